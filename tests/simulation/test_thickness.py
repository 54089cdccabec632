"""Thick ropes: the additional length of their bends, with which they are as long as planned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted import regular_hitch, standing, unformed

import hitchopt as ho
from hitchopt.cli.simulation_tables import flight_tables
from hitchopt.simulation.error_measures import effective_lengths
from hitchopt.simulation.flight_task import read_task
from hitchopt.simulation.rope_thickness import COARSENESS, bend_lengths, thickness_allowance
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import Loss, Settings

DIAMETER = 0.012


@pytest.mark.parametrize("n", [3, 5, 12])
def test_thick_cables_need_as_much_more_as_their_bends_do(n: int) -> None:
    found = thickness_allowance(standing(regular_hitch(n), 0.1), 0.01, 0.0)
    # Drawn as polygons: a circle of one diameter about the other cable, and tangents to the legs.
    turn = 2.0 * np.pi / n
    angle = np.linspace(0.5 * turn, np.pi - 0.5 * turn, 2001) + 0.5 * np.pi
    arc = 0.005 + 0.01 * np.cos(angle) + 1j * 0.01 * np.sin(angle)
    far = np.exp(0.5j * turn)
    path = np.array([far, *arc, far.conjugate()])
    longer = np.sum(np.abs(np.diff(path))) - 2.0
    np.testing.assert_allclose(found, 2.0 * longer, atol=2e-4)
    bends = bend_lengths(standing(regular_hitch(n), 0.1), 0.01, 0.0)
    np.testing.assert_allclose(bends, longer, atol=1e-4)
    coarse = thickness_allowance(standing(regular_hitch(n), 0.1), 0.01, 0.02)
    np.testing.assert_allclose(
        coarse - found, 2.0 * COARSENESS * 0.02**2 / 0.01 * np.cos(0.5 * turn)
    )


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 6])
def test_simulated_cables_are_as_long_as_planned(n: int) -> None:
    """Legs, edges and their arcs add up to the plan's length, whatever the ropes' bends use up."""
    task = standing(regular_hitch(n, cable_friction=0.0), 0.1)
    flight = simulate(task, Settings(body="point", pull_test=False)).flight
    np.testing.assert_allclose(effective_lengths(flight), task.team.cable_length, atol=4e-3)
    assert flight.longer > 0.015  # without which they would be as much too short


def test_lengths_are_told_of_a_hitch_that_is_left() -> None:
    task = standing(regular_hitch(3, cable_friction=0.0), 0.1)
    simulation = simulate(task, Settings(body="point", pull_test=False))
    off = 1e3 * (effective_lengths(simulation.flight) - task.team.cable_length)
    (row,) = [text for text in flight_tables(simulation).splitlines() if "effective" in text]
    assert f"{np.min(off):+.1f}" in row
    assert f"{np.max(off):+.1f}" in row
    flight = replace(simulation.flight, lost=Loss("q0", 0.05))
    assert np.all(np.isnan(effective_lengths(flight)))
    text = flight_tables(replace(simulation, flight=flight))
    assert "effective" not in text
    assert "nan" not in text


def test_no_hitch_no_additional_length() -> None:
    task = unformed(standing(regular_hitch(3), 0.1))
    np.testing.assert_array_equal(thickness_allowance(task, DIAMETER, 0.03), np.zeros(3))
    np.testing.assert_array_equal(bend_lengths(task, DIAMETER, 0.03), np.zeros(3))


def test_what_grips_bends_around_its_object_and_farther_at_clasps(tmp_path: Path) -> None:
    """Cables of a drum's grip follow the path that their thickness makes of the plan's lines."""
    polygon = 0.56 * np.array([[1.0, 0.0], [-0.5, -np.sqrt(0.75)], [-0.5, np.sqrt(0.75)]])
    steps = ({"enclose": {"object": "drum"}}, {"grasp": {"object": "drum", "by": "grip"}})
    problem = {
        "team": {"robots": 3, "cable_length": 1.6, "tension": 1.3, "cable_friction": 0.15},
        "limits": {"tilt_deg": 60},
        "objects": {"drum": {"circle": 0.2, "mass": 0.1, "friction": 0.5, "at": [0.0, 0.0, 0.0]}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 0.8}},
        "mission": [*steps, {"lift": {"by": 0.1}}],
    }
    plan = ho.solve(ho.problem_from_dict(problem))
    task, motion = read_task(plan.save(tmp_path / "plan")), plan.motion
    assert motion.contacts is not None
    layout, t = motion.team.layout, motion.duration
    vertices, drones = motion.vertices.at(t), motion.drones.at(t)
    first, last = np.moveaxis(motion.contacts.at(t), 1, 0)
    path = np.diff(np.stack([drones[0::2], vertices[layout.starts], first], axis=1), axis=1)
    path /= np.linalg.norm(path, axis=-1, keepdims=True)
    turn = np.arccos(np.sum(path[:, 0] * path[:, 1], axis=-1))  # from leg to edge
    away = 0.5 * (first + last)[:, :2] - motion.object_poses.at(t)[0, :2]
    wrapped = 2.0 * np.arccos(np.linalg.norm(away, axis=1) / 0.2)
    found = thickness_allowance(task, DIAMETER, 0.0)
    wanted = 2.0 * DIAMETER * (turn - np.sin(0.5 * turn)) + 0.5 * DIAMETER * wrapped
    np.testing.assert_allclose(found, wanted, atol=1e-3)
    straight = thickness_allowance(replace(task, motion=None), DIAMETER, 0.0)
    assert np.all(found > straight + 0.015)
