"""Sweeps: rows that arrive whole, stay, and do not depend on who computed them."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import distributed
import pandas
import pytest
from click.testing import CliRunner
from scipy.stats import norm
from test_studies import PROBLEM

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError, InputError
from hitchopt.sweeps.study import study_from_dict
from hitchopt.sweeps.sweep import ROWS, Share, load_sweep, summary, write_row
from hitchopt.sweeps.work import SETTINGS, row_of

STUDY: dict[str, Any] = {
    "title": "Tension",
    "problem": PROBLEM,
    "parameters": {"team.tension": [0.3, 0.5, 2.5], "limits.vertex_speed": [0.4, 0.5]},
}


def fixed(rows: pandas.DataFrame) -> pandas.DataFrame:
    return rows[[name for name in map(str, rows.columns) if not name.startswith("time.")]]


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def swept(
    tmp_path_factory: pytest.TempPathFactory, cluster: distributed.LocalCluster
) -> tuple[Path, pandas.DataFrame]:
    """A sweep one of whose workers is killed after the first row, and its rows."""
    place, told = tmp_path_factory.mktemp("sweep"), list[str]()

    def progress(words: str) -> None:
        told.append(words)
        if len(told) == 1:
            os.kill(cluster.workers[0].process.pid, signal.SIGKILL)

    address = cluster.scheduler_address
    rows = ho.run_sweep(STUDY, place, scheduler=address, progress=progress)
    assert [words.partition(" rows")[0] for words in told] == [f"{i} of 6" for i in range(1, 7)]
    assert told[-1] == "6 of 6 rows, 2 without a plan"
    return place, rows


@pytest.mark.slow
def test_workers_that_are_killed_lose_no_row(swept: tuple[Path, pandas.DataFrame]) -> None:
    place, rows = swept
    assert list(rows["parameter.team.tension"]) == [0.3, 0.3, 0.5, 0.5, 2.5, 2.5]
    assert list(rows["status"]) == ["planned"] * 4 + ["infeasible"] * 2
    assert set(rows["binding"].dropna()) <= {"thrust", "tilt"}
    cases = list(study_from_dict(STUDY).cases())
    alone = pandas.DataFrame([row_of(case, case.digest) for case in cases])
    alone = alone.reindex(columns=rows.columns)
    pandas.testing.assert_frame_equal(fixed(rows), fixed(alone), check_exact=True)
    pandas.testing.assert_frame_equal(load_sweep(place), rows, check_exact=True)


@pytest.mark.slow
def test_what_is_lost_is_computed_again_and_nothing_else(
    swept: tuple[Path, pandas.DataFrame], cluster: distributed.LocalCluster, tmp_path: Path
) -> None:
    place, rows = swept
    (tmp_path / "study.json").write_bytes((place / "study.json").read_bytes())
    lines = (place / ROWS).read_bytes()
    torn = lines[:-40]  # a power cut within the last row
    (tmp_path / ROWS).write_bytes(torn)
    assert len(load_sweep(tmp_path)) == 5
    again = ho.run_sweep(STUDY, tmp_path, scheduler=cluster.scheduler_address)
    pandas.testing.assert_frame_equal(fixed(again), fixed(rows), check_exact=True)
    assert (tmp_path / ROWS).read_bytes().startswith(torn)


def test_a_full_disk_leaves_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row: dict[str, Any] = {"problem": "p", "seed": None, "status": "failed", "message": "none"}
    write_row(tmp_path, {**row, "digest": "a"})
    (tmp_path / "study.json").write_text(
        json.dumps({"format": "hitchopt-sweep/1", "parameters": [], "cases": ["a", "b"]})
    )

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(FileError, match="only what is missing is computed"):
            write_row(tmp_path, {**row, "digest": "b"})
    assert list(load_sweep(tmp_path)["digest"]) == ["a"]


@pytest.mark.slow
def test_plans_are_simulated() -> None:
    study = {"problem": PROBLEM, "simulate": {"perturbed": False, "density": 0.01}}
    case = next(iter(study_from_dict(study).cases()))
    row = row_of(case, case.digest)
    plan = ho.solve(ho.problem_from_dict(case.problem))
    assert (row["status"], row["duration"]) == ("planned", plan.duration)
    for check in plan.certificate.checks:
        assert row[f"check.{check.name}"] == check.worst
    assert row["simulate.verdict"] == "succeeded", row
    assert row["simulate.peak_tension"] > 0.4  # the team's default tension


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SETTINGS, "distributed.comm.timeouts.connect", "0.5s")
    with pytest.raises(InputError, match="start `dask scheduler`"):
        ho.run_sweep(STUDY, tmp_path, scheduler="tcp://127.0.0.1:1")


def test_a_limit_of_time_is_a_row() -> None:
    study = study_from_dict({**STUDY, "parameters": {}, "limit": 1e-6})
    assert row_of(next(iter(study.cases())), "")["status"] == "time limit"


@pytest.mark.slow
def test_what_rows_come_to(swept: tuple[Path, pandas.DataFrame]) -> None:
    rows = swept[1]
    found = summary(rows, 7)
    assert (found.planned.count, found.planned.rows, found.cases) == (4, 6, 7)
    assert sum(count for _, count in found.binding) == 2
    assert found.medians["duration"][0] == pytest.approx(rows["duration"].dropna().median())
    low, high = Share(4, 6).interval  # Wilson's formula by hand
    z, p, n = norm.ppf(0.975), 4 / 6, 6
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
    assert (low, high) == pytest.approx((middle - half, middle + half))


@pytest.mark.slow
def test_the_command_reports_and_goes_on(
    swept: tuple[Path, pandas.DataFrame], tmp_path: Path
) -> None:
    place, _ = swept
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps(STUDY))  # YAML too

    def run(*arguments: object) -> tuple[int, str]:
        done = CliRunner().invoke(main, ["sweep", *map(str, arguments)])
        return done.exit_code, done.output

    code, output = run(study, "-o", place)
    assert (code, "planned: 4 of 6" in output) == (0, True), output
    assert run(place) == (0, output)
    study.write_text(json.dumps({**STUDY, "paramters": {}}))
    code, output = run(study, "-o", place)
    assert (code, "did you mean parameters" in output) == (2, True)
