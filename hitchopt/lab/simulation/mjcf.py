"""Format mjcf: ``scene.xml``, the simulator's world with the plan's setpoints as controls.

Drones are points with their masses; cables are the simulator's ropes in the shape that they have at
the plan's start. Every drone has six controls: the position that its loop follows (``q0 x``, ``q0
y``, ``q0 z`` [m]), and the force that is added to the loop's (``q0 fx``, … [N]). Keyframes contain
the controls at all times, and the first one also the state at the start::

    model = mujoco.MjModel.from_xml_path("scene.xml")
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for k in range(1, model.nkey):
        while data.time < model.key_time[k]:
            mujoco.mj_step(model, data)
        data.ctrl = model.key_ctrl[k]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from hitchopt.errors import FileError
from hitchopt.exports.contents import FileContents
from hitchopt.exports.format import ExportTask, Format, FormatOutput
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.lab.simulation.control import PositionGains
from hitchopt.lab.simulation.flight import FlightInProgress
from hitchopt.lab.simulation.ropes import Ropes, leg_end_offsets
from hitchopt.lab.simulation.settings import FAST, IDEAL, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import SLIDE_AXES, describe, text
from hitchopt.motion.flight import Flight
from hitchopt.motion.states import HOVER, flight_states_at, sample_times
from hitchopt.objects import SolidObject
from hitchopt.storage.archive import reading
from hitchopt.storage.files import file_bytes
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.values import Array

SETTINGS = Settings(FAST, controller=IDEAL, pull_test=False)
"""Settings of the simulator in whose world the scene starts."""

DIGITS = 9  # Significant digits of controls


class Mjcf(Format):
    """The simulator's scene for MuJoCo, with setpoints as controls of the drones."""

    name = "mjcf"
    file = "scene.xml"
    endings = (".xml",)
    frames = ("enu",)
    rate = 50.0
    accuracy = 2e-3
    feed_forward = "the forces of the controls"
    flown_by = ""
    needs_stiffness = False

    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the world at the plan's start, and the controls at the task's rate.

        Raises UnsupportedError for loads at clasps, and if mujoco is not installed.
        """
        flight, frame = task.flight, task.frame
        gains = PositionGains.of(flight.team, SETTINGS)
        start = _Start.of(flight)
        files_names = dict(zip(task.order.tolist(), task.names, strict=True))
        names = [files_names[i] for i in start.drones]
        t = sample_times(flight.duration, task.rate)
        setpoints, forces = _controls(flight, gains, start, t)
        controls = np.concatenate([frame.points(setpoints), frame.vectors(forces)], axis=-1)
        rows = controls[:, start.drones].reshape(len(t), -1)
        content = describe(
            start.ropes,
            flight.team.mass[start.drones],
            start.ground + float(frame.shift[2]),
            {name: _placed(each, frame) for name, each in start.objects.items()},
            names,
            drone_joints=_world_slides,
            node_joints=_world_slides,
            further=_actuators(names, gains, start.drones) + _keyframes(start, frame, t, rows),
        )
        (folder / self.file).write_text(content, encoding="utf-8")
        return FormatOutput((self.file,))

    def load(self, files: Sequence[Path]) -> FileContents:
        """Return the lines between the positions of a scene's controls."""
        (path,) = files[:1]
        with reading(path, "MuJoCo scene of drones with setpoints", ElementTree.ParseError):
            return FileContents.of_samples(*_read(path), "enu", 0)


@dataclass(frozen=True, eq=False)
class _Start:
    """The simulator's world when the plan starts."""

    ropes: Ropes
    ground: float  # [m]
    objects: dict[str, SolidObject]
    drones: list[int]  # (D,) indices in the flight: those of cables first, as in the world
    nodes: Array  # (nodes, 3) [m] of all cables with their drones, then of single drones
    task: Task | None  # of the teams with cables

    @classmethod
    def of(cls, flight: Flight) -> _Start:
        """Return the start of a flight, with taut cables if it begins with a hitch."""
        names = list(flight.team.drone_names)
        places = flight_states_at(flight, 0.0).positions
        if not flight.has_cables:
            ropes, drones = Ropes(np.zeros(0), 0.0, 0.0, FAST), list(range(len(names)))
            ground = flight.requirements.ground_or(float(np.min(places[:, 2])))
            return cls(ropes, ground, {}, drones, places, None)
        task = Task.of(flight)
        if np.any(task.team.load):
            raise unsupported(Feature.SCENE, Neighbour.LOADS)
        simulated = FlightInProgress(task, SETTINGS)
        world = simulated.settled()
        tied = [names.index(name) for name in world.drone_names]
        single = [i for i in range(len(names)) if i not in tied]
        return cls(
            world.ropes,
            world.ground,
            world.objects,
            tied + single,
            np.concatenate([world.nodes, places[single]]),
            task,
        )

    def end_offsets(self, t: Array) -> Array:
        """Return offsets of ropes' ends (S, D, 3) [m] at times (S,), as ``leg_end_offsets``."""
        offsets = np.zeros((len(t), len(self.drones), 3))
        if self.task is not None:
            each = [leg_end_offsets(part, FAST.diameter) for part in self.task.teams]
            joined = np.concatenate(each, axis=1)[[self.task.index(time) for time in t.tolist()]]
            offsets[:, self.drones[: joined.shape[1]]] = joined
        return offsets


