"""Plans flown by commands and with lost links: no jumps, limits hold, drones land."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.live.abort import AbortTable, abort_table
from hitchopt.live.fly import COMMANDS, LEAD, CommandedPlan, FleetSetpoints, SetpointStream
from hitchopt.live.player import Player, Setpoints
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.plans import planned

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
PATIENCE, LONG, STEP = 2.0, 60.0, 0.01


@cache
def plan_of(what: str = "moved") -> ho.Plan:
    """A triangle off the origin whose vertex moves, and that is ``carried`` besides.

    Or a ``swarm`` of two drones without cables that change places and end on the ground.
    """
    if what == "swarm":
        start = np.array([[1.0, 0.0, 1.0], [2.0, 0.5, 1.2]])
        goal = np.array([[2.0, 0.5, 0.0], [1.0, 0.1, 0.0]])
        return ho.separate(ho.Problem(ho.Swarm(2), start, [ho.Fly(goal)]))
    hitch = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE)
    moved, turned = ho.MoveVertex(0, by=[0.0, 0.4]), ho.Transport([1.4, 2.2, 1.3], yaw=0.5)
    return ho.solve(hitch, moved if what == "moved" else [moved, turned])


@cache
def tables(*, swarm: bool) -> dict[str, AbortTable]:
    motion = plan_of("swarm" if swarm else "moved").motion
    if swarm:
        return dict.fromkeys(("land", "abort"), abort_table(ho.Flight.of(motion), "land", 0.5))
    return {
        "land": abort_table(ho.Flight.of(motion), "land"),
        "abort": abort_table(ho.Flight.of(motion), "release_and_land"),
    }


def check_setpoints(series: list[Setpoints], limits: ho.Limits, step: float) -> None:
    """Setpoints, a step [s] apart, keep the limits, and each follows from the one before."""
    names = "positions", "velocities", "accelerations", "jerks"
    p, v, a, j = (np.array([getattr(each, name) for each in series]) for name in names)
    for values, most in ((v, limits.speed), (a, limits.acceleration), (j, limits.jerk)):
        assert np.max(np.linalg.norm(values, axis=-1)) <= most * (1.0 + 1e-6)
    led = p[:-1] + 0.5 * step * (v[1:] + v[:-1])
    assert np.max(np.abs(p[1:] - led), initial=0.0) <= limits.jerk * step**3


def ran(player: Player, seconds: float) -> Setpoints:
    """Return the last setpoints over some time; all keep the limits, without a jump."""
    found = [player.step(0.0), *(player.step(STEP) for _ in range(int(seconds / STEP) + 1))]
    check_setpoints(found, player.flight.requirements.limits, STEP)
    return found[-1]


def test_at_full_rate_it_is_the_plan() -> None:
    plan, player = plan_of("carried"), Player(plan_of("carried"))
    close = {"positions": 1e-12, "velocities": 1e-10, "accelerations": 1e-8, "jerks": 1e-5}
    for _ in range(30):
        here = player.step(0.07)
        for name, atol in close.items():
            wanted = getattr(plan.at(here.time), name)
            np.testing.assert_allclose(getattr(here, name), wanted, atol=atol)


CHANGES: list[Callable[[Player, float], float]] = [
    *(lambda player, _: player.pause(), lambda player, _: player.resume()),
    *(lambda player, _: player.back(), lambda player, _: player.rate(0.5), Player.seek),
]


@pytest.mark.parametrize("seed", range(6))
def test_any_changes_keep_all_limits_and_a_pause_ends_in_rest(seed: int) -> None:
    plan, rng = plan_of("carried"), np.random.default_rng(seed)
    player = Player(plan, rng.uniform() * plan.duration)
    for k in rng.choice(len(CHANGES), 2):
        share = float(rng.uniform())
        ran(player, share * CHANGES[k](player, share * plan.duration))
    seconds = player.pause()
    assert seconds <= max(np.max(player.stops.longest[0]) * 3.0, 3.0)
    last = ran(player, seconds)
    assert player.resting
    assert np.max(np.abs(last.velocities)) <= 1e-9
    np.testing.assert_allclose(last.positions, plan.at(last.time).positions, atol=1e-12)


def test_a_pause_takes_no_longer_than_the_certificate_reports() -> None:
    plan = plan_of("carried")
    for time in np.random.default_rng(3).uniform(0.0, plan.duration, 12):
        player = Player(plan, float(time))
        seconds = player.pause()
        assert seconds <= plan.certificate["stoppable"].worst + 1e-9
        player.step(0.3 * seconds)
        assert player.pause() <= 0.7 * seconds + 1e-9  # asked again
        before, here, after = (player.step(each) for each in (0.0, 1e-4, 1e-4))
        for values, slopes in (("positions", "velocities"), ("accelerations", "jerks")):
            change = getattr(after, values) - getattr(before, values)
            np.testing.assert_allclose(change / 2e-4, getattr(here, slopes), atol=0.02)


def test_seeking_and_going_back_end_at_the_plan_time() -> None:
    plan = plan_of("carried")
    player = Player(plan, 0.3 * plan.duration)
    for share in (0.8, 0.1, 0.0, 1.0, 0.6):
        ran(player, player.seek(share * plan.duration))
        assert player.resting
        assert player.time == pytest.approx(share * plan.duration, abs=1e-9)


def test_where_legs_lean_there_is_no_way_back() -> None:
    motion = plan_of("carried").motion
    breaks, pulls = motion.drones.breaks, np.repeat(motion.tensions.coefficients[:, :, None], 2, 2)
    first, last = np.searchsorted(breaks, [0.4, 0.7]).tolist()
    pulls[first:last, :, 0] *= 1.05
    leaning = replace(motion, leg_tensions=PiecewisePolynomial(breaks, pulls))
    within, after = (Player(leaning, t) for t in (float(np.mean(breaks[[first, last]])), 1.5))
    for player, asked in ((within, within.back), (after, lambda: after.rate(-0.5))):
        with pytest.raises(ho.InfeasibleError, match="lean against friction"):
            asked()
        assert player.clock_rate == 1.0
    ran(after, after.back())
    assert after.time == pytest.approx(breaks[last])
    with pytest.raises(ho.InfeasibleError, match="no change of the clock"):
        after.seek(0.2)


@pytest.mark.slow
def test_plans_go_back_to_their_start_also_where_drones_swing_about_their_places() -> None:
    team = ho.Team(3, 2.4, tension=0.6, cable_friction=0.05)
    swinging = ho.solve(ho.Hitch.spread(team, TRIANGLE, 1.2), ho.Settle(), team=team)
    for plan in (swinging, plan_of("carried")):
        player = Player(plan, 5.0 if plan is swinging else 0.6 * plan.duration)
        player.back()
        last = ran(player, 8.0)
        assert (last.time, last.rate) == (0.0, 0.0)
        np.testing.assert_allclose(last.positions, plan.at(0.0).positions, atol=1e-12)


def test_wrong_arguments_are_named() -> None:
    player = Player(plan_of())
    cases = (
        ("plan", lambda: Player(3)),
        ("time", lambda: Player(plan_of(), -0.1)),
        ("rate", lambda: player.rate(1.2)),
        ("time", lambda: player.seek(1e3)),
        ("command = 'dance'", lambda: CommandedPlan(plan_of().flight, {}).obey("dance")),
    )
    for key, call in cases:
        with pytest.raises(ho.InputError, match=f"^{key}"):
            call()


Later = Callable[[Callable[[], str]], Future[str]]


def at_once(compute: Callable[[], str]) -> Future[str]:
    """Compute now."""
    done: Future[str] = Future()
    try:
        done.set_result(compute())
    except ho.HitchoptError as error:
        done.set_exception(error)
    return done


class Rig:
    """Operator and fleet at once; time passes with ``run`` only."""

    def __init__(self, later: Later = at_once, rate: float = 25.0, *, swarm: bool = False) -> None:
        self.plan = plan_of("swarm" if swarm else "moved")
        self.names = self.plan.motion.team.drone_names
        self.course = CommandedPlan(self.plan.flight, tables(swarm=swarm))
        self.pressed, self.said, self.sent = list[str](), list[str](), list[FleetSetpoints]()
        self.operator, self.silent, self.off = True, set[str](), np.zeros(3)
        self.now, self.going, self.rate = 100.0, True, rate
        self.armed = list[int]()  # after how many setpoints
        parts = self.course, self, self.commands, self.names, later, self.said.append
        self.flight = SetpointStream(*parts, rate=rate, patience=PATIENCE)

    def send(self, flown: FleetSetpoints, now: float) -> None:
        assert now == self.now
        self.sent.append(flown)

    def measured(self) -> dict[str, Array]:
        places = [p + self.off for p in self.sent[-1].setpoints.positions] if self.sent else []
        found = zip(self.names, places, strict=False)
        return {name: place for name, place in found if name not in self.silent}

    def arm(self) -> None:
        self.armed.append(len(self.sent))

    def close(self, *, landed: bool) -> None:
        raise AssertionError(landed)

    def commands(self) -> tuple[list[str], bool]:
        found, self.pressed = self.pressed, []
        return found, self.operator

    def run(self, seconds: float, *commands: str) -> None:
        self.pressed += commands
        end = self.now + seconds
        while self.going and self.now < end - 1e-9:
            self.now += 1.0 / self.rate
            self.going = self.flight.tick(self.now)

    def begin(self, seconds: float) -> None:
        """Look at the start, and fly for some time."""
        self.run(0.1)
        self.run(seconds, "resume")

    @property
    def speed(self) -> float:
        return float(np.max(np.abs(self.sent[-1].setpoints.velocities)))

    def check(self, *, landed: bool) -> None:
        """All that was sent keeps the limits, and follows from the setpoint before.

        Drones that have landed, tied or not, are for some time asked to do nothing but stand.
        """
        series = [flown.setpoints for flown in self.sent]
        check_setpoints(series, self.plan.motion.requirements.limits, 1.0 / self.rate)
        assert self.flight.landed == landed
        assert not landed or abs(np.min(series[-1].positions[:, 2])) <= 1e-9
        for flown in self.sent[-round(0.3 * self.rate) :] if landed else ():
            np.testing.assert_allclose(flown.feed_forward, 0.0, atol=1e-9)
            np.testing.assert_allclose(flown.thrusts[:, :2], 0.0, atol=1e-9)


@pytest.mark.parametrize("swarm", [False, True])
def test_a_plan_is_flown_to_its_end_and_landed(*, swarm: bool) -> None:
    """Drones without cables end where the plan lands."""
    rig = Rig(swarm=swarm)
    rig.run(1.0)
    assert rig.course.resting
    rig.run(LONG / 4, "resume")
    there = rig.plan.at(rig.plan.duration).positions
    np.testing.assert_allclose(rig.sent[-1].setpoints.positions, there, atol=1e-8)
    rig.run(LONG, *([] if swarm else ["land"]))
    rig.check(landed=True)
    assert (rig.flight.late, rig.course.descending) == (0, not swarm)
    # Drones are armed once, while the last setpoints of the start are sent: none hovers there.
    (armed,) = rig.armed
    moving = [bool(np.any(flown.setpoints.velocities)) for flown in rig.sent]
    assert not any(moving[:armed])
    assert moving.index(True) <= armed + LEAD * rig.rate + 1


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))]
)
def test_any_commands_end_in_a_landing_without_a_jump(seed: int) -> None:
    rig, rng = Rig(swarm=seed == 3), np.random.default_rng(seed)
    rig.begin(0.5)
    for command in rng.choice([*COMMANDS[:-1], "toggle", "toggle"], 6):
        rig.run(float(rng.uniform(0.1, 0.9)), str(command))
    rig.run(LONG, "end")
    rig.run(LONG, "resume")
    rig.check(landed=True)


def test_setpoints_have_the_cable_forces_of_their_time() -> None:
    rig, plan = Rig(rate=1000.0), plan_of()
    rig.begin(0.5)
    flown, mass = rig.sent[-1], plan.motion.team.mass[:, None]
    expected = mass * (flown.setpoints.accelerations + [0, 0, 9.81])
    expected -= plan.at(flown.setpoints.time).cable_forces
    np.testing.assert_allclose(flown.thrusts, expected, atol=1e-3)
    thrusts, rates = (
        np.array([getattr(each, name) for each in rig.sent[-400:]])
        for name in ("thrusts", "thrust_rates")
    )
    slopes = 0.5 * rig.rate * (thrusts[2:] - thrusts[:-2])
    off = np.max(np.abs(rates[1:-1] - slopes), axis=(1, 2))
    assert np.quantile(off, 0.9) < 1e-3  # the jerk itself jumps here and there
    assert np.max(np.abs(rates)) > 0.02


@pytest.mark.parametrize(("who", "refused"), [("operator", 0), ("r1", 0), ("r1", 1)])
def test_a_lost_link_ends_in_a_hold_and_then_on_the_ground(who: str, refused: int) -> None:
    """Holds that are refused are tried again."""
    refusals = list[Callable[[], str]]()

    def refuse() -> str:
        raise ho.InfeasibleError([], "not now")

    rig = Rig(lambda compute: at_once(refusals.pop() if refusals else compute))
    rig.begin(0.4)
    begun = rig.sent[-1].setpoints.positions
    assert rig.speed > 0.0
    rig.operator, rig.silent, refusals[:] = who != "operator", {who}, [refuse] * refused
    rig.run(PATIENCE)
    assert (rig.going, rig.course.resting, rig.speed) == (True, True, 0.0)
    assert np.max(np.abs(rig.sent[-1].setpoints.positions - begun)) < 0.6
    assert f"lost: {who}" in rig.said
    assert who == "operator" or any(words.startswith("at rest in") for words in rig.said)
    rig.run(LONG)
    rig.check(landed=True)


def test_a_link_that_comes_back_in_time_leaves_a_hold() -> None:
    rig = Rig()
    rig.begin(0.5)
    rig.silent = {"q2"}
    rig.run(1.5)
    assert rig.course.resting
    rig.run(0.1, "resume")
    assert rig.said[-1] == "resume: no signal from q2"
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
    assert "no signal from q0, r0" in rig.said[-1]
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

    rig = Rig(slow, rate=50.0)
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


def test_a_landing_begins_ahead_even_where_a_rest_behind_is_nearer() -> None:
    rig, rests = Rig(), [entry.rest for entry in tables(swarm=False)["land"].entries]
    rig.begin(0.75)
    times = [rig.sent[-1].setpoints.time]
    assert rests[0] < times[0] < 0.5 * (rests[0] + rests[1])
    rig.pressed.append("land")
    while not rig.course.descending:
        rig.run(1.0 / rig.rate)
        times.append(rig.sent[-1].setpoints.time)
    assert np.max(times) == pytest.approx(rests[1], abs=0.02)
    with pytest.raises(ho.InfeasibleError, match="the landing has begun"):
        rig.course.obey("back")


def test_the_clock_is_led_back_to_where_a_landing_begins() -> None:
    """The last times of a stack have none: drones stand above each other."""
    motion = planned("swarms/stack").motion
    course = CommandedPlan(
        ho.Flight.of(motion), {"land": abort_table(ho.Flight.of(motion), "land", 0.5)}
    )
    course.obey("resume")
    course.step(3.0)
    assert course.obey("land").startswith("landing in ")
    for _ in range(12):
        sent = course.step(1.0)
    assert course.landed
    assert motion.requirements.floor == 0.0
    assert np.all(sent.setpoints.positions[:, 2] <= 1e-6)
