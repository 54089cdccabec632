"""Whether a path can be flown at all: a hitch everywhere, and drones that can hold it at rest."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length
from hitchopt.hitch.layout import Layout
from hitchopt.planners.path.shape_path import Path, Shapes, shapes_along
from hitchopt.planners.timing.fly_path import GRID, timing_demands
from hitchopt.planners.timing.speed_profile import path_grid
from hitchopt.requirements import Limits
from hitchopt.values import Array

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
