"""Laws by which leg lengths change along a path: so that distances hold, or drones start gently."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask, reference_margin, split_slack
from hitchopt.planners.morph.jets import quintic_spline
from hitchopt.planners.morph.path import LegLaw, ShapePath, Shapes, drones_along, shapes_along
from hitchopt.planners.timing.profile import demands_along, flight_estimate
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array

PROBES = 65
"""Number of points of the path at which a law is tried, before the certificate verifies it all."""

REFINEMENTS = ((9, 1.005), (17, 1.005), (17, 1.02), (33, 1.002), (33, 1.01))
"""Numbers of points of the path at which leg lengths are chosen, and the margins of distances and
legs there."""

CLEAR = 1.0 + 0.5 * (LIMIT_MARGIN - 1.0)
"""Factor on the limits that a law's distances must satisfy at all probes: half of what LIMIT_MARGIN
gives to legs at rest, and more than the certificate's tolerance."""

RAMP = 3.0
"""Number of knots in which the margin rises from CLEAR: the ends may have only LIMIT_MARGIN."""

ROUGHNESS = 1.0
"""[m²] Weight of a bend of the fractions between knots relative to a deviation of the legs."""

SLIDES = 1e-6
"""[m] A cable whose legs would change by less keeps them exactly."""


def with_legs_clear(
    path: ShapePath, requirements: Requirements, *, few: bool = False, at_rest: bool = False
) -> ShapePath:
    """Return the path with legs such that distances hold on all of it.

    The path's own law is used where its distances hold. Else leg lengths are chosen at knots, all
    at once, nearest to that law's.
    Where none is found the path is returned as it is, for the certificate to report what it breaks.

    Parameters
    ----------
    few: keep the law of all cables that need not slide.
    at_rest: whether cables have to start and end at rest, as where s is time.
    """
    if legs_clear(path, requirements):
        return path
    for candidate in _laws_nearby(path, requirements, at_rest):
        for law in (_few_sliding(path, candidate), candidate) if few else (candidate,):
            if legs_clear(law, requirements):
                return law
    return path


def _laws_nearby(path: ShapePath, requirements: Requirements, at_rest: bool) -> Iterator[ShapePath]:
    """Yield the path with other laws of the legs, closer to their limits from round to round.

    Ends early where no leg lengths at the knots are clear.
    """
    for count, margin in REFINEMENTS:
        s = np.linspace(0.0, 1.0, count)
        inward = np.minimum(np.arange(count), np.arange(count)[::-1]) / RAMP
        margins = CLEAR + (margin - CLEAR) * np.minimum(inward, 1.0)
        task = leg_task_along(path, requirements, s, margins)
        split = split_slack(replace(task, shortest_leg=margin * requirements.limits.leg))
        if split.margin < CLEAR:
            return
        fractions = split.q_legs / task.slack
        rest = quintic_spline(s, fractions, (1, 2)) if at_rest else None
        spline = rest or make_interp_spline(s, fractions, k=5)
        law = LegLaw.of_fractions(PiecewisePolynomial.from_spline(spline))
        yield replace(path, legs=law)


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


def _few_sliding(path: ShapePath, changed: ShapePath) -> ShapePath:
    """Return the changed path with the given path's law for all cables that hardly slide."""
    s = np.linspace(0.0, 1.0, PROBES)
    away = np.abs(shapes_along(changed, s).legs - shapes_along(path, s).legs)
    slides = np.max(away, axis=(0, 2)) > SLIDES
    breaks = changed.legs.share.breaks

    def chosen(new: PiecewisePolynomial, old: PiecewisePolynomial) -> PiecewisePolynomial:
        order = max(new.degree, old.degree)
        one, other = (on_breaks(p, breaks).elevated(order).coefficients for p in (new, old))
        return PiecewisePolynomial(breaks, np.where(slides[:, None], one, other))

    lengths = chosen(changed.legs.length, path.legs.length)
    return replace(path, legs=LegLaw(lengths, chosen(changed.legs.share, path.legs.share)))


def worst_place(path: ShapePath, requirements: Requirements) -> float:
    """Return s where the path's law comes closest to its limits or breaks them."""
    s = np.linspace(0.0, 1.0, PROBES)[1:-1]
    legs = shapes_along(path, s).legs[:, path.team.layout.has_leg]
    shortest = np.min(legs, axis=1) / requirements.limits.leg
    apart = [
        reference_margin(leg_task_along(path, requirements, s[j : j + 1], CLEAR))
        for j in range(len(s))
    ]
    return float(s[int(np.argmin(np.minimum(shortest, apart)))])


DEGREE = 3

SHARES = (1.0, 0.75, 0.5)
"""Shares of the slide that leaves drones the least to do: it costs speed in between."""

GAIN = 0.995
"""Largest share of the path's own estimate that another one may take to be worth flying."""


def leading(path: ShapePath, limits: Limits) -> Iterator[ShapePath]:
    """Yield a path of the same vertices with a shorter estimate; mostly none.

    Vertices have a limit of speed, drones one of acceleration besides. Cables that slide while
    their vertices speed up leave the drones behind for a while: the vertices are at full speed
    earlier. The slide is a cubic of s that is zero at both ends; its slopes there leave the two
    drones of each cable the least to do.
    Neither its distances nor its duration are verified here.
    """
    if path.legs.length.pieces > 1:
        return
    slopes = _slopes(path, limits)
    slid = (_slid(path, share * slopes) for share in SHARES)
    best = min(slid, key=lambda each: flight_estimate(each, limits))
    if flight_estimate(best, limits) < GAIN * flight_estimate(path, limits):
        yield best


def _slopes(path: ShapePath, limits: Limits) -> Array:
    """Return the slides' slopes (2, n) [m] at s = 0 and 1 that slow the drones most there.

    A drone's derivative by s is linear in its leg's, which moves it along the leg.
    """
    ends, n = np.array([0.0, 1.0]), path.team.robots
    usual = demands_along(path, limits).drones[[0, -1], ..., 1].reshape(2, n, 2, -1)
    slid = drones_along(_slid(path, np.ones((2, n))), ends)
    along = slid.positions[..., 1].reshape(2, n, 2, -1) - usual
    size = np.sum(along**2, axis=(2, 3))
    slopes: Array = -np.sum(usual * along, axis=(2, 3)) / np.where(size > 0.0, size, np.inf)
    return slopes


def _slid(path: ShapePath, slopes: Array) -> ShapePath:
    """Return the path with its legs slid, with slopes (2, n) at its ends."""
    law = path.legs.length.coefficients[0]
    slide = np.zeros((path.team.robots, DEGREE + 1))
    slide[:, 1], slide[:, -2] = slopes[0] / DEGREE, -slopes[1] / DEGREE
    order = max(DEGREE, bernstein.degree(law))
    length = bernstein.elevate(law, order) + bernstein.elevate(slide, order)
    legs = LegLaw(PiecewisePolynomial(np.array([0.0, 1.0]), length[None]), path.legs.share)
    return replace(path, legs=legs)
