"""Worst values of written trajectories, for all t: what exports and lint ask of the checks.

No other module of exports knows how a check bounds its quantity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF, RULES
from hitchopt.checks.rule import CheckRule
from hitchopt.checks.spans import ROUNDING
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed

FLOWN = tuple(rule for rule in RULES if any(finder.exported for finder in rule.finders))
"""Rules of the checks of what is flown, as they are listed."""

LINES = tuple(rule for rule in FLOWN if rule.derivative <= 1)
"""Rules for drones that fly along lines: velocities jump where they meet."""

PLACES = tuple(RULE_OF[name] for name in ("separation", "cable_clearance", "keep_out", "arena"))
"""Rules for set points that hold a tension. They are not where the drones are, of which the plan's
certificate says everything; but a drone whose cable breaks or goes slack flies there."""

ACROSS, UP, DOWN = 0, 1, -1  # Directions in which vectors count; z is up


DISTANCE = "minDistance"  # Key of the smallest distance between two drones [m]

OWN_LIMITS: dict[str, tuple[int, str, tuple[int, ...]]] = {
    "maxAltitude": (0, "m", (UP,)),
    "maxVelocityXY": (1, "m/s", (ACROSS,)),
    "maxVelocityZ": (1, "m/s", (UP, DOWN)),
    "maxVelocityZUp": (1, "m/s", (UP,)),
    "maxAccelerationXY": (2, "m/s²", (ACROSS,)),
    "maxAccelerationZ": (2, "m/s²", (UP, DOWN)),
    "maxAccelerationZUp": (2, "m/s²", (UP,)),
    DISTANCE: (0, "m", ()),
}
"""Limits that shows set themselves, as Skybrush's validation panel checks them: derivative by time,
unit, and directions in which the quantity counts; none for the distance of pairs."""


class Worst(NamedTuple):
    """A bound for all t, where it is about attained, and by which drone."""

    value: float
    time: float  # [s]
    drone: int


def written_checks(motion: Motion, rules: Sequence[CheckRule] = FLOWN) -> list[Check | None]:
    """Return what the rules say of a motion whose drones were read from files, rule by rule."""
    return [rule.check(motion, exported=True) for rule in rules]


def drone_check(name: str, curves: PiecewisePolynomial, asked: Requirements) -> Check | None:
    """Return a check of drones alone on their curves (D, 3) [m]; they are named d0, d1, …."""
    return RULE_OF[name].check(Motion.single(Swarm(curves.shape[0]), asked, curves, ()))


def worst_of(checks: Sequence[Check | None]) -> Check | None:
    """Return the check of one name that is closest to its limit, or farthest beyond it."""
    return most_pressing(checks)


def eased_by_slowing(name: str) -> bool:
    """Return whether a slower flight eases a check."""
    return RULE_OF[name].derivative > 0


def largest_derivative(curves: PiecewisePolynomial, order: int) -> float:
    """Return a bound on the size of a derivative of curves (D, 3)."""
    return largest_rate(curves, order).worst


def largest_distance(one: PiecewisePolynomial, other: PiecewisePolynomial) -> tuple[Worst, Worst]:
    """Return how far curves (D, 3) on the same breaks are apart, in position and in velocity."""
    degree = max(one.degree, other.degree)
    a = bernstein.elevate(one.coefficients, degree)
    b = bernstein.elevate(other.coefficients, degree)
    apart = PiecewisePolynomial(one.breaks, a - b)
    margin = ROUNDING * float(np.max(np.abs(b)))
    place, rate = largest_rate(apart, 0), largest_rate(apart, 1)
    near = Worst(place.worst + margin, place.time, place.item)
    return near, Worst(rate.worst, rate.time, rate.item)


def largest_along(curves: PiecewisePolynomial, order: int, direction: int) -> Worst:
    """Return the largest derivative across, up or down of curves (D, 3)."""

    def size(rate: Enclosed) -> Bound:
        return rate.level.norm_above if direction == ACROSS else (rate[2] * direction).above

    found = largest_rate(curves, order, size=size)
    return Worst(found.worst, found.time, found.item)
