"""Hitches that close around lopsided outlines: seams, pushes, and how weight is taken over."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.requirements import Requirements
from hitchopt.holding.grip import largest_tension
from hitchopt.holding.grip_search import best_grip
from hitchopt.motion.motion import Motion
from hitchopt.planners.carrying.grip import GrippedHitch
from hitchopt.planners.carrying.grip_polygon import SEARCHED, grip_polygons, grip_task
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.values import Array

NINE = np.array(
    [
        *([0.044, 0.181], [-0.136, 0.131], [-0.171, 0.084], [-0.185, -0.05], [-0.099, -0.16]),
        *([0.069, -0.173], [0.082, -0.168], [0.145, -0.121], [0.133, 0.134]),
    ]
)
"""Two edges come to touch it long before the third does [m]."""


TURNING = np.array(
    [
        *([0.137, -0.029], [0.093, 0.105], [-0.057, 0.128]),
        *([-0.134, 0.041], [-0.117, -0.077], [0.013, -0.139]),
    ]
)
"""About it the best grip by three cables hardly resists turning [m]."""


SLOPING = np.array(
    [
        *([0.046, -0.164], [0.17, -0.011], [0.133, 0.106]),
        *([-0.081, 0.15], [-0.169, 0.014], [-0.089, -0.145]),
    ]
)
"""As slopes turn the best grip's clasps, two drones come too close [m]."""


def problem(mass: float, friction: float, clasps: float = 0.0) -> ho.Problem:
    stone = {"outline": NINE.tolist(), "to": 0.3, "mass": mass, "friction": friction}
    team = {"robots": 3, "cable_length": 1.6, "cable_density": 0.01, "tension": 1.0}
    polygon = 0.42 * np.array([[1.0, 0.0], [-0.5, -0.8667], [-0.5, 0.8667]])
    return ho.problem_from_dict(
        {
            "team": team | {"cable_friction": clasps},
            "limits": {"tilt_deg": 60},
            "objects": {"stone": stone | {"at": [0.0, 0.0, 0.0]}},
            "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.2}},
            "mission": [
                {"enclose": {"object": "stone"}},
                {"grasp": {"object": "stone", "by": "grip", "tension": 1.3}},
                {"loosen": {"object": "stone"}},
            ],
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("outline", "length", "tension", "mass", "friction"),
    [(TURNING, 1.99, 1.3, 0.138, 0.7), (SLOPING, 2.31, 1.0, 0.121, 0.79)],
    ids=["turning", "sloping"],
)
def test_grips_are_taken_that_carry_the_weight(
    outline: Array, length: float, tension: float, mass: float, friction: float
) -> None:
    """The largest slip load is that of another grip, which cannot."""
    team, limits = ho.Team(3, length, tension=tension), Requirements(ho.Limits(tilt_deg=50))
    stone = ho.SolidObject(ho.Section(outline=outline), 0.0, 0.3, mass=mass, friction=friction)
    most, _ = largest_tension(limits, team.quadrotor[0])
    best = best_grip(grip_task(stone, team, SEARCHED * most, limits)).vertices[:, :2]
    closed = grip_polygons("stone", stone, team, limits, 0.08).closed
    place, pulls = np.zeros(4), np.full((2, 3), tension)
    taking = Move(place, place, pulls, (0.0, 1.0), (0.0, 0.0), SmoothLaw(1.0))

    def apart(clasps: Array) -> float:
        """The least distance of drones over their limit, where all clasps find their balance."""
        hitch = GrippedHitch(team, stone, clasps, clasps, 0.15, np.full(3, 0.5))
        try:
            drones = hitch.curves(taking, np.linspace(0.0, taking.law.duration, 17))["drones"]
        except ho.InfeasibleError:
            return 0.0
        away = np.linalg.norm((drones[:, :, None] - drones[:, None]) / [0.24, 0.24, 0.6], axis=-1)
        return float(np.min(away[:, *np.triu_indices(6, 1)]))

    assert apart(best) < 1.0 < apart(closed)


@pytest.fixture(scope="module")
def grasped() -> Motion:
    plan = ho.solve(problem(0.05, 1.0))
    assert plan.certificate.certified
    return plan.motion


@pytest.mark.slow
def test_edges_that_touch_first_pull_little(grasped: Motion) -> None:
    """At 1.3 N they would push the stone along; it is closed with less, and tightened then."""
    grasp = next(phase for phase in grasped.phases if phase.name == "grasp")
    t = np.linspace(grasp.start, grasp.end, 4001)
    p, c, T = grasped.vertices.at(t), grasped.edge_contacts.at(t), grasped.tensions.at(t)
    force = np.zeros((len(t), 2))
    for away in (c[:, :, 0] - p, c[:, :, 1] - np.roll(p, -1, axis=1)):
        unit = away / np.linalg.norm(away, axis=-1, keepdims=True)
        force -= np.sum(T[..., None] * unit, axis=1)[:, :2]
    pushed = np.max(np.linalg.norm(force, axis=-1))
    assert 0.05 < pushed < 1.0 * 0.05 * 9.81
    np.testing.assert_allclose(T[-1], 1.3)
    assert 1.3 * pushed / np.min(T) > 1.0 * 0.05 * 9.81


@pytest.mark.slow
def test_what_edges_push_along_at_any_tension_is_refused() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"edges push it along.*objects.stone.friction"):
        ho.solve(problem(0.012, 1.0))


@pytest.mark.slow
def test_light_objects_that_sticking_clasps_would_hold_are_refused() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"left as clasps stick.*team.cable_friction"):
        ho.solve(problem(0.05, 1.0, clasps=0.2))
