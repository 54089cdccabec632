from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import SAME_BREAK, merged_breaks, on_breaks


def made(seed: int) -> PiecewisePolynomial:
    rng = np.random.default_rng(seed)
    breaks = np.cumsum(rng.uniform(0.1, 1.0, 5)) - 0.3
    return PiecewisePolynomial(breaks, rng.normal(size=(4, 2, 3, 6)))


@given(st.integers(0, 50), st.lists(st.floats(0.0, 1.0), max_size=8))
def test_the_same_values_on_finer_breaks(seed: int, shares: list[float]) -> None:
    part = made(seed)
    extra = part.breaks[0] + np.array(shares, dtype=np.float64) * part.duration
    breaks = merged_breaks([part.breaks, extra])
    assert set(part.breaks) <= set(breaks)
    finer = on_breaks(part, breaks)
    # Not at breaks, where these parts jump: a time there belongs to either side.
    t = np.sort(np.random.default_rng(seed).uniform(part.breaks[0], part.breaks[-1], 200))
    t = t[np.min(np.abs(t[:, None] - breaks), axis=1) > 1e-6]
    for order in range(3):
        np.testing.assert_allclose(finer.at(t, order), part.at(t, order), rtol=1e-6, atol=1e-6)


def test_a_span_within_the_part() -> None:
    part = made(3)
    breaks = np.array([part.breaks[1] + 0.01, part.breaks[2], part.breaks[2] + 0.02])
    cut = on_breaks(part, breaks)
    assert np.array_equal(cut.breaks, breaks)
    middle = 0.5 * (breaks[1:] + breaks[:-1])
    np.testing.assert_allclose(cut.at(middle), part.at(middle), atol=1e-13)


def test_nothing_changes_on_the_same_breaks() -> None:
    part = made(4)
    assert np.array_equal(on_breaks(part, part.breaks).coefficients, part.coefficients)


@given(st.lists(st.floats(0.0, 10.0), min_size=2, max_size=9, unique=True))
def test_breaks_close_to_the_first_ones_are_left_out(times: list[float]) -> None:
    first = np.array([0.0, 3.0, 10.0])
    other = np.sort(np.array(times))
    merged = merged_breaks([first, other])
    assert np.all(np.diff(merged) > 0.0)
    for t in merged:
        assert t in first or np.min(np.abs(first - t)) > SAME_BREAK
    for t in other:
        assert np.min(np.abs(merged - t)) <= SAME_BREAK
