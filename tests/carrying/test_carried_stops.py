"""Stops while something is carried, by the checks of the plan that is flown on their clocks."""

from __future__ import annotations

import numpy as np
import pytest
from carried_plans import plan

import hitchopt as ho
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.stops import stop_phases
from hitchopt.live.abort import Aborts
from hitchopt.live.player import Player
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import retimed
from hitchopt.trajectory.clock_phases import ClockPhases

KINDS = ["tray", "drum"]


def carried(motion: Motion) -> tuple[float, float]:
    """When the object begins to move and when it stands again [s]."""
    speeds = motion.object_poses.differentiated().coefficients[:, 0]
    on = np.flatnonzero(np.any(np.abs(speeds) > 1e-6, axis=(1, 2)))
    return float(motion.drones.breaks[on[0]]), float(motion.drones.breaks[on[-1] + 1])


def balanced(motion: Motion, clock: ClockPhases) -> bool:
    """Whether the plan flown on a clock keeps the object, by the checks of plans."""
    flown = retimed(motion, clock)
    checks = [RULE_OF[name].check(flown) for name in ("equilibrium", "support", "grip")]
    return all(check is None or check.holds for check in checks)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pause_waits_until_what_is_carried_stays_in_balance(kind: str) -> None:
    """From where it gathers speed; and the clock can start again from there."""
    flown = plan(kind)
    carry = next(p for p in flown.motion.phases if p.name == "carry")
    time = carry.start + 0.2 * (carry.end - carry.start)
    player = Player(flown, time)
    player.pause()
    assert balanced(flown.motion, player.ahead)
    seconds = float(np.sum(player.ahead.duration))
    assert 0.5 < seconds <= flown.certificate["stoppable"].bound
    player.step(seconds)
    assert player.resting
    player.resume()
    assert balanced(flown.motion, player.ahead)
    sooner = stop_phases(np.array([time]), np.array([seconds]))  # at once, as quickly
    assert not balanced(flown.motion, sooner)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_any_commands_keep_the_balance(kind: str) -> None:
    motion = plan(kind).motion
    begin, end = carried(motion)
    rng, done = np.random.default_rng(12), 0
    for _ in range(2):
        player = Player(motion, rng.uniform(begin, end))
        for command in rng.choice(["pause", "resume", "back", "rate", "seek"], 4):
            given = {"rate": [0.5], "seek": [rng.uniform(begin, end)]}.get(command, [])
            try:
                seconds = getattr(player, command)(*given)
            except ho.InfeasibleError:
                assert command not in {"pause", "resume"}
                continue
            done += 1
            clock = player.ahead
            if command == "rate" and len(clock):
                jet = clock.ends[-1:] * [1.0, 1.0, 0.0, 0.0]
                left = 2.0 * (motion.duration - jet[:, 0])
                clock = clock.followed_by(ClockPhases(np.zeros(1, int), jet, left))
            assert not len(clock) or balanced(motion, clock)
            player.step(rng.uniform(0.3, 1.0) * seconds)
    assert done > 3


def test_a_rate_at_which_nothing_can_be_carried_is_refused() -> None:
    player = Player(plan("drum"), 0.5)
    with pytest.raises(ho.InfeasibleError, match=r"no change of .* carried has inertia"):
        player.rate(0.5)
    assert player.clock_rate == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_hold_begins_where_the_balance_allows(kind: str) -> None:
    """In the lift; its certificate is that of polynomials of its own."""
    motion = plan(kind).motion
    lift = next(p for p in motion.phases if p.name == "lift")
    found = Aborts(motion).found(lift.end - 1.0, "hold")
    assert found.certificate.certified
    assert found.rest < lift.end + 0.2
