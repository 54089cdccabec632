"""The player: any sequence of commands keeps all limits, and ends where it was asked to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from streamed_flights import check_setpoints

import hitchopt as ho
from hitchopt.live.player import Player
from hitchopt.trajectory import PiecewisePolynomial

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
STEP = 0.01


@cache
def plan_of() -> ho.Plan:
    """A triangle off the origin that moves a vertex and is carried."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE)
    steps = ho.MoveVertex(0, by=np.array([0.0, 0.4])), ho.Transport(np.array([1.4, 2.2, 1.3]), 0.5)
    return ho.solve(ho.Problem(start.team, start, steps))


def ran(player: Player, seconds: float) -> list[ho.Setpoints]:
    """Setpoints over some time; each keeps the limits and follows from the one before."""
    found = [player.step(0.0), *(player.step(STEP) for _ in range(int(seconds / STEP) + 1))]
    check_setpoints(found, player.motion.requirements.limits, STEP)
    return found


def test_at_full_rate_it_is_the_plan() -> None:
    plan, player = plan_of(), Player(plan_of())
    for _ in range(30):
        here = player.step(0.07)
        states = plan.at(here.time)
        np.testing.assert_allclose(here.positions, states.positions, atol=1e-12)
        np.testing.assert_allclose(here.velocities, states.velocities, atol=1e-10)
        np.testing.assert_allclose(here.accelerations, states.accelerations, atol=1e-8)
        np.testing.assert_allclose(here.jerks, states.jerks, atol=1e-5)


COMMANDS: dict[str, Callable[[Player, float], float]] = {
    "pause": lambda player, _: player.pause(),
    "resume": lambda player, _: player.resume(),
    "back": lambda player, _: player.back(),
    "half": lambda player, _: player.rate(0.5),
    "seek": Player.seek,
}


@pytest.mark.parametrize("seed", range(6))
def test_any_commands_keep_all_limits_and_a_pause_ends_in_rest(seed: int) -> None:
    plan, rng = plan_of(), np.random.default_rng(seed)
    player = Player(plan, rng.uniform() * plan.duration)
    for name in rng.choice(list(COMMANDS), 2):
        share = float(rng.uniform())
        ran(player, share * COMMANDS[name](player, share * plan.duration))
    seconds = player.pause()
    assert seconds <= max(np.max(player.stops.longest[0]) * 3.0, 3.0)
    last = ran(player, seconds)[-1]
    assert player.resting
    assert np.max(np.abs(last.velocities)) <= 1e-9
    np.testing.assert_allclose(last.positions, plan.at(last.time).positions, atol=1e-12)


def test_a_pause_takes_no_longer_than_the_certificate_reports() -> None:
    plan = plan_of()
    most = plan.certificate["stoppable"].bound
    for time in np.random.default_rng(3).uniform(0.0, plan.duration, 12):
        player = Player(plan, float(time))
        seconds = player.pause()
        assert seconds <= most + 1e-9
        player.step(0.3 * seconds)
        assert player.pause() <= 0.7 * seconds + 1e-9  # asked again
        before, here, after = (player.step(each) for each in (0.0, 1e-4, 1e-4))
        for values, slopes in (("positions", "velocities"), ("accelerations", "jerks")):
            change = getattr(after, values) - getattr(before, values)
            np.testing.assert_allclose(change / 2e-4, getattr(here, slopes), atol=0.02)
        player.step(seconds)
        assert player.resting


def test_seeking_and_going_back_end_at_the_plan_time() -> None:
    plan = plan_of()
    player = Player(plan, 0.3 * plan.duration)
    for share in (0.8, 0.1, 0.0, 1.0, 0.6):
        ran(player, player.seek(share * plan.duration))
        assert player.resting
        assert player.time == pytest.approx(share * plan.duration, abs=1e-9)
    player.back()
    last = ran(player, plan.duration + 2.0)[-1]
    assert (last.time, last.rate) == (0.0, 0.0)
    np.testing.assert_allclose(last.positions, plan.at(0.0).positions, atol=1e-12)


def test_where_legs_lean_there_is_no_way_back() -> None:
    motion = plan_of().motion
    breaks, pulls = motion.drones.breaks, np.repeat(motion.tensions.coefficients[:, :, None], 2, 2)
    first, last = np.searchsorted(breaks, [0.4, 0.7]).tolist()
    pulls[first:last, :, 0] *= 1.05
    leaning = replace(motion, leg_tensions=PiecewisePolynomial(breaks, pulls))
    begin, end = (float(breaks[i]) for i in (first, last))
    player = Player(leaning, 0.5 * (begin + end))
    with pytest.raises(ho.InfeasibleError, match="lean against friction"):
        player.back()
    assert player.clock_rate == 1.0
    player = Player(leaning, 1.5)
    with pytest.raises(ho.InfeasibleError, match="lean against friction"):
        player.rate(-0.5)
    ran(player, player.back())
    assert player.time == pytest.approx(end)
    with pytest.raises(ho.InfeasibleError, match="no change of the clock"):
        player.seek(0.2)


def test_drones_that_swing_about_their_places_can_go_back() -> None:
    team = ho.Team(3, 2.4, tension=0.6, cable_friction=0.1)
    plan = ho.Mission(team, ho.Hitch.spread(team, TRIANGLE, 1.2)).settle().solve()
    player = Player(plan, 5.0)
    player.back()
    last = ran(player, 8.0)[-1]
    assert (last.time, last.rate) == (0.0, 0.0)


def test_wrong_arguments_are_named() -> None:
    player = Player(plan_of())
    for key, call, *given in (
        ("plan", Player, 3),
        ("time", Player, plan_of(), -0.1),
        ("rate", player.rate, 1.2),
        ("time", player.seek, 1e3),
    ):
        with pytest.raises(ho.InputError, match=f"^{key}"):
            call(*given)
