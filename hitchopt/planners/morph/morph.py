"""Morphs: one hitch to another along straight vertex paths, or through several without a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.team import Layout
from hitchopt.planners.morph.jets import quintic_spline
from hitchopt.planners.morph.legs import with_legs_clear
from hitchopt.planners.morph.path import LegLaw, Path, ShapePath, Shapes, drones_along, shapes_along
from hitchopt.planners.timing.flight import GRID, Flight, fly, timing_demands
from hitchopt.planners.timing.profile import path_grid
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

STILL = 1e-9
"""[m] Distance within which a morph moves nothing."""


@dataclass(frozen=True, eq=False)
class StraightMorph:
    """The planner of a morph on which vertices go straight.

    Legs change so that distances hold on the path. Whether all limits hold for all t is for the
    certificate to say.

    Attributes
    ----------
    start, end: the hitches before and after.
    requirements: limits and distances.
    duration: exactly that long [s]; None for as fast as the limits allow.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    duration: float | None = None

    @cached_property
    def path(self) -> ShapePath:
        """The straight path, fractions changing evenly; raises InfeasibleError where it is shut."""
        path = ShapePath.straight(self.start, self.end)
        check_shapes(path)
        return path

    @cached_property
    def problem(self) -> ShapePath:
        """The path that is timed.

        Raises InfeasibleError where the polygon loses its convexity, or a leg or the thrust at rest
        gives out.
        """
        path = with_legs_clear(self.path, self.requirements)
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> Flight | None:
        """Return the flight from one hitch to the other, or None where they are the same.

        Raises
        ------
        InfeasibleError: as ``problem``, or ``duration`` is too short.
        TimingError: no timing was found.
        """
        if np.max(np.abs(self.end.drones - self.start.drones)) < STILL:
            return None
        return fly(self.problem, self.requirements.limits, self.duration)


FLATTEST = math.radians(0.01)
"""[rad] Smallest exterior angle on a path: at a flatter vertex the clasp's bisector is lost."""

SHORTEST_EDGE = 1e-3
"""[m] Shortest edge on a path: a shorter one has no accurate direction."""

SHORTEST_LEG = 1e-3
"""[m] Shortest leg on a path: a shorter one has no accurate direction."""

PROBES = 401
"""Number of points of the path at which its shapes are checked before timing."""


def exterior_angles(layout: Layout, edges: Array) -> Array:
    """Return the angles (…, clasps) [rad] by which edges (…, n, 2) turn right at each clasp."""
    ahead, behind = edges[..., layout.ahead, :], edges[..., layout.behind, :]
    right = behind[..., 1] * ahead[..., 0] - behind[..., 0] * ahead[..., 1]
    angles: Array = np.arctan2(right, np.sum(behind * ahead, axis=-1))
    return angles


def check_shapes(path: Path) -> None:
    """Raise InfeasibleError where the path has no hitch to fly."""
    s = np.linspace(0.0, 1.0, PROBES)
    check_shapes_at(s, shapes_along(path, s), path.team.layout)


def check_shapes_at(s: Array, shapes: Shapes, layout: Layout) -> None:
    """Raise InfeasibleError where one of the shapes at s (J,) of a path is no hitch to fly."""
    edges = layout.edges(shapes.polygons)
    lengths = length(edges)
    shorter = np.minimum(lengths[:, layout.ahead], lengths[:, layout.behind])
    # A point has no corners.
    angles = np.where(shorter < SHORTEST_EDGE, 0.0, exterior_angles(layout, edges))
    if np.min(angles) < FLATTEST:
        k = int(np.argmin(np.min(angles, axis=0)))
        first = int(np.argmax(angles[:, k] < FLATTEST))
        found = math.degrees(float(np.min(angles)))
        when = f"from {s[first]:.0%} of the path on"
        remedy = "the straight path is blocked: go by a polygon in between, in two morphs"
        where, least = (f"p{layout.clasps[k]}",), math.degrees(FLATTEST)
        flat = Violation("convexity", found, least, "min", "deg", where, when, remedy)
        raise InfeasibleError([flat])
    legs = np.where(layout.has_leg, shapes.legs, np.inf)
    if np.min(legs) < SHORTEST_LEG:
        j, at, end = np.unravel_index(int(np.argmin(legs)), legs.shape)
        left = legs[j, at][layout.has_leg[at]].sum()
        name, found = f"{'qr'[end]}{at}", float(legs[j, at, end])
        when, remedy = f"at {s[j]:.0%} of the path", f"cable {at} leaves {left:.6g} m there"
        short = Violation("legs", found, SHORTEST_LEG, "min", "m", (name,), when, remedy)
        raise InfeasibleError([short])


