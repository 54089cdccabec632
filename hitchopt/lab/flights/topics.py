"""Topics of a recording: their contents, their bodies, and the choice for the drones.

A topic is a stream of samples: of a bag, or a group of variables of a log. Its kind follows from
the words of its name or, failing that, of its type: measured, estimated, commanded, or of a load.
The drones' positions have one kind: measured before estimated before commanded, and loads only on
request. Among topics of a kind those that name a motion capture system come first, then message
types in the order of the reader. Other quantities are those of the first topic of their kind.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import NamedTuple

from hitchopt.errors import FileError
from hitchopt.hitch import GRAVITY
from hitchopt.lab.flights.recordings import QUANTITIES

DEGREE = math.pi / 180.0  # Unit of angles in logs [rad]
PWM = 1.0 / 65535.0  # Unit of motor commands in logs, of full power

LOAD = "load"  # Kind of topics of a carried load
COMMANDED = "commanded"  # Kind of topics of setpoints
KINDS = ("measured", "estimated", COMMANDED, LOAD)  # By preference

# Words of topics or, failing that, of message types, by kind; the first match counts. A topic
# without such a word is measured
WORDS: dict[str, frozenset[str]] = {
    kind: frozenset(words.split())
    for kind, words in {
        "commanded": "cmd command commanded commands setpoint setpoints goal goals initialpose "
        "target targets ref reference desired plan planned trajectory waypoint waypoints",
        "load": "load payload",
        "measured": "mocap capture vicon vrpn optitrack natnet qualisys motive truth groundtruth",
        "estimated": "odom odometry covariance estimate estimated estimates estimator ekf kalman "
        "filter filtered fused local log onboard state vio slam",
    }.items()
}
# Words of parts of topics that name no body
STRUCTURE = (
    "base body client footprint frame global in link map mavros node out pose poses position "
    "positions root tf tracking transform transforms vision world"
)

# Topics of logs with their kinds; of a kind the first is taken
LOG_TOPICS = {
    "stateEstimate": "estimated",
    "stateEstimateZ": "estimated",
    "kalman": "estimated",
    "locSrv": "measured",  # Motion capture, as the drone received it
    "ctrltarget": "commanded",
    "ctrltargetZ": "commanded",
    "stateEstimateZ.p": "load",
    "vehicle_local_position_groundtruth": "measured",  # Of the simulator
    "vehicle_mocap_odometry": "measured",  # Motion capture, as PX4 received it
    "vehicle_visual_odometry": "measured",  # The same, in most installations
    "vehicle_local_position": "estimated",
    "trajectory_setpoint": "commanded",
}

# Quantities of logs whose topics name them, by the topic's last part: quantity, number of values,
# and their unit; others are not read
LOGGED: dict[str, tuple[str, int, float]] = {
    "pos": ("position", 3, 1.0),
    "position": ("position", 3, 1.0),
    "pose": ("position", 3, 1.0),
    "vel": ("velocity", 3, 1.0),
    "quat": ("attitude", 4, 1.0),
    "gyro": ("rates", 3, DEGREE),
    "acc": ("specific_force", 3, GRAVITY),
    "pwm": ("motors", 4, PWM),
    "motor": ("motors", 4, PWM),
    "motors": ("motors", 4, PWM),
}

# Variables of uSD logs with positions by topic, with their unit
USD_POSITIONS: dict[str, tuple[str, float]] = {
    "stateEstimate": ("stateEstimate.x y z", 1.0),
    "stateEstimateZ": ("stateEstimateZ.x y z", 1e-3),
    "kalman": ("kalman.stateX stateY stateZ", 1.0),
    "locSrv": ("locSrv.x y z", 1.0),
    "ctrltarget": ("ctrltarget.x y z", 1.0),
    "ctrltargetZ": ("ctrltargetZ.x y z", 1e-3),
    "stateEstimateZ.p": ("stateEstimateZ.px py pz", 1e-3),
}

# Variables of uSD logs by quantity, with their unit; of each quantity the first that is logged
USD_QUANTITIES: dict[str, tuple[tuple[str, float], ...]] = {
    "attitude": (("locSrv.qx qy qz qw", 1.0),),
    "estimated_velocity": (
        ("stateEstimate.vx vy vz", 1.0),
        ("stateEstimateZ.vx vy vz", 1e-3),
    ),
    "estimated_attitude": (
        ("stateEstimate.qx qy qz qw", 1.0),
        ("stateEstimateZ.quat", 1.0),  # Compressed into 32 bits
        ("kalman.q1 q2 q3 q0", 1.0),
        ("ctrlLeeP.rpyx rpyy rpyz", 1.0),
        ("ctrlLee.rpyx rpyy rpyz", 1.0),
        ("stateEstimate.roll pitch yaw", DEGREE),
    ),
    "commanded_velocity": (("ctrltarget.vx vy vz", 1.0), ("ctrltargetZ.vx vy vz", 1e-3)),
    "commanded_acceleration": (("ctrltarget.ax ay az", 1.0), ("ctrltargetZ.ax ay az", 1e-3)),
    "commanded_yaw": (("ctrltarget.yaw", DEGREE),),
    "rates": (("gyro.x y z", DEGREE),),
    "specific_force": (("acc.x y z", GRAVITY),),
    "motors": (
        ("pwm.m1_pwm m2_pwm m3_pwm m4_pwm", PWM),
        ("motor.m1 m2 m3 m4", PWM),
        ("pwm.m1 m2 m3 m4", PWM),
    ),
    "thrust": (
        ("ctrlLeeP.thrustSI", 1.0),
        ("ctrlLee.thrustSI", 1.0),
        ("ctrlLeeP.ux uy uz", 1.0),
        ("ctrlLee.ux uy uz", 1.0),
    ),
}
FLIPPED = "stateEstimate.pitch"  # Has the opposite sign of the attitude's


class UlogVariables(NamedTuple):
    """Variables of a topic of ulogs.

    Attributes
    ----------
    topic: the topic's name.
    names: the variables' names, separated by blanks.
    axes: ``world`` for north, east, down; ``body`` for forward, right, down; ``attitude`` for
        quaternions w, x, y, z; ``plain`` for numbers without axes.
    valid: names of variables that are 0 while the others are not valid.
    """

    topic: str
    names: str
    axes: str
    valid: str = ""


ULOG_ODOMETRY = ("vehicle_mocap_odometry", "vehicle_visual_odometry")
ULOG_ESTIMATE = "vehicle_local_position"  # PX4's topic of the estimated position
# PX4's topic of the true position in a simulation
ULOG_TRUTH = "vehicle_local_position_groundtruth"

# Positions in ulogs by topic; older odometry has x, y and z
ULOG_POSITIONS: dict[str, tuple[UlogVariables, ...]] = {
    ULOG_TRUTH: (UlogVariables(ULOG_TRUTH, "x y z", "world"),),
    **{
        topic: (
            UlogVariables(topic, "x y z", "world"),
            UlogVariables(topic, "position[0] position[1] position[2]", "world"),
        )
        for topic in ULOG_ODOMETRY
    },
    ULOG_ESTIMATE: (UlogVariables(ULOG_ESTIMATE, "x y z", "world", "xy_valid z_valid"),),
}

# Variables of ulogs by quantity; of each quantity the first that is logged
ULOG_QUANTITIES: dict[str, tuple[UlogVariables, ...]] = {
    "attitude": tuple(
        UlogVariables(topic, "q[0] q[1] q[2] q[3]", "attitude")
        for topic in ("vehicle_attitude_groundtruth", *ULOG_ODOMETRY)
    ),
    "estimated_velocity": (
        UlogVariables(ULOG_ESTIMATE, "vx vy vz", "world", "v_xy_valid v_z_valid"),
    ),
    "estimated_attitude": (UlogVariables("vehicle_attitude", "q[0] q[1] q[2] q[3]", "attitude"),),
    "rates": (UlogVariables("sensor_combined", "gyro_rad[0] gyro_rad[1] gyro_rad[2]", "body"),),
    "specific_force": (
        UlogVariables(
            "sensor_combined",
            "accelerometer_m_s2[0] accelerometer_m_s2[1] accelerometer_m_s2[2]",
            "body",
        ),
    ),
    **{
        f"commanded_{name}": (
            UlogVariables("trajectory_setpoint", f"{name}[0] {name}[1] {name}[2]", "world"),
        )
        for name in ("position", "velocity", "acceleration")
    },
    "motors": (
        UlogVariables("actuator_motors", "control[0] control[1] control[2] control[3]", "plain"),
    ),
}
MAX_LISTED = 5  # Most topics that a message lists


@dataclass(frozen=True)
class Topic:
    """A stream of samples of one kind."""

    name: str
    family: str  # name with * in place of the body's name
    body: str  # name of the body; empty if messages name the bodies, or no part of ``name`` does
    kind: str  # one of KINDS
    preference: int = 0  # among topics of a kind; the lowest is taken

    def __str__(self) -> str:
        return f"{self.family} ({self.kind})"


def bag_topics(types: Mapping[str, str], preferences: Mapping[str, bool]) -> list[Topic]:
    """Return the topics of a bag.

    ``types`` are message types by topic, ``preferences`` whether messages of a type name the
    bodies, in order of preference.
    """
    order = list(preferences)
    topics = list[Topic]()
    for name, named in body_names(list(types)).items():
        kind = _kind_of(name) or _kind_of(types[name])
        preference = order.index(types[name]) + len(order) * (kind is None)
        body, family = ("", name) if preferences[types[name]] else named
        topics.append(Topic(name, family, body, kind or KINDS[0], preference))
    return topics


def quantity_name(kind: str, part: str) -> str:
    """Return the name in QUANTITIES of a part of a topic's samples; empty if it has none.

    Positions of measured topics are tracks, and have the name ``position``.
    """
    if part in {"rates", "specific_force", "motors", "thrust"}:
        return part
    name = part if kind in {KINDS[0], LOAD} else f"{kind}_{part}"
    return name if name in QUANTITIES or name == "position" else ""


def is_load(body: str) -> bool:
    """Return whether the name of a body denotes a load."""
    return bool(_words(body) & WORDS[LOAD])


def taken_topics(topics: Sequence[Topic], request: str | None) -> tuple[list[Topic], list[str]]:
    """Return the topics that hold the drones' positions, and a note on the choice if there is one.

    ``request`` is a topic or a family, or a pattern in which ``*`` stands for any text. Raises
    FileError if there is none.
    """
    if request is not None:
        taken = [x for x in topics if request in {x.name, x.family}]
        taken = taken or [x for x in topics if fnmatchcase(x.name, request)]
    else:
        ranks = [(KINDS.index(x.kind), x.preference) for x in topics]
        eligible = [rank for rank, x in zip(ranks, topics, strict=True) if x.kind != "load"]
        best = min(eligible, default=None)
        taken = [x for rank, x in zip(ranks, topics, strict=True) if rank == best]
    if not taken:
        bound = "no topic of a drone" if request is None else f"no topic {request}"
        raise FileError(f"contains {bound}, but {_listed(topics)}; choose with topic=")
    used = _listed(taken)
    others = _listed([x for x in topics if x not in taken])
    if others:
        return taken, [f"positions come from {used}, not from {others}: choose with topic="]
    return taken, [] if taken[0].kind == KINDS[0] else [f"positions come from {used}"]


def _listed(topics: Sequence[Topic]) -> str:
    """Return the families of topics with their kinds as text, shortened to MAX_LISTED."""
    ordered = sorted(topics, key=lambda x: (KINDS.index(x.kind), x.preference, x.family))
    families = list(dict.fromkeys(map(str, ordered)))
    more = [f"{len(families) - MAX_LISTED} more"] * (len(families) > MAX_LISTED)
    return ", ".join(families[:MAX_LISTED] + more)


def body_names(labels: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return the body's name and the family of every label, such as the name of a topic.

    The name is the part that differs: ``/uav0/local_position/pose`` and
    ``/uav1/local_position/pose`` are of uav0 and uav1, in the family ``/*/local_position/pose``.
    Parts that describe the contents of a topic, such as ``cmd_position``, are not names; without a
    name the family is the label.
    """
    parts = {label: label.split("/") for label in labels}

    def is_structure(part: str) -> bool:  # Says what a topic holds, not whose it is
        words = _words(part) <= set(STRUCTURE.split()) and not re.search(r"\d", part)
        return words or _kind_of(part) is not None

    candidates = {
        label: [part for part in dict.fromkeys(own) if part and not is_structure(part)]
        for label, own in parts.items()
    }

    def family(label: str, name: str) -> str:
        return "/".join("*" if part == name else part for part in parts[label])

    sizes = Counter(family(label, name) for label, own in candidates.items() for name in own)
    names = dict[str, tuple[str, str]]()
    for label, own in candidates.items():
        largest = max((sizes[family(label, name)] for name in own), default=0)
        name = next((name for name in own if sizes[family(label, name)] == largest), "")
        names[label] = name, family(label, name) if name else label
    return names


def _kind_of(text: str) -> str | None:
    return next((kind for kind, own in WORDS.items() if _words(text) & own), None)


def _words(text: str) -> set[str]:
    return {word.casefold() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)}
