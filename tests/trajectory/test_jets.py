"""Jets: rates of all operations, compared with differences of values in time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.jets import Jet
from hitchopt.values import Array

STEP = 1e-5  # of differences

OPERATIONS: dict[str, Callable[[Jet, Jet, Jet], Jet]] = {
    "sum": lambda x, y, _: x + y,
    "difference": lambda x, y, _: x - y * 2.0,
    "constants": lambda x, _y, _a: (
        1.0 - (x * np.array([[2.0, 1.0, 0.5]]) + np.array([0.1, 0.2, 0.3]))
    ),
    "product": lambda x, _, a: x * a,
    "by component": lambda x, y, _: x * y,
    "dot": lambda x, y, _: x.dot(y),
    "norm": lambda x, _y, _a: x.norm,
    "direction": lambda x, _y, _a: x.direction,
    "inverse": lambda _x, _y, a: a.inverse,
    "root": lambda _x, _y, a: a.root,
    "components": lambda x, y, _: (x.xy * y[2]).with_z(x[0]) + y[1].along_z(),
    "low degree": lambda x, y, _: (x * y).reduced(5),
}


def curves(seed: int) -> tuple[Array, Array, Array]:
    """Return two vectors (spans, 3, 6) that do not vanish, and a positive scalar (spans, 1, 6)."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.01, 0.01, (2, 4, 3, 6)) + rng.uniform(0.8, 1.2, (2, 4, 3, 1))
    return x, y, rng.uniform(0.99, 1.01, (4, 1, 6))


def at(c: Array, s: float) -> Array:
    """Return the values (spans, components) of polynomials at a parameter."""
    values: Array = c @ bernstein.basis(np.array([s]), c.shape[-1] - 1)[0]
    return values


@pytest.mark.parametrize("name", OPERATIONS)
def test_rates_are_those_of_values(name: str) -> None:
    operation = OPERATIONS[name]
    polynomials = curves(7)
    jets = [Jet(Enclosed(c), Enclosed(bernstein.differentiate(c))) for c in polynomials]
    result = operation(*jets)

    def value(s: float) -> Array:
        """Return the value at a parameter, a span of no length."""
        points = [Enclosed(at(c, s)[..., None]) for c in polynomials]
        zero = [Enclosed(np.zeros_like(point.c)) for point in points]
        return operation(*map(Jet, points, zero)).value.c[..., 0]

    for s in (0.1, 0.5, 0.83):
        slope = (value(s + STEP) - value(s - STEP)) / (2.0 * STEP)
        for enclosed, expected in ((result.value, value(s)), (result.rate, slope)):
            error = np.linalg.norm(at(enclosed.c, s) - expected, axis=-1)
            assert np.all(error <= enclosed.r + 1e-8), name
            assert np.all(np.asarray(enclosed.r) < 0.02)
