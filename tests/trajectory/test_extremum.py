"""Branch and bound: the answer is beyond every sample, near to the best, and always comes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.trajectory import bernstein, extremum
from hitchopt.trajectory.extremum import Cells, Estimate, Search, largest, smallest

Array = np.ndarray


def lowest(blocks: tuple[Array, ...]) -> Estimate:
    """The bound of the first row's own smallest value."""
    (rows,) = blocks
    c = rows[:, 0]
    x = np.argmin(c, axis=-1) / max(1, c.shape[-1] - 1)
    return Estimate(np.min(c, axis=-1), bernstein.evaluate(c, x), x)


def highest(blocks: tuple[Array, ...]) -> Estimate:
    return lowest(tuple(-block for block in blocks)).negated()


def curves(seed: int, pieces: int, items: int, order: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    breaks = 1.5 + np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
    return breaks, rng.normal(size=(pieces, items, 1, order + 1))


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 5), st.integers(0, 9))
def test_polynomials_against_their_stationary_points(
    seed: int, pieces: int, items: int, order: int
) -> None:
    breaks, c = curves(seed, pieces, items, order)
    found = smallest(Cells.over(breaks, [c]), lowest)
    best = math.inf
    for rows in c.reshape(-1, order + 1):
        powers = sum(
            value
            * math.comb(order, i)
            * np.polynomial.Polynomial([0.0, 1.0]) ** i
            * np.polynomial.Polynomial([1.0, -1.0]) ** (order - i)
            for i, value in enumerate(rows)
        )
        roots = np.atleast_1d(powers.deriv().roots())
        real = np.real(roots[np.abs(np.imag(roots)) < 1e-7])
        inside = np.concatenate([real[(real > 0.0) & (real < 1.0)], [0.0, 1.0]])
        best = min(best, float(np.min(powers(inside))))
    assert found.worst <= best + 1e-9
    assert found.worst == pytest.approx(best, rel=2e-4, abs=1e-6)
    there = []
    for piece in range(pieces):  # two of them at a joint
        x = (found.time - breaks[piece]) / (breaks[piece + 1] - breaks[piece])
        if -1e-9 < x < 1.0 + 1e-9:
            there.append(float(bernstein.evaluate(c[piece, found.item, 0], x)))
    assert min(abs(value - found.value) for value in there) < 1e-6


def test_the_largest_is_the_smallest_of_the_negative() -> None:
    breaks, c = curves(3, 3, 4, 6)
    high = largest(Cells.over(breaks, [c]), highest)
    low = smallest(Cells.over(breaks, [-c]), lowest)
    assert (high.worst, high.value, high.item, high.time) == (
        -low.worst,
        -low.value,
        low.item,
        low.time,
    )


def test_margins_move_the_answer_outward_by_their_own_cells_only() -> None:
    breaks = np.array([0.0, 1.0, 2.0])
    c = np.array([3.0, 5.0]).reshape(2, 1, 1, 1)
    small = smallest(Cells.over(breaks, [c], np.array([[0.25], [0.5]])), lowest)
    assert small.worst == 2.75
    assert small.value == 3.0
    both = smallest(Cells.over(breaks, [c], np.array([[0.25], [4.0]])), lowest)
    assert both.worst == 1.0  # not even a cell that seemed settled may be forgotten


def test_cells_in_portions_are_the_same_as_all_at_once() -> None:
    breaks, c = curves(5, 6, 300, 7)
    whole = smallest(Cells.over(breaks, [c]), lowest)
    search = Search(lowest)
    for i in range(6):
        search.add(Cells.over(breaks[i : i + 2], [c[i : i + 1]]))
    found = search.finish()
    assert found.worst == pytest.approx(whole.worst, rel=2e-4)
    assert found.item == whole.item


def test_batches_do_not_change_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    breaks, c = curves(6, 5, 40, 7)
    whole = smallest(Cells.over(breaks, [c]), lowest)
    monkeypatch.setattr(extremum, "BATCH", 7)
    again = smallest(Cells.over(breaks, [c]), lowest)
    assert again.worst == pytest.approx(whole.worst, rel=2e-4)
    assert again.item == whole.item


def test_rows_of_different_degrees_are_halved_alike() -> None:
    """The smallest of a(t) b(t) with a of degree 2 and b of degree 5."""

    def product(blocks: tuple[Array, ...]) -> Estimate:
        return lowest((bernstein.multiply(*blocks),))

    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(1, 4, 1, 3)), rng.normal(size=(1, 4, 1, 6))
    found = smallest(Cells.over(np.array([0.0, 1.0]), [a, b]), product)
    x = np.linspace(0.0, 1.0, 20_001)
    best = min(
        float(np.min(bernstein.evaluate(a[0, i, 0], x) * bernstein.evaluate(b[0, i, 0], x)))
        for i in range(4)
    )
    assert found.worst <= best
    assert found.worst == pytest.approx(best, rel=2e-4)


def test_thousands_of_equal_curves_cost_no_more_than_a_few_halvings() -> None:
    one = np.array([1.0, 0.2, 0.9, 0.1, 1.0])
    c = np.broadcast_to(one, (10, 500, 1, 5))
    search = Search(lowest)
    search.add(Cells.over(np.arange(11.0), [c]))
    search.finish()
    assert search.looked_at < 20 * 5000


def test_a_bound_that_never_comes_close_still_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extremum, "MAX_CELLS", 2000)
    _, c = curves(9, 1, 3, 4)

    def loose(blocks: tuple[Array, ...]) -> Estimate:
        tight = lowest(blocks)
        return Estimate(tight.bound - 1.0, tight.value, tight.x)

    search = Search(loose)
    search.add(Cells.over(np.array([0.0, 1.0]), [c]))
    found = search.finish()
    exact = smallest(Cells.over(np.array([0.0, 1.0]), [c]), lowest)
    assert search.looked_at < 20_000
    assert exact.worst - 2.0 < found.worst <= exact.worst - 1.0 + 1e-3


@pytest.mark.parametrize("broken", ["bound", "value"])
def test_what_is_no_number_is_as_bad_as_can_be(broken: str) -> None:
    def nothing(blocks: tuple[Array, ...]) -> Estimate:
        tight = lowest(blocks)
        none = np.full_like(tight.bound, np.nan)
        if broken == "bound":
            return Estimate(none, tight.value, tight.x)
        return Estimate(tight.bound, none, tight.x)

    breaks, c = curves(10, 2, 3, 4)
    assert smallest(Cells.over(breaks, [c]), nothing).worst == -math.inf


def test_no_cells_bound_nothing() -> None:
    found = smallest(Cells.over(np.array([0.0, 1.0]), [np.zeros((1, 0, 1, 3))]), lowest)
    assert found.worst == math.inf
    assert found.item == -1
