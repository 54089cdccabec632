"""Stretches in time with which motions keep their limits, between samples too.

Of the limits of which clocks and programs have rows, rates are enclosed, not sampled: a vector
polynomial is in the convex hull of its coefficients, which are close to it on a short span of time.
Every other limit that slower motion keeps is evaluated by the formula of its record, so that a new
record is planned for without a line here. What slower motion does not keep is not here: distances.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from hitchopt.checks.registry import RULES
from hitchopt.checks.rule import CheckRule
from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.hitch import Team
from hitchopt.hitch.forces import cable_forces
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.motion import Motion
from hitchopt.planners.timing.profile import (
    FINAL_SHARE,
    Demands,
    loads_at_rest,
    spare_accelerations,
)
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array, Indices

IN_ROWS = frozenset({"speed", "acceleration", "jerk", "vertex_speed"})
"""Limits of which clocks and programs have rows."""

SLOWED = tuple(rule for rule in RULES if rule.ease == "time" and rule.name not in IN_ROWS)
"""Further limits that slower motion keeps."""

SPANS = 8  # Number of spans of a piece. They enclose rates to within about 0.1 %.
SPAN_COEFFICIENTS = 8  # Number of coefficients on each span, as of the drones' septic pieces

FORCE_STRETCH_SHARE = 0.9
"""Estimated stretch for forces, over that for rates, below which it is not computed."""

CHUNK = 60_000  # Number of coefficients of drones per chunk
MAX_STRETCH = 1e6  # Largest stretch of the search
STRETCH_TOLERANCE = 1e-4  # Relative tolerance of a stretch
ROUNDING = 1e-9  # Relative difference of rates within which they may be equal


def needed_stretch(motion: Motion) -> float:
    """Return the stretch in time with which a hitched motion satisfies its limits."""
    team = motion.team
    limits = motion.requirements.limits
    drones = motion.drones
    factor = _rate_stretch(motion)
    critical = np.flatnonzero(_force_stretches(motion) > FORCE_STRETCH_SHARE * factor)
    no_vertices = np.zeros(0)
    for chunk in _chunks(team, critical):
        jets = np.stack([_on_spans(drones, chunk, order) for order in range(4)], axis=-1)
        forces = np.zeros(jets.shape[:-1])
        if team.has_cables:
            points = _on_spans(motion.pull_points, chunk)
            pulls = _on_spans(motion.pulls, chunk)
            forces = cable_forces(team, jets[..., 0], points, pulls, np.ones(team.robots))
        loads = loads_at_rest(team, forces)
        demands = Demands(jets, no_vertices, loads, team, limits, FINAL_SHARE)
        factor = max(factor, float(np.max(demands.stretches())))
    return further_stretch(motion, factor)


def further_stretch(motion: Motion, smallest: float = 1.0) -> float:
    """Return the stretch in time, at least ``smallest``, with which a motion keeps ``SLOWED``.

    It is infinite if the search fails.
    """
    factor = smallest
    for rule in SLOWED:
        if rule.limit_of(motion) is not None:
            factor = _stretch_by_record(motion, rule, factor)
    return factor


def _stretch_by_record(motion: Motion, rule: CheckRule, smallest: float) -> float:
    """Return the stretch in time, at least ``smallest``, with which a motion keeps a limit.

    A quantity of the k-th time derivative decreases with at most the k-th power of the stretch, so
    that the search approaches the answer from below.
    """
    factor = smallest
    while math.isfinite(factor):
        with rough_bounds():
            check = rule.check(motion.slowed(factor))
        if check is None or check.worst <= FINAL_SHARE * check.number:
            break
        excess = check.worst / (FINAL_SHARE * check.number)
        step = (1.0 + STRETCH_TOLERANCE) * math.pow(excess, 1.0 / rule.derivative)
        factor = factor * step if factor < MAX_STRETCH else math.inf
    return factor


def jerk_peaks(motion: Motion, limits: Limits) -> Array:
    """Return the largest enclosed jerk on each piece (pieces,) over its limit."""
    peaks = [
        length(_on_spans(motion.drones, chunk, 3)).reshape(len(chunk), -1).max(axis=1)
        for chunk in _chunks(motion.team, np.arange(motion.drones.pieces))
    ]
    return np.concatenate(peaks) / (FINAL_SHARE * limits.jerk)


def _rate_stretch(motion: Motion) -> float:
    """Return the stretch in time with which speeds, accelerations and jerks keep their limits.

    Spans are computed of the pieces whose own coefficients exceed a rate attained elsewhere.
    """
    limits = motion.requirements.limits
    bounds = (
        (motion.inner_ends.reshaped(-1, 3), 1, limits.vertex_speed),
        (motion.drones, 1, limits.speed),
        (motion.drones, 2, limits.acceleration),
        (motion.drones, 3, limits.jerk),
    )
    factor = 1e-12  # of motions at rest
    for points, order, limit in bounds:
        allowed = FINAL_SHARE * limit
        sizes = column_lengths(points.differentiated(order).coefficients).max(axis=1, initial=0.0)
        attained = max(float(np.max(sizes[:, [0, -1]])), allowed * factor**order)
        critical = np.flatnonzero(sizes.max(axis=1) >= (1.0 - ROUNDING) * attained)
        for chunk in _chunks(motion.team, critical):
            rate = float(np.max(length(_on_spans(points, chunk, order)), initial=0.0))
            factor = max(factor, (rate / allowed) ** (1.0 / order))
    return factor


def _force_stretches(motion: Motion) -> Array:
    """Return estimates of upper bounds of each piece's stretch (pieces,) for thrust and tilt.

    Accelerations have the worst direction, and forces at rest are those at the breakpoints.
    """
    team = motion.team
    drones = motion.drones
    forces = np.zeros((drones.pieces + 1, team.drones, 3))
    if team.has_cables:
        forces = cable_forces(
            team,
            _at_breaks(drones),
            _at_breaks(motion.pull_points),
            _at_breaks(motion.pulls),
            np.ones((len(forces), team.robots)),
        )
    limits = motion.requirements.limits
    spare = spare_accelerations(team, limits, loads_at_rest(team, forces))
    spare = np.maximum(spare, 1e-9)  # not zero: it divides
    second = bernstein.differentiate(bernstein.differentiate(drones.coefficients))
    accelerations = column_lengths(second).max(axis=-1) / drones.durations[:, None] ** 2
    ratios = accelerations / np.minimum(spare[1:], spare[:-1])
    return np.asarray(np.sqrt(ratios.max(axis=1)))


def _at_breaks(part: PiecewisePolynomial) -> Array:
    """Return the values (pieces + 1, *shape) at the breakpoints."""
    coefficients = part.coefficients
    return np.concatenate([coefficients[..., 0], coefficients[-1:, ..., -1]])


def _chunks(team: Team, pieces: Indices) -> Iterator[Indices]:
    """Yield the pieces of a flight in chunks of bounded size."""
    size = max(1, CHUNK // (SPANS * SPAN_COEFFICIENTS * team.drones))
    return (pieces[first : first + size] for first in range(0, len(pieces), size))


def by_piece(values: Array) -> Array:
    """Return values (pieces, *shape, samples) as (pieces, samples, *shape)."""
    return values.transpose(0, -1, *range(1, values.ndim - 1))


def _on_spans(part: PiecewisePolynomial, pieces: Indices, order: int = 0) -> Array:
    """Return enclosing values of a time derivative (pieces · SPANS · SPAN_COEFFICIENTS, *shape).

    They are coefficients on the spans of pieces; values and higher degrees are sampled instead.
    """
    of_pieces = part.coefficients[pieces]
    to_spans = _span_rows(bernstein.degree(of_pieces), order)
    of_spans = by_piece(bernstein.transform(of_pieces, to_spans))
    durations = part.durations[pieces].reshape(-1, *(1,) * (of_spans.ndim - 1))
    values: Array = (of_spans / durations**order).reshape(-1, *part.shape)
    return values


@lru_cache
def _span_rows(degree: int, order: int) -> Array:
    """Return the map (SPANS · SPAN_COEFFICIENTS, degree + 1) from a piece to its spans."""
    derivatives = np.eye(degree + 1)
    for _ in range(order):
        derivatives = bernstein.differentiate(derivatives)
    starts = np.arange(SPANS) / SPANS
    if order == 0 or bernstein.degree(derivatives) >= SPAN_COEFFICIENTS:
        samples = starts[:, None] + np.linspace(0.0, 1.0 / SPANS, SPAN_COEFFICIENTS)
        basis = bernstein.basis(samples.ravel(), bernstein.degree(derivatives))
        rows = (derivatives @ basis.T).T
    else:
        elevated = bernstein.elevate(derivatives, SPAN_COEFFICIENTS - 1)[:, None]
        rows = bernstein.restrict(elevated, starts, starts + 1.0 / SPANS)
        rows = rows.reshape(degree + 1, -1).T
    rows.setflags(write=False)
    return rows
