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

import hitchopt as ho
from benchmarks.recordings import RATE, Camera, exact_markers, plan_of
from hitchopt.cli import main
from hitchopt.flights.alignment import align
from hitchopt.flights.recordings import Track, planned
from hitchopt.flights.vertices import BENT, clasps_of, marker_plan
from hitchopt.simulation.task import Task
from hitchopt.values import Array
from hitchopt.view.cables import CLASPS
from hitchopt.view.scene import ghost_scene, scene_at

EXACT = Camera(noise=0.0, lost=0.0, ghosts=0.0)


@cache
def plan(name: str) -> ho.Plan:
    if name == "moving":
        return planned_problem("paper_experiment_4")
    if name != "chain":
        return plan_of(name)
    team = ho.Team(3, topology="open", cable_length=2.4, cable_density=0.005)
    points = [[-1.2, 0.3], [-0.5, 0.7], [0.6, 0.6], [1.1, 0.1]]
    start = ho.Hitch.spread(team, points, altitude=1.2)
    return ho.Mission(team, start).transport(to=[0.4, 0.5, 1.5]).solve()


@cache
def task(name: str) -> Task:
    return Task.of(plan(name).motion)


def flown(name: str, camera: Camera, seed: int = 0, **more: Any) -> ho.RecordedFlight:
    """Return the recording of a flight exactly as planned, but for an offset of every drone."""
    t = np.arange(-1.0, task(name).duration + 1.0, 1.0 / RATE)
    inside = np.clip(t, 0.0, task(name).duration)
    drones = planned(task(name), inside, task(name).setpoints.positions)
    off = np.random.default_rng(seed).normal(0.0, more.pop("off", 0.01), drones.shape[1:])
    off -= np.median(off, axis=0)  # The hitch follows the median of its drones
    markers = exact_markers(more.pop("ropes", task(name)), inside, **more)
    return camera.recorded(t, drones + off, markers, seed)


@cache
def usual(seed: int = 0) -> ho.RecordedFlight:
    return flown("triangle", Camera(), seed)


def altered(flight: ho.RecordedFlight, **changes: Any) -> ho.RecordedFlight:
    return replace(flight, **changes)


@pytest.mark.parametrize("name", ["triangle", "sharp", "pentagon", "chain", "moving"])
def test_markers_on_exact_curves_give_the_vertices(name: str) -> None:
    result = ho.evaluate(flown(name, EXACT, off=0.0), task(name))
    clasps = task(name).team.layout.clasps
    assert np.isfinite(result.errors[:, clasps]).mean() > 0.99
    assert np.nanmax(result.errors) < 1e-4
    assert np.nanmax(result.drone_errors) < 1e-4
    assert abs(result.alignment.offset + EXACT.start) < 1e-4


def test_the_weight_that_a_plan_does_not_know_is_fitted() -> None:
    weightless = replace_density(task("triangle"), 0.0)
    result = ho.evaluate(flown("triangle", EXACT, off=0.0), weightless)
    assert result.density == pytest.approx(task("triangle").team.cable_density, rel=0.02)
    assert np.nanmax(result.errors) < 3e-4
    assert any("weigh them" in remark for remark in result.remarks)
    stated = ho.evaluate(flown("triangle", EXACT, off=0.0), weightless, density=0.006)
    assert np.nanmax(stated.errors) < 1e-4


def replace_density(given: Task, density: float) -> Task:
    team = given.team
    weightless = ho.Team(
        team.robots, cable_length=2.4, cable_density=density, tension=float(team.tension[0])
    )
    return replace(given, team=weightless)


def test_standard_errors_cover_two_thirds_of_the_errors() -> None:
    """Markers beside the axis, other ones in every flight: as many errors as flights are free."""
    covered = []
    for seed in range(24):
        camera = Camera(noise=5e-4, aside=3e-3)
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
    return altered(flight, markers=Track(cloud.t, cloud.positions[order]))


def renamed(flight: ho.RecordedFlight) -> ho.RecordedFlight:
    names, tracks = list(flight.tracks), list(flight.tracks.values())
    return altered(flight, tracks=dict(zip(names[2:] + names[:2], tracks, strict=True)))


