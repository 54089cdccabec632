"""Several groups fly on one clock: it stops, seeks and aborts for all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.live.abort import Aborts, AbortTable
from hitchopt.live.fly import CommandedPlan
from hitchopt.motion.states import flight_states_at
from tests.helpers.groups import (
    alone,
    beside,
    hitch_and_swarm,
    moved,
    two_hitches,
)

MOTIONS = {"two hitches": two_hitches, "hitch and swarm": hitch_and_swarm}


@pytest.mark.parametrize("kind", MOTIONS)
def test_the_clock_is_that_of_all(kind: str) -> None:
    """Setpoints of each group are those of its own plan at the common plan time and rate."""
    flight = MOTIONS[kind]()
    player = ho.Player(flight)
    player.step(0.5 * flight.duration)
    for seconds in (0.5 * player.pause(), 20.0):
        target = player.step(seconds)
        first = 0
        for group in flight.teams:
            own, count = ho.Player(group.motion, target.time), group.motion.team.drones
            there = own.step(0.0)
            here = slice(first, first + count)
            np.testing.assert_allclose(target.positions[here], there.positions, atol=1e-12)
            np.testing.assert_allclose(
                target.velocities[here], target.rate * there.velocities, atol=1e-12
            )
            first += count
    assert player.resting
    player.seek(0.1)
    assert player.step(60.0).time == pytest.approx(0.1)
    player.resume()
    assert player.step(60.0).time == flight.duration


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize("how", ["hold", "land"])
def test_aborts_hold_for_all(kind: str, how: str) -> None:
    flight = MOTIONS[kind]()
    plan = ho.Plan(flight, certify(flight), kind).abort(0.5 * flight.duration, how)
    whole = plan.flight
    assert plan.certificate.certified
    assert [each.name for each in whole.teams] == [each.name for each in flight.teams]
    t = np.linspace(0.0, 0.5 * flight.duration, 9)
    np.testing.assert_allclose(whole.drones.at(t), flight.drones.at(t), atol=1e-12)
    assert np.max(np.abs(flight_states_at(whole, [whole.duration]).velocities)) < 1e-9
    if how == "land":
        for each in whole.teams:
            assert np.min(each.motion.drones.at(whole.duration)[:, 2]) == pytest.approx(
                0.0, abs=1e-9
            )
            named = [phase.name for phase in each.motion.phases if phase.name != "wait"]
            assert named[-1] == "land"


def test_an_abort_unties_each_hitch() -> None:
    whole = Aborts(hitch_and_swarm()).plan(1.0, "release_and_land").flight
    names = {each.name: [phase.name for phase in each.motion.phases] for each in whole.teams}
    assert names["triangle"][-1] == "land"
    assert "unswap 1" in names["triangle"]
    assert "unswap 1" not in names["ring"]


def test_back_leads_to_where_all_hang_free() -> None:
    with pytest.raises(ho.InfeasibleError, match="cables of triangle were never free"):
        Aborts(hitch_and_swarm()).plan(1.0, "back")


def test_aborts_keep_off_others() -> None:
    """A hitch that stops where somebody else passes later does not stay there."""
    motion, passing = (alone(two_hitches(), name) for name in "ab")
    asked = 0.5 * 10.0
    held = Aborts(beside(motion, moved(passing, 0.0, 0.0, 50.0), 0.0)).plan(asked, "hold")
    assert held.start == asked
    assert [each.name for each in held.flight.others] == ["show"]
    crossed = beside(motion, passing, 0.0)
    assert certify(crossed, reports=()).certified
    found = Aborts(crossed).plan(asked, "hold")
    assert found.certificate.certified
    assert found.start > asked + 0.5
    stays = replace(held.flight, others=crossed.others)
    assert not certify(stays, reports=()).certified


def test_a_fleet_flies_by_commands() -> None:
    flight = hitch_and_swarm()
    land = AbortTable("land", (Aborts(flight).plan(1.0, "land"),), flight.duration)
    plan = CommandedPlan(flight, {"land": land, "abort": land})
    plan.obey("resume")
    sent = plan.step(1.5)
    state = flight_states_at(flight, [sent.setpoints.time])
    assert sent.setpoints.rate == pytest.approx(1.0)
    np.testing.assert_allclose(sent.thrusts, state.thrusts(flight.team)[0], atol=1e-9)
    plan.obey("land")
    for _ in range(400):
        plan.step(0.1)
        if plan.landed:
            break
    assert plan.landed
