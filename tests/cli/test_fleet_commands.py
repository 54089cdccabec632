"""export and lint as a user types them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hitchopt.cli import main
from hitchopt.exports.formats.known_formats import HOMES
from hitchopt.exports.refit import point_rounding
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.plan_file import write_plan

PROBLEM = {
    "team": {"robots": 3, "cable_length": 2.4},
    "limits": {"speed": 0.3},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"transport": {"to": [0.5, 0.5, 1.0]}}],
}


WARNINGS = {"crazyswarm2": 2, "compressed": 2, "skybrush": 1, "skybrush_csv": 1}
"""Formats without feed-forward of the cable force, and those whose controllers have an integral."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a plan that goes at its limit of speed."""
    folder = tmp_path_factory.mktemp("plans") / "out"
    folder.mkdir()
    write_plan(folder / "plan.npz", solve_problem(problem_from_dict(PROBLEM)).motion, "Carried")
    return folder


@pytest.fixture(autouse=True)
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.parametrize("name", list(HOMES))
def test_every_format_there_and_back(name: str, plan: Path) -> None:
    done = run("export", plan, "--format", name, "-o", "files")
    assert done.exit_code == 0, done.output
    assert "certified as exported" in done.stdout
    assert "from the plan, over all time" in done.stdout
    assert "not carried: " in done.stdout
    again = run("lint", "files")
    assert again.exit_code == 0, again.output
    assert f"0 errors, {WARNINGS.get(name, 0)} warning" in again.stdout
    assert again.stdout.count("warning: tension: ") == WARNINGS.get(name, 0)


def test_a_bag_is_for_the_release_that_is_named(plan: Path) -> None:
    done = run("export", plan, "--format", "ros2bag", "-o", "bag", "--ros-distro", "jazzy")
    assert done.exit_code == 0, done.output
    assert "version: 9" in Path("bag/metadata.yaml").read_text()
    assert run("export", plan, "--format", "ros2bag", "--ros-distro", "foxy").exit_code == 2


def test_a_lost_limit_ends_with_3_and_what_would_do(
    plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(point_rounding, "MOST", -1)  # rounding is left as it is
    done = run("export", plan, "--format", "compressed", "-o", "files")
    assert done.exit_code == 3
    assert done.stdout == ""
    assert "error: speed: " in done.stderr
    assert "(the plan keeps 0.29" in done.stderr
    assert list(tmp_path.iterdir()) == []
    (line,) = (line for line in done.stderr.splitlines() if "verified: --stretch" in line)
    factor = line.split()[3]
    slower = run("export", plan, "--format", "compressed", "-o", "files", "--stretch", factor)
    assert slower.exit_code == 0, slower.output


def test_next_to_the_plan_by_default(plan: Path) -> None:
    done = run("export", plan, "--format", "npz")
    assert done.exit_code == 0
    assert (plan.parent / "out-npz" / "setpoints.npz").exists()


def test_frames_origin_yaw_and_fleet(plan: Path, tmp_path: Path) -> None:
    roles = [f"{end}{k}" for k in range(3) for end in "qr"]
    entries = [
        f"  {role}: {{name: cf{i}, uri: radio://0/80/2M/E7E7E7E70{i}}}"
        for i, role in enumerate(roles)
    ]
    Path("fleet.yaml").write_text("\n".join(["drones:", *entries]))
    done = run(
        *("export", plan, "--format", "csv", "--frame", "ned", "--origin", "1", "2", "0.5"),
        *("--yaw-deg", "90", "--fleet", "fleet.yaml", "-o", "files", "--rate", "10"),
    )
    assert done.exit_code == 0, done.output
    header, first, *_ = (tmp_path / "files" / "setpoints_ned.csv").read_text().splitlines()
    row = dict(zip(header.split(","), first.split(","), strict=True))
    assert row["drone"] == "cf0"
    assert float(row["z"]) == -1.5
    assert math.isclose(float(row["yaw"]), 0.0, abs_tol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["--format", "crazyswarm"], "did you mean crazyswarm2?"),
        (["--format", "csv", "--frame", "up"], "must be one of enu, nwu, ned"),
        (["--format", "mavsdk_drone_show", "--frame", "enu"], "must be one of ned for mavsdk"),
        (["--format", "csv", "--rate", "0"], "--rate = 0.0: must be above 0"),
        (["--format", "csv", "--rate", "nan"], "--rate = nan"),
        (["--format", "skybrush", "--rate", "10"], "it does not sample"),
        (["--format", "csv", "--stretch", "0.9"], "--stretch = 0.9: must be from 1"),
        (["--format", "csv", "--origin", "1", "2", "inf"], "three finite numbers"),
        (["--format", "csv", "--yaw-deg", "nan"], "yaw = nan"),
        (["--format", "csv", "--fleet", "nowhere.yaml"], "nowhere.yaml"),
        ([], "Missing option '--format'"),
    ],
)
def test_usage_that_is_wrong_ends_with_2(
    arguments: list[str], reported: str, plan: Path, tmp_path: Path
) -> None:
    done = run("export", plan, *arguments, "-o", "files")
    assert done.exit_code == 2, done.output
    assert reported in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_help_names_every_format() -> None:
    reported = run("export", "--help").stdout
    assert all(name in reported for name in HOMES)
    assert "Formats:" in reported


