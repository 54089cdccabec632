"""Numbers in messages: what a remedy names suffices as it is printed."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.carrying.planner import check_pull
from hitchopt.errors import InfeasibleError, rounded_down, rounded_up
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.timing.timed_motion import check_duration

sizes = st.floats(1e-6, 1e6)


@given(sizes, st.integers(1, 9))
def test_rounded_numbers_suffice_in_their_digits(value: float, digits: int) -> None:
    up = rounded_up(value, digits)
    down = rounded_down(value, digits)
    assert down <= value <= up
    for rounded in (down, up):
        assert float(f"{rounded:.{digits}g}") == rounded
        assert abs(rounded - value) <= 10.0 ** (1 - digits) * value
        assert rounded_up(rounded, digits) == rounded_down(rounded, digits) == rounded


def number_in(message: str, pattern: str) -> float:
    (number,) = re.findall(pattern, message)
    return float(number)


def refusal(check: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(InfeasibleError) as refused:
        check(*arguments)
    return str(refused.value)


@given(st.floats(0.1, 1e3))
def test_the_duration_that_a_refusal_names_is_long_enough(fastest: float) -> None:
    named = number_in(refusal(check_duration, 0.05, fastest), r"allow (\S+) s")
    check_duration(named, fastest)


@given(st.floats(10.0, 60.0), st.floats(0.03, 0.2))
def test_the_pull_that_a_refusal_names_is_low_enough(tilt: float, mass: float) -> None:
    team = ho.Team(3, 2.4, quadrotor=ho.Quadrotor(mass, 2.6))
    requirements = Requirements(ho.Limits(tilt=np.radians(tilt)))
    message = refusal(check_pull, 10.0, team, requirements)
    check_pull(number_in(message, r"a tension of (\S+) N"), team, requirements)


def loaded(tension: float) -> ho.Hitch:
    team = ho.Team(3, 2.4, tension=tension, load=0.05)
    return ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), 1.5)


@pytest.mark.parametrize("tension", [0.15, 0.2, 0.25, 0.3])
def test_the_factor_of_tensions_that_a_refusal_names_bears_the_load(tension: float) -> None:
    factor = number_in(refusal(loaded, tension), r"multiply team.tension by (\S+) or more")
    assert np.all(np.isfinite(loaded(factor * tension).drones))


def hanging(tension: float) -> ho.Plan:
    polygon = [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]]
    team = {"robots": 3, "cable_length": 2.3, "cable_density": 0.01, "tension": tension}
    start = {"hitch": {"polygon": polygon, "altitude": 1.5}}
    mission = [{"hold": {"seconds": 1.0}}]
    return ho.solve(ho.problem_from_dict({"team": team, "start": start, "mission": mission}))


def test_cables_that_sag_too_far_to_balance_are_no_fault_to_report() -> None:
    message = refusal(hanging, 0.08)
    assert "equilibrium" in message
    assert "raise the tension" in message
    assert hanging(0.12).certificate.certified
