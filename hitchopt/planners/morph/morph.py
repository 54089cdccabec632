"""Morphs from one hitch to another along straight vertex paths, or through several nonstop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.checks.certificate import Certificate
from hitchopt.checks.registry import distances_of
from hitchopt.checks.spans import value_cache
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import length, turn
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.model import drone_jets
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.morph.legs import with_legs_clear
from hitchopt.planners.path import FlatPath, LegLaw, Path, drones_along, shapes_along
from hitchopt.planners.timing.profile import demands_along, hover_violation, path_grid
from hitchopt.planners.timing.timed_motion import TIMING_GRID
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splines import interpolated
from hitchopt.values import Array

POSITION_TOLERANCE = 1e-9  # [m] Distance below which positions are equal


def moves(start: Hitch, end: Hitch) -> bool:
    """Return whether any drone moves from one hitch to another."""
    return bool(np.max(np.abs(end.drones - start.drones)) >= POSITION_TOLERANCE)


def straight_path(start: Hitch, end: Hitch, requirements: Requirements) -> Path:
    """Return the path with straight vertices between two hitches, to be timed.

    Leg lengths change so that distances hold at samples of the path; the certificate bounds all
    limits in continuous time.

    Raises InfeasibleError if the polygon loses its convexity, a leg vanishes, or forces at rest
    exceed limits.
    """
    path = clear_straight_path(start, end, requirements)
    check_loads(path, requirements.limits)
    return path


def clear_straight_path(start: Hitch, end: Hitch, requirements: Requirements) -> Path:
    """Return ``straight_path``, forces at rest unchecked."""
    straight = Path.straight(start, end)
    check_shapes(straight)
    return with_legs_clear(straight, requirements)


MIN_ANGLE = math.radians(0.01)
"""[rad] Smallest exterior angle on a path, below which the clasp's bisector is inaccurate."""

MIN_EDGE = 1e-3  # [m] Shortest edge on a path, below which its direction is inaccurate
MIN_LEG = 1e-3  # [m] Shortest leg on a path, below which its direction is inaccurate


def exterior_angles(layout: Layout, edges: Array) -> Array:
    """Return the right turns (…, clasps) [rad] of edges (…, n, 2) at each clasp."""
    return turn(edges[..., layout.ahead, :], edges[..., layout.behind, :])


def check_shapes(path: FlatPath) -> None:
    """Raise InfeasibleError if a polygon on the path is not convex, or an edge or leg vanishes."""
    violation = shape_violation(path)
    if violation is not None:
        raise InfeasibleError([violation])


ON_PATH = "of the path"  # Words for the path in descriptions of places on it


def shape_violation(path: FlatPath, on_path: str = ON_PATH) -> Violation | None:
    """Return the violation of a polygon that is not convex, or of an edge or leg that vanishes.

    ``on_path`` are the words for the path.
    """
    s = np.linspace(0.0, 1.0, 401)
    layout = path.team.layout
    shapes = shapes_along(path, s)
    edges = layout.edges(shapes.polygons)
    lengths = length(edges)
    shorter = np.minimum(lengths[:, layout.ahead], lengths[:, layout.behind])
    angles = np.where(shorter < MIN_EDGE, 0.0, exterior_angles(layout, edges))
    if np.min(angles) < MIN_ANGLE:
        return _flat_corner(layout, s, angles, on_path)
    legs = np.where(layout.has_leg, shapes.legs, np.inf)
    if np.min(legs) < MIN_LEG:
        return _short_leg(path.team, s, legs, on_path)
    return None


def _flat_corner(layout: Layout, s: Array, angles: Array, on_path: str) -> Violation:
    """Return the violation of the smallest exterior angle (J, clasps) [rad] at s (J,)."""
    clasp = int(np.argmin(np.min(angles, axis=0)))
    first = int(np.argmax(angles[:, clasp] < MIN_ANGLE))
    remedy = "move the vertex outward at an end, or turn the polygon by less"
    if np.all(angles[0] < 0.0):
        remedy = "list the points in the reverse order: they are counter-clockwise, seen from above"
    return Violation(
        "convexity",
        math.degrees(float(np.min(angles))),
        math.degrees(MIN_ANGLE),
        "min",
        "deg",
        (f"p{layout.clasps[clasp]}",),
        f"from {s[first]:.0%} {on_path}",
        remedy,
    )


def _short_leg(team: Team, s: Array, legs: Array, on_path: str) -> Violation:
    """Return the violation of the shortest leg (J, n, 2) [m] at s (J,), infinite without one."""
    sample, cable, end = np.unravel_index(int(np.argmin(legs)), legs.shape)
    remaining = legs[sample, cable][team.layout.has_leg[cable]].sum()
    return Violation(
        "legs",
        float(legs[sample, cable, end]),
        MIN_LEG,
        "min",
        "m",
        (team.drone_names[2 * cable + end],),
        f"at {s[sample]:.0%} {on_path}",
        f"{team.cable_names[cable]} leaves {remaining:.6g} m there",
    )


def check_loads(path: FlatPath, limits: Limits) -> None:
    """Raise InfeasibleError if hovering violates a limit at a point at which the path is timed."""
    violation = load_violation(path, limits)
    if violation is not None:
        raise InfeasibleError([violation])