def with_a_wand(flight: ho.RecordedFlight) -> ho.RecordedFlight:
    t = np.unique(flight.markers.t)
    return altered(flight, tracks={"wand": Track(t, np.full((len(t), 3), 2.0)), **flight.tracks})


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
    camera = Camera(yaw=0.7, shift=(1.0, 0.5, 0.3))
    flight = flown("triangle", camera, 1)
    place = ho.evaluate(flight, task("triangle")).save(tmp_path / "one")
    again = ho.evaluate(flight, task("triangle"), frame=place / "evaluation.json")
    first = json.loads((place / "evaluation.json").read_text())["alignment"]
    np.testing.assert_allclose(again.alignment.rotation, first["rotation"])
    assert "frame" not in again.alignment.fitted


def test_every_drone_may_have_its_clock() -> None:
    shifts = np.random.default_rng(2).uniform(-30.0, 30.0, 6)
    tracks = {
        name: Track(track.t + shift, track.positions)
        for (name, track), shift in zip(usual().tracks.items(), shifts, strict=True)
    }
    own = ho.RecordedFlight("logs", tracks, one_clock=False)
    together = ho.evaluate(usual(), task("triangle"))
    result = ho.evaluate(own, task("triangle"))
    assert result.alignment.names == together.alignment.names
    order = [list(tracks).index(name) for name in result.alignment.names]
    np.testing.assert_allclose(
        result.alignment.offsets + shifts[order], together.alignment.offset, atol=0.03
    )
    assert any("drones alone" in remark for remark in result.remarks)
    assert [row for row in result.table if row.name == "q0"]


def test_logged_set_points_show_the_lag_of_drones() -> None:
    late = {name: Track(x.t + 0.15, x.positions) for name, x in usual().tracks.items()}
    logged = altered(usual(), tracks=late, setpoints=usual().tracks)
    result = ho.evaluate(logged, task("triangle"))
    assert result.alignment.offset == pytest.approx(-Camera().start, abs=5e-3)
    assert not any("lag" in remark for remark in result.remarks)
    without = ho.evaluate(altered(usual(), tracks=late), task("triangle"))
    assert without.alignment.offset == pytest.approx(-Camera().start - 0.15, abs=5e-3)


def moved(given: Task, offsets: Array) -> Task:
    """Return a task whose drones begin as those of another, and then move by (times, 2n, 3)."""
    start = given.setpoints.positions[:1]
    return replace(given, setpoints=replace(given.setpoints, positions=start + offsets))


@cache
def small_moves() -> tuple[Task, Array]:
    """Return a task that moves by a few centimetres, and its movements (times, 2n, 3) [m]."""
    offsets = 0.25 * (
        task("triangle").setpoints.positions - task("triangle").setpoints.positions[0]
    )
    return moved(task("triangle"), offsets), offsets


def swinging(given: Task, seed: int, scatter: float, time: float = 1.0) -> tuple[Array, Array]:
    """Return times, and positions of drones that swing about their plan, in part all of them."""
    random, t = np.random.default_rng(seed), np.arange(0.0, given.duration, 0.02)
    drones = planned(given, t, given.setpoints.positions)
    decay = np.exp(-0.02 / time)
    white = random.normal(size=(1000 + len(t), drones.shape[1] + 1, 3))
    swings = lfilter([scatter * np.sqrt(1.0 - decay**2)], [1.0, -decay], white, axis=0)[1000:]
    return t, drones + swings[:, :-1] + swings[:, -1:] + random.normal(0.0, 0.01, drones[0].shape)


@pytest.mark.slow
@pytest.mark.parametrize("camera", [Camera(), Camera(yaw=0.7, up="y", shift=(1.0, 0.5, 0.3))])
def test_other_movements_of_the_same_hitch_are_refused(camera: Camera) -> None:
    """Twenty plans begin at the same positions and move as far, hence stay within some cm."""
    flown, offsets = small_moves()
    t, drones = swinging(flown, 1, 0.003)
    flight = camera.recorded(t, drones, np.zeros((len(t), 0, 3)), 0)
    assert align(flight, flown).rms < 0.05
    size, phases = np.std(offsets), np.linspace(0.0, 1.0, len(offsets))[:, None, None]
    for seed in range(20):
        random = np.random.default_rng(seed)
        shape = (2, *offsets.shape[1:])
        rate, phase = random.uniform(3.0, 12.0, shape), random.uniform(0.0, 6.3, shape)
        waves = sum(np.sin(r * phases + p) - np.sin(p) for r, p in zip(rate, phase, strict=True))
        with pytest.raises(ho.FileError, match="name the plan that was flown"):
            align(flight, moved(flown, size * np.asarray(waves)))


