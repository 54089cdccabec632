"""Plans that keep a limit of their body rates."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.team import Swarm
from hitchopt.mission.loading import read_problem
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial


def solved(name: str, rate_deg: float | None) -> ho.Plan:
    problem = read_problem(f"problems/{name}.yaml")
    rate = None if rate_deg is None else math.radians(rate_deg)
    return ho.solve(replace(problem, limits=replace(problem.limits, body_rate=rate)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("triangle", 40.0),
        ("form_triangle", 50.0),
        ("square_quarter_turn", 60.0),  # by the optimiser
        ("swarms/head_on", 30.0),
    ],
)
def test_plans_keep_the_limit_and_come_close_to_it(name: str, rate: float) -> None:
    free, plan = solved(name, None), solved(name, rate)
    check = plan.certificate["body_rate"]
    assert check.limit == pytest.approx(rate)
    assert plan.certificate.certified
    assert 0.9 * rate < check.bound <= rate
    assert plan.duration > free.duration
    states = plan.at(np.linspace(0.0, plan.duration, 3001))
    level = np.degrees(np.linalg.norm(states.body_rates[..., :2], axis=-1))
    assert 0.85 * rate < np.max(level) <= check.bound


@pytest.mark.parametrize("name", ["triangle", "swarms/head_on"])
def test_a_limit_that_does_not_bind_changes_nothing(name: str) -> None:
    free, plan = solved(name, None), solved(name, 500.0)
    assert plan.duration == free.duration
    np.testing.assert_array_equal(plan.motion.drones.coefficients, free.motion.drones.coefficients)


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_points_that_are_met_on_time_refuse_with_the_remedy() -> None:
    problem = read_problem("problems/open_chain.yaml")
    rate = math.radians(0.5)
    with pytest.raises(ho.InfeasibleError, match="body_rate") as refused:
        ho.solve(replace(problem, limits=replace(problem.limits, body_rate=rate)))
    assert "limits.body_rate_deg" in str(refused.value)


def test_the_stretch_of_a_known_turn_is_exact() -> None:
    """A level drone with jerk j turns by j / g: slowed by κ, by j / (g κ³)."""
    breaks = np.array([0.0, 0.01])
    coefficients = np.zeros((1, 1, 3, 4))
    coefficients[0, 0, 0, 3] = 30.0 * 0.01**3 / 6.0
    part = PiecewisePolynomial(breaks, coefficients)
    limit = 0.5
    found = turning_stretch(Swarm(1), limit, (part,))
    assert found == pytest.approx((30.0 / GRAVITY / limit) ** (1 / 3), rel=2e-3)
    assert turning_stretch(Swarm(1), limit, (part,), 7.0) == 7.0
    assert turning_stretch(Swarm(1), None, (part,), 1.5) == 1.5
