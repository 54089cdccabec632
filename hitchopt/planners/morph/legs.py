"""Leg laws along a path that keep distances, or reduce the motion of drones at its ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask
from hitchopt.planners.morph.path import LegLaw, Path, Shapes, drones_along, shapes_along
from hitchopt.planners.timing.profile import demands_along, flight_estimate, flight_estimates
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.trajectory.splines import interpolated
from hitchopt.values import Array

PATH_SAMPLES = 65
"""Number of sampled points of the path; the certificate bounds all of it."""

REFINEMENTS = ((9, 1.005), (17, 1.005), (17, 1.02), (33, 1.002), (33, 1.01))
"""Numbers of knots at which leg lengths are optimised, and margins of distances and legs there."""

SAMPLE_MARGIN = 1.0 + 0.5 * (LIMIT_MARGIN - 1.0)
"""Margin of a law's distances at all samples: half of LIMIT_MARGIN, which applies to legs at rest,
and more than the certificate's tolerance."""

MARGIN_RAMP = 3.0
"""Number of knots over which the margin rises from SAMPLE_MARGIN, since ends have LIMIT_MARGIN."""

ROUGHNESS_WEIGHT = 1.0
"""[m²] Weight of second differences of fractions between knots relative to deviations of legs."""

SLIDING_TOLERANCE = 1e-6
"""[m] Change of legs below which a cable keeps its law."""


def with_legs_clear(
    path: Path, requirements: Requirements, *, few: bool = False, at_rest: bool = False
) -> Path:
    """Return the path with a leg law that keeps all distances.

    If the path's own law does not, leg lengths are optimised at knots, all at once, with the
    smallest deviation from that law. If none is feasible the path is returned unchanged, and the
    certificate reports its violations.

    Parameters
    ----------
    few: whether cables that need not slide keep their law.
    at_rest: whether cables start and end at rest, required if s is time.
    """
    if legs_clear(path, requirements):
        return path
    for candidate in _nearby_laws(path, requirements, at_rest):
        if few:
            fewer = _few_sliding(path, candidate)
            if legs_clear(fewer, requirements):
                return fewer
        if legs_clear(candidate, requirements):
            return candidate
    return path


def _nearby_laws(path: Path, requirements: Requirements, at_rest: bool) -> Iterator[Path]:
    """Yield the path with other leg laws, one per refinement, until leg lengths are infeasible."""
    for count, margin in REFINEMENTS:
        s = np.linspace(0.0, 1.0, count)
        knots_to_end = np.minimum(np.arange(count), np.arange(count)[::-1])
        ramp = knots_to_end / MARGIN_RAMP
        margins = SAMPLE_MARGIN + (margin - SAMPLE_MARGIN) * np.minimum(ramp, 1.0)
        task = leg_task_along(path, requirements, s, margins)
        split = replace(task, shortest_leg=margin * requirements.limits.leg).split()
        if split.margin < SAMPLE_MARGIN:
            return
        fractions = split.q_legs / task.slack
        spline = interpolated(s, fractions, zero_orders=(1, 2) if at_rest else ())
        yield replace(path, legs=LegLaw.of_fractions(spline))


def legs_clear(path: Path, requirements: Requirements) -> bool:
    """Return whether legs are long enough and distances hold at samples of the path."""
    s = np.linspace(0.0, 1.0, PATH_SAMPLES)
    shapes = shapes_along(path, s)
    legs = shapes.legs[:, path.team.layout.has_leg]
    # The ends are prescribed and checked separately.
    if float(np.min(legs[1:-1])) < requirements.limits.leg:
        return False
    task = leg_task_of(path, requirements, shapes, SAMPLE_MARGIN)
    return task.reference_margin() >= SAMPLE_MARGIN


def leg_task_along(
    path: Path, requirements: Requirements, s: Array, margin: float | Array
) -> LegTask:
    """Return the leg task at points s (J,) of a path, with fixed ends."""
    return leg_task_of(path, requirements, shapes_along(path, s), margin)


def leg_task_of(
    path: Path, requirements: Requirements, shapes: Shapes, margin: float | Array
) -> LegTask:
    """Return the leg task of shapes of a path, of which the first and the last are fixed."""
    fixed = np.zeros(len(shapes.legs), dtype=np.bool_)
    fixed[[0, -1]] = True
    return LegTask(
        path.team,
        requirements,
        polygons=shapes.polygons,
        reference=shapes.legs[..., 0],
        shortest_leg=requirements.limits.leg,
        margin=margin,
        roughness=ROUGHNESS_WEIGHT,
        fixed=fixed,
        roll=shapes.roll,
    )


