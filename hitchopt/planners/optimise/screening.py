"""Which guesses are worth the optimiser's time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_lengths import reference_margin
from hitchopt.hitch.leg_task import LegTask
from hitchopt.planners.optimise.knot_path import Way
from hitchopt.requirements import Requirements

Array = NDArray[np.float64]

CLOSEST = 0.3
"""A guess whose distances fall below this share of their limits is not worth a try."""

SHARPEST_LOSS = 0.1
"""Share of a polygon's smallest exterior angle and shortest edge that a guess has to keep."""

WIDEST = 1.05
"""Largest margin that any round asks for; larger ones need not be told apart."""

SAME = 0.05
"""[m] Ways that differ by less at every knot are one."""


def sound(way: Way) -> bool:
    """Return whether a guess is a hitch all the way: convex, with edges, legs and slack."""
    edges = np.roll(way.polygons, -1, axis=1) - way.polygons
    lengths = np.linalg.norm(edges, axis=-1)
    behind = np.roll(edges, 1, axis=1)
    right = behind[..., 1] * edges[..., 0] - behind[..., 0] * edges[..., 1]
    angles = np.arctan2(right, np.sum(behind * edges, axis=-1))
    ends = np.minimum(angles[0].min(), angles[-1].min())
    shortest = np.minimum(lengths[0].min(), lengths[-1].min())
    return bool(
        np.min(way.slack) > 0.0
        and np.min(angles) > SHARPEST_LOSS * ends
        and np.min(lengths) > SHARPEST_LOSS * shortest
    )


def loose(way: Way, requirements: Requirements) -> bool:
    """Return whether a way's bodies are not all in one heap."""
    return _measured(way.team, way.polygons, way.q_legs, requirements) >= CLOSEST


def end_margin(hitch: Hitch, requirements: Requirements) -> float:
    """Return how many times their limits a hitch keeps its distances."""
    polygon, q_legs = hitch.polygon.vertices[None], hitch.q_legs[None]
    return _measured(hitch.team, polygon, q_legs, requirements) * (1.0 - 1e-4)


def same(way: Way, other: Way) -> bool:
    """Return whether two guesses have come to one and the same way."""
    if len(way.polygons) != len(other.polygons):
        other = other.resampled(len(way.polygons))
    apart = max(
        float(np.max(np.abs(way.polygons - other.polygons))),
        float(np.max(np.abs(way.q_legs - other.q_legs))),
    )
    return apart < SAME


def _measured(team: Team, polygons: Array, q_legs: Array, requirements: Requirements) -> float:
    return reference_margin(
        LegTask(team, replace(requirements, arena=None), polygons, q_legs, 0.0, WIDEST)
    )