def _controls(flight: Flight, gains: PositionGains, start: _Start, t: Array) -> tuple[Array, Array]:
    """Return positions [m] and forces [N] of drones (S, D, 3) at times (S,) [s], in the plan.

    Forces are those of the ideal controller without errors: ``m (a + g ẑ)``, the planned pull of
    the cable, ``kd v`` and ``kp`` times the offset of the rope's end.
    """
    states = flight_states_at(flight, t)
    forces = flight.team.mass[:, None] * (states.accelerations + HOVER)
    forces = forces - gains.feed_forward[:, None] * states.cable_forces
    forces += gains.damping * states.velocities + gains.stiffness * start.end_offsets(t)
    return states.positions, forces


def _placed(each: SolidObject, frame: ReferenceFrame) -> SolidObject:
    """Return an object in the frame of a file."""
    return replace(each, at=frame.points(np.asarray(each.at)), yaw=each.yaw + frame.yaw)


def _world_slides(name: str, place: Array) -> str:
    """Return slide joints whose coordinates are the position in the world [m]."""
    return "".join(
        f'<joint name={quoteattr(f"{name} {axis}")} type="slide" axis="{vector}" '
        f'ref="{text(origin)}"/>'
        for (axis, vector), origin in zip(SLIDE_AXES.items(), place.tolist(), strict=True)
    )


def _actuators(names: Sequence[str], gains: PositionGains, drones: Sequence[int]) -> str:
    """Return position loops and added forces of drones, in the order of the controls."""
    elements = ""
    for name, drone in zip(names, drones, strict=True):
        for kind, (i, axis) in product(("loop", "force"), enumerate(SLIDE_AXES)):
            joint = quoteattr(f"{name} {axis}")
            if kind == "loop":
                kp, kd = gains.stiffness[drone, i], gains.damping[drone, i]
                elements += (
                    f'<general name={joint} joint={joint} gainprm="{text(kp)}" '
                    f'biastype="affine" biasprm="0 {text([-kp, -kd])}"/>'
                )
            else:
                elements += f"<motor name={quoteattr(f'{name} f{axis}')} joint={joint}/>"
    return f"<actuator>{elements}</actuator>"


def _keyframes(start: _Start, frame: ReferenceFrame, t: Array, rows: Array) -> str:
    """Return keyframes with controls (S, 6 D) at times (S,) [s], the first one with the state."""
    state = [frame.points(start.nodes).ravel()]
    for each in start.objects.values():
        if not each.fixed:
            placed = _placed(each, frame)
            half = 0.5 * placed.yaw
            state += [np.asarray(placed.at), np.array([np.cos(half), 0.0, 0.0, np.sin(half)])]
    numbers = " ".join([f"%.{DIGITS}g"] * rows.shape[1])
    keys = [
        f'<key time="{time:.{DIGITS}g}" ctrl="{numbers % tuple(row)}"'
        for time, row in zip(t.tolist(), rows.tolist(), strict=True)
    ]
    keys[0] += f' qpos="{text(np.concatenate(state))}"'
    return f"<keyframe>{''.join(f'{key}/>' for key in keys)}</keyframe>"


def _read(path: Path) -> tuple[list[str], Array, Array]:
    """Return names (D,), times (S,) [s] and positions (S, D, 3) [m] of the controls of a scene."""
    root = ElementTree.fromstring(file_bytes(path))
    actuators = [each.get("name", "") for each in root.findall("actuator/*")]
    columns = [i for i, name in enumerate(actuators) if name.rpartition(" ")[2] in SLIDE_AXES]
    names = [actuators[i].rpartition(" ")[0] for i in columns[::3]]
    keys = root.findall("keyframe/key")
    if not names or not keys:
        raise FileError(f"{path}: has no drones with setpoints as controls")
    t = np.array([float(key.attrib["time"]) for key in keys])
    controls = np.array([np.array(key.attrib["ctrl"].split(), dtype=np.float64) for key in keys])
    return names, t, controls[:, columns].reshape(len(t), len(names), 3)
