"""The command ``hitchopt statics``: its output, files and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import hitchopt as ho
from hitchopt.cli import main


@pytest.fixture
def solved(tmp_path: Path) -> Path:
    """Return the plan of a regular triangle, at rest for a second."""
    team = ho.Team(3, 2.4, tension=0.5, quadrotor=ho.Quadrotor(stiffness=4.75))
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    return ho.hold(hitch, seconds=1.0).save(tmp_path / "out")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["statics", *(str(argument) for argument in arguments)])


def test_a_plan_without_errors_rests_where_it_says(solved: Path) -> None:
    result = run(solved, "--at", "0.5")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("0.500         0.500   no") == 3
    said = json.loads((solved / "statics.json").read_text(encoding="utf-8"))
    assert said["format"] == "hitchopt-statics/1"
    assert said["t"] == [0.5]
    assert said["slack_cables"] == said["loose_clasps"] == []
    assert said["force_residual"] < 1e-9
    planned = ho.load(solved).at(0.5)
    for name, places in (("vertices", planned.vertices), ("drones", planned.positions)):
        found = [entry["position"][0] for entry in said[name]]
        np.testing.assert_allclose(found, places, atol=1e-9)
    np.testing.assert_allclose([c["tension"][0] for c in said["cables"]], 0.5, atol=1e-9)
    assert "errors" not in said
    assert (solved / "statics.png").read_bytes().startswith(b"\x89PNG")
    assert "note" not in result.stdout


@pytest.mark.slow
def test_ranges_are_those_of_python(solved: Path) -> None:
    result = run(solved, "--samples", "3", "--cable-error", "0.01", "--force-error", "sd:0.02")
    assert result.exit_code == 0, result.output
    assert "range [N]" in result.stdout
    assert "beyond first order" in result.stdout
    plan = ho.load(solved)
    found = ho.tolerance(
        plan, [0.0, 1.0], cable_error=0.01, force_error=ho.ErrorSize(deviation=0.02)
    )
    said = json.loads((solved / "statics.json").read_text(encoding="utf-8"))
    assert said["errors"]["cable"] == {"bound": 0.01, "deviation": 0.0}
    assert said["errors"]["force"] == {"bound": 0.0, "deviation": 0.02}
    assert len(said["t"]) == 3
    ends = [[said["cables"][k][name][0] for name in ("smallest", "largest")] for k in range(3)]
    np.testing.assert_allclose(ends, found.tensions[0], rtol=1e-6)
    radii = [vertex["radius"][-1] for vertex in said["vertices"]]
    np.testing.assert_allclose(radii, found.radii[-1], rtol=1e-4)


def test_conditions_reach_what_settles(solved: Path) -> None:
    options = ["--cable-length", "2.39,2.41,2.4", "--density", "0.004", "--load", "0.002"]
    options += ["--stiffness", "8", "--axial-stiffness", "500"]
    assert run(solved, "--at", "0.5", *options).exit_code == 0
    said = json.loads((solved / "statics.json").read_text(encoding="utf-8"))
    found = ho.settle(
        ho.load(solved),
        0.5,
        cable_length=[2.39, 2.41, 2.4],
        cable_density=0.004,
        load=0.002,
        stiffness=8.0,
        axial_stiffness=500.0,
    )
    np.testing.assert_allclose([c["tension"][0] for c in said["cables"]], found.tensions, rtol=1e-9)


def test_slack_cables_end_with_3_and_are_named(solved: Path) -> None:
    result = run(solved, "--no-feed-forward", "--cable-length", "2.6")
    assert result.exit_code == 3
    assert "note: without feed-forward of the cable force" in result.stdout
    assert "slack, or without hold: c0, c1, c2, p0, p1, p2" in result.stderr
    assert json.loads((solved / "statics.json").read_text())["slack_cables"] == ["c0", "c1", "c2"]


def test_an_integral_is_warned_of(solved: Path) -> None:
    result = run(solved, "--at", "0", "--integral", "--tolerance", "--axial-stiffness", "100")
    assert result.exit_code == 0, result.output
    assert "note: an integral in the position loop" in result.stdout
    assert result.stdout.count("may be") == 3


def test_what_solve_writes_replaces_an_earlier_answer(solved: Path) -> None:
    assert run(solved, "--at", "0").exit_code == 0
    (solved / "mine.txt").write_text("mine")
    ho.load(solved).save(solved)
    assert not (solved / "statics.json").exists()
    assert not (solved / "statics.png").exists()
    assert (solved / "mine.txt").exists()
    assert run(solved, "--at", "0").exit_code == 0
    assert (solved / "certificate.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--at", "-1"], "t = "),
        (["--samples", "0"], "--samples = 0: must be from 1 to 1000"),
        (["--cable-error", "1 cm"], "--cable-error = '1 cm': must be a number, or sd:number"),
        (["--cable-length", "2.4,x"], "--cable-length = '2.4,x'"),
        (["--cable-length", "2.4,2.4"], "cable_length = "),
        (["--stiffness", "-1"], "stiffness = -1.0"),
    ],
)
def test_wrong_options_end_with_2(solved: Path, options: list[str], words: str) -> None:
    result = run(solved, *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert not (solved / "statics.json").exists()
