"""Where hitches come to rest, in which bands friction holds them, and in which ranges errors do."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from clasp_balance import clasp_residuals
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, root

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState
from hitchopt.statics.energy import INTEGRAL_ERROR, HitchEnergy
from hitchopt.statics.settle import Settled, conditions_of, energy_of, samples_of
from hitchopt.statics.tolerance import Tolerance, responses, taut_times
from hitchopt.steps.certified_motions import rest_motion
from hitchopt.trajectory import PiecewisePolynomial
from problems.random_morph import random_convex_polygon

seeds = st.integers(0, 2**32 - 1)
topologies = st.sampled_from(["closed", "open"])


def standing(hitch: ho.Hitch) -> ho.Motion:
    return rest_motion(hitch, Requirements(), 2.0, ho.Phase("hold", 0, 0.0, 2.0))


def random_hitch(
    seed: int, n: int, topology: str = "closed", *, density: float = 0.0, stiffness: float = 5.0
) -> ho.Hitch:
    """Unequal cables, tensions, masses, stiffness, leg lengths, at a random place."""
    rng = np.random.default_rng(seed)
    sides = n if topology == "closed" else n + 3
    outline: Any = random_convex_polygon(sides, 1.3, rng).translated(rng.normal(size=2))
    if topology == "open":
        outline = ho.ConvexArc(outline.vertices[: n + 1])
    length = outline.edge_lengths + rng.uniform(0.7, 1.1, n)
    kinds = [ho.Quadrotor(0.1 + 0.01 * k, 2.6, stiffness * (1.0 + 0.1 * k)) for k in range(n)]
    given: Any = {"topology": topology, "cable_density": density, "quadrotor": kinds}
    team = ho.Team(n, length, tension=rng.uniform(0.45, 0.55, n), **given)
    slack = length - outline.edge_lengths
    legs = team.layout.q_legs_of(slack * rng.uniform(0.35, 0.65, n), slack)
    return ho.Hitch(team, outline, 0.8 + rng.uniform(), legs)


def regular_hitch(n: int, tension: float = 0.5, **team: Any) -> ho.Hitch:
    made = ho.Team(n, 2.4, tension=tension, **team)
    return ho.Hitch.balanced(made, ho.regular_polygon(n, 1.2), 1.3)


def settled(hitch: ho.Hitch, **conditions: Any) -> Settled:
    return ho.settle(standing(hitch), 1.0, **conditions)


def resting_energy(hitch: ho.Hitch, **given: Any) -> HitchEnergy:
    motion, conditions = standing(hitch), conditions_of(hitch.team, **given)
    return energy_of(hitch.team, conditions, samples_of(motion, [1.0], conditions)[1])


@given(seeds, st.integers(3, 8), topologies)
@settings(max_examples=15)
def test_plans_come_back_but_for_an_error_of_weight(seed: int, n: int, topology: str) -> None:
    """Legs that rise for the weight hold vertices: to second order in weight over tension."""
    plain, away = random_hitch(seed, n, topology), list[float]()
    found = settled(plain)
    np.testing.assert_allclose(found.vertices, plain.vertices, atol=1e-9)
    np.testing.assert_allclose(found.drones, plain.drones, atol=1e-9)
    np.testing.assert_allclose(found.tensions, plain.team.tension, atol=1e-9)
    assert found.slack_cables == found.loose_clasps == ()
    for density in (0.002, 0.004):
        hitch = random_hitch(seed, n, topology, density=density)
        found = settled(hitch)
        away.append(float(np.max(np.abs(found.vertices - hitch.vertices))))
        np.testing.assert_allclose(found.tensions, hitch.team.tension, rtol=2e-3)
        # Level drones would let the vertices sag by far more.
        level = settled(plain, cable_density=density)
        assert away[-1] < 0.25 * np.max(np.abs(level.vertices - level.planned_vertices))
    assert away[0] < 0.4 * away[1]


@given(seeds, st.integers(3, 8), topologies, st.sampled_from([0.0, 0.01]), st.booleans())
@settings(max_examples=40)
def test_forces_balance_as_another_module_computes_them(
    seed: int, n: int, topology: str, density: float, named: bool
) -> None:
    hitch, rng = random_hitch(seed, n, topology), np.random.default_rng(seed + 1)
    if named:  # level and upright apart, with an integral that gives a force at most
        gains = {"kp": [3.0, 2.5], "ki": [0.02, 0.05]}
        own: Any = {"stiffness": None, "controller": "mellinger", "gains": gains}
        kinds = tuple(dataclasses.replace(kind, **own) for kind in hitch.team.quadrotor)
        hitch = dataclasses.replace(hitch, team=dataclasses.replace(hitch.team, quadrotor=kinds))
    offsets, forces = (rng.uniform(-size, size, (2 * n, 3)) for size in (0.02, 0.03))
    layout, load = hitch.team.layout, rng.uniform(0.0, 0.003, len(hitch.team.layout.clasps))
    off = {"offsets": offsets, "forces": forces, "load": load}
    found = settled(hitch, cable_density=density, **off)
    assert found.force_residual < 1e-8
    assert found.length_residual < 1e-9
    error = hitch.drones + offsets - found.drones
    wound = hitch.team.integral * error / np.hypot(error, INTEGRAL_ERROR)
    spring = hitch.team.stiffness * error + wound
    outer = spring + forces - hitch.cable_forces
    if density == 0.0:
        q, r, weight = found.drones[0::2], found.drones[1::2], np.outer(load, [0.0, 0.0, -9.81])
        force = clasp_residuals(found.vertices, q, r, found.tensions, weight, topology)
        assert np.max(np.linalg.norm(force, axis=-1)) < 1e-8
        # Drones: what their springs pull with is what their cables pull with.
        legs = unit(found.drones - found.vertices[layout.pulled_to])
        np.testing.assert_allclose(outer, np.repeat(found.tensions, 2)[:, None] * legs, atol=1e-8)
    else:  # all forces from outside and all weight add up to nothing; arcs are as long as cables
        mass = np.sum(load) + density * np.sum(hitch.team.cable_length)
        np.testing.assert_allclose(np.sum(outer, axis=0), [0.0, 0.0, 9.81 * mass], atol=2e-5)


def test_slopes_and_derivatives_are_those_of_the_energy() -> None:
    hitch = random_hitch(3, 4, "open")
    energy = resting_energy(hitch, cable_density=0.01, stiffness=4.0)
    x, h = energy.start, 1e-6
    away = np.random.default_rng(2).normal(size=x.shape)
    up, down = x + h * away, x - h * away
    change = (energy.values(up) - energy.values(down))[0] / (2.0 * h)
    assert np.sum(energy.slopes(x) * away) == pytest.approx(change, rel=1e-5)
    for friction in (0.0, 0.1):
        matrix = energy.matrix(x, energy.linear(x, friction)[0])
        change = (energy.slopes(up, friction) - energy.slopes(down, friction)).ravel() / (2.0 * h)
        np.testing.assert_allclose(matrix @ away.ravel(), change, rtol=1e-5, atol=1e-3)


def test_equal_errors_of_all_cables_of_a_regular_hitch() -> None:
    """By symmetry vertices stay; each end gives way by half of it, against k and the stretch."""
    k, T, EA, change = 4.75, 0.5, 1e4, np.array([[-0.02], [-0.005], [0.01]])
    lengths = 2.4 + change * np.ones(3)
    found = settled(regular_hitch(3, T), stiffness=k, cable_length=lengths, axial_stiffness=EA)
    expected = T - change / (2.0 / k + 2.4 / EA)
    np.testing.assert_allclose(found.tensions, expected * np.ones(3), rtol=1e-9)
    np.testing.assert_allclose(found.vertices, found.planned_vertices, atol=1e-9)


def test_without_feed_forward_nothing_pulls_and_moved_set_points_pull_again() -> None:
    hitch = random_hitch(11, 5, stiffness=4.75)
    assert np.max(settled(hitch, feed_forward=False).tensions) < 0.02
    outward = -hitch.cable_forces / hitch.team.stiffness
    again = settled(hitch, feed_forward=False, offsets=outward)
    np.testing.assert_allclose(again.tensions, hitch.team.tension, atol=1e-9)
    np.testing.assert_allclose(again.vertices, hitch.vertices, atol=1e-9)


def test_an_integral_holds_drones_where_they_are_led_whatever_their_stiffness() -> None:
    hitch, given = regular_hitch(4), {"cable_length": 2.39, "axial_stiffness": 200.0}
    for rigid in ({"integral": True, "stiffness": 3.0}, {"stiffness": np.inf}):
        found = settled(hitch, **given, **rigid)
        np.testing.assert_array_equal(found.drones, hitch.drones)
        np.testing.assert_allclose(found.tensions, 0.5 + 200.0 * 0.01 / 2.4, rtol=1e-9)


def test_slack_cables_are_named_and_hold_no_clasp() -> None:
    longer = settled(regular_hitch(5), cable_length=[4.4, 2.4, 2.4, 2.4, 2.4], stiffness=4.75)
    assert longer.tensions[0] == 0.0
    assert "c0" in longer.slack_cables
    assert {"p0", "p1"} <= set(longer.loose_clasps)


def test_samples_settle_as_each_alone() -> None:
    hitch, rng = random_hitch(4, 3, stiffness=8.0), np.random.default_rng(4)
    lengths = hitch.team.cable_length + rng.uniform(-0.01, 0.01, (2, 3, 3))
    offsets = rng.uniform(-0.01, 0.01, (3, 6, 3))
    together = ho.settle(standing(hitch), [0.5, 1.0, 1.5], cable_length=lengths, offsets=offsets)
    assert together.tensions.shape == (2, 3, 3)
    for i, j in np.ndindex(2, 3):
        alone = settled(hitch, cable_length=lengths[i, j], offsets=offsets[j])
        np.testing.assert_allclose(together.tensions[i, j], alone.tensions, atol=1e-9)
        np.testing.assert_allclose(together.vertices[i, j], alone.vertices, atol=1e-9)


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        (
            {"stiffness": 0.0},
            r"stiffness = 0\.0: must be one positive number, or an array \(…, 6, 3\)",
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
    ],
)
def test_wrong_conditions_are_refused(conditions: dict[str, Any], words: str) -> None:
    with pytest.raises(ho.InputError, match="^" + words):
        settled(regular_hitch(3), **conditions)


def test_times_without_hitch_are_refused() -> None:
    motion = standing(regular_hitch(3))
    (hold,) = motion.phases
    free = dataclasses.replace(motion, phases=(dataclasses.replace(hold, state=CableState.FREE),))
    words = r"t = 1\.0: must be within a hitch: never in this plan"
    for plan, t, told in ((free, 1.0, words), (motion, -1.0, r"t = -1\.0")):
        with pytest.raises(ho.InputError, match=told):
            ho.settle(plan, t)


@pytest.mark.parametrize(("seed", "density"), [(1, 0.006), (2, 0.012), (3, 0.018)])
def test_exact_catenaries_would_rest_there_too(seed: int, density: float) -> None:
    """Spans as exact curves between the settled nodes, the tension growing by the weight below.

    They are as long as the cable, and what then misses a balance would move vertices by 1 mm.
    """
    hitch, n, w = random_hitch(seed, 5, density=density), 5, 9.81 * density
    found = settled(hitch)
    x = np.concatenate([found.drones, found.vertices])
    missed, lengths = np.zeros_like(x), np.zeros(n)
    missed[: 2 * n] = hitch.team.stiffness * (hitch.drones - found.drones)
    missed[: 2 * n] -= hitch.cable_forces
    for k in range(n):
        ends = 2 * n + np.array([k, (k + 1) % n])  # of the edge, where legs begin
        middle = np.mean(x[ends, 2])
        for first, last in ((ends[0], ends[1]), (ends[0], 2 * k), (ends[1], 2 * k + 1)):
            chord = float(np.linalg.norm(x[last] - x[first]))
            tension = found.tensions[k] + w * (x[first, 2] - middle)

            def curve(log: float) -> tuple[float, np.ndarray]:
                length = chord * (1.0 + np.exp(log))  # noqa: B023
                a, b = x[first], x[last]  # noqa: B023
                return length, w * Catenary.between(a, b, length).pull(a, b)

            log = brentq(lambda log: np.linalg.norm(curve(log)[1][0]) - tension, -18.0, -1.0)  # noqa: B023
            length, pulls = curve(log)
            lengths[k] += length
            missed[[first, last]] += pulls
    np.testing.assert_allclose(lengths, hitch.team.cable_length, rtol=1e-3)  # arcs: 1 %
    energy = resting_energy(hitch)
    moved = energy.solved(energy.matrix(x[None], energy.linear(x[None])[0]), missed[None])[0]
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
    hitch, beyond = regular_hitch(5), np.zeros((10, 1))
    legs = hitch.drones - hitch.vertices[hitch.team.layout.anchors]
    beyond[2] = -2.0  # q1 is led through its vertex, as far again
    with pytest.raises(ho.InfeasibleError, match="move drones away from vertices"):
        settled(hitch, stiffness=3.0, cable_density=0.01, offsets=beyond * legs)


STIFFNESS, TENSION = 4.75, 0.6


def triangle(**team: Any) -> ho.Hitch:
    return regular_hitch(3, TENSION, quadrotor=ho.Quadrotor(stiffness=STIFFNESS), **team)


@pytest.mark.slow
@given(seeds, st.integers(3, 6), topologies, st.sampled_from([0.0, 0.006]))
@settings(max_examples=10)
def test_bands_hold_the_place_without_friction_and_grow_with_friction(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch = random_hitch(seed, n, topology, density=density, stiffness=20.0)
    bands = [settled(hitch, friction=friction).band for friction in (0.0, 0.002, 0.004)]
    np.testing.assert_array_equal(bands[0][:, 0], bands[0][:, 1])
    for narrow, wide in itertools.pairwise(bands):
        assert np.all((wide - narrow) * [-1.0, 1.0] >= -1e-6)
    assert np.all(np.ptp(bands[1][hitch.team.layout.clasps], axis=-1) > 1e-4)


@pytest.mark.parametrize("friction", [0.01, 0.05, 0.1])
def test_the_ends_of_a_triangles_band_are_those_of_its_five_equations(friction: float) -> None:
    """One vertex, one drone, one length: the half turn about a vertex's bisector does the rest."""
    hitch, side = triangle(), 1.2
    place, planned = hitch.drones[0], hitch.vertices[0]
    outward = unit(planned - np.mean(hitch.vertices, axis=0))
    edge, fed = unit(hitch.vertices[1] - planned), TENSION * unit(place - planned)

    def missing(unknowns: np.ndarray, friction: float) -> np.ndarray:
        drone, out, tension = unknowns[:3], unknowns[3], unknowns[4]
        leg = drone - (planned + out * outward)
        size = float(np.linalg.norm(leg))
        bend = np.arccos(-(leg / size) @ edge)
        pull = tension * np.exp(friction * bend)
        balance = STIFFNESS * (place - drone) + fed - pull * leg / size
        clasp = pull * (leg @ outward) / size - tension * np.cos(np.pi / 6)
        total = 2.0 * size + side + np.sqrt(3.0) * out - 2.4
        return np.array([*balance, clasp, total])

    found = settled(hitch, friction=friction, axial_stiffness=1e6)
    for column, sense in enumerate((-1.0, 1.0)):
        start = np.array([*place, 0.0, TENSION])
        for share in np.linspace(0.0, 1.0, 41):
            solved = root(missing, start, args=(sense * share * friction,), tol=1e-12)
            assert solved.success
            start = solved.x
        np.testing.assert_allclose(found.band[:, column], start[3], atol=1e-5)
        moved = (found.rests[column, 0] - planned) @ outward
        assert moved == pytest.approx(start[3], abs=1e-5)  # legs that pull more lead it outward


