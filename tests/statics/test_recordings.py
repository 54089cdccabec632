"""Recordings in tables: read in any order, and refused with the reason."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.simulation.task import Task, read_task
from hitchopt.statics.calibrate import Estimate
from hitchopt.statics.files import team_text
from hitchopt.statics.recordings import HEADER, Recording, read_recording, windows_of
from hitchopt.storage.yaml_file import parse_yaml

POLYGON = [[0.0, -0.75], [-0.6, 0.4], [0.7, 0.4]]


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a triangle, at rest for two seconds."""
    team = ho.Team(3, [2.4, 2.5, 2.45], tension=0.5)
    hitch = ho.Hitch.balanced(team, POLYGON, altitude=1.4)
    return ho.hold(hitch, seconds=2.0).save(tmp_path_factory.mktemp("plan") / "out")


def planned_rows(solved: Path) -> list[str]:
    return rows_of(read_task(solved))


def rows_of(task: Task) -> list[str]:
    """Return the rows of a recording in which all is as planned."""
    places = np.concatenate([task.setpoints.positions, task.vertices], axis=1)
    names = (*task.team.drone_names, *task.team.point_names)
    return [
        f"{float(task.t[i])!r},{name}," + ",".join(repr(float(x)) for x in place)
        for i in range(0, len(task.t), 5)
        for name, place in zip(names, places[i], strict=True)
    ]


