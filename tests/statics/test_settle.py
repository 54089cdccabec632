"""Where hitches come to rest: laws, closed forms, and residuals computed apart."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from clasp_balance import clasp_residuals
from hypothesis import given, settings
from hypothesis import strategies as st
from resting_hitches import random_hitch, regular_hitch, settled, standing
from scipy.optimize import brentq

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.motion import CableState
from hitchopt.statics.energy import HitchEnergy
from hitchopt.statics.settle import conditions_of, energy_of, samples_of

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(3, 8)
topologies = st.sampled_from(["closed", "open"])


def errors(seed: int, n: int, density: float) -> dict[str, Any]:
    rng = np.random.default_rng(seed + 1)
    return {
        "cable_density": density,
        "offsets": rng.uniform(-0.02, 0.02, (2 * n, 3)),
        "forces": rng.uniform(-0.03, 0.03, (2 * n, 3)),
    }


@given(seeds, sizes, topologies)
@settings(max_examples=15)
def test_plans_come_back_but_for_their_own_error_of_weight(
    seed: int, n: int, topology: str
) -> None:
    """Legs that rise for the weight hold vertices: to second order in weight over tension."""
    hitch = random_hitch(seed, n, topology)
    found = settled(hitch)
    np.testing.assert_allclose(found.vertices, hitch.vertices, atol=1e-9)
    np.testing.assert_allclose(found.drones, hitch.drones, atol=1e-9)
    np.testing.assert_allclose(found.tensions, hitch.team.tension, atol=1e-9)
    assert found.slack_cables == found.loose_clasps == ()
    away = []
    for density in (0.002, 0.004):
        hitch = random_hitch(seed, n, topology, density=density)
        found = settled(hitch)
        away.append(np.max(np.abs(found.vertices - hitch.vertices)))
        np.testing.assert_allclose(found.tensions, hitch.team.tension, rtol=2e-3)
        # Level drones would let the vertices sag by far more.
        level = settled(random_hitch(seed, n, topology), cable_density=density)
        assert away[-1] < 0.25 * np.max(np.abs(level.vertices - level.planned_vertices))
    assert away[0] < 0.4 * away[1]


@given(seeds, sizes, topologies, st.sampled_from([0.0, 0.01]))
@settings(max_examples=30)
def test_forces_balance_as_another_module_computes_them(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch = random_hitch(seed, n, topology)
    given_errors = errors(seed, n, density)
    found = settled(hitch, **given_errors)
    assert found.force_residual < 1e-8
    assert found.length_residual < 1e-9
    layout, w = hitch.team.layout, 9.81 * density
    q, r = found.drones[0::2], found.drones[1::2]
    if density == 0.0:
        force = clasp_residuals(found.vertices, q, r, found.tensions, topology=topology)
        assert np.max(np.linalg.norm(force, axis=-1)) < 1e-8
        # Drones: what their springs pull with is what their cables pull with.
        legs = unit(found.drones - found.vertices[layout.pulled_to])
        pull = np.repeat(found.tensions, 2)[:, None] * legs
        away = found.drones - hitch.drones - given_errors["offsets"]
        spring = hitch.team.stiffness[:, None] * away
        outer = given_errors["forces"] - hitch.cable_forces
        np.testing.assert_allclose(spring, outer - pull, atol=1e-8)
    else:  # all forces from outside and all weight add up to nothing
        away = found.drones - hitch.drones - given_errors["offsets"]
        spring = -hitch.team.stiffness[:, None] * away
        total = np.sum(spring + given_errors["forces"] - hitch.cable_forces, axis=0)
        total[2] -= w * np.sum(hitch.team.cable_length)  # their arcs are as long
        np.testing.assert_allclose(total, 0.0, atol=2e-5)


def resting_energy(hitch: ho.Hitch, **given: Any) -> HitchEnergy:
    motion, conditions = standing(hitch), conditions_of(hitch.team, **given)
    return energy_of(hitch.team, conditions, samples_of(motion, [1.0], conditions)[1])


def test_slopes_and_derivatives_are_those_of_the_energy() -> None:
    hitch = random_hitch(3, 4, "open")
    energy = resting_energy(hitch, cable_density=0.01, stiffness=4.0)
    x, h = energy.start, 1e-6
    away = np.random.default_rng(2).normal(size=x.shape)
    up, down = x + h * away, x - h * away
    change = (energy.values(up) - energy.values(down))[0] / (2.0 * h)
    assert np.sum(energy.slopes(x) * away) == pytest.approx(change, rel=1e-5)
    for friction in (0.0, 0.1):
        matrix = energy.matrix(energy.linear(x, friction)[0])
        change = (energy.slopes(up, friction) - energy.slopes(down, friction)).ravel() / (2.0 * h)
        np.testing.assert_allclose(matrix @ away.ravel(), change, rtol=1e-5, atol=1e-3)


def test_equal_errors_of_all_cables_of_a_regular_hitch() -> None:
    """By symmetry the vertices stay; each end gives way by half of it, against k and the stretch.

    For n = 3 the polygon could shrink or grow, too, but that changes no cable's length at first
    order, and by symmetry nothing pushes it.
    """
    k, T, EA, change = 4.75, 0.5, 1e4, np.array([[-0.02], [-0.005], [0.01]])
    lengths = 2.4 + change * np.ones(3)
    found = settled(regular_hitch(3, T), stiffness=k, cable_length=lengths, axial_stiffness=EA)
    expected = T - change / (2.0 / k + 2.4 / EA)
    np.testing.assert_allclose(found.tensions, expected * np.ones(3), rtol=1e-9)
    np.testing.assert_allclose(found.vertices, found.planned_vertices, atol=1e-9)


def test_without_feed_forward_nothing_pulls_and_moved_set_points_pull_again() -> None:
    hitch = random_hitch(11, 5, stiffness=4.75)
    without = settled(hitch, feed_forward=False)
    assert np.max(without.tensions) < 0.02
    outward = -hitch.cable_forces / hitch.team.stiffness[:, None]
    again = settled(hitch, feed_forward=False, offsets=outward)
    np.testing.assert_allclose(again.tensions, hitch.team.tension, atol=1e-9)
    np.testing.assert_allclose(again.vertices, hitch.vertices, atol=1e-9)


def test_an_integral_holds_drones_where_they_are_led_whatever_their_stiffness() -> None:
    hitch = regular_hitch(4)
    found = settled(hitch, integral=True, stiffness=3.0, cable_length=2.39, axial_stiffness=200.0)
    rigid = settled(hitch, stiffness=np.inf, cable_length=2.39, axial_stiffness=200.0)
    np.testing.assert_array_equal(found.drones, hitch.drones)
    np.testing.assert_array_equal(found.tensions, rigid.tensions)
    np.testing.assert_allclose(found.tensions, 0.5 + 200.0 * 0.01 / 2.4, rtol=1e-9)


def test_loads_hang_at_their_clasps_and_move_nothing_where_they_are_zero() -> None:
    hitch = random_hitch(2, 4, "open")
    plain, zero = settled(hitch), settled(hitch, load=[0.0] * 3)
    np.testing.assert_array_equal(plain.vertices, zero.vertices)
    load = np.array([0.002, 0.001, 0.003])
    found = settled(hitch, load=load)
    weight = 9.81 * load[:, None] * np.array([0.0, 0.0, -1.0])
    q, r = found.drones[0::2], found.drones[1::2]
    force = clasp_residuals(found.vertices, q, r, found.tensions, weight, "open")
    assert np.max(np.abs(force)) < 1e-8
    assert np.all((found.vertices - plain.vertices)[1:-1, 2] < 0.0)


def test_slack_cables_are_named_and_hold_no_clasp() -> None:
    hitch = regular_hitch(5)
    longer = settled(hitch, cable_length=[4.4, 2.4, 2.4, 2.4, 2.4], stiffness=4.75)
    assert longer.tensions[0] == 0.0
    assert "c0" in longer.slack_cables
    assert {"p0", "p1"} <= set(longer.loose_clasps)


def test_samples_settle_as_each_alone() -> None:
    hitch = random_hitch(4, 3, stiffness=8.0)
    rng = np.random.default_rng(4)
    lengths = hitch.team.cable_length + rng.uniform(-0.01, 0.01, (2, 3, 3))
    offsets = rng.uniform(-0.01, 0.01, (3, 6, 3))
    together = ho.settle(standing(hitch), [0.5, 1.0, 1.5], cable_length=lengths, offsets=offsets)
    assert together.tensions.shape == (2, 3, 3)
    for i, j in np.ndindex(2, 3):
        alone = settled(hitch, cable_length=lengths[i, j], offsets=offsets[j])
        np.testing.assert_allclose(together.tensions[i, j], alone.tensions, atol=1e-9)
        np.testing.assert_allclose(together.vertices[i, j], alone.vertices, atol=1e-9)


def test_a_hitch_of_a_thousand_robots_settles() -> None:
    hitch = regular_hitch(1000)
    rng = np.random.default_rng(0)
    found = settled(
        hitch, stiffness=4.75, cable_density=0.005, offsets=rng.uniform(-0.01, 0.01, (2000, 3))
    )
    assert found.force_residual < 1e-7
    assert np.all(np.abs(found.tensions - 0.5) < 0.15)


def test_wrong_conditions_are_refused() -> None:
    for conditions, words in (
        (
            {"stiffness": 0.0},
            r"stiffness = 0\.0: must be one positive number, or an array \(…, 6\)",
        ),
        ({"stiffness": [1.0, 2.0]}, "stiffness"),
        ({"cable_length": [1.0, 2.0]}, "cable_length"),
        ({"cable_length": np.nan}, "cable_length"),
        ({"offsets": np.zeros((5, 3))}, "offsets"),
        ({"load": -1.0}, "load"),
        ({"cable_density": -0.1}, r"cable_density = -0\.1: must be one non-negative"),
        ({"axial_stiffness": 0.0}, r"axial_stiffness = 0\.0: must be one positive"),
        ({"friction": -0.1}, "friction"),
        ({"fiction": 0.1}, "fiction = 0.1: must be one of cable_length"),
    ):
        with pytest.raises(ho.InputError, match="^" + words):
            settled(regular_hitch(3), **conditions)


def test_times_without_hitch_are_refused() -> None:
    motion = standing(regular_hitch(3))
    (hold,) = motion.phases
    free = dataclasses.replace(motion, phases=(dataclasses.replace(hold, state=CableState.FREE),))
    with pytest.raises(
        ho.InputError, match=r"t = 1\.0: must be within a hitch: never in this plan"
    ):
        ho.settle(free, 1.0)
    with pytest.raises(ho.InputError, match=r"t = -1\.0"):
        ho.settle(motion, -1.0)


@pytest.mark.parametrize(("seed", "density"), [(1, 0.006), (2, 0.012), (3, 0.018)])
def test_exact_catenaries_would_rest_there_too(seed: int, density: float) -> None:
    """Spans as exact curves, of one tension a cable in height, between the settled nodes.

    The forces that then miss a balance would move vertices by less than a millimetre.
    """
    hitch = random_hitch(seed, 5, density=density)
    n, w = hitch.team.robots, 9.81 * density
    found = settled(hitch)
    clasps, drones = np.zeros((n, 3)), np.zeros((2 * n, 3))

    def curve(first: np.ndarray, last: np.ndarray, tension: float) -> tuple[float, np.ndarray]:
        """Length of the curve of that tension at its first end, and the forces on its ends."""
        chord = float(np.linalg.norm(last - first))

        def missing(log: float) -> float:
            pull = w * Catenary.between(first, last, chord * (1.0 + np.exp(log))).pull(first, last)
            return float(np.linalg.norm(pull[0])) - tension

        length = chord * (1.0 + np.exp(brentq(missing, -18.0, -1.0)))
        return length, w * Catenary.between(first, last, length).pull(first, last)

    def cable(k: int, tension: float) -> tuple[float, tuple[np.ndarray, ...]]:
        q, r = found.drones[2 * k : 2 * k + 2]
        p, following = found.vertices[k], found.vertices[(k + 1) % n]
        q_leg, edge = curve(p, q, tension), curve(p, following, tension)
        r_leg = curve(following, r, float(np.linalg.norm(edge[1][1])))
        return q_leg[0] + edge[0] + r_leg[0], (q_leg[1], edge[1], r_leg[1])

    for k in range(n):
        length = float(hitch.team.cable_length[k])
        ends = (0.8 * found.tensions[k], 1.3 * found.tensions[k])
        tension = brentq(lambda T, k=k, length=length: cable(k, T)[0] - length, *ends)
        q_leg, edge, r_leg = cable(k, float(tension))[1]
        clasps[k] += q_leg[0] + edge[0]
        clasps[(k + 1) % n] += edge[1] + r_leg[0]
        drones[2 * k] += q_leg[1]
        drones[2 * k + 1] += r_leg[1]
    springs = hitch.team.stiffness[:, None] * (found.planned_drones - found.drones)
    drones += springs - hitch.cable_forces
    energy = resting_energy(hitch)
    x = np.concatenate([found.drones, found.vertices])[None]
    missed = np.concatenate([drones, clasps])[None]
    moved = energy.solved(energy.matrix(energy.linear(x)[0]), missed)[0]
    assert np.max(np.linalg.norm(moved, axis=-1)) < 1e-3


@pytest.mark.parametrize("inward", [0.3, 0.45])
@pytest.mark.parametrize("feed_forward", [True, False])
def test_hitches_whose_drones_are_far_too_near_find_a_rest(
    inward: float, feed_forward: bool
) -> None:
    hitch = regular_hitch(4)
    legs = unit(hitch.drones - hitch.vertices[hitch.team.layout.anchors])
    given: Any = {"stiffness": 12.0, "cable_density": 0.012, "feed_forward": feed_forward}
    found = settled(hitch, **given, offsets=-inward * legs)
    assert found.force_residual < 1e-8
    assert np.all(found.tensions > 0.0)
    assert np.all(found.tensions < 0.25)
    assert bool(found.slack_cables or found.loose_clasps) == (inward > 0.4)


@pytest.mark.slow
def test_no_rest_is_found_where_a_drone_comes_to_its_vertex() -> None:
    hitch = regular_hitch(5)
    legs = hitch.drones - hitch.vertices[hitch.team.layout.anchors]
    beyond = np.zeros((10, 1))
    beyond[2] = -2.0  # q1 is led through its vertex, as far again
    with pytest.raises(ho.InfeasibleError, match="lead drones farther from vertices"):
        settled(hitch, stiffness=3.0, cable_density=0.01, offsets=beyond * legs)
