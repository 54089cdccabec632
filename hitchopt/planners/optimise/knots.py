"""A path from one hitch to another as knots, which the optimiser moves, and their bounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.path import LegLaw, ShapePath, shapes_of
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

SPLINE_DEGREE = 5
"""Degree of the splines through the knots: smooth up to the snap, so that pieces of a trajectory
need not meet the knots."""


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a table (knots, size), of which the inner rows are variables.

    Drones and r-legs are variables of their own, tied to the flat outputs by equalities: distances
    are then polynomials of the second degree at most, and every row involves few variables.

    Attributes
    ----------
    vertices: (n, 2)
    q_legs, r_legs: (n,)
    drones: (2n, 2)
    tensions: (n,)
    """

    vertices: Indices
    q_legs: Indices
    r_legs: Indices
    drones: Indices
    tensions: Indices

    @property
    def size(self) -> int:
        """Number of variables per knot."""
        return 9 * len(self.q_legs)

    @property
    def nodes(self) -> Indices:
        """(3n, 2): vertices, then drones, as in ``hitch.pairs``."""
        return np.concatenate([self.vertices, self.drones])


@lru_cache(maxsize=64)
def columns_of(robots: int) -> Columns:
    """Return the columns of the table of a hitch of that many robots."""
    n = robots
    parts = np.split(np.arange(9 * n), np.cumsum([2 * n, n, n, 4 * n]))
    vertices, q_legs, r_legs, drones, tensions = parts
    return Columns(vertices.reshape(-1, 2), q_legs, r_legs, drones.reshape(-1, 2), tensions)


@dataclass(frozen=True, eq=False)
class KnotPath:
    """A hitch at J + 1 knots, evenly spaced in the path's parameter.

    Attributes
    ----------
    name: of the guess that it came from.
    team: whose cables.
    altitude: of the hitch's plane [m].
    polygons: (J + 1, n, 2) [m]
    q_legs: (J + 1, n) [m]
    tensions: (J + 1, n) [N]
    roll: (J + 1, clasps) [rad], or None where legs are not rolled.
    """

    name: str
    team: Team
    altitude: float
    polygons: Array
    q_legs: Array
    tensions: Array
    roll: Array | None = None

    @classmethod
    def through(cls, name: str, start: Hitch, end: Hitch, polygons: Array) -> KnotPath:
        """Return the path through polygons (J + 1, n, 2) on which fractions change evenly."""
        s = np.linspace(0.0, 1.0, len(polygons))[:, None]
        tensions = np.tile(start.team.tension, (len(polygons), 1))
        roll = start.roll + s * (end.roll - start.roll)
        slack = cable_slack_of(start.team, start.team.layout.edges(polygons), tensions)
        q_legs = (start.fractions + s * (end.fractions - start.fractions)) * slack
        own = roll if np.any(roll) else None
        return cls(name, start.team, start.altitude, polygons, q_legs, tensions, own)

    @property
    def steps(self) -> int:
        """Number J of steps between the knots."""
        return len(self.polygons) - 1

    @property
    def edges(self) -> Array:
        """(J + 1, n, 2) [m]: edge vectors."""
        return self.team.layout.edges(self.polygons)

    @property
    def slack(self) -> Array:
        """(J + 1, n) [m]: what each cable has left for its two legs."""
        return cable_slack_of(self.team, self.edges, self.tensions)

    @cached_property
    def path(self) -> ShapePath:
        """The smooth path through the knots."""
        level = np.full((*self.polygons.shape[:2], 1), self.altitude)
        steady = np.all(self.tensions == self.tensions[0])
        return ShapePath(
            self.team,
            _knot_spline(np.concatenate([self.polygons, level], axis=-1)),
            LegLaw.of_fractions(_knot_spline(self.q_legs / self.slack)),
            None if steady else _knot_spline(self.tensions),
            None if self.roll is None else _knot_spline(self.roll),
        )

    def resampled(self, steps: int) -> KnotPath:
        """Return the same path with so many steps, evaluated on its spline."""
        return self.at(np.linspace(0.0, 1.0, steps + 1))

    def at(self, s: Array) -> KnotPath:
        """Return the hitches at s (K,) of its path, as if they were knots."""
        flat = self.path.flat(s, 1)
        shapes, tensions = shapes_of(self.team, flat), flat.tensions[..., 0]
        q_legs = shapes.legs[..., 0]
        return replace(
            self, polygons=shapes.polygons, q_legs=q_legs, tensions=tensions, roll=shapes.roll
        )

    @property
    def columns(self) -> Columns:
        """The columns of its table."""
        return columns_of(self.team.robots)

    @cached_property
    def table(self) -> Array:
        """(knots, size): all columns, read-only."""
        edges = self.edges
        loads = clasp_loads(self.team, self.q_legs, self.slack, self.roll)
        u = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
        q, r = leg_directions(u, self.tensions, loads=loads)
        r_legs = self.slack - self.q_legs
        sag = sag_factors(self.team, self.tensions)
        q_drones = self.polygons + leg_vectors(self.q_legs, q, sag)[..., :2]
        r_drones = np.roll(self.polygons, -1, axis=1) + leg_vectors(r_legs, r, sag)[..., :2]
        drones = np.stack([q_drones, r_drones], axis=2)
        parts = [self.polygons, self.q_legs, r_legs, drones, self.tensions]
        table = np.concatenate([part.reshape(len(edges), -1) for part in parts], axis=1)
        table.setflags(write=False)
        return table

    def with_table(self, table: Array) -> KnotPath:
        """Return the path with the vertices, q-legs and tensions of a table (knots, size)."""
        columns = self.columns
        polygons, q_legs = table[:, columns.vertices], table[:, columns.q_legs]
        return replace(self, polygons=polygons, q_legs=q_legs, tensions=table[:, columns.tensions])


