"""How far carried objects keep from the ground and from what stands below them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

AT, TO = [1.3, -0.4], [1.3, 1.1]
"""Where a tray is taken, and where it is put down."""

RIM = 0.25


def mission(*steps: dict[str, Any], floor: float = 0.0, **objects: Any) -> dict[str, Any]:
    """Return the problem of a tray on four cables, by what is done once it is lifted."""
    polygon = [[0.6, 0.0], [0.0, -0.6], [-0.6, 0.0], [0.0, 0.6]]
    body = {"circle": 0.06, "to": 0.3, "mass": 0.15, "rim": {"circle": 0.5, "at": RIM}}
    lower, upper = [-5.0, -5.0, floor], [5.0, 5.0, floor + 5.0]
    return {
        "team": {"robots": 4, "cable_length": 2.6, "tension": 1.0},
        "objects": {"tray": {**body, "at": [*AT, floor]}, **objects},
        "start": {"hitch": {"polygon": polygon, "altitude": 1.0 + floor}},
        "mission": [{"enclose": {"object": "tray"}}, {"grasp": {"object": "tray"}}, *steps],
        **({"arena": {"lower": lower, "upper": upper}} if floor else {}),
    }


def lifted(to: list[float], by: float = 0.3, **others: Any) -> dict[str, Any]:
    return mission({"lift": {"by": by}}, {"carry": {"object": "tray", "to": to}}, **others)


def moved(to: float = 0.0, **objects: Any) -> dict[str, Any]:
    step = {"transport_object": {"object": "tray", "to": [*TO, to]}}
    return {**mission(**objects), "mission": [step]}


def clearance(given: dict[str, Any]) -> tuple[float, Motion]:
    plan = ho.solve(ho.problem_from_dict(given))
    return plan.certificate["object_clearance"].bound, plan.motion


def refused(given: dict[str, Any]) -> tuple[str, ...]:
    """Return what came too close in a plan that is refused."""
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(ho.problem_from_dict(given))
    (violation,) = caught.value.violations
    assert violation.constraint == "object_clearance"
    return violation.where


def heights(motion: Motion, floor: float) -> Array:
    """Heights of the tray above the ground in samples in which it moves level, too."""
    t = np.linspace(0.0, motion.duration, 200_001)
    places = motion.object_poses.at(t)[:, 0]
    level = np.linalg.norm(np.gradient(places[:, :2], axis=0), axis=-1) > 1e-9
    return np.asarray(places[level, 2] - floor)


@pytest.mark.slow
def test_the_ground_is_an_obstacle() -> None:
    z = floor = 0.7
    assert refused(lifted([*TO, z + 0.03], floor=floor)) == ("tray", "ground")
    assert refused(lifted([*AT, z - 0.1], floor=floor)) == ("tray", "ground")
    worst, motion = clearance(lifted([*TO, z + 0.05], floor=floor))
    assert worst == pytest.approx(np.min(heights(motion, z)), abs=1e-4)
    assert worst <= np.min(heights(motion, z))


@pytest.mark.slow
def test_an_object_is_lifted_and_goes_straight_up() -> None:
    """The ground that it has stood on may touch it until it moves level."""
    worst, motion = clearance(lifted([*AT, 0.8], by=0.02))
    assert worst > 0.035
    assert len(heights(motion, 0.0)) == 0
    assert refused(lifted([*TO, 0.8], by=0.02)) == ("tray", "ground")


@pytest.mark.slow
def test_a_rim_keeps_off_what_is_below_it() -> None:
    for at, top in ((AT, RIM - 0.001), (TO, RIM)):
        cup = {"circle": 0.02, "to": top, "mass": 0.02, "at": [at[0] - 0.18, at[1], 0.0]}
        assert refused(moved(cup=cup)) == ("tray", "cup")
    worst, _ = clearance(moved(cup={**cup, "to": RIM - 0.05}))
    assert worst == pytest.approx(0.05, abs=1e-5)  # below the rim; its foot is 0.1 m beside


@pytest.mark.slow
def test_an_object_stands_on_all_that_it_meets() -> None:
    """Two tables with a joint below its foot; another one that stands 1 cm beside its own."""
    table = {"to": 0.05, "at": [TO[0] + 0.05, TO[1], 0.0], "fixed": True}
    joint = {
        "here": {**table, "outline": [[-0.06, 0.3], [0.3, 0.3], [0.3, -0.3], [-0.06, -0.3]]},
        "there": {**table, "outline": [[-0.3, 0.3], [-0.06, 0.3], [-0.06, -0.3], [-0.3, -0.3]]},
    }
    small = [[-0.06, 0.3], [0.06, 0.3], [0.06, -0.3], [-0.06, -0.3]]
    beside = {
        "here": {**table, "outline": small, "at": [*TO, 0.0]},
        "there": {**joint["there"], "at": [TO[0] - 0.01, TO[1], 0.0]},
    }
    assert clearance(moved(0.05, **joint))[0] >= 0.035
    assert refused(moved(0.05, **beside)) == ("tray", "there")
