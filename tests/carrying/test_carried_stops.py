"""Stops and aborts while something is carried, by the checks of the plan that is flown so."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.stops import ClockLimits, stop_phases, stop_table
from hitchopt.live.abort import Abort, Aborts
from hitchopt.live.player import Player
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import on_clock
from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.values import Array
from hitchopt.verify import consistency
from tests.helpers.carried_plans import TO, check, plan, tray

KINDS = ["tray", "drum"]


def during(motion: Motion, name: str, share: float = 0.5) -> float:
    phase = next(p for p in motion.phases if p.name == name)
    return phase.start + share * (phase.end - phase.start)


def balanced(motion: Motion, clock: ClockPhases) -> bool:
    """Whether the plan flown on a clock keeps the object, by the checks of plans."""
    flown = on_clock(motion, clock)
    checks = [RULE_OF[name].check(flown) for name in ("equilibrium", "support", "grip")]
    return all(check is None or check.holds for check in checks)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pause_starts_when_the_carried_object_stays_in_balance(kind: str) -> None:
    """From where it gathers speed; and the clock can start again from there."""
    flown = plan(kind)
    time = during(flown.motion, "carry", 0.2)
    player = Player(flown, time)
    player.pause()
    assert balanced(flown.motion, player.ahead)
    seconds = float(np.sum(player.ahead.duration))
    assert 0.5 < seconds <= flown.certificate["stoppable"].worst
    player.step(seconds)
    assert player.resting
    player.resume()
    assert balanced(flown.motion, player.ahead)
    sooner = stop_phases(np.array([time]), np.array([seconds]))  # at once, as quickly
    assert not balanced(flown.motion, sooner)


@pytest.mark.parametrize("kind", KINDS)
def test_the_clock_restarts_from_every_stop_of_a_carry(kind: str) -> None:
    motion = plan(kind).motion
    limits = ClockLimits(ho.Flight.of(motion))
    table = stop_table(ho.Flight.of(motion), limits)
    rests = table.starts + 0.5 * table.durations
    there = np.flatnonzero(limits.carries(rests))
    assert len(there) > 5
    assert np.all(limits.keep(stop_phases(rests[there], table.durations[there], 0.0), len(there)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_any_commands_keep_the_balance(kind: str) -> None:
    motion = plan(kind).motion
    begin, end = during(motion, "lift", 0.0), during(motion, "set_down", 1.0)
    rng, done = np.random.default_rng(12), 0
    for _ in range(2):
        player = Player(motion, rng.uniform(begin, end))
        for command in rng.choice(["pause", "resume", "back", "seek"], 4):
            given = [rng.uniform(begin, end)] if command == "seek" else []
            try:
                seconds = getattr(player, command)(*given)
            except ho.InfeasibleError:
                assert command not in {"pause", "resume"}
                continue
            done += 1
            assert not len(player.ahead) or balanced(motion, player.ahead)
            player.step(rng.uniform(0.3, 1.0) * seconds)
    assert done > 3


def test_infeasible_rates_of_a_carry_are_refused() -> None:
    player = Player(plan("drum"), 0.5)
    with pytest.raises(ho.InfeasibleError, match=r"no change of .* held object has inertia"):
        player.rate(0.5)
    assert player.clock_rate == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_hold_starts_where_the_balance_permits(kind: str, tmp_path: Path) -> None:
    """In the lift; its certificate is that of polynomials of its own.

    It ends with the tension of the grasp, which the second opinion allows as well.
    """
    motion = plan(kind).motion
    end = during(motion, "lift", 1.0)
    found = Aborts(ho.Flight.of(motion)).plan(end - 1.0, "hold")
    assert found.certificate.certified
    assert found.rest < end + 0.2
    write_plan(tmp_path / "plan.npz", found.flight)
    (told,), _ = second.read(tmp_path / "plan.npz")
    assert {row.verdict for row in consistency.jumps(told)} == {"proven"}


@cache
def carried() -> Aborts:
    """Of a tray that is carried to a table and left, the hitch then led away from there."""
    problem = tray()
    problem["mission"].append({"transport": {"to": [-0.3, 2.6, 1.0]}})
    return Aborts(ho.solve(ho.problem_from_dict(problem)).flight)


def landed(found: Abort) -> Array:
    """Check that it is certified and lands without a jump; return the tray's ends."""
    whole = found.flight
    assert found.certificate.certified
    assert np.max(np.abs(whole.drones.at(whole.duration)[:, 2])) <= 0.2
    left, right = whole.poses.ends(0)
    np.testing.assert_allclose(left[1:], right[:-1], rtol=0.0, atol=1e-9)
    ends: Array = whole.poses.at(np.array([0.0, whole.duration]))[:, 0, :3]
    return ends


@pytest.mark.slow
def test_lifted_objects_are_set_down_first() -> None:
    """Where the plan takes them, or where they came from, whichever is sooner.

    Clasps of a hitch around the tray hang below its drones: it is untied before it lands.
    """
    aborts = carried()
    when = during(aborts.flight.teams[0].motion, "carry", 0.7)
    start, end = landed(aborts.plan(when, "release_and_land"))
    assert min(np.max(np.abs(end - place)) for place in (start, TO)) <= 1e-9
    with pytest.raises(ho.InfeasibleError, match=r"cables would be .* below the ground"):
        aborts.plan(when, "land")


@pytest.mark.slow
def test_before_it_is_lifted_the_hitch_goes_back() -> None:
    aborts = carried()
    found = aborts.plan(during(aborts.flight.teams[0].motion, "grasp"), "release_and_land")
    assert found.rest < during(aborts.flight.teams[0].motion, "grasp", 1.0)
    np.testing.assert_allclose(np.ptp(landed(found), axis=0), 0.0, atol=1e-9)


@pytest.mark.slow
def test_objects_left_in_the_air_are_set_down_at_their_start() -> None:
    names = {"enclose": {"object": "tray"}, "grasp": {"object": "tray"}, "lift": {"by": 0.2}}
    problem = {**tray(), "mission": [{name: keys} for name, keys in names.items()]}
    motion = ho.solve(ho.problem_from_dict(problem)).motion
    found = Aborts(ho.Flight.of(motion)).plan(motion.duration, "release_and_land")
    np.testing.assert_allclose(np.ptp(landed(found), axis=0), 0.0, atol=1e-9)


def test_jumps_of_objects_break_continuity() -> None:
    motion = plan("tray").motion
    poses = motion.poses.coefficients.copy()
    poses[-1, 0, 0] += 1e-3
    found = check(replace(motion, poses=motion.poses.replaced(poses)), "continuity")
    assert (check(motion, "continuity").holds, found.holds) == (True, False)
    assert found.where == ("tray",)
    assert found.worst == pytest.approx(1e-3, abs=1e-6)
