"""Feedback in simulated flights: ropes with weight that the plan does not know."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.simulation.simulation_settings import Perturbations, Settings


@pytest.mark.slow
def test_measured_vertices_take_the_sag_away() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[0.0, -0.8], [-0.7, 0.5], [0.7, 0.5]], 1.0)
    plan = ho.hold(start, 2.5)
    measured: dict[str, float | bool] = {"vertex_noise": 0.01, "vertex_delay": 0.05}
    off, on = (
        ho.simulate(plan, feedback=feedback, perturbations=measured, pull_test=False)
        for feedback in (False, True)
    )
    assert on.run.succeeded
    last = [np.nanmean(flight.errors.errors[-20:]) for flight in (off, on)]
    assert last[0] > 0.05
    assert last[1] < 0.25 * last[0]
    moved = on.flight.record.commanded[-1] - off.flight.record.commanded[-1]
    assert np.all(moved[:, 2] > 0.05)  # drones are told to fly higher
    assert np.all(np.linalg.norm(moved[:, :2], axis=-1) < 0.1)


@pytest.mark.parametrize("name", ["vertex_noise", "vertex_delay"])
def test_measurements_are_checked(name: str) -> None:
    wrong: dict[str, Any] = {name: -0.1}
    with pytest.raises(ho.InputError, match=name):
        Perturbations(**wrong)
    assert not Settings().feedback
