"""Flat trays: the rim is the underside; cables come in below it, beside a slim pillar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.storage.yaml_file import parse_yaml

FILE = Path(__file__).parents[2] / "problems" / "carry_tray.yaml"


def tray(**objects: Any) -> dict[str, Any]:
    """Return the problem of the collection with some keys of its objects changed."""
    given: Any = parse_yaml(FILE.read_text(), FILE.name)
    for name, keys in objects.items():
        given["objects"][name] |= keys
    return given  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    return ho.solve(FILE)


def test_a_flat_tray_is_carried_from_below(plan: ho.Plan) -> None:
    assert plan.certificate.certified
    motion = plan.motion
    names = list(motion.requirements.objects)
    lift = next(phase for phase in motion.phases if phase.name == "carry")
    times = np.linspace(lift.start, lift.end, 40)
    there = plan.at(times)
    underside = there.object_poses[:, names.index("tray"), 2]
    assert np.all(there.vertices[..., 2] <= underside[:, None] + 1e-6)
    level = there.vertices[..., :2] - there.object_poses[:, None, names.index("tray"), :2]
    assert np.all(np.linalg.norm(level, axis=-1) < 0.33)
    end = plan.at(plan.duration).object_poses[names.index("tray"), :3]
    assert end == pytest.approx([0.2, 1.8, 0.5], abs=1e-6)


def test_cables_keep_off_the_pillar(plan: ho.Plan) -> None:
    """By samples of edges, the pillar standing upright: level distances to its axis."""
    grasp, lift = (
        next(phase for phase in plan.phases if phase.name == name) for name in ("grasp", "lift")
    )
    vertices = plan.at(np.linspace(grasp.start, lift.start + 2.0, 200)).vertices
    starts, along = vertices[..., :2], np.roll(vertices, -1, axis=1)[..., :2] - vertices[..., :2]
    to = np.array([1.5, 0.0]) - starts
    share = np.clip(np.sum(to * along, -1) / np.sum(along * along, -1), 0.0, 1.0)
    apart = np.linalg.norm(to - share[..., None] * along, axis=-1) - 0.06
    worst = plan.certificate["object_clearance"].worst
    assert worst is not None
    assert float(np.min(apart)) >= worst - 1e-9
    assert worst >= 0.035


@pytest.mark.parametrize(
    ("name", "radius"), [("pillar", 0.3), pytest.param("stand", 0.31, marks=pytest.mark.slow)]
)
def test_what_is_in_the_way_is_refused_by_its_name(name: str, radius: float) -> None:
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(any_problem_from_dict(tray(**{name: {"circle": radius}})))
    broken = caught.value.violations[0]
    assert broken.constraint == "object_clearance"
    assert name in broken.where
    assert (broken.value, broken.limit) == (0.0, 0.035)


def test_a_tray_on_the_ground_is_to_be_stood_on_something() -> None:
    low = {"pillar": {"to": 0.02}, "tray": {"at": [1.5, 0, 0.02]}}
    with pytest.raises(ho.InfeasibleError, match="stand it on something") as caught:
        ho.solve(any_problem_from_dict(tray(**low)))
    assert "rim.at" not in str(caught.value)


@pytest.mark.parametrize("height", [-0.01, 0.06])
def test_a_rim_is_on_its_body(height: float) -> None:
    rim = ho.Rim(ho.Section(radius=0.33), height)
    with pytest.raises(ho.InputError, match=r"from the body's floor, 0 m, to its ceiling, 0\.05 m"):
        ho.SolidObject(ho.Section(radius=0.33), 0.0, 0.05, rim=rim)