def check_loads(path: Path, limits: Limits) -> None:
    """Raise InfeasibleError where hovering against the pull alone breaks a limit on the path.

    At the points at which the path is timed.
    """
    s, demands = path_grid(GRID), timing_demands(path, limits)
    thrust, tilt = demands.at_rest()
    most_tilt = np.full(len(path.team.mass), math.degrees(limits.tilt))
    for name, unit, ratios, most, remedy in (
        ("thrust", "N", thrust, demands.max_thrust, "give the drone more thrust"),
        ("tilt", "deg", tilt, most_tilt, "allow more tilt, or use heavier drones"),
    ):
        j, i = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
        if ratios[j, i] >= demands.share:
            found, limit = float(ratios[j, i] * most[i]), float(demands.share * most[i])
            reserved = f"{1.0 - demands.share:.1%} of it being reserved to move by"
            when = f"at rest, {s[j]:.0%} of the path on, {reserved}"
            where, eased = (path.team.drone_names[i],), f"{remedy}, or lower team.tension"
            raise InfeasibleError([Violation(name, found, limit, "max", unit, where, when, eased)])


FINE = 2001
"""Number of points by which the lengths of path and flight are compared."""

SLOWEST = 1e-6
"""Share of a path's mean speed by its parameter below which it cannot be timed."""

SAME = 1e-9
"""[m] Hitches in a row that are closer than this are one."""


@dataclass(frozen=True, eq=False)
class BlendedPath:
    """A path and where on it each of its hitches is.

    Attributes
    ----------
    path: through all hitches, smooth up to the snap.
    s: (J,), from 0 to 1.
    """

    path: ShapePath
    s: Array


@dataclass(frozen=True, eq=False)
class BlendedMorph:
    """The planner of a morph through several hitches without a stop.

    Attributes
    ----------
    hitches: three or more, no two neighbours of them the same.
    requirements: limits of motion.
    """

    hitches: Sequence[Hitch]
    requirements: Requirements

    @cached_property
    def problem(self) -> BlendedPath:
        """The path through all hitches; raises InfeasibleError where it cannot be flown."""
        blend = blended(self.hitches)
        check_shapes(blend.path)
        check_turns(blend)
        check_loads(blend.path, self.requirements.limits)
        return blend

    def solve(self) -> Flight:
        """Return the flight along the path; errors as of StraightMorph."""
        return fly(self.problem.path, self.requirements.limits)


def blended(hitches: Sequence[Hitch]) -> BlendedPath:
    """Return the path through three hitches or more, no two neighbours of them the same.

    Vertices, fractions and roll are natural quintic splines: of all curves through the hitches
    those with the least third derivative. Their parameter is nearly the distance of the farthest
    drone.
    """
    places = np.stack([hitch.drones for hitch in hitches])
    steps = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=1)
    s = np.append(0.0, np.cumsum(np.maximum(steps, SAME)))
    s = s / s[-1]
    vertices, fractions, roll = (
        PiecewisePolynomial.from_spline(quintic_spline(s, np.stack(values), (3, 4)))
        for values in zip(*((h.vertices, h.fractions, h.roll) for h in hitches), strict=True)
    )
    rolled = roll if np.any(roll.coefficients) else None
    return BlendedPath(
        ShapePath(hitches[0].team, vertices, LegLaw.of_fractions(fractions), roll=rolled), s
    )


def check_turns(blend: BlendedPath) -> None:
    """Raise InfeasibleError where the path turns back on itself at a point of the timing grid."""
    s = np.linspace(0.0, 1.0, GRID + 1)
    drones = drones_along(blend.path, s).positions[..., 1]
    speed = np.max(np.linalg.norm(drones, axis=-1), axis=1)
    slowest = int(np.argmin(speed))
    ratio = float(speed[slowest] / np.mean(speed))
    if ratio < SLOWEST:
        unit, when = "of the mean speed", f"at {s[slowest]:.0%} of the path"
        remedy = "the path turns back on itself there: go by another one"
        raise InfeasibleError([Violation("blend", ratio, SLOWEST, "min", unit, (), when, remedy)])


def passing_times(path: ShapePath, s: Array, flight: Flight) -> Array:
    """Return when (J,) [s] a flight along a path is at the inner points s (J,) of it.

    The distance that vertices and drones have covered together is the same on path and flight.
    """
    t = np.linspace(0.0, flight.duration, FINE)
    fine = np.linspace(0.0, 1.0, FINE)
    flown = flight.legs.at(t)
    gone_by_s = _gone(path.vertices.at(fine), path.legs.share.at(fine))
    gone_by_t = _gone(flight.vertices.at(t), flown[..., 0] / np.sum(flown, axis=-1))
    share = np.interp(s, fine, gone_by_s / gone_by_s[-1])
    times: Array = np.interp(share, gone_by_t / gone_by_t[-1], t)
    return times


def _gone(vertices: Array, fractions: Array) -> Array:
    """Return (J,): distance covered so far in all coordinates together."""
    rows = np.concatenate([vertices.reshape(len(vertices), -1), fractions], axis=1)
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1)))
