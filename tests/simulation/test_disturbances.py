"""Random walks that are drawn back to zero, and independent streams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchopt.simulation.disturbances import Disturbances, Drift
from hitchopt.simulation.simulation_settings import CALM, USUAL


@pytest.mark.parametrize("step", [0.005, 0.1, 1.0])
def test_spread_and_memory_do_not_depend_on_the_step(step: float) -> None:
    drift = Drift(0.3, 0.5, (40_000,), np.random.default_rng(1))
    for _ in range(3):
        before = drift.value.copy()
        after = drift.advance(step)
    assert np.std(after) == pytest.approx(0.3, rel=0.02)
    correlation = np.mean(before * after) / np.mean(before**2)
    assert correlation == pytest.approx(np.exp(-step / 0.5), abs=0.02)


def test_no_spread_is_no_disturbance() -> None:
    calm = Disturbances(CALM, 3, 7)
    np.testing.assert_array_equal(calm.cable_scale, 1.0)
    drifts = (calm.noise, calm.velocity_noise, calm.wind)
    for values in (calm.start_offset, calm.steady_wind, *(drift.advance(0.1) for drift in drifts)):
        np.testing.assert_array_equal(values, 0.0)


def test_a_quantity_that_is_switched_off_leaves_the_others_as_they_were() -> None:
    both = Disturbances(USUAL, 4, 11)
    windless = Disturbances(replace(USUAL, wind=0.0, steady_wind=0.0, velocity_noise=0.0), 4, 11)
    np.testing.assert_array_equal(both.cable_scale, windless.cable_scale)
    np.testing.assert_array_equal(both.start_offset, windless.start_offset)
    np.testing.assert_array_equal(both.noise.advance(0.1), windless.noise.advance(0.1))
    assert np.max(np.abs(both.wind.value)) > 0.0
    assert not np.array_equal(both.start_offset, Disturbances(USUAL, 4, 12).start_offset)


def test_gusts_have_the_size_that_was_asked_for() -> None:
    gusts = Disturbances(replace(CALM, wind=0.05), 3000, 5).wind.value
    assert np.sqrt(np.mean(np.sum(gusts**2, axis=-1))) == pytest.approx(0.05, rel=0.02)


def test_the_steady_wind_is_level_and_its_direction_is_the_seeds() -> None:
    winds = np.array([Disturbances(USUAL, 3, seed).steady_wind for seed in range(400)])
    np.testing.assert_allclose(np.linalg.norm(winds, axis=-1), USUAL.steady_wind)
    np.testing.assert_array_equal(winds[:, 2], 0.0)
    assert np.linalg.norm(np.mean(winds, axis=0)) < 0.1 * USUAL.steady_wind  # from everywhere
