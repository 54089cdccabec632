"""Aborts end at rest as commanded; survivors of a lost drone release tension and descend."""

from __future__ import annotations

import json
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.cli.planning import PACKAGE
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.requirements import Requirements
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.live.abort import Aborts, abort_table, until_stop
from hitchopt.live.lost import DELAY, RELEASE_TIME, Reactions, free_fall, survivable
from hitchopt.motion.motion import CableState, Phase
from hitchopt.motion.plan_file import read_plan
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import MIN_SPACING
from tests.helpers.plans import planned


@cache
def aborts_of(name: str) -> Aborts:
    """Aborts of a problem's plan, of a release, or of legs that are rolled, or lean."""
    if name == "untied":
        start = ho.Hitch.spread(ho.Team(3, 2.4), [[0, -0.9], [-0.72, 0.45], [0.72, 0.45]])
        return Aborts(ho.solve(start, ho.Release()).flight)
    if name == "rolled":  # what cables weigh on a clasp depends on its roll
        team, roll = (
            ho.Team(5, 2.2, tension=0.8, cable_density=0.01, load=0.01),
            [10, 35, 0, -15, 20],
        )
        corners = ho.regular_polygon(5, 1.0)
        start = ho.Hitch(team, corners, 1.5, np.full(5, 0.6), np.radians(roll))
        return Aborts(ho.solve(start, ho.Transport(to=[0.5, 0.0, 1.5])).flight)
    if name == "leaning":
        team = ho.Team(4, 2.2, cable_friction=0.1)
        start = ho.Hitch.balanced(team, ho.regular_polygon(4, 1.0), 1.5)
        slow = ho.Limits(speed=0.06)
        return Aborts(
            ho.solve(start, ho.MoveVertex(0, by=[0.1, 0.1], settle=False), limits=slow).flight
        )
    return Aborts(planned(name).flight)


@pytest.mark.parametrize(
    ("name", "share", "how"),
    [
        *(("triangle", 0.31, how) for how in ("hold", "land", "release_and_land")),
        ("form_triangle", 0.97, "back"),
        ("form_triangle", CableState.CLASPING, "hold"),
        ("form_triangle", CableState.TIGHTENING, "hold"),
        ("swarms/head_on", 0.4, "land"),
        ("untied", 0.9, "land"),  # back to the hitch, from where it lands sooner
        ("rolled", 0.1, "land"),
        ("leaning", 0.2, "land"),
        ("leaning", 0.2, "release_and_land"),
    ],
)
def test_commands_end_in_rest_as_they_say(name: str, share: float | CableState, how: str) -> None:
    plan = aborts_of(name).flight
    if isinstance(share, CableState):
        phase = next(p for p in plan.phases if p.state is share)
        share = (phase.start + 0.3 * (phase.end - phase.start)) / plan.duration
    found = aborts_of(name).plan(share * plan.duration, how)
    whole = found.flight
    assert found.certificate.certified
    assert found.start >= share * plan.duration
    until = np.linspace(0.0, min(found.start, plan.duration), 9)
    np.testing.assert_allclose(whole.drones.at(until), plan.drones.at(until), atol=1e-12)
    np.testing.assert_allclose(whole.drones.at(until, 2), plan.drones.at(until, 2), atol=1e-7)
    stopped = whole.drones.at(min(found.start + found.seconds, whole.duration))
    np.testing.assert_allclose(stopped, plan.drones.at(found.rest), atol=1e-9)
    assert np.max(np.abs(whole.drones.at(whole.duration, 1))) <= 1e-9
    end, last, free = whole.drones.at(whole.duration), whole.phases[-1], CableState.FREE
    if how in ("hold", "back"):
        at = [found.rest] if how == "hold" else [p.end for p in plan.phases if p.state is free]
        np.testing.assert_allclose(end, plan.drones.at(at[-1]), atol=1e-9)
        assert how == "hold" or last.state is free
    else:
        assert np.min(end[:, 2]) == pytest.approx(0.0, abs=1e-9)
        assert last.formed == (how == "land" and name != "swarms/head_on")
    if name == "leaning":  # they stand straight where the plan rests
        assert (found.start, found.seconds) == (plan.duration, 0.0)


