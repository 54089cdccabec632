"""Knots of a path from one hitch to another, the optimiser's variables, and their bounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    weight_ratios,
)
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort
from hitchopt.planners.path import LegLaw, Path, shapes_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splines import evenly_interpolated
from hitchopt.values import Array, Indices

SPLINE_DEGREE = 5
"""Degree of the splines through the knots, with four continuous derivatives, so that pieces of a
trajectory need not end at knots."""


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a table (knots, size): flat outputs, and drones and r-legs that follow."""

    vertices: Indices  # (n, 2): x and y of vertices
    q_legs: Indices  # (n,): lengths of q-legs
    r_legs: Indices  # (n,): lengths of r-legs
    drones: Indices  # (2n, 2): x and y of drones
    tensions: Indices  # (n,): tensions of cables

    @property
    def size(self) -> int:
        """Number of columns."""
        return 9 * len(self.q_legs)

    @property
    def nodes(self) -> Indices:
        """(3n, 2): vertices, then drones, as in ``hitch.pairs``."""
        return np.concatenate([self.vertices, self.drones])

    def flat_index(self, row: Indices, column: Indices) -> Indices:
        """Return the index of entries of a table, flattened row by row; arguments broadcast."""
        return self.size * row + column


@lru_cache(maxsize=64)
def columns_of(robots: int) -> Columns:
    """Return the columns for a number of robots."""
    n = robots
    parts = np.split(np.arange(9 * n), np.cumsum([2 * n, n, n, 4 * n]))
    vertices, q_legs, r_legs, drones, tensions = parts
    return Columns(vertices.reshape(-1, 2), q_legs, r_legs, drones.reshape(-1, 2), tensions)


@dataclass(frozen=True, eq=False)
class KnotPath:
    """A hitch at J + 1 knots, evenly spaced in the path's parameter."""

    name: str  # Name of the initial guess
    team: Team  # The team of the hitch
    altitude: float  # [m] Altitude of the hitch's plane
    polygons: Array  # (J + 1, n, 2) [m]: vertices in plan view
    q_legs: Array  # (J + 1, n) [m]: lengths of q-legs
    tensions: Array  # (J + 1, n) [N]: tensions of cables
    roll: Array | None = None  # (J + 1, clasps) [rad]: roll of legs, or None

    @classmethod
    def through(cls, name: str, start: Hitch, end: Hitch, polygons: Array) -> KnotPath:
        """Return the path through polygons (J + 1, n, 2) with linear fractions and roll."""
        s = np.linspace(0.0, 1.0, len(polygons))[:, None]
        tensions = np.tile(start.team.tension, (len(polygons), 1))
        roll = start.roll + s * (end.roll - start.roll)
        slack = cable_slack_of(start.team, start.team.layout.edges(polygons), tensions)
        q_legs = (start.fractions + s * (end.fractions - start.fractions)) * slack
        rolls = roll if np.any(roll) else None
        return cls(name, start.team, start.altitude, polygons, q_legs, tensions, rolls)

    @property
    def steps(self) -> int:
        """Number J of steps between the knots."""
        return len(self.polygons) - 1

    @property
    def robot_knots(self) -> int:
        """Number of robots times that of inner knots."""
        return self.team.robots * (self.steps - 1)

    @property
    def edges(self) -> Array:
        """(J + 1, n, 2) [m]: edge vectors."""
        return self.team.layout.edges(self.polygons)

    @property
    def slack(self) -> Array:
        """(J + 1, n) [m]: slack of each cable for its two legs."""
        return cable_slack_of(self.team, self.edges, self.tensions)

    @cached_property
    def path(self) -> Path:
        """The smooth path through the knots."""
        heights = np.full((*self.polygons.shape[:2], 1), self.altitude)
        is_constant = np.all(self.tensions == self.tensions[0])
        return Path(
            self.team,
            _knot_spline(np.concatenate([self.polygons, heights], axis=-1)),
            LegLaw.of_fractions(_knot_spline(self.q_legs / self.slack)),
            None if is_constant else _knot_spline(self.tensions),
            None if self.roll is None else _knot_spline(self.roll),
        )

    def resampled(self, steps: int) -> KnotPath:
        """Return the path with another number of steps, evaluated on its spline."""
        return self.at(np.linspace(0.0, 1.0, steps + 1))

    def at(self, s: Array) -> KnotPath:
        """Return the path with the hitches at s (K,) as knots."""
        flat = self.path.flat(s, 1)
        shapes = shapes_of(self.team, flat)
        return replace(
            self,
            polygons=shapes.polygons,
            q_legs=shapes.legs[..., 0],
            tensions=flat.tensions[..., 0],
            roll=shapes.roll,
        )

    def with_perturbed_legs(self, share: float) -> KnotPath:
        """Return the path with q-legs changed at random, by up to a fraction of the shorter leg."""
        shares = np.random.default_rng(0).uniform(-share, share, self.q_legs.shape)
        shares[[0, -1]] = 0.0
        shorter = np.minimum(self.q_legs, self.slack - self.q_legs)
        return replace(self, q_legs=self.q_legs + shares * shorter)

    @property
    def columns(self) -> Columns:
        """The columns of the table."""
        return columns_of(self.team.robots)

    @cached_property
    def drones(self) -> Array:
        """(J + 1, n, 2, 3) [m]: positions of both drones of every cable, heights over the plane."""
        r_legs = self.slack - self.q_legs
        loads = clasp_loads(self.team, self.slack, self.roll)
        q_directions, r_directions = leg_directions(unit(self.edges), self.tensions, loads=loads)
        ratios = weight_ratios(self.team, self.tensions)
        drones = np.zeros((*self.q_legs.shape, 2, 3))
        dimensions = q_directions.shape[-1]  # 2 if all legs are level
        drones[:, :, 0, :dimensions] = leg_vectors(self.q_legs, q_directions, ratios)
        drones[:, :, 1, :dimensions] = leg_vectors(r_legs, r_directions, ratios)
        drones[:, :, 0, :2] += self.polygons
        drones[:, :, 1, :2] += np.roll(self.polygons, -1, axis=1)
        return drones

    @property
    def node_heights(self) -> Array:
        """(J + 1, 3n) [m]: heights of the nodes over the plane, vertices first."""
        drones = self.drones[..., 2].reshape(len(self.polygons), -1)
        return np.concatenate([np.zeros_like(self.q_legs), drones], axis=1)

    @cached_property
    def table(self) -> Array:
        """(knots, size): all columns, read-only."""
        knots = len(self.polygons)
        r_legs = self.slack - self.q_legs
        parts = [self.polygons, self.q_legs, r_legs, self.drones[..., :2], self.tensions]
        table = np.concatenate([part.reshape(knots, -1) for part in parts], axis=1)
        table.setflags(write=False)
        return table

    def with_table(self, table: Array) -> KnotPath:
        """Return the path with the vertices, q-legs and tensions of a table (knots, size)."""
        columns = self.columns
        return replace(
            self,
            polygons=table[:, columns.vertices],
            q_legs=table[:, columns.q_legs],
            tensions=table[:, columns.tensions],
        )


