"""Products, compositions and interpolation of jets: values with derivatives by one parameter."""

from __future__ import annotations

import numpy as np

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
    first, second, third = chained_rates(outer, inner)
    jets = np.empty((*third.shape, 4), third.dtype)
    for k, each in enumerate((outer[..., 0], first, second, third)):
        jets[..., k] = each
    return jets


def chained_rates(outer: Array, inner: Array) -> tuple[Array, Array, Array]:
    """Return the first three derivatives (…) of f(g(t)), with arguments as in ``chained``."""
    f1, f2, f3 = outer[..., 1], outer[..., 2], outer[..., 3]
    g1, g2, g3 = inner[..., 1], inner[..., 2], inner[..., 3]
    return f1 * g1, f2 * g1**2 + f1 * g2, f3 * g1**3 + 3.0 * f2 * g1 * g2 + f1 * g3


def polynomials_through(breaks: Array, jets: Array) -> PiecewisePolynomial:
    """Return the polynomials with jets (J, *shape, m) at breaks (J,), of degree 2m - 1."""
    orders = jets.transpose(-1, *range(jets.ndim - 1))
    return PiecewisePolynomial.hermite(breaks, orders[:, :-1], orders[:, 1:])


def divided(breaks: Array, counts: Indices) -> Array:
    """Return breakpoints (J,) with pieces divided into ``counts`` (J - 1,) equal parts each."""
    each = zip(breaks[:-1], breaks[1:], counts, strict=True)
    inner = [np.linspace(first, last, count, endpoint=False) for first, last, count in each]
    return np.append(np.concatenate(inner), breaks[-1])
