"""Evaluation of hand-made and simulated flights: failures, errors, losses, campaigns."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.text import Text
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.lab.simulation import judgement
from hitchopt.lab.simulation.campaign import run_campaign, save_campaign
from hitchopt.lab.simulation.contacts import MIN_BEARING_RATIO, least_bearing
from hitchopt.lab.simulation.departures import Failure
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.judgement import Outcome, judge
from hitchopt.lab.simulation.report import Simulation, drawn_flight, flight_scene, summary
from hitchopt.lab.simulation.ropes import simulated_density
from hitchopt.lab.simulation.settings import Loss, Perturbations, Settings
from hitchopt.lab.simulation.task import Cargo, Task
from hitchopt.lab.simulation.world import InvalidRunError
from hitchopt.objects import Section, SolidObject
from hitchopt.view.style import save_figure
from tests.helpers import carried_plans
from tests.helpers.scripted import changed, flight_of, regular_hitch, resting_task

FAILED, NOT_SIMULATED, SUCCEEDED = "failed", "not simulated", "succeeded"
HITCH = regular_hitch(4)
NEIGHBOURS = np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]])
UNLINKED = 0 * NEIGHBOURS
STRAIN = InvalidRunError("strain", "strain of 5 %", 1.25, "cable 3", "use a higher density")


def flight_with(
    linking: NDArray[np.int64] | None = NEIGHBOURS,
    moved: float = 0.02,
    lost: int | None = None,
    *,
    formed: bool = True,
    pulled: float = 5.0,
    swing: float = 0.0,
    drift: float = 0.0,
    **known: Any,
) -> Simulation:
    """Return a flight of 2 s with rest and pull test.

    In the pull test the second vertex slips along a leg by ``moved``, and the hitch drifts. The
    vertex swings by ``swing`` to either side.
    """
    t = np.arange(known.pop("begin", 0.0), known.pop("end", 5.0) + 0.005, 0.01)
    vertices = np.repeat(HITCH.vertices[None], len(t), axis=0)
    vertices[t > 3.005, 1] += moved * unit(HITCH.vertices[1] - HITCH.drones[2])
    vertices[:, 1, 1] += swing * np.sin(1.5 * np.pi * t)  # farthest at 3 and at 5 s
    bearing = np.ones((len(t), 4))
    if lost is not None:
        vertices[:, lost], bearing[:, lost] = np.nan, 0.2
    drones = np.repeat(HITCH.drones[None], len(t), axis=0)
    for each in (vertices, drones):
        each[t > 3.005] += [0.0, drift, 0.1 * drift]
    known |= {"vertices": vertices, "bearing": bearing, "linking": linking, "rested": 3.0}
    known |= {"drones": drones}
    flight = flight_of(resting_task(HITCH, 2.0, formed=formed), HITCH, t, pulled=pulled, **known)
    return Simulation(flight, judge(flight), judgement.vertex_errors(flight))


def links(i: int, j: int, number: int) -> NDArray[np.int64]:
    """Return the linking numbers of a hitch with another number for one pair."""
    linking = NEIGHBOURS.copy()
    linking[i, j] = linking[j, i] = number
    return linking


UNTESTED = {"pulled": float("nan")}
INVALID = {"linking": None, "error": STRAIN, **UNTESTED}
PAIRS = [(f"cable {i}", f"cable {j}") for i, j in ((0, 1), (0, 3), (1, 2), (2, 3))]
TOUCH = {("q0", "cable 2"): 0.5}
STRAINED = ("invalid", ("cable 3",), 1.25)


@pytest.mark.parametrize(
    ("given", "verdict", "failures", "hitched"),
    [
        ({}, SUCCEEDED, [], True),
        ({"linking": -NEIGHBOURS}, SUCCEEDED, [], True),  # either sense
        (UNTESTED, SUCCEEDED, [], True),  # no pull test was requested
        # 14 cm off between two instants, but rest is judged over a second
        ({"moved": 0.0, "swing": 0.07}, SUCCEEDED, [], True),
        ({"moved": 0.0, "drift": 0.3}, SUCCEEDED, [], True),  # soft drones in a gust
        ({"linking": links(0, 1, 0)}, FAILED, [("unlinked", ("p1",), 3.0)], False),
        ({"linking": links(3, 0, 0)}, FAILED, [("unlinked", ("p0",), 3.0)], False),
        ({"linking": links(1, 2, 2)}, FAILED, [("unlinked", ("p2",), 3.0)], False),
        ({"linking": links(0, 2, 1)}, FAILED, [("tangled", ("cable 0", "cable 2"), 3.0)], True),
        ({"linking": links(1, 3, -1)}, FAILED, [("tangled", ("cable 1", "cable 3"), 3.0)], True),
        ({"moved": 0.13}, FAILED, [("slipped", ("p1",), 5.0)], False),
        ({"lost": 2}, FAILED, [("lost", ("p2",), 3.0)], False),
        ({"lost": 2, **UNTESTED}, FAILED, [("lost", ("p2",), 3.0)], False),
        ({"linking": UNLINKED, "formed": False}, SUCCEEDED, [], False),
        ({"formed": False}, FAILED, [("tangled", pair, 3.0) for pair in PAIRS], False),
        (INVALID, NOT_SIMULATED, [STRAINED], False),
        ({"touches": TOUCH, **INVALID}, FAILED, [("touch", *TOUCH, 0.5), STRAINED], False),
        # during the pull test
        ({"error": STRAIN, **UNTESTED}, NOT_SIMULATED, [STRAINED], False),
    ],
)
def test_flights_are_judged_by_links_contact_and_pull(
    given: dict[str, Any], verdict: str, failures: list[Any], hitched: bool
) -> None:
    outcome = flight_with(**given).outcome
    assert [(failure.kind, failure.where, failure.time) for failure in outcome.failures] == failures
    assert (outcome.verdict, outcome.hitched) == (verdict, hitched)
    assert outcome.succeeded is (verdict == SUCCEEDED)


def test_clasps_report_movement_and_force() -> None:
    slipped, lost = flight_with(moved=0.13).outcome, flight_with(lost=2).outcome
    assert [round(clasp.moved, 9) for clasp in slipped.clasps] == [0.0, 0.13, 0.0, 0.0]
    assert max(clasp.moved for clasp in flight_with(moved=0.0, drift=0.3).outcome.clasps) < 1e-9
    assert flight_with(moved=0.0, swing=0.07).outcome.clasps[1].moved < 0.04
    assert "slips 0.130 m" in slipped.failures[0].words
    assert "contact force 0.200 N, below 0.212 N" in lost.failures[0].words
    assert [clasp.holds for clasp in lost.clasps] == [True, True, False, True]
    assert all(np.isnan(clasp.moved) for clasp in flight_with(lost=2, pulled=np.nan).outcome.clasps)
    pulling = flight_with(error=STRAIN, pulled=np.nan).outcome.clasps
    assert [(clasp.bears, clasp.holds) for clasp in pulling] == [(True, False)] * 4
    assert flight_with(None, error=STRAIN, pulled=np.nan).outcome.clasps == ()


def test_errors_are_distances_while_hitched_and_at_rest() -> None:
    hitch = regular_hitch(3)
    task, late_task = (resting_task(hitch, 0.2, since=since) for since in (0, 10))
    t = np.append(np.minimum(task.states.t + 0.003, 0.2), 0.9)  # the last one is after the flight
    vertices = np.repeat(hitch.vertices[None], len(t), axis=0) + [0.0, 0.03, -0.04]
    vertices[-2, 1] = np.nan
    errors = judgement.vertex_errors(flight_of(late_task, hitch, t, vertices=vertices))
    np.testing.assert_allclose(errors.t, t[10:-1])
    np.testing.assert_allclose(errors.errors[:-1], 0.05)
    np.testing.assert_array_equal(np.isnan(errors.errors[-1]), [False, True, False])
    np.testing.assert_allclose(errors.without_sag[0], 0.03)
    np.testing.assert_allclose(errors.offsets[0, :, 2], -0.04)
    assert not errors.moving.any()
    shift = np.concatenate([np.zeros(10), np.linspace(0, 0.1, 11)])

    def variant_of(**values: Any) -> Task:
        return changed(late_task, states=replace(late_task.states, **values))

    moving = variant_of(vertices=late_task.states.vertices + shift[:, None, None])
    tension_rise = variant_of(tensions=late_task.states.tensions * (1.0 + shift[:, None]))
    for variant in (moving, tension_rise):
        errors = judgement.vertex_errors(flight_of(variant, hitch, t, vertices=vertices))
        np.testing.assert_array_equal(errors.moving, [False, *[True] * 10])
    t = np.append(task.states.t, [0.4, 0.7, 0.9])  # rest, then the pull test
    at_rest = judgement.vertex_errors(flight_of(moving, hitch, t, rested=0.7))
    np.testing.assert_allclose(at_rest.t, t[10:-1])
    np.testing.assert_array_equal(at_rest.moving, [False, *[True] * 10, False, False])
    drones = task.states.positions + [0.03, 0.0, 0.04]
    flight = flight_of(resting_task(hitch, 0.2, formed=False), hitch, task.states.t, drones=drones)
    assert judgement.vertex_errors(flight).errors.shape == (0, 3)
    np.testing.assert_allclose(judgement.tracking_errors(flight), 0.05)


def test_the_title_of_a_figure_states_the_outcome(tmp_path: Path) -> None:
    motion = ho.solve(HITCH, ho.Hold(2.0)).motion
    figure = drawn_flight(flight_with(), ho.Flight.of(motion), "Four ropes")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:2] == ["start, 0.0 s", "pull test, 5.0 s"]
    words = "Four ropes\n4 robots, 8 drones, 2 s, simulated: every vertex holds"
    assert figure.get_suptitle() == words
    save_figure(figure, tmp_path / "flight.png")
    assert imread(tmp_path / "flight.png").shape[:2] == (864, 1560)
    failure = Failure("dropped", ("tray",), 0.3, "tray is dropped: far below")
    for simulation, words in (
        (flight_with(UNLINKED), "not hitched"),
        (flight_with(None), "not simulated to its end"),
        (flight_with(UNLINKED, formed=False), "untied, as planned"),
        (flight_with(formed=False), "not untied"),
        (replace(flight_with(), outcome=Outcome((), (failure,))), f"but {failure.words}"),
    ):
        assert drawn_flight(simulation, ho.Flight.of(motion)).get_suptitle().endswith(words)
    page = drawn_flight(flight_with(), ho.Flight.of(motion), "Four ropes", 3.5)
    assert (page.get_size_inches()[0], page.get_suptitle()) == (3.5, "")
    page.draw_without_rendering()
    for text in page.findobj(Text):
        if text.get_text() and text.get_visible():
            box = text.get_window_extent()
            assert text.get_fontsize() == 8.0
            assert -1.0 <= box.x0 < box.x1 <= page.bbox.x1 + 1.0, text
    brief = flight_with(None, end=0.0)  # no frames
    assert flight_scene(brief, ho.Flight.of(motion)) is None
    assert len(drawn_flight(brief, ho.Flight.of(motion)).axes) == 3
    part = drawn_flight(flight_with(begin=1.0), ho.Flight.of(motion))  # not what was not flown
    assert part.axes[0].get_title() == "start, 1.0 s"
    assert part.axes[-1].get_xlim()[0] == pytest.approx(1.0)


def test_a_short_peak_of_the_tension_does_not_flatten_all_others() -> None:
    simulation, motion = flight_with(), ho.solve(HITCH, ho.Hold(2.0)).motion
    calm = drawn_flight(simulation, ho.Flight.of(motion)).axes[-2]
    assert not any("up to" in text.get_text() for text in calm.texts)
    record = simulation.flight.record
    record.tensions[len(record.t) // 2, 0] = 181.0
    axes = drawn_flight(simulation, ho.Flight.of(motion)).axes[-2]
    assert axes.get_ylim()[1] < 0.1 * 181.0
    assert "up to 181" in [text.get_text() for text in axes.texts]
    record.tensions[len(record.t) // 2, 0] = 2.05 * np.percentile(record.tensions, 99.0)
    shown = drawn_flight(simulation, ho.Flight.of(motion)).axes[-2]
    assert not any("up to" in text.get_text() for text in shown.texts)


def test_no_line_joins_errors_across_times_without_a_hitch() -> None:
    simulation, motion = flight_with(), ho.solve(HITCH, ho.Hold(2.0)).motion
    t = simulation.errors.t
    tied = (t < 0.5) | (t > 1.5)
    names = ("t", "rows", "planned", "offsets", "moving")
    parts = {name: getattr(simulation.errors, name)[tied] for name in names}
    retied = replace(simulation, errors=replace(simulation.errors, **parts))
    lines = drawn_flight(retied, ho.Flight.of(motion)).axes[-3].get_lines()
    errors = [
        np.asarray(line.get_xdata())
        for line in lines
        if line.get_label() in {"p0", "p1", "p2", "p3"}
    ]
    assert len(errors) == 4
    for times in errors:
        assert np.nanmax(np.diff(times)) < 0.02
        assert np.sum(np.isnan(times)) == 1


def test_setpoints_without_a_plan_are_saved_with_a_motion_to_draw(tmp_path: Path) -> None:
    with pytest.raises(ho.InputError, match="flight = None"):
        flight_with().save(tmp_path / "flight")
    assert not (tmp_path / "flight").exists()
    flight_with().save(tmp_path / "flight", flight=ho.solve(HITCH, ho.Hold(2.0)).flight)
    assert (tmp_path / "flight" / "simulation.json").is_file()


def test_what_the_plan_leaves_open_is_warned_of() -> None:
    task = resting_task(regular_hitch(3, cable_friction=0.0), 0.1)
    assert "friction is assumed to be 0" in judgement.warnings(task, Settings())[0]
    assert judgement.warnings(task, Settings(friction=0.0)) == ()
    assert judgement.warnings(resting_task(HITCH, 0.1), Settings()) == ()
    task = resting_task(regular_hitch(3, cable_density=0.0), 0.1)
    (words,) = judgement.warnings(task, Settings())
    density = 1e3 * simulated_density(task.team, Settings(), 0.5)
    assert f"fly as ropes of {density:.2g} g/m, the lightest that fast can simulate" in words
    assert judgement.warnings(task, Settings(density=0.01)) == ()
    kinds = [ho.Quadrotor(controller=name) for name in ("lee", "pid", None)]
    task = resting_task(regular_hitch(3, quadrotor=kinds), 0.1)
    (words,) = judgement.warnings(task, Settings())
    assert words.startswith("lee, none, pid: controllers are replaced by the ideal one")
    named = Settings(controller="lee"), Settings(controller="ideal"), Settings(drones="crazyflie")
    for settings in named:
        assert judgement.warnings(task, settings) == ()


def test_separation_and_tension_are_measured_before_the_pull_test() -> None:
    motion = ho.solve(HITCH, ho.Hold(2.0)).motion
    separation = ho.Separation(radius=0.1, height=0.4)
    motion = motion.replaced(requirements=replace(motion.requirements, separation=separation))
    task = changed(Task.of(ho.Flight.of(motion)), taut=None)
    t = np.arange(0.0, 5.005, 0.01)
    drones = np.repeat(HITCH.drones[None], len(t), axis=0)
    drones[120, 3] = drones[120, 0] + [0.3, -0.4, 1.0]
    drones[450, 5] = drones[450, 0] + [0.1, 0.0, 0.0]  # in the pull test
    tensions = np.repeat([[0.4, 0.5, 0.6, 0.5]], len(t), axis=0)
    tensions[t > 3.005] *= 1.5
    options = {"drones": drones, "tensions": tensions, "rested": 3.0, "pulled": 5.0}
    flight = flight_of(task, HITCH, t, linking=NEIGHBOURS, **options)
    found = judgement.closest(flight, separation.scale)
    assert found.drones == ("q0", "r1")
    assert found.time == pytest.approx(1.2)
    assert found.distance == pytest.approx(np.sqrt((0.5 / 0.2) ** 2 + (1.0 / 0.8) ** 2))
    simulation = Simulation(flight, judge(flight), judgement.vertex_errors(flight))
    content = summary(simulation)
    assert content["separation"]["distance"] == simulation.figures["separation"] == found.distance
    ratios = [each["over_planned"] for each in content["tension"]]
    np.testing.assert_allclose(ratios, [0.8, 1.0, 1.2, 1.0])  # of 0.5 N
    assert content["tension_ratio"]["largest"] == pytest.approx(1.2)


def test_invalid_losses_are_refused() -> None:
    assert Loss.parsed("2@0.5") == Loss("2", 0.5)
    messages = dict.fromkeys(("0", "0@", "@1.0", "0@soon", "0@nan"), r"write 2@12\.5")
    messages |= {"9@0.1": "cut = '9': must be one of 0, 1, 2", "0@9.0": "before the flight ends"}
    for text, words in messages.items():
        with pytest.raises(ho.InputError, match=words):
            fly(resting_task(regular_hitch(3), 0.5), Settings(lost=Loss.parsed(text)))


def test_contacts_after_a_loss_are_those_of_survivors() -> None:
    hitch, loss = regular_hitch(3), Loss("0", 0.05)
    task, t = resting_task(hitch, 0.3), np.linspace(0.0, 0.3, 31)
    touches = {("r0", "r1"): 0.01, ("q0", "cable 2"): 0.1, ("q1", "r2"): 0.1}
    touches |= {("q0", "r2"): 0.2, ("r1", "cable 0"): 0.2}
    drones = np.repeat(hitch.drones[None], len(t), axis=0)
    drones[t > 0.1, :2, 2] = 0.5  # q0 and r0 fall
    drones[t > 0.1, 3] += [0.03, 0.04, 0.0]
    peaks = np.where(t > 0.04, 2.0, 2.4)[:, None] * np.ones(3)
    parts = {"drones": drones, "peak_tensions": peaks, "touches": touches}
    parts["linking"] = np.ones((3, 3), dtype=np.int64) - np.eye(3, dtype=np.int64)
    flight = flight_of(task, hitch, t, settings=Settings(lost=loss), **parts)
    outcome = judgement.loss_outcome(flight)
    assert outcome is not None
    assert (outcome.among, outcome.others) == ((("q1", "r2"),), (("q0", "r2"), ("r1", "cable 0")))
    assert (outcome.linked, outcome.peak_tension) == (("p0", "p1", "p2"), 2.0)
    assert outcome.moved == pytest.approx(0.05)
    assert np.max(judgement.tracking_errors(flight)) == pytest.approx(0.05)
    planned = flight_of(
        Task.of(ho.solve(hitch, ho.Hold(0.3)).flight), hitch, t, settings=Settings(lost=loss)
    )
    planned = replace(planned, record=flight.record)
    assert "up to 0.05 m horizontally, 0 m vertically" in judgement.tracking_verdict(planned)
    assert np.max(judgement.vertex_errors(flight).t) <= loss.time
    assert Simulation.judged(flight).rests == ()
    assert len(Simulation.judged(flight_of(task, hitch, t, rested=0.3)).rests) == 1
    assert outcome.hangs == pytest.approx((11 * hitch.drones[0, 2] + 20 * 0.5) / 31 - 0.03)
    assert judgement.loss_outcome(flight_of(task, hitch, t)) is None
    contacts = [failure.where for failure in judge(flight).failures]
    assert contacts == [("r0", "r1"), ("q1", "r2"), ("q0", "r2")]


NOISY = Perturbations(noise=0.005, start_error=0.01)
BRIEF = Settings(perturbations=NOISY, pull_test=False, seed=40)


@pytest.mark.slow
def test_runs_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    task = resting_task(regular_hitch(3), 0.05)
    vertices = task.states.vertices.copy()
    vertices[4:, :, 0] += [[0.01], [0.02]]  # the plan moves it at the end
    task, messages = changed(task, states=replace(task.states, vertices=vertices)), list[str]()
    campaign = run_campaign(task, BRIEF, 2, workers=2, progress=messages.append)
    alone = Simulation.of(task, BRIEF)
    for name, value in alone.figures.items():
        np.testing.assert_equal(campaign.runs[0].figures[name], value)
    assert campaign.runs[0].figures["tracking_mean"] != campaign.runs[1].figures["tracking_mean"]
    assert messages[-1] == "2 of 2 flown, 2 succeeded"
    save_campaign(tmp_path, campaign)
    content = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    assert content["successes"] == content["runs"] == campaign.successes == 2
    assert content["rate_95_percent"] == list(campaign.interval)
    with (tmp_path / "runs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["seed"], row["verdict"]) for row in rows] == [(s, SUCCEEDED) for s in ("40", "41")]
    errors = alone.errors
    moves = (errors.t > 0.035) & (errors.t < 0.055)
    for name, chosen in (("moving", moves), ("resting", ~moves), ("vertex_error", moves | True)):
        expected = np.mean(errors.errors[chosen])
        assert float(rows[0][f"{name}_mean"]) == pytest.approx(expected, rel=1e-5)
    assert float(rows[0]["without_sag_mean"]) < float(rows[0]["vertex_error_mean"])


class Deadly:
    """What ends the process that receives it, as a lack of memory does."""

    def __reduce__(self) -> Any:
        return os._exit, (9,)


@pytest.mark.slow
def test_processes_that_end_are_reported_and_those_of_interrupted_campaigns_end() -> None:
    others, deadly = {*multiprocessing.active_children()}, Deadly()
    with pytest.raises(ho.InputError, match=r"^workers = 2: must be as many .* memory holds"):
        run_campaign(deadly, BRIEF, 3, workers=2)  # type: ignore[arg-type]

    def interrupt(_: str) -> None:
        raise KeyboardInterrupt

    task = resting_task(regular_hitch(3), 0.05)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(task, BRIEF, 1000, workers=2, progress=interrupt)
    assert {*multiprocessing.active_children()} <= others


def test_infeasible_starts_are_failures_of_their_run(tmp_path: Path) -> None:
    free = resting_task(regular_hitch(3), 0.05, formed=False)
    apart = replace(free.states, positions=free.states.positions * 1.6)
    campaign = run_campaign(changed(free, states=apart), BRIEF, 2, workers=1)
    assert (campaign.successes, campaign.failures) == (0, {("start", ""): 2})
    assert campaign.to_dict()["not_simulated"] == campaign.not_simulated == 2
    save_campaign(tmp_path, campaign)
    assert (tmp_path / "runs.csv").read_text(encoding="utf-8").count("its drones start") == 2
    with pytest.raises(ho.InputError, match="density"):  # invalid for every run
        run_campaign(free, replace(BRIEF, density=1e-6), 2, workers=1)
    for runs, workers, name in ((0, None, "runs"), (1, 0, "workers")):
        with pytest.raises(ho.InputError, match=f"^{name} = 0"):
            run_campaign(free, BRIEF, runs, workers)


def placed_with(tracking: float | ho.Tube | None, off: list[float], *, held: bool) -> Outcome:
    """Judge a flight whose box stands or hangs beside its plan, in which drones may be off."""
    simulation, count = flight_with(), 501
    task, (x, y) = simulation.flight.task, np.mean(HITCH.vertices[:, :2], axis=0)
    box = SolidObject(Section(radius=0.1), 0.0, 0.3, 0.1, at=[x, y, 1.0])
    samples = len(task.states.t)
    planned = np.tile([x, y, 1.0, 1.0, 0.0], (samples, 1, 1))
    share, is_held = np.full((samples, 1), float(held)), np.full((samples, 1), held)
    cargo = Cargo({"box": box}, planned, is_held, share)
    motion = ho.solve(HITCH, ho.Hold(1.0)).motion
    limits = replace(motion.requirements.limits, tracking=tracking)
    motion = replace(motion, requirements=replace(motion.requirements, limits=limits))
    poses = np.tile([x, y, 1.0, 1.0, 0.0, 0.0, 0.0], (count, 1, 1))
    poses[:, 0, :3] += off
    record = replace(
        simulation.flight.record, poses=poses, touched=np.full((count, 1), held, dtype=np.bool_)
    )
    task = changed(replace(task, flight=ho.Flight.of(motion)), cargo=cargo)
    return judge(replace(simulation.flight, task=task, record=record))


@pytest.mark.parametrize(
    ("tracking", "off", "held", "kinds"),
    [
        (None, [0.029, 0.0, 0.0], False, []),
        (None, [0.031, 0.0, 0.0], False, ["misplaced"]),
        (None, [0.0, 0.0, -0.06], True, ["dropped", "misplaced"]),
        (0.05, [0.06, 0.05, 0.0], False, []),
        (0.05, [0.06, 0.06, 0.0], False, ["misplaced"]),
        (ho.Tube(0.08, 0.2), [0.0, 0.109, 0.0], False, []),
        (ho.Tube(0.08, 0.2), [0.0, 0.111, 0.0], False, ["misplaced"]),
        # What stands is at its height, whatever errors drones have upright
        (ho.Tube(0.08, 0.2), [0.0, 0.0, 0.031], False, ["misplaced"]),
        (ho.Tube(0.08, 0.2), [0.0, 0.1, 0.03], False, ["misplaced"]),
        (ho.Tube(0.08, 0.2), [0.1, 0.0, -0.22], True, []),
        (ho.Tube(0.08, 0.2), [0.0, 0.0, -0.24], True, ["misplaced"]),
        (ho.Tube(0.08, 0.2), [0.0, 0.0, -0.26], True, ["dropped", "misplaced"]),
    ],
)
def test_objects_are_placed_up_to_the_tracking_errors_of_the_plan(
    tracking: float | ho.Tube | None, off: list[float], held: bool, kinds: list[str]
) -> None:
    outcome = placed_with(tracking, off, held=held)
    assert sorted(failure.kind for failure in outcome.failures) == kinds
    (box,) = outcome.objects
    assert box.placed == pytest.approx(float(np.linalg.norm(off)))
    assert box.well_placed is ("misplaced" not in kinds)
    for failure in outcome.failures:
        assert ("tracking errors" in failure.words) is (tracking is not None)


def test_clasps_of_bent_edges_need_a_share_of_what_a_cable_bends_with() -> None:
    motion = carried_plans.plan("drum").motion
    task = Task.of(ho.Flight.of(motion))
    held = task.cargo.held[:, 0] & np.all(task.states.tensions > 0.2, axis=1)
    t, starts = task.states.t[held], motion.team.layout.starts
    vertices = task.states.vertices[held][:, starts]
    legs, edges = task.states.positions[held][:, 0::2], motion.contacts.at(t)[:, :, 0]
    bends = np.linalg.norm(unit(legs - vertices) + unit(edges - vertices), axis=-1)
    expected = MIN_BEARING_RATIO * task.states.tensions[held] * bends
    assert np.any(held)
    np.testing.assert_allclose(least_bearing(task)[held], expected, rtol=0.12)
