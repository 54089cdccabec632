"""The task of a simulated flight: what a plan commands at 100 Hz, its team and its objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.exports.directory import refuse_mixture
from hitchopt.hitch import Team
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import sample_times, states_at
from hitchopt.objects import SolidObject
from hitchopt.storage.archive import PLAN
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

Flags = NDArray[np.bool_]

RATE = 100.0  # Setpoints per second [Hz]
ALOFT = 0.03  # Height over where it stood and will stand from which on an object is aloft [m]
CARRIED = 1.0 - 1e-6  # Share of its weight from which on a hitch carries all of an object
SAME_TIME = 1e-6  # Tolerance of a time that falls on a sample [s]: rounding of sums of periods


@dataclass(frozen=True, eq=False)
class Cargo:
    """Objects, and where the plan has them at the samples of a task.

    Attributes
    ----------
    objects: by name.
    poses: (samples, objects, 5): x, y, z of their bases [m], cosine and sine of their yaws.
    held: whether the hitch holds them, so that its cables may touch them (samples, objects).
    borne: share of its weight that the hitch carries (samples, objects).
    floor: height of the ground on which they stand [m].
    """

    objects: Mapping[str, SolidObject] = field(default_factory=dict)
    poses: Array = field(default_factory=lambda: np.zeros((1, 0, 5)))
    held: Flags = field(default_factory=lambda: np.zeros((1, 0), dtype=np.bool_))
    borne: Array = field(default_factory=lambda: np.zeros((1, 0)))
    floor: float = 0.0

    @classmethod
    def of(cls, motion: Motion, t: Array) -> Cargo:
        """Return the objects of a plan at times (samples,) [s]."""
        objects = motion.requirements.objects
        held = np.zeros((len(t), len(objects)), dtype=np.bool_)
        for phase in motion.phases:
            if phase.hold is not None:
                during = (t >= phase.start) & (t <= phase.end)
                held[during, list(objects).index(phase.hold.object)] = True
        poses, borne = motion.object_poses.at(t), motion.object_shares.at(t)
        return cls(objects, poses, held, borne, motion.requirements.floor)

    @property
    def names(self) -> list[str]:
        """Names of all objects."""
        return list(self.objects)

    @property
    def movable(self) -> Flags:
        """Whether an object can move (objects,)."""
        return np.array([not each.fixed for each in self.objects.values()], dtype=np.bool_)

    @property
    def carried(self) -> Flags:
        """Whether the hitch carries all of an object's weight (samples, objects)."""
        return self.borne >= CARRIED

    @property
    def aloft(self) -> Flags:
        """Whether an object is clear of what it stood on and will stand on (samples, objects)."""
        heights, rests = self.poses[..., 2], self.borne <= 0.0
        supports = []
        for order in (1, -1):  # the last place where it stood, and the next one
            rows = np.where(rests[::order], np.arange(len(rests))[:, None], -1)
            rows = np.maximum.accumulate(rows, axis=0)
            last = np.take_along_axis(heights[::order], np.maximum(rows, 0), axis=0)
            supports.append(np.where(rows >= 0, last, -np.inf)[::order])
        return ~rests & (heights > np.maximum(*supports) + ALOFT)


@dataclass(frozen=True, eq=False)
class Setpoints:
    """Commands to the drones q0, r0, q1, … at some times (…); yaw is 0.

    Attributes
    ----------
    positions, velocities, accelerations, jerks: (…, 2n, 3) [m], [m/s], [m/s²], [m/s³]
    cable_forces: (…, 2n, 3) [N], expected from the cables.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    cable_forces: Array

    def __getitem__(self, index: int) -> Setpoints:
        """Return the setpoints of one sample."""
        return Setpoints(*(values[index] for values in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Task:
    """Setpoints of a flight, and the plan's hitch at their times.

    Attributes
    ----------
    team: that flies them.
    t: (samples,) [s]
    setpoints: (samples, …).
    formed: whether the plan has a hitch (samples,).
    vertices, tensions: of the hitch (samples, points, 3) [m], (samples, n) [N]; zero without.
    taut: share of its part of the clasps' loads that a cable carries (samples, n); None: all where
        it is under tension.
    cargo: objects.
    motion: the plan, which feedback and gripped cables need; None where setpoints are made by hand.
    """

    team: Team
    t: Array
    setpoints: Setpoints
    formed: Flags
    vertices: Array
    tensions: Array
    taut: Array | None = None
    cargo: Cargo = field(default_factory=Cargo)
    motion: Motion | None = None

    @classmethod
    def of(cls, motion: Motion) -> Task:
        """Return the task of a plan; UnsupportedError for several teams, or without cables."""
        if len(motion.groups) > 1:
            raise UnsupportedError("several teams in one plan; solve and simulate each team alone")
        if not motion.team.has_cables:
            raise UnsupportedError("single drones have no cables; simulate a hitch's plan")
        t = sample_times(motion.duration, RATE)
        states = states_at(motion, t)
        formed = np.asarray(states.formed, np.bool_)
        taut = PiecewisePolynomial(motion.drones.breaks, tautness(motion))
        return cls(
            motion.team,
            t,
            Setpoints(*(getattr(states, each.name) for each in fields(Setpoints))),
            formed,
            np.where(formed[:, None, None], states.vertices, 0.0),
            np.where(formed[:, None], states.tensions, 0.0),
            taut.at(t),
            Cargo.of(motion, t),
            motion,
        )

    @property
    def duration(self) -> float:
        """Time from the first setpoint to the last [s]."""
        return float(self.t[-1] - self.t[0])

    def load_shares(self, index: int) -> Array:
        """Return the shares (n,) of their parts of the loads that cables carry at a sample."""
        return np.asarray(self.tensions[index] > 0.0 if self.taut is None else self.taut[index])

    def index(self, elapsed: float) -> int:
        """Return the setpoint that applies ``elapsed`` [s] after the first one."""
        index = int(np.searchsorted(self.t, self.t[0] + elapsed + SAME_TIME, side="right")) - 1
        return min(max(index, 0), len(self.t) - 1)


def read_task(directory: Path) -> Task:
    """Return the task of the plan in a directory; FileError where that is missing or broken."""
    motion = read_plan(directory / PLAN)
    refuse_mixture(directory)
    return Task.of(motion)
