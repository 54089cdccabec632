"""Records of a reaction to a loss: the survivors' course, and how they hold the lost drone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.motion.motion import Motion
from hitchopt.one_line import OneLine
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Course(OneLine):
    """What the survivors fly after a loss at a time, whichever drone it is.

    Attributes
    ----------
    time: of the loss [s].
    begins: when they react [s].
    sinking: the plan until ``begins``, and what follows until the lowest drone is on the ground.
    landing: the flights after that, of drones by themselves.
    share: of the limits with which they sink.
    checks: of all of it.
    """

    time: float
    begins: float
    sinking: Motion
    landing: tuple[Motion, ...]
    share: float
    checks: tuple[Check, ...]

    @property
    def duration(self) -> float:
        """Time at which all are on the ground [s]."""
        return self.sinking.duration + sum(each.duration for each in self.landing)


FADING = 0.1
"""[s] Time in which survivors let go of a lost drone that lies on the ground."""


@dataclass(frozen=True, eq=False)
class Held(OneLine):
    """How survivors hold a lost drone that hangs.

    Attributes
    ----------
    pulls: (2n, 3) [N], of the cables while it hangs, which survivors feed forward.
    begins, full: times from which on they pull, and from which on they do so fully [s].
    ends: time at which it lies on the ground, and they let go again [s].
    """

    pulls: Array
    begins: float
    full: float
    ends: float

    def added(self, times: Array, forces: Array) -> Array:
        """Return forces (k, 2n, 3) [N] that pass over into these pulls and fade, at times [s]."""
        risen = np.clip((times - self.begins) / (self.full - self.begins), 0.0, 1.0)
        fallen = np.clip((times - self.ends) / FADING, 0.0, 1.0)
        pulls: Array = (risen * (1.0 - fallen))[:, None, None] * self.pulls
        return (1.0 - risen)[:, None, None] * forces + pulls


@dataclass(frozen=True, eq=False)
class Inward(OneLine):
    """How survivors stay where what fell has drawn them.

    Attributes
    ----------
    forces: (2n, 3) [N], level, with which they push.
    begins, full: times from which on they push, and from which on they do so fully [s].
    fades, ends: times from which on they push less, and no longer [s].
    """

    forces: Array
    begins: float
    full: float
    fades: float
    ends: float

    def pushes(self, times: Array) -> Array:
        """Return their forces (k, 2n, 3) [N] at times [s]."""
        risen = np.clip((times - self.begins) / (self.full - self.begins), 0.0, 1.0)
        left = np.clip((self.ends - times) / (self.ends - self.fades), 0.0, 1.0)
        pushes: Array = (risen * left)[:, None, None] * self.forces
        return pushes


@dataclass(frozen=True, eq=False)
class Reaction(OneLine):
    """A certified reaction to the loss of a drone.

    Attributes
    ----------
    drone: that is lost.
    course: what survivors fly.
    thrust: largest thrust of a survivor that hovers with the lost drone's weight on its cable, over
        its largest one.
    nearest: smallest separation of two survivors, or distance of one to the lost drone over two
        radii.
    held: how they hold the lost drone once it has swung down; None where it lies on the ground by
        then, or no clasp holds its cable.
    inward: how they stay where it has drawn them; None where they do not.
    """

    drone: str
    course: Course
    thrust: float
    nearest: float
    held: Held | None = None
    inward: Inward | None = None