def _few_sliding(path: Path, candidate: Path) -> Path:
    """Return the candidate with the law of the path for all cables that hardly slide."""
    s = np.linspace(0.0, 1.0, PATH_SAMPLES)
    changes = np.abs(shapes_along(candidate, s).legs - shapes_along(path, s).legs)
    slides = np.max(changes, axis=(0, 2)) > SLIDING_TOLERANCE
    breaks = candidate.legs.share.breaks

    def merged(new: PiecewisePolynomial, old: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return the new curves (n,) of cables that slide, and the old ones of others."""
        order = max(new.degree, old.degree)
        sliding = on_breaks(new, breaks).elevated(order).coefficients
        constant = on_breaks(old, breaks).elevated(order).coefficients
        return PiecewisePolynomial(breaks, np.where(slides[:, None], sliding, constant))

    lengths = merged(candidate.legs.length, path.legs.length)
    return replace(path, legs=LegLaw(lengths, merged(candidate.legs.share, path.legs.share)))


def worst_point(path: Path, requirements: Requirements) -> float:
    """Return s with the smallest margin of the path's law."""
    s = np.linspace(0.0, 1.0, PATH_SAMPLES)[1:-1]
    legs = shapes_along(path, s).legs[:, path.team.layout.has_leg]
    shortest = np.min(legs, axis=1) / requirements.limits.leg
    margins = [
        leg_task_along(path, requirements, s[j : j + 1], SAMPLE_MARGIN).reference_margin()
        for j in range(len(s))
    ]
    return float(s[int(np.argmin(np.minimum(shortest, margins)))])


DEGREE = 3
"""Degree of slides in s."""

SHARES = (1.0, 0.75, 0.5)
"""Candidate shares of the slide that minimises the drones' motion at the ends, since it costs speed
between."""

MAX_DURATION_RATIO = 0.995
"""Largest estimated duration of a path with slides over that of the original path."""


def with_slides(path: Path, limits: Limits) -> Iterator[Path]:
    """Yield a path with the same vertices and a shorter estimated duration, if there is one.

    Speed limits bound vertices, while acceleration limits bound drones too. If cables slide while
    their vertices speed up, the drones lag for a while and vertices reach full speed earlier. The
    slide is a cubic of s that is zero at both ends; its slopes there minimise the motion of the two
    drones of each cable. Distances and duration are not verified.
    """
    if path.legs.length.pieces > 1:
        return
    slopes = _slopes(path, limits)
    candidates = [_with_slide(path, share * slopes) for share in SHARES]
    estimates = flight_estimates(candidates, limits)
    shortest = min(estimates)
    if shortest < MAX_DURATION_RATIO * flight_estimate(path, limits):
        yield candidates[estimates.index(shortest)]


def _slopes(path: Path, limits: Limits) -> Array:
    """Return the slides' slopes (2, n) [m] at s = 0 and 1 that minimise the drones' derivatives.

    The derivative of a drone by s is linear in that of its leg, along the leg.
    """
    robots = path.team.robots
    original = demands_along(path, limits).drones[[0, -1], ..., 1].reshape(2, robots, 2, -1)
    sliding = _with_slide(path, np.ones((2, robots)))
    slid = drones_along(sliding, np.array([0.0, 1.0])).positions[..., 1]
    along = slid.reshape(2, robots, 2, -1) - original
    squares = np.sum(along**2, axis=(2, 3))
    products = np.sum(original * along, axis=(2, 3))
    return np.asarray(-products / np.where(squares > 0.0, squares, np.inf))


def _with_slide(path: Path, slopes: Array) -> Path:
    """Return the path with a slide of its legs, with slopes (2, n) [m] at the ends."""
    law = path.legs.length.coefficients[0]
    slide = np.zeros((path.team.robots, DEGREE + 1))
    slide[:, 1] = slopes[0] / DEGREE
    slide[:, -2] = -slopes[1] / DEGREE
    order = max(DEGREE, bernstein.degree(law))
    length = bernstein.elevate(law, order) + bernstein.elevate(slide, order)
    legs = LegLaw(PiecewisePolynomial(np.array([0.0, 1.0]), length[None]), path.legs.share)
    return replace(path, legs=legs)
