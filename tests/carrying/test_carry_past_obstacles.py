"""Carries whose straight way is blocked: certified, proven by verify, and mirrored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify

pytestmark = pytest.mark.slow

GOAL = [5.5, 0.0, 0.0]
PILLAR: dict[str, Any] = {"circle": 0.05, "to": 2.5, "at": [3.3, 0.2, 0.0], "fixed": True}


def carried(side: float, steps: list[dict[str, Any]] | None = None) -> ho.Plan:
    """Return the plan of a box past obstacles, with y times a side, 1 or -1."""

    def mirrored(points: Any) -> Any:
        return (np.array(points) * [1.0, side]).tolist()[:: int(side)]

    rim = {"outline": mirrored([[-0.3, -0.25], [-0.3, 0.25], [0.3, 0.25], [0.3, -0.25]])}
    outline = mirrored([[-0.1, -0.08], [-0.1, 0.08], [0.1, 0.08], [0.1, -0.08]])
    box = {"outline": outline, "to": 0.3, "mass": 0.2, "at": [1.2, 0, 0]}
    x, y, z = PILLAR["at"]
    pillar = {**PILLAR, "at": [x, side * y, z]}
    data: dict[str, Any] = {
        "team": {"robots": 4, "cable_length": 2.4, "cable_density": 0.01, "tension": 1.0},
        "objects": {"box": {**box, "rim": {**rim, "at": 0.25}}, "pillar": pillar},
        "start": {
            "hitch": {
                "polygon": mirrored([[-0.4, -0.4], [-0.4, 0.4], [0.4, 0.4], [0.4, -0.4]]),
                "altitude": 1.0,
            }
        },
        "mission": steps or [{"transport_object": {"object": "box", "to": GOAL}}],
    }
    plan = ho.solve(ho.problem_from_dict(data))
    assert plan.certificate.certified
    return plan


def remark(plan: ho.Plan) -> str:
    (words,) = [phase.remark for phase in plan.phases if phase.name == "carry"]
    return words


def is_proven(plan: ho.Plan, folder: Path) -> bool:
    """Return whether ``hitchopt verify`` proves every limit of a plan."""
    plan.save(folder, picture=False)
    return all(row.verdict in verify.PASSING for row in verify.verify(folder))


def test_a_box_is_carried_past_a_pillar_on_the_nearer_side(tmp_path: Path) -> None:
    """The mirrored problem has the mirrored plan, numbered in the reverse order."""
    plans = [carried(side) for side in (1.0, -1.0)]
    for plan, side in zip(plans, (1.0, -1.0), strict=True):
        assert "on the way past obstacles" in remark(plan)
        sideways = side * plan.motion.poses.at(np.linspace(0.0, plan.duration, 801))[:, 0, 1]
        assert np.min(sideways) < -0.3
        assert np.max(sideways) < 1e-6
        assert is_proven(plan, tmp_path / str(side))
    assert plans[0].duration == pytest.approx(plans[1].duration, rel=0.01)


def test_a_box_turns_past_a_pillar_in_a_stated_duration(tmp_path: Path) -> None:
    names = ("enclose", "grasp", "lift", "carry", "set_down")
    steps: list[dict[str, Any]] = [{name: {"object": "box"}} for name in names]
    steps[2] = {"lift": {"by": 0.3}}
    steps[3]["carry"] |= {"to": [5.5, 0.0, 0.3], "yaw_deg": 30, "duration": 30}
    plan = carried(1.0, steps)
    assert "on the way past obstacles" in remark(plan)
    (phase,) = [phase for phase in plan.phases if phase.name == "carry"]
    assert phase.end - phase.start == pytest.approx(30.0, abs=1e-9)
    assert is_proven(plan, tmp_path)
