"""Reactions to the loss of a drone: what survivors fly, where the lost one falls, what is said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main, simulate_command
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import GRAVITY
from hitchopt.losing import pushing, sinking
from hitchopt.losing.falling import GAIN, Rest, free_fall, resting_place
from hitchopt.losing.flown_reaction import LETTING_GO, reacting
from hitchopt.losing.reaction import DELAY, SWUNG, Reactions
from hitchopt.losing.sinking import CARRIED, SLOPES, stopped
from hitchopt.losing.survivable import survivable
from hitchopt.losing.swinging import swings, swung
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.phases import CableState
from hitchopt.motion.states import states_at
from hitchopt.requirements import Requirements
from hitchopt.simulation.flight_task import read_task
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.stopping.abort import Aborts
from hitchopt.trajectory import PiecewisePolynomial

PROBLEMS = Path(__file__).parents[2] / "problems"
TIME = 0.8


@cache
def plan_of(altitude: float) -> ho.Plan:
    team = ho.Team(robots=4, cable_length=2.2, tension=0.5)
    start = ho.Hitch.spread(team, regular_polygon(4, 1.0).vertices, altitude=altitude)
    return ho.transport(start, to=[0.7, 0.3, altitude])


@cache
def reactions_of(altitude: float) -> Reactions:
    return Reactions(plan_of(altitude).motion)


@pytest.mark.parametrize("altitude", [1.0, 2.4])
def test_survivors_sink_as_a_whole_and_keep_all_limits(altitude: float) -> None:
    plan = plan_of(altitude)
    found = reactions_of(altitude).found("q1", TIME)
    course, limits = found.course, plan.motion.requirements.limits
    flown = course.sinking.drones
    t = np.linspace(0.0, course.sinking.duration, 2001)
    places = flown.at(t)
    before = t <= course.begins
    np.testing.assert_allclose(places[before], plan.at(t[before]).positions, atol=1e-9)
    shape = places - places[:, :1]
    np.testing.assert_allclose(shape, np.broadcast_to(shape[0], shape.shape), atol=1e-6)
    for order, limit in ((1, limits.speed), (2, limits.acceleration), (3, limits.jerk)):
        assert np.max(np.linalg.norm(flown.at(t, order), axis=-1)) <= limit + 1e-6
    assert np.min(places[-1, :, 2]) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(flown.at(t[-1], 1))) <= 1e-9
    assert course.begins == pytest.approx(TIME + DELAY)
    assert all(check.holds for check in course.checks)


def test_survivors_sink_while_the_plan_still_stops() -> None:
    """A plan that accelerates as fast as it may leaves nothing to sink with until it stops."""
    reactions, time = reactions_of(2.4), 0.2
    course = reactions.course(time)
    still = stopped(reactions.motion, Aborts(reactions.motion).stops, course.begins)
    heights = course.sinking.drones.at([time, time + SWUNG])[:, 0, 2]
    assert still.motion.duration > time + SWUNG
    assert heights[0] - heights[1] > 0.1


def test_a_team_that_brakes_is_carried_on_while_it_sinks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight down nothing is left to sink with before the plan has come to rest."""
    motion = plan_of(2.4).motion
    time = motion.duration - 0.5
    sunk_by = []
    for slopes in ((0.0,), SLOPES):
        monkeypatch.setattr(sinking, "SLOPES", slopes)
        flown = Reactions(motion).course(time).sinking.drones
        heights = flown.at([time, time + SWUNG])[:, 0, 2]
        sunk_by.append(heights[0] - heights[1])
    assert sunk_by[0] < 0.05
    assert sunk_by[1] > 0.15
    carried = (flown.at(flown.duration) - motion.drones.at(motion.duration))[0, :2]
    assert np.linalg.norm(carried) == pytest.approx(CARRIED)
    speed = motion.drones.at(time, 1)[0, :2]
    assert carried @ speed == pytest.approx(CARRIED * np.linalg.norm(speed))


def test_a_lost_drone_is_held_where_it_hangs_still() -> None:
    low, high = (reactions_of(altitude).found("q1", TIME) for altitude in (1.0, 2.4))
    assert low.held is None
    assert high.held is not None
    assert high.course.begins < high.held.begins < high.held.ends <= high.course.duration


