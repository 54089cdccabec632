"""Detours around obstacles: where offsets are free, and flights past pillars and walls."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.detours import DetourSearch
from hitchopt.planners.path import Path as HitchPath
from hitchopt.values import Array

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
GOAL = np.array([[0.1, -0.8], [-0.6, 0.4], [0.5, 0.6]]) + [4.0, 0.0]
TEAM = {"robots": 3, "cable_length": 2.4}
PILLAR: dict[str, Any] = {
    "outline": [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]],
    "to": 4.0,
}
WALL: dict[str, Any] = {
    "outline": [[-0.1, -2.5], [0.1, -2.5], [0.1, 2.5], [-0.1, 2.5]],
    "to": 1.6,
}
MORPH = [{"morph": {"polygon": GOAL.tolist()}}]
TRANSPORT = [{"transport": {"to": [4.0, 0.2, 1.5], "yaw_deg": 30.0}}]
BLENDED = [
    {"morph": {"polygon": (1.05 * TRIANGLE + [0.4, 0.1]).tolist(), "blend": True}},
    *MORPH,
]


def problem(
    mission: list[dict[str, Any]], turn: float = 0.0, side: float = 1.0, **shape: Any
) -> dict[str, Any]:
    """Return a mission past an obstacle at (2, 0.15) m, mirrored to a side and turned [rad]."""
    place = turned(np.array([[2.0, 0.15]]), turn, side)[0]
    obstacle = {**shape, "at": [*place.tolist(), 0.0], "yaw_deg": math.degrees(turn), "fixed": True}
    polygon = turned(TRIANGLE, turn, side)
    steps = [
        {name: {**step, "polygon": turned(np.array(step["polygon"]), turn, side).tolist()}}
        if "polygon" in step
        else {name: {**step, "to": [*turned(np.array([step["to"][:2]]), turn, side)[0], 1.5]}}
        for entry in mission
        for name, step in entry.items()
    ]
    return {
        "team": TEAM,
        "objects": {"obstacle": obstacle},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.5}},
        "mission": steps,
    }


def turned(points: Array, turn: float, side: float) -> Array:
    """Return points (n, 2) mirrored about x if the side is negative, then turned [rad].

    Vertices stay clockwise.
    """
    mirrored = points * [1.0, side]
    if side < 0.0 and len(points) > 1:
        mirrored = mirrored[[0, 2, 1]]
    cosine, sine = math.cos(turn), math.sin(turn)
    return np.asarray(mirrored @ np.array([[cosine, sine], [-sine, cosine]]))


def planned(*args: Any, **kwargs: Any) -> ho.Plan:
    """Return the certified plan of a mission past an obstacle."""
    plan = ho.solve(ho.problem_from_dict(problem(*args, **kwargs)))
    assert plan.certificate.certified
    return plan


def is_proven(plan: ho.Plan, folder: Path) -> bool:
    """Return whether ``hitchopt verify`` proves every limit of a plan."""
    plan.save(folder, picture=False)
    return all(row.verdict in verify.PASSING for row in verify.verify(folder))


@pytest.mark.parametrize("mission", [MORPH, TRANSPORT, BLENDED], ids=["morph", "move", "blend"])
def test_a_hitch_passes_a_pillar_on_a_short_way(mission: Any, tmp_path: Path) -> None:
    """Its vertices alone take 8 s; all of it moves aside by 1.6 m."""
    plan = planned(mission, **PILLAR)
    assert all("on a detour" in phase.remark for phase in plan.phases)
    assert plan.duration < 12.5
    assert len(plan.phases) == len(mission)
    assert is_proven(plan, tmp_path)


@pytest.mark.parametrize("turn", [math.pi / 2.0, 2.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_detours_turn_and_mirror_with_the_problem(turn: float, side: float) -> None:
    """Normals between bodies and obstacles do not turn: other headings differ by millimetres."""
    plain = planned(MORPH, **PILLAR)
    plan = planned(MORPH, turn, side, **PILLAR)
    assert plan.duration == pytest.approx(plain.duration, rel=0.01)


def test_a_hitch_flies_over_a_low_wall(tmp_path: Path) -> None:
    plan = planned(MORPH, **WALL)
    midway = plan.motion.vertices.at(0.5 * plan.duration)
    assert np.min(midway[:, 2]) > 1.6
    assert plan.duration < 10.0
    assert is_proven(plan, tmp_path)


def test_a_ceiling_leads_around_a_wall() -> None:
    data = problem(MORPH, **{**WALL, "outline": [[0.1, -1], [0.1, 1], [-0.1, 1], [-0.1, -1]]})
    data["arena"] = {"lower": [-4, -6, 0], "upper": [8, 6, 1.65]}
    plan = ho.solve(ho.problem_from_dict(data))
    assert plan.certificate.certified
    drones = plan.motion.drones.at(np.linspace(0.0, plan.duration, 201))
    assert np.max(drones[..., 2]) <= 1.65
    middles = np.mean(plan.motion.vertices.at(np.linspace(0.0, plan.duration, 201)), axis=1)
    assert np.max(np.abs(middles[:, 1])) > 1.0


def test_a_hitch_with_a_pillar_among_its_legs_rises_first(tmp_path: Path) -> None:
    """Between two legs that point outwards no way leads sideways."""
    data = problem(MORPH, outline=PILLAR["outline"], to=2.6)
    data["objects"]["obstacle"]["at"] = [0.45, 0.0, 0.0]
    data["team"] = {"robots": 3, "cable_length": 3.4}
    plan = ho.solve(ho.problem_from_dict(data))
    vertices = plan.motion.vertices.at(np.linspace(0.0, plan.duration, 201))
    assert np.max(vertices[..., 2]) > 2.6
    assert is_proven(plan, tmp_path)


@pytest.mark.parametrize(
    ("tilt", "place"),
    [(0.0, [2.0, 0.0, 0.0]), (0.8, [2.2, 0.7, 0.9]), (math.pi / 2.0, [2.2, 0.7, 0.9])],
)
def test_free_offsets_keep_the_distances(tilt: float, place: list[float]) -> None:
    """The distance of cables and drones is sampled; of blocked offsets it is not much larger."""
    outline = [[-0.3, -0.1], [-0.1, 0.2], [0.3, 0.1], [0.1, -0.3]]
    body = ho.SolidObject(ho.Section(outline), 0.0, 1.2, at=place, yaw=0.4, fixed=True)
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.5)
    end = ho.Hitch.spread(ho.Team(3, 2.4), GOAL, 1.5)
    requirements = Requirements(objects={"body": body})
    search = DetourSearch.of(HitchPath.straight(start, end), requirements)
    direction = search.direction(tilt)
    gaps = search.gaps(direction)
    offsets = np.linspace(-1.5, 1.5, 61)
    free = gaps.free(offsets)
    parts = search.layout.part_nodes
    drones = np.arange(3, 9)
    share = np.linspace(0.0, 1.0, 101)[:, None]
    cosine, sine = math.cos(0.4), math.sin(0.4)
    to_body = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    (slab,) = body.slabs
    for j in range(1, len(search.s) - 1, 6):
        for offset, is_free in zip(offsets, free[j], strict=True):
            nodes = (search.nodes[j] + offset * direction - place) @ to_body
            cables = nodes[parts[:, :1]] + share * (nodes[parts[:, 1:]] - nodes[parts[:, :1]])
            to_cables = float(np.min(slab.clearance(cables).distance))
            to_drones = float(np.min(slab.clearance(nodes[drones]).distance))
            above_ground = np.min(search.nodes[j][drones, 2] + offset * direction[2]) > 0.3
            if is_free:
                assert to_cables >= 0.035
                assert to_drones >= 0.12
            elif above_ground:
                assert to_cables < 0.1 or to_drones < 0.2
