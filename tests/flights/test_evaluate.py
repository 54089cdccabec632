"""Evaluation of recorded flights, on recordings whose truth is known: laws, errors, refusals."""

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
from plans import planned as planned_problem
from scipy.signal import lfilter
from writers import write_csv

import hitchopt as ho
from benchmarks.recordings import RATE, Camera, exact_markers, plan_of
from hitchopt.cli import main
from hitchopt.flights.alignment import align
from hitchopt.flights.recordings import Track, plan_at
from hitchopt.flights.report import summary
from hitchopt.flights.vertices import ROPE_SCATTER, clasps_of, marker_plan
from hitchopt.simulation.task import Task
from hitchopt.values import Array
from hitchopt.view.cables import CLASPS
from hitchopt.view.scene import ghost_scene, scene_at

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
    else:  # Of three robots, as the triangle
        regular = ho.regular_polygon(3, 1.0).vertices.tolist()
        points = regular if name == "regular" else [[0, 0.9], [0.75, -0.45], [-0.75, -0.45]]
        team = ho.Team(3, **options)
    hitch = ho.Mission(team, ho.Hitch.spread(team, points, altitude=1.2))
    to = [0.0, 0.0, 1.6] if name == "regular" else [0.4, 0.5, 1.5]
    return hitch.transport(to=to).hold(1.0).solve()


@cache
def task(name: str) -> Task:
    return Task.of(plan(name).motion)


def drones_of(given: Task, t: Array) -> Array:
    return plan_at(given, t, given.states.positions)


def flown(name: str, camera: Camera, seed: int = 0, off: float = 0.01) -> ho.RecordedFlight:
    """Return the recording of a flight exactly as planned, but for an offset of every drone."""
    t = np.arange(-1.0, task(name).duration + 1.0, 1.0 / RATE)
    inside = np.clip(t, 0.0, task(name).duration)
    drones = drones_of(task(name), inside)
    offsets = np.random.default_rng(seed).normal(0.0, off, drones.shape[1:])
    offsets -= np.median(offsets, axis=0)  # The hitch follows the median of its drones
    return camera.recorded(t, drones + offsets, exact_markers(task(name), inside), seed)


@cache
def usual() -> ho.RecordedFlight:
    return flown("triangle", Camera())


def recorded(camera: Camera, t: Array, drones: Array, seed: int = 0) -> ho.RecordedFlight:
    return camera.recorded(t, drones, np.zeros((len(t), 0, 3)), seed)


@pytest.mark.parametrize("name", ["triangle", "sharp", "pentagon", "chain", "moving"])
def test_markers_on_exact_curves_give_the_vertices(name: str) -> None:
    result = ho.evaluate(flown(name, EXACT, off=0.0), task(name))
    clasps = task(name).team.layout.clasps
    assert np.isfinite(result.errors[:, clasps]).mean() > 0.99
    assert np.nanmax(result.errors) < 1e-4
    assert np.nanmax(result.drone_errors) < 1e-4
    assert abs(result.alignment.offset + EXACT.start) < 1e-4


def test_the_weight_that_a_plan_does_not_know_is_fitted() -> None:
    given, flight = task("triangle"), flown("triangle", EXACT, off=0.0)
    team: Any = {"cable_length": 2.4, "tension": float(given.team.tension[0])}
    weightless = replace(given, team=ho.Team(3, cable_density=0.0, **team))
    result = ho.evaluate(flight, weightless)
    assert result.density == pytest.approx(given.team.cable_density, rel=0.02)
    assert np.nanmax(result.errors) < 3e-4
    assert any("weigh them" in remark for remark in result.remarks)
    assert np.nanmax(ho.evaluate(flight, weightless, density=0.006).errors) < 1e-4


def test_standard_errors_cover_two_thirds_of_the_errors() -> None:
    """Markers beside the axis, other ones in every flight: as many errors as flights are free."""
    covered = []
    for seed in range(16):
        camera = Camera(noise=5e-4, offset=3e-3)
        result = ho.evaluate(flown("triangle", camera, seed, off=0.0), task("triangle"))
        i = len(result.t) // 2
        covered.append(result.errors[i] < result.standard_errors[i])
    assert 0.53 < np.mean(covered) < 0.83


