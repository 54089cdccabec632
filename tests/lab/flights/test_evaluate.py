"""Evaluation of recorded flights with known truth: estimates, standard errors, refusals."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import hitchopt as ho
from benchmarks.recordings import RATE, Camera, exact_markers, plan_of
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.lab.flights.alignment import align
from hitchopt.lab.flights.evaluation import Evaluation, summary
from hitchopt.lab.flights.recordings import RecordedFlight, Track, plan_at
from hitchopt.lab.flights.vertices import ROPE_SCATTER, clasps_of, marker_plan
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array
from hitchopt.view.cables import CLASPS
from hitchopt.view.scene import ghost_scene, scene_at
from tests.helpers.plans import planned as planned_problem
from tests.helpers.writers import TRANSFORMS, write_bag, write_csv, write_usd

EXACT = Camera(noise=0.0, lost=0.0, ghosts=0.0)


@cache
def plan(name: str) -> ho.Plan:
    if name == "moving":
        return planned_problem("paper_experiment_4")
    if name not in {"chain", "regular", "other"}:
        return plan_of(name)
    options: Any = {"cable_length": 2.4, "cable_density": 0.005}
    if name == "chain":
        points = [[-1.2, 0.3], [-0.5, 0.7], [0.6, 0.6], [1.1, 0.1]]
        team = ho.Team(3, topology="open", **options)
    else:  # of three robots, as the triangle
        regular = ho.regular_polygon(3, 1.0).vertices.tolist()
        points = regular if name == "regular" else [[0, 0.9], [0.75, -0.45], [-0.75, -0.45]]
        team = ho.Team(3, **options)
    start = ho.Hitch.spread(team, points, altitude=1.2)
    to = [0.0, 0.0, 1.6] if name == "regular" else [0.4, 0.5, 1.5]
    return ho.solve(start, [ho.Transport(to), ho.Hold(1.0)])


@cache
def task(name: str) -> TeamTask:
    return TeamTask.of(plan(name).motion)


def drones_of(target: TeamTask, t: Array) -> Array:
    return plan_at(target, t, target.states.positions)


def planned_flight(
    name: str, camera: Camera, seed: int = 0, offset: float = 0.01
) -> RecordedFlight:
    """Return the recording of a flight as planned, with a constant offset of every drone."""
    t = np.arange(-1.0, task(name).duration + 1.0, 1.0 / RATE)
    plan_times = np.clip(t, 0.0, task(name).duration)
    drones = drones_of(task(name), plan_times)
    offsets = np.random.default_rng(seed).normal(0.0, offset, drones.shape[1:])
    offsets -= np.median(offsets, axis=0)  # the hitch follows the median of its drones
    return camera.recorded(t, drones + offsets, exact_markers(task(name), plan_times), seed)


@cache
def triangle() -> RecordedFlight:
    return planned_flight("triangle", Camera())


def drones_recording(camera: Camera, t: Array, drones: Array, seed: int = 0) -> RecordedFlight:
    return camera.recorded(t, drones, np.zeros((len(t), 0, 3)), seed)


@pytest.mark.parametrize(
    "name", ["triangle", pytest.param("pentagon", marks=pytest.mark.slow), "chain", "moving"]
)
def test_markers_on_exact_curves_give_the_vertices(name: str) -> None:
    result = ho.evaluate(planned_flight(name, EXACT, offset=0.0), task(name))
    clasps = task(name).team.layout.clasps
    assert np.isfinite(result.errors[:, clasps]).mean() > 0.99
    assert np.nanmax(result.errors) < 1e-4
    assert np.nanmax(result.drone_errors) < 1e-4
    assert abs(result.alignment.offset + EXACT.start) < 1e-4


def test_an_unknown_weight_is_fitted() -> None:
    target, flight = task("triangle"), planned_flight("triangle", EXACT, offset=0.0)
    team: Any = {"cable_length": 2.4, "tension": float(target.team.tension[0])}
    weightless = replace(target, team=ho.Team(3, cable_density=0.0, **team))
    result = ho.evaluate(flight, weightless)
    assert result.density == pytest.approx(target.team.cable_density, rel=0.02)
    assert np.nanmax(result.errors) < 3e-4
    assert any("weigh the cables" in remark for remark in result.remarks)
    assert result.sag == "the plan ignores the cables' weight: these errors include sag"
    assert "g/m is planned: these errors do not include it" in ho.evaluate(flight, target).sag
    assert np.nanmax(ho.evaluate(flight, weightless, density=0.006).errors) < 1e-4


@pytest.mark.slow
def test_standard_errors_cover_two_thirds_of_the_errors() -> None:
    """Markers are offset from the axis, independently in every flight; all times count."""
    coverage = []
    for seed in range(24):
        camera = Camera(noise=5e-4, offset=3e-3)
        result = ho.evaluate(planned_flight("triangle", camera, seed, offset=0.0), task("triangle"))
        coverage.append(np.mean(result.errors < result.standard_errors))
    assert 0.53 < np.mean(coverage) < 0.83


@pytest.mark.parametrize("camera", [Camera(noise=2e-3, lost=0.2, gap=10.0), Camera(ghosts=2.0)])
def test_noise_losses_and_ghosts_cost_a_few_millimetres(camera: Camera) -> None:
    result = ho.evaluate(planned_flight("sharp", camera, 3), task("sharp"))
    errors = result.errors[np.isfinite(result.planned[..., 0])]
    assert np.mean(np.isfinite(errors)) > 0.9
    assert np.nanmedian(errors) < 5e-3
    assert np.nanpercentile(errors, 95) < 15e-3


def shuffle_markers(flight: RecordedFlight) -> RecordedFlight:
    cloud = flight.markers
    order = np.lexsort((np.random.default_rng(5).random(len(cloud.t)), cloud.t))
    return replace(flight, markers=Track(cloud.t, cloud.positions[order]))


def rename_bodies(flight: RecordedFlight) -> RecordedFlight:
    names, tracks = list(flight.tracks), list(flight.tracks.values())
    return replace(flight, tracks=dict(zip(names[2:] + names[:2], tracks, strict=True)))


def add_a_wand(flight: RecordedFlight) -> RecordedFlight:
    t = np.unique(flight.markers.t)
    return replace(flight, tracks={"wand": Track(t, np.full((len(t), 3), 2.0)), **flight.tracks})


def test_names_order_and_other_bodies_do_not_change_results() -> None:
    flights = triangle(), shuffle_markers(rename_bodies(add_a_wand(triangle())))
    first, second = (ho.evaluate(each, task("triangle")) for each in flights)
    np.testing.assert_allclose(second.vertices, first.vertices, atol=1e-6)
    np.testing.assert_allclose(second.drones, first.drones, atol=1e-9)


@pytest.mark.parametrize(("yaw", "up"), [(0.0, "y"), (0.0, "z"), (4.0, "z")])
def test_frames_and_clocks_are_fitted(up: str, yaw: float) -> None:
    plan_frame = up == "z" and yaw == 0.0
    camera = Camera(yaw=yaw, up=up, shift=(0.0, 0.0, 0.0) if yaw == 0.0 else (1.0, 0.5, 0.3),
                    start=40.0, rate=84.0 / 85.0)  # fmt: skip
    result = ho.evaluate(planned_flight("triangle", camera, 1), task("triangle"))
    assert result.alignment.frame == ("fit" if yaw else "plan" if plan_frame else "y-up")
    assert result.alignment.rate == pytest.approx(85.0 / 84.0, abs=1e-3)
    middle = 40.0 + 4.0 * 84.0 / 85.0
    assert result.alignment.rate * middle + result.alignment.offset == pytest.approx(4.0, abs=0.02)
    assert np.nanmedian(result.errors) < (15e-3 if yaw else 3e-3)
    shared = result.alignment.rms / np.sqrt(2) if yaw else 0.0  # error of the frame
    assert np.nanmin(result.standard_errors) > shared


def test_the_frame_of_another_evaluation_is_used(tmp_path: Path) -> None:
    flight = planned_flight("triangle", Camera(yaw=0.7, shift=(1.0, 0.5, 0.3)), 1)
    first, file = ho.evaluate(flight, task("triangle")), tmp_path / "evaluation.json"
    file.write_text(json.dumps(summary(first)))
    second = ho.evaluate(flight, task("triangle"), frame=file)
    np.testing.assert_allclose(second.alignment.rotation, first.alignment.rotation)
    assert "frame" in first.alignment.fitted
    assert "frame" not in second.alignment.fitted


def test_every_drone_may_have_its_own_clock() -> None:
    shifts = np.random.default_rng(2).uniform(-30.0, 30.0, 6)
    pairs = zip(triangle().tracks.items(), shifts, strict=True)
    tracks = {name: Track(x.t + shift, x.positions) for (name, x), shift in pairs}
    together = ho.evaluate(triangle(), task("triangle")).alignment
    result = ho.evaluate(RecordedFlight("logs", tracks, one_clock=False), task("triangle"))
    assert result.alignment.names == together.names
    order = [list(tracks).index(name) for name in together.names]
    offsets = result.alignment.offsets + shifts[order]
    np.testing.assert_allclose(offsets, together.offset, atol=0.03)
    assert any("only drones" in remark for remark in result.remarks)
    assert [row for row in result.table if row.name == "q0"]


def test_logged_set_points_show_the_lag_of_drones() -> None:
    lag_tracks = {name: Track(x.t + 0.15, x.positions) for name, x in triangle().tracks.items()}
    logged = replace(triangle(), tracks=lag_tracks, setpoints=triangle().tracks)
    result = ho.evaluate(logged, task("triangle"))
    assert result.alignment.offset == pytest.approx(-Camera().start, abs=5e-3)
    assert not any("lag" in remark for remark in result.remarks)
    fallback = ho.evaluate(replace(triangle(), tracks=lag_tracks), task("triangle"))
    assert fallback.alignment.offset == pytest.approx(-Camera().start - 0.15, abs=5e-3)


def slow_flight(camera: Camera, seed: int = 0) -> RecordedFlight:
    """Return a recording of drones on their plan at 20 Hz."""
    t = np.arange(-1.0, task("triangle").duration, 0.05)
    return drones_recording(camera, t, drones_of(task("triangle"), t), seed)


@pytest.mark.parametrize(
    ("topic", "bodies"),
    [
        ("/*/cmd_position", ("/*/pose", "PoseStamped")),
        ("/*/odom", ("/tf", TRANSFORMS)),
        ("/goal_pose", ("/tf", TRANSFORMS)),
    ],
)
def test_commands_estimates_and_goals_change_no_result(
    bodies: tuple[str, str], topic: str, tmp_path: Path
) -> None:
    flight, other = slow_flight(Camera(noise=5e-3)), slow_flight(replace(EXACT, start=2.003))
    if topic == "/goal_pose":
        other = replace(other, tracks=dict(list(other.tracks.items())[:1]))
    others = [(topic, "nav_msgs/msg/Odometry" if "odom" in topic else "PoseStamped", other)]
    alone = write_bag(tmp_path / "alone", flight, bodies=bodies)
    both = write_bag(tmp_path / "both", flight, bodies=bodies, others=others)
    first, second = (ho.evaluate(path, task("triangle")) for path in (alone, both))
    np.testing.assert_array_equal(second.drones, first.drones)
    assert second.alignment.names == first.alignment.names
    (note,) = set(second.remarks) - set(first.remarks)
    assert bodies[0] in note
    assert topic in note
    if topic == "/goal_pose":
        with pytest.raises(FileError, match=r"1 body \(goal_pose\).*, not from /"):
            ho.evaluate(both, task("triangle"), topic=topic)
    else:
        chosen = ho.evaluate(both, task("triangle"), topic=topic)
        assert np.nanmax(chosen.drone_errors) < 1e-3 < np.nanmean(first.drone_errors)


def test_targets_of_a_load_change_no_result(tmp_path: Path) -> None:
    """Logs hold positions and targets of the load, half a metre below the drones."""
    flight, load = slow_flight(Camera(noise=2e-3, lost=0.0)), np.array([0.0, 0.0, -0.5])
    below = {name: Track(x.t, x.positions + load) for name, x in flight.tracks.items()}
    late = {name: Track(x.t, np.roll(x.positions, 5, axis=0)) for name, x in below.items()}
    alone = write_usd(tmp_path / "alone", flight)
    loads = {"stateEstimateZ.p": replace(flight, tracks=below)}
    both = write_usd(tmp_path / "both", replace(flight, setpoints=late), others=loads)
    first, second = (ho.evaluate(path, task("triangle")) for path in (alone, both))
    np.testing.assert_array_equal(second.drones, first.drones)
    assert second.flight.setpoints == {}


@pytest.mark.parametrize("up", ["y", pytest.param("z", marks=pytest.mark.slow)])
def test_the_height_of_a_fitted_frame_changes_no_result(up: str) -> None:
    level = np.array([1.0, 0.5, 0.0]) if up == "z" else np.array([1.0, 0.0, 0.5])
    vertical = np.array([0.0, 0.0, 1.0]) if up == "z" else np.array([0.0, 1.0, 0.0])
    results = []
    for height in (0.0, -0.039 if up == "z" else 1.7):
        shift = tuple((level + height * vertical).tolist())
        camera = Camera(yaw=0.7, up=up, shift=shift)
        results.append(ho.evaluate(planned_flight("triangle", camera, 1), task("triangle")))
        np.testing.assert_allclose(results[-1].vertices, results[0].vertices, atol=1e-4)
        note = f"heights are shifted by {-1e3 * height:+.0f} mm" if height else "as recorded"
        assert any(note in remark for remark in results[-1].remarks)


def task_with_movement(target: TeamTask, offsets: Array) -> TeamTask:
    """Return a task that starts as another and moves drones by offsets (times, 2n, 3) [m]."""
    start = target.states.positions[:1]
    return replace(target, states=replace(target.states, positions=start + offsets))


@cache
def small_movement() -> tuple[TeamTask, Array]:
    """Return a task that moves by a few centimetres, and its movements (times, 2n, 3) [m]."""
    positions = task("triangle").states.positions
    offsets = 0.25 * (positions - positions[0])
    return task_with_movement(task("triangle"), offsets), offsets


def swinging_drones(
    target: TeamTask, seed: int, scatter: float, time: float = 1.0
) -> tuple[Array, Array]:
    """Return times and positions of drones that swing about their plan, partly in common."""
    from scipy.signal import lfilter  # a second to import

    random, t = np.random.default_rng(seed), np.arange(0.0, target.duration, 0.02)
    drones, decay = drones_of(target, t), np.exp(-0.02 / time)
    white = random.normal(size=(1000 + len(t), drones.shape[1] + 1, 3))
    swings = lfilter([scatter * np.sqrt(1.0 - decay**2)], [1.0, -decay], white, axis=0)[1000:]
    return t, drones + swings[:, :-1] + swings[:, -1:] + random.normal(0.0, 0.01, drones[0].shape)


@pytest.mark.slow
@pytest.mark.parametrize("camera", [Camera(), Camera(yaw=0.7, up="y", shift=(1.0, 0.5, 0.3))])
def test_other_movements_of_the_same_hitch_are_refused(camera: Camera) -> None:
    """Twenty plans start at the same positions and stay within a few centimetres of each other."""
    target, offsets = small_movement()
    flight = drones_recording(camera, *swinging_drones(target, 1, 0.003))
    assert align(flight, target).rms < 0.05
    size, phases = np.std(offsets), np.linspace(0.0, 1.0, len(offsets))[:, None, None]
    for seed in range(20):
        random = np.random.default_rng(seed)
        shape = (2, *offsets.shape[1:])
        rate, phase = random.uniform(3.0, 12.0, shape), random.uniform(0.0, 6.3, shape)
        waves = sum(np.sin(r * phases + p) - np.sin(p) for r, p in zip(rate, phase, strict=True))
        with pytest.raises(FileError, match="name the plan that was flown"):
            align(flight, task_with_movement(target, size * np.asarray(waves)))


@pytest.mark.parametrize("name", ["small", pytest.param("triangle", marks=pytest.mark.slow)])
def test_standard_errors_of_clocks_are_those_over_seeds(name: str) -> None:
    """Deviations of drones are correlated over a second, and partly common to all drones."""
    target = small_movement()[0] if name == "small" else task(name)
    deviations, standard_errors = [], []
    for seed in range(12):
        t, drones = swinging_drones(target, seed, 0.004 if name == "small" else 0.01)
        result = align(drones_recording(Camera(), t, drones, seed), target)
        deviations.append(result.rate * (2.0 + t[-1] / 2.0) + result.offset - t[-1] / 2.0)
        standard_errors.append(result.offset_error)
    ratio = np.sqrt(np.mean(np.square(deviations)) / np.mean(np.square(standard_errors)))
    assert 0.4 < ratio < 1.5


def excerpt(flight: RecordedFlight, start: float, end: float) -> RecordedFlight:
    tracks = {}
    for name, x in flight.tracks.items():
        inside = (x.t >= start) & (x.t <= end)
        tracks[name] = Track(x.t[inside], x.positions[inside])
    return RecordedFlight("excerpt", tracks)


def motionless_flight() -> RecordedFlight:
    tracks = {name: Track(x.t, 0.0 * x.positions + x.positions[0]) for name, x in
            triangle().tracks.items()}  # fmt: skip
    return replace(triangle(), tracks=tracks)


def regular_in_turned_frame() -> RecordedFlight:
    t = np.arange(0.0, task("regular").duration, 0.02)
    return drones_recording(Camera(yaw=1.0), t, drones_of(task("regular"), t))


def part_in_turned_frame() -> RecordedFlight:
    return excerpt(planned_flight("triangle", Camera(yaw=0.7, start=0.0)), 0.0, 3.0)


Request = tuple[Callable[[], RecordedFlight], str, dict[str, Any], str]

REFUSALS: dict[str, Request] = {
    "another plan": (triangle, "other", {}, "was flown"),
    "another polygon": (triangle, "sharp", {}, "was flown"),
    "more robots": (triangle, "pentagon", {}, "6 bodies (cf"),
    "nothing moves": (motionless_flight, "triangle", {}, "start="),
    "too short": (lambda: excerpt(triangle(), 4.0, 5.5), "triangle", {}, "2.0 s"),
    "a third of the flight in an unknown frame": (part_in_turned_frame, "triangle", {}, "m, 7."),
    "two assignments": (regular_in_turned_frame, "regular", {}, "names="),
    "no such name": (triangle, "triangle", {"names": "cf999=q0"}, "cf999"),
    "no pairs": (triangle, "triangle", {"names": "cf1"}, "cf231=q0"),
    "no frame": (triangle, "triangle", {"frame": "left"}, "y-up"),
    "no window": (triangle, "triangle", {"window": 0}, "window"),
    "no diameter": (triangle, "triangle", {"diameter": -1}, "diameter"),
    "a topic of a flight that is read": (triangle, "triangle", {"topic": "/tf"}, "read already"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_other_plans_and_requests_are_refused(case: str) -> None:
    flight, name, options, words = REFUSALS[case]
    error = ho.InputError if options else FileError
    with pytest.raises(error, match=words.replace("(", r"\(")):
        ho.evaluate(flight(), task(name), **options)


def test_a_drone_is_named_once() -> None:
    names = dict.fromkeys(triangle().tracks, "q0")
    with pytest.raises(ho.InputError, match="once"):
        ho.evaluate(triangle(), task("triangle"), names=names)


def test_names_choose_between_two_assignments() -> None:
    flight = regular_in_turned_frame()
    names = dict(zip(flight.tracks, task("regular").team.drone_names, strict=True))
    result = ho.evaluate(flight, task("regular"), names=names)
    assert result.alignment.names == tuple(flight.tracks)
    assert "names" not in result.alignment.fitted


def test_a_stated_start_is_the_clock() -> None:
    result = ho.evaluate(triangle(), task("triangle"), start=2.013)
    assert result.alignment.offset == pytest.approx(-2.013)
    assert result.alignment.fitted == ("names",)
    late = planned_flight("triangle", replace(EXACT, start=0.02))
    # Simulated flights have the plan's clock.
    simulated = replace(late, simulated={"density": 0.01, "feed_forward": None, "integral": None})
    assert ho.evaluate(simulated, task("triangle")).alignment.offset == 0.0


def test_remarks_name_bare_edges() -> None:
    cloud, p = triangle().markers, task("triangle").states.vertices[0]
    bare = np.linalg.norm(cloud.positions - 0.5 * (p[0] + p[1]), axis=1) > 0.5
    sparse = replace(triangle(), markers=Track(cloud.t[bare], cloud.positions[bare]))
    result = ho.evaluate(sparse, task("triangle"))
    detected = np.isfinite(result.vertices[result.t < 1.5, :, 0]).mean(axis=0)
    assert detected[2] > 0.9
    assert np.all(detected[:2] == 0.0)
    assert [remark for remark in result.remarks if remark.startswith("p0 is measured")]


def test_recorded_vertices_are_used_while_hitched() -> None:
    target = TeamTask.of(planned_problem("tie_carry_untie").motion)
    t = np.arange(0.0, target.duration, 0.02)
    flight = drones_recording(Camera(lost=0.0), t, drones_of(target, t))
    places = plan_at(target, t, target.states.vertices) + [0.01, 0.0, 0.0]
    vertex_tracks = {f"p{k}": Track(t + Camera().start, places[:, k]) for k in range(3)}
    result = ho.evaluate(replace(flight, tracks={**flight.tracks, **vertex_tracks}), target)
    hitched = np.isfinite(result.planned[:, 0, 0])
    assert 0.1 < np.mean(hitched) < 0.9
    np.testing.assert_allclose(result.errors[hitched], 0.01, atol=1e-3)
    assert np.all(np.isnan(result.vertices[~hitched]))
    assert np.all(np.isnan(result.standard_errors))


def test_clasps_lie_outward_by_the_turn() -> None:
    diameter, layout = 0.012, task("pentagon").team.layout
    corners = np.column_stack([ho.regular_polygon(5, 1.0).vertices, np.full(5, 1.3)])
    result = clasps_of(corners, layout, diameter)
    outward = corners[:, :2] / np.linalg.norm(corners[:, :2], axis=1, keepdims=True)
    size = diameter * (0.8 + 0.75 * np.tan(np.radians(36.0)))
    np.testing.assert_allclose(result[:, :2] - corners[:, :2], size * outward, atol=1e-12)
    np.testing.assert_array_equal(result[:, 2], corners[:, 2])


def test_planned_markers_give_the_stated_errors() -> None:
    """Compare the stated errors with those of lines fitted to noisy markers."""
    target, t, random = task("regular"), np.array([1.0]), np.random.default_rng(0)
    advice, layout = marker_plan(target), target.team.layout
    p = plan_at(target, t, target.states.vertices)[0]
    edges, legs = layout.edges(p), drones_of(target, t)[0] - p[layout.anchors]
    span, leg_lengths = np.linalg.norm(edges, axis=1), np.linalg.norm(legs, axis=1)[::2]
    units, lines = edges[:, :2] / span[:, None], []
    for k in range(3):
        s = advice.places[k] - leg_lengths[k]
        assert np.all((s > 0.0) & (s < span[k]))
        fits = np.polyfit(s, random.normal(0.0, ROPE_SCATTER, (4000, len(s))).T, 1)
        lines.append((fits[1], fits[1] + fits[0] * span[k]))
    for k in range(3):
        normals = units[[k - 1, k]] @ [[0.0, 1.0], [-1.0, 0.0]]
        deviations = np.linalg.solve(normals, np.stack([lines[k - 1][1], lines[k][0]]))
        scatter = np.sqrt(np.mean(np.sum(deviations**2, axis=0)))
        assert scatter < advice.standard_errors[k, 0] < 1.25 * scatter  # heights add to the squares


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def test_commands_and_files_agree_with_the_evaluation(place: Path) -> None:
    plan("triangle").save(place / "plan")
    write_csv(place / "flight.csv", triangle())
    call = run(
        "evaluate",
        "flight.csv",
        "--plan",
        "plan",
        "--diameter",
        "0.01",
        "--width",
        "3.5",
    )
    assert call.exit_code == 0, call.output
    assert "p2" in call.stdout
    assert "the clock is fitted" in call.stdout
    result, out = ho.evaluate(triangle(), task("triangle"), diameter=0.01), place / "evaluation"
    names = {"evaluation.json", "evaluation.pdf", "evaluation.tex", "recording.npz", "vertices.csv"}
    assert {path.name for path in out.iterdir()} == names
    rows = list(csv.DictReader((out / "vertices.csv").read_text().splitlines()))
    errors = np.array([float(row["error"] or "nan") for row in rows if row["vertex"] == "1"])
    content = json.loads((out / "evaluation.json").read_text())
    (row,) = (x for x in content["table"] if (x["name"], x["phase"]) == ("p1", "all"))
    measures = np.nanmean(errors), np.nanstd(errors), np.nanmax(errors), np.isfinite(errors).mean()
    assert [row[name] for name in ("mean", "std", "max", "found")] == pytest.approx(measures)
    assert measures[0] == pytest.approx(np.nanmean(result.errors[:, 1]))
    first = next(row for row in rows if row["x"])
    ends = [np.array([float(first[f"{a}{c}"]) for c in "xyz"]) for a in ("clasp_", "planned_")]
    assert float(first["error"]) == pytest.approx(np.linalg.norm(ends[0] - ends[1]))
    assert len(result.to_dataframe()) == len(content["table"])
    assert b"/MediaBox [ 0 0 252 " in (out / "evaluation.pdf").read_bytes()  # 3.5 inches
    cells = f"{1e3 * row['mean']:.1f} & {1e3 * row['std']:.1f}"
    latex = (out / "evaluation.tex").read_text()
    assert cells in latex
    lines = [line for line in latex.splitlines() if line.startswith("$p_{0}$ & ")]
    assert len({line.split(" & ", 2)[2] for line in lines}) == len(lines) >= 1  # none twice
    assert all(word in latex for word in (r"\begin{table}", r"\caption{", "$q_{0}$ & all"))
    assert_moving_and_resting_make_up_the_flight(result)
    ghost, clean = (
        ghost_scene(out, plan("triangle").flight),
        scene_at(plan("triangle").flight, result.t),
    )
    np.testing.assert_allclose(ghost.drones[5], result.drones[5], atol=1e-5)
    bend = ghost.cables[5, 0, CLASPS[0]] - clean.cables[5, 0, CLASPS[0]]
    np.testing.assert_allclose(bend, result.measured[5, 0] - result.planned[5, 0], atol=1e-5)
    page = plan("triangle").report(place / "plan", ghost=out).read_text("utf-8")
    assert '"name":"ghost"' in page
    assert result.to_recording().standard_errors is result.standard_errors
    with pytest.raises(ho.InputError, match="format"):
        result.save(out, "gif")
    with pytest.raises(FileError, match=r"contains plan\.npz"):
        result.save(place / "plan")


def assert_moving_and_resting_make_up_the_flight(result: Evaluation) -> None:
    """Sums over moving and resting times are those over all times."""
    rows = {(row.name, row.phase): row for row in result.table}
    off = result.drone_errors[:, 0]
    speeds = np.linalg.norm(np.gradient(result.planned_drones, result.t, axis=0), axis=-1)
    moving = np.max(speeds, axis=1) > 1e-3
    for phase, mask in (("moving", moving), ("resting", ~moving)):
        if mask.any():
            assert rows["q0", phase].mean == pytest.approx(np.nanmean(off[mask]))
    shares = np.mean(moving), 1.0 - np.mean(moving)
    means = [
        rows["q0", phase].mean if share else 0.0
        for phase, share in zip(("moving", "resting"), shares, strict=True)
    ]
    assert np.dot(shares, means) == pytest.approx(rows["q0", "all"].mean, rel=0.05)


def test_commands_place_markers_and_refuse_other_plans(place: Path) -> None:
    plan("sharp").save(place / "other")
    write_csv(place / "flight.csv", triangle())
    refusal = run("evaluate", "flight.csv", "--plan", "other")
    assert refusal.exit_code == 2
    assert "flight.csv" in refusal.stderr
    assert run("evaluate", "--plan", "other").exit_code == 2
    advice = run("evaluate", "--plan", "other", "--markers")
    assert advice.exit_code == 0
    assert "markers at [m]" in advice.stdout
