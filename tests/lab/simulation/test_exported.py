"""Exported files as they are flown: setpoints, parts, parameters, and the plan that they need."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.drones.controllers import HELD
from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.exports.contents import PLAN_COPY
from hitchopt.exports.format import format_of
from hitchopt.lab.simulation.commands import flown_gains, flown_team, received, resolved
from hitchopt.lab.simulation.exported import (
    BEFORE,
    BETWEEN,
    is_export,
    read_exported,
    read_flown,
)
from hitchopt.lab.simulation.judgement import warnings
from hitchopt.lab.simulation.settings import Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.storage.archive import PLAN
from tests.helpers.groups import flown_by
from tests.helpers.plans import planned

TEAM = ho.Team(3, 2.3, tension=0.4, quadrotor="paper_132g")
QUANTUM = 1e-3  # Of packets [m], [m/s²]


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    start = ho.Hitch.balanced(TEAM, ho.regular_polygon(3, 1.3), altitude=2.0)
    return ho.solve(start, ho.Transport(to=[0.2, 0.1, 2.1]))


def exported(plan: ho.Plan, folder: Path, kind: str, **options: Any) -> Path:
    plan.export(kind, folder, **options)
    assert is_export(folder)
    return folder


def test_streamed_setpoints_are_those_of_the_file_as_packets_hold_them(
    plan: ho.Plan, tmp_path: Path
) -> None:
    """They are those of the plan, which the simulator forms itself without a file."""
    flown = read_exported(exported(plan, tmp_path / "csv", "csv"))
    files, task = flown.task.received, Task.of(plan.flight)
    settings = resolved(flown.task, Settings())
    assert (settings.controller, settings.upload) == ("mellinger", False)
    assert settings.estimator == HELD
    own = received(task.teams[0], flown_team(task.team, settings), settings)
    assert files is not None
    assert flown.task.duration == pytest.approx(plan.duration)
    for name in ("positions", "velocities", "accelerations"):
        ours, theirs = own.arrays[name], files.commands.arrays[name]
        np.testing.assert_allclose(theirs[: len(ours)], ours, atol=1.001 * QUANTUM)
    ours, theirs = own.rates, files.commands.rates
    assert np.max(np.abs(ours)) > 0.1
    np.testing.assert_allclose(theirs[: len(ours)], ours, atol=0.02 * np.max(np.abs(ours)))


@pytest.mark.parametrize("kind", ["crazyswarm2", "compressed"])
@pytest.mark.parametrize(
    "placed", [{}, {"frame": "nwu", "origin": (1.0, -2.0, 0.5), "yaw": 0.7}], ids=["enu", "nwu"]
)
def test_uploads_are_evaluated_from_their_files_in_the_plans_frame(
    plan: ho.Plan, tmp_path: Path, kind: str, placed: dict[str, Any]
) -> None:
    folder = exported(plan, tmp_path / kind, kind, **placed)
    flown = read_exported(folder)
    states, files = flown.task.states, flown.task.received
    assert files is not None
    outward = files.commands.positions - states.positions
    legs = states.positions - states.vertices[:, flown.task.team.layout.pulled_to]
    along = np.einsum("sda,sda->sd", outward, legs) / np.linalg.norm(legs, axis=-1)
    gains = files.loops[0].kp[0]
    np.testing.assert_allclose(along[-1], 0.4 / gains, rtol=0.25)  # setpoints hold the tension
    if not placed:
        frame = "_enu" * (kind == "compressed")
        ending = {"crazyswarm2": ".csv", "compressed": ".bin"}[kind]
        curve = format_of(kind).upload(folder / f"r1{frame}{ending}").curve  # type: ignore[attr-defined]
        drone = flown.task.team.drone_names.index("r1")
        for index in (0, 37, 60):
            place = curve.at(min(states.t[index], curve.duration))
            np.testing.assert_allclose(files.commands.positions[index, drone], place, atol=1e-12)


def test_gains_and_filter_are_those_of_the_files(plan: ho.Plan, tmp_path: Path) -> None:
    folder = exported(plan, tmp_path / "files", "crazyswarm2")
    flown, kinds = read_exported(folder), TEAM.kinds
    assert flown.task.received is not None
    assert flown.changed == ()
    for loop, kind in zip(flown.task.received.loops, kinds, strict=True):
        np.testing.assert_allclose([loop.kp, loop.kd], [kind.loop.kp, kind.loop.kd], rtol=1e-5)
    assert flown.task.received.estimator == HELD
    flown_with = resolved(flown.task, Settings())
    assert warnings(flown.task, flown_with) == warnings(flown.task, Settings())
    settings = folder / "crazyflies.yaml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace('"pNAcc_xy": 20.0', '"pNAcc_xy": 7.0'), encoding="utf-8")
    edited = read_exported(folder)
    assert edited.changed == ("crazyflies.yaml",)
    assert edited.task.received is not None
    assert edited.task.received.estimator is not None
    assert edited.task.received.estimator.level_noise == 7.0
    for stated in (Settings(controller="lee"), Settings(stiffness=1.0), Settings(upload=False)):
        with pytest.raises(InputError, match="its files state it"):
            resolved(edited.task, stated)


def test_files_that_hold_gains_of_one_team_only_are_flown_with_those_of_the_plan(
    tmp_path: Path,
) -> None:
    unknown = ho.Quadrotor(mass=0.132, max_thrust=2.6)
    flight = flown_by(planned("two_teams").flight, a=TEAM.quadrotor[0], b=unknown)
    plan = ho.Plan(flight, certify(flight))
    folder = exported(plan, tmp_path / "two", "crazyswarm2", allow_slack=True)
    task = read_exported(folder).task
    assert task.received is not None
    assert task.received.loops == ()
    settings = resolved(task, Settings(controller="mellinger"))
    loops = [kind.loop for part in task.teams for kind in flown_team(part.team, settings).kinds]
    assert len(loops) == task.team.drones
    assert loops[0] == TEAM.kinds[0].loop


def px4_plan(**kind: Any) -> ho.Plan:
    drone = ho.Quadrotor(mass=0.8, max_thrust=16.0, **kind)
    team = ho.Team(3, 4.6, tension=0.2, quadrotor=drone)
    start = ho.Hitch.balanced(team, ho.regular_polygon(3, 2.4), altitude=2.0)
    return ho.solve(start, ho.Hold(seconds=0.1))


def test_gains_of_px4_are_those_of_the_files(tmp_path: Path) -> None:
    plan = px4_plan(controller="px4", gains={"kp": 2.4, "kd": 2.0, "ki": 0.1})
    folder = exported(plan, tmp_path / "px4", "mavsdk_drone_show")
    (own,) = {kind.loop for kind in plan.flight.team.kinds}
    task = read_exported(folder).task
    assert task.received is not None
    for loop in task.received.loops:
        for key in ("kp", "kd", "ki", "ki_limit"):
            assert getattr(loop, key) == pytest.approx(getattr(own, key), rel=1e-5)
    assert "gains: px4 kp [2.4, 2.4]" in flown_gains(task, Settings())
    assert flown_gains(task, Settings()).endswith("those of the files")
    manifest = folder / "export.json"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(text.replace('"MPC_XY_P": 1.2', '"MPC_XY_P": 0.6'), encoding="utf-8")
    edited = read_exported(folder).task.received
    assert edited is not None
    assert edited.loops[0].kp == pytest.approx((1.2, 2.4), rel=1e-5)
    with pytest.raises(InputError, match="whose controller is px4; omit it"):
        resolved(task, Settings(drones="crazyflie"))
    with pytest.raises(InputError, match=r"latency = 0\.02.*; omit it"):
        resolved(task, Settings(latency=0.02))


@pytest.mark.parametrize(
    ("kind", "format", "words"),
    [
        ({"controller": "px4"}, "mavsdk_drone_show", "defaults of its firmware, since the files"),
        (
            {"controller": "px4", "gains": {"kp": 2.4}},
            "csv",
            "the plan's, since the files contain none",
        ),
        ({}, "csv", "files and plan name no flight controller"),
    ],
)
def test_gains_that_files_do_not_hold_are_said(
    tmp_path: Path, kind: dict[str, Any], format: str, words: str
) -> None:
    task = read_exported(exported(px4_plan(**kind), tmp_path / "files", format)).task
    assert words in flown_gains(task, Settings())
    settings = resolved(task, Settings(controller="mellinger"))
    assert (settings.controller, settings.upload) == ("mellinger", False)
    assert "the stiffest" in flown_gains(task, Settings(controller="mellinger"))
    assert "defaults of its firmware" in flown_gains(task, Settings(controller="pid"))
    assert flown_gains(task, Settings(controller="ideal")).endswith("as requested")
    soft = flown_gains(task, Settings(controller="px4", stiffness=1.3))
    assert "kp [1.3, " in soft
    assert ": as requested" in soft


def test_an_export_flies_with_its_own_plan_alone(plan: ho.Plan, tmp_path: Path) -> None:
    saved = plan.save(tmp_path / "plan")
    other = ho.solve(plan.end, ho.Hold(0.5)).save(tmp_path / "other")
    folder = exported(ho.load(saved), tmp_path / "csv", "csv")
    manifest = json.loads((folder / "export.json").read_text(encoding="utf-8"))
    assert (folder / PLAN_COPY).read_bytes() == (saved / PLAN).read_bytes()
    file = tmp_path / "alone.csv"
    ho.load(saved).export("csv", file)
    assert is_export(file)
    assert not is_export(saved)
    with pytest.raises(InputError, match=r"plan = None.*add --plan"):
        read_exported(file)
    with pytest.raises(FileError, match=r"alone\.csv: holds no copy of the plan; name the dir"):
        read_flown(file)
    with pytest.raises(FileError, match="is not the plan that was exported"):
        read_exported(file, other / PLAN)
    with pytest.raises(FileError, match=r"contains no export\.json"):
        read_exported(saved)
    assert read_exported(file, saved / PLAN).task.duration == pytest.approx(plan.duration)
    assert manifest["plan_digest"]
    viewed = exported(plan, tmp_path / "gltf", "gltf")
    with pytest.raises(UnsupportedError, match="no drone flies them"):
        read_exported(viewed)


def test_an_export_that_becomes_smaller_leaves_nothing_behind(
    plan: ho.Plan, tmp_path: Path
) -> None:
    folder = exported(plan, tmp_path / "files", "crazyswarm2")
    exported(plan, folder, "csv")
    names = {path.name for path in folder.iterdir()}
    assert names == {"export.json", PLAN_COPY, "README.txt", "setpoints_enu.csv"}
    assert "fly.py" not in (folder / "README.txt").read_text("utf-8")


def test_stretched_exports_are_flown_with_a_stretched_plan(plan: ho.Plan, tmp_path: Path) -> None:
    flown = read_exported(exported(plan, tmp_path / "csv", "csv", stretch=1.5))
    assert flown.task.duration == pytest.approx(1.5 * plan.duration)
    states, files = flown.task.states, flown.task.received
    assert files is not None
    np.testing.assert_allclose(files.commands.positions, states.positions, atol=QUANTUM)


@pytest.mark.parametrize("kind", ["mavsdk_drone_show", "ros2bag", "parquet"])
def test_streams_are_held_from_sample_to_sample(kind: str, tmp_path: Path) -> None:
    """Between samples setpoints stay, and are off the moving plan by at most speed over rate."""
    px4 = ho.Quadrotor(mass=0.8, max_thrust=16.0, controller="px4")
    team = ho.Team(3, 4.6, tension=0.2, quadrotor=px4)
    start = ho.Hitch.balanced(team, ho.regular_polygon(3, 2.4), altitude=2.0)
    moving = ho.solve(start, ho.Transport(to=[0.2, 0.1, 2.1]))
    flown = read_exported(exported(moving, tmp_path / kind, kind))
    states, files = flown.task.states, flown.task.received
    assert files is not None
    rate = format_of(kind).rate
    held = np.max(np.abs(np.diff(files.commands.positions, axis=0)), axis=(1, 2)) == 0.0
    assert np.mean(held) == pytest.approx(1.0 - rate / 100.0, abs=0.2)
    speed = float(np.max(np.linalg.norm(states.velocities, axis=-1)))
    off = np.linalg.norm(files.commands.positions - states.positions, axis=-1)
    assert np.max(off) < speed / rate + 2.0 * QUANTUM
    forward = states.accelerations - states.cable_forces / 0.8
    at = slice(0, None, round(100.0 / rate))
    sent = files.commands.accelerations[: len(forward)]
    np.testing.assert_allclose(sent[at][:-1], forward[at][:-1], atol=0.02)


@pytest.mark.slow
def test_parts_are_flown_with_what_the_script_does_between_them(tmp_path: Path) -> None:
    """Drones take off, and go to the first points of the next part: nothing jumps."""
    q = np.array([[-1.0, 0.9, 1.0], [0.9, 0.9, 1.0], [-0.3, -1.2, 1.0]])
    team = ho.Team(3, 2.35, tension=0.4, cable_density=0.01, quadrotor="paper_132g")
    start = ho.DronesStart(q, q + [0.6, 0.0, 0.0])
    form = ho.Form(ho.regular_polygon(3, 1.0), altitude=1.5)
    plan = ho.solve(start, [form, ho.Hold(4.0), ho.Release()], team=team)
    flown = read_exported(exported(plan, tmp_path / "files", "crazyswarm2"))
    assert flown.takes_off
    assert len(flown.parts) > 1
    seconds = sum(part.curves.duration for part in flown.parts)
    waits = BEFORE + BETWEEN * (len(flown.parts) - 1)
    assert flown.task.duration == pytest.approx(seconds + waits, abs=0.01)
    files, states = flown.task.received, flown.task.states
    assert files is not None
    positions, velocities = files.commands.positions, files.commands.velocities
    assert np.max(positions[0, :, 2]) < 0.05
    assert np.max(np.linalg.norm(np.diff(positions, axis=0), axis=-1)) < 0.011
    rates = np.diff(positions, axis=0) / np.diff(states.t)[:, None, None]
    mean_rates = 0.5 * (velocities[1:] + velocities[:-1])
    assert np.max(np.abs(rates - mean_rates)) < 0.05
    assert np.max(np.linalg.norm(positions - states.positions, axis=-1)) < 0.2


@pytest.mark.slow
def test_the_evaluation_of_a_flown_export_agrees_to_a_millimetre(
    plan: ho.Plan, tmp_path: Path
) -> None:
    """Its clock is that of the files, as is that of flights by fly.py."""
    folder = exported(plan, tmp_path / "files", "crazyswarm2")
    simulation = ho.simulate(folder, pull_test=False)
    recording = simulation.save(tmp_path / "simulation")
    evaluation, errors = ho.evaluate(recording, folder), simulation.errors
    during = errors.t <= simulation.flight.task.duration
    own, theirs = np.nanmean(errors.errors[during], axis=0), np.nanmean(evaluation.errors, axis=0)
    np.testing.assert_allclose(theirs, own, atol=1e-3)


@pytest.mark.slow
def test_the_command_flies_an_export(plan: ho.Plan, tmp_path: Path) -> None:
    folder = exported(plan, tmp_path / "files", "crazyswarm2")
    result = CliRunner().invoke(main, ["simulate", str(folder)])
    assert result.exit_code == 0, result.output
    assert "flies the crazyswarm2 files in 1 part" in result.stdout
    assert "gains: mellinger" in result.stdout
    assert (folder / "simulation" / "simulation.json").is_file()
    assert "every vertex holds" in result.stdout