def _knot_spline(values: Array) -> PiecewisePolynomial:
    """Return the spline through values (J + 1, *shape) at evenly spaced s in [0, 1]."""
    return evenly_interpolated(values, SPLINE_DEGREE)


KNOT_MARGIN = 5e-3  # [m] Margin of walls and shortest legs at knots, for the spline between

COST_LEG_MARGIN = 0.025
"""[m] The same margin of legs with a custom cost, which bends paths more: splines between
knots fell up to 0.022 m short."""

TENSION_MARGIN = 0.02
"""Margin at both ends of a range of tensions, over the range, for the same reason."""

STATIC_SHARE = 0.97  # Largest fraction of thrust and tilt at rest, with a reserve for motion
MIN_MARGIN_RESERVE = 1e-9  # Smallest reserve of a margin over 1 by which others are divided

MARGIN_RAMP = 2.0
"""Number of knots over which the margin changes from that of an end, since a jump would bend the
path."""

Judge = Callable[[Path], Motion | None]
"""Function that returns the certified motion along a path, or None if it violates a limit."""


@dataclass(frozen=True)
class SolverStep:
    """Parameters of a step of the optimiser."""

    stride: float  # [m] Trust radius of coordinates of vertices and drones
    # Number of parts of every step between knots, at whose ends distances are enforced
    parts: int = 1
    fastest: bool = False  # True to minimise time instead of energy

    @property
    def reach(self) -> float:
        """Distance beyond the limit [m] up to which pairs have rows in the step."""
        return 2.0 * self.stride


class QuadraticTerms(NamedTuple):
    """A convex quadratic function of the changes of some variables.

    They are the inner rows of a path's table, or the coefficients of splines.
    """

    hessian: sp.csr_array[np.float64]  # (variables, variables), of which the symmetric part is used
    gradient: Array  # (variables,)

    def plus(self, other: QuadraticTerms) -> QuadraticTerms:
        """Return the sum of two functions."""
        hessian = sp.csr_array(self.hessian + other.hessian)
        return QuadraticTerms(hessian, self.gradient + other.gradient)


