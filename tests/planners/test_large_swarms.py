"""Crowds of single drones: programs of those that are too close, the others staying."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from hitchopt.api import separate
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.mission.problem import SwarmProblem
from problems.swarm import antipodal_circle

search = import_module("hitchopt.planners.separation.separate")


def test_drones_that_nobody_meets_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(search, "LARGE", 40)
    monkeypatch.setattr("hitchopt.planners.separation.guesses.ROUNDS", 2)  # guesses are not clear
    ring = antipodal_circle(12)
    x, y = np.meshgrid(np.arange(6) - 2.5, 8.0 + np.arange(5), indexing="ij")
    away = np.column_stack([x.ravel(), y.ravel(), np.full(30, 1.5)]).tolist()
    data = ring | {
        "team": {"drones": 42}, "start": ring["start"] + away, "goal": ring["goal"] + away
    }  # fmt: skip
    problem = any_problem_from_dict(data)
    assert isinstance(problem, SwarmProblem)
    plan = separate(problem)
    plan.certificate.raise_if_violated()
    drones = plan.motion.drones.at(np.linspace(0.0, plan.duration, 300))
    i, j = np.triu_indices(42, 1)
    apart = (drones[:, i] - drones[:, j]) / [0.24, 0.24, 0.6]
    assert np.min(np.linalg.norm(apart, axis=-1)) >= 1.0
    np.testing.assert_allclose(drones[:, 12:], np.broadcast_to(away, (300, 30, 3)), atol=1e-12)
    np.testing.assert_allclose(drones[-1], problem.goal, atol=1e-9)