def write(path: Path, rows: list[str], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_a_flight_as_planned_has_the_plans_lengths_and_no_errors(
    solved: Path, tmp_path: Path
) -> None:
    table = write(tmp_path / "flight.csv", planned_rows(solved))
    output, picture = tmp_path / "team.yaml", tmp_path / "flight.png"
    result = run("calibrate", table, "--plan", solved, "-o", output, "--picture", picture)
    assert result.exit_code == 0, result.output
    for words in (" 2.4 ", " 2.5 ", " 2.45 ", "0.0 ± 0.0 (0.0)", "not determined"):
        assert words in result.stdout
    assert "displaced by too little" in result.stdout
    assert picture.read_bytes()[:4] == b"\x89PNG"
    found = ho.calibrate(table, solved)
    np.testing.assert_allclose([one.value for one in found.lengths], [2.4, 2.5, 2.45], atol=1e-6)
    team = parse_yaml(output.read_text(encoding="utf-8"))
    assert isinstance(team, dict)
    start = {"hitch": {"polygon": POLYGON}}
    problem = ho.problem_from_dict(
        {**team, "start": start, "mission": [{"hold": {"seconds": 1.0}}]}
    )
    np.testing.assert_allclose(problem.team.cable_length, [2.4, 2.5, 2.45], atol=1e-4)
    np.testing.assert_allclose(problem.team.tension, 0.5)


def test_order_other_columns_and_unknown_names_do_not_matter(solved: Path, tmp_path: Path) -> None:
    rows = planned_rows(solved)
    team = read_task(solved).team
    plain = read_recording(write(tmp_path / "a.csv", rows), team)
    mixed = np.random.default_rng(3).permutation(rows).tolist()
    fields = [row.split(",") for row in mixed]
    other = [f"{z},{name},{x},0.5,{t},{y}" for t, name, x, y, z in fields]
    other += ["1.0,camera,2.0,3.0,0.0,1.0"]
    again = read_recording(write(tmp_path / "b.csv", other, "z,name,x,battery,t,y"), team)
    np.testing.assert_array_equal(plain.t, again.t)
    np.testing.assert_array_equal(plain.drones, again.drones)
    np.testing.assert_array_equal(plain.vertices, again.vertices)


def test_a_chain_ends_at_its_outer_drones(tmp_path: Path) -> None:
    arc = [[1.0, 0.0], [1.6, 1.0], [2.9, 1.1], [3.6, 0.0]]
    team = ho.Team(3, [2.2, 2.6, 2.3], topology="open", tension=0.5)
    task = Task.of(ho.hold(ho.Hitch.balanced(team, arc, altitude=1.4), seconds=2.0).motion)
    rows = [row for row in rows_of(task) if ",p0," not in row and ",p3," not in row]
    found = ho.calibrate(write(tmp_path / "flight.csv", rows), task)
    np.testing.assert_array_equal(found.recording.vertices, task.vertices[::5])
    np.testing.assert_allclose([one.value for one in found.lengths], team.cable_length, atol=1e-6)


def test_windows_count_of_which_half_was_seen(solved: Path) -> None:
    task = read_task(solved)
    drones, vertices = task.setpoints.positions, task.vertices.copy()
    vertices[55:100, 0] = np.nan  # of 50 samples 5 are left
    vertices[100:120, 0] = np.nan  # of 50 samples 30 are left
    found = windows_of(Recording(task.t, drones, vertices), task, 0.5)
    np.testing.assert_allclose(found["t"][:2], [0.245, 1.345])
    np.testing.assert_allclose(found["tensions"], 0.5)


def test_tables_that_are_no_recordings_are_refused(solved: Path, tmp_path: Path) -> None:
    rows = planned_rows(solved)
    for header, lines, words in (
        ("t,name,x,y", rows, "'z' is not in list"),
        (HEADER, [r for r in rows if ",r1," not in r], "r1 is not recorded"),
        (HEADER, [*rows, rows[0]], "holds a name twice at the same time"),
        (HEADER, [*rows, "9,q0,a,b,c"], "could not convert"),
        (HEADER, [*rows, "9,q0"], "index out of range"),
        (HEADER, [*rows, "inf,q0,1,2,3"], "a time is not finite"),
        (HEADER, rows[:0], "q0 is not recorded"),
        (HEADER, [r for r in rows if ",p" not in r], "record the vertices too"),
    ):
        result = run("calibrate", write(tmp_path / "x.csv", lines, header), "--plan", solved)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output
    table = write(tmp_path / "flight.csv", rows)
    for arguments, words in (
        ((tmp_path / "none.csv", "--plan", solved), "there is no such file"),
        ((table,), "plan.npz: there is no such file"),
        ((table, "--plan", solved, "--density", "-1"), "density = -1.0: must be at least 0"),
    ):
        result = run("calibrate", *arguments)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output


@pytest.mark.slow
def test_a_simulated_flight_is_calibrated_from_its_files(solved: Path) -> None:
    flown = run("simulate", solved, "--stiffness", "6", "--density", "0.012")
    assert flown.exit_code == 0, flown.output
    found = ho.calibrate(solved / "simulation")  # the plan is where the results lie
    assert found.density == 0.012
    assert np.isfinite(found.recording.vertices[-1]).all()  # drones are recorded for longer
    np.testing.assert_allclose([one.value for one in found.lengths], [2.4, 2.5, 2.45], atol=5e-3)
    assert found.stiffness[0].value == pytest.approx(6.0, rel=0.1)
    assert not found.friction.known
    summary = solved / "simulation" / "simulation.json"
    mean = json.loads(summary.read_text(encoding="utf-8"))["vertex_error"]["all"]["mean"]
    assert np.nanmean(found.vertex_errors) == pytest.approx(mean, rel=0.02)
    summary.write_text("{}", encoding="utf-8")
    broken = run("calibrate", solved / "simulation")
    assert (broken.exit_code, "simulate again" in broken.stderr) == (2, True)


def test_a_team_of_different_kinds_lists_them(solved: Path) -> None:
    task = read_task(solved)
    drones, vertices = task.setpoints.positions, task.vertices
    plain = ho.calibrate(Recording(task.t, drones, vertices), task, density=0.01)
    stiffness = (Estimate(4.0, 0.2), Estimate(4.0, 0.2), Estimate(np.nan, np.inf, "nothing moves"))
    text = team_text(replace(plain, stiffness=stiffness, friction=Estimate(0.123, 0.02)))
    team = parse_yaml(text)
    assert isinstance(team, dict)
    given = team["team"]
    assert isinstance(given, dict)
    assert [kind["stiffness"] for kind in given["quadrotor"]] == [4, 4, None]  # type: ignore[index,union-attr,call-overload]
    assert given["cable_friction"] == 0.123
    assert "# ± 0.02" in text
    assert text.count("not determined") == 1