@pytest.mark.parametrize("camera", [Camera(noise=2e-3, lost=0.2, gap=10.0), Camera(ghosts=2.0)])
def test_noise_losses_and_ghosts_cost_a_few_millimetres(camera: Camera) -> None:
    result = ho.evaluate(flown("sharp", camera, 3), task("sharp"))
    off = result.errors[np.isfinite(result.planned[..., 0])]
    assert np.mean(np.isfinite(off)) > 0.9
    assert np.nanmedian(off) < 5e-3
    assert np.nanpercentile(off, 95) < 15e-3


def shuffled(flight: ho.RecordedFlight) -> ho.RecordedFlight:
    cloud = flight.markers
    order = np.lexsort((np.random.default_rng(5).random(len(cloud.t)), cloud.t))
    return replace(flight, markers=Track(cloud.t, cloud.positions[order]))


def renamed(flight: ho.RecordedFlight) -> ho.RecordedFlight:
    names, tracks = list(flight.tracks), list(flight.tracks.values())
    return replace(flight, tracks=dict(zip(names[2:] + names[:2], tracks, strict=True)))


def with_a_wand(flight: ho.RecordedFlight) -> ho.RecordedFlight:
    t = np.unique(flight.markers.t)
    return replace(flight, tracks={"wand": Track(t, np.full((len(t), 3), 2.0)), **flight.tracks})


@pytest.mark.parametrize("change", [shuffled, renamed, with_a_wand])
def test_names_labels_and_other_bodies_change_nothing(
    change: Callable[[ho.RecordedFlight], ho.RecordedFlight],
) -> None:
    first, second = (ho.evaluate(each, task("triangle")) for each in (usual(), change(usual())))
    np.testing.assert_allclose(second.vertices, first.vertices, atol=1e-6)
    np.testing.assert_allclose(second.drones, first.drones, atol=1e-9)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("yaw", [0.0, 0.7, 4.0])
def test_frames_and_clocks_are_fitted(up: str, yaw: float) -> None:
    known = up == "z" and yaw == 0.0
    camera = Camera(yaw=yaw, up=up, shift=(0.0, 0.0, 0.0) if yaw == 0.0 else (1.0, 0.5, 0.3),
                    start=40.0, rate=84.0 / 85.0)  # fmt: skip
    result = ho.evaluate(flown("triangle", camera, 1), task("triangle"))
    assert result.alignment.frame == ("fit" if yaw else "plan" if known else "y-up")
    assert result.alignment.rate == pytest.approx(85.0 / 84.0, abs=1e-3)
    middle = 40.0 + 4.0 * 84.0 / 85.0
    assert result.alignment.rate * middle + result.alignment.offset == pytest.approx(4.0, abs=0.02)
    assert np.nanmedian(result.errors) < (15e-3 if yaw else 3e-3)
    shared = result.alignment.rms / np.sqrt(2) if yaw else 0.0  # A frame's error is in all places
    assert np.nanmin(result.standard_errors) > shared


def test_the_frame_of_another_evaluation_is_used(tmp_path: Path) -> None:
    flight = flown("triangle", Camera(yaw=0.7, shift=(1.0, 0.5, 0.3)), 1)
    first, file = ho.evaluate(flight, task("triangle")), tmp_path / "evaluation.json"
    file.write_text(json.dumps(summary(first)))
    again = ho.evaluate(flight, task("triangle"), frame=file)
    np.testing.assert_allclose(again.alignment.rotation, first.alignment.rotation)
    assert "frame" in first.alignment.fitted
    assert "frame" not in again.alignment.fitted


def test_every_drone_may_have_its_clock() -> None:
    shifts = np.random.default_rng(2).uniform(-30.0, 30.0, 6)
    pairs = zip(usual().tracks.items(), shifts, strict=True)
    tracks = {name: Track(x.t + shift, x.positions) for (name, x), shift in pairs}
    together = ho.evaluate(usual(), task("triangle")).alignment
    result = ho.evaluate(ho.RecordedFlight("logs", tracks, one_clock=False), task("triangle"))
    assert result.alignment.names == together.names
    order = [list(tracks).index(name) for name in together.names]
    offsets = result.alignment.offsets + shifts[order]
    np.testing.assert_allclose(offsets, together.offset, atol=0.03)
    assert any("only drones" in remark for remark in result.remarks)
    assert [row for row in result.table if row.name == "q0"]


