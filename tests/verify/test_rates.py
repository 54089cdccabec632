"""What bounds how fast quantities change is no smaller than what they do."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hitchopt import verify as second
from hitchopt.verify import Curve, Line, Spans

FORMULAS: dict[str, Callable[[Line, Line], Line]] = {
    "product": lambda x, y: x * y.dot(x) + y * 2.0 - 1.0,
    "norm": lambda x, _: x.norm(),
    "direction": lambda x, _: x.unit(),
    "inverse": lambda x, _: x.norm().inverse(),
    "angle": second.angle,
    "turning": lambda x, y: x.cross(y) * x.dot(x).inverse(),
    "clipped": lambda x, _: second.least(second.largest(x[0], 2.0), 2.1),
    "joined": lambda x, y: second.joined(x[0] * y[1], y[2], x.norm()) * second.UP,
    "least": lambda x, y: second.least(x[0], y[1], -x[2]),
}


pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
"""What is not known of a wide span is infinite, or not a number."""


def spans(seed: int, width: float, offset: float) -> Spans:
    """Return spans of polynomials; cables hang between them."""
    rng = np.random.default_rng(seed)
    plan: Any = SimpleNamespace(h=np.array([0.7, 1.3]), breaks=np.array([0.0, 0.7, 2.0]))
    plan.points = Curve(rng.normal(size=(2, 8, 3, 6)) + offset, plan.h)
    plan.length = np.full((8, 1), 60.0)
    piece, item = np.repeat([0, 1], 4), np.tile(np.arange(4), 2)[:, None]
    return Spans(plan, piece, item, rng.uniform(width, 1.0 - width, size=8), np.full(8, width))


@pytest.mark.parametrize("width", [0.1, 0.01, 0.001])
@pytest.mark.parametrize("formula", FORMULAS)
def test_values_and_slopes_stay_within_their_bounds(formula: str, width: float) -> None:
    make = FORMULAS[formula]
    for seed in range(5):
        s = spans(seed, width, 2.0)
        i = s.item[:, 0]
        found, far = make(s.point(i), s.point(i + 4)), np.zeros(8)
        for share in np.linspace(-1.0, 1.0, 41):
            there = s.within(float(share), 1e-9)
            now = make(there.point(i), there.point(i + 4))
            far = np.maximum(far, second.size(now.v - found.v))
            assert not np.any(second.size(now.g - found.g) > found.q * (1.0 + 1e-9) + 1e-9)
        assert not np.any(far > found.reach * (1.0 + 1e-9) + 1e-12)
        if width == 0.001:  # and they are of use
            assert np.median(found.reach / np.maximum(far, 1e-9)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.1, 0.01])
def test_hanging_cables_move_no_farther_than_told(
    width: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(second, "LINKS", 200)
    for seed in range(2):
        s = spans(seed, width, 0.0)
        k = s.item[:, 0]
        cable, _, far = second.hanging_links(s, k)
        lowest, pull = second.lowest(s, k), second.hanging_pull(s, 2 * k)
        length = sum(second.size(b.v - a.v) for a, b in pairwise(cable))
        assert length == pytest.approx(60.0 * np.ones(8), rel=0.01)
        for share in np.linspace(-1.0, 1.0, 5):
            there = s.within(float(share), 1e-9)
            for x in second.hanging_links(there, k)[0][::40]:
                ways = [second.closest(x.v, x.v, a.v, b.v) for a, b in pairwise(cable)]
                apart = np.min([second.size(way) for way in ways], axis=0)
                assert not np.any(
                    apart > far[:, 0] + np.max([y.reach for y in cable], axis=0) + 1e-9
                )
            assert not np.any(second.lowest(there, k).v[:, 0] < lowest.low - 1e-9)
            off = second.hanging_pull(there, 2 * k).v - pull.v
            assert not np.any(second.size(off) > pull.reach)
