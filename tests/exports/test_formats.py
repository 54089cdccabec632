"""The file is the plan: every format, read by what knows nothing of hitchopt, and by the lint."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import Array, exported, hitch_plan, swarm_plan, task_of
from format_readers import READERS
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError, InfeasibleError, UnsupportedError
from hitchopt.exports.format import NOTE, format_of
from hitchopt.exports.lint import lint
from hitchopt.exports.options import HOMES
from hitchopt.exports.reading import read_manifest
from hitchopt.hitch import GRAVITY
from hitchopt.mission.loading import any_problem_from_dict, load_problem
from hitchopt.mission.problem import SwarmProblem
from hitchopt.mission.solving import solve_problem, solve_swarm
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at

ROOT = Path(__file__).parents[2]

MOTIONS = {"hitch": hitch_plan, "swarm": swarm_plan}

PLACE: dict[str, Any] = {"origin": [2.0, -1.0, 0.5], "yaw": 0.4}

AXES = {
    "enu": lambda x, y, z: (x, y, z),
    "nwu": lambda x, y, z: (y, -x, z),
    "ned": lambda x, y, z: (y, x, -z),
}

FRAMES = [(name, frame) for name in HOMES for frame in format_of(name).frames]


def in_file(frame: str, v: Array) -> Array:
    """Turned by the yaw of PLACE, then along the file's axes."""
    c, s = np.cos(PLACE["yaw"]), np.sin(PLACE["yaw"])
    east, north = c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]
    return np.stack(AXES[frame](east, north, v[..., 2]), axis=-1)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize(("name", "frame"), FRAMES)
def test_the_file_is_the_plan(name: str, frame: str, motion: str, tmp_path: Path) -> None:
    plan = MOTIONS[motion]()
    kind, team = format_of(name), plan.team
    (part,) = exported(plan, name, tmp_path, frame=frame, **PLACE)
    verdict = part.verdict
    assert verdict.lost == ()
    assert verdict.position.worst <= kind.accuracy <= 2e-3
    read = READERS[name](tmp_path, team.drone_names, np.linspace(0.0, plan.duration, 80))
    assert -1e-8 <= read.t[-1] - plan.duration < 0.05
    if kind.rate:
        single = 1e-6 if name == "gltf" else 1e-9  # whose times have single precision
        np.testing.assert_allclose(np.diff(read.t)[:-1], 1.0 / kind.rate, atol=single)
    states = states_at(plan, read.t)
    origin = np.array(AXES[frame](*PLACE["origin"]))
    apart = np.linalg.norm(read.places - in_file(frame, states.positions) - origin, axis=-1)
    assert np.max(apart) <= verdict.position.worst + 1e-6
    if read.velocities is not None:
        apart = np.linalg.norm(read.velocities - in_file(frame, states.velocities), axis=-1)
        assert np.max(apart) <= verdict.velocity.worst + 1e-6
    if read.forward is not None:  # m (a_ff + g up) is the thrust
        up = np.array([0.0, 0.0, -GRAVITY if frame == "ned" else GRAVITY])
        thrust = in_file(frame, states.thrusts(team))
        np.testing.assert_allclose(team.mass[:, None] * (read.forward + up), thrust, atol=1e-6)
    if read.quaternions is not None and read.rates is not None:
        found = Rotation.from_quat(read.quaternions.reshape(-1, 4), scalar_first=True)
        specific = thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
        upward = [0.0, 0.0, -1.0 if frame == "ned" else 1.0]
        np.testing.assert_allclose(found.apply(upward), specific.reshape(-1, 3), atol=1e-9)
        ahead = found.apply([1.0, 0.0, 0.0])
        east = in_file(frame, np.array([1.0, 0.0, 0.0]))
        np.testing.assert_allclose(ahead[:, 0] * east[1], ahead[:, 1] * east[0], atol=1e-9)
        assert np.all(ahead @ east > 0.0)
        turning = np.linalg.norm(read.rates[..., :2], axis=-1)
        expected = np.linalg.norm(states.body_rates[..., :2], axis=-1)
        np.testing.assert_allclose(turning, expected, atol=1e-8)


@pytest.mark.parametrize("name", HOMES)
def test_lint_has_nothing_to_complain_of(name: str, tmp_path: Path) -> None:
    (part,) = exported(hitch_plan(), name, tmp_path)
    (found,) = lint(tmp_path)
    assert found.sound
    lead = 0.0
    if name == "mavsdk_drone_show":  # which flies nothing of it by its own settings
        assert [(f.level, f.rule) for f in found.findings] == [(NOTE, "settings")]
        lead = json.loads((tmp_path / "export.json").read_text())["receiver"]["plan_begins_s"]
    else:
        assert found.findings == ()
    assert (found.kind, found.frame) == (name, format_of(name).frames[0])
    assert len(found.facts) == 6
    checks = {check.name: check.bound for check in part.verdict.checks}
    assert found.flight.separation == pytest.approx(checks["separation"], rel=2e-3)
    speed = max(checks["speed"], 0.5 if lead else 0.0)
    assert found.flight.speed == pytest.approx(speed, rel=2e-3)
    assert found.flight.duration == pytest.approx(part.verdict.duration + lead)


