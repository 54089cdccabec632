"""Drones with trims and thrust factors that plans state: tilts explain trims."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.control import FlownDrones
from hitchopt.lab.simulation.report import Simulation
from hitchopt.lab.simulation.settings import Perturbations, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import RigidBodies
from tests.helpers.plans import planned
from tests.helpers.scripted import changed

OFF: dict[str, Any] = {
    "q0": {"trim": [0.1, 0.0], "thrust_factor": 1.1},
    "r1": {"trim": [-0.03, 0.08]},
}


def task() -> Task:
    return Task.of(planned("form_triangle").flight)


def known_task() -> Task:
    """The task of a plan that states how its drones are off."""
    plain = task()
    assert plain.team.assignment is not None
    return changed(plain, team=plain.team.assignment.team(ho.Team(3, 2.4, quadrotor=OFF)))


def place(drone: str) -> int:
    """The index of a drone by its name in the problem."""
    return task().team.drone_names.index(drone)


def drones(**given: Any) -> FlownDrones:
    stiffness = np.full((6, 3), 4.75)
    return FlownDrones.of(known_task(), Settings(**given), stiffness)


def test_tilts_explain_trims() -> None:
    """A level force k · trim leans the thrust that the controller wants as far as its frame."""
    found, mass = drones(), task().team.mass
    still, upright = np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1))
    bodies = RigidBodies(still, still, upright, np.ones((6, 3)))
    measured = found.measured(bodies)
    for name, trim in (("q0", [0.1, 0.0]), ("r1", [-0.03, 0.08]), ("r0", [0.0, 0.0])):
        i = place(name)
        wanted = np.array([*(4.75 * np.array(trim)), mass[i] * GRAVITY])
        axis = wanted / np.linalg.norm(wanted)
        np.testing.assert_allclose(measured.attitudes[i, :, 2], axis, atol=1e-12)
    moments = np.random.default_rng(0).normal(size=(6, 3))
    thrusts, turned = found.actual(np.ones(6), moments)
    np.testing.assert_allclose(thrusts, np.where(np.arange(6) == place("q0"), 1.0 / 1.1, 1.0))
    np.testing.assert_allclose(  # power is the same in both frames
        np.sum(turned * bodies.rates, axis=1), np.sum(moments * measured.rates, axis=1)
    )
    assert found.drag == 0.0
    assert drones(perturbations=Perturbations(rotor_drag=0.012)).drag == 0.012


def test_plans_add_the_trims_that_they_know() -> None:
    np.testing.assert_allclose(drones().trims[place("q0")], [0.1, 0.0, 0.0])
    nominal = FlownDrones.of(task(), Settings(), np.full((6, 3), 4.75))
    np.testing.assert_array_equal(nominal.trims, np.zeros((6, 3)))
    np.testing.assert_array_equal(nominal.turns, np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_array_equal(nominal.thrust_factors, np.ones(6))
    assert nominal.drag == 0.0


@pytest.mark.slow
def test_drones_hover_at_their_places_with_trims_that_the_plan_states() -> None:
    settings = Settings(controller="mellinger", pull_test=False)
    record = Simulation.of(known_task(), settings).flight.record
    off = (record.drones - record.commanded)[100, :, :2]  # still hovering
    np.testing.assert_allclose(off[[place("q0"), place("r1")]], 0.0, atol=0.03)
