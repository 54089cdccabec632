"""Errors, sags and spreads, each computed by an independent method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scripted import formed_where, regular_hitch, standing, unformed

from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.error_measures import Spread, tracking_errors, vertex_errors
from hitchopt.simulation.flight_records import Film, Flight, Record
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.hitch_sag import predicted_sag

Array = NDArray[np.float64]


def flight_of(task: Task, t: Array, vertices: Array, hitch: Hitch) -> Flight:
    n, samples = hitch.team.robots, len(t)
    drones = np.repeat(hitch.drones[None], samples, axis=0)
    record = Record(
        t,
        drones + [0.03, 0.0, 0.04],
        drones,
        vertices,
        np.ones(vertices.shape[:2]),
        np.ones((samples, n)),
        np.ones((samples, n)),
        np.ones((samples, 2 * n)),
        np.zeros((samples, 2 * n), dtype=np.bool_),
    )
    film = Film(t, np.zeros((samples, 4, 3), dtype=np.float32), np.array([0, 4]))
    return Flight(task, record, film, (), None, np.nan, np.nan, 0.01, np.zeros(n), None)


def test_errors_are_distances_where_there_is_a_hitch() -> None:
    hitch = regular_hitch(3)
    task = standing(hitch, 0.2)
    late = formed_where(task, hitch, np.arange(len(task.t)) >= 10)
    t = np.append(np.minimum(task.t + 0.003, 0.2), 0.9)  # the last one is after the flight
    found = np.repeat(hitch.vertices[None], len(t), axis=0) + [0.0, 0.03, -0.04]
    found[-2, 1] = np.nan
    errors = vertex_errors(flight_of(late, t, found, hitch))
    np.testing.assert_allclose(errors.t, t[10:-1])
    np.testing.assert_allclose(errors.errors[:-1], 0.05)
    np.testing.assert_array_equal(np.isnan(errors.errors[-1]), [False, True, False])
    assert errors.lost == pytest.approx(1 / 33)
    sag = errors.sag[0, 0]
    np.testing.assert_allclose(errors.without_sag[0], np.hypot(0.03, sag - 0.04))
    assert not errors.moving.any()
    shift = np.concatenate([np.zeros(10), np.linspace(0, 0.1, 11)])
    moving = replace(late, vertices=late.vertices + shift[:, None, None])
    again = vertex_errors(flight_of(moving, t, found, hitch))
    np.testing.assert_array_equal(again.moving, [False, *[True] * 10])


def test_a_flight_without_a_hitch_has_no_errors() -> None:
    hitch = regular_hitch(3)
    task = unformed(standing(hitch, 0.1))
    found = np.repeat(hitch.vertices[None], len(task.t), axis=0)
    flight = flight_of(task, task.t, found, hitch)
    errors = vertex_errors(flight)
    assert errors.errors.shape == (0, 3)
    assert errors.lost == 0.0
    assert np.isnan(Spread.of(errors.errors).mean)
    np.testing.assert_allclose(tracking_errors(flight), 0.05)


def test_a_spread_leaves_out_what_is_not_there() -> None:
    found = Spread.of(np.array([1.0, np.nan, 3.0]))
    assert (found.mean, found.deviation, found.largest) == (2.0, 1.0, 3.0)


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_the_predicted_sag_has_the_least_energy(topology: str) -> None:
    """Cables of constant tension and weight: lengths times tension plus weight times height."""
    points = np.array([[1.2, 0.7], [0.9, 1.9], [2.0, 2.3], [2.6, 1.1]])
    n = 4 if topology == "closed" else 3
    tension = np.array([0.5, 0.55, 0.52, 0.5])[:n]
    density = 1e-3  # small sags: the balance is linear in them
    team = Team(n, 2.6, topology=topology, tension=tension, cable_density=density)
    hitch = Hitch.balanced(team, points, 1.1)
    layout = team.layout
    drones, vertices = hitch.drones, hitch.vertices

    def energy(heights: Array) -> float:
        p = vertices.copy()
        p[layout.clasps, 2] = 1.1 - 1e-2 * heights
        total = 0.0
        for k in range(n):
            a, b = p[layout.starts[k]], p[layout.ends[k]]
            for x, y in ((drones[2 * k], a), (a, b), (b, drones[2 * k + 1])):
                length = float(np.linalg.norm(y - x))
                flat = float(np.linalg.norm((y - x)[:2]))
                total += tension[k] * length
                total += GRAVITY * density * flat * 0.5 * (x[2] + y[2])
        return 1e3 * total

    best = minimize(energy, np.zeros(len(layout.clasps)), method="BFGS", options={"gtol": 1e-5})
    found = predicted_sag(team, density, drones, vertices, tension)
    np.testing.assert_allclose(found[layout.clasps], 1e-2 * best.x, rtol=2e-3)
    if topology == "open":
        np.testing.assert_array_equal(found[[0, -1]], 0.0)
    np.testing.assert_allclose(
        predicted_sag(team, 3 * density, drones, vertices, 2 * tension), 1.5 * found
    )


def test_drones_that_give_way_pull_harder_and_the_hitch_hangs_less() -> None:
    hitch = regular_hitch(5)
    team, leg, edge = hitch.team, 0.5, 1.3
    drones, vertices, planned = hitch.drones, hitch.vertices, team.tension
    sag = predicted_sag(team, 0.01, drones, vertices, planned, 4.75)[0]
    # All vertices hang alike: one unknown, solved by bisection of the tension's own equation.
    low, high = planned[0], 2.0 * planned[0]
    for _ in range(60):
        tension = 0.5 * (low + high)
        deep = GRAVITY * 0.01 * leg * (leg + edge) / (2.0 * tension)
        bent = (GRAVITY * 0.01 / tension) ** 2 * (2.0 * leg**3 + edge**3) / 24.0
        pulls = planned[0] + 0.5 * 4.75 * (2.0 * deep**2 / (2.0 * leg) + bent)
        low, high = (tension, high) if pulls > tension else (low, tension)
    assert sag == pytest.approx(deep, rel=1e-5)
    assert sag < 0.95 * predicted_sag(team, 0.01, drones, vertices, planned)[0]
