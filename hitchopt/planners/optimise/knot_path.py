"""A path from one hitch to another, as knots: what the optimiser moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_spans import cable_slack_of, clasp_loads, leg_vectors, sag_factors
from hitchopt.hitch.statics import leg_directions
from hitchopt.planners.path.shape_path import LegLaw, ShapePath, shapes_of
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
        """(3n, 2): vertices, then drones, as in ``hitch.parts``."""
        return np.concatenate([self.vertices, self.drones])


@lru_cache(maxsize=64)
def columns_of(n: int) -> Columns:
    """Return the columns of n robots."""
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
        bare = cls(
            name,
            start.team,
            start.altitude,
            polygons,
            np.zeros_like(tensions),
            tensions,
            roll if np.any(roll) else None,
        )
        fractions = start.fractions + s * (end.fractions - start.fractions)
        return replace(bare, q_legs=fractions * bare.slack)

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

    def resampled(self, count: int) -> KnotPath:
        """Return the same path at ``count`` knots, evaluated on its spline."""
        return self.at(np.linspace(0.0, 1.0, count))

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
    units = _unit_splines(len(values))
    joined = values.reshape(len(values), -1).T @ units.coefficients
    shape = (units.pieces, *values.shape[1:], SPLINE_DEGREE + 1)
    return PiecewisePolynomial(units.breaks, joined.reshape(shape))


@lru_cache(maxsize=64)
def _unit_splines(count: int) -> PiecewisePolynomial:
    """Return the splines (count,) that are 1 at one of ``count`` knots and 0 at the others."""
    s = np.linspace(0.0, 1.0, count)
    return PiecewisePolynomial.from_spline(make_interp_spline(s, np.eye(count), k=SPLINE_DEGREE))
