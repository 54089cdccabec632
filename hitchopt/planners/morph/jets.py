"""Products, compositions and interpolation of jets: values with derivatives by one parameter."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from hitchopt.hitch.series import Series
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices


def product(a: Array, b: Array) -> Array:
    """Return the jet (…, m) of a·b; both have equally many axes."""
    return (Series.of_jet(a) * Series.of_jet(b)).jet


def chained(outer: Array, inner: Array) -> Array:
    """Return the jet (…, 4) of f(g(t)) in t by Faà di Bruno's formula.

    Parameters
    ----------
    outer: (…, 4), derivatives of f at g(t).
    inner: (…, 4), derivatives of g at t.
    """
    return np.stack(np.broadcast_arrays(outer[..., 0], *chained_rates(outer, inner)), axis=-1)


def chained_rates(outer: Array, inner: Array) -> tuple[Array, Array, Array]:
    """Return the first three derivatives (…) of f(g(t)), with arguments as in ``chained``."""
    f1, f2, f3 = outer[..., 1], outer[..., 2], outer[..., 3]
    g1, g2, g3 = inner[..., 1], inner[..., 2], inner[..., 3]
    return f1 * g1, f2 * g1**2 + f1 * g2, f3 * g1**3 + 3.0 * f2 * g1 * g2 + f1 * g3


def polynomials_through(breaks: Array, jets: Array) -> PiecewisePolynomial:
    """Return the polynomials with jets (J, *shape, m) at breaks (J,), of degree 2m - 1."""
    orders = np.moveaxis(jets, -1, 0)
    return PiecewisePolynomial.hermite(breaks, orders[:, :-1], orders[:, 1:])


def divided(breaks: Array, counts: Indices) -> Array:
    """Return breakpoints (J,) with pieces divided into ``counts`` (J - 1,) equal parts each."""
    each = zip(breaks[:-1], breaks[1:], counts, strict=True)
    inner = [np.linspace(first, last, count, endpoint=False) for first, last, count in each]
    return np.append(np.concatenate(inner), breaks[-1])


def quintic_spline(s: Array, values: Array, zero_orders: tuple[int, int]) -> BSpline:
    """Return the quintic spline through values (J, *shape) at s (J,).

    Parameters
    ----------
    zero_orders: orders of the two derivatives that vanish at both ends: (1, 2) at rest, (2, 3)
        straight, (3, 4) for a natural spline.
    """
    zero = np.zeros(values.shape[1:])
    ends = [(order, zero) for order in zero_orders]  # the stubs allow one condition per end
    return make_interp_spline(s, values, k=5, bc_type=(ends, ends))  # type: ignore[arg-type]
