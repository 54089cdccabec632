"""The commands simulate and statics: their output, files and exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from problem_files import run

import hitchopt as ho

pytestmark = pytest.mark.usefixtures("place")


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a regular triangle, at rest for a tenth of a second."""
    team = ho.Team(3, 2.4, tension=0.5, cable_density=0.01, cable_friction=0.1)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    place = tmp_path_factory.mktemp("plan") / "out"
    return ho.hold(hitch, seconds=0.1).save(place)


@pytest.mark.slow
def test_one_flight_reports_that_it_holds_and_writes_files(solved: Path, tmp_path: Path) -> None:
    film = tmp_path / "flight.gif"
    result = run("simulate", solved, "--film", film, "--drones", "point", code=0)
    assert "hitched: every vertex is linked and held" in result.stdout
    assert "times real time" in result.stdout
    for words in (
        "the fast preset is 1 to 2 cm off; take the accurate one",
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
    tables = {"vertices.csv", "cables.csv", "drones.csv"}
    assert names == tables | {"simulation.json", "recording.npz", "simulation.png"}
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
    assert summary["warnings"] == []
    size = 1e3 * summary["compensation"]["cables_longer"]
    assert re.search(rf"ropes of 12 mm longer for their bends +≤ {size:.1f} mm", result.stdout)
    assert summary["position_loops"]["stiffness"] == pytest.approx([36.0 * 0.132] * 6)
    assert film.read_bytes()[:6] in {b"GIF87a", b"GIF89a"}
    assert [path.name for path in tmp_path.iterdir()] == ["flight.gif"]
    run("check", solved, code=0)  # the plan's own files are as they were


@pytest.mark.slow
def test_a_campaign_reports_its_success_rate(solved: Path, tmp_path: Path) -> None:
    place = tmp_path / "campaign"
    options = ["--runs", "2", "--processes", "1", "--seed", "7", "--perturbed", "--noise", "0"]
    result = run("simulate", solved, "-o", place, "--drones", "point", *options, code=0)
    assert (
        "2 of 2 flights succeeded: 100.0% (34.2% to 100.0% at 95 %), seeds 7 to 8" in result.stdout
    )
    assert {path.name for path in place.iterdir()} == {"campaign.json", "runs.csv"}
    settings = json.loads((place / "campaign.json").read_text(encoding="utf-8"))["settings"]
    assert settings["perturbations"]["noise"] == 0.0
    assert settings["perturbations"]["wind"] == 0.05
    assert settings["perturbations"]["downwash"] is True


@pytest.mark.slow
def test_a_flight_that_fails_ends_with_3_and_the_failure(
    solved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.simulation.judgement.HELD", 1e-4)  # every vertex moves more
    result = run("simulate", solved, "-o", tmp_path / "x", "--drones", "point", code=3)
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
    monkeypatch.setattr("hitchopt.simulation.world.MOST_STRAIN", -1.0)  # every one exceeds it
    result = run("simulate", solved, "-o", tmp_path / "x", "--drones", "point", code=3)
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
        ("--preset fine", "'fine' is not one of 'fast', 'accurate'"),
        ("--preste fast", "No such option"),
        ("--noise -1", "noise = -1.0: must be at least 0"),
        ("--stiffness 0", "stiffness = 0.0: must be"),
        ("--stiffness 60", "oscillates more and more; lower it"),
        ("--density 0.0001", "time_step = 0.001: must be at most"),
        ("--runs 0", "runs = 0: must be at least 1"),
        ("--film flight.avi", "must be a name in .gif or .mp4"),
        ("--film flight.gif --runs 3", "must be of a single flight"),
        ("--seed -3", "seed = -3: must be a whole number"),
    ],
)
def test_invalid_options_end_with_2(
    solved: Path, tmp_path: Path, arguments: str, words: str
) -> None:
    assert words in run("simulate", solved, "-o", tmp_path / "x", *arguments.split(), code=2).stderr
    assert not (tmp_path / "x").exists()


@pytest.fixture
def settling(place: Path) -> Path:
    """Return the plan of a regular triangle, at rest for a second."""
    team = ho.Team(3, 2.4, tension=0.5, quadrotor=ho.Quadrotor(stiffness=4.75))
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    return ho.hold(hitch, seconds=1.0).save(place / "out")


