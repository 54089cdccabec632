"""Splines over s that are added to a path: B-splines at samples, and rows by their coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.planners.optimise.parts import Columns
from hitchopt.planners.path import LegLaw, Path
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks, summed
from hitchopt.trajectory.splines import bspline, extraction
from hitchopt.values import Array, Indices

DEGREE = 5  # Degree of the splines that are added


class LocalBasis(NamedTuple):
    """B-splines at samples."""

    first: Indices  # (M,): index of the first one that does not vanish
    jets: Array  # (M, degree + 1, count): values and derivatives of those that do not

    @classmethod
    def of(cls, knots: Array, degree: int, at: Array, count: int) -> LocalBasis:
        """Return the B-splines with knots at parameters (M,)."""
        breaks, columns, maps = extraction(knots, degree)
        piece = breaks[1:-1].searchsorted(at, side="right")
        durations = breaks[piece + 1] - breaks[piece]
        jets = bernstein.jet_basis((at - breaks[piece]) / durations, degree, count)
        jets = jets / durations[:, None, None] ** np.arange(count)
        return cls(columns[piece, 0], maps[piece].swapaxes(1, 2) @ jets)

    @property
    def indices(self) -> Indices:
        """(M, degree + 1): indices of the B-splines that do not vanish."""
        return self.first[:, None] + np.arange(self.jets.shape[1])

    def at(self, sample: Indices) -> LocalBasis:
        """Return the B-splines at some samples (rows,)."""
        return LocalBasis(self.first[sample], self.jets[sample])


def scattered(columns: Indices, entries: Array, width: int) -> sp.csr_array[np.float64]:
    """Return the sparse rows (rows, width) with entries (rows, k) in columns (rows, k)."""
    count = len(columns)
    rows = np.repeat(np.arange(count), columns.shape[1])
    return sp.csr_array((entries.ravel(), (rows, columns.ravel())), (count, width))


@dataclass(frozen=True, eq=False)
class PathSplines:
    """One spline for each flat output of a path, of the same knots.

    Coefficients are stored B-spline by B-spline, each with those of all unknowns.
    """

    columns: Columns  # The unknowns: flat outputs to which splines are added
    pieces: int  # Number of pieces of each spline

    @classmethod
    def of(cls, path: Path, pieces: int) -> PathSplines:
        """Return the splines for the flat outputs of a path."""
        return cls(Columns(path.team, path.roll is not None, path.tensions is not None), pieces)

    @cached_property
    def knots(self) -> Array:
        """Knots over s."""
        inner = np.linspace(0.0, 1.0, self.pieces + 1)
        return np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])

    @property
    def count(self) -> int:
        """Number of coefficients of each spline."""
        return self.pieces + DEGREE

    @property
    def width(self) -> int:
        """Number of coefficients of all splines."""
        return self.count * self.columns.size

    @property
    def from_ends(self) -> Array:
        """(count,): pieces between each coefficient and the nearest end of the path."""
        averages = np.convolve(self.knots[1:-1], np.full(DEGREE, 1.0 / DEGREE), "valid")
        return self.pieces * np.minimum(averages, 1.0 - averages)

    def basis(self, s: Array, count: int) -> LocalBasis:
        """Return the B-splines at s (J,) with ``count`` coefficients of their jets."""
        return LocalBasis.of(self.knots, DEGREE, s, count)

    def places(self, basis: LocalBasis, columns: Indices) -> Indices:
        """Return the coefficients (rows, degree + 1, k) of unknowns (rows, k) or (k,)."""
        of_unknowns = columns[..., None, :]
        return basis.indices[..., None] * self.columns.size + of_unknowns

    def of_coefficients(self, coefficients: Array) -> PiecewisePolynomial:
        """Return the splines (unknowns,) over s of coefficients (width,)."""
        return bspline(self.knots, coefficients.reshape(self.count, -1), DEGREE)

    def unknowns(self, path: Path, s: Array, count: int) -> Array:
        """Return the jets (J, unknowns, count) of the unknowns of a path at s (J,)."""
        has_leg = np.all(path.team.layout.has_leg, axis=1)
        points = path.vertices.jet(s, count)[:, :, :2]
        parts = [
            points.reshape(len(s), -1, count),
            path.legs.length.jet(s, count) * has_leg[:, None],
        ]
        parts += [curve.jet(s, count) for curve in (path.roll, path.tensions) if curve is not None]
        return np.concatenate(parts, axis=1)

    def added_to(self, path: Path, change: PiecewisePolynomial) -> Path:
        """Return a path whose q-legs are splines, with a change (unknowns,) of its flat outputs."""
        columns = self.columns

        def changed(curve: PiecewisePolynomial, of: Indices) -> PiecewisePolynomial:
            """Return a curve with the change of the unknowns ``of``."""
            return summed(curve, change.replaced(change.coefficients[:, of]))

        vertices = on_breaks(path.vertices, merged_breaks([path.vertices.breaks, change.breaks]))
        vertices = vertices.elevated(max(vertices.degree, change.degree))
        coefficients = vertices.coefficients.copy()
        shift = on_breaks(change, vertices.breaks).elevated(vertices.degree).coefficients
        coefficients[:, :, :2] += shift[:, columns.points]
        return Path(
            path.team,
            vertices.replaced(coefficients),
            LegLaw.of_lengths(changed(path.legs.length, columns.q_legs)),
            None if path.tensions is None else changed(path.tensions, columns.tensions),
            None if path.roll is None else changed(path.roll, columns.roll),
        )
