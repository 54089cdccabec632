"""A hitch that begins formed and is at rest: forces balance, sag is counted, equal by seed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scripted import hanging_task, regular_hitch, standing, unformed

from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.simulate import Simulation, simulate
from hitchopt.simulation.simulation_settings import FAST, Perturbations, Settings
from hitchopt.simulation.validity import InvalidRunError


@pytest.fixture(scope="module")
def stood() -> Simulation:
    return simulate(standing(regular_hitch(3), 1.0), Settings())


def test_it_holds(stood: Simulation) -> None:
    assert stood.outcome.failures == ()
    assert stood.outcome.hitched
    assert stood.flight.touches == ()
    assert all(0.0 < clasp.moved < 0.1 for clasp in stood.outcome.clasps)


def test_drones_carry_the_weight_of_all(stood: Simulation) -> None:
    team, record = stood.flight.task.team, stood.flight.record
    at_rest = (record.t > 1.0) & (record.t < stood.flight.rested)
    lifted = np.sum(np.mean(record.thrusts[at_rest], axis=0))
    pull = team.tension[0]
    weight = GRAVITY * (np.sum(team.mass) + team.cable_density * np.sum(team.cable_length))
    # Each thrust holds its share of the weight upward and the cable's pull across.
    across = 2 * team.robots * np.mean(record.tensions[at_rest])
    assert across == pytest.approx(2 * team.robots * pull, rel=0.05)
    assert lifted == pytest.approx(np.hypot(weight, across), rel=0.02)


def test_vertices_are_at_their_height_in_spite_of_their_weight(stood: Simulation) -> None:
    """A plan of level legs would let them hang 9 cm deep, by the balance of heights."""
    team, errors = stood.flight.task.team, stood.errors
    edge = 1.3
    leg = 0.5 * (team.cable_length[0] - edge)
    level = GRAVITY * team.cable_density * leg * (leg + edge) / (2.0 * team.tension[0])
    measured = np.mean(
        errors.planned[50:, :, 2] - stood.flight.record.vertices[errors.rows[50:], :, 2]
    )
    assert abs(measured) < 0.1 * level
    assert np.max(errors.without_sag[50:]) < 0.05
    assert not errors.moving.any()
    assert errors.lost == 0.0


def test_pulls_are_near_the_plans_and_rise_with_the_pull_test(stood: Simulation) -> None:
    record, team = stood.flight.record, stood.flight.task.team
    flying = (record.t > 0.5) & (record.t < 1.0)
    assert np.mean(record.tensions[flying]) == pytest.approx(team.tension[0], rel=0.15)
    pulled = record.t > stood.flight.pulled - 0.3
    ratio = np.mean(record.tensions[pulled]) / np.mean(record.tensions[flying])
    assert 1.3 < ratio < 1.6
    assert np.all(record.peak_tensions[1:] >= record.tensions[1:] - 1e-12)


@pytest.mark.slow
def test_the_same_seed_flies_the_same_flight_and_another_does_not() -> None:
    task = standing(regular_hitch(3), 0.1)
    windy = Settings(
        body="point", perturbations=Perturbations(noise=0.01, wind=0.05), pull_test=False, seed=3
    )
    first, again, other = (
        simulate(task, settings).flight.record
        for settings in (windy, windy, replace(windy, seed=4))
    )
    np.testing.assert_array_equal(first.drones, again.drones)
    np.testing.assert_array_equal(first.tensions, again.tensions)
    assert np.max(np.abs(first.drones - other.drones)) > 1e-3


def test_a_chain_holds_at_its_clasps() -> None:
    team = Team(3, 2.4, topology="open", tension=0.5, cable_density=0.01)
    points = [[1.0, 0.0], [1.8, 1.2], [3.2, 1.3], [4.0, 0.0]]
    hitch = Hitch.balanced(team, points, altitude=1.6)
    done = simulate(standing(hitch, 0.3), Settings(body="point"))
    assert done.outcome.failures == ()
    assert [clasp.name for clasp in done.outcome.clasps] == ["p1", "p2"]


@pytest.mark.slow
def test_cables_that_reach_the_ground_settle_lying_on_it() -> None:
    """Problem form_hanging_to_the_floor begins so; folded in the air, cables tore as they fell."""
    team = Team(4, [2.6, 2.8, 2.6, 2.9], tension=0.6)
    q = np.array([[1.35, -0.4], [-2.0, 0.6], [-0.35, 0.6], [-2.0, -0.4]])
    places = np.ones((8, 3))
    places[0::2, :2], places[1::2, :2] = q, q + [0.7, 0.0]
    still = np.repeat(places[None], 31, axis=0)
    done = simulate(hanging_task(team, still, np.zeros_like(still)), Settings())
    assert done.outcome.verdict == "succeeded"
    for film in (done.flight.film.nodes[0], done.flight.film.nodes[-1]):
        for begin, end in pairwise(done.flight.film.cables):
            heights = film[begin:end, 2]
            assert np.min(heights) == pytest.approx(0.006, abs=0.004)
            assert 0.1 < np.mean(heights < 0.015) < 0.5  # so much of it lies
    assert np.max(done.flight.record.peak_tensions) < 3.0 * GRAVITY * 0.01 * 1.0


def test_a_flight_that_overloads_its_cables_is_ended_with_the_reason() -> None:
    hitch = regular_hitch(3)
    task = standing(hitch, 0.5)
    wild = replace(task.setpoints, cable_forces=20.0 * task.setpoints.cable_forces)
    team = Team(
        3,
        2.3,
        tension=0.5,
        cable_density=0.01,
        quadrotor=replace(hitch.team.quadrotor[0], max_thrust=30.0),
    )
    done = simulate(replace(task, team=team, setpoints=wild), Settings(body="point"))
    assert isinstance(done.flight.error, InvalidRunError)
    assert done.flight.error.quantity in {"tension", "strain", "penetration"}
    (failure,) = done.outcome.failures
    assert failure.kind == "invalid"
    assert "ropes may have passed each other" in failure.words
    assert not done.outcome.hitched


def test_drones_that_touch_are_reported() -> None:
    hitch = regular_hitch(3)
    task = unformed(standing(hitch, 0.3))
    moved = task.setpoints.positions.copy()
    moved[:, 0] = moved[:, 5] + [0.05, 0.0, 0.0]  # q0 next to r2
    weight = np.zeros_like(moved)
    weight[..., 2] = -hitch.team.cable_weight
    together = replace(task.setpoints, positions=moved, cable_forces=weight)
    done = simulate(replace(task, setpoints=together), Settings(body="point", preset=FAST))
    first = {(touch.first, touch.second): touch.time for touch in done.flight.touches}
    assert first["q0", "r2"] == 0.0
    assert {failure.kind for failure in done.outcome.failures} >= {"touch"}