def load_violation(path: FlatPath, limits: Limits, on_path: str = ON_PATH) -> Violation | None:
    """Return the violation of a limit by hovering at a point at which the path is timed.

    ``on_path`` are the words for the path.
    """
    when = [f"at rest at {s:.0%} {on_path}" for s in path_grid(TIMING_GRID)]
    remedies = (
        "use a drone with more thrust, or lower team.tension",
        "allow more tilt, or use heavier drones, or lower team.tension",
    )
    loads = demands_along(path, limits, TIMING_GRID).loads
    return hover_violation(path.team, limits, loads, when, remedies)


CHECKED_AT_SAMPLES = distances_of("drones", "cables", "vertices", "ground", "walls")
"""Checks of distances that neither another timing nor a detour around objects mends."""

DISTANCE_SAMPLES = 257  # Number of points of a path at which they are evaluated

DISTANCE_TOLERANCE = 2e-5
"""Largest violation, in the unit of its check, that is left to the certificate: motions pass
breakpoints of their paths exactly, and are less far from them in between."""


def check_distances(path: FlatPath, requirements: Requirements) -> None:
    """Raise InfeasibleError if a distance at samples of the path breaks its limit.

    Paths are sampled before they are timed, since timing and certificate take fifty times longer.
    The formulas are the certificate's, of a motion that rests at every sample.
    """
    samples = np.linspace(0.0, 1.0, DISTANCE_SAMPLES)
    flat = path.flat(samples, 1)
    drones = drone_jets(path.team, flat)
    legs = drones.legs * path.team.layout.has_leg[..., None]
    breaks = np.arange(DISTANCE_SAMPLES + 1.0)
    resting = Motion(
        path.team,
        requirements,
        drones=PiecewisePolynomial(breaks, drones.positions),
        vertices=PiecewisePolynomial(breaks, flat.vertices),
        legs=PiecewisePolynomial(breaks, legs),
        tensions=PiecewisePolynomial(breaks, flat.tensions),
        phases=(Phase("path", 0, 0.0, breaks[-1]),),
    )
    violations = list[Violation]()
    for rule in CHECKED_AT_SAMPLES:
        with value_cache():
            check = rule.check(resting)
        if check is None or check.limit is None:
            continue
        if check.limit - check.worst <= DISTANCE_TOLERANCE:
            continue
        place = samples[min(int(check.time), DISTANCE_SAMPLES - 1)]
        of_check = Certificate(resting.duration, (check,))
        violations += infeasible_error(of_check, resting, f"at {place:.0%} of the path").violations
    if violations:
        raise InfeasibleError(violations)


MIN_SPEED_RATIO = 1e-6
"""Smallest speed of a path in its parameter over the mean, below which it cannot be timed."""


@dataclass(frozen=True, eq=False)
class BlendedMorph:
    """A planner of flights through hitches without a stop.

    Vertices, fractions and roll are natural quintic splines, the curves through the hitches that
    minimise the third derivative. Their parameter is nearly the distance of the farthest drone.
    """

    start: Hitch  # The hitch at the start
    passed: Sequence[Sequence[Hitch]]  # Hitches of each step, each different from the next
    requirements: Requirements  # Limits of motion

    @cached_property
    def hitches(self) -> list[Hitch]:
        """All J hitches, three or more."""
        return [self.start, *(hitch for of_step in self.passed for hitch in of_step)]

    @cached_property
    def knots(self) -> Array:
        """(J,): path parameters of the hitches, from 0 to 1."""
        drones = np.stack([hitch.drones for hitch in self.hitches])
        steps = np.max(np.linalg.norm(np.diff(drones, axis=0), axis=-1), axis=1)
        s = np.append(0.0, np.cumsum(np.maximum(steps, POSITION_TOLERANCE)))
        knots: Array = s / s[-1]
        return knots

    @property
    def ends(self) -> Array:
        """(steps + 1,): path parameters at which the steps start and end."""
        last = np.cumsum([0, *(len(of_step) for of_step in self.passed)])
        return np.asarray(self.knots[last])

    def _spline(self, values: Sequence[Array]) -> PiecewisePolynomial:
        """Return the natural quintic spline through values at the knots."""
        return interpolated(self.knots, np.stack(values), zero_orders=(3, 4))

    @cached_property
    def path(self) -> Path:
        """The path to be timed.

        Raises InfeasibleError as for a straight morph, or if the path has a point of zero speed.
        """
        vertices = self._spline([hitch.vertices for hitch in self.hitches])
        fractions = self._spline([hitch.fractions for hitch in self.hitches])
        roll = self._spline([hitch.roll for hitch in self.hitches])
        path = Path(
            self.start.team,
            vertices,
            LegLaw.of_fractions(fractions),
            roll=roll if np.any(roll.coefficients) else None,
        )
        check_shapes(path)
        grid = np.linspace(0.0, 1.0, TIMING_GRID + 1)
        speed = np.max(length(drones_along(path, grid).positions[..., 1]), axis=1)
        slowest = int(np.argmin(speed))
        ratio = float(np.min(speed) / np.mean(speed))
        if ratio < MIN_SPEED_RATIO:
            unit = "of the mean speed"
            when = f"at {grid[slowest]:.0%} of the path"
            remedy = "the path turns back on itself there: use another path"
            violation = Violation("blend", ratio, MIN_SPEED_RATIO, "min", unit, (), when, remedy)
            raise InfeasibleError([violation])
        check_loads(path, self.requirements.limits)
        return path