def test_a_plan_without_errors_rests_where_it_says(settling: Path) -> None:
    result = run("statics", settling, "--at", "0.5", code=0)
    assert result.stdout.count("0.500         0.500   no") == 3
    said = json.loads((settling / "statics.json").read_text(encoding="utf-8"))
    assert said["format"] == "hitchopt-statics/1"
    assert said["t"] == [0.5]
    assert said["slack_cables"] == said["loose_clasps"] == []
    assert said["force_residual"] < 1e-9
    planned = ho.load(settling).at(0.5)
    for name, places in (("vertices", planned.vertices), ("drones", planned.positions)):
        found = [entry["position"][0] for entry in said[name]]
        np.testing.assert_allclose(found, places, atol=1e-9)
    np.testing.assert_allclose([c["tension"][0] for c in said["cables"]], 0.5, atol=1e-9)
    assert "errors" not in said
    np.testing.assert_allclose([v["band"][0] for v in said["vertices"]], 0.0, atol=1e-9)
    assert (settling / "statics.png").read_bytes().startswith(b"\x89PNG")
    assert "note" not in result.stdout


def test_friction_makes_bands_of_rest(settling: Path) -> None:
    result = run("statics", settling, "--at", "0.5", "--friction", "0.05", code=0)
    assert "band of rest" in result.stdout
    said = json.loads((settling / "statics.json").read_text(encoding="utf-8"))
    found = ho.settle(ho.load(settling), [0.5], friction=0.05).band[0]
    np.testing.assert_allclose([v["band"][0] for v in said["vertices"]], found)
    assert np.all(found[:, 0] < -0.05)
    assert np.all(found[:, 1] > 0.05)


@pytest.mark.slow
def test_ranges_are_those_of_python(settling: Path) -> None:
    result = run(
        "statics",
        settling,
        "--samples",
        "3",
        "--cable-error",
        "0.01",
        "--force-error",
        "sd:0.02",
        code=0,
    )
    assert "range [N]" in result.stdout
    assert "beyond first order" in result.stdout
    plan = ho.load(settling)
    found = ho.tolerance(
        plan, [0.0, 1.0], cable_error=0.01, force_error=ho.ErrorSize(deviation=0.02)
    )
    said = json.loads((settling / "statics.json").read_text(encoding="utf-8"))
    assert said["errors"]["cable"] == {"bound": 0.01, "deviation": 0.0}
    assert said["errors"]["force"] == {"bound": 0.0, "deviation": 0.02}
    assert len(said["t"]) == 3
    ends = [[said["cables"][k][name][0] for name in ("smallest", "largest")] for k in range(3)]
    np.testing.assert_allclose(ends, found.tensions[0], rtol=1e-6)
    radii = [vertex["radius"][-1] for vertex in said["vertices"]]
    np.testing.assert_allclose(radii, found.radii[-1], rtol=1e-4)


def test_conditions_reach_what_settles(settling: Path) -> None:
    options = ["--cable-length", "2.39,2.41,2.4", "--density", "0.004", "--load", "0.002"]
    options += ["--stiffness", "8", "--axial-stiffness", "500"]
    run("statics", settling, "--at", "0.5", *options, code=0)
    said = json.loads((settling / "statics.json").read_text(encoding="utf-8"))
    found = ho.settle(
        ho.load(settling),
        0.5,
        cable_length=[2.39, 2.41, 2.4],
        cable_density=0.004,
        load=0.002,
        stiffness=8.0,
        axial_stiffness=500.0,
    )
    np.testing.assert_allclose([c["tension"][0] for c in said["cables"]], found.tensions, rtol=1e-9)


def test_slack_cables_end_with_3_and_are_named(settling: Path) -> None:
    result = run("statics", settling, "--no-feed-forward", "--cable-length", "2.6", code=3)
    assert "note: without feed-forward of the cable force" in result.stdout
    assert "slack, or without hold: c0, c1, c2, p0, p1, p2" in result.stderr
    assert json.loads((settling / "statics.json").read_text())["slack_cables"] == ["c0", "c1", "c2"]


def test_an_integral_is_warned_of(settling: Path) -> None:
    result = run(
        "statics",
        settling,
        "--at",
        "0",
        "--integral",
        "--tolerance",
        "--axial-stiffness",
        "100",
        code=0,
    )
    assert "note: an integral in the position loop" in result.stdout
    assert result.stdout.count("may be") == 3


def test_what_solve_writes_replaces_an_earlier_answer(settling: Path) -> None:
    run("statics", settling, "--at", "0", code=0)
    (settling / "mine.txt").write_text("mine")
    ho.load(settling).save(settling)
    assert not (settling / "statics.json").exists()
    assert not (settling / "statics.png").exists()
    assert (settling / "mine.txt").exists()
    run("statics", settling, "--at", "0", code=0)
    assert (settling / "certificate.json").exists()


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
def test_wrong_options_end_with_2(settling: Path, options: list[str], words: str) -> None:
    assert words in run("statics", settling, *options, code=2).stderr
    assert not (settling / "statics.json").exists()