@pytest.mark.parametrize("name", ["triangle", "form_triangle", "leaning", "two_teams"])
def test_stops_right_after_breaks_leave_no_short_pieces(name: str) -> None:
    flight = aborts_of(name).flight
    rng = np.random.default_rng(5)
    offs = [1e-8, 1e-6, 9.5e-5, 1e-3, 3.5e-3]
    own = [np.min(flown.motion.drones.durations) for flown in flight.teams]
    for time in rng.choice(flight.breaks[:-1], 6) + rng.choice(offs, 6):
        stop = until_stop(flight, float(time))
        assert stop.start >= time - 1e-7
        for flown, shortest in zip(stop.flight.teams, own, strict=True):
            assert np.min(flown.motion.drones.durations) >= 0.9 * min(MIN_SPACING, shortest)


def test_no_rest_while_tensions_rise() -> None:
    motion = planned("form_triangle").motion
    (rise,) = (phase for phase in motion.phases if phase.name == "tension")
    assert np.ptp(motion.tensions.at(np.array([rise.start, rise.end]))) > 0.1
    found = aborts_of("form_triangle").plan(rise.start + 0.3, "hold")
    assert (found.rest, found.seconds) == (rise.end, 0.0)


def test_impossible_aborts_are_refused() -> None:
    """Drones that start and end above each other cannot land."""
    stacks = np.array([[[0, 0, 1], [0, 0, 2.2]], [[1, 0.2, 1], [1, 0.2, 2.2]]])
    motion = ho.separate(ho.Problem(ho.Swarm(2), stacks[0], [ho.Fly(stacks[1])])).motion
    table = abort_table(ho.Flight.of(motion), "land", 0.5)
    assert (table.entries, table.missing) == ((), ((0.0, motion.duration),))
    with pytest.raises(ho.InfeasibleError, match="separation"):
        Aborts(ho.Flight.of(motion)).plan(1.0, "land")
    with pytest.raises(ho.InfeasibleError, match="were never free before"):
        aborts_of("triangle").plan(1.0, "back")
    for time, how, key in ((-1.0, "hold", "t"), (1e3, "hold", "t"), (0.1, "stay", "how")):
        with pytest.raises(ho.InputError, match=f"^{key} "):
            aborts_of("triangle").plan(time, how)


def test_the_command_writes_a_table_that_can_be_recomputed(tmp_path: Path) -> None:
    plan = planned("triangle")
    plan.save(tmp_path, rate=10.0)
    done = CliRunner().invoke(main, ["abort", str(tmp_path), "--how", "hold", "--every", "1"])
    assert done.exit_code == 0, done.output
    (table,) = json.loads((tmp_path / "aborts.json").read_text())["tables"]
    assert (table["how"], table["missing"]) == ("hold", [])
    starts, seconds = np.array([[e["start"], e["seconds"]] for e in table["entries"]]).T
    assert np.all(np.diff(starts) > 0.0)
    assert starts[-1] == pytest.approx(plan.duration)
    waits = starts + seconds - [0.0, *starts[:-1]]
    assert table["longest"] == pytest.approx(np.max(waits))
    with zipfile.ZipFile(tmp_path / "aborts.zip") as archive:
        assert archive.namelist() == [entry["plan"] for entry in table["entries"]]
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        archive.extractall(tmp_path / "plans")
    for entry in table["entries"]:
        motion = read_plan(tmp_path / "plans" / entry["plan"])
        assert certify(motion, reports=()).certified
        assert motion.duration == pytest.approx(entry["ends"])


TIME = 0.8
SQUARE = ho.regular_polygon(4, 1.0)


@cache
def plan_of(altitude: float) -> ho.Plan:
    start = ho.Hitch.spread(ho.Team(4, 2.2, tension=0.5), SQUARE, altitude)
    return ho.solve(start, ho.Transport(to=[0.7, 0.3, altitude]))


@pytest.mark.parametrize("altitude", [1.0, 2.4])
def test_survivors_descend_as_a_rigid_team(altitude: float) -> None:
    plan, found = plan_of(altitude), Reactions(plan_of(altitude).motion).plan("q1", TIME)
    motion, limits = found.motion, plan.motion.requirements.limits
    t = np.linspace(0.0, motion.duration, 2001)
    places, before = motion.drones.at(t), t <= TIME + DELAY
    assert found.start == pytest.approx(TIME + DELAY)
    np.testing.assert_allclose(places[before], plan.at(t[before]).positions, atol=1e-9)
    every = np.concatenate([places, motion.vertices.at(t)], axis=1)
    shape = every - every[:, :1]
    np.testing.assert_allclose(shape, np.broadcast_to(shape[0], shape.shape), atol=1e-6)
    for order, limit in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
        assert np.max(np.linalg.norm(motion.drones.at(t, order), axis=-1)) <= limit + 1e-6
    assert np.min(places[-1, :, 2]) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(motion.drones.at(t[-1], 1))) <= 1e-9


