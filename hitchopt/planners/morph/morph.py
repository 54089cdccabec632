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
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.jets import quintic_spline
from hitchopt.planners.morph.legs import with_legs_clear
from hitchopt.planners.morph.path import LegLaw, Path, ShapePath, Shapes, drones_along, shapes_along
from hitchopt.planners.timing.flight import GRID, fly
from hitchopt.planners.timing.profile import check_hover, demands_along, path_grid
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SAME = 1e-9
"""[m] What is no farther from its other place than this is at rest there."""


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
    def problem(self) -> ShapePath:
        """The path that is timed.

        Raises InfeasibleError where the polygon loses its convexity, or a leg or the thrust at rest
        gives out.
        """
        straight = ShapePath.straight(self.start, self.end)
        check_shapes(straight)
        path = with_legs_clear(straight, self.requirements)
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> Motion | None:
        """Return the motion, or None where the hitches are the same.

        Raises
        ------
        InfeasibleError: as ``problem``, or ``duration`` is too short.
        TimingError: no timing was found.
        """
        if np.max(np.abs(self.end.drones - self.start.drones)) < SAME:
            return None
        return fly(self.problem, self.requirements, self.duration)


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
        narrowest = math.degrees(float(np.min(angles)))
        when = f"from {s[first]:.0%} of the path on"
        remedy = "the straight path is blocked: go by a polygon in between, in two morphs"
        where, least = (f"p{layout.clasps[k]}",), math.degrees(FLATTEST)
        flat = Violation("convexity", narrowest, least, "min", "deg", where, when, remedy)
        raise InfeasibleError([flat])
    legs = np.where(layout.has_leg, shapes.legs, np.inf)
    if np.min(legs) < SHORTEST_LEG:
        j, at, end = np.unravel_index(int(np.argmin(legs)), legs.shape)
        left = legs[j, at][layout.has_leg[at]].sum()
        name, shortest = f"{'qr'[end]}{at}", float(legs[j, at, end])
        when, remedy = f"at {s[j]:.0%} of the path", f"cable {at} leaves {left:.6g} m there"
        short = Violation("legs", shortest, SHORTEST_LEG, "min", "m", (name,), when, remedy)
        raise InfeasibleError([short])


def check_loads(path: Path, limits: Limits) -> None:
    """Raise InfeasibleError where hovering against the pull alone breaks a limit on the path.

    At the points at which the path is timed.
    """
    when = [f"at rest, {s:.0%} of the path on" for s in path_grid(GRID)]
    thrust, tilt = "give the drone more thrust", "allow more tilt, or use heavier drones"
    remedies = f"{thrust}, or lower team.tension", f"{tilt}, or lower team.tension"
    check_hover(path.team, limits, demands_along(path, limits, GRID).loads, when, remedies)


FINE = 2001
"""Number of points by which the lengths of path and flight are compared."""

SLOWEST = 1e-6
"""Share of a path's mean speed by its parameter below which it cannot be timed."""


@dataclass(frozen=True, eq=False)
class BlendedMorph:
    """The planner of a flight through hitches without a stop.

    Vertices, fractions and roll are natural quintic splines: of all curves through the hitches
    those with the least third derivative. Their parameter is nearly the distance of the farthest
    drone.

    Attributes
    ----------
    hitches: (J,), three or more, no two neighbours of them the same.
    requirements: limits of motion.
    """

    hitches: Sequence[Hitch]
    requirements: Requirements

    @property
    def places(self) -> Array:
        """(J,): the parameter of the path at the hitches, from 0 to 1."""
        drones = np.stack([hitch.drones for hitch in self.hitches])
        steps = np.max(np.linalg.norm(np.diff(drones, axis=0), axis=-1), axis=1)
        s = np.append(0.0, np.cumsum(np.maximum(steps, SAME)))
        places: Array = s / s[-1]
        return places

    @cached_property
    def problem(self) -> ShapePath:
        """The path that is timed; raises InfeasibleError as a straight morph, or where it stops."""
        vertices, fractions, roll = (
            PiecewisePolynomial.from_spline(quintic_spline(self.places, np.stack(values), (3, 4)))
            for values in zip(
                *((h.vertices, h.fractions, h.roll) for h in self.hitches), strict=True
            )
        )
        rolled, legs = roll if np.any(roll.coefficients) else None, LegLaw.of_fractions(fractions)
        path = ShapePath(self.hitches[0].team, vertices, legs, roll=rolled)
        check_shapes(path)
        grid = np.linspace(0.0, 1.0, GRID + 1)
        speed = np.max(length(drones_along(path, grid).positions[..., 1]), axis=1)
        slowest, ratio = int(np.argmin(speed)), float(np.min(speed) / np.mean(speed))
        if ratio < SLOWEST:
            unit, when = "of the mean speed", f"at {grid[slowest]:.0%} of the path"
            remedy = "the path turns back on itself there: go by another one"
            broken = Violation("blend", ratio, SLOWEST, "min", unit, (), when, remedy)
            raise InfeasibleError([broken])
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> tuple[Motion, Array]:
        """Return the motion, and when (J - 2,) [s] it is at the inner hitches.

        Raises InfeasibleError as ``problem``, or TimingError where no timing was found.
        """
        path = self.problem
        motion = fly(path, self.requirements)
        # The distance that vertices and fractions have covered is the same on path and flight.
        t, fine = np.linspace(0.0, motion.duration, FINE), np.linspace(0.0, 1.0, FINE)
        legs = motion.legs.at(t)
        by_s = _travelled_share(path.vertices.at(fine), path.legs.share.at(fine))
        by_t = _travelled_share(motion.vertices.at(t), legs[..., 0] / np.sum(legs, axis=-1))
        times: Array = np.interp(np.interp(self.places[1:-1], fine, by_s), by_t, t)
        return motion, times


def _travelled_share(vertices: Array, fractions: Array) -> Array:
    """Return (J,): share of the distance covered so far in all coordinates together."""
    rows = np.concatenate([vertices.reshape(len(vertices), -1), fractions], axis=1)
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1)))
    share: Array = travelled / travelled[-1]
    return share
