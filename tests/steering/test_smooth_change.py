"""Curves from a moving state to rest: their ends, derivatives, and what a long shift leaves."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.steering.smooth_change import SmoothChange
from hitchopt.values import Array

VALUES = st.floats(-2.0, 2.0)
DURATIONS = st.floats(0.2, 4.0)


@given(st.tuples(VALUES, VALUES, VALUES), VALUES, DURATIONS, DURATIONS)
def test_it_begins_in_the_state_and_rests_at_the_goal(
    state: tuple[float, float, float], goal: float, brake: float, shift: float
) -> None:
    change = SmoothChange(np.array([state, state[::-1]]), np.array([goal, -goal]))
    ends: Array = np.array([0.0, max(brake, shift)])
    jets = change.jets(ends, brake, shift)
    np.testing.assert_allclose(jets[0, 0, :3], state, atol=1e-12)
    np.testing.assert_allclose(jets[0, 1, :3], state[::-1], atol=1e-12)
    np.testing.assert_allclose(jets[1, :, 0], [goal, -goal], atol=1e-9)
    np.testing.assert_allclose(jets[1, :, 1:3], 0.0, atol=1e-9)


@given(st.tuples(VALUES, VALUES, VALUES), VALUES, DURATIONS, DURATIONS, st.floats(0.05, 0.95))
def test_derivatives_are_those_of_the_curve(
    state: tuple[float, float, float], goal: float, brake: float, shift: float, share: float
) -> None:
    change, h = SmoothChange(np.array(state), np.array(goal)), 1e-4
    t: Array = share * min(brake, shift) + h * np.array([-1.0, 0.0, 1.0])
    jets = change.jets(t, brake, shift)
    for order in range(3):
        slope = (jets[2, order] - jets[0, order]) / (2.0 * h)
        size = 1.0 + np.max(np.abs(change.jets(t, brake, shift))) / min(brake, shift) ** 2
        np.testing.assert_allclose(slope, jets[1, order + 1], atol=1e-4 * size)


def test_acceleration_is_continuous_where_brake_and_shift_end() -> None:
    change = SmoothChange(np.array([0.3, 0.8, -1.2]), np.array(2.0))
    for end in (0.7, 1.9):
        before, after = change.jets(np.array([end - 1e-9, end + 1e-9]), 0.7, 1.9)[:, :3]
        np.testing.assert_allclose(before, after, atol=1e-7)


def test_without_a_shift_the_brake_alone_is_left() -> None:
    change = SmoothChange(np.array([0.3, 0.8, -1.2]), np.array(2.0))
    jets = change.jets(np.array([1.0, 5.0]), 1.0, math.inf)
    np.testing.assert_allclose(jets[:, 0], 0.3 + 0.5 * 0.8 - 1.2 / 12.0, atol=1e-12)
    np.testing.assert_allclose(jets[:, 1:3], 0.0, atol=1e-12)
