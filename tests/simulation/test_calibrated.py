"""Drones as calibrated: tilts that explain trims, thrust factors, and names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import FileError
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.control import (
    ROTOR_DRAG,
    FlownDrones,
    calibrated_kinds,
    read_calibrated,
)
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
    return FlownDrones.of(task(), Settings(as_calibrated=OFF, **given), stiffness)


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
    assert (found.drag, drones(perturbations=Perturbations(rotor_drag=0.0)).drag) == (
        ROTOR_DRAG,
        0.0,
    )


def test_plans_add_the_trims_that_they_know() -> None:
    plain, known = task(), known_task()
    stiffness = np.full((6, 3), 4.75)
    found = FlownDrones.of(known, Settings(), stiffness)
    np.testing.assert_allclose(found.trims[place("q0")], [0.1, 0.0, 0.0])
    np.testing.assert_allclose(found.turns, drones().turns)
    assert not np.any(drones().trims)  # known to nobody
    nominal = FlownDrones.of(plain, Settings(), stiffness)
    np.testing.assert_array_equal(nominal.trims, np.zeros((6, 3)))
    np.testing.assert_array_equal(nominal.turns, np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_array_equal(nominal.thrust_factors, np.ones(6))
    assert nominal.drag == 0.0


def test_names_of_calibrated_drones_are_those_of_the_team(tmp_path: Path) -> None:
    with pytest.raises(ho.InputError, match=r"as_calibrated\.quadrotor\.q9: .*no such drone"):
        calibrated_kinds(task().team, {"q9": {"trim": [0, 0]}})
    text = "quadrotor: {q0: {trim: [0.1, 0.0], thrust_factor: 1.1}, r1: {trim: [-0.03, 0.08]}}\n"
    for prefix in ("", "team: {robots: 3, cable_length: 2, "):
        (tmp_path / "drones.yaml").write_text(prefix + text.strip() + "}" * bool(prefix) + "\n")
        assert read_calibrated(tmp_path / "drones.yaml") == OFF
    (tmp_path / "drones.yaml").write_text("[1, 2]\n")
    with pytest.raises(FileError, match="contains no drones"):
        read_calibrated(tmp_path / "drones.yaml")


@pytest.mark.slow
def test_drones_hover_beside_their_places_by_their_trims_unless_the_plan_knows_them() -> None:
    plain, known = task(), known_task()
    settings = Settings(controller="mellinger", pull_test=False)
    for each, setup, left in (
        (plain, replace(settings, as_calibrated=OFF), 1.0),
        (known, settings, 0.0),
    ):
        record = Simulation.of(each, setup).flight.record
        off = (record.drones - record.commanded)[100, :, :2]  # still hovering
        np.testing.assert_allclose(off[place("q0")], [-0.1 * left, 0.0], atol=0.03)
        np.testing.assert_allclose(off[place("r1")], [0.03 * left, -0.08 * left], atol=0.03)
