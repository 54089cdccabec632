"""Trims and errors at rest that a recorded flight shows, and what they make of the next plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.hitch.rest_errors import ErrorSizes
from hitchopt.hitch.team import Errors
from hitchopt.lab.flights.recordings import Recording
from hitchopt.lab.simulation.control import FlownDrones
from hitchopt.lab.simulation.settings import Settings
from hitchopt.lab.simulation.task import Task, TeamTask
from hitchopt.lab.statics.calibrate import Calibration, Estimate
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.values import Array
from tests.helpers.scripted import changed

POLYGON = np.array([[3.0, -1.1], [2.4, 0.4], [3.5, 0.5]])
OTHER = np.array([[3.1, -1.0], [2.3, 0.5], [3.4, 0.6]])
TRIMS = np.array([[0.06, 0.0], [0.0, 0.0], [0.0, 0.0], [-0.03, 0.05], [0.0, 0.0], [0.0, -0.04]])


def team(**given: Any) -> ho.Team:
    return ho.Team(3, [2.4, 2.5, 2.45], tension=0.5, **given)


def planned(
    of: ho.Team, *polygons: Array, start: Array = POLYGON, altitude: float = 1.4
) -> ho.Plan:
    mission: list[ho.Hold | ho.Morph] = [ho.Hold(4.0)]
    for polygon in polygons:
        mission += [ho.Morph(polygon), ho.Hold(4.0)]
    return ho.solve(ho.HitchStart(start, altitude), mission, team=of)


def flown(of: ho.Team, *polygons: Array) -> TeamTask:
    """Return the task of a plan that rests for four seconds at each of some polygons."""
    return TeamTask.of(planned(of, *polygons).motion)


def recorded(task: TeamTask, offsets: Array) -> Recording:
    """Return a recording of drones that are off by offsets (…, 2n, 3) [m]."""
    return Recording(task.states.t, task.states.positions + offsets, task.states.vertices)


def level(trims: Array) -> Array:
    return np.insert(trims, 2, 0.0, axis=1)


def test_drones_that_are_off_alike_at_all_rests_are_trimmed() -> None:
    task = flown(team(), OTHER, POLYGON + [0.1, 0.05])
    result = ho.calibrate(recorded(task, -level(TRIMS)), task)
    assert len(result.at_rests.t) == 3
    np.testing.assert_allclose(result.at_rests.trims, TRIMS, atol=1e-9)
    assert result.at_rests.largest_error < 1e-9
    assert result.errors == Errors(result.errors.cable_length, 0.001, 0.0)


def test_trims_add_to_those_of_the_plan() -> None:
    known = {"q0": {"trim": [0.02, -0.05]}, "q1": {"trim": [0.01, 0.0]}}
    task = flown(team(quadrotor=known), OTHER)
    result = ho.calibrate(recorded(task, -level(TRIMS)), task)
    expected = TRIMS + [[0.02, -0.05], [0, 0], [0.01, 0], [0, 0], [0, 0], [0, 0]]
    np.testing.assert_allclose(result.at_rests.trims, expected, atol=1e-9)


@pytest.mark.parametrize("trims", [0.4 * TRIMS[:1], -0.3 * TRIMS[3:4]])
def test_small_offsets_are_errors_but_no_trims(trims: Array) -> None:
    """Flights repeat trims to a centimetre: below two of these nothing is written."""
    task = flown(team(), OTHER)
    offsets = np.zeros((6, 3))
    offsets[2, :2] = 0.5 * trims[0]
    result = ho.calibrate(recorded(task, offsets), task)
    assert not np.any(result.at_rests.trims)
    assert result.at_rests.largest_error == pytest.approx(float(np.linalg.norm(offsets[2])))


def test_one_rest_determines_no_trim() -> None:
    task = flown(team())
    result = ho.calibrate(recorded(task, -level(TRIMS)), task)
    assert np.all(np.isinf(result.at_rests.trim_errors))
    assert not np.any(result.at_rests.trims)
    assert result.errors.drone == 0.06


def test_offsets_that_change_from_rest_to_rest_are_errors() -> None:
    """Every remaining distance is at most the error, which is rounded up to a millimetre."""
    task, rng = flown(team(), OTHER, POLYGON + [0.1, 0.05]), np.random.default_rng(3)
    shares = (task.states.t / task.duration)[:, None, None]
    offsets = rng.normal(scale=0.05, size=(6, 3)) * (0.5 - shares) - level(TRIMS)
    at_rests = ho.calibrate(recorded(task, offsets), task).at_rests
    change = at_rests.trims - at_rests.flown_trims
    remaining = at_rests.offsets + np.insert(change, 2, 0.0, axis=1)
    sizes = np.linalg.norm(remaining, axis=-1)
    assert at_rests.largest_error == pytest.approx(np.max(sizes))
    found = at_rests.errors(Errors(), np.full(3, 1e-3)).drone
    assert isinstance(found, float)
    assert 0.0 <= found - np.max(sizes) < 1.001e-3


SOFT = ho.Quadrotor(mass=0.14, stiffness=5.0, feed_forward=True)


def test_forces_that_the_cables_explain_are_no_trims() -> None:
    """Loops of 2 N/m give way to a cable that is 10 cm longer, as its equilibrium says."""
    task = flown(team(quadrotor=replace(SOFT, stiffness=2.0)), OTHER)
    motion = task.motion
    assert motion is not None
    lengths = task.team.cable_length + [0.0, 0.1, 0.0]
    rest = ho.equilibrium(motion, task.states.t, cable_length=lengths)
    off = np.linalg.norm(rest.drones - task.states.positions, axis=-1)
    assert np.max(off) > 0.02  # more than twice the repeatability: written if not explained
    result = ho.calibrate(Recording(task.states.t, rest.drones, rest.vertices), task)
    np.testing.assert_allclose([one.value for one in result.lengths], lengths, atol=1e-3)
    assert not np.any(result.at_rests.trims)
    assert result.at_rests.largest_error < 1e-3


@pytest.mark.slow
def test_trims_of_one_flight_after_another_leave_less_than_their_errors() -> None:
    """Cables hold drones back from their offset setpoints, so that one flight shows a part."""
    missing, steps = TRIMS, list[float]()
    for _ in range(4):
        task = flown(team(quadrotor=SOFT), OTHER)
        motion = task.motion
        assert motion is not None
        rest = ho.equilibrium(motion, task.states.t, offsets=-level(missing))
        result = ho.calibrate(Recording(task.states.t, rest.drones, rest.vertices), task)
        missing = missing - result.at_rests.trims
        steps.append(float(np.max(np.linalg.norm(missing, axis=1))))
    assert np.all(np.diff(steps) <= 0.0)
    assert steps[-1] < 0.03


def test_the_text_is_a_team_with_trims_errors_and_cables_of_the_plan_where_not_determined() -> None:
    task = flown(team(), OTHER)
    result = ho.calibrate(recorded(task, -level(TRIMS)), task)
    unknown = Estimate(remark="its two vertices are never visible together; record both")
    lengths = (result.lengths[0], unknown, result.lengths[2])
    without = replace(result, lengths=lengths)
    assert "nan" not in without.text.lower()
    content: Any = parse_yaml(without.text)
    expected = [round(result.lengths[0].value, 4), 2.5, round(result.lengths[2].value, 4)]
    assert content["team"]["cable_length"] == expected
    assert content["team"]["errors"] == {"cable_length": 0.01, "drone": 0.001, "friction": 0.0}
    start = {"start": {"hitch": {"polygon": POLYGON.tolist(), "altitude": 1.4}}}
    problem = ho.problem_from_dict(content | start | {"mission": [{"hold": {"seconds": 1.0}}]})
    np.testing.assert_allclose(problem.team.trim, TRIMS, atol=1e-9)
    assert problem.team.errors == without.errors


def test_vertex_errors_before_and_after_are_those_of_plans_with_these_errors() -> None:
    stated = Errors(0.02, 0.03, 0.0)
    task = flown(team(errors=stated), OTHER)
    result = ho.calibrate(recorded(task, np.zeros((6, 3))), task)
    again = flown(team(errors=result.errors), OTHER)
    for found, of in ((result.planned_vertex_error, task), (result.vertex_error, again)):
        motion = of.motion
        assert motion is not None
        check = {each.name: each for each in ho.certify(motion).checks}["vertex_error"]
        assert found == pytest.approx(check.worst, rel=1e-6)
    assert ErrorSizes.of(again.team, None).drone.level == 0.001


@pytest.mark.slow
def test_the_command_prints_trims_and_how_far_the_vertex_error_falls(tmp_path: Path) -> None:
    stated = Errors(0.02, 0.03, 0.0)
    plan = planned(team(errors=stated), OTHER)
    folder = plan.save(tmp_path / "out")
    task = TeamTask.of(plan.motion)
    drones = task.states.positions - level(TRIMS)
    rows = ["t,name,x,y,z"]
    for places, names in (
        (drones, task.team.drone_names),
        (task.states.vertices, ("p0", "p1", "p2")),
    ):
        for k in range(0, len(task.states.t), 4):
            for name, place in zip(names, places[k].tolist(), strict=True):
                rows.append(",".join([repr(float(task.states.t[k])), name, *map(repr, place)]))
    (tmp_path / "flight.csv").write_text("\n".join([*rows, ""]), encoding="utf-8")
    command = ["calibrate", str(tmp_path / "flight.csv"), "--plan", str(folder)]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    words = " ".join(result.stdout.split())
    assert "Trims from 2 rests" in words
    assert "q0 6.0, 0.0 1.0 0.0, 0.0" in words
    found = ho.calibrate(tmp_path / "flight.csv", folder)
    before, after = found.planned_vertex_error, found.vertex_error
    assert before is not None
    assert after is not None
    bounds = f"{100 * after:.3g} cm instead of {100 * before:.3g} cm"
    assert f"vertex_error is {bounds}" in words
    assert after < 0.5 * before
    content = json.loads(CliRunner().invoke(main, [*command, "--json"]).stdout)
    np.testing.assert_allclose(content["trims"], found.at_rests.trims)
    assert content["vertex_error"] == {"planned": before, "calibrated": after}
    assert content["errors"]["drone"] == found.errors.drone


@pytest.mark.slow
def test_a_calibrated_team_flies_closer_to_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """In simulated ropes, drones with bodies defined tilted are told by their trims."""
    tilted, planned_drones = {"q0": (0.06, 0.0), "r1": (-0.03, 0.05)}, FlownDrones.of

    def tilted_drones(task: Task, settings: Settings, stiffness: Array) -> FlownDrones:
        """Return drones with tilted bodies, whatever trims their plan states."""
        named = zip(task.team.kinds, task.team.drone_names, strict=True)
        kinds = tuple(replace(kind, trim=tilted.get(name)) for kind, name in named)
        actual = changed(task, team=replace(task.team, quadrotor=kinds))
        stated = planned_drones(task, settings, stiffness)
        return replace(planned_drones(actual, settings, stiffness), trims=stated.trims)

    monkeypatch.setattr(FlownDrones, "of", tilted_drones)
    gains = {"kp": 1.41, "kd": 0.39, "ki": 0.0}
    kind = ho.Quadrotor(0.0393, 0.8, controller="mellinger", gains=gains)
    stated = ho.Team(3, 2.4, cable_density=0.0015, tension=0.12, quadrotor=kind)
    first = calibration_of_a_flight(stated)
    second = calibration_of_a_flight(team_of(first))
    off = [np.nanmean(each.drone_errors, axis=0) for each in (first, second)]
    assert np.max(off[1]) < 0.6 * np.max(off[0])


def calibration_of_a_flight(of: ho.Team) -> Calibration:
    """Return what a simulated flight says of a team."""
    triangle = np.array([[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]])
    other = np.array([[0.0, 0.7], [0.4, -0.29], [-0.5, -0.35]])
    plan = planned(of, other, start=triangle, altitude=1.2)
    record = ho.simulate(plan).flight.record
    recording = Recording(record.t, record.drones, record.vertices)
    return ho.calibrate(recording, TeamTask.of(plan.motion))


def team_of(calibration: Calibration) -> ho.Team:
    """Return the team that a calibration writes."""
    content: Any = parse_yaml(calibration.text)
    start = {"start": {"hitch": {"polygon": POLYGON.tolist(), "altitude": 1.4}}}
    mission = {"mission": [{"hold": {"seconds": 1.0}}]}
    calibrated: ho.Team = ho.problem_from_dict(content | start | mission).team
    return calibrated