@lru_cache
def planned(stem: str) -> Motion:
    return solve_problem(load_problem(ROOT / "problems" / f"{stem}.yaml")).motion


@pytest.mark.parametrize("name", ["crazyswarm2", "compressed", "skybrush"])
@pytest.mark.parametrize(
    "stem",
    ["open_chain", "paper_experiment_3", "unequal_cables", "thrust_bound", "narrow_arena"],
)
def test_refitted_problems_lose_nothing(stem: str, name: str, tmp_path: Path) -> None:
    (part,) = exported(planned(stem), name, tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst <= format_of(name).accuracy


@pytest.mark.slow
@pytest.mark.parametrize(("name", "cut"), [("crazyswarm2", True), ("compressed", False)])
def test_a_mission_is_cut_where_it_loses_a_limit_as_one(
    name: str, cut: bool, tmp_path: Path
) -> None:
    parts = exported(planned("tie_carry_untie"), name, tmp_path)
    assert (len(parts) > 1) is cut
    for part in parts:
        assert part.verdict.lost == ()
        checks = {check.name for check in part.verdict.checks}
        assert {"separation", "cable_clearance"} <= checks
    assert any("span" in {check.name for check in part.verdict.checks} for part in parts)


def test_an_export_that_enters_a_prism_is_refused(tmp_path: Path) -> None:
    """The path keeps 0.12009 m; in whole millimetres it begins at 0.1196 m."""
    y = 0.12049
    prism = [[-3.0, -1.0], [-3.0, 0.0004], [3.0, 0.0004], [3.0, -1.0]]
    problem = any_problem_from_dict(
        {
            "team": {"drones": 1},
            "start": [[-1.5, y, 1.0]],
            "goal": [[1.5, y, 1.0]],
            "keep_out": [{"polygon": prism, "lower": 0.0, "upper": 3.0}],
        }
    )
    assert isinstance(problem, SwarmProblem)
    motion = solve_swarm(None, problem).motion
    exported(motion, "csv", tmp_path / "csv")
    with pytest.raises(InfeasibleError, match="keep_out"):
        exported(motion, "compressed", tmp_path / "compressed")
    assert not (tmp_path / "compressed").exists()


@pytest.mark.parametrize("name", ["parquet", "ros2bag"])
def test_a_missing_library_says_what_to_install(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(module: str) -> None:
        raise UnsupportedError(f"{module}; pip install 'hitchopt[export]'")

    place = {"parquet": "tables", "ros2bag": "ros2bag"}[name]
    monkeypatch.setattr(f"hitchopt.exports.formats.{place}.needed", missing)
    with pytest.raises(UnsupportedError, match=r"pip install 'hitchopt\[export\]'"):
        exported(swarm_plan(), name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_manifest_says_frame_drones_errors_and_checks(tmp_path: Path) -> None:
    (part,) = exported(hitch_plan(), "csv", tmp_path, frame="ned", **PLACE)
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert (manifest["frame"], manifest["origin_enu"]) == ("ned", [2.0, -1.0, 0.5])
    assert manifest["yaw_deg"] == pytest.approx(np.degrees(0.4))
    assert manifest["drones"] == {name: name for name in hitch_plan().team.drone_names}
    assert manifest["position_error_m"]["worst"] == part.verdict.position.worst
    assert [c["name"] for c in manifest["checks"]] == [c.name for c in part.verdict.checks]
    assert all(c["holds"] for c in manifest["checks"])


def test_only_files_of_exports_are_replaced(tmp_path: Path) -> None:
    folder, other = tmp_path / "out", tmp_path / "other"
    exported(swarm_plan(), "csv", folder)
    (folder / "mine.txt").write_text("mine")
    exported(swarm_plan(), "npz", folder)
    assert sorted(p.name for p in folder.iterdir()) == ["export.json", "mine.txt", "setpoints.npz"]
    other.mkdir()
    (other / "setpoints.npz").write_text("somebody's")
    with pytest.raises(FileError, match="not from an export"):
        exported(swarm_plan(), "npz", other)
    assert (other / "setpoints.npz").read_text() == "somebody's"


def test_attitudes_turn_as_their_rates_say() -> None:
    """Differentiated numerically: the body's rates are those of the quaternions."""
    for frame in AXES:
        task = task_of(hitch_plan(), "csv", frame=frame, yaw=0.4)
        t, h = np.array([0.21, 0.4, 1.9]), 1e-5
        now = task.attitudes(states_at(hitch_plan(), t))
        before, after = (
            Rotation.from_quat(each.quaternions.reshape(-1, 4), scalar_first=True)
            for each in (task.attitudes(states_at(hitch_plan(), t + d)) for d in (-h, h))
        )
        turned = (before.inv() * after).as_rotvec() / (2 * h)
        np.testing.assert_allclose(turned, now.body_rates.reshape(-1, 3), atol=2e-4)
        assert np.max(np.abs(now.body_rates)) > 0.05
