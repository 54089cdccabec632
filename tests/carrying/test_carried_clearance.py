"""Clearances of carried objects to the ground and to bodies below them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

pytestmark = pytest.mark.slow

AT, TO = [1.3, -0.4], [1.3, 1.1]
"""Where a tray is taken, and where it is put down."""

RIM = 0.25


def solved(*steps: dict[str, Any], floor: float = 0.0, **objects: Any) -> ho.Plan:
    """Return the plan of a tray on four cables, moved in one step or in more once it is grasped."""
    polygon = [[0.6, 0.0], [0.0, -0.6], [-0.6, 0.0], [0.0, 0.6]]
    body = {"circle": 0.06, "to": 0.3, "mass": 0.15, "rim": {"circle": 0.5, "at": RIM}}
    begun = [{"enclose": {"object": "tray"}}, {"grasp": {"object": "tray"}}]
    given: dict[str, Any] = {
        "team": {"robots": 4, "cable_length": 2.6, "tension": 1.0},
        "objects": {"tray": {**body, "at": [*AT, floor]}, **objects},
        "start": {"hitch": {"polygon": polygon, "altitude": 1.0 + floor}},
        "mission": [*(begun if len(steps) > 1 else ()), *steps],
    }
    if floor:
        given["arena"] = {"lower": [-5.0, -5.0, floor], "upper": [5.0, 5.0, floor + 5.0]}
    return ho.solve(ho.problem_from_dict(given))


def lifted(to: list[float], by: float = 0.3, **others: Any) -> ho.Plan:
    return solved({"lift": {"by": by}}, {"carry": {"object": "tray", "to": to}}, **others)


def moved(to: float = 0.0, **objects: Any) -> ho.Plan:
    return solved({"transport_object": {"object": "tray", "to": [*TO, to]}}, **objects)


def clearance(plan: ho.Plan) -> float:
    return plan.certificate["object_clearance"].worst


def too_close(body: str) -> Any:
    return pytest.raises(ho.InfeasibleError, match=rf"^object_clearance: .* at tray, {body} ")


def heights(motion: Motion, floor: float) -> Array:
    """Heights of the tray above the ground in samples in which it moves level, too."""
    t = np.linspace(0.0, motion.duration, 200_001)
    places = motion.poses.at(t)[:, 0]
    level = np.linalg.norm(np.gradient(places[:, :2], axis=0), axis=-1) > 1e-9
    return np.asarray(places[level, 2] - floor)


def test_the_ground_is_an_obstacle_for_horizontal_motion() -> None:
    """The ground that it has stood on may touch it until it does."""
    z = floor = 0.7
    for to in ([*TO, z + 0.03], [*AT, z - 0.1]):
        with too_close("ground"):
            lifted(to, floor=floor)
    plan = lifted([*TO, z + 0.05], floor=floor)
    least = np.min(heights(plan.motion, z))
    assert least - 1e-4 <= clearance(plan) <= least
    plan = lifted([*AT, 0.8], by=0.02)
    assert clearance(plan) > 0.035
    assert len(heights(plan.motion, 0.0)) == 0
    with too_close("ground"):
        lifted([*TO, 0.8], by=0.02)


def test_a_rim_keeps_clear_of_bodies_below_it() -> None:
    for at, top in ((AT, RIM - 0.001), (TO, RIM)):
        cup = {"circle": 0.02, "to": top, "mass": 0.02, "at": [at[0] - 0.18, at[1], 0.0]}
        with too_close("cup"):
            moved(cup=cup)
    below = moved(cup={**cup, "to": RIM - 0.05})
    assert clearance(below) == pytest.approx(0.05, abs=1e-5)  # its foot is 0.1 m beside


def test_an_object_stands_on_all_bodies_that_it_touches() -> None:
    """Two tables with a joint below its foot; another one that stands 1 cm beside its own."""

    def table(left: float, right: float, x: float) -> dict[str, Any]:
        outline = [[left, 0.3], [right, 0.3], [right, -0.3], [left, -0.3]]
        return {"outline": outline, "to": 0.05, "at": [TO[0] + x, TO[1], 0.0], "fixed": True}

    joint = {"here": table(-0.06, 0.3, 0.05), "there": table(-0.3, -0.06, 0.05)}
    assert clearance(moved(0.05, **joint)) >= 0.035
    with too_close("there"):
        moved(0.05, here=table(-0.06, 0.06, 0.0), there=table(-0.3, -0.06, -0.01))
