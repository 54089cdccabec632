"""Plan files hold what was asked: what differs from that is refused by its key."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.mission.loading import asked_in, parse_problem
from hitchopt.motion.asked import asked_of, check_asked

ROOT = Path(__file__).parents[2]

FORM = """
title: tied
team:
  robots: 3
  cable_length: [2.4, 2.4, 2.6]
  cable_density: 0.003
  cable_friction: 0.05
  tension: 0.5
  quadrotor: [{mass: 0.132}, {mass: 0.14}, {mass: 0.15, max_thrust: 2.8}]
limits: {speed: 0.9}
arena: {lower: [-4, -4, 0], upper: [4, 4, 4]}
objects: {table: {circle: 0.2, to: 0.4, at: [3, 3, 0], fixed: true}}
start:
  drones:
    q: [[0.9, 0.2, 1.5], [-1.2, -0.6, 1.5], [-0.4, 1.2, 1.5]]
    r: [[0.2, -1.2, 1.5], [-1.0, 0.6, 1.5], [0.8, 0.9, 1.5]]
mission:
- form: {polygon: [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], altitude: 1.6}
"""


def changed(path: Path, change: Callable[[dict[str, Any], dict[str, Any]], None]) -> None:
    """Save a plan again after a change of its settings and arrays."""
    with np.load(path) as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    change(settings, arrays)
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})


@pytest.fixture(scope="module")
def tied() -> ho.Plan:
    return ho.solve(ROOT / "problems" / "form_triangle.yaml")


@pytest.fixture(scope="module")
def formed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A formed hitch of unlike robots, saved by the command line with its problem's text."""
    folder = tmp_path_factory.mktemp("formed")
    (folder / "tied.yaml").write_text(FORM)
    done = CliRunner().invoke(main, ["solve", str(folder / "tied.yaml"), "-o", str(folder / "out")])
    assert done.exit_code == 0, done.output
    return folder / "out" / "plan.npz"


def swapped(settings: dict[str, Any], _: Any) -> None:
    robots = settings["assignment"]["robots"]
    robots[0], robots[1] = robots[1], robots[0]


def flipped(settings: dict[str, Any], _: Any) -> None:
    settings["assignment"]["flipped"][2] ^= True


def exchanged(_: Any, arrays: dict[str, Any]) -> None:
    order = [1, 0, 2, 3, 4, 5]
    arrays["drones"] = arrays["drones"][:, order]


def setting(*path: str | int, to: Any) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    def change(settings: dict[str, Any], _: Any) -> None:
        place: Any = settings
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to

    return change


def scaled(name: str, factor: float) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    def change(_: Any, arrays: dict[str, Any]) -> None:
        arrays[name] = arrays[name] * factor

    return change


LIES: dict[str, tuple[str, Callable[[dict[str, Any], dict[str, Any]], None]]] = {
    "two robots exchanged": ("assignment.robots", swapped),
    "q and r exchanged": ("assignment.flipped", flipped),
    "two drones' paths exchanged": ("assignment.flipped", exchanged),
    "no assignment": ("assignment", lambda settings, _: settings.pop("assignment")),
    "lighter drones": ("mass", scaled("mass", 0.5)),
    "stronger drones": ("max_thrust", scaled("max_thrust", 1.5)),
    "longer cables": ("cable_length", scaled("cable_length", 1.01)),
    "lower tensions": ("tension", scaled("tension", 0.5)),
    "cables without weight": ("cable_density", setting("team", "cable_density", to=0.0)),
    "no friction": ("cable_friction", setting("team", "cable_friction", to=0.0)),
    "a load": ("load", setting("team", "load", to=[0.01, 0.0, 0.0])),
    "faster": ("limits.speed", setting("limits", "speed", to=9.0)),
    "tilted farther": ("limits.tilt_deg", setting("limits", "tilt", to=1.2)),
    "no limit on the duration": ("limits.duration", setting("asked", "limits", "duration", to=9.0)),
    "nearer": ("separation.radius", setting("separation", "radius", to=0.01)),
    "lower": ("separation.height", setting("separation", "height", to=0.1)),
    "cables nearer": ("separation.cable", setting("separation", "cable", to=0.01)),
    "no arena": ("arena", setting("arena", to=None)),
    "a larger arena": ("arena.upper[2]", setting("arena", "upper", to=[4, 4, 9])),
    "a thinner table": ("objects.table", setting("objects", "table", "section", "radius", to=0.1)),
    "a table elsewhere": ("objects.table", setting("objects", "table", "at", to=[3, 2, 0])),
    "no table": ("objects.table", setting("objects", to={})),
    "another start": ("start.drones.q[0]", setting("asked", "start", "drones", "q", 0, 0, to=2.0)),
    "a start in words": ("asked", setting("asked", "start", "drones", "q", 0, 0, to="left")),
    "a start that is none": ("asked", setting("asked", "start", "drones", to=None)),
    "a prism": (
        "keep_out",
        setting("asked", "keep_out", to=[{"polygon": [], "lower": 0, "upper": 1}]),
    ),
    "nothing asked": ("asked", setting("asked", to={})),
    "no mapping": ("asked", setting("asked", to=[])),
    "not a word": ("asked", lambda settings, _: settings.pop("asked")),
}


