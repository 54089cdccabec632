"""The commands simulate and statics: their output, files and exit codes."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.lab.cli.simulating import spread_text
from hitchopt.lab.simulation.judgement import Spread
from hitchopt.lab.simulation.settings import perturbation_keys, settings_of
from hitchopt.lab.statics.files import statics_content
from hitchopt.lab.statics.tolerance import ErrorSize
from hitchopt.storage.files import strict_json
from hitchopt.storage.yaml_file import parse_yaml
from tests.helpers.commands import run

pytestmark = pytest.mark.usefixtures("place")

Options = dict[str, Any]


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a regular triangle, at rest for a tenth of a second."""
    team = ho.Team(3, 2.4, tension=0.5, cable_density=0.01, cable_friction=0.1)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    place = tmp_path_factory.mktemp("plan") / "out"
    return ho.solve(hitch, ho.Hold(seconds=0.1)).save(place)


@pytest.fixture
def settling(place: Path) -> Path:
    """Return the plan of a regular triangle, at rest for a second."""
    team = ho.Team(3, 2.4, tension=0.5, quadrotor=ho.Quadrotor(stiffness=4.75))
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    return ho.solve(hitch, ho.Hold(seconds=1.0)).save(place / "out")


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize(("allowed", "words"), [(0.1, "within"), (1e-4, "more than")])
def test_errors_are_compared_with_what_was_allowed_for(
    place: Path, allowed: float, words: str
) -> None:
    drone = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0})
    team = ho.Team(3, 2.4, tension=0.3, cable_density=0.01, cable_friction=0.1, quadrotor=drone)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3), altitude=1.4)
    limits = ho.Limits(tracking=allowed)
    ho.solve(hitch, ho.Hold(seconds=0.1), limits=limits).save(place / "out")
    result = run("simulate", place / "out", code=0 if words == "within" else 3)
    verdict = rf"drones were off by up to .* m vertically, {words} limits.tracking"
    assert re.search(verdict, result.stdout)
    assert f"limits.tracking ({allowed:.3g} m)" in result.stdout
    left = re.findall(r"failed: t = \d\.\d\d s, ([qr]\d) is .* cm off", result.stderr)
    assert bool(left) is (words == "more than")


@pytest.mark.slow
def test_one_flight_reports_that_it_holds_and_writes_files(solved: Path) -> None:
    result = run("simulate", solved, code=0)
    for words in (
        "every vertex holds; results are in",
        r"preset fast: links of 30 mm catch at clasps.* use --cables clasps.*--preset accurate",
        r"rest, .* s +p0 +\d+\.\d +yes\n",
        r"minimum separation of drones \[ellipsoids\] +\d\.\d\d, [qr]\d and [qr]\d\n",
        r"tension / planned tension +[01]\.\d\d ± 0\.\d\d \([01]\.\d\d\)\n",
        r"flown by +ideal\n",
        r"p0 +-?1 +0\.\d+ +0\.15 .*yes\n",
        r"position loops \[N/m\] +4.75\n",
        r"cable density: simulated \[g/m\] +10\n",
    ):
        assert re.search(words, result.stdout), words
    assert result.stderr == ""
    place = solved / "simulation"
    tables = {"vertices.csv", "cables.csv", "drones.csv"}
    files = tables | {"simulation.json", "recording.npz", "simulation.png"}
    assert {path.name for path in place.iterdir()} == files
    summary = read(place / "simulation.json")
    assert summary["hitched"] is summary["succeeded"] is True
    tracked = spread_text(Spread(**summary["tracking_error"]))
    assert re.search(rf"drone errors \[cm\] +{re.escape(tracked)}", result.stdout)
    assert spread_text(Spread.of(np.array([0.01, 0.03, np.nan]))) == "2.0 ± 1.0 (3.0)"
    size = 1e3 * summary["compensation"]["cables_longer"]
    assert re.search(rf"extra rope for bends \[mm\] +≤ {size:.1f}", result.stdout)
    *_, last = result.stdout.splitlines()
    line = shlex.split(last.partition(": hitchopt ")[2])
    assert "evaluation.tex is the LaTeX table" in run(*line, code=0).stdout
    table = (solved / "evaluation" / "evaluation.tex").read_text(encoding="utf-8")
    assert re.search(r"^\$p_\{0\}\$ & .*( & \d+\.\d){3} &", table, re.MULTILINE), table
    run("check", solved, code=0)  # the plan's own files are as they were


