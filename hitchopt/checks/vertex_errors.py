"""Check ``vertex_error``: the largest error of a vertex at any rest, for errors of a stated size.

A rest is a time at which the hitch holds nothing, its cables have at least nine tenths of their
team's tensions, and no drone has a velocity or an acceleration. Errors are the worst case of
``team.errors``, as ``hitchopt.hitch.rest_errors`` bounds it: the position loops hold the planned
pulls, and errors of cables, drones and friction are independent and as large as stated. The swing
that earlier motion leaves is added, as estimated by ``hitchopt.checks.swing``.
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from hitchopt.checks.rule import ReportRule, SpanResults, WorstCase
from hitchopt.checks.swing import swings_at_rests
from hitchopt.hitch.rest_errors import KINDS, ErrorSizes, planned_rest, vertex_errors
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.values import Array

AT_REST = 1e-6  # [m/s], [m/s²] Largest velocity and acceleration at rest
BEFORE = 1e-9  # [s] Time before the end of a piece at which it is evaluated
SAME_PLACE = 1e-6  # [m] Largest distance of drones at rests that are evaluated once


class RestErrors(NamedTuple):
    """Errors of vertices at a rest."""

    time: float  # [s] Time of the rest
    radii: Array  # (points,) [m], largest distances of vertices from their planned positions
    parts: Array  # (points, 3) [m], contributions of cables, drones and friction, to first order
    swing: Array  # (points,) [m], contributions of what still swings


def states_at_rests(motion: Motion) -> States | None:
    """Return the states at all rests of a hitch that holds nothing, one for each position.

    Rests are sought at the ends of pieces: motions from rest to rest are joined there. None without
    a rest; times start at the motion's start.
    """
    if not motion.team.has_cables:
        return None
    loaded = np.any(motion.load_share.coefficients != 0.0, axis=(1, 2))
    empty = motion.formed & ~motion.holding & ~loaded
    if not np.any(empty):
        return None
    breaks = motion.drones.breaks
    ends = np.column_stack([breaks[:-1], breaks[1:] - BEFORE])[empty]
    states = states_at(motion, ends.ravel() - breaks[0])
    rates = np.stack([states.velocities, states.accelerations])
    at_rest = np.max(np.abs(rates), axis=(0, 2, 3)) <= AT_REST
    at_rest &= states.taut(motion.team.tension)
    rests = list[int]()
    for sample in np.flatnonzero(at_rest).tolist():
        offsets = np.abs(states.positions[rests] - states.positions[sample])
        if np.all(np.max(offsets, axis=(1, 2)) > SAME_PLACE):
            rests.append(sample)
    return states[rests] if rests else None


_ERRORS: WeakKeyDictionary[Motion, list[RestErrors]] = WeakKeyDictionary()
"""Errors that this process has computed."""


def errors_at_rests(motion: Motion) -> list[RestErrors]:
    """Return the errors of vertices at every rest, in order of time; computed only once."""
    if motion not in _ERRORS:
        sizes = ErrorSizes.of(motion.team, motion.requirements.limits.tracking)
        _ERRORS[motion] = errors_of_sizes(motion, sizes)
    return _ERRORS[motion]


def errors_of_sizes(motion: Motion, sizes: ErrorSizes) -> list[RestErrors]:
    """Return the errors of vertices at every rest for errors of other sizes than the team's."""
    states = states_at_rests(motion)
    if states is None:
        return []
    rests = planned_rest(
        motion.team, states.positions, states.vertices, states.tensions, states.cable_forces
    )
    errors = vertex_errors(motion.team, rests, sizes)
    times = motion.drones.breaks[0] + states.t
    swing = swings_at_rests(motion, times)
    of_rests = zip(times.tolist(), errors.radii + swing, errors.parts, swing, strict=True)
    return [RestErrors(*of_rest) for of_rest in of_rests]


def _worst_vertex(motion: Motion) -> tuple[RestErrors, int] | None:
    """Return the rest with the largest error, and its vertex; None without a rest."""
    rests = errors_at_rests(motion)
    if not rests:
        return None
    worst = max(rests, key=lambda rest: float(np.max(rest.radii)))
    return worst, int(np.argmax(worst.radii))


def _largest_error(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase | None:
    """Return the largest error [m]; None if the hitch never rests without a load."""
    worst = _worst_vertex(motion)
    if worst is None:
        return None
    rest, vertex = worst
    return WorstCase(float(rest.radii[vertex]), rest.time, (motion.team.point_names[vertex],))


def error_in_words(motion: Motion) -> str:
    """Return the largest error at rest with its contributions in words; empty without a rest."""
    worst = _worst_vertex(motion)
    if worst is None:
        return ""
    rest, vertex = worst
    name = motion.team.point_names[vertex]
    radius = 100.0 * float(rest.radii[vertex])  # [cm]
    if not np.isfinite(radius):
        return f"{name}: no equilibrium was found for errors as large as team.errors"
    parts = dict(zip(KINDS, (100.0 * rest.parts[vertex]).tolist(), strict=True))
    parts["swing"] = 100.0 * float(rest.swing[vertex])
    parts["higher-order terms"] = radius - sum(parts.values())
    causes = ", ".join(f"{x:.2g} cm from {kind}" for kind, x in parts.items() if x > 0.0)
    return f"vertex error: up to {radius:.3g} cm, at {name}, t = {rest.time:.4g} s ({causes})"


VERTEX_ERROR = ReportRule(
    "vertex_error",
    "m",
    "max",
    _largest_error,
    limit=lambda requirements: requirements.limits.vertex_error,
    remedy="place drones more accurately (hitchopt calibrate), choose polygons with wider angles, "
    "or lower team.errors to what was measured",
    free_remedy="",
    assumes_gamma=False,
    group="distances",
    key="limits.vertex_error",
    proves="the largest error [m] of a vertex at rest, in the worst case of `team.errors`, and the "
    "swing that is left there",
    unproven="objects, integrals; second order and swing are estimated",
)
