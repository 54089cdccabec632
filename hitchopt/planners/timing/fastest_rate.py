"""The fastest squared rate of a clock under its rows: an interior-point method of banded systems.

The rate is a cubic spline, so that every row sees four neighbouring coefficients and Newton's
matrix has seven diagonals: a step costs as much as looking at the rows. Every iterate satisfies all
rows strictly, so the last one is a solution whatever ended the search, and only how fast it is
depends on that. Arrays over samples have these next to one another in memory (Fortran's order):
numpy's sums over the few other indices are then several times as fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg.lapack import dpbtrf, dpbtrs

from hitchopt.planners.timing.rate_rows import RateRows
from hitchopt.time_limit import check_time
from hitchopt.values import Array, Indices

DEGREE = 3

LOWER = np.tril_indices(DEGREE + 1)
"""Pairs of the coefficients that a sample sees, the first not before the second."""

STEPS = 60
"""Largest number of Newton steps; some 15 are usual."""

GAP = 1e-5
"""Duality gap at which the search ends, as a share of the duration."""

LEAST = 1e-4
"""Least coefficient: keeps the rate above zero between the samples as well."""

INSIDE = 0.99
"""Largest share of the distance to the nearest bound that a step may take."""

SHRINK = 1e-3
"""Least share of a slack that every step leaves."""

BACKTRACK, SMALLEST = 0.7, 1e-8
"""Factor by which a step is shortened that breaks a row, and the share at which that ends."""

LEAST_LEFT = 0.1
"""Least share of the gap after the predictor's step that sets the centring."""


@dataclass(frozen=True, eq=False)
class SplineBasis:
    """A cubic spline's values and two derivatives at samples, by its coefficients.

    Attributes
    ----------
    first: (M,), the first of the four coefficients that a sample sees.
    values: (M, 3, 4)
    count: of the coefficients.
    """

    first: Indices
    values: Array
    count: int

    @classmethod
    def of(cls, spline: BSpline, at: Array) -> SplineBasis:
        """Return the basis of a cubic spline at samples (M,) inside of its range."""
        count = len(spline.c)
        span = np.clip(np.searchsorted(spline.t, at, side="right") - 1, DEGREE, count - 1)
        first = span - DEGREE
        whole = BSpline(spline.t, np.eye(count), DEGREE)
        columns = first[:, None] + np.arange(DEGREE + 1)
        rows = np.arange(len(at))[:, None]
        values = np.stack([whole(at, order)[rows, columns] for order in range(3)], axis=1)
        return cls(first, np.asfortranarray(values), count)

    @cached_property
    def seen(self) -> Indices:
        """(4, M): the coefficients that a sample sees."""
        return np.arange(DEGREE + 1)[:, None] + self.first

    @cached_property
    def places(self) -> Indices:
        """(10 M,): places in the flat band of the pairs of coefficients that a sample sees."""
        i, j = (index[:, None] for index in LOWER)
        return (self.count * (i - j) + j + self.first).ravel()

    @cached_property
    def products(self) -> Array:
        """(M, 10, 3, 3): products of values and derivatives of these pairs."""
        first, second = (self.values[..., index] for index in LOWER)
        return np.asfortranarray(np.einsum("mop,mqp->mpoq", first, second))

    def at(self, coefficients: Array) -> Array:
        """Return value and derivatives (M, 3)."""
        values: Array = np.einsum("moj,mj->mo", self.values, coefficients[self.seen].T)
        return values

    def transposed(self, forces: Array) -> Array:
        """Return what (M, 3) by value and derivatives is by coefficients (count,)."""
        local = np.einsum("mo,moj->mj", forces, self.values)
        return _sums(self.seen.ravel(), local.T.ravel(), self.count)

    def banded(self, forms: Array) -> Array:
        """Return the lower band (4, count) of what quadratic forms (M, 3, 3) are together."""
        local = np.einsum("mpoq,moq->mp", self.products, forms)
        band = _sums(self.places, local.T.ravel(), (DEGREE + 1) * self.count)
        return band.reshape(DEGREE + 1, self.count)


def _sums(places: Indices, values: Array, count: int) -> Array:
    """Return (count,): the sums of the values at each place."""
    return np.bincount(places, weights=values, minlength=count).astype(np.float64, copy=False)


@dataclass(frozen=True, eq=False)
class RateProgram:
    """``min Σ w / √x`` over the coefficients of x, all rows below zero.

    Attributes
    ----------
    basis: of x at the samples.
    rows: at the samples.
    weights: (M,) [s], of the quadrature that gives the duration.
    """

    basis: SplineBasis
    rows: RateRows
    weights: Array

    def duration(self, coefficients: Array) -> float:
        """Return Σ w / √x [s]."""
        return self.time(self.basis.at(coefficients))

    def time(self, p: Array) -> float:
        """Return the same for x and its derivatives p (M, 3) at the samples [s]."""
        return float(self.weights @ (1.0 / np.sqrt(p[:, 0])))

    def slack(self, coefficients: Array) -> Array | None:
        """Return the slack (R · M + count,) of rows and coefficients; None if one is negative."""
        p = self.basis.at(coefficients)
        own = coefficients - LEAST
        if own.min() <= 0.0 or p[:, 0].min() <= 0.0:
            return None
        slack = np.concatenate([-self.rows.values(p).T.ravel(), own])
        return slack if slack.min() > 0.0 else None


