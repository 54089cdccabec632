"""What bounds how fast quantities change is no smaller than what they do."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hitchopt import verify

second: Any = verify  # its inner names have no types

SAMPLES = np.linspace(-1.0, 1.0, 41)

FORMULAS: dict[str, Callable[[Any, Any], Any]] = {
    "sum": lambda x, y: x + y * 2.0,
    "product": lambda x, y: x * y.dot(x),
    "cross": lambda x, y: x.cross(y),
    "norm": lambda x, _: x.norm(),
    "direction": lambda x, _: x.unit(),
    "inverse": lambda x, _: x.norm().inverse(),
    "turning": lambda x, y: x.cross(y) * x.dot(x).inverse(),
    "pull": lambda x, y: x.unit() * y.part(0) - y.unit() * x.part(2),
    "stacked": lambda x, y: second._stacked(x.part(0) * y.part(1), y.part(2), x.norm()),
}


def spans(seed: int, width: float, offset: float) -> tuple[Any, Any, Any]:
    """Return polynomials, and rows that are spans of them."""
    rng = np.random.default_rng(seed)
    h = np.array([0.7, 1.3])
    c = rng.normal(size=(2, 8, 3, 6)) + offset
    plan = SimpleNamespace(h=h, breaks=np.array([0.0, 0.7, 2.0]))
    p, i = np.repeat([0, 1], 4), np.tile(np.arange(4), 2)
    x = rng.uniform(width, 1.0 - width, size=8)
    return second.Poly(c, h), second.Rows(plan, p, x, np.full(8, width), i), c


@pytest.mark.parametrize("width", [0.1, 0.01, 0.001])
@pytest.mark.parametrize("formula", FORMULAS)
def test_values_stay_within_their_spread(formula: str, width: float) -> None:
    make = FORMULAS[formula]
    for seed in range(5):
        poly, rows, _ = spans(seed, width, 2.0)
        found = make(poly.jet(rows, rows.i), poly.jet(rows, rows.i + 4))
        largest = np.zeros(len(rows))
        for share in SAMPLES:
            x = rows.x + share * rows.w
            there = second.Rows(rows.plan, rows.p, x, 0.0 * rows.w, rows.i)
            value = make(poly.jet(there, rows.i), poly.jet(there, rows.i + 4)).v
            largest = np.maximum(largest, second._size(value - found.v))
        assert np.all(largest <= found.spread * (1.0 + 1e-9) + 1e-12)
        if width == 0.001:  # and they are of use
            assert np.median(found.spread / np.maximum(largest, 1e-9)) < 1.5


@pytest.mark.parametrize("width", [0.1, 0.01])
def test_hanging_cables_move_no_farther_than_told(width: float) -> None:
    for seed in range(5):
        poly, rows, c = spans(seed, width, 0.0)
        length = np.full(len(rows), 3.0 * np.max(np.abs(c)) * 2.0)
        hung = second.Hanging(poly.jet(rows, rows.i), poly.jet(rows, rows.i + 4), length)
        at, off = hung.points()
        lowest = hung.lowest()
        for share in SAMPLES[::5]:
            x = rows.x + share * rows.w
            there = second.Rows(rows.plan, rows.p, x, 0.0 * rows.w, rows.i)
            now = second.Hanging(poly.jet(there, rows.i), poly.jet(there, rows.i + 4), length)
            points, _ = now.points()
            gaps = [second.to_links(points[:, k], at) for k in range(points.shape[1])]
            assert np.all(np.max(gaps, axis=0) <= hung.moved + off + 1e-9)
            assert np.all(np.abs(now.lowest() - lowest) <= hung.moved + 1e-9)


def test_a_catenary_hangs_by_its_length() -> None:
    poly, rows, _ = spans(1, 0.1, 0.0)
    length = np.full(len(rows), 20.0)
    hung = second.Hanging(poly.jet(rows, rows.i), poly.jet(rows, rows.i + 4), length)
    at, off = hung.points(2000, 0)
    size = np.sum(np.sqrt(np.sum(np.diff(at, axis=1) ** 2, axis=-1)), axis=1)
    assert size == pytest.approx(length, rel=1e-4)
    assert np.all(off < 0.01)
    assert np.min(at[..., 2], axis=1) == pytest.approx(hung.lowest(), abs=1e-3)