def balance(motion: Motion, time: float, lost: int) -> tuple[Rest, np.ndarray]:
    """The rest, and the sum of forces on all drones and cables, from the positions alone."""
    states, team = states_at(motion, time), motion.team
    rest = resting_place(motion, states, lost)
    assert rest is not None
    assert not rest.lies
    held = np.arange(team.drones) != lost
    away = (rest.positions - states.positions)[held]
    stiffness = rest.stiffer * GAIN * team.mass[held, None]
    pulls = states.cable_forces[held] + stiffness * away
    np.testing.assert_allclose(rest.pulls[held], pulls)
    pull = np.sum(team.mass[held, None] * [0, 0, GRAVITY] - pulls, axis=0)
    return rest, pull - [0, 0, GRAVITY * np.sum(team.mass)]


@pytest.mark.parametrize("lost", range(8))
def test_a_team_at_rest_carries_all_of_its_weight(lost: int) -> None:
    """Cables are weightless here, so the survivors' thrusts sum to the team's weight."""
    motion = plan_of(2.4).motion
    rest, left = balance(motion, TIME, lost)
    assert np.max(np.abs(left)) < 5e-3
    clasp = rest.vertices[motion.team.layout.pulled_to[lost]]
    leg = rest.positions[lost] - clasp
    assert leg[2] < 0.0
    assert np.hypot(*leg[:2]) < 1e-2  # a weight hangs straight down from its clasp
    assert rest.thrust <= 1.0


def test_lost_drones_of_a_regular_hitch_hang_alike() -> None:
    motion = plan_of(2.4).motion
    depths = [balance(motion, 0.0, lost)[0].positions[lost, 2] for lost in range(8)]
    np.testing.assert_allclose(depths, depths[0], atol=2e-3)


def test_a_fall_keeps_its_energy_and_ends_on_the_ground() -> None:
    position, velocity = np.array([0.3, -0.2, 1.7]), np.array([0.4, 0.1, 0.6])
    t, places = free_fall(position, velocity, 0.2)
    assert places[-1, 2] == pytest.approx(0.2)
    np.testing.assert_allclose(places[-1, :2], position[:2] + t[-1] * velocity[:2])
    speeds = velocity - t[:, None] * [0.0, 0.0, GRAVITY]
    energy = 0.5 * np.sum(speeds**2, axis=-1) + GRAVITY * places[:, 2]
    np.testing.assert_allclose(energy, energy[0])


def test_a_swing_on_a_cable_that_cannot_run_keeps_its_arc_and_its_energy() -> None:
    reach, angle = swung((0.4, 0.2), 0.5, (0.1, 1e6), 0.5, 0.2)
    assert np.max(np.abs(reach - 0.4)) < 1e-4
    np.testing.assert_allclose(angle[-1], np.pi - 0.2, atol=0.02)  # as high as it began


def test_friction_lets_less_cable_run() -> None:
    """At equal pulls: the more friction, the shorter the reach, and the farther it swings."""
    reach, angle = (
        each[-1].reshape(2, -1) for each in swung((0.3, 0.0), 0.9, (0.1, 0.1), 0.5, 0.2)
    )
    assert np.all(np.diff(reach, axis=1) < 0.0)
    assert np.all(np.diff(angle, axis=1) > 0.0)
    assert np.all(reach[1] < reach[0])  # and so does a partner that pulls
    assert np.max(reach) <= 1.2
    short = swung((0.3, 0.0), 0.1, (0.1, 0.1), 0.5, 0.2)[0]
    assert np.max(short) == pytest.approx(0.4)


@pytest.mark.parametrize("lost", [2, 5])
def test_swings_begin_where_the_drone_is_lost_and_stay_in_their_plane(lost: int) -> None:
    motion = plan_of(2.4).motion
    states = states_at(motion, TIME)
    places = swings(motion.team, states, lost, 0.9, 0.0)
    start, clasp = states.positions[lost], states.vertices[motion.team.layout.pulled_to[lost]]
    assert np.min(np.linalg.norm(places - start, axis=-1)) < 1e-12
    radii = np.linalg.norm(places - clasp, axis=-1)
    assert np.min(radii) >= np.linalg.norm(start - clasp) - 1e-12
    across = np.cross(start - clasp, [0.0, 0.0, 1.0])
    assert np.max(np.abs((places - clasp) @ across)) < 1e-12
    high = swings(motion.team, states, lost, 0.9, 2.0)
    assert np.min(high[:, 2]) == 2.0


