"""The command ``hitchopt simulate``: its output, files and exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import hitchopt as ho
from hitchopt.cli import main


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a regular triangle, at rest for a tenth of a second."""
    team = ho.Team(3, 2.4, tension=0.5, cable_density=0.01, cable_friction=0.1)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    place = tmp_path_factory.mktemp("plan") / "out"
    return ho.hold(hitch, seconds=0.1).save(place)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.slow
def test_one_flight_reports_that_it_holds_and_writes_files(solved: Path, tmp_path: Path) -> None:
    film = tmp_path / "flight.gif"
    result = run("simulate", solved, "--film", film, "--drones", "point")
    assert result.exit_code == 0, result.output
    assert "hitched: every vertex is linked and held" in result.stdout
    assert "times real time" in result.stdout
    for words in (
        "without sag",
        "while the plan stands still",
        "drones to their setpoints [cm]",
        "4.75 N/m",
        "nobody: the simulator's own",
        "10 g/m; the plan knows 10",
    ):
        assert words in result.stdout
    assert re.search(r"p0 +-?1 +0\.\d{3} ≥ 0\.150 ", result.stdout)
    assert result.stderr == ""
    place = solved / "simulation"
    names = {path.name for path in place.iterdir()}
    assert names == {
        "simulation.json",
        "vertices.csv",
        "cables.csv",
        "drones.csv",
        "recording.npz",
        "simulation.png",
    }
    summary = json.loads((place / "simulation.json").read_text(encoding="utf-8"))
    assert summary["hitched"] is summary["succeeded"] is True
    assert [clasp["name"] for clasp in summary["clasps"]] == ["p0", "p1", "p2"]
    assert summary["settings"]["lag"] == 0.08
    assert summary["settings"]["preset"]["name"] == "fast"
    with np.load(place / "recording.npz") as recording:
        assert recording["nodes"].shape == (len(recording["t"]), recording["cables"][-1], 3)
    rows = (place / "vertices.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("t,vertex,x,y,z,planned_x")
    assert len(rows) == 1 + 3 * len({row.split(",")[0] for row in rows[1:]})
    error = [float(row.split(",")[9]) for row in rows[1:]]
    mean = np.mean(error)
    assert mean == pytest.approx(summary["vertex_error"]["all"]["mean"], rel=1e-6)
    assert f"vertex error in 3-D, sag included: {100 * mean:.1f} ± " in result.stdout
    size = 1e3 * summary["compensation"]["cables_longer"]
    assert re.search(rf"ropes of 12 mm longer for their bends +≤ {size:.1f} mm", result.stdout)
    assert summary["position_loops"]["stiffness"] == pytest.approx([36.0 * 0.132] * 6)
    assert film.read_bytes()[:6] in {b"GIF87a", b"GIF89a"}
    assert [path.name for path in tmp_path.iterdir()] == ["flight.gif"]
    check = run("check", solved)  # the plan's own files are as they were
    assert check.exit_code == 0, check.output


@pytest.mark.slow
def test_a_campaign_reports_its_success_rate(solved: Path, tmp_path: Path) -> None:
    place = tmp_path / "campaign"
    options = ["--runs", "2", "--processes", "1", "--seed", "7", "--perturbed", "--noise", "0"]
    result = run("simulate", solved, "-o", place, "--drones", "point", *options)
    assert result.exit_code == 0, result.output
    assert (
        "2 of 2 flights succeeded: 100.0% (34.2% to 100.0% at 95 %), seeds 7 to 8" in result.stdout
    )
    assert {path.name for path in place.iterdir()} == {"campaign.json", "runs.csv"}
    settings = json.loads((place / "campaign.json").read_text(encoding="utf-8"))["settings"]
    assert settings["perturbations"]["noise"] == 0.0
    assert settings["perturbations"]["wind"] == 0.05
    assert settings["perturbations"]["downwash"] is True


def test_a_flight_that_fails_ends_with_3_and_the_failure(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.simulation.flight_outcome.HELD", 1e-4)  # every vertex moves more
    result = run("simulate", solved, "-o", tmp_path / "x", "--drones", "point")
    assert result.exit_code == 3, result.output
    assert "failed: t = " in result.stderr
    assert "under the pull test" in result.stderr
    assert "NOT hitched" in result.stdout
    summary = json.loads((tmp_path / "x" / "simulation.json").read_text(encoding="utf-8"))
    assert summary["succeeded"] is False
    assert summary["verdict"] == "failed"
    assert summary["failures"]


def test_an_invalid_run_counts_as_not_simulated(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.simulation.validity.MOST_STRAIN", -1.0)  # every one exceeds it
    result = run("simulate", solved, "-o", tmp_path / "x", "--drones", "point")
    assert result.exit_code == 3, result.output
    assert "not simulated: t = -2.50 s, simulation: strain of" in result.stderr
    assert "not simulated to its end: nothing is known of the hitch" in result.stdout
    assert "failed" not in result.output
    assert "NOT hitched" not in result.output
    assert "p0" not in result.stdout  # no vertex was judged
    summary = json.loads((tmp_path / "x" / "simulation.json").read_text(encoding="utf-8"))
    assert (summary["verdict"], summary["clasps"]) == ("not simulated", [])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--preset", "fine"], "'fine' is not one of 'fast', 'accurate'"),
        (["--preste", "fast"], "No such option"),
        (["--noise", "-1"], "noise = -1.0: must be at least 0"),
        (["--stiffness", "0"], "stiffness = 0.0: must be"),
        (["--stiffness", "60"], "oscillates more and more; lower it"),
        (["--density", "0.0001"], "time_step = 0.001: must be at most"),
        (["--runs", "0"], "runs = 0: must be at least 1"),
        (["--film", "flight.avi"], "must be a name in .gif or .mp4"),
        (["--film", "flight.gif", "--runs", "3"], "must be of a single flight"),
        (["--seed", "-3"], "seed = -3: must be a whole number"),
    ],
)
def test_invalid_options_end_with_2(
    solved: Path, tmp_path: Path, arguments: list[str], words: str
) -> None:
    result = run("simulate", solved, "-o", tmp_path / "x", *arguments)
    assert result.exit_code == 2, result.output
    assert words in result.stderr
    assert not (tmp_path / "x").exists()


def test_a_directory_without_a_plan_is_reported(tmp_path: Path) -> None:
    result = run("simulate", tmp_path)
    assert result.exit_code == 2
    assert "plan.npz: there is no such file" in result.stderr
