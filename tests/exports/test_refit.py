from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from exported_plans import hitch_plan
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.exports.recording import lasted
from hitchopt.exports.refit.piece_fitting import (
    NODES,
    Kind,
    Scale,
    SpanErrors,
    best_breaks,
    fitted,
    greedy_breaks,
)
from hitchopt.exports.refit.point_rounding import rounded
from hitchopt.trajectory import PiecewisePolynomial, bernstein

SEPTIC = Kind(degree=7, match=3, quantum=1.0 / 1024.0, longest=60.0)
CUBIC = Kind(degree=3, match=2, quantum=1e-3, longest=60.0)


@pytest.mark.parametrize("kind", [SEPTIC, CUBIC], ids=["septic", "cubic"])
def test_ends_are_the_plan_s(kind: Kind) -> None:
    curves = hitch_plan().drones
    breaks = np.linspace(0.0, curves.duration, 9)
    fit = fitted(curves, breaks, kind)
    for order in range(kind.match):
        left, right = fit.ends(order)
        np.testing.assert_allclose(left, curves.at(breaks[:-1], order), atol=1e-7)
        np.testing.assert_allclose(right, curves.at(breaks[1:], order), atol=1e-7)


@given(st.integers(0, 20))
def test_polynomials_of_the_degree_are_met_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = PiecewisePolynomial(np.array([0.0, 2.0]), rng.normal(size=(1, 2, 3, 8)))
    fit = fitted(whole, np.array([0.0, 0.3, 1.1, 2.0]), SEPTIC)
    t = rng.uniform(0.0, 2.0, 40)
    np.testing.assert_allclose(fit.at(t), whole.at(t), atol=1e-9)
    assert SpanErrors(whole, SEPTIC, Scale())(0.2, 1.7) < 1e-6


@settings(max_examples=20)
@given(st.integers(0, 100))
def test_no_other_inner_coefficients_are_nearer(seed: int) -> None:
    curves = hitch_plan().drones
    breaks = np.array([0.1, 0.6])
    fit = fitted(curves, breaks, SEPTIC)
    t = breaks[0] + bernstein.nodes(NODES - 1) * np.diff(breaks)
    best = np.sum((fit.at(t) - curves.at(t)) ** 2)
    other = np.array(fit.coefficients)
    other[..., 3:5] += np.random.default_rng(seed).normal(size=other[..., 3:5].shape) * 1e-5
    worse = PiecewisePolynomial(breaks, other)
    assert np.sum((worse.at(t) - curves.at(t)) ** 2) > best


@pytest.mark.parametrize("kind", [SEPTIC, CUBIC], ids=["septic", "cubic"])
def test_the_error_of_a_span_is_that_of_its_fit(kind: Kind) -> None:
    curves = hitch_plan().drones
    scale = Scale(2e-3, 3e-2, 0.4)
    start, end = 0.13, 0.57
    fit = fitted(curves, np.array([start, end]), kind)
    t = start + bernstein.nodes(NODES - 1)[1:-1] * (end - start)
    expected = max(
        float(np.max(np.linalg.norm(fit.at(t, k) - curves.at(t, k), axis=-1))) / size
        for k, size in enumerate((scale.position, scale.velocity, scale.acceleration))
    )
    # The ends themselves count too: there cubics miss the acceleration.
    assert SpanErrors(curves, kind, scale)(start, end) >= expected * (1.0 - 1e-9)
    if kind is SEPTIC:
        assert SpanErrors(curves, kind, scale)(start, end) == pytest.approx(expected, rel=1e-6)


def test_breaks_are_whole_quanta_and_each_span_keeps_the_bound() -> None:
    curves = hitch_plan().drones
    error = SpanErrors(lasted(curves, curves.duration + CUBIC.quantum), CUBIC, Scale())
    breaks = greedy_breaks(error, curves.duration, CUBIC, 0.5, 10_000)
    assert breaks is not None
    ticks = breaks / CUBIC.quantum
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-6)
    assert breaks[0] == 0.0
    assert 0.0 <= breaks[-1] - curves.duration < CUBIC.quantum
    for start, end in pairwise(breaks):
        assert error(start, end) <= 0.5 or end - start < 1.5 * CUBIC.quantum
    assert greedy_breaks(error, curves.duration, CUBIC, 0.5, len(breaks) - 2) is None


@pytest.mark.parametrize("duration", [0.05, 0.15, 0.25, 1.0, 3.021])
def test_no_piece_is_shorter_than_it_may_be(duration: float) -> None:
    """However large the error, and whatever remains at the end; a shorter curve is one piece."""
    kind = replace(CUBIC, shortest=0.1)

    def hopeless(start: float, end: float) -> float:
        return 9.0 + end - start

    breaks = greedy_breaks(hopeless, duration, kind, 0.5, 10_000)
    assert breaks is not None
    assert breaks[0] == 0.0
    assert breaks[-1] == pytest.approx(duration, abs=CUBIC.quantum)
    assert np.min(np.diff(breaks)) >= min(0.1, duration) - 1e-9


def test_more_pieces_fit_better() -> None:
    curves = hitch_plan().drones
    errors = []
    for most in (4, 8, 16, 31):
        breaks = best_breaks(curves, SEPTIC, most)
        assert breaks is not None
        assert len(breaks) - 1 <= most
        fit = fitted(lasted(curves, float(breaks[-1])), breaks, SEPTIC)
        t = np.linspace(0.0, curves.duration, 2000)
        errors.append(float(np.max(np.linalg.norm(fit.at(t) - curves.at(t), axis=-1))))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-5


def test_longest_pieces_are_kept_to() -> None:
    still = PiecewisePolynomial.constant([0.0, 200.0], np.ones((2, 3)), 7)
    kind = Kind(degree=7, match=3, quantum=1e-3, longest=65.0)
    breaks = best_breaks(still, kind, 31)
    assert breaks is not None
    assert np.max(np.diff(breaks)) <= 65.0 + 1e-9
    assert len(breaks) == 5


def test_rounded_together_is_better_than_each_alone() -> None:
    curves = hitch_plan().drones
    breaks = np.array([0.0, 0.31, 0.35, 0.73, 0.79])  # short pieces suffer most
    fit = fitted(curves, breaks, SEPTIC)
    scale = Scale(5e-4, 1e-2, 0.2)
    together = rounded(fit, 1e-3, scale)
    alone = PiecewisePolynomial(breaks, np.rint(fit.coefficients / 1e-3) * 1e-3)
    np.testing.assert_allclose(
        together.coefficients / 1e-3, np.rint(together.coefficients / 1e-3), atol=1e-9
    )
    left, right = together.ends()
    assert np.array_equal(left[1:], right[:-1])
    t = np.linspace(0.0, float(breaks[-1]), 3000)

    def noise(curve: PiecewisePolynomial) -> float:
        errors = [np.mean((curve.at(t, k) - fit.at(t, k)) ** 2) for k in range(3)]
        sizes = (scale.position, scale.velocity, scale.acceleration)
        return float(sum(e / size**2 for e, size in zip(errors, sizes, strict=True)))

    assert noise(together) < 0.2 * noise(alone)


def test_what_is_round_already_stays() -> None:
    rng = np.random.default_rng(1)
    c = rng.integers(-2000, 2000, size=(3, 2, 3, 8)).astype(np.float64)
    c[1:, ..., 0] = c[:-1, ..., -1]
    curves = PiecewisePolynomial(np.array([0.0, 0.4, 1.0, 1.3]), c * 1e-3)
    assert np.array_equal(rounded(curves, 1e-3, Scale()).coefficients, curves.coefficients)
