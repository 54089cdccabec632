"""Sweeps: rows that arrive whole, stay, and do not depend on who computed them."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pandas
import pytest
from click.testing import CliRunner
from scipy.stats import norm
from study_cases import PROBLEM

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError, InputError
from hitchopt.sweeps.study import study_from_dict
from hitchopt.sweeps.sweep import (
    MEASURED,
    ROWS,
    Share,
    column_of,
    load_sweep,
    summary,
    write_outcome,
    write_study,
)
from hitchopt.sweeps.work import Outcome, outcome_of

STUDY: dict[str, Any] = {
    "title": "Tension",
    "problem": PROBLEM,
    "parameters": {"team.tension": [0.3, 0.5, 2.5], "limits.vertex_speed": [0.4, 0.5]},
}


def fixed(rows: pandas.DataFrame) -> pandas.DataFrame:
    return rows[[name for name in map(str, rows.columns) if not name.startswith(MEASURED)]]


def written(study: dict[str, Any], place: Path) -> pandas.DataFrame:
    """Compute all rows in this process, one by one, and read them back."""
    made = study_from_dict(study)
    cases = list(made.cases())
    write_study(place, "", [p.key for p in made.parameters], [case.digest for case in cases])
    for case in reversed(cases):
        write_outcome(place, outcome_of(case, case.digest))
    return load_sweep(place)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with two workers in threads, which start fast."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
def test_a_sweep_is_the_same_with_two_workers_and_none(tmp_path: Path, scheduler: str) -> None:
    counts: list[Any] = []
    rows = ho.run_sweep(STUDY, tmp_path / "two", scheduler=scheduler, progress=counts.append)
    assert [count.done for count in counts] == [1, 2, 3, 4, 5, 6]
    assert counts[-1].fraction == 1.0
    alone = written(STUDY, tmp_path / "alone")
    pandas.testing.assert_frame_equal(fixed(rows), fixed(alone), check_exact=True)
    assert list(rows["parameter.team.tension"]) == [0.3, 0.3, 0.5, 0.5, 2.5, 2.5]
    assert list(rows["status"]) == ["planned"] * 4 + ["infeasible"] * 2
    assert set(rows["binding"].dropna()) <= {"thrust", "tilt"}
    # One row is lost: it alone is computed again, and comes to the same.
    lost = tmp_path / "two" / ROWS / f"{rows['digest'][3]}.parquet"
    times = {p.name: p.stat().st_mtime_ns for p in lost.parent.iterdir() if p != lost}
    lost.unlink()
    again = ho.run_sweep(STUDY, tmp_path / "two", scheduler=scheduler)
    pandas.testing.assert_frame_equal(fixed(again), fixed(rows), check_exact=True)
    assert times == {p.name: p.stat().st_mtime_ns for p in lost.parent.iterdir() if p != lost}


def test_a_row_says_what_the_plan_says() -> None:
    case = next(iter(study_from_dict(STUDY).cases()))
    row = outcome_of(case, case.digest).row
    plan = ho.solve(ho.problem_from_dict(case.problem))
    assert row["status"] == "planned"
    assert row["duration"] == plan.duration
    for check in plan.certificate.checks:
        assert row[f"check.{check.name}"] == check.worst


@pytest.mark.slow
def test_plans_are_settled_simulated_and_exported(tmp_path: Path) -> None:
    study = {
        "problem": PROBLEM,
        "settle": {"samples": 2, "stiffness": 5.0},
        "simulate": {"drones": "point", "perturbed": False, "density": 0.01},
        "export": {"format": "json"},
    }
    case = next(iter(study_from_dict(study).cases()))
    outcome = outcome_of(case, case.digest)
    row = outcome.row
    assert row["simulate.verdict"] == "succeeded", row
    assert row["settle.tension_min"] == pytest.approx(0.4, abs=0.02)  # the team's default tension
    assert 0.0 < row["export.position_error"] < 1e-3
    place = tmp_path / "sweep"
    write_study(place, "", [], [case.digest])
    write_outcome(place, outcome)
    files = place / "files" / case.digest
    assert {p.name for p in files.iterdir()} == set(outcome.files)
    assert load_sweep(place)["simulate.succeeded"].all()


@pytest.mark.slow
def test_workers_are_processes_of_this_machine(tmp_path: Path) -> None:
    rows = ho.run_sweep({**STUDY, "parameters": {}}, tmp_path, workers=1)
    assert list(rows["status"]) == ["planned"]


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="start `dask scheduler`"):
        ho.run_sweep(STUDY, tmp_path, scheduler="tcp://127.0.0.1:1")


def test_a_limit_of_time_and_a_wrong_draw_are_rows() -> None:
    study = study_from_dict({**STUDY, "parameters": {}, "limit": 1e-6})
    row = outcome_of(next(iter(study.cases())), "").row
    assert row["status"] == "time limit"
    study = study_from_dict(
        {**STUDY, "parameters": {"limits.leg": {"random": {"from": 0.1, "to": 5.0}}}, "samples": 4}
    )
    assert {outcome_of(case, "").row["status"] for case in study.cases()} <= {
        "infeasible",
        "planned",
    }


def test_a_full_disk_leaves_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.umask(umask := os.umask(0o022))
    write_study(tmp_path, "", [], ["a", "b"])
    row: dict[str, Any] = {"problem": "p", "seed": None, "status": "failed", "message": "none"}
    write_outcome(tmp_path, Outcome("a", {**row, "digest": "a"}, {"x/y.bin": b"1"}))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FileError, match="only what is missing is computed"):
        write_outcome(tmp_path, Outcome("b", {**row, "digest": "b"}, {"x/y.bin": b"1"}))
    assert [p.name for p in (tmp_path / ROWS).iterdir()] == ["a.parquet"]
    others = stat.S_IRGRP | stat.S_IROTH
    assert (tmp_path / ROWS / "a.parquet").stat().st_mode & others == others & ~umask
    assert not list(tmp_path.glob(".hitchopt-*"))
    assert list(load_sweep(tmp_path)["digest"]) == ["a"]


@pytest.mark.slow
def test_what_rows_come_to(tmp_path: Path) -> None:
    rows = written(STUDY, tmp_path)
    found = summary(rows, 7)
    assert (found.planned.count, found.planned.rows, found.cases) == (4, 6, 7)
    assert sum(count for _, count in found.binding) == 2
    assert found.medians["duration"][0] == pytest.approx(rows["duration"].dropna().median())
    low, high = Share(4, 6).interval  # Wilson's formula by hand
    z, p, n = norm.ppf(0.975), 4 / 6, 6
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
    assert (low, high) == pytest.approx((middle - half, middle + half))
    assert column_of(rows, "team.tension") == "parameter.team.tension"
    assert column_of(rows, "thrust") == "check.thrust"
    with pytest.raises(InputError, match=r"team\.tension"):
        column_of(rows, "team.tensoin")


@pytest.mark.slow
def test_the_command_reports_draws_and_goes_on(tmp_path: Path) -> None:
    place = tmp_path / "out"
    written(STUDY, place)
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps(STUDY))  # YAML too
    run = CliRunner().invoke(main, ["sweep", str(study), "-o", str(place)])
    assert run.exit_code == 0, run.output
    assert "planned: 4 of 6" in run.output
    drawn = CliRunner().invoke(main, ["sweep", str(place), "--plot", "team.tension", "duration"])
    assert drawn.exit_code == 0, drawn.output
    assert (place / "duration_over_tension.png").stat().st_size > 5000
    study.write_text(json.dumps({**STUDY, "paramters": {}}))
    wrong = CliRunner().invoke(main, ["sweep", str(study), "-o", str(place)])
    assert wrong.exit_code == 2
    assert "did you mean parameters" in wrong.output
    missing = CliRunner().invoke(main, ["sweep", str(place), "--plot", "team.tension", "durtion"])
    assert missing.exit_code == 2
    assert "duration" in missing.output
