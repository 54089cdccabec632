from __future__ import annotations

import numpy as np
import pytest
from handmade import made_motion
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.errors import InputError
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import sample_times, states_at


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


@given(st.floats(0.0, 40.0), st.floats(0.1, 60.0))
def test_times_are_all_multiples_and_the_end(duration: float, rate: float) -> None:
    times = sample_times(duration, rate)
    assert times[0] == 0.0
    assert np.all(np.diff(times) > 0.0)
    assert times[-1] <= duration
    multiples = [k / rate for k in range(len(times) + 2) if k / rate <= duration]
    extra = [duration] if duration - multiples[-1] > 1e-6 else []
    assert times.tolist() == multiples + extra


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e12])
def test_a_useless_rate_is_an_input_error(rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        sample_times(3.0, rate)


def test_states_are_those_of_the_polynomials(motion: Motion) -> None:
    t = np.random.default_rng(1).uniform(0.0, motion.duration, (5, 7))
    states = states_at(motion, t)
    assert np.array_equal(states.t, t)
    for name, order in (("positions", 0), ("velocities", 1), ("accelerations", 2), ("jerks", 3)):
        values = getattr(states, name)
        np.testing.assert_allclose(values, motion.drones.at(t, order), atol=1e-9 * 10**order)
    np.testing.assert_allclose(states.vertices, motion.vertices.at(t), atol=1e-12)
    np.testing.assert_allclose(states.vertex_velocities, motion.vertices.at(t, 1), atol=1e-10)
    np.testing.assert_allclose(states.legs, motion.legs.at(t), atol=1e-12)
    np.testing.assert_allclose(states.tensions, motion.tensions.at(t), atol=1e-12)


def test_values_at_a_break_are_the_later_piece_s_and_the_end_s_the_earlier(motion: Motion) -> None:
    left, right = motion.drones.ends(3)
    assert not np.allclose(left[1], right[0], atol=1e-3)  # the jerk does jump in this motion
    at = states_at(motion, [0.7, 1.9, motion.duration]).jerks
    np.testing.assert_allclose(at[0], left[1], atol=1e-7)
    np.testing.assert_allclose(at[1], left[2], atol=1e-7)
    np.testing.assert_allclose(at[2], right[2], atol=1e-7)


@pytest.mark.parametrize("t", [-0.1, float("nan"), [0.0, float("inf")], []])
def test_times_before_the_start_are_refused(motion: Motion, t: float | list[float]) -> None:
    with pytest.raises(InputError, match="finite times from 0 s on"):
        states_at(motion, t)


def test_after_its_end_a_plan_rests_where_it_ended(motion: Motion) -> None:
    states = states_at(motion, [1.0, 9.0])
    end = states_at(motion, motion.duration)
    np.testing.assert_array_equal(states.t, [1.0, 9.0])
    np.testing.assert_array_equal(states.positions[1], end.positions)
    np.testing.assert_array_equal(states.cable_forces[1], end.cable_forces)
    for rate in (states.velocities, states.accelerations, states.jerks):
        assert not np.any(rate[1])
    assert np.any(states.velocities[0])
