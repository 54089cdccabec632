"""Errors and spreads of flights whose vertices are off by known distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted import NO_WIRES, formed_where, no_poses, regular_hitch, standing, unformed

from hitchopt.hitch import Hitch
from hitchopt.simulation.drone_control import PositionGains
from hitchopt.simulation.error_measures import Spread, tracking_errors, vertex_errors
from hitchopt.simulation.flight_records import Film, Flight, Record
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.simulation_settings import Settings

Array = NDArray[np.float64]


def flight_of(
    task: Task, t: Array, vertices: Array, hitch: Hitch, rested: float = np.nan
) -> Flight:
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
        no_poses(samples).astype(np.float64),
        np.zeros((samples, 0), dtype=np.bool_),
    )
    shapes = np.zeros((samples, 4, 3), dtype=np.float32), np.array([0, 4])
    film = Film(t, *shapes, no_poses(samples), NO_WIRES)
    gains = PositionGains.of(hitch.team, Settings())
    return Flight(
        *(task, record, film, (), None, rested, np.nan, 0.01, np.zeros(n)),
        *(gains, 0.0, None),
    )


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
    np.testing.assert_allclose(errors.without_sag[0], 0.03)
    np.testing.assert_allclose(errors.offsets[0, :, 2], -0.04)
    assert not errors.moving.any()
    shift = np.concatenate([np.zeros(10), np.linspace(0, 0.1, 11)])
    moving = replace(late, vertices=late.vertices + shift[:, None, None])
    again = vertex_errors(flight_of(moving, t, found, hitch))
    np.testing.assert_array_equal(again.moving, [False, *[True] * 10])
    drawn = replace(late, tensions=late.tensions * (1.0 + shift[:, None]))
    tight = vertex_errors(flight_of(drawn, t, found, hitch))
    np.testing.assert_array_equal(tight.moving, [False, *[True] * 10])


def test_the_time_of_rest_counts_as_standing_still_and_the_pull_test_does_not() -> None:
    hitch = regular_hitch(3)
    task = standing(hitch, 0.2)
    shift = np.linspace(0.0, 0.1, len(task.t))[:, None, None]
    moved = replace(task, vertices=task.vertices + shift)
    t = np.append(task.t, [0.4, 0.7, 0.9])
    found = np.repeat(moved.vertices[-1:], len(t), axis=0) + [0.0, 0.0, -0.05]
    errors = vertex_errors(flight_of(moved, t, found, hitch, rested=0.7))
    np.testing.assert_allclose(errors.t, t[1:-1])
    np.testing.assert_array_equal(errors.moving, [True] * (len(t) - 4) + [False] * 2)
    np.testing.assert_allclose(errors.planned[-2:], moved.vertices[[-1, -1]])
    np.testing.assert_allclose(errors.errors[-2:], 0.05)


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
