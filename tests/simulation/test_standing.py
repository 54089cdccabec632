"""Simulated flights: hitches that stand, bear loads, are formed, and are corrected."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scripted import forming, hanging_task, regular_hitch, standing, unformed

import hitchopt as ho
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.judgement import Simulation, simulate
from hitchopt.simulation.settings import USUAL, Settings
from hitchopt.simulation.task import read_task
from hitchopt.simulation.world import InvalidRunError


@pytest.fixture(scope="module")
def stood() -> Simulation:
    return simulate(standing(regular_hitch(3), 1.0), Settings())


def test_it_holds(stood: Simulation) -> None:
    assert stood.outcome.failures == ()
    assert stood.outcome.hitched
    assert stood.flight.touches == {}
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
def test_a_chain_holds_at_its_clasps() -> None:
    team = Team(3, 2.4, topology="open", tension=0.5, cable_density=0.01)
    points = [[1.0, 0.0], [1.8, 1.2], [3.2, 1.3], [4.0, 0.0]]
    hitch = Hitch.balanced(team, points, altitude=1.6)
    done = simulate(standing(hitch, 0.3), Settings())
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
    task, strong = standing(regular_hitch(3), 0.5), ho.Quadrotor(max_thrust=30.0)
    wild = replace(task.setpoints, cable_forces=20.0 * task.setpoints.cable_forces)
    team = replace(task.team, quadrotor=(strong,) * 3)
    done = simulate(replace(task, team=team, setpoints=wild), Settings())
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
    done = simulate(replace(task, setpoints=together), Settings(pull_test=False))
    assert done.flight.touches["q0", "r2"] == 0.0
    assert {failure.kind for failure in done.outcome.failures} >= {"touch"}


CALM = Settings(pull_test=False)
LOADS = np.array([0.01, 0.0, 0.02])


def lifted(loads: np.ndarray, shares: float = 1.0) -> tuple[float, np.ndarray]:
    """Return the drones' upward force at rest [N], and the clasps' height over the plan's [m]."""
    task = standing(regular_hitch(3, load=loads, tension=0.8), 1.0)  # type: ignore[arg-type]
    done = simulate(replace(task, taut=np.full(task.tensions.shape, shares)), CALM)
    assert done.outcome.failures == ()
    record, gains = done.flight.record, done.flight.gains
    rows = (record.t > 1.0) & (record.t < done.flight.rested)
    sunk = np.mean(record.commanded[rows] - record.drones[rows], axis=0)[:, 2]
    held = -task.setpoints.cable_forces[0, :, 2] + gains.stiffness * sunk
    return float(np.sum(held)), np.nanmean(done.errors.offsets[50:, :, 2], axis=0)


@pytest.mark.slow
def test_drones_carry_the_loads_and_clasps_stay_at_their_heights() -> None:
    held, heights = lifted(LOADS)
    assert held == pytest.approx(GRAVITY * (np.sum(LOADS) + 3 * 0.01 * 2.3), rel=0.02)
    assert np.max(np.abs(heights)) < 0.015  # legs that rise for no load would stand 4 cm off
    half, heights = lifted(LOADS, 0.5)  # only the share that the plan states hangs there
    assert held - half == pytest.approx(0.5 * GRAVITY * np.sum(LOADS), rel=0.03)
    assert heights[2] > 0.02  # planned for a load that is not there


def test_a_plan_says_how_its_loads_are_taken_up(tmp_path_factory: pytest.TempPathFactory) -> None:
    hitch = regular_hitch(3, load=0.01)
    place = tmp_path_factory.mktemp("loaded")
    ho.transport(hitch, to=[0.1, 0.0, 2.1]).save(place)
    task = read_task(place)
    assert task.taut is not None
    np.testing.assert_allclose(task.taut, 1.0)
    np.testing.assert_array_equal(task.load_shares(0), np.ones(3))


@pytest.mark.slow
def test_two_half_turns_form_a_triangle_that_holds() -> None:
    task = forming(regular_hitch(3), [1.0, 1.0, 1.0], swap=2.0)
    done = simulate(task, Settings(perturbations=USUAL, seed=5))
    assert done.outcome.failures == ()
    assert done.outcome.hitched
    assert [clasp.name for clasp in done.outcome.clasps] == ["p0", "p1", "p2"]
    assert {abs(clasp.linking) for clasp in done.outcome.clasps} == {1}
    angle = 2.0 * np.pi / 3.0  # exterior: two pulls of 0.5 N close the force triangle
    for clasp in done.outcome.clasps:
        assert clasp.least_bearing == pytest.approx(0.3 * 2.0 * 0.5 * np.cos(0.5 * angle))
        assert clasp.bearing > 3.0 * clasp.least_bearing
    assert np.nanmax(done.errors.without_sag[-50:]) < 0.15
    tensions = done.flight.record.tensions
    assert np.max(tensions[:300]) < 0.5 * np.min(tensions[-50:])


@pytest.mark.slow
def test_cables_that_merely_cross_are_no_clasps() -> None:
    """Half a turn, drawn tight as it is: every cable runs straight across its neighbours."""
    task = forming(regular_hitch(3), [(0.5, 0.0)] * 3, swap=2.0, swapped=True)
    done = simulate(task, Settings(perturbations=USUAL, seed=7, pull_test=False))
    clasps = done.outcome.clasps
    assert any(abs(clasp.linking) == 1 for clasp in clasps)  # Gauss's integral alone would hold
    assert all(0.0 < clasp.bearing < 0.2 * clasp.least_bearing for clasp in clasps)
    assert not any(clasp.bears or clasp.holds for clasp in clasps)
    lost = {f.where[0] for f in done.outcome.failures if f.kind == "lost"}
    assert lost == {clasp.name for clasp in clasps if abs(clasp.linking) == 1}


@pytest.mark.slow
def test_measured_vertices_take_the_sag_away() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[0.0, -0.8], [-0.7, 0.5], [0.7, 0.5]], 1.0)
    plan = ho.hold(start, 1.5)
    measured: dict[str, float | bool] = {"vertex_noise": 0.01, "vertex_delay": 0.05}
    off, on = (
        ho.simulate(plan, feedback=feedback, perturbations=measured, pull_test=False)
        for feedback in (False, True)
    )
    assert on.run.succeeded
    last = [np.nanmean(flight.errors.errors[-20:]) for flight in (off, on)]
    assert last[0] > 0.05
    assert last[1] < 0.25 * last[0]
    moved = on.flight.record.commanded[-1] - off.flight.record.commanded[-1]
    assert np.all(moved[:, 2] > 0.05)  # drones are told to fly higher
    assert np.all(np.linalg.norm(moved[:, :2], axis=-1) < 0.1)
