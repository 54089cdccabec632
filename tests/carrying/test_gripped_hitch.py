"""Hitches that close around lopsided outlines: seams, pushes, and how weight is taken over."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.motion.motion import Motion

NINE = np.array(
    [
        *([0.044, 0.181], [-0.136, 0.131], [-0.171, 0.084], [-0.185, -0.05], [-0.099, -0.16]),
        *([0.069, -0.173], [0.082, -0.168], [0.145, -0.121], [0.133, 0.134]),
    ]
)
"""Two edges come to touch it long before the third does [m]."""


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
