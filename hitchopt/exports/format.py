"""The interface of formats: the plans they write, and what they read and find in files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.exports.options import HOMES, ExportOptions
from hitchopt.exports.placing import Fleet, ReferenceFrame
from hitchopt.exports.recording import Recording
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import Attitudes, States, attitudes, iterate_states, states_at
from hitchopt.values import Array

FLIPPED = np.array([1.0, -1.0, -1.0])  # Signs of axes that are turned by 180° about x

ERROR, WARNING, NOTE = LEVELS = ("error", "warning", "note")
"""Levels of a finding: the flight fails; it may fail; information for the pilot."""


@dataclass(frozen=True)
class Finding:
    """One problem, or one piece of information, found in fleet files.

    Attributes
    ----------
    level: ERROR, WARNING or NOTE.
    rule: name of the rule in one word or two, such as ``memory`` or ``end marker``.
    where: drone or file; empty for all of them.
    message: value, bound, and the remedy.
    """

    level: str
    rule: str
    where: str
    message: str

    def __str__(self) -> str:
        place = f" {self.where}:" if self.where else ""
        return f"{self.level}: {self.rule}:{place} {self.message}"


error, warning, note = (partial(Finding, level) for level in (ERROR, WARNING, NOTE))
"""Constructors of findings of each level from rule, place and message."""


@dataclass(frozen=True)
class DroneFacts:
    """Size and duration of one drone's file.

    Attributes
    ----------
    name: of the drone.
    pieces: of its curve; 0 where it is sampled.
    size: [bytes] in the drone's memory; 0 where it is not uploaded.
    duration: [s] of its own file; 0 where all drones share their times.
    """

    name: str
    pieces: int = 0
    size: int = 0
    duration: float = 0.0


@dataclass(frozen=True, eq=False)
class Loaded:
    """Contents of files, read."""

    kind: str  # name of the format, as in ``hitchopt export --format``
    recording: Recording  # what the drones fly
    facts: tuple[DroneFacts, ...]  # one per drone
    findings: tuple[Finding, ...] = ()  # those made while reading
    streamed: bool = False  # whether samples are sent in flight: gaps between them count then
    own: Mapping[str, float] = field(default_factory=dict)  # a show's own limits, by its keys


@dataclass(frozen=True, eq=False)
class Task:
    """A plan or a part of it, and everything that its files depend on."""

    motion: Motion  # from t = 0 on
    title: str
    frame: ReferenceFrame  # the file's axes, and where the plan lies in them
    fleet: Fleet  # who flies its drones
    rate: float  # samples a second of the formats that sample [Hz]
    options: ExportOptions  # what the user asked for
    begins: float = 0.0  # when in the plan the motion begins [s]; 0 unless the plan was cut
    number: int = 1  # which part of the plan the motion is, from 1 on,
    count: int = 1  # of how many
    undetermined: tuple[str, ...] = ()  # why the files leave the cables' tension undetermined
    notes: tuple[str, ...] = ()  # what else the user should know of it

    @property
    def names(self) -> tuple[str, ...]:
        """Names (D,) that the files give the drones, in the plan's order."""
        return tuple(member.name for member in self.fleet.members)

    @property
    def span(self) -> tuple[float, float]:
        """Times in the plan at which the motion begins and ends [s]; parts leave no gap."""
        return self.begins, self.begins + self.motion.duration

    @property
    def part(self) -> str:
        """Description of the part of the plan that this is; empty for the whole."""
        if self.count == 1:
            return ""
        begins, ends = self.span
        return f"part {self.number} of {self.count}, t = {begins:.3f} s to {ends:.3f} s of the plan"

    def states(self, t: Array) -> States:
        """Return the states at times (S,) [s], with the cable forces that are fed forward.

        There are none where set points hold the tension by their offsets.
        """
        return self._fed(states_at(self.motion, t))

    def blocks(self, times: Array, rows: int) -> Iterator[States]:
        """Yield states at times (S,) [s] in blocks of so many rows, one per drone and time."""
        size = max(1, rows // len(self.names))
        return map(self._fed, iterate_states(self.motion, times, size))

    def _fed(self, states: States) -> States:
        if not self.options.hold_tension:
            return states
        nothing = np.zeros_like(states.cable_forces)
        return replace(states, cable_forces=nothing, cable_force_rates=nothing)

    def pulls(self, states: States) -> Array:
        """Return the forces to feed forward over each drone's mass, (S, D, 3) [m/s²]."""
        return self.frame.vectors(states.cable_forces) / self.motion.team.mass[:, None]

    def setpoints(self, states: States) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations less the pull, in the file's axes.

        Shapes are (S, D, 3); units [m], [m/s], [m/s²].
        """
        frame = self.frame
        forward = frame.vectors(states.accelerations) - self.pulls(states)
        return frame.points(states.positions), frame.vectors(states.velocities), forward

    def attitudes(self, states: States) -> Attitudes:
        """Return attitudes and body rates, from the body's axes to the file's.

        The body's z axis is along the thrust ``m (a_ff + g ẑ)``, its yaw is the frame's heading. In
        a frame whose z axis points down the body's axes are forward, right, down, as its readers
        expect; in others forward, left, up.
        """
        frame, team = self.frame, self.motion.team
        thrusts = frame.vectors(states.thrusts(team))
        rates = frame.vectors(states.thrust_rates(team))
        if frame.vectors(np.array([0.0, 0.0, 1.0]))[2] > 0.0:
            return attitudes(thrusts, rates, frame.heading)
        found = attitudes(thrusts * FLIPPED, rates * FLIPPED, -frame.heading)
        return Attitudes(found.quaternions * [1.0, *FLIPPED], found.body_rates * FLIPPED)


@dataclass(frozen=True, eq=False)
class Written:
    """What a format wrote into a folder."""

    files: tuple[str, ...]  # names
    notes: tuple[str, ...] = ()  # what the user should know of them
    receiver: Mapping[str, Any] = field(default_factory=dict)  # its settings, for the manifest


class Format:
    """One file format: what is written, and how files are read, ours or anybody else's.

    Attributes
    ----------
    name: as given to ``--format``.
    file: name of the file; with ``{name}`` or ``{number}`` of the drone each has its own, with
        ``{frame}`` it tells the frame.
    endings: of the files that hold trajectories.
    several: those of them of which every drone has a file.
    frames: those that its files may be in, the usual one first.
    rate: samples a second if nothing else is asked [Hz]; 0 where nothing is sampled.
    accuracy: the largest position error that it is meant to have [m].
    feed_forward: whether the consumer needs the cable's pull in its acceleration, and what is done.
    carries_pull: whether the files hold the cable's pull, as a force or in an acceleration.
    receiver_integral: whether the controllers that fly the files have an integral of their own.
    bounds: errors of refits over the usual one, tried one after the other.
    """

    name: str
    file: str
    endings: tuple[str, ...]
    several: tuple[str, ...] = ()
    frames: tuple[str, ...]
    rate: float = 0.0
    accuracy: float
    feed_forward: str
    carries_pull: bool = False
    receiver_integral: bool = False
    bounds: tuple[float, ...] = (1.0,)

    def write(self, folder: Path, task: Task, bound: float) -> Written:
        """Write the files of a task, refitted within a bound; raise OSError if that fails.

        Raises
        ------
        InfeasibleError: the plan is beyond what the format can hold.
        """
        raise NotImplementedError

    def parts(self, task: Task) -> Iterable[Sequence[Task]]:  # noqa: ARG002
        """Give cuts of a task into parts to be flown one after the other; here none.

        Raises
        ------
        InfeasibleError: no such parts hold the plan.
        """
        return ()

    def files(self, task: Task) -> tuple[str, ...]:
        """Return the names of the files with the trajectories of a task."""
        frame, each = task.frame.name, enumerate(task.names, 1)
        names = (self.file.format(name=name, number=i, frame=frame) for i, name in each)
        return tuple(dict.fromkeys(names))

    def load(self, files: Sequence[Path]) -> Loaded:
        """Return what files hold, ours or anybody else's, and what is wrong with them.

        Raises
        ------
        FileError: they are damaged.
        """
        raise NotImplementedError

    def recognises(self, labels: Sequence[str]) -> bool:  # noqa: ARG002
        """Return whether the first line of a CSV file, in lower case, is one of this format."""
        return False

    def read(self, folder: Path, task: Task) -> Recording:
        """Return what the files of a task in a folder say; raise FileError if they are damaged."""
        return self.load([folder / name for name in self.files(task)]).recording

    def certify(self, folder: Path, task: Task) -> None:
        """Certify what the files hold besides the flight that is read; most hold nothing else.

        Raises
        ------
        FileError: they are damaged.
        InfeasibleError: it breaks a limit.
        """


def format_of(name: str) -> Format:
    """Return the format of that name; raise InputError if there is none."""
    if name not in HOMES:
        import difflib

        near = difflib.get_close_matches(name, HOMES, 1)
        remedy = f"did you mean {near[0]}?" if near else "hitchopt export --help tells them apart"
        raise InputError("--format", name, f"one of {', '.join(HOMES)}", remedy)
    module, _, kind = HOMES[name].partition(":")
    found: Format = getattr(import_module(f"hitchopt.exports.formats.{module}"), kind)()
    return found
