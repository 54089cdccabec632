"""The commands export and lint."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

import hitchopt as ho
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.plan_file import write_plan
from tests.helpers.commands import run

pytestmark = pytest.mark.usefixtures("place")

PROBLEM = {
    "team": {"robots": 3, "cable_length": 2.4},
    "limits": {"speed": 0.3},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"transport": {"to": [0.5, 0.5, 1.0]}}],
}

ONE_FILE = {"csv": "csv", "skybrush": "skyc"}


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a plan that goes at its limit of speed."""
    folder = tmp_path_factory.mktemp("plans") / "out"
    folder.mkdir()
    write_plan(folder / "plan.npz", solve_problem(ho.problem_from_dict(PROBLEM)).flight, "Carried")
    return folder


@pytest.mark.parametrize("name", ["csv", "ros2bag", "skybrush"])
def test_kinds_of_formats_there_and_back(name: str, plan: Path) -> None:
    """A table, a folder, and an upload that is refused without a stiffness."""
    export: list[str | Path] = ["export", plan, "--format", name]
    if name == "skybrush":
        done = run(*export, "-o", "files", code=3)
        assert "Cables will go slack" in done.stderr
        assert "--stiffness 4.75" in done.stderr
        assert "add --allow-slack" in done.stderr
        assert done.stdout == ""
        said = run(*export, "-o", "slack", "--allow-slack", code=0).stdout
        assert "certified as exported" not in said
        assert said.count("Cables will go slack") == 1
        assert "0 errors, 2 warnings" in run("lint", "slack", code=0).stdout
        export += ["--stiffness", "4.75"]
    said = run(*export, "-o", "files", code=0).stdout
    for words in ("certified as exported", "from the plan, at all times", "discontinuous"):
        assert words in said
    linted = run("lint", "files", code=0).stdout
    if name == "skybrush":  # the plan begins in the air
        assert "above the ground; begin with the take-off" in linted
        linted = linted.replace("0 errors, 1 warnings", "0 errors, 0 warnings")
    assert "0 errors, 0 warnings" in linted
    if name in ONE_FILE:  # written where it is wanted, again too
        file = Path("new") / f"table.{ONE_FILE[name]}"
        for _ in range(2):
            run(*export, "-o", file, code=0)
        assert {path.name for path in file.parent.iterdir()} == {
            file.name,
            f"{file.name}.export.json",
        }


PRISM = [[-3.0, -1.0], [-3.0, 0.0004], [3.0, 0.0004], [3.0, -1.0]]
PASSING = {
    "team": {"drones": 1},
    "start": [[-1.5, 0.12049, 1.0]],
    "goal": [[1.5, 0.12049, 1.0]],
    "keep_out": [{"polygon": PRISM, "lower": 0.0, "upper": 3.0}],
}
"""A path that keeps 0.12009 m, and 0.1196 m where it begins at a whole millimetre."""


def test_an_export_that_violates_a_limit_ends_with_3(place: Path) -> None:
    ho.solve(ho.problem_from_dict(PASSING)).save(place / "out")
    done = run("export", "out", "--format", "compressed", "-o", "files", code=3)
    assert done.stdout == ""
    for words in ("error: keep_out: ", "(the plan keeps 0.120", "sample at a higher --rate"):
        assert words in done.stderr
    assert [path.name for path in place.iterdir()] == ["out"]


def test_frames_origin_yaw_fleet_and_the_usual_place(plan: Path, place: Path) -> None:
    roles = [f"{end}{k}" for k in range(3) for end in "qr"]
    uri = "radio://0/80/2M/E7E7E7E70"
    entries = [f"  {x}: {{name: cf{i}, uri: {uri}{i}}}" for i, x in enumerate(roles)]
    Path("fleet.yaml").write_text("\n".join(["drones:", *entries]))
    run(
        *("export", plan, "--format", "csv", "--frame", "ned", "--origin", "1", "2", "0.5"),
        *("--yaw-deg", "90", "--fleet", "fleet.yaml", "-o", "files", "--rate", "10"),
        code=0,
    )
    header, first, *_ = (place / "files" / "setpoints_ned.csv").read_text().splitlines()
    row = dict(zip(header.split(","), first.split(","), strict=True))
    assert (row["drone"], float(row["z"])) == ("cf0", -1.5)
    assert math.isclose(float(row["yaw"]), 0.0, abs_tol=1e-9)
    run("export", plan, "--format", "parquet", code=0)
    assert (plan.parent / "out-parquet" / "setpoints.parquet").exists()


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        ("--format crazyswarm", "did you mean crazyswarm2?"),
        ("--format skybrush_csv", "did you mean skybrush?"),
        *((f"--format {x}", "did you mean mavsdk_drone_show?") for x in ("mavsdk", "px4")),
        ("--format crazyflie", "did you mean crazyswarm2?"),
        ("--format npz", "did you mean csv?"),
        ("--format xyz", "hitchopt export lists them"),
        ("--format csv --frame up", "'up' is not one of"),
        ("--format mavsdk_drone_show --frame enu", "must be ned for mavsdk"),
        ("--format csv --rate 0", "--rate = 0.0: must be above 0"),
        ("--format skybrush --rate 10", "it does not sample"),
        ("--format csv --stretch 0.9", "--stretch = 0.9: must be from 1"),
        ("--format csv --origin 1 2 inf", "origin[2] = inf: must be finite"),
        ("--format csv --fleet nowhere.yaml", "nowhere.yaml"),
        ("--format ros2bag --storage rosbag1", "'rosbag1' is not one of"),
        ("--format csv --hold-tension", "pass --stiffness, or team.quadrotor.stiffness"),
        ("--format csv --damping 2", "--damping = 2.0: must be omitted for csv without --hold"),
        ("--format csv -o table.parquet", "-o = 'table.parquet': must be a folder"),
        ("", "missing --format; choose one"),
    ],
)
def test_invalid_export_usage_ends_with_2(
    arguments: str, reported: str, plan: Path, place: Path
) -> None:
    words = arguments.split()
    placed = [] if "-o" in words else ["-o", "files"]
    assert reported in run("export", plan, *words, *placed, code=2).stderr
    assert list(place.iterdir()) == []