@pytest.mark.slow
def test_the_command_line_tells_losses(tmp_path: Path) -> None:
    plan_of(1.0).save(tmp_path)
    shown = CliRunner().invoke(main, ["check", str(tmp_path), "--survivable"])
    assert shown.exit_code == 0
    (row,) = [line for line in shown.output.splitlines() if "survivable" in line]
    assert row.split()[1] == "1"
    for given in ("q9@0.5", "q0@99", "q0"):
        refused = CliRunner().invoke(main, ["simulate", str(tmp_path), "--lose", given])
        assert refused.exit_code == 2
    together = ["simulate", str(tmp_path), "--lose", "q0@0.5", "--runs", "2"]
    assert CliRunner().invoke(main, together).exit_code == 2


def hovering(altitude: float) -> Motion:
    """Two cables that hang free, at rest."""
    places = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 2, 0]]) + [0, 0, altitude]
    drones = PiecewisePolynomial.constant([0.0, 2.0], places, 7)
    team = ho.Team(robots=2, topology="open", cable_length=2.0)
    phase = Phase("hover", 0, 0.0, 2.0, state=CableState.FREE)
    return Motion.single(team, Requirements(), drones, [phase])


def test_no_drone_carries_two() -> None:
    """A cable of 2 m between drones 1 m apart is taut after a fall of the square root of 3 m."""
    low = survivable(hovering(1.6))
    assert low.share == 1.0
    assert low.without == ()
    high = survivable(hovering(2.2))
    assert high.share == 0.0
    assert high.check.where == ("q0", "r0", "q1", "r1")
    assert (high.without[0].start, high.without[0].end) == (0.0, 2.0)
    with pytest.raises(ho.InfeasibleError, match=r"q0 hangs on its partner 0\.4"):
        Reactions(hovering(2.2)).found("q0", 1.0)


def test_single_drones_end_on_the_ground_beside_the_lost_one() -> None:
    motion = ho.solve(PROBLEMS / "swarms/head_on.yaml").motion
    found = survivable(motion)
    assert found.share == 1.0
    assert found.check.method == "sampled"
    course = Reactions(motion).found("d0", 1.0).course
    last = (course.landing or (course.sinking,))[-1].drones
    assert np.max(last.at(last.breaks[-1])[:, 2]) <= 2e-3


def test_a_wrong_drone_and_a_wrong_time_are_named() -> None:
    with pytest.raises(ho.InputError, match="one of q0, r0"):
        reactions_of(1.0).found("d7", 0.5)
    with pytest.raises(ho.InputError, match="ask within the plan"):
        reactions_of(1.0).found("q0", 1e3)


@cache
def short_legs(altitude: float) -> ho.Plan:
    team = ho.Team(robots=4, cable_length=2.2, tension=0.5)
    start = ho.Hitch(team, regular_polygon(4, 1.0), altitude, [0.92] * 4)  # legs of 0.28 m at r
    return ho.transport(start, to=[0.7, 0.3, altitude])


@pytest.mark.parametrize(
    ("drone", "altitude", "waits"), [("q1", 2.4, DELAY), ("r1", 1.5, 1.0), ("r1", 2.4, DELAY)]
)
def test_survivors_pull_at_once_where_a_leg_is_short(
    drone: str, altitude: float, waits: float, tmp_path: Path
) -> None:
    """A lost drone may fall if it reaches the ground before its cable has run."""
    plan = short_legs(altitude)
    found = Reactions(plan.motion).found(drone, TIME)
    held = found.held
    assert held is not None
    assert held.begins == pytest.approx(TIME + waits)
    assert (found.inward is None) == (waits == DELAY)  # who pulls at once does not push
    flown = reacting(read_task(plan.save(tmp_path)), found)
    pulling = (flown.t > held.full) & (flown.t < held.ends)
    assert np.any(pulling) == (held.full < held.ends)
    forces = flown.setpoints.cable_forces[pulling]
    if found.inward is not None:
        forces = forces + found.inward.pushes(flown.t[pulling])
    np.testing.assert_allclose(forces - held.pulls, np.zeros_like(forces), atol=1e-9)