@cache
def heavy() -> ho.Plan:
    """Return a plan whose drones are above their clasps, which are above the middle of edges."""
    team = ho.Team(3, 2.65, tension=0.4, cable_density=0.01)
    start = ho.Hitch.spread(team, [[0, 0.64], [0.55, -0.32], [-0.55, -0.32]], 1.6)
    return ho.solve(start, ho.Transport(to=[0.3, 0.2, 1.6]))


def test_no_cable_sinks_below_the_ground() -> None:
    """Drones are 10 cm above their clasps: the lowest point is in the middle of an edge."""
    motion = Reactions(heavy().motion).plan("q1", TIME).motion
    down = next(phase.start for phase in motion.phases if phase.name == "land")
    vertices, drones = motion.vertices.at(down), motion.drones.at(down)
    edges = vertices - np.roll(vertices, -1, axis=0)
    sag = 0.01 * GRAVITY * np.sum(edges**2, axis=1) / (8.0 * 0.4)
    lowest = 0.5 * (vertices + np.roll(vertices, -1, axis=0))[:, 2] - sag
    assert np.min(drones[:, 2]) > 0.1
    assert np.min(lowest) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(motion.drones.at(motion.duration)[:, 2], 0.0, atol=1e-9)


def test_a_hitch_whose_cables_reach_the_ground_first_does_not_land_tied() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"its cables would be 0\.21 m below"):
        Aborts(heavy().flight).plan(TIME, "land")


@pytest.mark.slow
def test_most_losses_of_the_first_plan_of_users_are_survivable() -> None:
    plan = ho.solve(PACKAGE / "mission" / "template.yaml")
    assert survivable(plan.motion)[0].worst >= 0.9


@pytest.mark.parametrize("lost", [0, 3, 5, 6])
def test_survivors_keep_clear_of_the_swing_of_the_lost_drone(lost: int) -> None:
    """Turned about its clasp in its vertical plane, its cable longer by what its partner gives."""
    team = ho.Team(4, 2.3, tension=0.5)
    polygon = ho.regular_polygon(4, 0.9).vertices + [1.0, 2.0]
    hitch = ho.Hitch.balanced(team, polygon, 1.6, np.radians([20.0, -15.0, 10.0, -25.0]))
    hitch = ho.Hitch(team, polygon, 1.6, hitch.slack * [0.4, 0.47, 0.53, 0.6], hitch.roll)
    plan = ho.solve(hitch, ho.Hold(2.0))
    clasps = hitch.vertices[team.layout.pulled_to]
    leg, partner = (hitch.drones - clasps)[[lost, lost ^ 1]]
    size = float(np.linalg.norm(partner))
    level = np.hypot(*leg[:2])
    down = np.array([*leg[:2] * leg[2] / level, -level])  # across the leg
    turns = np.linspace(0.0, np.radians(155.0) + 2.0 * np.arctan2(leg[2], level), 300)[:, None]
    longer = 1.0 + np.linspace(0.0, size - 0.05, 60)[:, None, None] / np.linalg.norm(leg)
    swing = clasps[lost] + longer * (np.cos(turns) * leg + np.sin(turns) * down)
    others = np.delete(hitch.drones, lost, axis=0)[:, None]
    swing = np.maximum(swing.reshape(-1, 3), [-9.0, -9.0, 0.0])
    apart = np.min(np.linalg.norm(others - swing, axis=-1)) / 0.24
    drawn = hitch.drones.copy()
    drawn[lost ^ 1] -= min(0.36, size - 0.05) / size * partner
    drawn = np.delete(drawn, lost, axis=0) / [0.24, 0.24, 0.6]
    between = np.min(np.linalg.norm(drawn[:, None] - drawn, axis=-1) + 9.0 * np.eye(7))
    found = Reactions(plan.motion).plan(team.drone_names[lost], 1.0)
    assert found.nearest == pytest.approx(min(apart, between), abs=0.02)


def test_a_fall_keeps_its_energy_and_ends_on_the_ground() -> None:
    position, velocity = np.array([0.3, -0.2, 1.7]), np.array([0.4, 0.1, 0.6])
    t, places = free_fall(position, velocity, 0.2)
    assert places[-1, 2] == pytest.approx(0.2)
    np.testing.assert_allclose(places[-1, :2], position[:2] + t[-1] * velocity[:2])
    speeds = velocity - t[:, None] * [0.0, 0.0, GRAVITY]
    energy = 0.5 * np.sum(speeds**2, axis=-1) + GRAVITY * places[:, 2]
    np.testing.assert_allclose(energy, energy[0])


