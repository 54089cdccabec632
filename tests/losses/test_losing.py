"""After the loss of a robot the others stop, hold a chain in balance, and land in order."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.cli import main
from hitchopt.live.abort import AbortTable
from hitchopt.live.fly import CommandedPlan
from hitchopt.live.links import Operator
from hitchopt.live.player import Setpoints
from hitchopt.losses.losing import after_loss_of
from hitchopt.losses.reactions import DELAY, prepared_stops
from hitchopt.losses.table import after_loss
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import TeamMotion
from hitchopt.motion.motion import HoldBy, PhaseHold
from hitchopt.trajectory.piecewise import MIN_SPACING

STEP = 0.01


@cache
def square(density: float = 0.0) -> ho.Plan:
    team = ho.Team(
        *(4, 2.2),
        tension=0.3,
        cable_density=density,
        release=True,
        quadrotor=ho.Quadrotor(stiffness=4.75),
    )
    start = ho.Hitch.balanced(team, ho.regular_polygon(4, 1.2), 1.6)
    moved = start.polygon.vertices + 0.1 * np.eye(4)[:, :1]
    steps = [ho.Morph(moved), ho.Transport(to=[0.4, 0.2, 1.6], yaw=0.3)]
    return ho.solve(start, steps, limits=ho.Limits(survive="cable"))


@pytest.mark.parametrize(("robot", "time", "density"), [(0, 1.0, 0.0), (2, 2.0, 0.008)])
def test_all_but_two_drones_stay_where_the_plan_stopped(
    robot: int, time: float, density: float
) -> None:
    plan = square(density)
    found = after_loss_of(plan.flight, str(robot), time)
    assert found.certificate.certified
    chain, lost = (flown.motion for flown in found.flight.teams)
    assert found.rest >= time + 0.1
    assert 0.1 < found.stops <= found.starts < found.taut
    before = plan.motion.drones.at(found.rest)
    first = chain.drones.at(found.stops)
    names = {
        f"{kind}{int(own.split('.')[1])}": f"{kind}{old}"
        for own, old in found.robots.items()
        for kind in "qr"
    }
    of_plan = plan.motion.team.drone_names
    places = [of_plan.index(names[name]) for name in chain.team.drone_names]
    np.testing.assert_allclose(first, before[places], atol=1e-9)
    own = [2 * robot, 2 * robot + 1]
    rising = next(phase for phase in lost.phases if phase.name == "rise")
    risen = before[own] + [0, 0, found.rise]
    np.testing.assert_allclose(lost.drones.at(rising.end), risen, atol=1e-9)
    for t in (0.0, 0.05, 0.1):  # all fly on as planned
        planned = plan.motion.drones.at(found.begin + t)
        np.testing.assert_allclose(chain.drones.at(t), planned[places], atol=1e-7)
        np.testing.assert_allclose(lost.drones.at(t), planned[own], atol=1e-7)
    moved = np.linalg.norm(chain.drones.at(chain.duration) - first, axis=1) > 1e-6
    ends = {chain.team.drone_names[i] for i in np.flatnonzero(moved)}
    assert {names[end] for end in ends} == {f"q{(robot + 1) % 4}", f"r{(robot - 1) % 4}"}
    np.testing.assert_allclose(chain.tensions.at(chain.duration), 0.3)


@pytest.mark.parametrize("density", [pytest.param(0.0, marks=pytest.mark.slow), 0.008])
def test_no_reaction_takes_longer_than_stated(density: float) -> None:
    """The worst time is that just after a loss would have been answered by the stop before."""
    flight = square(density).flight
    starts = [stop.start - DELAY for stop in prepared_stops(flight)]
    times = np.random.default_rng(7).uniform(0.0, flight.duration, 3).tolist()
    for row in after_loss(flight)["robots"][::2]:
        taut = list[float]()
        for time in (*times, *(start + 1e-9 for start in starts[::4] if start >= 0.0), 0.0):
            taut.append(after_loss_of(flight, row["robot"], time).taut)
            assert taut[-1] <= row["seconds"] + 1e-3
        assert row["seconds"] <= 1.1 * max(taut)


def irregular(robots: int, seed: int) -> ho.Plan:
    """Return the plan of a random morph of a hitch with weight and rolled legs that survives."""
    rng = np.random.default_rng(seed)
    drone = ho.Quadrotor(stiffness=4.75)
    corners = ho.regular_polygon(robots, rng.uniform(0.9, 1.2)).vertices
    corners = corners + rng.uniform(-0.1, 0.1, corners.shape)
    longest = np.max(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1))
    team = ho.Team(
        robots,
        longest + rng.uniform(0.7, 1.0),
        tension=rng.uniform(0.2, 0.3),
        cable_density=0.004,
        release=True,
        quadrotor=drone,
    )
    start = ho.Hitch.balanced(team, corners, 1.7, rng.uniform(-0.3, 0.3, robots))
    moved = corners + rng.uniform(-0.08, 0.08, corners.shape)
    return ho.solve(start, ho.Morph(moved), limits=ho.Limits(survive="cable"))


@pytest.mark.parametrize(
    ("robots", "seed"),
    [
        (3, 0),
        *(pytest.param(*x, marks=pytest.mark.slow) for x in ((3, 2), (4, 3), (5, 1), (6, 4))),
    ],
)
def test_what_survives_has_a_certified_reaction(robots: int, seed: int, tmp_path: Path) -> None:
    """For each robot, at a drawn time; the verifier proves one."""
    plan = irregular(robots, seed)
    assert plan.certificate["survivable"].worst == 1.0
    times = np.random.default_rng(seed).uniform(0.0, plan.duration, robots)
    answers = [plan.after_loss(robot, time) for robot, time in enumerate(times)]
    assert all(answer.certificate.certified for answer in answers)
    rows = second.verify(answers[seed % robots].save(tmp_path, picture=False))
    assert {row.verdict for row in rows} <= second.PASSING


@pytest.mark.parametrize(
    "off", [1e-6, 9.5e-5, 2e-3, *(pytest.param(x, marks=pytest.mark.slow) for x in (1e-8, 1e-5))]
)
def test_losses_right_after_breaks_have_a_certified_reaction(off: float) -> None:
    """Also where a prepared stop begins there: no piece that moves is too short."""
    flight = square(0.008).flight
    breaks = flight.breaks[1:-1]
    rng = np.random.default_rng(int(1e9 * off))
    starts = np.array([stop.start for stop in prepared_stops(flight)])
    for time in rng.choice(breaks, 3) + off:
        found = after_loss_of(flight, str(rng.integers(4)), float(time))
        assert found.certificate.certified
        assert min(map(shortest_moving_piece, found.flight.teams)) >= 0.9 * MIN_SPACING
    since = starts - breaks[np.maximum(np.searchsorted(breaks, starts, side="right") - 1, 0)]
    assert np.all((since <= 0.0) | (since >= 0.9 * MIN_SPACING))


def shortest_moving_piece(flown: TeamMotion) -> float:
    """Return the duration [s] of the shortest piece on which a drone moves."""
    drones = flown.motion.drones
    moves = np.max(np.ptp(drones.coefficients, axis=-1), axis=(1, 2)) > 0.0
    return float(np.min(drones.durations[moves]))


@pytest.mark.slow
@pytest.mark.parametrize("density", [0.0, 0.008])
def test_the_chain_is_untied_and_lands(density: float, tmp_path: Path) -> None:
    plan = square(density).after_loss(1, 1.5, how="land")
    assert np.max(plan.at(plan.duration).positions[:, 2]) <= 1e-6
    assert "chain unswap 2" in " ".join(phase.name for phase in plan.phases)
    rows = list(second.verify(plan.save(tmp_path, picture=False)))
    assert {row.verdict for row in rows} <= second.PASSING


def test_the_command_writes_a_plan_that_others_read(tmp_path: Path) -> None:
    folder, out = square().save(tmp_path / "plan", picture=False), tmp_path / "after"
    call = ["react", str(folder), "--lose", "3", "--at", "0.5", "-o", str(out)]
    shown = CliRunner().invoke(main, call)
    assert shown.exit_code == 0, shown.output
    assert "chain.2 is 2" in shown.output
    assert CliRunner().invoke(main, ["check", str(out)]).exit_code == 0
    exported = CliRunner().invoke(main, ["export", str(out), "--format", "csv"])
    assert exported.exit_code == 0, exported.output
    flown = CliRunner().invoke(main, ["export", str(out), "--format", "crazyswarm2"])
    assert "the plan begins in motion, as after a loss" in flown.output
    uploaded = CliRunner().invoke(main, ["export", str(folder), "--format", "csv"])
    assert "files do not react to the loss of a robot" in uploaded.output


@pytest.mark.parametrize(
    ("robot", "time", "words"),
    [
        ("7", "1", "lose = '7': must be one of 0, 1, 2, 3"),
        ("a.1", "1", "must be one of 0, 1, 2, 3"),
        ("1", "99", "must be while a hitch is taut, 0 to"),
        ("1", "-1", "t = -1"),
    ],
)
def test_a_robot_or_a_time_without_an_answer_is_refused(
    robot: str, time: str, words: str, tmp_path: Path
) -> None:
    folder = square().save(tmp_path / "plan", picture=False)
    call = ["react", str(folder), "--lose", robot, "--at", time, "-o", str(tmp_path / "out")]
    shown = CliRunner().invoke(main, call)
    assert shown.exit_code == 2
    assert words in shown.stderr


@pytest.mark.parametrize("release", [True, None])
def test_inner_robots_of_chains_are_refused_and_cables_may_break_by_themselves(
    release: bool | None,
) -> None:
    arc = [[-1.4, 0.0], [-0.6, 0.7], [0.6, 0.7], [1.4, 0.0]]
    team = ho.Team(3, 1.9, topology="open", tension=0.3, release=release)
    plan = ho.solve(ho.Hitch.balanced(team, arc, 1.5), ho.Hold(1.0))
    with pytest.raises(ho.InputError, match="hold one another"):
        plan.after_loss("1", 0.5)
    assert plan.after_loss("0", 0.5).certificate.certified


@cache
def sagging(*, release: bool) -> ho.Plan:
    """The plan of a hitch whose chain cannot be untied, and whose cables would be below ground."""
    team = ho.Team(
        *(3, 2.53), cable_density=0.005, tension=0.4, quadrotor="paper_132g", release=release
    )
    corners = [[-0.432, -0.304], [-0.092, 0.509], [0.524, -0.205]]
    moved = [[-0.278, 0.228], [1.001, 0.143], [-0.084, -0.869]]
    return ho.solve(ho.Hitch.spread(team, corners, altitude=1.6), ho.Morph(moved))


@pytest.mark.parametrize("release", [True, False])
def test_where_no_chain_lands_all_cables_are_dropped(release: bool, tmp_path: Path) -> None:
    plan = sagging(release=release)
    if not release:
        with pytest.raises(ho.InfeasibleError, match=r"tied landing\n.*team\.release: true"):
            plan.after_loss(1, 0.9888, "land")
        return
    found = after_loss_of(plan.flight, "1", 0.9888, "land")
    assert found.certificate.certified
    assert [phase.name for phase in found.flight.phases] == ["stop", "land"]
    assert sorted(found.drones) == sorted(plan.motion.team.drone_names)
    landed = found.flight.drones.at(found.flight.duration)
    stopped = plan.motion.drones.at(found.rest)
    np.testing.assert_allclose(landed, stopped * [1.0, 1.0, 0.0], atol=1e-9)
    folder = ho.Plan(found.flight, found.certificate).save(tmp_path, picture=False)
    assert {row.verdict for row in second.verify(folder)} <= second.PASSING


def test_after_a_second_loss_drones_keep_clear_of_those_of_the_first() -> None:
    first = square().after_loss(1, 1.0)
    taut = first.flight.duration - 0.5
    labels = first.flight.teams[0].motion.team.labels
    for end in (labels[0], labels[-1]):
        found = after_loss_of(first.flight, f"chain.{end}", taut)
        assert found.certificate.certified
        assert [each.name for each in found.flight.teams] == ["chain", "chain-lost", "lost"]


def test_teams_are_named_and_others_rest() -> None:
    plan = square()
    away = plan.motion.drones.coefficients + np.array([0.0, 8.0, 0.0])[:, None]
    clasps = plan.motion.vertices.coefficients + np.array([0.0, 8.0, 0.0])[:, None]
    other = plan.motion.replaced(
        drones=plan.motion.drones.replaced(away), vertices=plan.motion.vertices.replaced(clasps)
    )
    flight = ho.Flight((TeamMotion("a", plan.motion), TeamMotion("b", other)))
    found = after_loss_of(flight, "b.2", 0.7)
    assert {flown.name for flown in found.flight.teams} == {"a", "b", "b-lost"}
    rest = plan.motion.drones.at(found.rest)
    own = next(flown for flown in found.flight.teams if flown.name == "a")
    np.testing.assert_allclose(own.motion.drones.at(found.stops), rest, atol=1e-9)


def flown_by(step: Callable[[float], Setpoints], seconds: float) -> list[Setpoints]:
    """Return setpoints over some time, in steps of STEP."""
    return [step(STEP) for _ in range(round(seconds / STEP))]


def check_continuous(series: list[Setpoints], limits: ho.Limits) -> None:
    """Each setpoint follows from the one before within the limits."""
    positions, velocities = (
        np.array([getattr(each, name) for each in series]) for name in ("positions", "velocities")
    )
    led = positions[:-1] + 0.5 * STEP * (velocities[1:] + velocities[:-1])
    assert np.max(np.abs(positions[1:] - led)) <= limits.jerk * STEP**3
    assert np.max(np.linalg.norm(velocities, axis=-1)) <= limits.speed * (1.0 + 1e-6)


@pytest.mark.parametrize(("robot", "rate"), [("1", 1.0), (2, 0.4)])
def test_a_player_flies_from_the_plan_to_the_chain(robot: int | str, rate: float) -> None:
    plan = square()
    player = ho.Player(plan, 0.5, rate)
    before = flown_by(player.step, 0.4)
    seconds = player.lose(robot)
    with pytest.raises(ho.InfeasibleError, match="begins at rest"):
        player.resume()
    after = flown_by(player.step, seconds + 1.0)
    check_continuous(before + after, plan.motion.requirements.limits)
    assert player.resting
    assert player.time == pytest.approx(player.flight.duration)
    last = dict(zip(plan.motion.team.listed_names, after[-1].positions, strict=True))
    ends = player.flight.drones.coefficients[-1, ..., -1]
    held = {name: ends[place] for name, place in zip(last, player.listed, strict=True)}
    assert last.keys() == held.keys()
    np.testing.assert_allclose([*last.values()], [*held.values()], atol=1e-9)
    assert last[f"q{robot}"][2] > 0.8 + max(last[f"{end}{k}"][2] for end in "qr" for k in (0, 3))


def test_a_player_refuses_what_cannot_be_lost_and_flies_on() -> None:
    player = ho.Player(square(), 0.5)
    with pytest.raises(ho.InputError, match="must be one of 0, 1, 2, 3"):
        player.lose("7")
    assert player.clock_rate == 1.0
    player.step(0.1)


def stream_of(plan: ho.Plan) -> tuple[CommandedPlan, Callable[[float], Setpoints]]:
    """Return a plan that is flown, and its steps, in which commands that wait are retried."""
    tables = {
        "land": AbortTable.unplanned(plan.flight, "land"),
        "abort": AbortTable.unplanned(plan.flight, "release_and_land"),
    }
    commanded = CommandedPlan(plan.flight, tables)
    commanded.obey("resume")

    def step(seconds: float) -> Setpoints:
        if retried := commanded.retry():
            commanded.obey(retried)
        return commanded.step(seconds).setpoints

    return commanded, step


@pytest.mark.parametrize("density", [0.0, pytest.param(0.008, marks=pytest.mark.slow)])
def test_a_stream_stops_holds_the_chain_and_lands(density: float) -> None:
    plan = square(density)
    commanded, step = stream_of(plan)
    series = flown_by(step, 0.8)
    for wrong, words in {"lose 9": "one of 0, 1", "lose": "command", "land 2": "command"}.items():
        with pytest.raises(ho.InputError, match=words):
            commanded.obey(wrong)
    assert "at rest in" in commanded.obey("lose 1")
    series += flown_by(step, 3.0)
    assert commanded.lost == "1"
    with pytest.raises(ho.InfeasibleError, match="lost"):
        commanded.obey("back")
    assert "as soon as the chain is held" in commanded.obey("land")
    series += flown_by(step, 12.0 if density == 0.0 else 24.0)
    check_continuous(series, plan.motion.requirements.limits)
    assert commanded.landed
    remaining = [0, 1, 4, 5, 6, 7]  # setpoints keep their order
    assert np.max(np.abs(series[-1].positions[remaining, 2])) < 1e-6


def test_a_stream_drops_all_cables_where_no_chain_lands() -> None:
    plan = sagging(release=True)
    commanded, step = stream_of(plan)
    series = flown_by(step, 0.8)
    commanded.obey("lose 1")
    series += flown_by(step, 12.0)
    assert "without cables" in commanded.obey("land")
    series += flown_by(step, 5.0)
    check_continuous(series, plan.motion.requirements.limits)
    assert commanded.landed
    assert np.max(np.abs(series[-1].positions[:, 2])) < 1e-6


@pytest.mark.parametrize("release", [True, None])
def test_a_stream_drops_all_cables_where_no_chain_is_certified(release: bool | None) -> None:
    arc = [[-1.4, 0.0], [-0.6, 0.7], [0.6, 0.7], [1.4, 0.0]]
    team = ho.Team(3, 1.9, topology="open", tension=0.3, release=release)
    low = ho.Arena([-4.0, -4.0, 0.0], [4.0, 4.0, 1.7])  # nothing can rise
    plan = ho.solve(ho.Hitch.balanced(team, arc, 1.5), ho.Hold(1.0), arena=low)
    commanded, step = stream_of(plan)
    flown_by(step, 0.3)
    commanded.obey("lose 0")
    while not commanded.resting:
        commanded.step(STEP)
    if not release:
        with pytest.raises(ho.InfeasibleError, match="arena"):
            commanded.obey("lose 0")
        assert not commanded.lost
        return
    assert "drop their cables and hover" in commanded.obey("lose 0")
    hovering = flown_by(step, 0.5)
    commanded.obey("land")
    series = hovering + flown_by(step, 5.0)
    check_continuous(series, plan.motion.requirements.limits)
    assert commanded.landed
    landed = hovering[0].positions * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(series[-1].positions, landed, atol=1e-9)


def test_the_operator_types_the_robot_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    with os.fdopen(read, "rb") as keys, os.fdopen(write, "wb", buffering=0) as typing:
        monkeypatch.setattr("sys.stdin", keys)
        operator = Operator()
        typing.write(b" xa.")
        assert operator.commands() == (["toggle"], True)
        typing.write(b"2\nbx\nL")
        assert operator.commands() == (["lose a.2", "back", "land"], True)


@pytest.mark.parametrize("by", list(HoldBy))
def test_what_is_held_falls(by: HoldBy) -> None:
    motion = square().motion
    hold = PhaseHold("drum", by, (0, 1, 2, 3))
    held = motion.replaced(phases=tuple(replace(phase, hold=hold) for phase in motion.phases))
    with pytest.raises(ho.InfeasibleError, match=r"loss of 1 at t = 0\.5 s: .* drum, which falls"):
        after_loss_of(ho.Flight.of(held), "1", 0.5)


def test_losses_from_which_the_hitch_loosens_before_it_stops_are_refused() -> None:
    """Of a hitch whose cables are free from a time on at which drones move."""
    motion = square().motion
    speeds = np.linalg.norm(motion.drones.at(motion.drones.breaks, 1), axis=-1)
    slack = float(motion.drones.breaks[np.argmax(np.min(speeds, axis=1))])
    first = motion.phases[0]
    phases = (
        first.retimed(0.0, slack),
        replace(first.retimed(slack, motion.duration), state=CableState.FREE),
    )
    flight = ho.Flight.of(motion.replaced(phases=phases))
    last = max(stop.start for stop in prepared_stops(flight) if stop.rest <= slack)
    for time in np.linspace(0.0, slack, 12):
        is_answered = time + DELAY <= last
        with nullcontext() if is_answered else pytest.raises(ho.InfeasibleError):
            after_loss_of(flight, "1", float(time))
