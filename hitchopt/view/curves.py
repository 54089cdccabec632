"""Samples over time of what the pictures of a plan show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.values import Array

POINTS = 150_000
"""Number of drone positions that a picture is drawn from; they take about a second."""

MIN_SAMPLES, MAX_SAMPLES = 60, 600
"""Number of times; more are finer than a picture's pixels."""

ROUNDING = 1e-9
"""Relative and absolute margin of a bound of scaled distances."""


@dataclass(frozen=True, eq=False)
class Curves:
    """The team's worst values over time.

    Attributes
    ----------
    states: the states at all times (samples,).
    separation: smallest ratio over all pairs of drones (samples,).
    speed: speed of the fastest drone (samples,) [m/s].
    thrust: largest thrust as a share of the drone's limit (samples,).
    """

    states: States
    separation: Array
    speed: Array
    thrust: Array

    @property
    def t(self) -> Array:
        """Times since the plan's start (samples,) [s]."""
        return self.states.t


def sampled_curves(motion: Motion) -> Curves:
    """Return the curves at times that include the joints of the plan's pieces."""
    drones = len(motion.team.drone_names)
    samples = int(np.clip(POINTS // drones, MIN_SAMPLES, MAX_SAMPLES))
    even = np.linspace(0.0, motion.duration, samples)
    joints = motion.drones.breaks - motion.drones.breaks[0]
    few = joints if len(joints) < samples else joints[:0]
    states = states_at(motion, np.unique(np.minimum(np.concatenate([even, few]), even[-1])))
    thrusts = np.linalg.norm(states.thrusts(motion.team), axis=-1)
    return Curves(
        states,
        smallest_separations(states.positions, motion.requirements.separation.scale),
        np.max(np.linalg.norm(states.velocities, axis=-1), axis=-1),
        np.max(thrusts / motion.team.max_thrust, axis=-1),
    )


def smallest_separations(positions: Array, scale: Array) -> Array:
    """Return the smallest distance of two drones after scaling (samples,).

    One search covers all times: time is a fourth coordinate, scaled so that every nearest neighbour
    belongs to the same time.

    Parameters
    ----------
    positions: drone positions (samples, drones, 3) [m]; a single drone has no neighbour (inf).
    scale: factor of every axis (3,) [1/m].
    """
    scaled = positions * scale
    samples, drones, _ = scaled.shape
    if drones == 1:
        return np.full(samples, np.inf)
    apart = 1.0 + 2.0 * float(np.linalg.norm(np.ptp(scaled, axis=(0, 1))))
    sheets = np.repeat(apart * np.arange(samples), drones)
    points = np.column_stack([scaled.reshape(-1, 3), sheets])
    # No smallest distance is above the largest of those along the drones' order.
    along = np.linalg.norm(np.diff(scaled, axis=1), axis=-1)
    bound = float(np.max(np.min(along, axis=1))) * (1.0 + ROUNDING) + ROUNDING
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances = np.asarray(tree.query(points, k=[2], distance_upper_bound=bound)[0])
    smallest: Array = np.min(distances.reshape(samples, drones), axis=1)
    return smallest
