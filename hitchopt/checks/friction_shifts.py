"""Check ``friction_shift``: how far less friction than the largest moves vertices off their ways.

Legs lean against the largest friction of ``team.cable_friction``. With less of it they rest ahead
of their plan, mostly on their ways, on which they keep all distances. The farthest from these is
the rest with the least friction of the range, since rests depend almost linearly on it. It is
sampled. Where no leg leans, as in over-travels, friction holds vertices back on their ways.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hitchopt.checks.certificate import SAMPLED
from hitchopt.checks.rule import ReportRule, SpanResults, WorstCase
from hitchopt.checks.spans import phase_parts
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.rest_errors import bends_at, planned_rest, settled
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import states_at
from hitchopt.values import Array

SAMPLES = 24
"""Number of samples of each phase."""

TINY = 1e-12
"""Smallest divisor."""


def _leans(motion: Motion) -> bool:
    """Return whether legs lean against friction."""
    return motion.team.has_cables and motion.team.friction > 0.0 and motion.leg_tensions_differ


def _largest_shift(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase | None:
    """Return the largest distance [m] from the ways; None if no leg leans against friction."""
    if not _leans(motion):
        return None
    return max(_shifts(motion), key=lambda shift: shift.worst, default=None)


def _shifts(motion: Motion) -> Iterator[WorstCase]:
    """Yield the largest distance [m] of each phase in which legs lean against friction."""
    hitched = frozenset({CableState.HITCHED})
    for part in phase_parts(motion):
        phase = part.motion
        if not phase.leg_tensions_differ or np.any(phase.holding):
            continue
        if not phase.cable_states <= hitched:
            continue
        t = np.linspace(0.0, phase.duration, SAMPLES)
        shifts = distances_from_ways(
            rests_with_least_friction(phase, t), states_at(phase, t).vertices
        )
        sample, vertex = np.unravel_index(int(np.argmax(shifts)), shifts.shape)
        time = float(motion.drones.breaks[part.pieces.start] + t[sample])
        yield WorstCase(float(shifts[sample, vertex]), time, (motion.team.point_names[vertex],))


def rests_with_least_friction(motion: Motion, t: Array) -> Array:
    """Return vertices (S, points, 3) [m] at rest with the least friction, at times t (S,) [s].

    Drones hold the planned pulls. Vertices are infinitely far without a rest.
    """
    team, states = motion.team, states_at(motion, t)
    rests = planned_rest(
        team, states.positions, states.vertices, states.tensions, states.cable_forces
    )
    pulls = motion.pulls.at(motion.drones.breaks[0] + t).reshape(*states.tensions.shape, 2)
    logarithms = np.log(pulls / states.tensions[..., None])
    share = team.least_friction / team.friction
    vertices = settled(
        team,
        rests,
        lengths=np.zeros(states.tensions.shape),
        offsets=np.zeros(states.positions.shape),
        friction=share * logarithms / np.maximum(bends_at(team, rests), TINY),
    )
    return np.where(np.isfinite(vertices), vertices, np.inf)


def distances_from_ways(places: Array, ways: Array) -> Array:
    """Return distances (S, points) [m] of places (S, points, 3) from ways (samples, points, 3)."""
    along = np.diff(ways, axis=0)
    offsets = places[:, None] - ways[:-1]
    shares = dot(offsets, along) / np.maximum(dot(along, along), TINY)
    nearest = np.clip(shares, 0.0, 1.0)[..., None] * along
    return np.asarray(np.min(length(offsets - nearest), axis=1))


def _allowed(requirements: Requirements) -> float | None:
    """Return the tracking error, which distances of vertices allow for [m]; None without one."""
    return requirements.limits.tube.level or requirements.position_error or None


FRICTION_SHIFT = ReportRule(
    "friction_shift",
    "m",
    "max",
    _largest_shift,
    limit=_allowed,
    remedy="state a larger least friction (cable_friction: [least, largest]), or move more slowly",
    free_remedy="",
    assumes_gamma=False,
    applies=_leans,
    group="distances",
    key="limits.tracking",
    method=SAMPLED,
    proves="the largest distance [m] from their ways at which vertices rest with the least "
    "friction where legs lean, at samples",
    unproven="times between samples, over-travels, swings, objects",
)
