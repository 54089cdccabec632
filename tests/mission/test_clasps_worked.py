"""Clasps are worked: drones swing about their places until friction has lost its memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion

POLYGON = np.array([[3.0, -0.25], [3.65, -1.375], [2.35, -1.375]])
TEAM = {"robots": 3, "cable_length": 2.4, "tension": 0.6, "cable_friction": 0.1}
Q = [[2.2, 0.4, 0.9], [3.9, -0.6, 0.9], [2.9, -2.2, 0.9]]
R = [[3.1, 0.5, 0.9], [3.9, -1.6, 0.9], [2.1, -1.8, 0.9]]


def solved(steps: list[dict[str, Any]], tied: bool = True, **keys: Any) -> ho.Plan:
    start = {"hitch": {"polygon": POLYGON.tolist(), "altitude": 1.2}}
    start = start if tied else {"drones": {"q": Q, "r": R}}
    team = {**TEAM, **keys.pop("team", {})}
    plan = ho.solve(problem_from_dict({"team": team, "start": start, "mission": steps, **keys}))
    assert isinstance(plan.motion, Motion)
    assert plan.certificate.certified
    return plan


def form(**keys: Any) -> list[dict[str, Any]]:
    return [{"form": {"polygon": POLYGON.tolist(), "altitude": 1.2, **keys}}]


def extremes(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the values at which a curve turns."""
    steps = np.diff(values)
    return values[1:-1][steps[1:] * steps[:-1] < 0.0]


def test_drones_swing_to_both_sides_by_less_and_less_and_vertices_stay() -> None:
    plan = solved([{"settle": {}}])
    assert (plan.phases[0].name, plan.duration) == ("settle", 17.0)
    samples = plan.at(np.linspace(0.0, 17.0, 4_001))
    np.testing.assert_allclose(
        samples.vertices, np.broadcast_to(samples.vertices[0], samples.vertices.shape), atol=1e-9
    )
    np.testing.assert_allclose(samples.positions[-1], samples.positions[0], atol=1e-9)
    away = np.linalg.norm(samples.positions - samples.positions[:1], axis=-1)
    assert np.all((np.max(away, axis=0) > 0.07) & (np.max(away, axis=0) < 0.12))
    for pull in plan.motion.pulls.at(samples.t).T:
        turned = extremes(np.log(pull / TEAM["tension"]))
        assert len(turned) == 16
        assert np.all(turned[1:] * turned[:-1] < 0.0)
        np.testing.assert_allclose(np.diff(np.abs(turned)), -np.abs(turned[0]) / 17.0, rtol=0.1)


def test_legs_balance_edges_as_friction_fully_used_would_have_them() -> None:
    plan = solved([{"settle": {}}])
    t = np.linspace(0.0, 17.0, 301)
    samples, pulls = plan.at(t), plan.motion.pulls.at(t)
    p = samples.vertices
    u = np.roll(p, -1, axis=1) - p
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    force = TEAM["tension"] * (u - np.roll(u, 1, axis=1))
    for of_q, at in ((0, p), (1, np.roll(p, -1, axis=1))):
        leg = samples.positions[:, of_q::2] - at
        pulled = pulls[:, of_q::2, None] * leg / np.linalg.norm(leg, axis=-1, keepdims=True)
        force += np.roll(pulled, of_q, axis=1)
    assert np.max(np.abs(force)) < 1e-3 * TEAM["tension"]
    # Cables bend by half of the angle between the edges at a clasp, each, and once more at a leg.
    wrapped = np.pi - np.arccos(np.sum(u * np.roll(u, 1, axis=1), axis=-1))[0]
    assert np.max(pulls) <= TEAM["tension"] * np.exp(0.1 * np.max(np.pi - wrapped)) * 1.001


def test_a_hitch_that_is_formed_of_cables_with_friction_ends_with_it() -> None:
    worked, left = solved(form(), tied=False), solved(form(settle=False), tied=False)
    assert worked.phases[-1].name == "settle"
    assert worked.duration == pytest.approx(left.duration + 17.0)
    given = solved(form(settle=20), tied=False)
    assert given.duration == pytest.approx(left.duration + 20.0)
    smooth = solved(form(), tied=False, team={"cable_friction": 0.0})
    assert "settle" not in {phase.name for phase in (*left.phases, *smooth.phases)}
    ends = [plan.at([plan.duration]).positions for plan in (worked, left, given)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    np.testing.assert_allclose(ends[2], ends[1], atol=1e-9)


@pytest.mark.slow
def test_cables_with_weight_and_the_independent_verifier(tmp_path: Path) -> None:
    plan = solved([{"settle": {"seconds": 18}}], team={"cable_density": 0.01})
    assert plan.duration == 18.0
    plan.save(tmp_path)
    assert verify.main([str(tmp_path)]) == 0


@pytest.mark.slow
def test_limits_make_swings_smaller_or_slower() -> None:
    free = solved([{"settle": {}}])
    slow = solved([{"settle": {}}], limits={"speed": 0.2})
    assert 17.0 < slow.duration < 25.6
    quick = solved([{"settle": {"seconds": 12}}], limits={"speed": 0.2})
    assert "no more" in quick.phases[0].remark
    assert "no more" not in free.phases[0].remark + slow.phases[0].remark
    ranges = [
        np.max(np.ptp(plan.at(np.linspace(0.0, plan.duration, 999)).positions, axis=0))
        for plan in (free, slow, quick)
    ]
    assert ranges[1] == pytest.approx(ranges[0], rel=1e-3)
    assert ranges[2] < 0.9 * ranges[0]
    with pytest.raises(ho.InfeasibleError, match="speed"):
        solved([{"settle": {"seconds": 2}}], limits={"speed": 0.2})


@pytest.mark.slow
def test_form_says_where_limits_leave_no_room_for_it() -> None:
    plan = solved(form(), tied=False, limits={"tilt_deg": 25.2})
    assert "limits leave no room" in plan.phases[-1].remark


@pytest.mark.parametrize(
    ("steps", "keys", "named"),
    [
        ([{"settle": {}}], {"team": {"cable_friction": 0.0}}, "settle"),
        ([{"settle": {"seconds": -1}}], {}, "seconds"),
        ([{"settle": {"seconds": "long"}}], {}, "seconds"),
        ([{"release": {}}, {"settle": {}}], {}, "settle"),
    ],
)
def test_settling_that_cannot_be_is_refused(
    steps: list[dict[str, Any]], keys: dict[str, Any], named: str
) -> None:
    with pytest.raises(ho.InputError, match=named):
        solved(steps, **keys)


def test_mission_has_it_and_python_values_are_checked() -> None:
    team = ho.Team(robots=3, cable_length=2.4, tension=0.6, cable_friction=0.1)
    start = ho.Hitch.spread(team, POLYGON, 1.2)
    plan = ho.Mission(team, start).settle().solve()
    assert plan.duration == 17.0
    with pytest.raises(ho.InputError, match="seconds"):
        ho.Mission(team, start).settle(seconds=True)
    with pytest.raises(ho.InputError, match="settle"):
        ho.Form(POLYGON, settle="no")  # type: ignore[arg-type]
