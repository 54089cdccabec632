"""Largest norms of derivatives: what speed, acceleration, jerk and vertex_speed have in common."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.rounding_margins import derivative_margin
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Extremum, largest
from hitchopt.values import Array


def rate_rule(
    name: str, unit: str, order: int, *, vertices: bool = False, exported: bool = False
) -> CheckRule:
    """Return the rule that holds a derivative of drones, or of vertices, against ``Limits.name``.

    Of acceleration and jerk, plans use the share ``Limits.reserve``.

    Parameters
    ----------
    name, unit: of the check; its limit has the same name.
    order: of the derivative by time.
    vertices: whether vertices are checked, while the hitch exists, instead of drones.
    exported: whether exported curves are checked too.
    """

    def find(motion: Motion, limit: float) -> Finding:
        part, names = (
            (motion.vertices, motion.team.point_names)
            if vertices
            else (motion.drones, motion.team.drone_names)
        )
        found = largest_rate(part, order, limit)
        return Finding(found.worst, found.time, (names[found.item],), 0.0)

    def limit_of(motion: Motion) -> float:
        limit: float = getattr(motion.requirements.limits.planned, name)
        return limit

    states = HITCHED_STATE if vertices else frozenset(CableState)
    finder = Finder(find, states, exported)
    remedy = f"raise limits.{name}"
    return CheckRule(
        name, unit, "max", limit_of, (finder,), remedy, ease=Ease.TIME, derivative=order
    )


def largest_rate(part: PiecewisePolynomial, order: int, limit: float = np.inf) -> Extremum:
    """Return the largest norm of a derivative by time of points ``part`` (items, 3).

    It is bounded as closely as it takes to tell whether it satisfies the limit.
    A norm is convex, so it is largest at one of the Bernstein coefficients: nothing is squared.
    """
    derivative = part.differentiated(order)
    cells = Cells.over(part.breaks, [derivative.coefficients], derivative_margin(part, order))
    return largest(cells, norm_bound, within(limit, "max", 0.0, 0.5))


def norm_bound(blocks: tuple[Array, ...]) -> Estimate:
    """Bound the norm of vectors from above: one block (cells, d, degree + 1)."""
    (vectors,) = blocks
    order = bernstein.degree(vectors)
    norms = column_lengths(vectors)
    index = np.argmax(norms, axis=-1)
    value = length(bernstein.evaluate_at(vectors, index[:, None], order))
    return Estimate(np.max(norms, axis=-1), value, index / max(1, order))
