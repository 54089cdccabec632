"""Problems whose cables have friction: legs lean where cables slide, within every limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion

TEAM = {"robots": 3, "cable_length": 2.4, "tension": 0.5}
START = {"hitch": {"polygon": [[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]], "altitude": 1.0}}
MOVE = {"move_vertex": {"vertex": 0, "by": [0.1, 0.3]}}
LEANING = "legs lean against friction, by up to"


def solved(steps: list[dict[str, Any]], friction: float = 0.1, **keys: Any) -> ho.Plan:
    team = {**TEAM, "cable_friction": friction, **keys.pop("team", {})}
    plan = ho.solve(problem_from_dict({"team": team, "start": START, "mission": steps, **keys}))
    assert isinstance(plan.motion, Motion)
    assert plan.certificate.certified
    return plan


def timed(seconds: float) -> dict[str, Any]:
    return {"move_vertex": {**MOVE["move_vertex"], "duration": seconds}}


SHARP = {"move_vertex": {"vertex": 0, "by": [0.0, 0.4], "duration": 8.0}}


@pytest.mark.parametrize(
    ("step", "friction", "keys", "leans"),
    [
        (timed(4.0), 1e-3, {}, False),  # too little to lean for
        (timed(4.0), 0.1, {"separation": {"cable": 0.0}}, True),
        (SHARP, 0.5, {}, True),
    ],
)
def test_remarks_say_whether_legs_lean(
    step: dict[str, Any], friction: float, keys: dict[str, Any], leans: bool
) -> None:
    plan = solved([step], friction, **keys)
    remark = plan.phases[0].remark
    assert LEANING in remark if leans else "lean" not in remark
    assert "no more" not in remark
    assert (plan.motion.leg_tensions is not None) == leans


def test_only_the_steps_that_slide_lean_and_each_says_how_far() -> None:
    steps: list[dict[str, Any]] = [
        {"hold": {"seconds": 0.5}},
        timed(4.0),
        {"transport": {"to": [0.5, 0.0, 1.4], "yaw_deg": 20}},
        {"adjust": {"legs": "balanced", "duration": 4.0}},
    ]
    plan = solved(steps)
    leaning = [LEANING in phase.remark for phase in plan.phases]
    assert leaning == [False, True, False, True]
    assert plan.motion.leg_tensions is not None
    still = [phase for phase in plan.phases if LEANING not in phase.remark]
    for phase in still:
        t = np.linspace(phase.start, phase.end, 50)
        np.testing.assert_allclose(plan.motion.pulls.at(t), 0.5, atol=1e-9)
    t = np.linspace(0.0, plan.duration, 2_000)
    assert np.ptp(plan.motion.pulls.at(t)) > 0.02


def test_vertices_go_where_and_when_they_would_without_friction() -> None:
    plain, leaned = solved([timed(4.0)], 0.0), solved([timed(4.0)])
    t = np.linspace(0.0, 4.0, 500)
    assert leaned.duration == plain.duration == 4.0
    np.testing.assert_allclose(leaned.at(t).vertices, plain.at(t).vertices, atol=1e-9)
    away = np.linalg.norm(leaned.at(t).positions - plain.at(t).positions, axis=-1)
    assert 0.01 < np.max(away) < 0.2


def test_where_limits_leave_little_room_legs_lean_less() -> None:
    """A limit of tilt just above what the hitch needs at rest lets no leg pull much harder."""
    inward = {"move_vertex": {"vertex": 0, "by": [0.0, -0.25], "duration": 6.0}}
    free, plain = solved([inward]), solved([inward], 0.0)
    t = np.linspace(0.0, 6.0, 2_000)
    tilts = {}
    for name, plan in (("free", free), ("plain", plain)):
        thrust = plan.at(t).thrusts(plan.motion.team)
        level = np.linalg.norm(thrust[..., :2], axis=-1)
        tilts[name] = float(np.max(np.degrees(np.arctan2(level, thrust[..., 2]))))
    assert tilts["free"] > tilts["plain"] + 0.1
    between = 0.5 * (tilts["free"] + tilts["plain"])
    tight = solved([inward], limits={"tilt_deg": between})
    assert tight.certificate["tilt"].bound <= between
    shared = tight.phases[0].remark
    assert "limits leave room for no more" in shared
    ratios = [np.max(np.abs(plan.motion.pulls.at(t) - 0.5)) for plan in (tight, free)]
    assert 0.0 < ratios[0] < ratios[1]


def test_what_leaning_would_break_is_flown_without_it() -> None:
    """Within walls that the drones just reach; a plan without friction stays one with it."""
    steps = [{"move_vertex": {"vertex": 0, "by": [0.2, 0.0], "duration": 4.0}}]
    plain = solved(steps, 0.0)
    t = np.linspace(0.0, 4.0, 4_001)
    places = plain.at(t).positions.reshape(-1, 3)
    walls = {
        "lower": (np.min(places, axis=0) - 1e-4).tolist(),
        "upper": (np.max(places, axis=0) + 1e-4).tolist(),
    }
    plan = solved(steps, arena=walls)
    assert "legs do not lean against friction: limits leave no room" in plan.phases[0].remark
    np.testing.assert_array_equal(plan.at(t).positions, plain.at(t).positions)
