"""What every format offers, and what it is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.exports.fleet import Fleet
from hitchopt.exports.frame import Room
from hitchopt.exports.recording import Recording
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.storage.atomic import Writer

Array = NDArray[np.float64]


ROS_DISTROS = {"humble": 8, "iron": 8, "jazzy": 9}
"""Version of a bag's metadata that each release is given. 8 is read by all three; Humble and Iron
stop at 9, whose profiles of quality of service are lists."""


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be exported.

    Attributes
    ----------
    motion: the plan, from t = 0 on.
    title: what the plan is called.
    room: where it lies in the file's frame.
    fleet: who flies its drones.
    rate: samples a second of the formats that sample [Hz].
    storage: of a bag, mcap or sqlite3.
    rate_given: whether the user asked for that rate; else a format may sample more often.
    begins: when in the plan the motion begins [s]; 0 unless the plan was cut.
    number, count: which part of how many the motion is, from 1 on.
    ros_distro: the ROS 2 release that a bag is for, one of ROS_DISTROS.
    """

    motion: Motion
    title: str
    room: Room
    fleet: Fleet
    rate: float
    storage: str = "mcap"
    rate_given: bool = False
    begins: float = 0.0
    number: int = 1
    count: int = 1
    ros_distro: str = "humble"

    @property
    def names(self) -> tuple[str, ...]:
        """(D,) what the files call the drones, in the plan's order."""
        return tuple(member.name for member in self.fleet.members)

    @property
    def span(self) -> tuple[float, float]:
        """When in the plan the motion begins and ends [s]; parts follow without a gap."""
        return self.begins, self.begins + self.motion.duration

    @property
    def place(self) -> str:
        """Which part of the plan this is, in words; nothing for the whole."""
        if self.count == 1:
            return ""
        begins, ends = self.span
        return f"part {self.number} of {self.count}, t = {begins:.3f} s to {ends:.3f} s of the plan"

    def pulls(self, t: Array) -> Array:
        """Return the cables' pull over each drone's mass, (S, D, 3) [m/s²], in the file's axes."""
        return pull_of(self, states_at(self.motion, t))


def pull_of(task: Task, states: States) -> Array:
    """Return what cables add to the drones' accelerations, (S, D, 3) [m/s²], in the file's axes."""
    return task.room.vectors(states.cable_forces / task.motion.team.mass[:, None])


@dataclass(frozen=True, eq=False)
class Candidate:
    """Files that may be what is asked for; the export tries one candidate after the other.

    Attributes
    ----------
    writers: for each file's name, what writes it.
    notes: what the user should know of them.
    receiver: what must be set where they are flown, for the manifest; empty for nothing.
    """

    writers: Mapping[str, Writer]
    notes: tuple[str, ...] = field(default=())
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


class Whole:
    """What formats that hold plans of any length have in common."""

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the task as a whole."""
        yield Arrangement((task,))


class Format(Protocol):
    """One way of telling a fleet what to fly.

    Attributes
    ----------
    name: as given to ``--format``.
    summary: one line on what is written.
    frames: those that its files may be in, the usual one first.
    rate: samples a second if nothing else is asked [Hz]; 0 where nothing is sampled.
    accuracy: the largest position error that it is meant to have [m].
    feed_forward: whether the consumer needs the cable's pull in its acceleration, and what is done.
    """

    name: str
    summary: str
    frames: tuple[str, ...]
    rate: float
    accuracy: float
    feed_forward: str

    def arrangements(self, task: Task) -> Iterator[Arrangement]:
        """Give the task as a whole, then in parts to be flown one after the other, at rest between.

        Raises
        ------
        InfeasibleError: there is no other way to hold the plan.
        """
        ...

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
