"""Topics of a recording: what they hold, whose they are, and which is taken for the drones.

A topic is a stream of positions: of a bag, or a group of variables of a log. Its kind follows from
the words of its name, else of its type: measured, estimated, commanded, or of a load. The drones'
positions are of one kind: measured before estimated before commanded, and of a load only on
request. Among topics of a kind those that name a motion capture system come first, then message
types in the order of the reader.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from hitchopt.errors import FileError

KINDS = ("measured", "estimated", "commanded", "load")  # By preference

# Words of topics, else of message types, by kind; the first kind that matches counts. A topic
# without such a word is measured
WORDS: dict[str, frozenset[str]] = {
    kind: frozenset(words.split())
    for kind, words in {
        "commanded": "cmd command commanded commands setpoint setpoints goal goals initialpose "
        "target targets ref reference desired plan planned trajectory waypoint waypoints",
        "load": "load payload",
        "measured": "mocap capture vicon vrpn optitrack natnet qualisys motive truth groundtruth",
        "estimated": "odom odometry covariance estimate estimated estimates estimator ekf kalman "
        "filter filtered fused local onboard state vio slam",
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
    "locSrv": "measured",  # Motion capture, as the drone received it
    "ctrltarget": "commanded",
    "ctrltargetZ": "commanded",
    "stateEstimateZ.p": "load",
    "vehicle_visual_odometry": "measured",  # Motion capture, as PX4 received it
    "vehicle_local_position": "estimated",
}
MAX_LISTED = 5  # Most topics that a message lists


@dataclass(frozen=True)
class Topic:
    """A stream of positions of one kind."""

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
    order, topics = list(preferences), list[Topic]()
    for name, named in body_names(list(types)).items():
        kind = _kind_of(name) or _kind_of(types[name])
        preference = order.index(types[name]) + len(order) * (kind is None)
        body, family = ("", name) if preferences[types[name]] else named
        topics.append(Topic(name, family, body, kind or KINDS[0], preference))
    return topics


def log_topics(names: Sequence[str]) -> list[Topic]:
    """Return the topics of a drone's log."""
    order = list(LOG_TOPICS)
    return [Topic(name, name, "", LOG_TOPICS[name], order.index(name)) for name in names]


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
        raise FileError(f"holds {bound}, but {_listed(topics)}; choose with topic=")
    used, others = _listed(taken), _listed([x for x in topics if x not in taken])
    if others:
        return taken, [f"positions are of {used}, not of {others}: choose with topic="]
    return taken, [] if taken[0].kind == KINDS[0] else [f"positions are of {used}"]


def _listed(topics: Sequence[Topic]) -> str:
    """Return the families of topics with their kinds as text, shortened to MAX_LISTED."""
    ordered = sorted(topics, key=lambda x: (KINDS.index(x.kind), x.preference, x.family))
    families = list(dict.fromkeys(map(str, ordered)))
    more = [f"{len(families) - MAX_LISTED} more"] * (len(families) > MAX_LISTED)
    return ", ".join(families[:MAX_LISTED] + more)


def body_names(labels: Sequence[str], separator: str = "/") -> dict[str, tuple[str, str]]:
    """Return the body's name and the family of every label, such as the name of a topic.

    The name is the part that differs: ``/uav0/local_position/pose`` and
    ``/uav1/local_position/pose`` are of uav0 and uav1, in the family ``/*/local_position/pose``.
    Parts that say what a topic holds, such as ``cmd_position``, are no names; without a name the
    family is the label.
    """
    parts = {label: label.split(separator) for label in labels}
    candidates = {
        label: [part for part in dict.fromkeys(own) if part and not _is_structure(part)]
        for label, own in parts.items()
    }

    def family(label: str, name: str) -> str:
        return separator.join("*" if part == name else part for part in parts[label])

    sizes = Counter(family(label, name) for label, own in candidates.items() for name in own)
    names = dict[str, tuple[str, str]]()
    for label, own in candidates.items():
        largest = max((sizes[family(label, name)] for name in own), default=0)
        name = next((name for name in own if sizes[family(label, name)] == largest), "")
        names[label] = name, family(label, name) if name else label
    return names


def distinct_names(labels: Sequence[str], separator: str = "/") -> dict[str, str]:
    """Return names of the bodies of labels; the labels themselves where names coincide."""
    names = {label: name or label for label, (name, _) in body_names(labels, separator).items()}
    sizes = Counter(names.values())
    return {label: name if sizes[name] == 1 else label for label, name in names.items()}


def _kind_of(text: str) -> str | None:
    return next((kind for kind, own in WORDS.items() if _words(text) & own), None)


def _words(text: str) -> set[str]:
    return {word.casefold() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)}


def _is_structure(part: str) -> bool:
    """Return whether a part of a topic says what it holds, not whose it is."""
    structure = _words(part) <= set(STRUCTURE.split()) and not re.search(r"\d", part)
    return structure or _kind_of(part) is not None
