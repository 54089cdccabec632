"""Piecewise polynomials of time: derivatives, joints, and invalid arguments."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from hitchopt.errors import InputError
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.piecewise import (
    BREAK_TOLERANCE,
    MIN_SPACING,
    merged_breaks,
    on_breaks,
    on_spaced_breaks,
    spaced,
)
from hitchopt.trajectory.splines import bspline, evenly_interpolated, interpolated
from tests.helpers.refusals import assert_refused

BREAKS = np.array([0.5, 0.9, 2.0, 2.3])


def some(order: int = 4, seed: int = 0) -> PiecewisePolynomial:
    c = np.random.default_rng(seed).normal(size=(3, 2, 3, order + 1))
    return PiecewisePolynomial(BREAKS, c)


@pytest.mark.parametrize("order", [0, 1, 2, 4, 6])
def test_values_and_derivatives_match_scipy(order: int) -> None:
    part = some(order)
    exact = part.to_scipy()
    t = np.array([[0.5, 0.7, 0.9], [1.7, 2.1, 2.3]])
    jet, end, scale = part.jet(t, 4), part.end_jet(4), 1e-9
    assert (part.pieces, part.degree, part.shape, jet.shape) == (3, order, (2, 3), (2, 3, 2, 3, 4))
    for k in range(4):
        expected = exact.derivative(k)(t) if k <= order else np.zeros((2, 3, 2, 3))
        scale = max(scale, 1e-9 * float(np.max(np.abs(expected))))
        for result in (part.at(t, k), jet[..., k], part.differentiated(k).at(t)):
            np.testing.assert_allclose(result, expected, atol=scale)
        np.testing.assert_allclose(end[..., k], expected[-1, -1], atol=scale)
        left, right = part.ends(k)
        np.testing.assert_allclose(left[:2], expected[0, [0, 2]], atol=scale)
        np.testing.assert_allclose(right[-1], expected[-1, -1], atol=scale)
    assert part.duration == pytest.approx(1.8)
    assert part.at(1.0).shape == (2, 3)


def test_hermite_meets_every_derivative_at_both_ends() -> None:
    left, right = np.random.default_rng(3).normal(size=(2, 4, 3, 2))
    part = PiecewisePolynomial.hermite(BREAKS, left, right)
    assert part.degree == 7
    for j in range(4):
        for result, expected in zip(part.ends(j), (left[j], right[j]), strict=True):
            np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)


def test_stretching_slows_down_and_reversing_twice_is_the_identity() -> None:
    part = some()
    slow = part.stretched(3.0)
    t = np.array([0.7, 1.0, 2.2])
    np.testing.assert_allclose(slow.at(0.5 + 3.0 * (t - 0.5)), part.at(t), atol=1e-10)
    np.testing.assert_allclose(slow.at(0.5 + 3.0 * (t - 0.5), 2), part.at(t, 2) / 9.0, rtol=1e-9)
    back = part.reversed()
    np.testing.assert_allclose(back.at(2.8 - t), part.at(t), atol=1e-10)
    np.testing.assert_allclose(back.at(2.8 - t, 1), -part.at(t, 1), atol=1e-9)
    again = back.reversed()
    np.testing.assert_allclose(again.breaks, part.breaks)
    np.testing.assert_array_equal(again.coefficients, part.coefficients)


def test_joined_parts_follow_each_other_from_any_start() -> None:
    first, second = some(2), some(5, seed=1)
    both = joined([first, second])
    assert both.degree == 5
    assert both.pieces == 6
    assert both.duration == pytest.approx(3.6)
    t = np.array([0.6, 1.5, 2.2])
    np.testing.assert_allclose(both.at(t), first.at(t), atol=1e-12)
    np.testing.assert_allclose(both.at(t + 1.8), second.at(t), atol=1e-10)
    other = some(3, seed=2)  # with the same breaks as the second one
    expected, result = joined([second, other]), joined([second, other], both)
    assert result.breaks is both.breaks
    np.testing.assert_allclose(result.breaks, expected.breaks)
    np.testing.assert_array_equal(result.coefficients, expected.coefficients)


def test_constants_end_at_rest_after_pieces_of_any_length() -> None:
    still = PiecewisePolynomial.constant([0.0, 1.0, 1.0 + 1e-6], [0.1, 0.7], order=7)
    rest = [[0.1, 0.0, 0.0], [0.7, 0.0, 0.0]]
    np.testing.assert_array_equal(still.end_jet(3), rest)
    np.testing.assert_allclose(still.jet(0.3, 3), rest, atol=1e-14)
    assert still.degree == 7


def test_values_are_split_and_reshaped() -> None:
    c = np.random.default_rng(3).normal(size=(3, 10, 6))
    rows, column = PiecewisePolynomial(BREAKS, c).split([(2, 4), (2,)])
    np.testing.assert_array_equal(rows.coefficients, c[:, :8].reshape(3, 2, 4, 6))
    np.testing.assert_array_equal(column.coefficients, c[:, 8:])
    np.testing.assert_array_equal(rows.reshaped(-1, 1).coefficients[:, :, 0], c[:, :8])


def test_stored_arrays_are_read_only_copies() -> None:
    breaks, c = BREAKS.copy(), np.zeros((3, 2))
    part = PiecewisePolynomial(breaks, c)
    breaks[0], c[0, 0] = -5.0, 7.0
    assert part.breaks[0] == 0.5
    assert part.coefficients[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        part.coefficients[0, 0] = 1.0


def test_invalid_functions_are_refused() -> None:
    """Joining a piece so short that its breaks coincide after rounding is invalid as well."""
    long, short = (PiecewisePolynomial.constant([0.0, end], 0.0) for end in (1e9, 1e-8))
    assert_refused(lambda: joined([long, short]), "breaks", "strictly increasing")
    for breaks, c, key in (
        ([0.0], np.zeros((0, 2)), "breaks"),
        ([0.0, 1.0, 1.0], np.zeros((2, 2)), "breaks"),
        ([0.0, math.nan], np.zeros((1, 2)), "breaks"),
        ([0.0, 1.0], np.zeros((2, 2)), "coefficients"),
        ([0.0, 1.0], np.zeros((1, 0)), "coefficients"),
        ([0.0, 1.0], np.array([[0.0, math.inf]]), "coefficients"),
    ):
        assert_refused(partial(PiecewisePolynomial, np.array(breaks), c), key, "")


def test_times_outside_are_refused_except_within_rounding() -> None:
    part = some()
    for t in (0.4, 2.4, math.nan):
        for value in (part.at, lambda when: part.jet(when, 2)):
            with pytest.raises(InputError, match="within"):
                value(t)
    for t, end in ((0.5 - 1e-12, 0.5), (2.3 + 1e-12, 2.3)):
        np.testing.assert_allclose(part.at(t), part.at(end))


@given(st.integers(0, 10**6), st.integers(3, 30), st.sampled_from([3, 5, 7]))
@settings(max_examples=60)
def test_splines_are_those_of_scipy(seed: int, count: int, degree: int) -> None:
    rng, count = np.random.default_rng(seed), max(count, degree + 1)
    s, values = np.cumsum(rng.uniform(0.1, 1.0, count)), rng.normal(size=(count, 2, 3))
    zero, t = np.zeros((2, 3)), np.linspace(s[0], s[-1], 50)
    for orders in ((), (1, 2), (2, 3), (3, 4)) if degree == 5 else ((),):
        ends = ([(order, zero) for order in orders],) * 2 if orders else None
        theirs = make_interp_spline(s, values, k=degree, bc_type=ends)  # type: ignore[arg-type]
        through = interpolated(s, values, degree, orders)
        for own in (through, bspline(theirs.t, theirs.c, degree)):
            assert (own.degree, own.shape) == (degree, (2, 3))
            np.testing.assert_array_equal(own.breaks, np.unique(theirs.t))
            for order in range(4):
                size = 1e-9 * np.max(np.abs(theirs(t, order)))
                np.testing.assert_allclose(own.at(t, order), theirs(t, order), rtol=0.0, atol=size)
        if not orders:
            even, at = evenly_interpolated(values, degree), np.linspace(0.0, 1.0, count)
            known = interpolated(at, values, degree)
            np.testing.assert_allclose(even.coefficients, known.coefficients, rtol=0.0, atol=1e-9)
    inner = bspline(np.arange(10.0), np.eye(6), 3)  # its basis is complete from 3 to 6 only
    np.testing.assert_array_equal(inner.breaks, [3, 4, 5, 6])


@given(st.integers(0, 50), st.lists(st.floats(0.0, 1.0), max_size=8))
def test_values_are_the_same_on_finer_breaks(seed: int, shares: list[float]) -> None:
    part = some(5, seed)
    added = part.breaks[0] + np.array(shares, dtype=np.float64) * part.duration
    breaks = merged_breaks([part.breaks, added])
    assert set(part.breaks) <= set(breaks)
    finer = on_breaks(part, breaks)
    # Not at breaks, where these parts jump: a time there belongs to either side.
    t = np.sort(np.random.default_rng(seed).uniform(part.breaks[0], part.breaks[-1], 200))
    t = t[np.min(np.abs(t[:, None] - breaks), axis=1) > 1e-6]
    for order in range(3):
        np.testing.assert_allclose(finer.at(t, order), part.at(t, order), rtol=1e-6, atol=1e-6)


def test_a_span_within_the_part_and_the_same_breaks() -> None:
    part = some(5)
    breaks = np.array([part.breaks[1] + 0.01, part.breaks[2], part.breaks[2] + 0.02])
    cut = on_breaks(part, breaks)
    assert np.array_equal(cut.breaks, breaks)
    middle = 0.5 * (breaks[1:] + breaks[:-1])
    np.testing.assert_allclose(cut.at(middle), part.at(middle), atol=1e-13)
    assert np.array_equal(on_breaks(part, part.breaks).coefficients, part.coefficients)


@given(st.lists(st.floats(0.0, 10.0), min_size=2, max_size=9, unique=True))
def test_breaks_close_to_the_first_array_are_dropped(times: list[float]) -> None:
    first, other = np.array([0.0, 3.0, 10.0]), np.sort(np.array(times))
    merged = merged_breaks([first, other])
    assert np.all(np.diff(merged) > 0.0)
    assert all(t in first or np.min(np.abs(first - t)) > BREAK_TOLERANCE for t in merged)
    assert all(np.min(np.abs(merged - t)) <= BREAK_TOLERANCE for t in other)


@given(
    st.lists(st.floats(0.0, 0.1), min_size=2, max_size=9, unique=True),
    st.floats(0.0, 1.0),
    st.sampled_from([0.0, 1e-12, 1e-6, 1e-4, 3e-3, 5e-3]),
)
def test_times_are_spaced_from_the_breaks_before_them(
    times: list[float], share: float, later: float
) -> None:
    breaks = np.array([0.0, *(0.01 + np.cumsum(np.array(times) + 1e-5))])
    after_a_break = breaks[int(share * (len(breaks) - 1))] + later
    wanted = np.clip([share * breaks[-1], after_a_break], 0.0, breaks[-1])
    found = spaced(wanted, breaks)
    assert np.all(found >= wanted - 1e-9)
    assert np.all(found <= wanted + MIN_SPACING + 1e-9)
    since = found - breaks[np.searchsorted(breaks, found, side="right") - 1]
    assert np.all((since == 0.0) | (since >= MIN_SPACING * (1.0 - 1e-9)))
    np.testing.assert_array_equal(spaced(found, breaks), found)


@pytest.mark.parametrize("off", [1e-9, 1e-5, 9.5e-5, 2e-3, 3.9e-3, 5e-3])
def test_breaks_close_to_others_are_left_out_without_jumps(off: float) -> None:
    breaks = np.array([0.0, 0.11, 0.2, 0.35])
    jets = np.array([[1.5, 0.4, -0.3]])
    for seconds, jerk in zip(np.diff(breaks), (6.0, -9.0, 4.0), strict=True):
        powers = jerk * seconds ** np.arange(3, 0, -1) / [6.0, 2.0, 1.0]
        place, speed, rate = jets[-1]
        moved = [place + seconds * (speed + 0.5 * seconds * rate), speed + seconds * rate, rate]
        jets = np.append(jets, [moved + powers], axis=0)
    part = PiecewisePolynomial.through_jets(breaks, jets[:, None]).elevated(7)
    wanted = np.array([0.0, 0.11 - off, 0.2 + off, 0.3, 0.35])
    found = on_spaced_breaks(part, wanted)
    assert np.min(np.diff(found.breaks)) >= min(MIN_SPACING, 0.05)
    assert set(wanted) <= set(found.breaks)
    t = np.linspace(0.0, 0.35, 500)
    for order, most in ((0, 2e-5), (1, 1e-3), (2, 6e-2)):
        left, right = found.ends(order)
        np.testing.assert_allclose(left[1:], right[:-1], atol=1e-8)
        np.testing.assert_allclose(found.at(t, order), part.at(t, order), atol=most)
        if off > MIN_SPACING or off < BREAK_TOLERANCE:  # exact
            np.testing.assert_allclose(found.at(t, order), part.at(t, order), atol=1e-7)