@pytest.mark.slow
def test_a_reaction_follows_the_plan_and_then_releases_tension() -> None:
    plan, found = plan_of(2.4), Reactions(plan_of(2.4).motion).plan("r2", TIME)
    task = TeamTask.of(plan.motion)
    flown = task.released(found.motion, found.start, RELEASE_TIME)
    assert 0.0 < np.min(np.diff(flown.states.t)) <= np.max(np.diff(flown.states.t)) <= 0.011
    assert flown.duration == pytest.approx(found.motion.duration)
    early, places = flown.states.t < found.start, flown.states.positions
    before = task.states.positions[: np.sum(early)]
    np.testing.assert_allclose(places[early], before, atol=1e-8)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert np.max(steps / np.diff(flown.states.t)[:, None]) <= 1.0 + 1e-3
    forces = np.linalg.norm(flown.states.cable_forces, axis=-1)
    np.testing.assert_allclose(forces[early], 0.5, atol=1e-3)
    letting_go = (flown.states.t > found.start) & (flown.states.t < found.start + RELEASE_TIME)
    assert np.all(np.diff(forces[letting_go], axis=0) < 0.0)
    times = found.start + np.array([0.1, 0.5, 0.9]) * RELEASE_TIME
    there = np.interp(times, flown.states.t, forces[:, 0])
    np.testing.assert_allclose(there + there[::-1], 0.5, atol=5e-3)  # as fast at first as at last
    assert np.max(forces[flown.states.t >= found.start + RELEASE_TIME]) == 0.0


def test_a_lost_drone_too_heavy_for_its_partner_has_no_reaction() -> None:
    team = ho.Team(4, 2.2, tension=0.5, quadrotor=ho.Quadrotor(max_thrust=1.7))
    start = ho.Hitch.spread(team, SQUARE, 2.4)
    with pytest.raises(ho.InfeasibleError, match="q1 on its cable takes 108% of a drone's thrust"):
        Reactions(ho.solve(start, ho.Hold(2.0)).motion).plan("q1", 1.0)
    for drone, time, words in (
        ("d7", 0.5, "lose = 'd7': must be one of q0, r0"),
        ("q0", 1e3, "choose a time within the plan"),
    ):
        with pytest.raises(ho.InputError, match=words):
            Reactions(plan_of(1.0).motion).plan(drone, time)


@pytest.mark.parametrize("share", [0.49, 0.6533])
def test_survivors_may_wait_until_they_can_stop(share: float) -> None:
    """Just then polynomials do not follow the soonest stop closely enough, later they do."""
    motion = planned("form_triangle").motion
    assert Reactions(motion).plan("q0", share * motion.duration).nearest >= 1.0


@pytest.mark.slow
def test_the_command_line_reports_losses(tmp_path: Path) -> None:
    shown = CliRunner().invoke(main, ["check", str(plan_of(1.0).save(tmp_path)), "--survivable"])
    (row,) = [line for line in shown.output.splitlines() if "survivable" in line]
    assert (shown.exit_code, row.split()[1]) == (0, "1")


@pytest.mark.parametrize(("altitude", "share"), [(1.6, 1.0), (2.2, 0.0)])
def test_no_drone_carries_two(altitude: float, share: float) -> None:
    """A cable of 2 m between drones 1 m apart is taut after a fall of the square root of 3 m."""
    places = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 2, 0]]) + [0, 0, altitude]
    team = ho.Team(robots=2, topology="open", cable_length=2.0)
    phase = Phase("hover", 0, 0.0, 2.0, state=CableState.FREE)
    hovering = PiecewisePolynomial.constant([0.0, 2.0], places, 7)
    found, without = survivable(ho.Motion.single(team, Requirements(), hovering, [phase]))
    assert (found.worst, found.where) == (share, tuple(each.drone for each in without))
    told = [(each.drone, each.start, each.end) for each in without]
    assert told == ([] if share else [(name, 0.0, 2.0) for name in team.drone_names])
    assert all(f"{each.drone} hangs from its partner 0.19" in each.reason for each in without)


def test_single_drones_land_clear_of_the_lost_one() -> None:
    motion = planned("swarms/head_on").motion
    found, _ = survivable(motion, every=0.5 * motion.duration)
    assert (found.worst, found.method) == (1.0, "sampled")
    last = Reactions(motion).plan("d0", 1.0).motion.drones
    assert np.max(last.at(last.breaks[-1])[:, 2]) <= 2e-3
