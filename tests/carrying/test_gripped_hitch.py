"""Hitches that close around lopsided outlines: seams, pushes, and how weight is taken over."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks.registry import RULE_OF
from hitchopt.holding.grip_limits import largest_tension
from hitchopt.holding.grip_search import best_grip
from hitchopt.holding.wraps import wraps_around
from hitchopt.motion.motion import Motion
from hitchopt.objects.placing import in_frame
from hitchopt.planners.carrying.grip_polygon import SEARCHED, grip_polygons, grip_task
from hitchopt.planners.carrying.gripped_hitch import GrippedHitch
from hitchopt.planners.carrying.moves import Move
from hitchopt.planners.carrying.smooth_law import SmoothLaw
from hitchopt.requirements import Requirements
from hitchopt.values import Array

NINE = np.array(
    [
        *([0.044, 0.181], [-0.136, 0.131], [-0.171, 0.084], [-0.185, -0.05], [-0.099, -0.16]),
        *([0.069, -0.173], [0.082, -0.168], [0.145, -0.121], [0.133, 0.134]),
    ]
)
"""Two edges come to touch it long before the third does [m]."""

ALONG = np.array(
    [
        *([0.16, 0.11], [-0.09, 0.16], [-0.16, 0.11], [-0.2, -0.01]),
        *([-0.14, -0.13], [0.04, -0.18], [0.12, -0.14]),
    ]
)
"""The best grip by three cables has an edge along one of its sides, nearly [m]."""

TURNING = np.array(
    [
        *([0.137, -0.029], [0.093, 0.105], [-0.057, 0.128]),
        *([-0.134, 0.041], [-0.117, -0.077], [0.013, -0.139]),
    ]
)
"""About it the best grip by three cables hardly resists turning [m]."""

TEAM = ho.Team(3, 1.6, cable_density=0.01, tension=1.0)
STEEP = Requirements(limits=ho.Limits(tilt=math.radians(60)))


def body(outline: Array, mass: float = 0.05, friction: float = 1.0) -> ho.SolidObject:
    return ho.SolidObject(ho.Section(outline=outline), 0.0, 0.3, mass=mass, friction=friction)


@cache
def held() -> GrippedHitch:
    """A hitch that grips a stone of nine corners, its clasps not quite in balance."""
    stone = body(NINE)
    polygons = grip_polygons("stone", stone, TEAM, STEEP, 0.08)
    closed = polygons.closed + np.array([[0.004, 0.0], [0.0, 0.0], [0.0, -0.003]])
    split = np.array([0.5, 0.48, 0.53])
    return GrippedHitch(TEAM, stone, polygons.around, closed, 0.15, split)


def move(closed: tuple[float, float], borne: tuple[float, float] = (0.0, 0.0)) -> Move:
    place, pulls = np.array([0.4, -0.3, 0.0, 0.6]), np.full((2, 3), 1.2)
    return Move(place, place, pulls, borne, (0.0, 0.0), SmoothLaw(1.0), closed)


def ends(one: Move) -> tuple[dict[str, Array], dict[str, Array]]:
    times = np.array([0.0, one.law.duration])
    found = {name: each for name, each in held().curves(one, times).items() if name != "pose"}
    return {k: v[0] for k, v in found.items()}, {k: v[1] for k, v in found.items()}


def test_drones_stand_where_edges_come_to_bend_otherwise() -> None:
    events = held().events
    assert len(events) >= 3
    for event, before, after in zip(
        events, np.append(0.0, events), np.append(events[1:], 1.0), strict=False
    ):
        one, other = ends(move((before, event)))[1], ends(move((event, after)))[0]
        np.testing.assert_allclose(one["drones"], other["drones"], atol=1e-9)


def test_clasps_take_a_weight_over_without_a_jump() -> None:
    """They move aside for what lopsided edges pull, as far as they bear the weight."""
    standing = ends(move((1.0, 1.0)))[1]
    taken = move((1.0, 1.0), (0.0, 1.0))
    first, last = ends(taken)
    lifted = ends(move((1.0, 1.0), (1.0, 1.0)))[0]
    for name in ("vertices", "drones"):
        np.testing.assert_allclose(first[name], standing[name], atol=1e-9)
        np.testing.assert_allclose(last[name], lifted[name], atol=1e-9)
    aside = np.linalg.norm((last["vertices"] - first["vertices"])[:, :2], axis=1)
    assert np.max(aside) > 1e-4


def test_pushes_are_those_of_the_curves() -> None:
    """By vertices and contacts, as a plan would be looked at."""
    stone, largest = held(), 0.0
    for first, last in zip(np.append(0.0, stone.events), np.append(stone.events, 1.0), strict=True):
        one = move((first, last))
        found = stone.curves(one, np.linspace(0.0, one.law.duration, 400))
        p, c = found["vertices"][..., :2], found["contacts"][..., :2]
        force: Array = np.zeros((400, 2))
        for away in (c[:, :, 0] - p, c[:, :, 1] - np.roll(p, -1, axis=1)):
            # Edges pull contacts towards both clasps.
            force -= np.sum(1.2 * away / np.linalg.norm(away, axis=-1, keepdims=True), axis=1)
        largest = max(largest, float(np.max(np.linalg.norm(force, axis=-1))))
    assert largest > 0.3
    assert stone.largest_push(np.full(3, 1.2)) == pytest.approx(largest, rel=0.02)


@pytest.mark.slow
def test_grips_are_moved_off_corners_in_balance() -> None:
    lying = body(ALONG)
    most, _ = largest_tension(STEEP, TEAM.quadrotor[0])
    task = grip_task(lying, TEAM, SEARCHED * most, STEEP)
    best = best_grip(task).vertices[:, :2]
    moved = grip_polygons("stone", lying, TEAM, STEEP, 0.08).closed
    least = [
        float(wraps_around(lying.section, p).least_turns(lying.section)) for p in (best, moved)
    ]
    assert math.degrees(least[0]) < 0.6
    assert math.degrees(least[1]) > 1.9
    assert task.imbalance(task.grip(moved)) < 1e-9
    held = [float(task.grip(p).slip_load(1.0)) for p in (best, moved)]
    assert 0.9 * held[0] < held[1] < held[0]


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
def test_grips_are_taken_that_find_balance_as_they_take_the_weight() -> None:
    """The largest slip load is that of clasps which lose their balance at a quarter of it."""
    team = ho.Team(3, 1.99, tension=1.3)
    limits = Requirements(limits=ho.Limits(tilt=math.radians(50)))
    stone = body(TURNING, mass=0.138, friction=0.7)
    most, _ = largest_tension(limits, team.quadrotor[0])
    best = best_grip(grip_task(stone, team, SEARCHED * most, limits)).vertices[:, :2]
    closed = grip_polygons("stone", stone, team, limits, 0.08).closed
    place, pulls = np.zeros(4), np.full((2, 3), 1.3)
    taking = Move(place, place, pulls, (0.0, 1.0), (0.0, 0.0), SmoothLaw(1.0))

    def lifted(clasps: Array) -> dict[str, Array]:
        hitch = GrippedHitch(team, stone, clasps, clasps, 0.15, np.full(3, 0.5))
        return hitch.curves(taking, np.linspace(0.0, taking.law.duration, 17))

    with pytest.raises(ho.InfeasibleError, match="equilibrium"):
        lifted(best)
    assert np.max(np.abs(lifted(closed)["vertices"][-1, :, :2] - closed)) < 0.015


@pytest.mark.slow
def test_grips_are_taken_whose_drones_stay_apart_with_the_weight() -> None:
    """As this one's slopes turn the best grip's clasps, two drones come too close."""
    outline = np.array(
        [
            *([0.046, -0.164], [0.17, -0.011], [0.133, 0.106]),
            *([-0.081, 0.15], [-0.169, 0.014], [-0.089, -0.145]),
        ]
    )
    team = ho.Team(3, 2.31, tension=1.0)
    limits = Requirements(limits=ho.Limits(tilt=math.radians(50)))
    stone = body(outline, mass=0.121, friction=0.79)
    most, _ = largest_tension(limits, team.quadrotor[0])
    best = best_grip(grip_task(stone, team, SEARCHED * most, limits)).vertices[:, :2]
    closed = grip_polygons("stone", stone, team, limits, 0.08).closed
    place, pulls = np.zeros(4), np.ones((2, 3))
    held_up = Move(place, place, pulls, (1.0, 1.0), (0.0, 0.0), SmoothLaw(1.0))
    apart = []
    for clasps in (best, closed):
        hitch = GrippedHitch(team, stone, clasps, clasps, 0.15, np.full(3, 0.5))
        drones = hitch.curves(held_up, np.zeros(1))["drones"][0]
        away = np.linalg.norm((drones[:, None] - drones) / [0.24, 0.24, 0.6], axis=-1)
        apart.append(float(np.min(away[np.triu_indices(6, 1)])))
    assert apart[0] < 1.0 < apart[1]


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


def test_lengths_err_most_at_seams(grasped: Motion) -> None:
    loosen = next(phase for phase in grasped.phases if phase.name == "loosen")
    ends_at = np.array([loosen.end, loosen.start])
    pose = grasped.object_poses.at(ends_at)[:, None, 0]
    around, closed = in_frame(pose, grasped.vertices.at(ends_at))[..., :2]
    stone = next(iter(grasped.requirements.objects.values()))
    again = GrippedHitch(grasped.team, stone, around, closed, 0.15, np.full(3, 0.5))
    loose = np.min(grasped.tensions.at(np.linspace(loosen.start, loosen.end, 2001)), axis=0)
    found = RULE_OF["cable_length"].check(grasped)
    assert found is not None
    assert found.bound == pytest.approx(again.largest_seam(loose), rel=0.15)


def test_what_edges_push_along_at_any_tension_is_refused() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"edges push it along.*objects.stone.friction"):
        ho.solve(problem(0.012, 1.0))


@pytest.mark.slow
def test_light_objects_that_sticking_clasps_would_hold_are_refused() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"left as clasps stick.*team.cable_friction"):
        ho.solve(problem(0.05, 1.0, clasps=0.2))