@pytest.mark.parametrize("name", ["small", "triangle"])
def test_standard_errors_of_clocks_are_those_over_seeds(name: str) -> None:
    """Drones swing for a second and more, some of them together; little moves in one flight."""
    given = small_moves()[0] if name == "small" else task(name)
    off, stated = [], []
    for seed in range(20):
        t, drones = swinging(given, seed, 0.004 if name == "small" else 0.01)
        result = align(Camera().recorded(t, drones, np.zeros((len(t), 0, 3)), seed), given)
        off.append(result.rate * (2.0 + t[-1] / 2.0) + result.offset - t[-1] / 2.0)
        stated.append(result.offset_error)
    ratio = np.sqrt(np.mean(np.square(off)) / np.mean(np.square(stated)))
    assert 0.4 < ratio < 1.5


def other_plan(altitude: float = 1.2) -> Task:
    team = ho.Team(3, cable_length=2.4, cable_density=0.006, tension=0.5)
    start = ho.Hitch.spread(team, [[0, 0.9], [0.75, -0.45], [-0.75, -0.45]], altitude=altitude)
    return Task.of(ho.Mission(team, start).transport(to=[0.3, 0.2, 1.4]).solve().motion)


@cache
def regular() -> Task:
    team = ho.Team(3, cable_length=2.4)
    start = ho.Hitch.spread(team, ho.regular_polygon(3, 1.0).vertices, altitude=1.2)
    hitch = ho.Mission(team, start)
    return Task.of(hitch.transport(to=[0.0, 0.0, 1.6]).hold(1.0).solve().motion)


def still() -> ho.RecordedFlight:
    tracks = {
        name: Track(x.t, 0.0 * x.positions + x.positions[0]) for name, x in usual().tracks.items()
    }
    return altered(usual(), tracks=tracks)


def cut(flight: ho.RecordedFlight, start: float, end: float) -> ho.RecordedFlight:
    tracks = {}
    for name, x in flight.tracks.items():
        use = (x.t >= start) & (x.t <= end)
        tracks[name] = Track(x.t[use], x.positions[use])
    return ho.RecordedFlight("cut", tracks)


def turned_regular() -> ho.RecordedFlight:
    t = np.arange(0.0, regular().duration, 0.02)
    drones = planned(regular(), t, regular().setpoints.positions)
    return Camera(yaw=1.0).recorded(t, drones, np.zeros((len(t), 0, 3)), 0)


REFUSALS: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "another plan": (lambda: ho.evaluate(usual(), other_plan()), ho.FileError, "was flown"),
    "another polygon": (lambda: ho.evaluate(usual(), task("sharp")), ho.FileError, "was flown"),
    "more robots": (lambda: ho.evaluate(usual(), task("pentagon")), ho.FileError, "6 bodies (cf"),
    "nothing moves": (lambda: ho.evaluate(still(), task("triangle")), ho.FileError, "start="),
    "too short": (
        lambda: ho.evaluate(cut(usual(), 4.0, 5.5), task("triangle")), ho.FileError, "2.0 s",
    ),
    "a third of it in an unknown frame": (
        lambda: ho.evaluate(cut(flown("triangle", Camera(yaw=0.7, start=0.0)), 0.0, 3.0),
                            task("triangle")),
        ho.FileError, "at least 4",
    ),
    "two answers": (lambda: ho.evaluate(turned_regular(), regular()), ho.FileError, "names="),
    "no such name": (
        lambda: ho.evaluate(usual(), task("triangle"), names="cf999=q0"), ho.InputError, "cf999",
    ),
    "a drone twice": (
        lambda: ho.evaluate(usual(), task("triangle"), names=dict.fromkeys(usual().tracks, "q0")),
        ho.InputError, "once",
    ),
    "no pairs": (
        lambda: ho.evaluate(usual(), task("triangle"), names="cf1"), ho.InputError, "cf231=q0",
    ),
    "no frame": (
        lambda: ho.evaluate(usual(), task("triangle"), frame="left"), ho.InputError, "y-up",
    ),
    "no window": (
        lambda: ho.evaluate(usual(), task("triangle"), window=0), ho.InputError, "window",
    ),
    "no diameter": (
        lambda: ho.evaluate(usual(), task("triangle"), diameter=-1), ho.InputError, "diameter",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSALS)
