"""Motions at many times, by formulas of their own: what certificates are held against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly, PPoly

import hitchopt as ho

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion at some times.

    Attributes
    ----------
    positions, velocities, accelerations, jerks: of the drones q0, r0, … (J, 2n, 3), SI.
    vertices, vertex_velocities: (J, n, 3) [m], [m/s].
    """

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    vertices: Array
    vertex_velocities: Array


Sampler = Callable[[Array], Samples]
"""Gives the motion at times (J,) [s], ascending."""


def of_motion(motion: ho.Motion) -> Sampler:
    """Return the sampler of a plan's polynomials, in powers of each piece's own time."""
    drones, vertices = _powers(motion.drones), _powers(motion.vertices)

    def sample(t: Array) -> Samples:
        x, v, a, j = _evaluated(drones, t, 4)
        return Samples(x, v, a, j, *_evaluated(vertices, t, 2))

    return sample


def slowed(sample: Sampler, factor: float) -> Sampler:
    """Return the same motion flown so many times as slow."""

    def slow(t: Array) -> Samples:
        s = sample(t / factor)
        return Samples(
            s.positions,
            s.velocities / factor,
            s.accelerations / factor**2,
            s.jerks / factor**3,
            s.vertices,
            s.vertex_velocities / factor,
        )

    return slow


def _powers(part: ho.PiecewisePolynomial) -> PPoly:
    return PPoly.from_bernstein_basis(BPoly(np.moveaxis(part.coefficients, -1, 0), part.breaks))


def _evaluated(poly: PPoly, t: Array, count: int) -> list[Array]:
    """Return values and derivatives at ascending t, piece by piece: a product of matrices each."""
    pieces = np.clip(np.searchsorted(poly.x, t, side="right") - 1, 0, len(poly.x) - 2)
    shape = poly.c.shape[2:]
    out = [np.empty((len(t), int(np.prod(shape)))) for _ in range(count)]
    starts = np.flatnonzero(np.diff(pieces, prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(t)], strict=True):
        c = poly.c[:, pieces[first]].reshape(len(poly.c), -1)
        local = t[first:last] - poly.x[pieces[first]]
        for values in out:
            np.matmul(np.vander(local, len(c)), c, out=values[first:last])
            c = c[:-1] * np.arange(len(c) - 1, 0, -1)[:, None]
    return [values.reshape(len(t), *shape) for values in out]