def fastest_rate(program: RateProgram, start: Array) -> Array:
    """Return the coefficients of the fastest rate that is found from a start inside of all rows.

    A primal-dual method with a predictor, after Mehrotra. The start itself is returned where it is
    not inside.
    """
    found = program.slack(start)
    if found is None:
        return start
    c, slack = start, found
    force = 0.1 * program.duration(c) / len(slack) / slack
    for _ in range(STEPS):
        check_time()
        p = program.basis.at(c)
        duration = program.time(p)
        gap = float(force @ slack)
        newton = _Newton.at(program, p, force, slack)
        if gap < GAP * duration and np.abs(newton.residual).max() < GAP * duration:
            break
        if not newton.solvable:
            break
        dc, dslack, dforce = newton.step(0.0)
        left = (slack + _share(slack, dslack) * dslack) @ (force + _share(force, dforce) * dforce)
        aim = max(gap * float(np.clip(left / gap, LEAST_LEFT, 1.0)) ** 3, 0.1 * GAP * duration)
        dc, dslack, dforce = newton.step(aim / len(slack))
        share = _share(slack, dslack)
        left_over, least = program.slack(c + share * dc), SHRINK * slack
        while left_over is None or (left_over < least).any():
            share *= BACKTRACK
            if share < SMALLEST:
                return c
            left_over = program.slack(c + share * dc)
        c, slack = c + share * dc, left_over
        force = force + _share(force, dforce) * dforce
    return c


@dataclass(frozen=True, eq=False)
class _Newton:
    """Newton's system at a point.

    Attributes
    ----------
    program: what is solved.
    gradients: (M, R, 3), of the rows by value and derivatives of x.
    residual: (count,), of what the objective's and the rows' forces come to.
    force, slack: (R · M + count,), of the rows, then of the coefficients.
    factor: of the matrix, banded; empty where there is none.
    """

    program: RateProgram
    gradients: Array
    residual: Array
    force: Array
    slack: Array
    factor: Array

    @classmethod
    def at(cls, program: RateProgram, p: Array, force: Array, slack: Array) -> _Newton:
        """Return the system at p (M, 3), by the convex part of the rows where it is indefinite."""
        basis, rows = program.basis, program.rows
        shape = rows.c.T.shape
        inner = rows.c.size
        gradients = rows.gradients(p)
        own = force[:inner].reshape(shape).T
        stiff = (force[:inner] / slack[:inner]).reshape(shape).T
        pull = np.einsum("mr,mri->mi", own, gradients)
        pull[:, 0] -= 0.5 * program.weights * p[:, 0] ** -1.5
        residual = basis.transposed(pull) - force[inner:]
        forms = np.einsum("mri,mrj->mij", stiff[..., None] * gradients, gradients)
        forms[:, 0, 0] += 0.75 * program.weights * p[:, 0] ** -2.5
        factor = np.zeros((0, 0))
        for convex in (False, True):
            band = basis.banded(forms + rows.curvature(p, own, convex=convex))
            band[0] += force[inner:] / slack[inner:]
            lower, failed = dpbtrf(band, lower=True)
            if not failed:
                factor = lower
                break
        return cls(program, gradients, residual, force, slack, factor)

    @property
    def solvable(self) -> bool:
        """Whether there is a factor."""
        return self.factor.size > 0

    def step(self, aim: float) -> tuple[Array, Array, Array]:
        """Return the steps of coefficients, slack and forces towards products of ``aim`` each."""
        basis, shape = self.program.basis, self.gradients.shape[1::-1]
        inner = shape[0] * shape[1]
        pull = aim / self.slack - self.force
        pushed = np.einsum("mr,mri->mi", pull[:inner].reshape(shape).T, self.gradients)
        right = pull[inner:] - self.residual - basis.transposed(pushed)
        dc: Array = dpbtrs(self.factor, right, lower=True)[0]
        along = np.einsum("mri,mi->mr", self.gradients, basis.at(dc))
        dslack = np.concatenate([-along.T.ravel(), dc])
        return dc, dslack, pull - self.force / self.slack * dslack


def _share(values: Array, steps: Array) -> float:
    """Return how much of a step keeps the values above zero, at most all of it."""
    fastest = float((steps / values).min())
    return min(1.0, INSIDE / -fastest) if fastest < 0.0 else 1.0
