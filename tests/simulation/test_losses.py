"""Drones whose motors stop in a simulated flight, with the reaction of the others and without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted import regular_hitch, standing

import hitchopt as ho
from hitchopt.losing.flown_reaction import reacting
from hitchopt.losing.reaction import Reactions
from hitchopt.simulation import rope_flight
from hitchopt.simulation.flight_outcome import judge
from hitchopt.simulation.flight_records import Touch
from hitchopt.simulation.flight_task import read_task
from hitchopt.simulation.lost_drones import loss_outcome
from hitchopt.simulation.rope_flight import fly
from hitchopt.simulation.simulation_settings import ACCURATE, FAST, Loss, Preset, Settings


@pytest.mark.parametrize("text", ["q0", "q0@", "@1.0", "q0@soon", "q0@nan"])
def test_what_is_no_loss_is_refused(text: str) -> None:
    with pytest.raises(ho.InputError, match=r"write q0@12\.5"):
        Loss.parsed(text)
    assert Loss.parsed("r2@0.5") == Loss("r2", 0.5)


@pytest.mark.parametrize(
    ("loss", "words"), [(Loss("q9", 0.1), "one of q0"), (Loss("q0", 9.0), "before the flight ends")]
)
def test_a_loss_that_cannot_be_is_refused(loss: Loss, words: str) -> None:
    task = standing(regular_hitch(3), 0.5)
    with pytest.raises(ho.InputError, match=words):
        fly(task, Settings(lost=loss))


@pytest.mark.parametrize("preset", [FAST, ACCURATE])
def test_steps_are_finer_after_a_loss(preset: Preset) -> None:
    """Ropes that run over the lost drone's clasp strain too much with the preset's own."""
    settings = Settings(lost=Loss("q0", 0.01), preset=preset, pull_test=False)
    run = rope_flight._Run(standing(regular_hitch(3), 0.02), settings, None)
    used = []
    for time in (0.0, 0.02):
        run._step(time, 0, 1.0)
        used.append(run._world.model.opt.timestep)
    assert used[0] == preset.time_step
    assert used[1] <= min(preset.time_step / 3.0, 0.00034) * (1.0 + 1e-9)


@pytest.mark.slow
def test_a_reaction_lowers_the_tension(tmp_path: Path) -> None:
    """The lost drone falls, none of the others touch, and their cables pull less."""
    team = ho.Team(robots=3, cable_length=2.2, tension=0.5)
    corners = [[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
    plan = ho.hold(ho.Hitch.spread(team, corners, altitude=1.0), 1.2)
    task, loss = read_task(plan.save(tmp_path)), Loss("r1", 0.3)
    settings = Settings(lost=loss)
    without = fly(task, settings)
    flight = fly(reacting(task, Reactions(plan.motion).found("r1", 0.3)), settings)
    before, after = loss_outcome(without, loss), loss_outcome(flight, loss)
    assert flight.error is None
    assert without.error is None
    assert before.apart
    assert after.apart
    assert after.peak_tension < before.peak_tension
    assert after.dropped > 0.8
    assert after.hangs < 0.1
    record, lost = flight.record, team.drone_names.index("r1")
    assert np.max(record.thrusts[record.t > 0.5, lost]) < 1e-3
    assert judge(flight).failures == ()


@pytest.mark.slow
def test_who_pushes_inward_stays_inward(tmp_path: Path) -> None:
    """Survivors that do not push are back at their setpoints once the lost drone lies."""
    team = ho.Team(robots=3, cable_length=2.2, tension=0.5)
    corners = [[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
    plan = ho.hold(ho.Hitch.spread(team, corners, altitude=2.0), 1.0)
    task, loss = read_task(plan.save(tmp_path)), Loss("q0", 0.2)
    found = Reactions(plan.motion).found("q0", 0.2)
    assert found.inward is not None
    out = []
    for inward in (None, found.inward):
        record = fly(reacting(task, replace(found, inward=inward)), Settings(lost=loss)).record
        late = np.argmin(np.abs(record.t - 1.7))
        level = record.drones[late, 1:, :2]
        out.append(float(np.mean(np.linalg.norm(level - np.mean(corners, axis=0), axis=-1))))
    assert out[0] - out[1] > 0.1


@pytest.mark.slow
def test_contacts_are_those_of_survivors() -> None:
    task = standing(regular_hitch(3), 0.3)
    loss = Loss("q0", 0.05)
    flight = fly(task, Settings(lost=loss, body="point"))
    touches = (
        Touch(0.01, "r0", "r1"),
        Touch(0.1, "q0", "cable 2"),
        Touch(0.1, "q1", "r2"),
        Touch(0.2, "q0", "r2"),
        Touch(0.2, "r1", "cable 0"),
    )
    flight = replace(flight, touches=touches)
    outcome = loss_outcome(flight, loss)
    assert outcome.among == touches[2:3]
    assert outcome.others == touches[3:]
    found = [failure.where for failure in judge(flight).failures]
    assert found == [("r0", "r1"), ("q1", "r2"), ("q0", "r2"), ("r1", "cable 0")]
