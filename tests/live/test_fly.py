"""Flights by commands and by lost links: nothing jumps, limits hold, and they end on the ground."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import numpy as np
import pytest
from plans import planned
from streamed_flights import PATIENCE, Rig, plan_of

import hitchopt as ho
from hitchopt.live.abort import abort_table
from hitchopt.live.fly import COMMANDS, Course

LONG = 60.0


def test_a_plan_is_flown_to_its_end_and_landed() -> None:
    rig, plan = Rig(), plan_of()
    rig.run(1.0)
    assert rig.course.resting
    rig.run(LONG / 4, "resume")
    there = plan.at(plan.duration).positions
    np.testing.assert_allclose(rig.sent[-1].setpoints.positions, there, atol=1e-9)
    rig.run(LONG, "land")
    rig.check(landed=True)
    assert rig.flight.late == 0


@pytest.mark.parametrize("aborted", [False, True])
def test_drones_without_cables_end_where_the_plan_lands(*, aborted: bool) -> None:
    rig = Rig(swarm=True)
    rig.begin(0.8)
    rig.run(LONG, *(["abort"] if aborted else []))
    rig.check(landed=True)
    assert rig.course.descending == aborted
    there = [[2.0, 0.5, 0.0], [1.0, 0.1, 0.0]]
    assert aborted or np.allclose(rig.sent[-1].setpoints.positions, there, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_any_commands_end_in_a_landing_without_a_jump(seed: int) -> None:
    rig, rng = Rig(), np.random.default_rng(seed)
    rig.begin(0.5)
    for command in rng.choice([*COMMANDS[:-1], "toggle", "toggle"], 6):
        rig.run(float(rng.uniform(0.1, 0.9)), str(command))
    rig.run(LONG, "end")
    rig.run(LONG, "resume")
    rig.check(landed=True)


def test_what_is_sent_belongs_to_the_cables() -> None:
    rig, plan = Rig(rate=1000.0), plan_of()
    rig.begin(0.7)
    flown, team = rig.sent[-1], plan.motion.team
    states = plan.at(flown.setpoints.time)
    expected = team.mass[:, None] * (flown.setpoints.accelerations + [0, 0, 9.81])
    np.testing.assert_allclose(flown.thrusts, expected - states.cable_forces, atol=1e-3)
    thrusts, rates = (
        np.array([getattr(each, name) for each in rig.sent[-400:]])
        for name in ("thrusts", "thrust_rates")
    )
    slopes = 0.5 * rig.rate * (thrusts[2:] - thrusts[:-2])
    off = np.max(np.abs(rates[1:-1] - slopes), axis=(1, 2))
    assert np.quantile(off, 0.9) < 1e-3  # the jerk itself jumps here and there
    assert np.max(np.abs(rates)) > 0.02


@pytest.mark.parametrize("who", ["operator", "r1"])
def test_a_lost_link_ends_in_a_hold_and_then_on_the_ground(who: str) -> None:
    rig = Rig()
    rig.begin(0.6)
    begun = rig.sent[-1].setpoints.positions
    assert rig.speed > 0.0
    rig.operator, rig.silent = who != "operator", {who}
    rig.run(PATIENCE)
    assert rig.going
    assert rig.course.resting
    assert rig.speed == 0.0
    assert np.max(np.abs(rig.sent[-1].setpoints.positions - begun)) < 0.6
    assert f"lost: {who}" in rig.said
    rig.run(LONG)
    rig.check(landed=True)


def test_a_link_that_comes_back_in_time_leaves_a_hold() -> None:
    rig = Rig()
    rig.begin(0.5)
    rig.silent = {"q2"}
    rig.run(1.5)
    assert rig.course.resting
    rig.run(0.1, "resume")
    assert rig.said[-1] == "resume: nothing is heard of q2"
    rig.silent = set()
    rig.run(4.0)
    assert (rig.speed, rig.course.descending) == (0.0, False)
    rig.run(LONG / 4, "resume")
    assert rig.sent[-1].setpoints.time == pytest.approx(plan_of().duration)
    rig.check(landed=False)


def test_nothing_begins_without_measurements_near_the_start_or_an_operator() -> None:
    rig = Rig()
    rig.silent = set(rig.names)
    rig.run(0.5)
    rig.run(0.5, "resume")
    assert "nothing is heard of q0, r0" in rig.said[-1]
    rig.silent, rig.off = set(), np.array([0.0, 0.5, 0.0])
    for command, words in (("toggle", "q0 is 0.50 m from its setpoint"), ("abort", "not begun")):
        rig.run(0.5, command)
        assert words in rig.said[-1]
    assert {flown.setpoints.time for flown in rig.sent} == {0.0}
    rig.run(1.0, "quit")
    assert (rig.going, rig.flight.landed) == (False, False)
    rig = Rig()
    rig.operator = False
    rig.run(LONG)
    assert not rig.going
    assert rig.now < 104.0
    assert "no operator" in rig.said[-1]


@pytest.mark.parametrize(("ticks", "late"), [(6, False), (30, True)])
def test_setpoints_go_on_while_a_command_is_computed(*, ticks: int, late: bool) -> None:
    waiting: list[tuple[int, Callable[[], str], Future[str]]] = []

    def slow(compute: Callable[[], str]) -> Future[str]:
        waiting.append((len(rig.sent) + ticks, compute, Future()))
        return waiting[-1][2]

    rig = Rig(slow)
    for command in ("resume", "pause", "abort"):
        rig.pressed.append(command)
        for _ in range(60):
            rig.run(1.0 / rig.rate)
            if waiting and len(rig.sent) >= waiting[0][0]:
                _, compute, future = waiting.pop(0)
                future.set_result(compute())
    assert (rig.flight.late > 0) == late
    series = [each for each, after in zip(rig.sent, rig.sent[1:], strict=False) if each != after]
    rig.sent = series  # what is sent twice is no jump, but late
    rig.check(landed=False)


def test_refusals_leave_the_flight_as_it_is() -> None:
    rig = Rig()
    with pytest.raises(ho.InputError, match="command = 'dance'"):
        rig.course.obey("dance")
    rig.begin(0.4)
    times = [rig.sent[-1].setpoints.time]
    rig.pressed.append("land")
    while not rig.course.descending:
        rig.run(1.0 / rig.rate)
        times.append(rig.sent[-1].setpoints.time)
    assert times[-1] > times[0]  # to a rest ahead
    with pytest.raises(ho.InfeasibleError, match="the landing has begun"):
        rig.course.obey("back")


def test_the_clock_is_led_back_to_where_a_landing_begins() -> None:
    """The last times of a stack have none: drones stand above each other."""
    motion = planned("swarms/stack").motion
    course = Course(motion, {"land": abort_table(motion, "land", 0.5)})
    course.obey("resume")
    for _ in range(300):
        course.step(0.01)
    assert course.obey("land").startswith("land: begins in ")
    for _ in range(1200):
        sent = course.step(0.01)
    assert course.landed
    assert np.all(sent.setpoints.positions[:, 2] <= motion.requirements.floor + 1e-6)