def test_other_plans_and_requests_are_refused(case: str) -> None:
    call, error, words = REFUSALS[case]
    with pytest.raises(error, match=words.replace("(", r"\(")):
        call()


def test_names_choose_between_two_answers() -> None:
    flight = turned_regular()
    names = dict(zip(flight.tracks, regular().team.drone_names, strict=True))
    result = ho.evaluate(flight, regular(), names=names)
    assert result.alignment.names == tuple(flight.tracks)
    assert "names" not in result.alignment.fitted


def test_a_stated_start_is_the_clock() -> None:
    result = ho.evaluate(usual(), task("triangle"), start=2.013)
    assert result.alignment.offset == pytest.approx(-2.013)
    assert result.alignment.fitted == ("names",)
    on = np.ones(6, np.bool_)
    camera = replace(EXACT, start=0.02)  # As late as drones may fly: the clock is the plan's
    simulated = altered(
        flown("triangle", camera), simulated={"density": 0.01, "feed_forward": on, "integral": on}
    )
    assert ho.evaluate(simulated, task("triangle")).alignment.offset == 0.0


def test_remarks_name_bare_edges() -> None:
    cloud = usual().markers
    p = planned(task("triangle"), np.zeros(1), task("triangle").vertices)[0]
    middle = 0.5 * (p[0] + p[1])
    bare = np.linalg.norm(cloud.positions - middle, axis=1) > 0.45
    few = Track(cloud.t[bare], cloud.positions[bare])
    result = ho.evaluate(cut_markers(few), task("triangle"))
    seen = np.isfinite(result.vertices[result.t < 1.5, :, 0]).mean(axis=0)
    assert seen[2] > 0.9
    assert np.all(seen[:2] == 0.0)
    assert [remark for remark in result.remarks if remark.startswith("p0 is found")]


def cut_markers(cloud: Track) -> ho.RecordedFlight:
    return altered(usual(), markers=cloud)


def test_recorded_vertices_are_used_while_there_is_a_hitch() -> None:
    given = Task.of(planned_problem("tie_carry_untie").motion)
    t = np.arange(0.0, given.duration, 0.02)
    drones = planned(given, t, given.setpoints.positions)
    flight = Camera(lost=0.0).recorded(t, drones, np.zeros((len(t), 0, 3)), 0)
    places = planned(given, t, given.vertices) + [0.01, 0.0, 0.0]
    own = {f"p{k}": Track(t + Camera().start, places[:, k]) for k in range(3)}
    result = ho.evaluate(altered(flight, tracks={**flight.tracks, **own}), given)
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
    given = regular()
    advice = marker_plan(given)
    t = np.array([1.0])
    p, layout = planned(given, t, given.vertices)[0], given.team.layout
    edges = layout.edges(p)
    span = np.linalg.norm(edges, axis=1)
    legs = np.linalg.norm(
        planned(given, t, given.setpoints.positions)[0] - p[layout.anchors], axis=1
    )
    random, off = np.random.default_rng(0), []
    lines = []
    for k in range(3):
        s = advice.places[k] - legs[2 * k]
        assert np.all((s > 0.0) & (s < span[k]))
        noise = random.normal(0.0, BENT, (4000, len(s)))
        fits = np.polyfit(s, noise.T, 1)  # slopes and offsets of lines aside
        lines.append((fits[1], fits[1] + fits[0] * span[k]))
    for k in range(3):
        u, v = edges[k - 1][:2] / span[k - 1], edges[k][:2] / span[k]
        normals = np.array([[-u[1], u[0]], [-v[1], v[0]]])
        ends = np.stack([lines[k - 1][1], lines[k][0]])
        off.append(np.sqrt(np.mean(np.sum(np.linalg.solve(normals, ends) ** 2, axis=0))))
    level = np.array(off)
    said = advice.standard_errors[:, 0]
    assert np.all((said > level) & (said < 1.25 * level))  # heights add a quarter of the squares


