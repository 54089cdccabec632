"""Flights that leave what their plans are certified for: tracking, tensions, ground, walls."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.lab.simulation.departures import MAX_TENSION_RATIO, departures
from hitchopt.lab.simulation.judgement import judge
from hitchopt.lab.simulation.record import Film, SimulatedFlight
from hitchopt.lab.simulation.settings import Loss, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.values import Array
from tests.helpers.scripted import changed, flight_of, regular_hitch, resting_task

HITCH = regular_hitch(3)
T = np.arange(0.0, 2.005, 0.01)


def task(tracking: Any = None, arena: ho.Arena | None = None) -> Task:
    """Return the task of a hitch at rest for a second."""
    limits = ho.Limits(tracking=tracking)
    plan = ho.solve(HITCH, ho.Hold(seconds=1.0), limits=limits, arena=arena)
    return Task.of(plan.flight)


def moved(drone: int, offset: Any, after: float = 0.5) -> Array:
    """Return drones (samples, 2n, 3) [m] of which one is elsewhere after a time [s]."""
    drones = np.repeat(HITCH.drones[None], len(T), axis=0)
    drones[after + 0.005 < T, drone] += offset
    return drones


def kinds(flight: SimulatedFlight) -> list[Any]:
    """Return the kinds, names and times of departures."""
    return [(each.kind, each.where, each.time) for each in departures(flight)]


@pytest.mark.parametrize(
    ("tracking", "off", "fails"),
    [
        (0.03, [0.02, 0.02, 0.0], False),
        (0.03, [0.0, 0.025, -0.02], True),
        (None, [0.3, 0.0, 0.0], False),  # no errors are stated
        (ho.Tube(0.03, 0.09), [0.01, 0.0, -0.08], False),
        (ho.Tube(0.03, 0.09), [0.02, 0.0, -0.08], True),
    ],
)
def test_drones_beyond_the_stated_tracking_errors_fail(
    tracking: Any, off: list[float], fails: bool
) -> None:
    flight = flight_of(task(tracking), HITCH, T, drones=moved(3, off))
    assert kinds(flight) == ([("off", ("r1",), pytest.approx(0.51))] if fails else [])
    if fails:
        (failure,) = departures(flight)
        assert f"r1 is {100 * np.linalg.norm(off):.3g} cm off at t = 0.51 s (hold)" in failure.words
        assert failure in judge(flight).failures


def test_errors_after_the_plan_and_after_a_loss_do_not_count() -> None:
    stated = task(0.03)
    later = flight_of(stated, HITCH, T, drones=moved(0, [0.0, 0.0, -0.5], after=1.2))
    assert kinds(later) == []
    lost = Settings(lost=Loss("0", 0.4))
    falls = flight_of(stated, HITCH, T, drones=moved(0, [0.0, 0.0, -0.5]), settings=lost)
    assert kinds(falls) == []


def test_a_cable_pulled_far_beyond_the_largest_planned_tension_fails() -> None:
    planned = float(HITCH.team.tension[0])
    for ratio, fails in ((0.99, False), (1.01, True)):
        peaks = np.full((len(T), 3), planned)
        peaks[70, 2] = ratio * MAX_TENSION_RATIO * planned
        peaks[-5:] = 20.0 * planned  # in the pull test
        flight = flight_of(task(), HITCH, T, peak_tensions=peaks, rested=1.5)
        assert kinds(flight) == ([("snapped", ("cable 2",), pytest.approx(0.7))] if fails else [])
    (failure,) = departures(flight)
    assert "5.05 times the largest planned one" in failure.words
    free = resting_task(HITCH, 1.0, formed=False)  # nothing to compare with
    assert kinds(flight_of(free, HITCH, T, peak_tensions=peaks)) == []


def test_drones_and_cables_that_touch_the_ground_in_flight_fail() -> None:
    flight = flight_of(task(), HITCH, T, drones=moved(4, [0.0, 0.0, -HITCH.drones[4, 2]]))
    assert kinds(flight)[:1] == [("ground", ("q2",), pytest.approx(0.51))]
    sinking = flight_of(task(), HITCH, T)
    nodes = sinking.film.nodes.copy()
    nodes[60, 6, 2] = 0.0  # of cable 0, which has twelve nodes
    film = Film(sinking.film.t, nodes, sinking.film.cables, sinking.film.poses)
    assert kinds(replace(sinking, film=film)) == [("ground", ("cable 0",), pytest.approx(0.6))]


def test_drones_may_stand_where_they_take_off_and_land() -> None:
    """Their cables may lie on the ground then."""
    places = [[-0.5, 1.0, 0.0], [-0.5, 0.0, 0.0], [-0.5, -1.0, 0.0]]
    problem = {
        "team": {"robots": 3, "cable_length": 2.3, "tension": 0.5, "cable_density": 0.01},
        "start": {"drones": {"q": places, "r": [[0.5, y, z] for _, y, z in places]}},
        "mission": [
            {"form": {"polygon": ho.regular_polygon(3, 1.0).vertices.tolist(), "altitude": 1.4}},
            *({"release": {}}, {"land": {}}),
        ],
    }
    plan = ho.solve(ho.problem_from_dict(problem))
    whole = Task.of(plan.flight)
    t = whole.states.t
    positions = whole.states.positions
    shares = np.linspace(0.0, 1.0, 12)[:, None]
    pairs = positions.reshape(len(t), 3, 2, 3)
    straight = pairs[:, :, :1] * (1.0 - shares) + pairs[:, :, 1:] * shares
    nodes = straight.reshape(len(t), 36, 3).astype(np.float32)
    flight = flight_of(whole, HITCH, t, drones=positions)
    film = Film(t, nodes, 12 * np.arange(4), np.zeros((len(t), 0, 7), dtype=np.float32))
    assert kinds(replace(flight, film=film)) == []


def test_drones_and_cables_beyond_walls_fail() -> None:
    arena = ho.Arena([-1.5, -1.5, 0.0], [1.5, 1.5, 2.5])
    flight = flight_of(
        task(arena=arena), HITCH, T, drones=moved(1, [0.0, 0.0, 2.6 - HITCH.drones[1, 2]])
    )
    found = kinds(flight)
    assert found == [("wall", ("r0",), pytest.approx(0.51))]
    (failure,) = departures(flight)
    assert "10.0 cm beyond a wall of the arena" in failure.words
    assert kinds(flight_of(task(arena=arena), HITCH, T)) == []


def test_setpoints_without_a_plan_have_no_limits() -> None:
    bare = changed(resting_task(HITCH, 1.0))
    assert kinds(flight_of(bare, HITCH, T, drones=moved(0, [0.0, 0.0, -9.0]))) == []
