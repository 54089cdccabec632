"""Laws by which leg lengths change along a path so that distances hold on all of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.hitch.leg_lengths import reference_margin, split_slack, split_slack_from
from hitchopt.hitch.leg_task import LIMIT_MARGIN, LegTask
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, Shapes, shapes_along
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

PROBES = 65
"""Number of points of the path at which a law is tried, before the certificate verifies it all."""

MARGIN = 1.005
"""Factor on the limits of distances at knots, for what is between them."""

ROUNDS = ((9, MARGIN), (17, MARGIN), (17, 1.02), (33, 1.002), (33, 1.01))
"""Numbers of points of the path at which leg lengths are chosen, and the margins there."""

ONE_SIDED = ((17, 1.02), (33, 1.02))
"""The same for laws on which drones pass each other on one side."""

STEEP = 0.8
"""Slope of a cable's fraction by the path's parameter from which on it may jump between knots."""

CLEAR = 1.0 + 0.5 * (LIMIT_MARGIN - 1.0)
"""Factor on the limits that a law's distances must satisfy at all probes: half of what LIMIT_MARGIN
gives to legs at rest, and more than the certificate's tolerance."""

RAMP = 3.0
"""Number of knots in which the margin rises from CLEAR: the ends may have only LIMIT_MARGIN."""

ROUGHNESS = 1.0
"""[m²] Weight of a bend of the fractions between knots relative to a deviation of the legs."""


def with_legs_clear(path: ShapePath, requirements: Requirements) -> ShapePath:
    """Return the path with legs such that distances hold on all of it.

    The path's own law is used where its distances hold. Else legs that are rolled at an end are
    rolled more half way; else leg lengths are chosen at knots, all at once, nearest to that law's,
    or else, where legs are rolled, on one side of what they jump across.
    Where none is found the path is returned as it is, for the certificate to report what it breaks.
    """
    if legs_clear(path, requirements):
        return path
    laws = laws_nearby(path, requirements, ROUNDS, requirements.limits.leg, CLEAR)
    tried = chain(rolled_more(path), laws, one_sided_laws(path, requirements))
    return next((found for found in tried if legs_clear(found, requirements)), path)


def laws_nearby(
    path: ShapePath,
    requirements: Requirements,
    rounds: Sequence[tuple[int, float]],
    shortest_leg: float,
    least: float,
    *,
    at_rest: bool = False,
) -> Iterator[ShapePath]:
    """Yield the path with other laws of the legs, closer to their limits from round to round.

    Ends early where no leg lengths at the knots have a margin of ``least``.

    Parameters
    ----------
    rounds: numbers of knots, and margins there; towards the ends less, which are given already.
    shortest_leg: [m], at the knots.
    at_rest: whether the fractions start and end at rest, as where s is time.
    """
    for count, margin in rounds:
        task = replace(_task_at(path, requirements, count, margin), shortest_leg=shortest_leg)
        found = split_slack(task)
        if found.margin < least:
            return
        yield _with_fractions(path, found.q_legs / task.slack, at_rest=at_rest)


def one_sided_laws(path: ShapePath, requirements: Requirements) -> Iterator[ShapePath]:
    """Yield the path with laws on which drones pass each other on one side, the nearest law first.

    Leg lengths of neighbouring knots may lie on two sides of what they avoid. They are followed
    from knot to knot, from either end. None where no law is steep, nor where legs are level, whose
    routes the optimiser finds.
    """
    for count, margin in ONE_SIDED if path.roll is not None else ():
        task = _task_at(path, requirements, count, margin)
        found = split_slack(task)
        slopes = count * np.diff(found.q_legs / task.slack, axis=0)
        if found.margin < CLEAR or float(np.max(np.abs(slopes))) < STEEP:
            return
        knots = range(1, count - 1)
        sides = [split_slack_from(task, _followed(task, each)) for each in (knots, knots[::-1])]
        for side in sorted(sides, key=lambda each: each.deviation):
            if side.margin >= CLEAR:
                yield _with_fractions(path, side.q_legs / task.slack)


