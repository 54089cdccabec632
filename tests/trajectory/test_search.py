"""Branch and bound: the answer bounds every sample, is close to the best, and always ends."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import BranchAndBound, Extremum, Formula, TimeSpans, worst
from tests.helpers.powers import in_powers

Array = np.ndarray


class Curves(TimeSpans):
    """Spans of scalar curves (pieces, items, degree + 1)."""

    @property
    def curve(self) -> Enclosed:
        return Enclosed(self.read(self.source)[:, None])


def curves(seed: int, pieces: int, items: int, order: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    breaks = 1.5 + np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
    return breaks, rng.normal(size=(pieces, items, order + 1))


def above(spans: Curves) -> Bound:
    return spans.curve.upper


def below(spans: Curves) -> Bound:
    return spans.curve.lower


def extreme(
    breaks: Array,
    c: Array,
    sense: str = "min",
    formula: Formula[Curves] | None = None,
    mask: Array | None = None,
    **options: float,
) -> Extremum:
    formula = formula or (below if sense == "min" else above)
    return worst(Curves.all_of(c, breaks, c.shape[1], mask), formula, sense, **options)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 5), st.integers(0, 9))
def test_polynomials_against_their_stationary_points(
    seed: int, pieces: int, items: int, order: int
) -> None:
    breaks, c = curves(seed, pieces, items, order)
    result = extreme(breaks, c)
    best = math.inf
    for rows in c.reshape(-1, order + 1):
        powers = in_powers(rows)
        roots = np.atleast_1d(powers.deriv().roots())
        real = np.real(roots[np.abs(np.imag(roots)) < 1e-7])
        inside = np.concatenate([real[(real > 0.0) & (real < 1.0)], [0.0, 1.0]])
        best = min(best, float(np.min(powers(inside))))
    assert result.worst <= best + 1e-9
    assert result.worst == pytest.approx(best, rel=2e-4, abs=1e-6)
    there = []
    for piece in range(pieces):  # two of them at a joint
        x = (result.time - breaks[piece]) / (breaks[piece + 1] - breaks[piece])
        if -1e-9 < x < 1.0 + 1e-9:
            there.append(float(bernstein.evaluate(c[piece, result.item], x)))
    assert min(abs(value - result.value) for value in there) < 1e-6


def test_maximum_is_the_negated_minimum_of_the_negative() -> None:
    breaks, c = curves(3, 3, 4, 6)
    high, low = extreme(breaks, c, "max"), extreme(breaks, -c)
    assert (high.worst, high.value, high.item) == (-low.worst, -low.value, low.item)
    assert high.time == low.time


def test_the_worst_of_many_batches_is_the_worst_of_their_parts() -> None:
    breaks, c = curves(6, 5, 4000, 7)  # 20,000 spans
    whole = extreme(breaks, c)
    parts = [extreme(breaks, c[:, first : first + 500]) for first in range(0, 4000, 500)]
    index = min(range(len(parts)), key=lambda k: parts[k].worst)
    assert whole.item == 500 * index + parts[index].item
    assert whole.worst == pytest.approx(parts[index].worst, rel=2e-4)


@pytest.mark.parametrize("count", [0, 3, 200])
def test_spans_read_the_parts_of_curves_that_they_cover(count: int) -> None:
    """Those of few spans are read by matrices, which are exact at the ends of pieces."""
    breaks, c = curves(5, 4, 6, 7)
    vectors = np.stack([c, c[::-1]], axis=2)
    rng = np.random.default_rng(count)
    piece, item = rng.integers(0, 4, count), rng.integers(0, 6, count)
    extent = np.sort(rng.uniform(0.0, 1.0, (2, count)), axis=0)
    extent[:, :2] = np.array([[0.0], [1.0]])
    read = TimeSpans(None, breaks, piece, item, extent).read(vectors)
    assert read.shape == (count, 2, 8)
    lower, upper = extent[..., None]
    np.testing.assert_allclose(
        read, bernstein.restrict(vectors[piece, item], lower, upper), atol=1e-14
    )
    np.testing.assert_array_equal(read[:2], vectors[piece, item][:2])


def test_masks_select_spans() -> None:
    breaks, c = curves(7, 3, 4, 5)
    mask = np.zeros((3, 4), dtype=bool)
    mask[1, 2] = True
    result = extreme(breaks, c, "max", mask=mask)
    assert result.item == 2
    assert breaks[1] <= result.time <= breaks[2]
    assert result.value <= np.max(c[1, 2])
    none = extreme(breaks, c, "max", mask=~mask & mask)
    assert (none.worst, none.item) == (-math.inf, -1)


def test_a_target_that_all_values_satisfy_is_enough() -> None:
    breaks, c = curves(8, 4, 30, 7)
    counted: list[int] = []

    def formula(spans: Curves) -> Bound:
        counted.append(len(spans))
        return above(spans)

    exact = extreme(breaks, c, "max", formula)
    evaluations, high = sum(counted), float(np.max(c))
    counted.clear()
    rough = extreme(breaks, c, "max", formula, target=high)
    assert sum(counted) <= evaluations
    assert exact.worst <= rough.worst <= high
    assert extreme(breaks, c, "max", formula, incumbent=high).item == -1


def test_thousands_of_equal_curves_cost_few_halvings() -> None:
    c = np.broadcast_to([1.0, 0.2, 0.9, 0.1, 1.0], (10, 500, 5))
    minimum: BranchAndBound[Curves] = BranchAndBound(below, "min")
    for spans in Curves.all_of(c, np.arange(11.0), 500):
        minimum.add(spans)
    minimum.finish()
    assert minimum.evaluated < 20 * 5000


def test_loose_bounds_still_end() -> None:
    breaks, c = curves(9, 2, 3, 5)

    def loose(spans: Curves) -> Bound:
        result = above(spans)
        return result if spans.points else Bound(result.value + 7.0, result.x)

    result = extreme(breaks, c, "max", loose)
    assert result.worst > result.value + 6.9


def test_nan_is_the_worst_value() -> None:
    breaks, c = curves(10, 2, 3, 5)
    c[1, 1, 2] = math.nan
    assert extreme(breaks, c).worst == -math.inf
    assert extreme(breaks, c, "max").worst == math.inf


def test_bounds_are_as_tight_as_the_limit_requires() -> None:
    """Bound 1 + x on [0, 1] within 1e-4, and closer if that decides."""

    def loose(spans: Curves) -> Bound:
        c = spans.curve.c[:, 0]
        return Bound(np.min(c, axis=-1) - np.ptp(c, axis=-1), np.zeros(len(c)))

    def result(target: float = math.nan) -> float:
        line = np.array([0.0, 1.0]), np.array([[[1.0, 1.5, 2.0]]])
        return extreme(*line, formula=loose, target=target).worst

    assert 1.0 - 1e-4 <= result() < 1.0 - 1e-9
    assert result(1.0 - 1e-9) >= 1.0 - 1e-9
    assert result(1.5) < 1.0  # the target is violated
