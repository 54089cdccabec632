"""Leg laws along a path (its slack split over s) that keep distances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask
from hitchopt.planners.path import LegLaw, Path, Shapes, shapes_along
from hitchopt.planners.timing.profile import flight_estimates
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.trajectory.splines import interpolated
from hitchopt.values import Array

PATH_SAMPLES = 65  # Number of sampled points of the path; the certificate bounds all of it

REFINEMENTS = ((9, 1.005), (17, 1.005), (17, 1.02), (33, 1.002), (33, 1.01))
"""Numbers of knots at which leg lengths are optimised, and margins of distances and legs there."""

SAMPLE_MARGIN = 1.0 + 0.5 * (LIMIT_MARGIN - 1.0)
"""Margin of a law's distances at all samples: half of LIMIT_MARGIN, which applies to legs at rest,
and more than the certificate's tolerance."""

MARGIN_RAMP = 3.0
"""Number of knots over which the margin rises from SAMPLE_MARGIN, since ends have LIMIT_MARGIN."""

ROUGHNESS_WEIGHT = 1.0
"""[m²] Weight of second differences of fractions between knots relative to deviations of legs."""

SLIDING_TOLERANCE = 1e-6  # [m] Change of legs below which a cable keeps its law


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


ROLLS = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 45.0))
"""[rad] Rolls to which legs rise on a path. Simulated clasps hold up to 60°."""

ROLL_RAMPS = (0.5, 0.3, 0.15)  # Parts of a path on which legs roll at either end
ROLL_KNOTS = 33  # Number of knots of the roll along a path


def rolling_paths(path: Path, requirements: Requirements, *, at_rest: bool = False) -> list[Path]:
    """Return the path with legs that roll between its ends and keep all distances, fastest first.

    Legs pass above each other as they roll. Leg lengths are those of the path's law, or have
    fractions that are linear from end to end. ``at_rest`` is that of ``with_legs_clear``.
    """
    laws = path.legs, _linear_fractions(path, at_rest=at_rest)
    rolled = [
        replace(path, roll=_raised_roll(path, roll, ramp, at_rest=at_rest), legs=legs)
        for roll in ROLLS
        for ramp in ROLL_RAMPS
        for legs in laws
    ]
    paths = [each for each in rolled if legs_clear(each, requirements)]
    if not paths:
        return []
    order = np.argsort(flight_estimates(paths, requirements.limits), kind="stable")
    return [paths[index] for index in order]


def _raised_roll(path: Path, angle: float, part: float, *, at_rest: bool) -> PiecewisePolynomial:
    """Return the roll (clasps,) over s that rises to an angle [rad] on a part at either end."""
    s = np.linspace(0.0, 1.0, ROLL_KNOTS)[:, None]
    first, last = np.zeros((2, len(path.team.layout.clasps)))
    if path.roll is not None:
        first, last = path.roll.at(np.array([0.0, 1.0]))
    side = -1.0 if np.sum(first) + np.sum(last) < 0.0 else 1.0
    linear = first + s * (last - first)
    ramp = np.minimum(np.minimum(s, 1.0 - s) / part, 1.0)
    progress = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    rise = np.maximum(angle - side * linear, 0.0)
    roll = linear + side * progress * rise
    return interpolated(s[:, 0], roll, zero_orders=(1, 2) if at_rest else ())


def largest_roll(path: Path) -> float:
    """Return the largest roll of a leg at samples of a path [rad]."""
    roll = path.shapes(np.linspace(0.0, 1.0, PATH_SAMPLES)).roll
    return 0.0 if roll is None else float(np.max(np.abs(roll)))


def _linear_fractions(path: Path, *, at_rest: bool) -> LegLaw:
    """Return the law of fractions that change evenly from one end of a path to the other."""
    legs = shapes_along(path, np.array([0.0, 1.0])).legs
    fractions = legs[..., 0] / np.sum(legs, axis=-1)
    shares = np.repeat([0.0, 1.0], 3 if at_rest else 1)
    coefficients = fractions[0][:, None] + np.diff(fractions, axis=0)[0][:, None] * shares
    unit = np.array([0.0, 1.0])
    return LegLaw.of_fractions(PiecewisePolynomial(unit, coefficients[None]))


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