def _knot_spline(values: Array) -> PiecewisePolynomial:
    """Return the spline through values (J + 1, *shape) at evenly spaced s in [0, 1]."""
    s = np.linspace(0.0, 1.0, len(values))
    return PiecewisePolynomial.from_spline(make_interp_spline(s, values, k=SPLINE_DEGREE))


INSET = 5e-3
"""[m] Distance from walls and shortest legs, for the spline between knots."""

TENSION_INSET = 0.02
"""Share of a range of tensions that stays free at both its ends, for the same reason."""

STATIC_SHARE = 0.97
"""Share of thrust and tilt that holding the hitch at rest may take; the rest moves it."""

RAMP = 2.0
"""Number of knots in which the margin rises from that of an end: a jump would bend the path."""

Judge = Callable[[ShapePath], Motion | None]
"""Flies a path and verifies all of the time: the motion if it satisfies every limit, else None."""


@dataclass(frozen=True)
class SolverStep:
    """One step of the optimiser, from a path to a better one.

    Attributes
    ----------
    stride: [m], how far a coordinate of a vertex or drone may go.
    parts: of every step between knots, at whose ends distances are enforced as well.
    fastest: minimise the time, not the energy.
    """

    stride: float
    parts: int = 1
    fastest: bool = False

    @property
    def reach(self) -> float:
        """[m] Pairs farther apart than their limit and this hardly come near in such a step.

        What does has rows in the next one.
        """
        return 1.5 * self.stride


@dataclass(frozen=True, eq=False)
class Search:
    """Constraints of all paths of one search.

    Attributes
    ----------
    requirements: of the problem.
    judge: decides about every path.
    tension: smallest and largest [N] where tensions may change on the path, or None.
    end_margins: how many times their limits the first and last hitch exceed their distances.
    margin: how many times their limits distances are enforced at the knots.
    """

    requirements: Requirements
    judge: Judge
    tension: tuple[float, float] | None
    end_margins: tuple[float, float]
    margin: float = 1.02

    def margins(self, steps: int, places: Array) -> Array:
        """Return (K,): the margins at places in steps from the start, near ends at most theirs."""
        first, last = (min(m, self.margin) for m in self.end_margins)
        out, back = (np.minimum(a / RAMP, 1.0) for a in (places, steps - places))
        return np.minimum(first + out * (self.margin - first), last + back * (self.margin - last))


def variable_bounds(path: KnotPath, search: Search, stride: float) -> tuple[Array, Array]:
    """Return bounds of the inner knots' variables: legs, walls, a stride [m], static tensions."""
    columns, table, team = path.columns, path.table[1:-1], path.team
    margins = search.margins(path.steps, np.arange(1.0, path.steps))
    arena, limits = search.requirements.arena, search.requirements.limits
    lower = np.full(table.shape, -np.inf)
    upper = np.full(table.shape, np.inf)
    if arena is not None:
        lower[:, columns.drones] = arena.lower[:2] + INSET
        upper[:, columns.drones] = arena.upper[:2] - INSET
    if search.tension is None:
        lower[:, columns.tensions] = upper[:, columns.tensions] = team.tension
    else:
        least, most = search.tension
        inset = TENSION_INSET * (most - least)
        # Against a level pull both drones of a robot must be able to hover.
        lift = team.mass * GRAVITY + team.cable_weight
        spare = np.sqrt(np.maximum((STATIC_SHARE * team.max_thrust) ** 2 - lift**2, 0.0))
        static = np.minimum(spare, lift * math.tan(STATIC_SHARE * limits.tilt))
        static = static.reshape(-1, 2).min(axis=1)
        lower[:, columns.tensions] = least + inset
        upper[:, columns.tensions] = np.maximum(least + inset, np.minimum(most - inset, static))
    rise = (margins - 1.0) / max(search.margin - 1.0, 1e-9)
    legs = limits.leg + INSET * np.clip(rise, 0.0, 1.0)
    lower[:, columns.q_legs] = lower[:, columns.r_legs] = legs[:, None]
    nodes = columns.nodes
    lower[:, nodes] = np.maximum(lower[:, nodes], table[:, nodes] - stride)
    upper[:, nodes] = np.minimum(upper[:, nodes], table[:, nodes] + stride)
    # A guess may stand outside the arena: then the walls are what it is pulled towards.
    return np.minimum(lower, upper).ravel(), np.maximum(lower, upper).ravel()