def test_a_flown_reaction_is_the_plan_and_then_the_reaction(tmp_path: Path) -> None:
    plan, found = plan_of(2.4), reactions_of(2.4).found("r2", TIME)
    task = read_task(plan.save(tmp_path))
    flown = reacting(task, found)
    assert np.all(np.diff(flown.t) > 0.0)
    assert np.max(np.diff(flown.t)) <= 0.011
    assert flown.duration == pytest.approx(found.course.duration)
    early = flown.t < found.course.begins
    np.testing.assert_array_equal(
        flown.setpoints.positions[early], task.setpoints.positions[: np.sum(early)]
    )
    steps = np.linalg.norm(np.diff(flown.setpoints.positions, axis=0), axis=-1)
    assert np.max(steps / np.diff(flown.t)[:, None]) <= 1.0 + 1e-3
    forces = np.linalg.norm(flown.setpoints.cable_forces, axis=-1)
    np.testing.assert_allclose(forces[early], 0.5, atol=1e-3)
    held = found.held
    assert held is not None
    assert held.begins == TIME + 1.0
    letting_go = (flown.t > found.course.begins) & (flown.t < found.course.begins + LETTING_GO)
    assert np.all(np.diff(forces[letting_go], axis=0) < 0.0)
    smoothly = flown.t < found.course.time + 0.55
    assert np.max(np.abs(np.diff(forces[smoothly], axis=0))) < 0.03
    inward = found.inward
    assert inward is not None
    between = (flown.t >= found.course.begins + LETTING_GO) & (flown.t < inward.begins)
    assert np.any(between)
    assert np.max(forces[between]) == 0.0
    assert np.max(forces[flown.t > max(held.ends + 0.11, inward.ends)]) == 0.0
    fully = (flown.t > inward.full) & (flown.t < held.begins)
    pushes = np.broadcast_to(inward.forces, (int(np.sum(fully)), 8, 3))
    np.testing.assert_allclose(-flown.setpoints.cable_forces[fully], pushes, atol=1e-9)
    rising = (flown.t > held.begins) & (flown.t < min(held.full, held.ends, inward.fades))
    share = (flown.t[rising] - held.begins) / (held.full - held.begins)
    expected = share[:, None, None] * held.pulls - inward.forces
    np.testing.assert_allclose(flown.setpoints.cable_forces[rising], expected, atol=1e-9)


@pytest.mark.parametrize("across", [False, True])
def test_who_comes_closer_keeps_its_height(across: bool) -> None:
    motion = plan_of(2.4).motion
    states = states_at(motion, TIME)
    by = pushing.closer(motion.team, states, 3, across=across)
    tilted = states.positions + np.linspace(-0.3, 0.3, 8)[:, None] * [0.0, 0.0, 1.0]
    moved = pushing.closer(motion.team, replace(states, positions=tilted), 3, across=across)
    np.testing.assert_allclose(moved, by, atol=1e-15)
    assert not np.any(moved[:, 2])
    assert np.count_nonzero(np.linalg.norm(by, axis=-1)) == 7


@cache
def leaning(tilt: float, thrust: float = 2.6) -> ho.Plan:
    drone = ho.Quadrotor(max_thrust=thrust)
    team = ho.Team(robots=4, cable_length=2.2, tension=0.5, quadrotor=drone)
    start = ho.Hitch.spread(team, regular_polygon(4, 1.0).vertices, altitude=2.4)
    return ho.transport(start, to=[0.7, 0.3, 2.4], limits=ho.Limits(tilt_deg=tilt))


@pytest.mark.parametrize(("drone", "beside"), [("q0", ["r0", "r3"]), ("r2", ["q2", "q3"])])
def test_survivors_push_level_and_inward(drone: str, beside: list[str]) -> None:
    """On their position loops those beside the lost one come to its clasp, the others together."""
    motion = leaning(60.0).motion
    found, names = Reactions(motion).found(drone, TIME), motion.team.drone_names
    pushed, lost, near = found.inward, names.index(drone), [names.index(name) for name in beside]
    assert pushed is not None
    assert not np.any(pushed.forces[lost])
    assert not np.any(pushed.forces[:, 2])
    states = states_at(motion, TIME)
    places, by = states.positions, pushed.forces / (GAIN * motion.team.mass[:, None])
    clasp = states.vertices[motion.team.layout.pulled_to[lost]]
    for i in near:
        before, after = (
            np.linalg.norm((place - clasp)[:2]) for place in (places[i], places[i] + by[i])
        )
        assert before - after == pytest.approx(pushing.BESIDE)
    others = [i for i in range(8) if i not in (*near, lost)]
    middle = np.mean(places, axis=0)
    far = np.linalg.norm((places - middle)[:, :2], axis=-1)
    closer = far - np.linalg.norm((places + by - middle)[:, :2], axis=-1)
    np.testing.assert_allclose(closer[others], pushing.CLOSER * far[others] / np.max(far))
    survivors = (places + by)[[*near, *others]]
    one, other = np.triu_indices(7, 1)
    scale = motion.requirements.separation.scale
    apart = np.min(np.linalg.norm((survivors[one] - survivors[other]) * scale, axis=-1))
    assert found.nearest <= apart + 1e-9
    assert apart >= pushing.ROOM


