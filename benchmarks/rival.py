"""What all rivals share: what they come back with, and flat outputs sampled through the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.samples import Sampler, Samples
from benchmarks.tasks import Task
from hitchopt.model.evaluation import FlatJets, drone_jets
from hitchopt.model.robot import JET

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a rival comes back with.

    Attributes
    ----------
    duration: [s]
    sample: the motion.
    """

    duration: float
    sample: Sampler


class RivalError(Exception):
    """The rival's solver says that it has not succeeded."""


def straight_time(task: Task) -> float:
    """Return a duration in which the straight way can be flown with ease [s]."""
    farthest = np.max(np.linalg.norm(task.end.drones - task.start.drones, axis=-1))
    return 2.0 + 4.0 * float(farthest)


def flat_ends(task: Task) -> tuple[Array, Array]:
    """Return the flat outputs (3n,) at both ends: vertices x, y, x, y, …, then q-legs [m]."""
    first, last = (
        np.concatenate([hitch.vertices[:, :2].ravel(), hitch.q_legs])
        for hitch in (task.start, task.end)
    )
    return first, last


def flat_sampler(task: Task, flat: Callable[[Array], Array]) -> Sampler:
    """Return the sampler of flat outputs: ``flat(t)`` are their jets by time (J, 3n, JET)."""
    n = task.robots

    def sample(t: Array) -> Samples:
        jets = flat(t)
        vertices = np.zeros((len(t), n, 3, JET))
        vertices[:, :, :2] = jets[:, : 2 * n].reshape(len(t), n, 2, JET)
        vertices[:, :, 2, 0] = task.start.altitude
        tensions = np.zeros((len(t), n, JET))
        tensions[..., 0] = task.start.team.tension
        flat_jets = FlatJets(vertices, jets[:, 2 * n :], tensions)
        drones = drone_jets(task.start.team, flat_jets).positions
        x, v, a, j = (drones[..., order] for order in range(JET))
        return Samples(x, v, a, j, vertices[..., 0], vertices[..., 1])

    return sample