def _followed(task: LegTask, knots: range) -> Array:
    """Return leg lengths (J, n) [m] of which each knot's are near those of the knot before it."""
    fractions, step = task.reference / task.slack, knots.step
    for j in knots:
        one = slice(j, j + 1)
        roll = None if task.roll is None else task.roll[one]
        near = replace(task, polygons=task.polygons[one], margin=task.margins[one], fixed=None)
        near = replace(near, reference=fractions[j - step] * near.slack, roll=roll)
        fractions[j] = (split_slack_from(near, near.reference).q_legs / near.slack)[0]
    return fractions * task.slack


def _task_at(path: ShapePath, requirements: Requirements, count: int, margin: float) -> LegTask:
    """Return the task of choosing leg lengths at knots, towards the path's ends of less margin."""
    inward = np.minimum(np.arange(count), np.arange(count)[::-1]) / RAMP
    margins = CLEAR + (margin - CLEAR) * np.minimum(inward, 1.0)
    return leg_task_along(path, requirements, np.linspace(0.0, 1.0, count), margins)


def _with_fractions(path: ShapePath, fractions: Array, *, at_rest: bool = False) -> ShapePath:
    """Return the path with a spline through fractions (J, n) at evenly spaced knots."""
    still = np.zeros(fractions.shape[1])
    rest = [(1, still), (2, still)]  # the stubs know of one condition an end, scipy of any
    ends, s = (rest, rest) if at_rest else None, np.linspace(0.0, 1.0, len(fractions))
    spline = make_interp_spline(s, fractions, k=5, bc_type=ends)  # type: ignore[arg-type]
    return replace(path, legs=LegLaw.of_fractions(PiecewisePolynomial.from_spline(spline)))


def legs_clear(path: ShapePath, requirements: Requirements) -> bool:
    """Return whether legs are long enough and distances hold at the probes."""
    s = np.linspace(0.0, 1.0, PROBES)
    shapes = shapes_along(path, s)
    legs = shapes.legs[:, path.team.layout.has_leg]
    # The ends are given; whether they hold is reported apart from the path.
    long_enough = float(np.min(legs[1:-1])) >= requirements.limits.leg
    return long_enough and reference_margin(leg_task_of(path, requirements, shapes, CLEAR)) >= CLEAR


def leg_task_along(
    path: ShapePath, requirements: Requirements, s: Array, margin: float | Array
) -> LegTask:
    """Return the task of choosing leg lengths at the points s (J,) of a path, the ends fixed."""
    return leg_task_of(path, requirements, shapes_along(path, s), margin)


def leg_task_of(
    path: ShapePath, requirements: Requirements, shapes: Shapes, margin: float | Array
) -> LegTask:
    """Return the task of choosing leg lengths for shapes of a path, the first and last fixed."""
    fixed = np.zeros(len(shapes.legs), dtype=np.bool_)
    fixed[[0, -1]] = True
    wanted = (shapes.legs[..., 0], requirements.limits.leg, margin, ROUGHNESS, fixed, shapes.roll)
    return LegTask(path.team, requirements, shapes.polygons, *wanted)


RAISES = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0))
"""[rad] Rolls that are added half way, tried in turn."""

STEEPEST = math.radians(60.0)
"""[rad] Largest roll tried, up to which clasps hold in simulated ropes."""

DEGREE = 2


def rolled_more(path: ShapePath) -> Iterator[ShapePath]:
    """Yield the path with its legs rolled more half way; none where they are not rolled at all."""
    roll = path.roll
    if roll is None:
        return
    c = roll.coefficients
    order = max(DEGREE, bernstein.degree(c))
    sense = np.sign(c[..., 0] + c[..., -1])[..., None]
    lower, upper = roll.breaks[:-1], roll.breaks[1:]
    rise = bernstein.restrict(np.array([0.0, 2.0, 0.0]), lower, upper)[:, None]  # 4 s (1 - s)
    own, more = bernstein.elevate(c, order), bernstein.elevate(rise, order)
    for angle in RAISES:
        if float(np.max(np.abs(own))) + angle > STEEPEST:
            return
        yield replace(path, roll=PiecewisePolynomial(roll.breaks, own + angle * sense * more))
