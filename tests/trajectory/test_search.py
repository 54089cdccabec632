"""Branch and bound: the answer is beyond every sample, near to the best, and always comes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from powers import in_powers

from hitchopt.trajectory import bernstein, search
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import Extremum, Formula, Search, Spans, worst

Array = np.ndarray


class Curves(Spans):
    """Spans of scalar curves (pieces, items, degree + 1)."""

    @property
    def curve(self) -> Enclosed:
        return Enclosed(self.read(self.source)[:, None])


def curves(seed: int, pieces: int, items: int, order: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    breaks = 1.5 + np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
    return breaks, rng.normal(size=(pieces, items, order + 1))


def above(spans: Curves) -> Bound:
    return spans.curve.above


def below(spans: Curves) -> Bound:
    return spans.curve.below


def extreme(
    breaks: Array,
    c: Array,
    sense: str = "min",
    formula: Formula[Curves] | None = None,
    on: Array | None = None,
    **options: float,
) -> Extremum:
    formula = formula or (below if sense == "min" else above)
    return worst(Curves.all_of(c, breaks, c.shape[1], on), formula, sense, **options)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 5), st.integers(0, 9))
def test_polynomials_against_their_stationary_points(
    seed: int, pieces: int, items: int, order: int
) -> None:
    breaks, c = curves(seed, pieces, items, order)
    found = extreme(breaks, c)
    best = math.inf
    for rows in c.reshape(-1, order + 1):
        powers = in_powers(rows)
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
            there.append(float(bernstein.evaluate(c[piece, found.item], x)))
    assert min(abs(value - found.value) for value in there) < 1e-6


def test_the_largest_is_the_smallest_of_the_negative() -> None:
    breaks, c = curves(3, 3, 4, 6)
    high, low = extreme(breaks, c, "max"), extreme(breaks, -c)
    assert (high.worst, high.value, high.item) == (-low.worst, -low.value, low.item)
    assert high.time == low.time


def test_batches_and_portions_do_not_change_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    breaks, c = curves(6, 5, 40, 7)
    whole = extreme(breaks, c)
    monkeypatch.setattr(search, "BATCH", 7)
    again = extreme(breaks, c)
    assert again.item == whole.item
    assert again.worst == pytest.approx(whole.worst, rel=2e-4)


def test_chosen_spans_are_all_that_counts() -> None:
    breaks, c = curves(7, 3, 4, 5)
    on = np.zeros((3, 4), dtype=bool)
    on[1, 2] = True
    found = extreme(breaks, c, "max", on=on)
    assert found.item == 2
    assert breaks[1] <= found.time <= breaks[2]
    assert found.value <= np.max(c[1, 2])
    none = extreme(breaks, c, "max", on=~on & on)
    assert (none.worst, none.item) == (-math.inf, -1)


def test_a_target_that_all_keep_is_enough() -> None:
    breaks, c = curves(8, 4, 30, 7)
    counted: list[int] = []

    def formula(spans: Curves) -> Bound:
        counted.append(len(spans))
        return above(spans)

    near = extreme(breaks, c, "max", formula)
    many, high = sum(counted), float(np.max(c))
    counted.clear()
    rough = extreme(breaks, c, "max", formula, target=high)
    assert sum(counted) <= many
    assert near.worst <= rough.worst <= high
    assert extreme(breaks, c, "max", formula, known=high).item == -1


def test_thousands_of_equal_curves_cost_no_more_than_a_few_halvings() -> None:
    c = np.broadcast_to([1.0, 0.2, 0.9, 0.1, 1.0], (10, 500, 5))
    many: Search[Curves] = Search(below, "min")
    for spans in Curves.all_of(c, np.arange(11.0), 500):
        many.add(spans)
    many.finish()
    assert many.evaluated < 20 * 5000


def test_a_bound_that_never_comes_close_still_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "MAX_SPANS", 300)
    breaks, c = curves(9, 2, 3, 5)

    def loose(spans: Curves) -> Bound:
        found = above(spans)
        return found if spans.points else Bound(found.value + 7.0, found.x)

    found = extreme(breaks, c, "max", loose)
    assert found.worst > found.value + 6.9


def test_what_is_no_number_is_as_bad_as_can_be() -> None:
    breaks, c = curves(10, 2, 3, 5)
    c[1, 1, 2] = math.nan
    assert extreme(breaks, c).worst == -math.inf
    assert extreme(breaks, c, "max").worst == math.inf


def test_a_bound_is_as_close_as_the_limit_asks() -> None:
    """1 + x on [0, 1]: within 1e-4 of it usually, closer where that decides."""

    def loose(spans: Curves) -> Bound:
        c = spans.curve.c[:, 0]
        return Bound(np.min(c, axis=-1) - np.ptp(c, axis=-1), np.zeros(len(c)))

    def found(target: float = math.nan) -> float:
        line = np.array([0.0, 1.0]), np.array([[[1.0, 1.5, 2.0]]])
        return extreme(*line, formula=loose, target=target).worst

    assert 1.0 - 1e-4 <= found() < 1.0 - 1e-9
    assert found(1.0 - 1e-9) >= 1.0 - 1e-9
    assert found(1.5) < 1.0  # no help where the limit is broken