def test_a_range_has_the_band_of_the_team_which_has_no_end_without_rest() -> None:
    hitch = triangle(cable_friction=0.05)
    found = ho.tolerance(standing(hitch), [0.5, 1.0]).band
    np.testing.assert_allclose(found, [settled(hitch).band] * 2, atol=1e-7)
    assert np.all(np.sign(found) == [-1.0, 1.0])
    assert np.all(np.abs(found) > 0.05)
    assert np.all(np.isinf(settled(triangle(), friction=3.0).band).any(axis=-1))


def ranges(hitch: ho.Hitch, **given: Any) -> Tolerance:
    return ho.tolerance(standing(hitch), [1.0], **given)


def gradients(hitch: ho.Hitch, **given: Any) -> list[np.ndarray]:
    """Derivatives of tensions and points by lengths, set points and forces."""
    found, n = settled(hitch, **given), hitch.team.robots
    at = np.concatenate([found.drones, found.vertices[hitch.team.layout.clasps]])
    rows = responses(resting_energy(hitch, **given), at[None])
    return np.split(rows, [n, 3 * n], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("held", [False, True])
def test_gradients_are_those_of_settled_hitches(topology: str, held: bool) -> None:
    hitch = random_hitch(3, 4, topology)
    team, h = hitch.team, 1e-5
    stiffness = team.stiffness.copy()
    if held:
        stiffness[[0, 3]] = np.inf
    base: dict[str, Any] = {"stiffness": stiffness, "cable_density": 0.008, "axial_stiffness": 500}
    by_length, by_place, by_force = gradients(hitch, **base)

    def difference(name: str, middle: Any, step: np.ndarray) -> np.ndarray:
        up, down = (settled(hitch, **(base | {name: middle + s * step})) for s in (h, -h))
        apart = up.tensions - down.tensions, (up.vertices - down.vertices).ravel()
        return np.concatenate(apart) / (2 * h)

    for k in range(team.robots):
        slope = difference("cable_length", team.cable_length, np.eye(team.robots)[k])
        np.testing.assert_allclose(by_length[:, k, 0], slope, rtol=1e-4, atol=2e-5)
    for i, axis in itertools.product(range(0, team.drones, 3), range(3)):
        step = np.zeros((team.drones, 3))
        step[i, axis] = 1.0
        for name, rows in (("offsets", by_place), ("forces", by_force)):
            slope = difference(name, 0.0, step)
            np.testing.assert_allclose(rows[:, i, axis], slope, rtol=1e-4, atol=2e-5)


@pytest.mark.slow
@given(seeds, st.integers(3, 6), topologies, st.sampled_from([0.0, 0.01]))
@settings(max_examples=6)
def test_sampled_hitches_stay_within_bounds(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch, rng = random_hitch(seed, n, topology), np.random.default_rng(seed)
    errors = {"cable_error": 0.01, "position_error": 0.01, "force_error": 0.02}
    found = ranges(hitch, **errors, cable_density=density)
    offsets, forces = unit(rng.normal(size=(2, 150, 2 * n, 3)))  # on the bounds' surface
    lengths = hitch.team.cable_length + 0.01 * rng.choice([-1.0, 1.0], (150, n))
    off = {"cable_length": lengths, "offsets": 0.01 * offsets, "forces": 0.02 * forces}
    samples = settled(hitch, cable_density=density, **off)
    beyond = (samples.tensions[..., None] - found.tensions[0]) * [-1.0, 1.0]
    assert np.max(beyond) <= 1e-9
    away = samples.vertices - found.settled.vertices[0]
    assert np.all(np.abs(away) <= found.vertex_halves[0] + found.vertex_remainders[0] + 1e-9)
    # Each within its ellipsoid, widened by what is beyond first order.
    shapes = found.ellipsoids[0] + 1e-18 * np.eye(3)
    for k in range(away.shape[1]):
        sizes, axes = np.linalg.eigh(shapes[k])
        wide = np.sqrt(np.maximum(sizes, 0.0)) + found.vertex_remainders[0] + 1e-9
        assert np.all(np.sum((away[:, k] @ axes / wide) ** 2, axis=-1) <= 1.0)
    assert np.all(np.linalg.norm(away, axis=-1) <= found.radii[0] + 1e-9)
    # They are not much wider than what is needed: the worst errors reach their ends.
    assert found.tension_remainders[0] < 0.25 * np.max(found.tension_halves)


def test_ends_of_ranges_are_reached() -> None:
    hitch = random_hitch(21, 4)
    found = ranges(hitch, cable_error=0.004)
    signs = np.array(list(itertools.product([-1.0, 1.0], repeat=4)))
    corners = settled(hitch, cable_length=hitch.team.cable_length + 0.004 * signs).tensions
    reached = np.stack([np.min(corners, axis=0), np.max(corners, axis=0)], axis=-1)
    spare = (found.tensions[0] - reached) * [-1.0, 1.0]
    assert np.all((spare >= 0.0) & (spare <= 3.0 * found.tension_remainders[0] + 1e-9))


@pytest.mark.slow
def test_standard_deviations_are_those_of_samples() -> None:
    hitch, rng = random_hitch(5, 4), np.random.default_rng(1)
    found = ranges(hitch, cable_error="sd:0.002", position_error="sd:0.003")
    lengths = hitch.team.cable_length + 0.002 * rng.normal(size=(1500, 4))
    offsets = 0.003 * rng.normal(size=(1500, 8, 3))
    samples = settled(hitch, cable_length=lengths, offsets=offsets)
    pulled, moved = (3.0 * np.std(each, axis=0) for each in (samples.tensions, samples.vertices))
    np.testing.assert_allclose(found.tension_halves[0], pulled, rtol=0.08)
    np.testing.assert_allclose(found.vertex_halves[0], moved, rtol=0.1, atol=1e-4)
    shapes = [np.cov(samples.vertices[:, k].T) * 9.0 for k in range(4)]
    np.testing.assert_allclose(found.ellipsoids[0], shapes, atol=0.15 * np.max(shapes))


def test_bounds_add_and_no_error_has_no_width() -> None:
    hitch, one, two = random_hitch(9, 5), {"cable_error": 0.003}, {"force_error": 0.01}
    cable, force, both, nothing = (ranges(hitch, **each) for each in (one, two, one | two, {}))
    for name in ("tension_halves", "vertex_halves"):
        total = getattr(cable, name) + getattr(force, name)
        np.testing.assert_allclose(getattr(both, name), total, rtol=1e-9)
        assert not np.any(getattr(nothing, name))
    assert not np.any(nothing.ellipsoids)
    assert np.max(nothing.tension_remainders) < 1e-9
    np.testing.assert_allclose(nothing.tensions[0, :, 0], hitch.team.tension, atol=1e-8)


def test_what_is_beyond_first_order_is_found_at_the_worst_of_three_deviations() -> None:
    """For one cable's error that is where it is three times its deviation, both ways."""
    hitch, step = random_hitch(9, 3, stiffness=2.0), 1e-5 * np.array([[1.0], [-1.0]])
    lengths, made = hitch.team.cable_length, []
    for size in (0.002, 0.004):
        made.append(ranges(hitch, cable_error=f"sd:{size}"))
        assert 0.0 < made[-1].tension_remainders[0] < 0.2 * np.max(made[-1].tension_halves)
    up, down = (settled(hitch, cable_length=lengths + h * np.eye(3)).tensions for h in step)
    slopes = (up - down).T / 2e-5  # of each tension by each length
    worst = 3.0 * 0.004 * unit(slopes)
    beyond = []
    for errors in (worst, -worst):
        found = settled(hitch, cable_length=lengths + errors).tensions
        beyond.append(np.abs(found - hitch.team.tension - errors @ slopes.T))
    assert made[1].tension_remainders[0] >= 2.0 * np.max(beyond) * (1.0 - 1e-3)
    grown = made[1].tension_remainders / made[0].tension_remainders
    np.testing.assert_allclose(grown, 4.0, rtol=0.1)  # as it is of second order


def test_slack_is_found_where_a_range_reaches_nothing() -> None:
    assert ranges(regular_hitch(3), cable_error=0.01, stiffness=20.0).slack_cables == ()
    loose = ranges(regular_hitch(3), cable_error=0.01, stiffness=120.0)
    assert loose.slack_cables == ("c0", "c1", "c2")
    assert np.all(loose.tensions[..., 0] == 0.0)


def test_sizes_are_read_and_refused_in_words() -> None:
    assert ho.ErrorSize.of("--x", "0.01") == ho.ErrorSize.of("--x", 0.01) == ho.ErrorSize(0.01)
    assert ho.ErrorSize.of("--x", "sd:0.02") == ho.ErrorSize(deviation=0.02)
    for wrong in ("", "sd:", "sd:-1", "-1", "nan", "1 cm", -1.0):
        with pytest.raises(ho.InputError, match=r"^--x = "):
            ho.ErrorSize.of("--x", wrong)


def test_taut_times_leave_out_rising_tensions() -> None:
    motion = standing(regular_hitch(3))
    np.testing.assert_allclose(taut_times(motion, 5), [0.0, 0.5, 1.0, 1.5, 2.0], atol=0.02)
    assert taut_times(motion, 1).tolist() == [0.0]
    rising = PiecewisePolynomial(np.array([0.0, 2.0]), 0.5 * np.outer(np.ones(3), [0.0, 1.0])[None])
    found = taut_times(dataclasses.replace(motion, tensions=rising), 5)
    np.testing.assert_allclose(found[[0, -1]], [1.8, 2.0], atol=0.03)
