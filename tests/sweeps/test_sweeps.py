"""Studies and sweeps: cases, refusals, and rows that survive interruptions."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.drones.controllers import Gains
from hitchopt.errors import FileError
from hitchopt.lab.simulation.settings import (
    CALM,
    DRONES,
    ESTIMATORS,
    INDOOR,
    Perturbations,
    flight_keys,
    settings_of,
)
from hitchopt.lab.sweeps.study import Case, ParameterKeys, points, study_from_dict, with_values
from hitchopt.lab.sweeps.sweep import (
    PICTURE,
    ROWS,
    SETTINGS,
    compute_row,
    draw_sweep,
    load_sweep,
    outcomes,
    run_tasks,
    summary,
    write_row,
)
from hitchopt.values import Array
from hitchopt.values.fields import mapping_of

if TYPE_CHECKING:
    import distributed
    import pandas

PROBLEM: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}},
    "mission": [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}],
}
LOG = {"from": 0, "to": 2, "count": 3, "log": True}


def test_every_combination_occurs_once() -> None:
    log = {"grid": {"from": 1.0, "to": 4.0, "count": 3, "log": True}}
    even = {"grid": {"from": -1.0, "to": 1.0, "count": 5}}
    spans = {
        key: mapping_of(ParameterKeys).check("", each) for key, each in (("b", log), ("c", even))
    }
    found = points({"a": [1, 2], **spans})
    wanted = itertools.product((1, 2), (1.0, 2.0, 4.0), (-1.0, -0.5, 0.0, 0.5, 1.0))
    assert [list(point) for point in found] == [["a", "b", "c"]] * 30
    rows = [[float(str(x)) for x in point.values()] for point in found]
    np.testing.assert_allclose(rows, list(wanted))


def test_values_are_set_in_a_copy() -> None:
    made: Any = with_values(PROBLEM, {"team.tension": 0.3, "mission[0].morph.duration": 9.0})
    assert made["team"] == {**PROBLEM["team"], "tension": 0.3}
    assert made["mission"][0]["morph"] == {**PROBLEM["mission"][0]["morph"], "duration": 9.0}
    assert "tension" not in PROBLEM["team"]
    assert "duration" not in PROBLEM["mission"][0]["morph"]
    assert with_values(PROBLEM, {"limits.speed": 2})["limits"] == {"speed": 2}
    wrong = "mission[1].hold mission.morph team.robots.x team[0] team..x mission[0]x"
    for key in wrong.split():
        with pytest.raises(ho.InputError, match="parameters"):
            with_values(PROBLEM, {key: 1})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": {"team.tensoin": [0.3]}}, "parameters.'team.tensoin' = .* mean tension"),
        ({"problem": {"team": 3}}, "^problem problem: team = 3: must be a mapping"),
        ({"parameters": {"team.tension": [0.3, -1.0]}}, "team.tension"),
        ({"parameters": {"team.tension": {"grid": {"from": 1, "to": 0, "count": 3}}}}, "below"),
        ({"parameters": {"team.tension": {"grid": LOG}}}, "log"),
        ({"parameters": {"team.tension": {"list": [1]}}}, "team.tension"),
        ({"parameters": {"team.tension": []}}, "team.tension"),
        ({"parameters": {"simulate.wind": [0.1]}}, "add simulate"),
        ({"simulate": {"wind": -1}}, "simulate.wind"),
        ({"simulate": {}, "parameters": {"simulate.wnd": [0.1]}}, "simulate.wnd"),
        ({"paramters": {}}, "did you mean parameters"),
        ({"limit": 0}, "limit"),
        ({"problem": []}, "add problem: triangle.yaml"),
        ({"problem": [3]}, "problem = "),
        ({"problem": "no_such_file.yaml"}, "no such file"),
    ],
)
def test_invalid_studies_are_refused_by_key(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ho.HitchoptError, match=words):
        study_from_dict({"problem": PROBLEM, **change})


FLIGHT: dict[str, Any] = {
    "noise": 0.02, "velocity_noise": 0.05, "wind": 0.1, "steady_wind": 0.02, "lag": 0.04,
    "cable_error": 0.01, "start_error": 0.03, "downwash": False,
    "object_mass": 0.2, "object_friction": 0.3, "object_place": 0.01,
    "rotor_drag": 0.02, "seed": 3, "friction": 0.2, "density": 0.01, "stiffness": 6.0,
    "cables": "clasps", "pull_test": False, "controller": "lee",
    "gains": {"kp": 3.0}, "drones": "crazyflie",
    "estimator": "crazyflie", "upload": True, "latency": 0.02,
}  # fmt: skip
"""A value of every key of simulated flights."""


def test_studies_take_all_settings_of_simulated_flights() -> None:
    assert set(FLIGHT) == set(flight_keys())
    (case,) = study_from_dict({"problem": PROBLEM, "simulate": FLIGHT}).cases()
    assert case.simulate is not None
    assert len(case.digest) == 64
    keys: dict[str, Any] = {**case.simulate, "seed": case.seed}
    settings = settings_of(**keys)
    for name, value in FLIGHT.items():
        record = settings.perturbations if hasattr(settings.perturbations, name) else settings
        expected = {"gains": Gains(3.0), "estimator": ESTIMATORS["crazyflie"]}.get(name, value)
        assert getattr(record, name) == expected, name


def test_drones_of_a_study_have_their_own_perturbations_unless_others_are_stated() -> None:
    parameters = {"simulate.drones": [None, "crazyflie"]}

    def perturbations(simulate: dict[str, Any]) -> list[Perturbations]:
        study = {"problem": PROBLEM, "simulate": simulate, "parameters": parameters}
        keys: list[Any] = [case.simulate for case in study_from_dict(study).cases()]
        return [settings_of(**each).perturbations for each in keys]

    assert perturbations({}) == [INDOOR, DRONES["crazyflie"].perturbations]
    assert perturbations({"perturbed": True}) == [INDOOR, INDOOR]
    assert perturbations({"perturbed": False}) == [CALM, DRONES["crazyflie"].perturbations]


@pytest.mark.parametrize("name", sorted(FLIGHT.keys() - {"seed"}))
def test_every_setting_of_a_flight_is_a_parameter(name: str) -> None:
    values = {f"simulate.{name}": [None, FLIGHT[name]]}
    given = {"problem": PROBLEM, "parameters": values, "simulate": {}}
    simulated = [case.simulate or {} for case in study_from_dict(given).cases()]
    assert [keys[name] for keys in simulated] == [None, FLIGHT[name]]


@pytest.mark.parametrize("name", sorted(FLIGHT))
def test_settings_of_flights_are_checked_by_key(name: str) -> None:
    given = {"problem": PROBLEM, "simulate": {name: [-1]}}
    with pytest.raises(ho.InputError, match=rf"^simulate\.{name} = \[-1\]: must be "):
        study_from_dict(given)


def test_cases_have_digests_of_all_their_inputs() -> None:
    parameters = {"team.tension": [0.3, 0.4], "simulate.wind": [0.0, 0.1]}
    given = {"problem": PROBLEM, "parameters": parameters, "simulate": {"seeds": 3, "seed": 5}}
    cases = list(study_from_dict(given).cases())
    assert len({case.digest for case in cases}) == len(cases) == 12
    assert [case.seed for case in cases[:4]] == [5, 6, 7, 5]
    assert cases[0].simulate is not None
    assert cases[0].simulate["wind"] == 0.0
    assert "seeds" not in cases[0].simulate  # more seeds leave the rows of the first ones
    assert "simulate" not in cases[0].problem
    sections = [{**PROBLEM["team"], "tension": value} for value in (0.3, 0.4)]
    whole = study_from_dict({"problem": PROBLEM, "parameters": {"team": sections}})
    assert [case.problem["team"] for case in whole.cases()] == sections


def test_drawings_can_be_a_parameter(tmp_path: Path) -> None:
    """Cases hold their outlines, and digests depend on these."""

    def drawn(name: str, width: float) -> None:
        shape = f'<rect x="0" y="0" width="{width}" height="0.3"/>'
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1">{shape}</svg>'
        (tmp_path / name).write_text(svg)

    def cases(*files: str) -> list[Case]:
        box = {"file": "a.svg", "at": [3.0, 0.0, 0.0], "fixed": True}
        study = {"problem": PROBLEM | {"objects": {"box": box}}}
        study["parameters"] = {"objects.box.file": list(files)}
        return list(study_from_dict(study, tmp_path).cases())

    drawn("a.svg", 0.4)
    drawn("b.svg", 0.6)
    first, second = cases("a.svg", "b.svg")
    for case, file, width in ((first, "a.svg", 0.4), (second, "b.svg", 0.6)):
        made: Any = case.problem["objects"]
        assert (case.point, "file" in made["box"]) == ({"objects.box.file": file}, False)
        np.testing.assert_allclose(np.ptp(made["box"]["outline"], axis=0), [width, 0.3], atol=1e-9)
    drawn("b.svg", 0.4)
    again = cases("a.svg", "b.svg")
    assert (again[0].digest, again[1].digest != second.digest) == (first.digest, True)
    with pytest.raises(FileError, match=r"c\.svg"):
        cases("c.svg")


STUDY: dict[str, Any] = {
    "title": "Tension",
    "problem": PROBLEM,
    "parameters": {"team.tension": [0.3, 0.5, 2.5], "limits.vertex_speed": [0.4, 0.5]},
}


def fixed(rows: pandas.DataFrame) -> pandas.DataFrame:
    return rows[[name for name in map(str, rows.columns) if not name.startswith("time.")]]


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    import distributed

    given = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**given) as cluster:
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
    import pandas

    place, rows = swept
    assert list(rows["parameter.team.tension"]) == [0.3, 0.3, 0.5, 0.5, 2.5, 2.5]
    assert list(rows["status"]) == ["planned"] * 4 + ["infeasible"] * 2
    assert set(rows["binding"].dropna()) <= {"thrust", "tilt"}
    cases = list(study_from_dict(STUDY).cases())
    alone = pandas.DataFrame([compute_row(case, case.digest) for case in cases])
    alone = alone.reindex(columns=rows.columns)
    pandas.testing.assert_frame_equal(fixed(rows), fixed(alone), check_exact=True)
    pandas.testing.assert_frame_equal(load_sweep(place), rows, check_exact=True)


@pytest.mark.slow
def test_only_lost_rows_are_computed_again(
    swept: tuple[Path, pandas.DataFrame], cluster: distributed.LocalCluster, tmp_path: Path
) -> None:
    import pandas

    place, rows = swept
    (tmp_path / "study.json").write_bytes((place / "study.json").read_bytes())
    lines = (place / ROWS).read_bytes()
    torn = lines[:-40]  # a power cut within the last row
    (tmp_path / ROWS).write_bytes(torn)
    assert len(load_sweep(tmp_path)) == 5
    again = ho.run_sweep(STUDY, tmp_path, scheduler=cluster.scheduler_address)
    pandas.testing.assert_frame_equal(fixed(again), fixed(rows), check_exact=True)
    assert (tmp_path / ROWS).read_bytes().startswith(torn)


@pytest.mark.parametrize(
    ("old", "new"), [('"infeasible"', '"planned"'), ("1.5", "2.5"), (', "sha256"', ', "sha"')]
)
def test_rows_that_were_edited_are_refused_by_their_line(
    old: str, new: str, tmp_path: Path
) -> None:
    for digest in "ab":
        row = {"digest": digest, "status": "infeasible", "duration": 1.5, "check.speed": math.nan}
        write_row(tmp_path, row)
    study = {"format": "hitchopt-sweep/1", "parameters": [], "cases": ["a", "b"]}
    (tmp_path / "study.json").write_text(json.dumps(study))
    assert list(load_sweep(tmp_path)["duration"]) == [1.5, 1.5]
    lines = (tmp_path / ROWS).read_text().splitlines()
    assert old in lines[3]
    lines[3] = lines[3].replace(old, new)
    (tmp_path / ROWS).write_text("\n".join(lines))
    with pytest.raises(FileError, match="line 4 was edited"):
        load_sweep(tmp_path)
    with pytest.raises(FileError, match=r"cannot be read \(No such file or directory\); run"):
        load_sweep(tmp_path / "none")


def test_a_full_disk_leaves_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row: dict[str, Any] = {"problem": "p", "seed": None, "status": "failed", "message": "none"}
    write_row(tmp_path, {**row, "digest": "a"})
    study = {"format": "hitchopt-sweep/1", "parameters": [], "cases": ["a", "b"]}
    (tmp_path / "study.json").write_text(json.dumps(study))

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(FileError, match="only missing rows are computed"):
            write_row(tmp_path, {**row, "digest": "b"})
    assert list(load_sweep(tmp_path)["digest"]) == ["a"]


@pytest.mark.slow
def test_planned_cases_are_simulated() -> None:
    study = {"problem": PROBLEM, "simulate": {"perturbed": False, "density": 0.01}}
    (case,) = study_from_dict(study).cases()
    row = compute_row(case, case.digest)
    plan = ho.solve(ho.problem_from_dict(case.problem))
    assert (row["status"], row["duration"]) == ("planned", plan.duration)
    for check in plan.certificate.checks:
        assert row[f"check.{check.name}"] == check.worst
    assert row["simulate.verdict"] == "succeeded", row
    assert row["simulate.peak_tension"] > 0.4  # the team's default tension


@pytest.mark.slow
def test_an_unreachable_scheduler_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SETTINGS, "distributed.comm.timeouts.connect", "0.5s")
    with pytest.raises(ho.InputError, match="start `dask scheduler`"):
        ho.run_sweep(STUDY, tmp_path, scheduler="tcp://127.0.0.1:1")


@pytest.mark.slow
def test_a_long_flight_is_shared_without_a_warning() -> None:
    flight = np.arange(1.6e6)  # 12.8 MB: dask's default warns above 10 MB
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _, future in run_tasks(_last, {"one": (2.0,)}, 1, shared=flight):
            assert future.result() == 2.0 * flight[-1]


def _last(factor: float, values: Array) -> float:
    return factor * float(values[-1])


@pytest.mark.parametrize("package", ["mujoco", "pandas", "distributed"])
def test_missing_packages_are_reported_before_planning(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps({**STUDY, "simulate": {}}))
    words = ["sweep", str(study), "-o", str(tmp_path / "out"), "--workers", "1"]
    done = CliRunner().invoke(main, words)
    assert (done.exit_code, f"{package} (" in done.stderr) == (3, True), done.output
    assert (
        f"pip install 'hitchopt[{'simulate' if package == 'mujoco' else 'sweep'}]'" in done.stderr
    )
    assert not (tmp_path / "out").exists()


SCRIPT = """
import hitchopt as ho
if {condition}:
    print(len(ho.run_sweep({study!r}, "out", workers=2)))
