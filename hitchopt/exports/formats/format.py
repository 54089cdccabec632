"""The interface of formats, and the plans that they are given."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from hitchopt.exports.export_options import ExportOptions
from hitchopt.exports.fleet import Fleet
from hitchopt.exports.recording import Recording
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.storage.atomic import Writer
from hitchopt.values import Array

Progress = Callable[[str], None]
"""Function that is called with what is being done now."""


@dataclass(frozen=True, eq=False)
class Task:
    """A plan or a part of it, and everything that its files depend on.

    Attributes
    ----------
    motion: the plan, from t = 0 on.
    title: what the plan is called.
    frame: the file's axes, and where the plan lies in them.
    fleet: who flies its drones.
    rate: samples a second of the formats that sample [Hz].
    options: what the user asked for.
    begins: when in the plan the motion begins [s]; 0 unless the plan was cut.
    number, count: which part of how many the motion is, from 1 on.
    undetermined: why the files leave the cables' tension undetermined, in words.
    notes: what else the user should know of it.
    """

    motion: Motion
    title: str
    frame: ReferenceFrame
    fleet: Fleet
    rate: float
    options: ExportOptions
    begins: float = 0.0
    number: int = 1
    count: int = 1
    undetermined: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

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

    def cable_forces(self, states: States) -> Array:
        """Return the cable forces to feed forward, (S, D, 3) [N], in the file's axes.

        None where the set points hold the tension by their offsets.
        """
        forces = 0.0 * states.cable_forces if self.options.hold_tension else states.cable_forces
        return self.frame.vectors(forces)

    def pulls(self, states: States) -> Array:
        """Return the forces to feed forward over each drone's mass, (S, D, 3) [m/s²]."""
        return self.cable_forces(states) / self.motion.team.mass[:, None]

    def setpoints(self, states: States) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations less the pull, in the file's axes.

        Shapes are (S, D, 3); units [m], [m/s], [m/s²].
        """
        frame = self.frame
        forward = frame.vectors(states.accelerations) - self.pulls(states)
        return frame.points(states.positions), frame.vectors(states.velocities), forward


@dataclass(frozen=True, eq=False)
class Candidate:
    """Files that may do; the export tries one candidate after the other.

    Attributes
    ----------
    writers: for each file's name, what writes it.
    notes: what the user should know of them.
    receiver: what must be set where they are flown, for the manifest; empty for nothing.
    """

    writers: Mapping[str, Writer]
    notes: tuple[str, ...] = ()
    receiver: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A plan as a whole, or cut.

    Attributes
    ----------
    tasks: one after the other.
    note: why it is so, for the user; nothing for the usual.
    """

    tasks: tuple[Task, ...]
    note: str = ""


class Format(Protocol):
    """One file format.

    Attributes
    ----------
    name: as given to ``--format``.
    frames: those that its files may be in, the usual one first.
    rate: samples a second if nothing else is asked [Hz]; 0 where nothing is sampled.
    accuracy: the largest position error that it is meant to have [m].
    feed_forward: whether the consumer needs the cable's pull in its acceleration, and what is done.
    carries_pull: whether the files hold the cable's pull, as a force or in an acceleration.
    receiver_integral: whether the controllers that fly the files have an integral of their own.
    """

    name: str
    frames: tuple[str, ...]
    rate: float
    accuracy: float
    feed_forward: str
    carries_pull: bool
    receiver_integral: bool

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the task as a whole, then in parts to be flown one after the other, at rest between.

        Formats that hold plans of any length give the whole.

        Raises
        ------
        InfeasibleError: no other arrangement holds the plan.
        """
        yield Arrangement((task,))

    def candidates(self, task: Task) -> Iterator[Candidate]:
        """Give what may be written, the best first.

        Raises
        ------
        InfeasibleError: the plan is beyond what the format can hold.
        """
        ...

    def read(self, folder: Path, task: Task) -> Recording:
        """Return what the files in a folder say, read as anybody else would.

        Raises
        ------
        FileError: they are damaged.
        """
        ...

    def certify(self, folder: Path, task: Task) -> None:  # noqa: ARG002
        """Certify what the files hold besides the flight that is read; most hold nothing else.

        Raises
        ------
        FileError: they are damaged.
        InfeasibleError: it breaks a limit.
        """
        return


def writer_of(content: str | bytes) -> Writer:
    """Return what writes the content, text in UTF-8."""
    data = content.encode() if isinstance(content, str) else content

    def write(path: Path) -> None:
        path.write_bytes(data)

    return write