def test_nobody_pushes_where_survivors_come_too_close(monkeypatch: pytest.MonkeyPatch) -> None:
    largest, nearest = [], []
    for room in (1.0, 2.96, 3.4, 9.0):
        monkeypatch.setattr(pushing, "ROOM", room)
        found = reactions_of(2.4).found("q1", TIME)
        pushed = found.inward
        largest.append(0.0 if pushed is None else float(np.max(np.abs(pushed.forces))))
        nearest.append(found.nearest)
    assert largest[0] == max(largest) > 0.0
    assert largest[-1] == 0.0
    assert max(nearest) <= nearest[-1]  # what is nearest without pushing is so with it as well


def test_nobody_pushes_into_the_swing() -> None:
    """Survivors keep two radii from where the lost drone swings when they have come closer."""
    motion, lost = leaning(60.0).motion, 2
    states = states_at(motion, TIME)
    found = Reactions(motion).found("q1", TIME)
    bare = replace(found, inward=None)
    assert found.inward is not None
    by = found.inward.forces / (GAIN * motion.team.mass[:, None])
    radius, place = motion.requirements.separation.radius, states.positions[3] + by[3]
    for off, pushes in ((2.5, True), (1.9, False)):
        arcs = (place + [0.0, 0.0, -off * radius])[None]
        again = pushing.pushing(motion, states, lost, bare, arcs)
        assert (
            again.inward is not None and np.allclose(again.inward.forces, found.inward.forces)
        ) == pushes
        if pushes:
            assert again.nearest == pytest.approx(min(bare.nearest, off / 2.0))


def test_the_command_line_says_who_pushes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of(2.4)
    plan.save(tmp_path)
    simulate_command._lost(tmp_path, Settings(), read_task(tmp_path), f"q1@{TIME}", react=True)
    said = " ".join(capsys.readouterr().out.split())
    assert f"the others push inward from {TIME + 0.55:.3f} to {TIME + 2.2:.3f} s" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tilt", "thrust", "closer"),
    [(25.0, 2.6, 0.21), (32.0, 2.6, 0.21), (45.0, 2.6, 0.21), (60.0, 2.6, 0.21), (75.0, 2.2, 0.4)],
)
def test_who_pushes_leans_within_the_limits(
    tilt: float, thrust: float, closer: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thrusts by Newton's law from the setpoints that are flown."""
    monkeypatch.setattr(pushing, "CLOSER", closer)
    plan = leaning(tilt, thrust)
    team, found = plan.motion.team, Reactions(plan.motion).found("q1", TIME)
    flown = reacting(read_task(plan.save(tmp_path)), found)
    setpoints = flown.setpoints
    thrusts = team.mass[:, None] * (setpoints.accelerations + [0.0, 0.0, GRAVITY])
    thrusts = (thrusts - setpoints.cable_forces)[:, np.arange(8) != 2]
    angle = np.degrees(np.arctan2(np.linalg.norm(thrusts[..., :2], axis=-1), thrusts[..., 2]))
    assert (found.inward is None) == (tilt == 25.0)
    if found.inward is not None:
        during = (flown.t >= found.inward.begins) & (flown.t <= found.inward.ends)
        largest = np.max(angle[during])
        assert 0.6 * min(tilt, 40.0) < largest <= tilt + 0.1
        sizes = np.linalg.norm(thrusts[during], axis=-1)
        assert 0.9 * min(thrust, 1.8) < np.max(sizes) <= thrust


def test_a_low_team_lands_upright() -> None:
    assert reactions_of(1.0).found("q1", TIME).inward is not None
    assert Reactions(plan_of(0.5).motion).found("q1", TIME).inward is None
    for altitude in (1.0, 2.4):
        found = reactions_of(altitude).found("q1", TIME)
        pushed, flown = found.inward, found.course.sinking.drones
        assert pushed is not None
        assert np.min(flown.at(pushed.ends)[:, 2]) > 0.24
        assert pushed.ends <= TIME + 2.2
