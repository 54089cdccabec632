"""A time limit ends whatever is planned, and says so; no clock decides what these tests find."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import Progress, TimeIsUp, TimeLimitError, check_time, time_left, time_limit
from hitchopt.repairs.repair import find_suggestions
from hitchopt.steps import STEP_KINDS
from tests.helpers.clocks import Clock
from tests.helpers.plans import PROBLEMS, planned
from tests.helpers.refusing_steps import NEEDED_SPEED, brittle_problem


def wait(seconds: float, *progress: Progress) -> None:
    """Ask for the time until it is up."""
    with time_limit(seconds, *progress) as tell:
        tell("work")
        while True:
            check_time()


def test_the_earliest_end_counts_and_the_error_says_what_was_being_done(clock: Clock) -> None:
    with time_limit(None) as tell:
        tell("anything")
        check_time()
        assert time_left() == math.inf
    told: list[str] = []
    with pytest.raises(TimeLimitError, match=r"time limit: .* 5 s \(last: work\)") as up:
        wait(5.0, told.append)
    assert told == ["work"]
    assert "limit=" in str(up.value)
    assert time_left() == math.inf
    for outer, inner in ((5.0, 50.0), (50.0, 5.0)):
        with pytest.raises(TimeLimitError, match="limit of 5 s"), time_limit(outer):
            wait(inner)
    assert clock.now < 40.0


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        *(("form_triangle.yaml", 40.0), ("swarms/circle_24.yaml", 40.0), ("transport.yaml", 3.0)),
        *(("straight_way_shut.yaml", seconds) for seconds in (3.0, 40.0)),
    ],
)
def test_every_kind_of_problem_is_given_up(clock: Clock, name: str, seconds: float) -> None:
    with pytest.raises(TimeLimitError, match=f"limit of {seconds:g} s"):
        ho.solve(PROBLEMS / name, limit=seconds)
    assert seconds < clock.now < 2.0 * seconds + 10.0


TRIANGLE = [[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]]
PULLED = [[0.0, 0.7], [0.5, -0.3], [-0.5, -0.3]]
START = ho.Hitch.spread(ho.Team(3, 2.4, cable_density=0.005, tension=0.5), TRIANGLE, 1.5)
RUBBING = ho.Hitch.spread(ho.Team(3, 2.4, tension=0.5, cable_friction=0.1), TRIANGLE, 1.5)
Q, R = ([[x, y, 1.6] for y in (1.2, 0.0, -1.2)] for x in (-0.6, 0.6))
ARGUMENTS: dict[str, dict[str, Any]] = {
    "morph": {"polygon": PULLED},
    "hold": {"seconds": 1.0},
    "move_vertex": {"vertex": 0, "to": PULLED[0]},
    "move_edge": {"edge": 0, "by": [0.0, 0.05]},
    "adjust": {"legs": "balanced"},
    "follow_vertex": {"vertex": 0, "path": [[0.0, 0.0, 0.6], [5.0, 0.0, 0.7]]},
    "transport": {"to": [0.2, 0.1, 1.5]},
    "form": {"polygon": TRIANGLE, "altitude": 1.2},
    "settle": {},
    "release": {},
    "land": {},
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_every_step_is_given_up(clock: Clock, name: str) -> None:
    step = STEP_KINDS[name](**ARGUMENTS[name])
    start: Any = RUBBING if name == "settle" else START
    if step.needs_hitch is False:
        start = ho.DronesStart(Q, R)
    with pytest.raises(TimeLimitError, match=r"limit of 1\.5 s"):
        ho.solve(start, step, team=RUBBING.team if name == "settle" else START.team, limit=1.5)
    assert clock.now < 10.0


@pytest.mark.parametrize("wrong", [0, -1.0, math.nan, "1"])
def test_a_limit_is_a_positive_time(wrong: Any) -> None:
    for call in (
        partial(ho.solve, START, ho.Hold(1.0)),
        partial(ho.morph, START, PULLED),
        partial(ho.form, START.team, Q, R, TRIANGLE),
    ):
        with pytest.raises(ho.InputError, match=r"^limit = "):
            call(limit=wrong)


def test_a_plan_in_time_is_the_plan_without_a_limit() -> None:
    path = PROBLEMS / "straight_way_shut.yaml"
    plans = planned("straight_way_shut"), ho.solve(path, limit=1e6)
    a, b = (plan.motion.drones.coefficients for plan in plans)
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9)
    with pytest.raises(ho.InputError, match="limit = 0"):
        ho.solve(path, limit=0)
    a, b = (
        ho.solve(START, ho.Transport([0.2, 0.1, 1.5]), limit=limit).motion.drones.coefficients
        for limit in (None, 1e6)
    )
    np.testing.assert_array_equal(a, b)


def test_suggestions_found_before_the_limit_are_kept() -> None:
    problem = brittle_problem(TimeIsUp())
    with pytest.raises(ho.InfeasibleError) as refused:
        ho.solve(problem)
    (found,) = find_suggestions(problem, refused.value, budget=60.0)
    assert float(found.change.new) > 1.05 * NEEDED_SPEED  # it is not narrowed down