class PathCost(Protocol):
    """A cost of paths [s]."""

    def at_rest(self, path: Path, duration: float) -> float:
        """Return an estimate of the cost [s] of a flight along a path, without its motion."""

    def terms(self, path: KnotPath, duration: float) -> QuadraticTerms:
        """Return a convex second-order expansion of this estimate around a path."""


@dataclass(frozen=True, eq=False)
class SearchLimits:
    """Constraints of all paths of one search."""

    requirements: Requirements  # Requirements of the problem
    judge: Judge  # Accepts or rejects paths
    # [N] Smallest and largest one of variable tensions, or None
    tension: tuple[float, float] | None
    end_margins: tuple[float, float]  # Margins of distances of the first and the last hitch
    margin: float = 1.02  # Enforced margin of distances at the knots
    effort: Effort = field(default_factory=Effort)  # Effort of all programs of the search
    # Refined paths that break a limit, for the diagnosis
    rejected: list[KnotPath] = field(default_factory=list)
    cost: PathCost | None = None  # Custom cost, to be minimised with the duration

    def cost_of(self, path: Path, duration: float) -> float:
        """Return an estimate of the cost of a flight along a path [s]; 0 without a cost."""
        return 0.0 if self.cost is None else self.cost.at_rest(path, duration)

    def margins(self, steps: int, indices: Array) -> Array:
        """Return the margins (K,) at fractional knot indices (K,), at most those of the ends."""
        first = min(self.end_margins[0], self.margin)
        last = min(self.end_margins[1], self.margin)
        rise = np.minimum(indices / MARGIN_RAMP, 1.0)
        fall = np.minimum((steps - indices) / MARGIN_RAMP, 1.0)
        from_first = first + rise * (self.margin - first)
        toward_last = last + fall * (self.margin - last)
        return np.minimum(from_first, toward_last)


def variable_bounds(path: KnotPath, search: SearchLimits, stride: float) -> tuple[Array, Array]:
    """Return bounds of the inner knots' variables by legs, walls, stride [m] and tensions."""
    columns = path.columns
    table = path.table[1:-1]
    arena = search.requirements.arena
    lower = np.full(table.shape, -np.inf)
    upper = np.full(table.shape, np.inf)
    if arena is not None:
        lower[:, columns.drones] = arena.lower[:2] + KNOT_MARGIN
        upper[:, columns.drones] = arena.upper[:2] - KNOT_MARGIN
    lowest_tension, highest_tension = _tension_bounds(path.team, search)
    lower[:, columns.tensions] = lowest_tension
    upper[:, columns.tensions] = highest_tension
    # Legs have the margins of distances
    margins = search.margins(path.steps, np.arange(1.0, path.steps))
    share = (margins - 1.0) / max(search.margin - 1.0, MIN_MARGIN_RESERVE)
    leg_margin = KNOT_MARGIN if search.cost is None else COST_LEG_MARGIN
    shortest = search.requirements.limits.leg + leg_margin * np.clip(share, 0.0, 1.0)
    lower[:, columns.q_legs] = shortest[:, None]
    lower[:, columns.r_legs] = shortest[:, None]
    nodes = columns.nodes
    lower[:, nodes] = np.maximum(lower[:, nodes], table[:, nodes] - stride)
    upper[:, nodes] = np.minimum(upper[:, nodes], table[:, nodes] + stride)
    # For a guess outside the arena the bounds are exchanged, and pull it toward the walls
    return np.minimum(lower, upper).ravel(), np.maximum(lower, upper).ravel()


def _tension_bounds(team: Team, search: SearchLimits) -> tuple[Array, Array]:
    """Return the smallest and the largest tensions (n,) [N] of cables at knots.

    Both drones of a robot can hover against the horizontal pull of the largest ones.
    """
    if search.tension is None:
        return team.tension, team.tension
    smallest, largest = search.tension
    margin = TENSION_MARGIN * (largest - smallest)
    lowest = smallest + margin
    lift = team.mass * GRAVITY + team.cable_weight
    spare_thrust = np.sqrt(np.maximum((STATIC_SHARE * team.max_thrust) ** 2 - lift**2, 0.0))
    largest_tilt = STATIC_SHARE * search.requirements.limits.tilt
    pull_of_drones = np.minimum(spare_thrust, lift * math.tan(largest_tilt))
    pull = pull_of_drones.reshape(-1, 2).min(axis=1)
    highest = np.maximum(lowest, np.minimum(largest - margin, pull))
    return np.full(team.robots, lowest), highest
