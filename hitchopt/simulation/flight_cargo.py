"""Objects of a simulated flight: where the plan has them, and what may touch them when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

ALOFT = 0.03
"""Height over the places where it stood and will stand from which on an object is aloft [m]."""

CARRIED = 1.0 - 1e-6
"""Share of its weight from which on a hitch carries all of an object."""


@dataclass(frozen=True, eq=False)
class Cargo:
    """Objects, and where the plan has them at the samples of a task.

    Attributes
    ----------
    objects: by name.
    poses: (samples, objects, 5): x, y, z of their bases [m], cosine and sine of their yaws.
    held: whether the hitch holds them, such that its cables may touch them (samples, objects).
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
        """Return the objects of a plan at times ``t`` (samples,) [s] from its start."""
        objects = motion.requirements.objects
        times = np.clip(t, *motion.drones.breaks[[0, -1]])
        held = np.zeros((len(times), len(objects)), dtype=np.bool_)
        names = list(objects)
        for phase in motion.phases:
            if phase.hold is not None:
                during = (times >= phase.start) & (times <= phase.end)
                held[during, names.index(phase.hold.object)] = True
        poses, borne = motion.object_poses.at(times), motion.object_shares.at(times)
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
        last, following = _last_true(rests), _last_true(rests[::-1])[::-1]
        following = np.where(following >= 0, len(heights) - 1 - following, -1)
        columns = np.arange(heights.shape[1])
        supports = [
            np.where(rows >= 0, heights[rows, columns], -np.inf) for rows in (last, following)
        ]
        return ~rests & (heights > np.maximum(*supports) + ALOFT)


def _last_true(flags: Flags) -> NDArray[np.intp]:
    """Return the last row up to each one in which a flag is true (rows, columns), or -1."""
    rows = np.where(flags, np.arange(len(flags))[:, None], -1)
    return np.maximum.accumulate(rows, axis=0)