@pytest.mark.parametrize("lie", LIES)
def test_what_differs_from_what_was_asked_is_refused_by_its_key(
    lie: str, formed: Path, tmp_path: Path
) -> None:
    key, change = LIES[lie]
    path = tmp_path / "plan.npz"
    path.write_bytes(formed.read_bytes())
    changed(path, change)
    with pytest.raises(FileError) as caught:
        ho.load(tmp_path)
    assert key in str(caught.value)
    if lie == "no mapping":
        done = CliRunner().invoke(main, ["check", str(tmp_path)])
        assert done.exit_code == 2
        assert key in done.output


def test_the_text_of_the_problem_is_compared_too(formed: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    for old, new, key in (
        ("{mass: 0.14}", "{mass: 0.28}", "asked.team.quadrotor[1].mass"),
        ("speed: 0.9", "speed: 0.8", "asked.limits.speed"),
        ("[0.8, 0.9, 1.5]", "[0.8, 0.8, 1.5]", "asked.start.drones.r[2][1]"),
        ("robots: 3", "robots: four", "robots"),
    ):
        path.write_bytes(formed.read_bytes())
        text = FORM.replace(old, new)
        assert text != FORM
        changed(path, setting("problem", to=text))
        with pytest.raises(FileError) as caught:
            ho.load(tmp_path)
        assert key in str(caught.value)


def test_what_was_asked_is_in_the_order_of_the_start(formed: Path) -> None:
    with np.load(formed) as file:
        settings = json.loads(str(file["settings"]))
        masses = file["mass"].tolist()
    asked, robots = settings["asked"], settings["assignment"]["robots"]
    assert [kind["mass"] for kind in asked["team"]["quadrotor"]] == [0.132, 0.14, 0.15]
    assert masses == [asked["team"]["quadrotor"][i]["mass"] for i in robots]
    assert asked["start"]["drones"]["q"][1] == pytest.approx([-1.2, -0.6, 1.5])
    assert asked["limits"]["tilt_deg"] == pytest.approx(45.0)


@pytest.mark.parametrize(
    "name",
    [
        *("triangle", "open_chain", "swarms/head_on", "form_triangle"),
        pytest.param("carry_box", marks=pytest.mark.slow),
    ],
)
def test_plans_ask_what_their_problems_do(name: str) -> None:
    path = ROOT / "problems" / f"{name}.yaml"
    text = path.read_text()
    motion = ho.solve(parse_problem(text, str(path), path.parent)).motion
    check_asked(asked_in(text, motion.requirements.objects), motion, whole=False)
    check_asked(asked_of(motion), motion)


@pytest.mark.slow
def test_plans_made_in_python_and_their_aborts_are_read_again(
    tied: ho.Plan, tmp_path: Path
) -> None:
    team = ho.Team(robots=3, cable_length=2.4)
    polygon = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
    start = ho.Hitch.spread(team, polygon, altitude=1.0)
    plan = ho.morph(start, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])
    for i, each in enumerate((plan, plan.abort(1.0), tied, tied.abort(2.0))):
        each.save(tmp_path / str(i))
        read = ho.load(tmp_path / str(i))
        assert read.certificate.certified
    with np.load(tmp_path / "0" / "plan.npz") as file:
        asked = json.loads(str(file["settings"]))["asked"]
    assert asked["start"]["hitch"]["polygon"][0] == pytest.approx([0.0, -1.0])
    assert asked["start"]["hitch"]["altitude"] == pytest.approx(1.0)