def test_logged_set_points_show_the_lag_of_drones() -> None:
    late = {name: Track(x.t + 0.15, x.positions) for name, x in usual().tracks.items()}
    logged = replace(usual(), tracks=late, setpoints=usual().tracks)
    result = ho.evaluate(logged, task("triangle"))
    assert result.alignment.offset == pytest.approx(-Camera().start, abs=5e-3)
    assert not any("lag" in remark for remark in result.remarks)
    without = ho.evaluate(replace(usual(), tracks=late), task("triangle"))
    assert without.alignment.offset == pytest.approx(-Camera().start - 0.15, abs=5e-3)


def moved(given: Task, offsets: Array) -> Task:
    """Return a task whose drones begin as those of another, and then move by (times, 2n, 3)."""
    start = given.states.positions[:1]
    return replace(given, states=replace(given.states, positions=start + offsets))


@cache
def small_moves() -> tuple[Task, Array]:
    """Return a task that moves by a few centimetres, and its movements (times, 2n, 3) [m]."""
    positions = task("triangle").states.positions
    offsets = 0.25 * (positions - positions[0])
    return moved(task("triangle"), offsets), offsets


def swinging(given: Task, seed: int, scatter: float, time: float = 1.0) -> tuple[Array, Array]:
    """Return times, and positions of drones that swing about their plan, in part all of them."""
    random, t = np.random.default_rng(seed), np.arange(0.0, given.duration, 0.02)
    drones, decay = drones_of(given, t), np.exp(-0.02 / time)
    white = random.normal(size=(1000 + len(t), drones.shape[1] + 1, 3))
    swings = lfilter([scatter * np.sqrt(1.0 - decay**2)], [1.0, -decay], white, axis=0)[1000:]
    return t, drones + swings[:, :-1] + swings[:, -1:] + random.normal(0.0, 0.01, drones[0].shape)


@pytest.mark.slow
@pytest.mark.parametrize("camera", [Camera(), Camera(yaw=0.7, up="y", shift=(1.0, 0.5, 0.3))])
def test_other_movements_of_the_same_hitch_are_refused(camera: Camera) -> None:
    """Twenty plans begin at the same positions and move as far, hence stay within some cm."""
    given, offsets = small_moves()
    flight = recorded(camera, *swinging(given, 1, 0.003))
    assert align(flight, given).rms < 0.05
    size, phases = np.std(offsets), np.linspace(0.0, 1.0, len(offsets))[:, None, None]
    for seed in range(20):
        random = np.random.default_rng(seed)
        shape = (2, *offsets.shape[1:])
        rate, phase = random.uniform(3.0, 12.0, shape), random.uniform(0.0, 6.3, shape)
        waves = sum(np.sin(r * phases + p) - np.sin(p) for r, p in zip(rate, phase, strict=True))
        with pytest.raises(ho.FileError, match="name the plan that was flown"):
            align(flight, moved(given, size * np.asarray(waves)))


@pytest.mark.parametrize("name", ["small", "triangle"])
def test_standard_errors_of_clocks_are_those_over_seeds(name: str) -> None:
    """Drones swing for a second and more, some of them together; little moves in one flight."""
    given = small_moves()[0] if name == "small" else task(name)
    off, stated = [], []
    for seed in range(20):
        t, drones = swinging(given, seed, 0.004 if name == "small" else 0.01)
        result = align(recorded(Camera(), t, drones, seed), given)
        off.append(result.rate * (2.0 + t[-1] / 2.0) + result.offset - t[-1] / 2.0)
        stated.append(result.offset_error)
    ratio = np.sqrt(np.mean(np.square(off)) / np.mean(np.square(stated)))
    assert 0.4 < ratio < 1.5


def cut(flight: ho.RecordedFlight, start: float, end: float) -> ho.RecordedFlight:
    tracks = {}
    for name, x in flight.tracks.items():
        use = (x.t >= start) & (x.t <= end)
        tracks[name] = Track(x.t[use], x.positions[use])
    return ho.RecordedFlight("cut", tracks)


def still() -> ho.RecordedFlight:
    held = {name: Track(x.t, 0.0 * x.positions + x.positions[0]) for name, x in
            usual().tracks.items()}  # fmt: skip
    return replace(usual(), tracks=held)