def test_no_plan_or_a_file_in_the_way_end_with_2(plan: Path) -> None:
    assert "there is no such file" in run("export", "nowhere", "--format", "csv").stderr
    ending = run("export", plan, "--format", "csv", "-o", "table.npz")
    assert ending.exit_code == 2
    assert "-o = 'table.npz': must be a folder" in ending.stderr
    assert list(Path().iterdir()) == []
    Path("taken").write_text("mine")
    done = run("export", plan, "--format", "csv", "-o", "taken")
    assert done.exit_code == 2
    assert "an export is a folder" in done.stderr
    assert Path("taken").read_text() == "mine"


def test_lint_ends_with_3_where_something_would_go_wrong(plan: Path) -> None:
    run("export", plan, "--format", "crazyswarm2", "-o", "files")
    done = run("lint", "files", "--speed", "0.1", "--radius", "2")
    assert done.exit_code == 3
    assert "error: speed: " in done.stderr
    assert "error: separation: " in done.stderr
    assert "2 errors, 2 warnings" in done.stdout
    assert run("lint", "files", "--radius", "-1").exit_code == 2
    assert run("lint", "nowhere").exit_code == 2
    assert "hitchopt check" in run("lint", plan).stderr


@pytest.mark.parametrize(
    ("name", "ending"),
    [
        ("csv", "csv"),
        ("parquet", "parquet"),
        ("npz", "npz"),
        ("json", "json"),
        ("skybrush", "skyc"),
    ],
)
def test_a_format_of_one_file_is_written_where_it_is_wanted(
    plan: Path, name: str, ending: str
) -> None:
    place = Path("new") / f"table.{ending}"
    reported = run("export", plan, "--format", name, "-o", str(place), "--stretch", "1.02")
    assert reported.exit_code == 0, reported.stderr
    assert run("export", plan, "--format", name, "-o", "folder", "--stretch", "1.02").exit_code == 0
    (same,) = (path for path in Path("folder").iterdir() if path.name != "export.json")
    assert place.stat().st_size == same.stat().st_size
    beside = {path.name for path in place.parent.iterdir()}
    assert beside == {place.name, f"{place.name}.export.json"}
    again = run("export", plan, "--format", name, "-o", str(place), "--stretch", "1.02")
    assert again.exit_code == 0
    Path("mine.csv").write_text("mine")
    assert run("export", plan, "--format", "csv", "-o", "mine.csv").exit_code == 2
    assert Path("mine.csv").read_text() == "mine"


def test_lint_of_trajectories_flown_from_the_drones_places(plan: Path) -> None:
    run("export", plan, "--format", "crazyswarm2", "-o", "files")
    done = run("lint", "files", "--relative")
    assert done.exit_code == 0, done.output
    assert "0 errors, 2 warnings" in done.stdout
    alone = run("lint", Path("files") / "q0.csv", "--relative")
    assert alone.exit_code == 0, alone.output


def test_lint_shows_the_limits_that_a_show_sets_itself(plan: Path) -> None:
    run("export", plan, "--format", "skybrush", "-o", "files")
    done = run("lint", "files")
    assert done.exit_code == 0, done.output
    assert "maxVelocityXY 0." in done.stdout
    assert "of 0.3 m/s, the show's own" in done.stdout
    assert " of 3 m/s" not in done.stdout


def test_lint_refuses_plans_by_name(plan: Path) -> None:
    told = run("lint", plan / "plan.npz")
    assert told.exit_code == 2
    assert "hitchopt check" in told.stderr


def test_set_points_hold_the_tension_where_that_is_asked(plan: Path) -> None:
    options = ["--hold-tension", "--stiffness", "4.75", "--damping", "1.3"]
    done = run("export", plan, "--format", "skybrush", "-o", "files", *options)
    assert done.exit_code == 0, done.output
    assert "note: set points are up to 8.4" in done.stdout
    assert "loops of 4.75 N/m and 1.3 N s/m" in done.stdout
    assert "separation" in done.stdout
    assert "thrust" not in done.stdout.partition("not carried")[0]
    assert "0 errors, 0 warnings" in run("lint", "files").stdout
    rigid = run("export", plan, "--format", "csv", "--hold-tension")
    assert rigid.exit_code == 2
    assert "give --stiffness, or team.quadrotor.stiffness" in rigid.stderr