@pytest.mark.slow
def test_flights_that_evaluate_refuses_name_no_command_for_it() -> None:
    """It compares a single team with its whole plan: others, and what follows a loss, it cannot."""
    hitch = {"polygon": [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], "altitude": 1.5}
    goal = [[3.0, 0.2, 1.0]]
    problem = {
        "teams": {"tied": {"robots": 3, "cable_length": 2.4}, "single": {"drones": 1}},
        "start": {"tied": {"hitch": hitch}, "single": [[3.0, 0.0, 1.0]]},
        "mission": [{"tied": {"hold": {"seconds": 1.0}}, "single": {"fly": {"goal": goal}}}],
    }
    ho.solve(ho.problem_from_dict(problem)).save("out")
    result = run("simulate", "out", code=0)
    assert "every vertex holds" in result.stdout
    assert "hitchopt evaluate" not in result.stdout


@pytest.mark.slow
def test_a_campaign_reports_its_success_rate(solved: Path) -> None:
    options = [
        "--runs",
        "1",
        "--workers",
        "1",
        "--seed",
        "7",
        "--perturbed",
        "--perturb",
        "noise=0",
    ]
    result = run("simulate", solved, "-o", "campaign", *options, code=0)
    rate = "1 of 1 flights succeeded: 100.0% (20.7% to 100.0% at 95 %), seeds 7 to 7"
    assert rate in result.stdout
    assert "mean drone error [cm]" in result.stdout
    assert "mean tension / planned tension" in result.stdout
    assert "vertex error" not in result.stdout  # of coarse ropes
    names = {path.name for path in Path("campaign").iterdir()}
    assert names == {"campaign.json", "campaign.png", "runs.csv"}
    varied = read(Path("campaign/campaign.json"))["settings"]["perturbations"]
    assert (varied["noise"], varied["wind"], varied["downwash"]) == (0.0, 0.05, True)


def test_a_flight_that_is_invalid_ends_with_3(solved: Path) -> None:
    """A gale tears the drones apart; verdicts of other flights: tests/lab/simulation."""
    result = run("simulate", solved, "-o", "x", "--perturb", "steady_wind=50", code=3)
    assert re.search("not simulated: t = -2.4. s, simulation: strain of", result.stderr)
    assert "not simulated to its end" in result.stdout
    assert "p0" not in result.stdout
    summary = read(Path("x/simulation.json"))
    assert (summary["verdict"], summary["succeeded"]) == ("not simulated", False)
    assert summary["clasps"] == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("simulate --preset fine", "'fine' is not one of 'fast', 'accurate'"),
        ("simulate --preste fast", "No such option"),
        ("simulate --perturb noise=-1", "--perturb noise = -1: must be at least 0"),
        ("simulate --perturb stiffness=0", "--perturb stiffness = 0: must be"),
        (
            "simulate --perturb cable_error=0.5",
            "cable_error = 0.5: must be from 0 to 0.1; if per cent",
        ),
        ("simulate --perturb friction=-0.1", "friction = -0.1: must be at least 0"),
        ("simulate --perturb lag=.nan", "lag = nan"),
        ("simulate --perturb lag=late", "--perturb lag = 'late': must be a number"),
        (
            "simulate --perturb wnd=0.1",
            "--perturb = 'wnd': unknown key; did you mean wind?",
        ),
        ("simulate --perturb wind", "--perturb = 'wind': must be KEY=VALUE; write noise=0.1"),
        ("simulate --perturb wind=[", "--perturb:1:"),
        ("simulate --perturb stiffness=60", "is unstable, since its thrust lags; lower it"),
        ("simulate --perturb density=0.00001", "density = 1e-05: must be at least"),
        ("simulate --runs 0", "runs = 0: must be at least 1; use 1 or more"),
        ("simulate --cut 2", "--cut = '2': must be ROBOT@SECONDS; write 2@12.5"),
        ("simulate --cut 9@0.1", "--cut = '9': must be one of 0, 1, 2"),
        ("simulate --cut 1@0.1 --runs 2", "must be of a single flight"),
        ("simulate --no-reaction", "--no-reaction = True: must be omitted without a loss"),
        ("simulate --workers 2", "--workers = 2: must be of several flights; add --runs"),
        ("simulate --width 3.5 --runs 2", "--width = 3.5: must be of the picture of a single"),
        (
            "simulate --upload",
            "--upload = True: must be omitted for this plan, whose drones have no flight "
            "controller (team.quadrotor.controller); add --controller mellinger",
        ),
        ("simulate --estimator crazyflie", "--estimator = 'crazyflie': must be omitted for this"),
        ("simulate --drones crazyfly", "'crazyfly' is not one of 'crazyflie', 'px4'"),
        ("statics --at -1", "t = "),
        ("statics --error cable=1cm", "--error cable = '1cm': must be a number or sd:number"),
        ("statics --perturb cable_length=[2.4,x]", "--perturb cable_length[1] = 'x'"),
        ("statics --perturb stiffness=-1", "--perturb stiffness = -1: must be"),
    ],
)
def test_invalid_options_end_with_2(solved: Path, words: str, told: str) -> None:
    command, *options = words.split()
    place = ["-o", "x"] if command == "simulate" else []
    before = {path.name for path in solved.iterdir()}
    assert told in run(command, solved, *place, *options, code=2).stderr
    assert {path.name for path in solved.iterdir()} == before
    assert not Path("x").exists()