"""


def ran(directory: Path, condition: str) -> subprocess.CompletedProcess[str]:
    (directory / "study.py").write_text(SCRIPT.format(condition=condition, study=STUDY))
    return subprocess.run(
        [sys.executable, "study.py"], cwd=directory, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_a_script_with_the_usual_guard_runs_a_sweep(tmp_path: Path) -> None:
    done = ran(tmp_path, "__name__ == '__main__'")
    assert (done.returncode, done.stdout, done.stderr) == (0, "6\n", "")


@pytest.mark.slow
def test_a_script_without_guard_ends_with_one_error_that_names_it(tmp_path: Path) -> None:
    done = ran(tmp_path, "True")
    assert (done.returncode, done.stdout, done.stderr.count("Traceback")) == (1, "", 1)
    assert 'call it under `if __name__ == "__main__":`' in done.stderr.splitlines()[-1]


def test_a_time_limit_is_a_row() -> None:
    (case,) = study_from_dict({"problem": PROBLEM, "limit": 1e-6}).cases()
    assert compute_row(case, "")["status"] == "time limit"


@pytest.mark.slow
def test_the_summary_and_the_picture_of_a_sweep(swept: tuple[Path, pandas.DataFrame]) -> None:
    rows = swept[1]
    found = summary(rows, 7)
    assert (found.planned.count, found.planned.rows, found.cases) == (4, 6, 7)
    assert sum(count for _, count in found.binding) == 2
    points = outcomes(rows)
    assert [row["team.tension [N]"] for row in points] == [0.3, 0.3, 0.5, 0.5, 2.5, 2.5]
    assert [row.get("binding") for row in points] == [None] * 4 + ["thrust"] * 2
    np.testing.assert_allclose([row["duration [s]"] for row in points], rows["duration"])
    figure = draw_sweep(points)
    assert figure is not None
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("team.tension [N]", "duration [s]")
    crosses = [line.get_xydata() for line in axes.lines if line.get_marker() == "x"]
    assert np.concatenate(crosses).tolist() == [[2.5, 0.0]] * 2
    assert draw_sweep(outcomes(rows[:1])) is None


def test_parameters_have_the_units_of_their_keys() -> None:
    import pandas

    keys = ("team.tension", "mission[0].morph.duration", "team.robots", "team.quadrotor.controller")
    cells = [(0.3, 2.0, 3, "lee"), (0.5, 2.0, 4, "lee"), (0.5, 3.0, 4, "pid")]
    rows = pandas.DataFrame(cells, columns=[f"parameter.{key}" for key in keys])
    points = outcomes(rows.assign(problem="triangle", status="planned", duration=[1.0, 2.0, 3.0]))
    heads = ["team.tension [N]", "mission[0].morph.duration [s]", *keys[2:]]
    assert list(points[0]) == [*heads, "planned", "duration [s]"]
    figure = draw_sweep(points)
    assert figure is not None
    (axes,) = figure.axes
    assert axes.get_xlabel() == heads[0]
    labels = [line.get_label() for line in axes.lines]
    assert (
        labels[0] == "mission[0].morph.duration 2.0 s, team.robots 3, team.quadrotor.controller lee"
    )


@pytest.mark.parametrize(("values", "line"), [((0.3, 0.5), "-"), (("lee", "pid"), "None")])
def test_points_of_numbers_are_joined_and_those_of_names_are_not(
    values: tuple[Any, ...], line: str
) -> None:
    points = [
        {"team.key": x, "planned": True, "duration [s]": 1.0 + i} for i, x in enumerate(values)
    ]
    figure = draw_sweep(points)
    assert figure is not None
    (curve,) = figure.axes[0].lines
    assert curve.get_linestyle() == line


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
    assert (code, "planned: 4 of 6\n" in output) == (0, True), output
    assert (place / PICTURE).stat().st_size > 5_000
    assert run(place) == (0, output)
    study.write_text(json.dumps({**STUDY, "paramters": {}}))
    code, output = run(study, "-o", place)
    assert (code, "did you mean parameters" in output) == (2, True)