def test_lint_reports_errors_and_foreign_files_stay(plan: Path) -> None:
    run("export", plan, "--format", "crazyswarm2", "--allow-slack", "-o", "files", code=0)
    done = run("lint", "files", "--set", "speed=0.1", "--set", "radius=2", code=3)
    assert "error: speed: " in done.stderr
    assert "error: separation: " in done.stderr
    assert "2 errors, 1 warnings" in done.stdout
    assert "--set radius = -1" in run("lint", "files", "--set", "radius=-1", code=2).stderr
    run("lint", "nowhere", code=2)
    both = json.loads(run("lint", "files", "files/q1.csv", "--json", code=0).stdout)["reports"]
    assert [each["path"] for each in both] == ["files", "files/q1.csv"]
    assert "Missing argument 'PATH...'" in run("lint", code=2).stderr
    for path in (plan, plan / "plan.npz"):
        assert "hitchopt check" in run("lint", path, code=2).stderr
    assert 'No plan in "nowhere": name a' in run("export", "nowhere", "--format", "csv").stderr
    for name, told in (("taken", "an export is a folder"), ("mine.csv", "")):
        Path(name).write_text("mine")
        assert told in run("export", plan, "--format", "csv", "-o", name, code=2).stderr
        assert Path(name).read_text() == "mine"


@pytest.mark.slow
def test_notes_of_several_parts_are_said_once(place: Path) -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), PROBLEM["start"]["hitch"]["polygon"])  # type: ignore[index]
    mission: list[ho.MoveVertex | ho.Hold] = []
    for k in range(9):
        mission += [ho.MoveVertex(0, by=[0.0, 0.1 * (-1.0) ** k]), ho.Hold(1.0)]
    ho.solve(start, mission).save(place / "out")
    said = run("export", "out", "--format", "crazyswarm2", "--stiffness", "4.75", code=0).stdout
    assert said.count("note: cables are assumed weightless") == 1
    assert said.count("certified as exported") > 1


def test_lint_passes_tables_and_texts_with_the_line_ends_of_windows(plan: Path) -> None:
    run("export", plan, "--format", "crazyswarm2", "--stiffness", "4.75", "-o", "files", code=0)
    texts = {".csv", ".json", ".py", ".txt", ".yaml"}
    changed = [path for path in Path("files").iterdir() if path.suffix in texts]
    assert {".csv", ".json"} <= {path.suffix for path in changed}
    for path in changed:
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    done = run("lint", "files", code=0)
    assert "0 errors" in done.stdout
    assert "line ends" in done.stdout + done.stderr


def test_shows_declare_limits_and_hold_the_tension(plan: Path) -> None:
    slack = ("export", plan, "--format", "skybrush", "--allow-slack", "-o", "files")
    (part,) = json.loads(run(*slack, "--json", code=0).stdout)["parts"]
    assert part["goes_slack"]
    said = run("lint", "files", code=0).stdout
    assert re.search(r"maxVelocityXY \[m/s\], declared by the show +0\.\d+ +0\.3\n", said)
    assert re.search(r"\nspeed \[m/s\] +0\.\d+ +–\n", said)
    options = ["--stiffness", "4.75", "--damping", "1.3"]
    said = run("export", plan, "--format", "skybrush", "-o", "files", *options, code=0).stdout
    assert "note: setpoints lie up to 8.4" in said
    assert "gains 4.75 N/m, 1.3 N s/m" in said
    assert "separation" in said
    table, _, rest = said.partition("from the plan, at all times")
    assert "thrust" in table  # of the drones that follow the setpoints
    assert "jerk" not in table
    assert "Limits of motion hold for drones that follow the setpoints" in rest
    assert "0 errors, 1 warnings" in run("lint", "files").stdout  # it begins in the air