VALUES = {"downwash": "false", "lag": "0.05", "rotor_drag": "0.01", "friction": "0.2"}
"""Values in texts of keys of --perturb; 0.07 of others."""


def test_every_perturbation_is_a_key_of_the_option(solved: Path) -> None:
    """Several are set at once, with hyphens or underscores."""
    keys = perturbation_keys()
    texts = {name: VALUES.get(name, "0.07") for name in keys}
    options = [f"--perturb={name.replace('_', '-')}={text}" for name, text in texts.items()]
    command = main.get_command(click.Context(main), "simulate")
    assert command is not None
    context = command.make_context("simulate", [str(solved), "--perturbed", *options])
    given = context.params["perturb"]
    assert given == {name: parse_yaml(text) for name, text in texts.items()}
    settings = settings_of("fast", perturbed=True, **given)
    for name, value in given.items():
        record = settings.perturbations if hasattr(settings.perturbations, name) else settings
        assert getattr(record, name) == value
    (option,) = (each for each in command.params if each.name == "perturb")
    assert all(f"{name}: " in (getattr(option, "help", "") or "") for name in keys)


REAL = (
    "--perturb cable_length=[2.39,2.41,2.4] --perturb density=0.004 --perturb load=0.002 "
    "--perturb stiffness=8"
)


@pytest.mark.parametrize(
    ("options", "conditions"),
    [
        ("--at 0.5", {}),
        ("--at 0.5 --perturb friction=0.05", {"friction": 0.05}),
        (
            f"--at 0.5 {REAL} --perturb axial_stiffness=500",
            {"cable_length": [2.39, 2.41, 2.4], "axial_stiffness": 500.0}
            | {"cable_density": 0.004, "load": 0.002, "stiffness": 8.0},
        ),
        pytest.param(
            "--at 0.5 --error cable=0.01 --error force=sd:0.02",
            {"cable_error": 0.01, "force_error": ErrorSize(deviation=0.02)},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_statics_agrees_with_the_python_interface(
    settling: Path, options: str, conditions: Options
) -> None:
    result = run("statics", settling, *options.split(), code=0)
    plan, ranges = ho.load(settling), None
    if "cable_error" in conditions:
        ranges = ho.tolerance(plan, [0.5], **conditions)
    found = ho.equilibrium(plan, [0.5], **conditions) if ranges is None else ranges.equilibrium
    expected = strict_json(statics_content(found, ranges))
    assert read(settling / "statics.json") == json.loads(expected)
    assert found.force_residual.max() < 1e-9
    assert (settling / "statics.png").read_bytes().startswith(b"\x89PNG")
    assert ("band of rest" in result.stdout) is ("friction" in conditions)
    assert ("range [N]" in result.stdout) is (ranges is not None)
    if not conditions:  # it rests where the plan says
        assert len(re.findall(r"0\.500? +0\.500? +no", result.stdout)) == 3
        assert "note" not in result.stdout
    if "load" in conditions:  # vertices hang lower by as much
        lower = 1e3 * (plan.at(0.5).vertices - found.vertices[0])[:, 2]
        assert re.search(rf"p0 +\d+\.\d +{lower[0]:.1f}\n", result.stdout)


def test_slack_cables_end_with_3_and_integrals_are_warned_of(settling: Path) -> None:
    result = run(
        "statics", settling, "--perturb=feed_forward=false", "--perturb=cable_length=2.6", code=3
    )
    assert "note: Cables will go slack" in result.stdout
    assert "slack cables or loose clasps: c0, c1, c2, p0, p1, p2" in result.stderr
    assert read(settling / "statics.json")["slack_cables"] == ["c0", "c1", "c2"]
    options = [
        "--at",
        "0",
        "--perturb=integral=true",
        "--tolerance",
        "--perturb=axial_stiffness=100",
    ]
    result = run("statics", settling, *options, code=0)
    assert "note: Integral action overrides the planned tension" in result.stdout
    assert result.stdout.count("may be") == 3


def test_solve_replaces_earlier_statics(settling: Path) -> None:
    run("statics", settling, "--at", "0", code=0)
    (settling / "mine.txt").write_text("mine")
    ho.load(settling).save(settling)
    names = {path.name for path in settling.iterdir()}
    assert "mine.txt" in names
    assert not names & {"statics.json", "statics.png"}
    run("statics", settling, "--at", "0", code=0)
    assert (settling / "certificate.json").exists()
