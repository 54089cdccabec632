"""Drones whose motors stop in a simulated flight, with the reaction of the others and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scripted import flight_of, regular_hitch, standing

import hitchopt as ho
from hitchopt.live.lost import Reactions, reacting
from hitchopt.simulation.flight import fly
from hitchopt.simulation.judgement import judge, loss_outcome
from hitchopt.simulation.settings import Loss, Settings
from hitchopt.simulation.task import read_task


def test_a_loss_that_cannot_be_is_refused() -> None:
    assert Loss.parsed("r2@0.5") == Loss("r2", 0.5)
    for text in ("q0", "q0@", "@1.0", "q0@soon", "q0@nan"):
        with pytest.raises(ho.InputError, match=r"write q0@12\.5"):
            Loss.parsed(text)
    task = standing(regular_hitch(3), 0.5)
    wrong = (Loss("q9", 0.1), "one of q0"), (Loss("q0", 9.0), "before the flight ends")
    for loss, words in wrong:
        with pytest.raises(ho.InputError, match=words):
            fly(task, Settings(lost=loss))


@pytest.mark.slow
def test_a_reaction_lowers_the_tension(tmp_path: Path) -> None:
    """The lost drone falls, none of the others touch, and their cables pull less."""
    team = ho.Team(robots=3, cable_length=2.2, tension=0.5)
    corners = [[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
    plan = ho.hold(ho.Hitch.spread(team, corners, altitude=1.0), 1.2)
    task, loss = read_task(plan.save(tmp_path)), Loss("r1", 0.3)
    flight = fly(reacting(task, Reactions(plan.motion).found("r1", 0.3)), Settings(lost=loss))
    after = loss_outcome(flight)
    assert after is not None
    assert after.apart
    assert after.peak_tension < 4.4  # less than any without a reaction
    assert after.hangs < 0.1
    record, lost = flight.record, team.drone_names.index("r1")
    assert np.max(record.thrusts[record.t > 0.5, lost]) < 1e-3
    assert judge(flight).failures == ()


def test_contacts_are_those_of_survivors() -> None:
    hitch, loss = regular_hitch(3), Loss("q0", 0.05)
    task, t = standing(hitch, 0.3), np.linspace(0.0, 0.3, 31)
    touches = {
        ("r0", "r1"): 0.01,
        ("q0", "cable 2"): 0.1,
        ("q1", "r2"): 0.1,
        ("q0", "r2"): 0.2,
        ("r1", "cable 0"): 0.2,
    }
    drones = np.repeat(hitch.drones[None], len(t), axis=0)
    drones[t > 0.1, 0, 2] = 0.5  # q0 falls
    drones[t > 0.1, 3] += [0.03, 0.04, 0.0]
    peaks = np.where(t > 0.04, 2.0, 7.0)[:, None] * np.ones(3)
    parts = {"drones": drones, "peak_tensions": peaks, "touches": touches}
    parts["linking"] = np.ones((3, 3), dtype=np.int64) - np.eye(3, dtype=np.int64)
    flight = flight_of(task, hitch, t, settings=Settings(lost=loss), **parts)
    outcome = loss_outcome(flight)
    assert outcome is not None
    assert outcome.among == (("q1", "r2"),)
    assert outcome.others == (("q0", "r2"), ("r1", "cable 0"))
    assert outcome.linked == ("p0", "p1", "p2")
    assert outcome.moved == pytest.approx(0.05)
    assert outcome.peak_tension == 2.0
    mean = (11 * hitch.drones[0, 2] + 20 * 0.5) / 31
    assert outcome.hangs == pytest.approx(mean - 0.03)
    assert loss_outcome(flight_of(task, hitch, t)) is None
    found = [failure.where for failure in judge(flight).failures]
    assert found == [("r0", "r1"), ("q1", "r2"), ("q0", "r2"), ("r1", "cable 0")]