def turned_regular() -> ho.RecordedFlight:
    t = np.arange(0.0, task("regular").duration, 0.02)
    return recorded(Camera(yaw=1.0), t, drones_of(task("regular"), t))


def turned_part() -> ho.RecordedFlight:
    return cut(flown("triangle", Camera(yaw=0.7, start=0.0)), 0.0, 3.0)


Request = tuple[Callable[[], ho.RecordedFlight], str, dict[str, Any], str]

REFUSALS: dict[str, Request] = {
    "another plan": (usual, "other", {}, "was flown"),
    "another polygon": (usual, "sharp", {}, "was flown"),
    "more robots": (usual, "pentagon", {}, "6 bodies (cf"),
    "nothing moves": (still, "triangle", {}, "start="),
    "too short": (lambda: cut(usual(), 4.0, 5.5), "triangle", {}, "2.0 s"),
    "a third of it in an unknown frame": (turned_part, "triangle", {}, "m, 4."),
    "two answers": (turned_regular, "regular", {}, "names="),
    "no such name": (usual, "triangle", {"names": "cf999=q0"}, "cf999"),
    "a drone twice": (usual, "triangle", {"names": dict.fromkeys(usual().tracks, "q0")}, "once"),
    "no pairs": (usual, "triangle", {"names": "cf1"}, "cf231=q0"),
    "no frame": (usual, "triangle", {"frame": "left"}, "y-up"),
    "no window": (usual, "triangle", {"window": 0}, "window"),
    "no diameter": (usual, "triangle", {"diameter": -1}, "diameter"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_other_plans_and_requests_are_refused(case: str) -> None:
    flight, name, options, words = REFUSALS[case]
    error = ho.InputError if options else ho.FileError
    with pytest.raises(error, match=words.replace("(", r"\(")):
        ho.evaluate(flight(), task(name), **options)


def test_names_choose_between_two_answers() -> None:
    flight = turned_regular()
    names = dict(zip(flight.tracks, task("regular").team.drone_names, strict=True))
    result = ho.evaluate(flight, task("regular"), names=names)
    assert result.alignment.names == tuple(flight.tracks)
    assert "names" not in result.alignment.fitted


def test_a_stated_start_is_the_clock() -> None:
    result = ho.evaluate(usual(), task("triangle"), start=2.013)
    assert result.alignment.offset == pytest.approx(-2.013)
    assert result.alignment.fitted == ("names",)
    late = flown(
        "triangle", replace(EXACT, start=0.02)
    )  # As drones may fly: the clock is the plan's
    simulated = replace(late, simulated={"density": 0.01, "feed_forward": None, "integral": None})
    assert ho.evaluate(simulated, task("triangle")).alignment.offset == 0.0


def test_remarks_name_bare_edges() -> None:
    cloud, p = (
        usual().markers,
        plan_at(task("triangle"), np.zeros(1), task("triangle").states.vertices)[0],
    )
    bare = np.linalg.norm(cloud.positions - 0.5 * (p[0] + p[1]), axis=1) > 0.45
    few = replace(usual(), markers=Track(cloud.t[bare], cloud.positions[bare]))
    result = ho.evaluate(few, task("triangle"))
    seen = np.isfinite(result.vertices[result.t < 1.5, :, 0]).mean(axis=0)
    assert seen[2] > 0.9
    assert np.all(seen[:2] == 0.0)
    assert [remark for remark in result.remarks if remark.startswith("p0 is measured")]


def test_recorded_vertices_are_used_while_there_is_a_hitch() -> None:
    given = Task.of(planned_problem("tie_carry_untie").motion)
    t = np.arange(0.0, given.duration, 0.02)
    flight = recorded(Camera(lost=0.0), t, drones_of(given, t))
    places = plan_at(given, t, given.states.vertices) + [0.01, 0.0, 0.0]
    own = {f"p{k}": Track(t + Camera().start, places[:, k]) for k in range(3)}
    result = ho.evaluate(replace(flight, tracks={**flight.tracks, **own}), given)
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
    """Against lines through noisy markers."""
    given, t, random = task("regular"), np.array([1.0]), np.random.default_rng(0)
    advice, p, layout = (
        marker_plan(given),
        plan_at(given, t, given.states.vertices)[0],
        given.team.layout,
    )
    edges, legs = layout.edges(p), drones_of(given, t)[0] - p[layout.anchors]
    span, begins = np.linalg.norm(edges, axis=1), np.linalg.norm(legs, axis=1)[::2]
    units, lines = edges[:, :2] / span[:, None], []
    for k in range(3):
        s = advice.places[k] - begins[k]
        assert np.all((s > 0.0) & (s < span[k]))
        fits = np.polyfit(s, random.normal(0.0, ROPE_SCATTER, (4000, len(s))).T, 1)
        lines.append((fits[1], fits[1] + fits[0] * span[k]))
    for k in range(3):
        normals = units[[k - 1, k]] @ [[0.0, 1.0], [-1.0, 0.0]]
        off = np.linalg.solve(normals, np.stack([lines[k - 1][1], lines[k][0]]))
        level = np.sqrt(np.mean(np.sum(off**2, axis=0)))
        assert level < advice.standard_errors[k, 0] < 1.25 * level  # Heights add to the squares


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def test_commands_and_files_agree_with_the_evaluation(place: Path) -> None:
    plan("triangle").save(place / "plan")
    write_csv(place / "flight.csv", usual())
    done = run("evaluate", "flight.csv", "--plan", "plan", "--diameter", "0.01", "--format", "svg")
    assert done.exit_code == 0, done.output
    assert "p2" in done.stdout
    assert "the clock is fitted" in done.stdout
    result, out = ho.evaluate(usual(), task("triangle"), diameter=0.01), place / "evaluation"
    names = {"evaluation.json", "evaluation.svg", "evaluation.tex", "recording.npz", "vertices.csv"}
    assert {path.name for path in out.iterdir()} == names
    rows = list(csv.DictReader((out / "vertices.csv").read_text().splitlines()))
    off = np.array([float(row["error"] or "nan") for row in rows if row["vertex"] == "1"])
    content = json.loads((out / "evaluation.json").read_text())
    (said,) = (x for x in content["table"] if (x["name"], x["phase"]) == ("p1", "all"))
    measures = np.nanmean(off), np.nanstd(off), np.nanmax(off), np.isfinite(off).mean()
    assert [said[name] for name in ("mean", "std", "max", "found")] == pytest.approx(measures)
    assert measures[0] == pytest.approx(np.nanmean(result.errors[:, 1]))
    one = next(row for row in rows if row["x"])
    ends = [np.array([float(one[f"{a}{c}"]) for c in "xyz"]) for a in ("clasp_", "planned_")]
    assert float(one["error"]) == pytest.approx(np.linalg.norm(ends[0] - ends[1]))
    assert len(result.to_dataframe()) == len(content["table"])
    cells = f"{1e3 * said['mean']:.1f} & {1e3 * said['std']:.1f}"
    assert cells in (out / "evaluation.tex").read_text()
    ghost, clean = (
        ghost_scene(out, plan("triangle").motion),
        scene_at(plan("triangle").motion, result.t),
    )
    np.testing.assert_allclose(ghost.drones[5], result.drones[5], atol=1e-5)
    bend = ghost.cables[5, 0, CLASPS[0]] - clean.cables[5, 0, CLASPS[0]]
    np.testing.assert_allclose(bend, result.measured[5, 0] - result.planned[5, 0], atol=1e-5)
    page = plan("triangle").report(place / "plan", ghost=out).read_text("utf-8")
    assert '"name":"ghost"' in page
    assert result.to_recording().standard_errors is result.standard_errors
    with pytest.raises(ho.InputError, match="format"):
        result.save(out, "gif")
    with pytest.raises(ho.FileError, match=r"holds plan\.npz"):
        result.save(place / "plan")


def test_commands_place_markers_and_refuse_other_plans(place: Path) -> None:
    plan("sharp").save(place / "other")
    write_csv(place / "flight.csv", usual())
    wrong = run("evaluate", "flight.csv", "--plan", "other")
    assert wrong.exit_code == 2
    assert "flight.csv" in wrong.stderr
    assert run("evaluate", "--plan", "other").exit_code == 2
    said = run("evaluate", "--plan", "other", "--markers")
    assert said.exit_code == 0
    assert "markers at [m]" in said.stdout
