"""Loads at the clasps: ropes bear their weight, as much as the plan says, while they touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scripted import regular_hitch, standing

from hitchopt import actions
from hitchopt.hitch import GRAVITY
from hitchopt.simulation.flight_task import read_task
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import Settings

CALM = Settings(body="point", pull_test=False)
LOADS = np.array([0.01, 0.0, 0.02])


def lifted(loads: np.ndarray, shares: float = 1.0) -> tuple[float, np.ndarray]:
    """Return the drones' upward force at rest [N], and the clasps' height over the plan's [m]."""
    task = standing(regular_hitch(3, load=loads, tension=0.8), 1.0)  # type: ignore[arg-type]
    done = simulate(replace(task, taut=np.full(task.tensions.shape, shares)), CALM)
    assert done.outcome.failures == ()
    record, gains = done.flight.record, done.flight.gains
    rows = (record.t > 1.0) & (record.t < done.flight.rested)
    sunk = np.mean(record.commanded[rows] - record.drones[rows], axis=0)[:, 2]
    held = -task.setpoints.cable_forces[0, :, 2] + gains.stiffness * sunk
    return float(np.sum(held)), np.nanmean(done.errors.offsets[50:, :, 2], axis=0)


@pytest.mark.slow
def test_drones_carry_the_loads_and_clasps_stay_at_their_heights() -> None:
    held, heights = lifted(LOADS)
    cables = 3 * 0.01 * 2.3
    assert held == pytest.approx(GRAVITY * (np.sum(LOADS) + cables), rel=0.02)
    assert np.max(np.abs(heights)) < 0.015  # legs that rise for no load would stand 4 cm off


@pytest.mark.slow
def test_only_the_share_that_the_plan_states_hangs_there() -> None:
    whole, _ = lifted(LOADS)
    half, heights = lifted(LOADS, 0.5)
    assert whole - half == pytest.approx(0.5 * GRAVITY * np.sum(LOADS), rel=0.03)
    assert heights[2] > 0.02  # planned for a load that is not there


def test_a_plan_says_how_its_loads_are_taken_up(tmp_path_factory: pytest.TempPathFactory) -> None:
    hitch = regular_hitch(3, load=0.01)
    place = tmp_path_factory.mktemp("loaded")
    actions.transport(hitch, to=[0.1, 0.0, 2.1]).save(place)
    task = read_task(place)
    assert task.taut is not None
    np.testing.assert_allclose(task.taut, 1.0)
    np.testing.assert_array_equal(task.load_shares(0), np.ones(3))
