"""Rows of a path's program that tie drones to the flat outputs, with their exact derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY
from hitchopt.model.planar_derivatives import planar, planar_bends, planar_slopes
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.model_rows import Draft, Symbols
from hitchopt.values import Array, Indices

FLATTEST = math.radians(3.0)
"""[rad] Smallest exterior angle on the path, or half of that at its ends if that is less."""

PLACES = 5
"""Number of rows of a robot at a knot: both drones' places and the r-leg; its turn is one more."""


@dataclass(frozen=True, eq=False)
class TiedRows:
    """Places and turns of all robots at all inner knots, one after the other: m columns.

    Rows are all places, less the variables tied to them, then all turns.

    Attributes
    ----------
    loaded, choice: of the model, see ``planar``.
    group: of the variables.
    inputs: (m, width_i) each, numbers of the variables that the model follows from.
    lifted: (m, 5), of those tied to it.
    own: (rows, m) each, the model's other inputs.
    """

    loaded: bool
    choice: bool
    group: int
    inputs: tuple[Indices, ...]
    lifted: Indices
    own: tuple[Array, ...]

    def value(self, at: Symbols) -> ca.MX:
        """Return the rows."""
        place, turn = self._mapped(planar(self.loaded, self.choice), at)
        return ca.vertcat(ca.vec(place - self._columns(at, self.lifted)), ca.vec(turn))

    def slopes(self, at: Symbols) -> ca.MX:
        """Return the rows' Jacobian (rows, variables)."""
        function = planar_slopes(self.loaded, self.choice)
        (found,) = self._mapped(function, at)
        row, column = map(np.asarray, function.sparsity_out(0).get_triplet())
        count, tied = len(self.lifted), np.arange(self.lifted.size)
        knot = np.arange(count)[:, None]
        rows = np.where(row < PLACES, PLACES * knot + row, PLACES * count + knot)
        places = self._first(at) + np.append(self._varied[:, column].ravel(), self.lifted)
        entries = ca.vertcat(found.nz[:], -ca.DM.ones(tied.size))
        return _summed(np.append(rows.ravel(), tied), places, entries, (6 * count, _size(at)))

    def bends(self, at: Symbols, multipliers: ca.MX) -> ca.MX:
        """Return the upper triangle (variables, variables) of the Hessian of the weighted sum."""
        function, count = planar_bends(self.loaded, self.choice), len(self.lifted)
        of_places = ca.reshape(multipliers[: PLACES * count], PLACES, count)
        weights = ca.vertcat(of_places, multipliers[PLACES * count :].T)
        (found,) = self._mapped(function, at, weights)
        pair = [self._varied[:, side] for side in function.sparsity_out(0).get_triplet()]
        row, column = (self._first(at) + end for end in (np.minimum(*pair), np.maximum(*pair)))
        # With n = 3 both ends of a pair may be one variable: what stood on both sides counts twice.
        folded = (pair[0] == pair[1]) & np.not_equal(*function.sparsity_out(0).get_triplet())
        entries = ca.DM(np.where(folded, 2.0, 1.0).ravel()) * found.nz[:]
        return _summed(row.ravel(), column.ravel(), entries, (_size(at), _size(at)))

    @property
    def _varied(self) -> Indices:
        """(m, width): numbers of the variables that the model follows from."""
        return np.concatenate(self.inputs, axis=1)

    def _first(self, at: Symbols) -> int:
        """Return the number of the group's first variable among all."""
        return sum(part.numel() for part in at.variables[: self.group])

    def _columns(self, at: Symbols, places: Indices) -> ca.MX:
        """Return the variables (width, m) at places (m, width)."""
        return ca.reshape(at.variables[self.group][places.ravel().tolist()], *places.T.shape)

    def _mapped(self, function: ca.Function, at: Symbols, *more: ca.MX) -> list[ca.MX]:
        """Return the outputs of all columns, side by side."""
        varied = [self._columns(at, places) for places in self.inputs]
        own = [ca.MX(ca.DM(values)) for values in self.own]
        found: list[ca.MX] = function.map(len(self.lifted)).call([*varied, *own, *more])
        return found


def _size(at: Symbols) -> int:
    """Return the number of all variables."""
    return sum(part.numel() for part in at.variables)


def _summed(rows: Indices, columns: Indices, entries: ca.MX, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix of entries at rows and columns; those at one place are added."""
    place, which = np.unique(columns * shape[0] + rows, return_inverse=True)
    ones = (np.ones(len(which)), (which, np.arange(len(which))))
    adding = ca.DM(sparse.csc_matrix(ones, shape=(len(place), len(which))))
    pattern = (place % shape[0]).tolist(), (place // shape[0]).tolist()
    return ca.MX(ca.Sparsity.triplet(*shape, *pattern), adding @ entries)


def tie_drones(draft: Draft, x: int, path: KnotPath) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner.

    Parameters
    ----------
    x: the variables of the inner knots.
    """
    layout, n, team, inner = path.columns, path.team.robots, path.team, path.steps - 1
    lifted = np.column_stack([layout.drones.reshape(n, 4), layout.r_legs])
    around = np.concatenate([np.roll(layout.vertices, -k, axis=0) for k in (-1, 0, 1, 2)], axis=1)
    pulls = np.stack([np.roll(layout.tensions, -k) for k in (-1, 0, 1)], axis=1)
    rolled, equal = team.loaded or path.roll is not None, bool(np.ptp(team.tension) == 0.0)
    own: tuple[Array, ...]
    if rolled:
        legs, own = layout.q_legs[team.layout.neighbours], _clasp_numbers(path)
        choice = team.cable_density > 0.0
    else:
        legs, own = layout.q_legs[:, None], (np.tile(team.cable_length, inner)[None],)
        choice = equal
    draft.structure("tied", n, inner, rolled, choice, *own)

    def at_knots(places: NDArray[np.intp]) -> Indices:
        """Return the numbers (inner · n, width) of columns (n, width) at all knots."""
        starts = layout.size * np.arange(inner)[:, None, None]
        return (starts + places).reshape(-1, places.shape[1])

    inputs = (at_knots(around), at_knots(legs), at_knots(pulls))
    tied = TiedRows(rolled, choice, x, inputs, at_knots(lifted), own)
    sharpest = min(np.min(ConvexPolygon(path.polygons[end]).exterior_angles) for end in (0, -1))
    flattest = math.sin(min(FLATTEST, 0.5 * float(sharpest)))
    zeros, corners = np.zeros(tied.lifted.size), np.full(len(tied.lifted), flattest)
    least, most = (np.append(zeros, end) for end in (corners, np.full(len(corners), np.inf)))
    draft.bound(tied.value, least, most, tied)


def _clasp_numbers(path: KnotPath) -> tuple[Array, ...]:
    """Return cables' lengths, rolls, loads and weights of all robots at the inner knots."""
    team, n, inner = path.team, path.team.robots, path.steps - 1
    columns, ends = n * inner, np.column_stack([team.layout.starts, team.layout.ends])
    roll = np.zeros((inner, n)) if path.roll is None else path.roll[1:-1]
    loads = np.zeros((n, 2, 3))
    loads[..., 2] = -GRAVITY * team.load[ends]
    return (
        np.tile(team.cable_length[team.layout.neighbours[:, :2]].T, inner),
        roll[:, ends].reshape(columns, 2).T,
        np.tile(loads.reshape(n, 6).T, inner),
        np.full((1, columns), GRAVITY * team.cable_density),
    )
