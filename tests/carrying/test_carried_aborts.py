"""Aborts of plans that carry objects: where these end, and from where a hitch lands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from carried_plans import TO, check, plan, tray

import hitchopt as ho
from hitchopt.live.abort import Abort, Aborts
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

BESIDE = {"transport": {"to": [-0.3, 2.6, 1.0]}}
"""What leads the hitch away from the table on which the tray is set down."""


@cache
def carried() -> Aborts:
    """Of a tray that is carried to a table and left, the hitch then led away."""
    problem = tray()
    problem["mission"].append(BESIDE)
    return Aborts(ho.solve(ho.problem_from_dict(problem)).motion)


def during(motion: Motion, name: str, share: float = 0.5) -> float:
    phase = next(p for p in motion.phases if p.name == name)
    return phase.start + share * (phase.end - phase.start)


def check_landed(found: Abort) -> Motion:
    """It is certified, nothing jumps, and all drones end on the ground."""
    whole = found.motion
    assert found.certificate.certified
    assert np.max(np.abs(whole.drones.at(whole.duration)[:, 2])) <= 0.2
    left, right = whole.object_poses.ends(0)
    np.testing.assert_allclose(left[1:], right[:-1], rtol=0.0, atol=1e-9)
    return whole


@pytest.mark.slow
@pytest.mark.parametrize("how", ["land", "release_and_land"])
def test_what_was_lifted_is_set_down_first_and_stays_there(how: str) -> None:
    aborts = carried()
    left = during(aborts.motion, "leave", 0.0)
    found = aborts.found(during(aborts.motion, "carry"), how)
    assert found.rest >= left
    whole = check_landed(found)
    np.testing.assert_allclose(whole.object_poses.at(whole.duration)[0, :3], TO, atol=1e-9)


def stays(whole: Motion) -> bool:
    """Whether the tray never moves, or comes back to where it was."""
    poses = whole.object_poses.at(np.array([0.0, whole.duration]))[:, 0]
    return bool(np.max(np.abs(poses[1] - poses[0])) <= 1e-9)


@pytest.mark.slow
def test_before_it_is_lifted_the_hitch_goes_back() -> None:
    aborts = carried()
    found = aborts.found(during(aborts.motion, "grasp"), "release_and_land")
    assert found.rest < during(aborts.motion, "grasp", 1.0)
    assert stays(check_landed(found))


@pytest.mark.slow
def test_what_the_plan_leaves_in_the_air_is_set_down_where_it_was_taken() -> None:
    names = {"enclose": {"object": "tray"}, "grasp": {"object": "tray"}, "lift": {"by": 0.2}}
    problem = {**tray(), "mission": [{name: keys} for name, keys in names.items()]}
    motion = ho.solve(ho.problem_from_dict(problem)).motion
    assert stays(check_landed(Aborts(motion).found(motion.duration, "release_and_land")))


def test_an_object_that_jumps_is_found() -> None:
    motion = plan("tray").motion
    poses = motion.object_poses.coefficients.copy()
    poses[-1, 0, 0] += 1e-3
    jumping = replace(motion, poses=PiecewisePolynomial(motion.drones.breaks, poses))
    found = check(jumping, "continuity")
    assert (check(motion, "continuity").holds, found.holds) == (True, False)
    assert found.where == ("tray",)
    assert found.bound == pytest.approx(1e-3, abs=1e-6)