def test_files_agree_with_the_evaluation(tmp_path: Path) -> None:
    place = plan("triangle").save(tmp_path / "plan")
    result = ho.evaluate(usual(), place, diameter=0.01)
    out = result.save(tmp_path / "out", "svg")
    names = {"evaluation.json", "evaluation.svg", "evaluation.tex", "recording.npz", "vertices.csv"}
    assert {path.name for path in out.iterdir()} == names
    rows = list(csv.DictReader((out / "vertices.csv").read_text().splitlines()))
    off = np.array([float(row["error"] or "nan") for row in rows if row["vertex"] == "1"])
    content = json.loads((out / "evaluation.json").read_text())
    (said,) = (x for x in content["table"] if (x["name"], x["phase"]) == ("p1", "all"))
    measures = np.nanmean(off), np.nanstd(off), np.nanmax(off), np.isfinite(off).mean()
    assert [said[name] for name in ("mean", "std", "max", "found")] == pytest.approx(measures)
    one = next(row for row in rows if row["x"])
    place_of = [np.array([float(one[f"{a}{c}"]) for c in "xyz"]) for a in ("clasp_", "planned_")]
    assert float(one["error"]) == pytest.approx(np.linalg.norm(place_of[0] - place_of[1]))
    frame = result.to_dataframe()
    assert len(frame) == len(content["table"])
    assert (
        f"{1e3 * said['mean']:.1f} & {1e3 * said['std']:.1f}"
        in (out / "evaluation.tex").read_text()
    )
    ghost = ghost_scene(out, plan("triangle").motion)
    np.testing.assert_allclose(ghost.drones[5], result.drones[5], atol=1e-5)
    assert result.clasps is not None
    clean = scene_at(plan("triangle").motion, result.t)
    bend = ghost.cables[5, 0, CLASPS[0]] - clean.cables[5, 0, CLASPS[0]]
    np.testing.assert_allclose(bend, result.clasps[5, 0] - result.planned[5, 0], atol=1e-5)
    page = plan("triangle").report(place, ghost=out).read_text("utf-8")
    assert '"name":"ghost"' in page
    recording = result.to_recording()
    assert recording.standard_errors is result.standard_errors
    with pytest.raises(ho.InputError, match="format"):
        result.save(tmp_path / "out", "gif")
    with pytest.raises(ho.FileError, match=r"holds plan\.npz"):
        result.save(place)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, arguments)


def test_commands_evaluate_and_place_markers(place: Path) -> None:
    plan("triangle").save(place / "plan")
    with (place / "flight.csv").open("w") as file:
        file.write("t,name,x,y,z\n")
        for name, track in usual().tracks.items():
            for t, x in zip(track.t, track.positions.tolist(), strict=True):
                file.write(f"{t:.5f},{name},{x[0]:.5f},{x[1]:.5f},{x[2]:.5f}\n")
        cloud = usual().markers
        for t, x in zip(cloud.t, cloud.positions.tolist(), strict=True):
            file.write(f"{t:.5f},marker,{x[0]:.5f},{x[1]:.5f},{x[2]:.5f}\n")
    done = run("evaluate", "flight.csv", "--plan", "plan")
    assert done.exit_code == 0, done.output
    assert (place / "evaluation" / "evaluation.png").exists()
    assert "p2" in done.stdout
    assert "the clock is fitted" in done.stdout
    assert run("evaluate", "--plan", "plan").exit_code == 2
    said = run("evaluate", "--plan", "plan", "--markers")
    assert said.exit_code == 0
    assert "markers at [m]" in said.stdout
    plan("sharp").save(place / "other")
    wrong = run("evaluate", "flight.csv", "--plan", "other")
    assert wrong.exit_code == 2
    assert "flight.csv" in wrong.stderr
