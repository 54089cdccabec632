"""Rest positions of hitches, their friction bands, and tolerances for errors."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, root

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.energy import INTEGRAL_ERROR, HitchEnergy, energy_of
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.rest_errors import responses
from hitchopt.lab.statics.equilibrium import Equilibrium, conditions_of, samples_of
from hitchopt.lab.statics.files import draw_statics
from hitchopt.lab.statics.tolerance import ErrorSize, Tolerance, taut_times
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.loads import sags
from hitchopt.motion.motion import Phase, concatenated
from hitchopt.planners.rests import rest_motion
from hitchopt.trajectory import PiecewisePolynomial
from problems.random_morph import random_convex_polygon
from tests.helpers.clasp_balance import clasp_residuals

seeds = st.integers(0, 2**32 - 1)
topologies = st.sampled_from(["closed", "open"])


def resting_motion(hitch: ho.Hitch) -> ho.Motion:
    return rest_motion(hitch, Requirements(), 2.0, Phase("hold", 0, 0.0, 2.0))


def random_hitch(
    seed: int, n: int, topology: str = "closed", *, density: float = 0.0, stiffness: float = 5.0
) -> ho.Hitch:
    """Return a hitch of unequal cables, tensions, masses, stiffness and leg lengths."""
    rng = np.random.default_rng(seed)
    sides = n if topology == "closed" else n + 3
    outline: Any = random_convex_polygon(sides, 1.3, rng).translated(rng.normal(size=2))
    if topology == "open":
        outline = ho.ConvexArc(outline.vertices[: n + 1])
    length = outline.edge_lengths + rng.uniform(0.7, 1.1, n)
    kinds = [ho.Quadrotor(0.1 + 0.01 * k, 2.6, stiffness * (1.0 + 0.1 * k)) for k in range(n)]
    options: Any = {"topology": topology, "cable_density": density, "quadrotor": kinds}
    team = ho.Team(n, length, tension=rng.uniform(0.45, 0.55, n), **options)
    slack = length - outline.edge_lengths
    legs = team.layout.q_legs_of(slack * rng.uniform(0.35, 0.65, n), slack)
    return ho.Hitch(team, outline, 0.8 + rng.uniform(), legs)


def regular_hitch(n: int, tension: float = 0.5, **team: Any) -> ho.Hitch:
    polygon = ho.regular_polygon(n, 1.2)
    return ho.Hitch.balanced(ho.Team(n, 2.4, tension=tension, **team), polygon, 1.3)


def settle_hitch(hitch: ho.Hitch, **conditions: Any) -> Equilibrium:
    return ho.equilibrium(resting_motion(hitch), 1.0, **conditions)


def resting_energy(hitch: ho.Hitch, **options: Any) -> HitchEnergy:
    motion, conditions = resting_motion(hitch), conditions_of(hitch.team, **options)
    return energy_of(hitch.team, conditions, samples_of(motion, [1.0], conditions)[1])


@given(seeds, st.integers(3, 5), topologies)
@settings(max_examples=10)
def test_planned_hitches_rest_as_planned(seed: int, n: int, topology: str) -> None:
    """Legs rise for the weight: plan and statics have the same catenaries."""
    plain, deviations = random_hitch(seed, n, topology), list[float]()
    rest = settle_hitch(plain)
    np.testing.assert_allclose(rest.vertices, plain.vertices, atol=1e-9)
    np.testing.assert_allclose(rest.drones, plain.drones, atol=1e-9)
    np.testing.assert_allclose(rest.tensions, plain.team.tension, atol=1e-9)
    assert rest.slack_cables == rest.loose_clasps == ()
    for density in (0.002, 0.004):
        hitch = random_hitch(seed, n, topology, density=density)
        rest = settle_hitch(hitch)
        deviations.append(float(np.max(np.abs(rest.vertices - hitch.vertices))))
        np.testing.assert_allclose(rest.tensions, hitch.team.tension, rtol=1e-6)
        # Level drones would let the vertices sag by far more.
        level = settle_hitch(plain, cable_density=density)
        assert deviations[-1] < 0.25 * np.max(np.abs(level.vertices - level.planned_vertices))
    assert max(deviations) < 1e-6


@given(seeds, st.integers(3, 6), topologies, st.sampled_from([0.0, 0.01]), st.booleans())
@settings(max_examples=30)
def test_forces_balance_by_independent_formulas(
    seed: int, n: int, topology: str, density: float, named_controller: bool
) -> None:
    hitch, rng = random_hitch(seed, n, topology), np.random.default_rng(seed + 1)
    if named_controller:  # horizontal and vertical gains differ; the integral force is bounded
        gains = {"kp": [3.0, 2.5], "ki": [0.02, 0.05]}
        options: Any = {"stiffness": None, "controller": "mellinger", "gains": gains}
        kinds = tuple(dataclasses.replace(kind, **options) for kind in hitch.team.quadrotor)
        hitch = dataclasses.replace(hitch, team=dataclasses.replace(hitch.team, quadrotor=kinds))
    offsets, forces = (rng.uniform(-size, size, (2 * n, 3)) for size in (0.02, 0.03))
    layout, load = hitch.team.layout, rng.uniform(0.0, 0.003, len(hitch.team.layout.clasps))
    errors = {"offsets": offsets, "forces": forces, "load": load}
    rest = settle_hitch(hitch, cable_density=density, **errors)
    assert rest.force_residual < 1e-8
    assert rest.length_residual < 1e-9
    error = hitch.drones + offsets - rest.drones
    integral_force = hitch.team.integral * error / np.hypot(error, INTEGRAL_ERROR)
    spring = hitch.team.stiffness * error + integral_force
    outer = spring + forces - hitch.cable_forces
    if density == 0.0:
        q, r, weight = rest.drones[0::2], rest.drones[1::2], np.outer(load, [0.0, 0.0, -9.81])
        force = clasp_residuals(rest.vertices, q, r, rest.tensions, weight, topology)
        assert np.max(np.linalg.norm(force, axis=-1)) < 1e-8
        # The spring force of a drone equals the pull of its cable.
        legs = unit(rest.drones - rest.vertices[layout.pulled_to])
        np.testing.assert_allclose(outer, np.repeat(rest.tensions, 2)[:, None] * legs, atol=1e-8)
    else:  # external forces balance the total weight
        mass = np.sum(load) + density * np.sum(hitch.team.cable_length)
        np.testing.assert_allclose(np.sum(outer, axis=0), [0.0, 0.0, 9.81 * mass], atol=2e-5)


def test_slopes_and_derivatives_are_those_of_the_energy() -> None:
    hitch = random_hitch(3, 4, "open")
    energy = resting_energy(hitch, cable_density=0.01, stiffness=4.0)
    x, h = energy.start, 1e-6
    direction = np.random.default_rng(2).normal(size=x.shape)
    up, down = x + h * direction, x - h * direction
    change = (energy.values(up) - energy.values(down))[0] / (2.0 * h)
    assert np.sum(energy.slopes(x) * direction) == pytest.approx(change, rel=1e-5)
    for friction in (0.0, 0.1):
        (matrix,) = energy.matrix(x, energy.linear(x, friction).forces)
        change = (energy.slopes(up, friction) - energy.slopes(down, friction)).ravel() / (2.0 * h)
        np.testing.assert_allclose(matrix @ direction.ravel(), change, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("tension", [0.6, 1.2])
@pytest.mark.parametrize("n", [3, 5, 0])
def test_clasps_of_cables_planned_as_weightless_hang_lower_by_their_sags(
    n: int, tension: float
) -> None:
    """Below drones with soft loops, which keep the tension; those sink by half a cable's weight."""
    outline: Any = ho.regular_polygon(n, 1.0) if n else [[0.3, 0.8], [0.8, -0.5], [-0.4, -0.3]]
    team = ho.Team(n or 3, 2.6, tension=tension, quadrotor=ho.Quadrotor(stiffness=0.5))
    hitch, density = ho.Hitch.balanced(team, outline, 1.3), 0.003
    settled = settle_hitch(hitch, cable_density=density)
    drones, clasps = (
        (planned - rest)[:, 2]
        for planned, rest in (
            (settled.planned_drones, settled.drones),
            (settled.planned_vertices, settled.vertices),
        )
    )
    np.testing.assert_allclose(drones, 0.5 * 9.81 * density * 2.6 / 0.5, rtol=1e-4 if n else 0.02)
    (found, *_) = sags(resting_motion(hitch), density)
    np.testing.assert_allclose(clasps - np.mean(drones), found, rtol=0.003 if n else 0.02)
    if n:
        edge, leg = hitch.polygon.edge_lengths[0], hitch.q_legs[0]
        regular = density * 9.81 * leg * (edge + leg) / (2.0 * tension)
        np.testing.assert_allclose(found, regular, rtol=1e-5)


def test_equal_errors_of_all_cables_of_a_regular_hitch() -> None:
    """By symmetry vertices stay; each end moves by half of the error, against k and the stretch."""
    k, T, EA, change = 4.75, 0.5, 1e4, np.array([[-0.02], [-0.005], [0.01]])
    lengths = 2.4 + change * np.ones(3)
    rest = settle_hitch(regular_hitch(3, T), stiffness=k, cable_length=lengths, axial_stiffness=EA)
    expected = T - change / (2.0 / k + 2.4 / EA)
    np.testing.assert_allclose(rest.tensions, expected * np.ones(3), rtol=1e-9)
    np.testing.assert_allclose(rest.vertices, rest.planned_vertices, atol=1e-9)


def test_integral_action_holds_drones_at_set_points_with_any_stiffness() -> None:
    hitch, conditions = regular_hitch(4), {"cable_length": 2.39, "axial_stiffness": 200.0}
    for rigid in ({"integral": True, "stiffness": 3.0}, {"stiffness": np.inf}):
        rest = settle_hitch(hitch, **conditions, **rigid)
        np.testing.assert_array_equal(rest.drones, hitch.drones)
        np.testing.assert_allclose(rest.tensions, 0.5 + 200.0 * 0.01 / 2.4, rtol=1e-9)


def test_slack_cables_and_loose_clasps_are_reported() -> None:
    rest = settle_hitch(regular_hitch(5), cable_length=[4.4, 2.4, 2.4, 2.4, 2.4], stiffness=4.75)
    assert rest.tensions[0] == 0.0
    assert "c0" in rest.slack_cables
    assert {"p0", "p1"} <= set(rest.loose_clasps)


def test_samples_settle_as_each_alone() -> None:
    hitch, rng = random_hitch(4, 3, stiffness=8.0), np.random.default_rng(4)
    lengths = hitch.team.cable_length + rng.uniform(-0.01, 0.01, (2, 3, 3))
    offsets = rng.uniform(-0.01, 0.01, (3, 6, 3))
    together = ho.equilibrium(
        resting_motion(hitch), [0.5, 1.0, 1.5], cable_length=lengths, offsets=offsets
    )
    assert together.tensions.shape == (2, 3, 3)
    for i, j in np.ndindex(2, 3):
        alone = settle_hitch(hitch, cable_length=lengths[i, j], offsets=offsets[j])
        np.testing.assert_allclose(together.tensions[i, j], alone.tensions, atol=1e-9)
        np.testing.assert_allclose(together.vertices[i, j], alone.vertices, atol=1e-9)


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        (
            {"stiffness": 0.0},
            r"stiffness = 0\.0: must be one positive number up to 1e\+12, or an array \(…, 6, 3\)",
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
        settle_hitch(regular_hitch(3), **conditions)


def test_times_without_a_hitch_are_refused() -> None:
    motion = resting_motion(regular_hitch(3))
    (hold,) = motion.phases
    free = dataclasses.replace(motion, phases=(dataclasses.replace(hold, state=CableState.FREE),))
    words = r"t = 1\.0: must be within a hitch: never in this plan"
    later = concatenated([motion, motion, free])  # 2 s each, the last one untied
    spans = r"t = 5\.0: must be within a hitch: 0 to 4 s; see its phases"
    for plan, t, message in (
        (free, 1.0, words),
        (motion, -1.0, r"t = -1\.0"),
        (later, 5.0, spans),
    ):
        with pytest.raises(ho.InputError, match=message):
            ho.equilibrium(plan, t)


@pytest.mark.parametrize(("seed", "density"), [(1, 0.006), (2, 0.012), (3, 0.018)])
def test_exact_catenaries_are_in_balance_to_a_millimetre(seed: int, density: float) -> None:
    """Catenaries between the settled nodes are as long as the cable.

    Their residual forces correspond to movements below 1 mm.
    """
    hitch, n, w = random_hitch(seed, 5, density=density), 5, 9.81 * density
    rest = settle_hitch(hitch)
    x = np.concatenate([rest.drones, rest.vertices])
    residuals, lengths = np.zeros_like(x), np.zeros(n)
    residuals[: 2 * n] = hitch.team.stiffness * (hitch.drones - rest.drones)
    residuals[: 2 * n] -= hitch.cable_forces
    for k in range(n):
        ends = 2 * n + np.array([k, (k + 1) % n])  # of the edge, where legs begin
        middle = np.mean(x[ends, 2])
        for first, last in ((ends[0], ends[1]), (ends[0], 2 * k), (ends[1], 2 * k + 1)):
            chord = float(np.linalg.norm(x[last] - x[first]))
            tension = rest.tensions[k] + w * (x[first, 2] - middle)

            def curve(log: float) -> tuple[float, np.ndarray]:
                length = chord * (1.0 + np.exp(log))  # noqa: B023
                a, b = x[first], x[last]  # noqa: B023
                return length, w * Catenary.between(a, b, length).pull(a, b)

            log = brentq(lambda log: np.linalg.norm(curve(log)[1][0]) - tension, -18.0, -1.0)  # noqa: B023
            length, pulls = curve(log)
            lengths[k] += length
            residuals[[first, last]] += pulls
    np.testing.assert_allclose(lengths, hitch.team.cable_length, rtol=1e-3)  # arcs: 1 %
    energy = resting_energy(hitch)
    movements = energy.solved(
        energy.matrix(x[None], energy.linear(x[None]).forces), residuals[None]
    )[0]
    assert np.max(np.linalg.norm(movements, axis=-1)) < 1e-3


@pytest.mark.parametrize("inward", [0.3, 0.45])
@pytest.mark.parametrize("feed_forward", [True, False])
def test_hitches_with_drones_far_inward_come_to_rest(inward: float, feed_forward: bool) -> None:
    hitch = regular_hitch(4)
    legs = unit(hitch.drones - hitch.vertices[hitch.team.layout.anchors])
    conditions: Any = {"stiffness": 12.0, "cable_density": 0.012, "feed_forward": feed_forward}
    rest = settle_hitch(hitch, **conditions, offsets=-inward * legs)
    assert rest.force_residual < 1e-8
    assert np.all(rest.tensions > 0.0)
    assert np.all(rest.tensions < 0.25)
    assert rest.slack_cables or rest.loose_clasps  # they would sag by over an eighth


@pytest.mark.slow
def test_a_drone_led_through_its_vertex_has_no_rest() -> None:
    hitch, beyond = regular_hitch(5), np.zeros((10, 1))
    legs = hitch.drones - hitch.vertices[hitch.team.layout.anchors]
    beyond[2] = -2.0  # q1 is led through its vertex
    with pytest.raises(ho.InfeasibleError, match="move drones away from vertices"):
        settle_hitch(hitch, stiffness=3.0, cable_density=0.01, offsets=beyond * legs)


STIFFNESS, TENSION = 4.75, 0.6


def triangle(**team: Any) -> ho.Hitch:
    return regular_hitch(3, TENSION, quadrotor=ho.Quadrotor(stiffness=STIFFNESS), **team)


@pytest.mark.slow
@given(seeds, st.integers(3, 6), topologies, st.sampled_from([0.0, 0.006]))
@settings(max_examples=10)
def test_bands_contain_the_rest_without_friction_and_grow_with_friction(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch = random_hitch(seed, n, topology, density=density, stiffness=20.0)
    bands = [settle_hitch(hitch, friction=friction).band for friction in (0.0, 0.002, 0.004)]
    np.testing.assert_array_equal(bands[0][:, 0], bands[0][:, 1])
    for narrow, wide in itertools.pairwise(bands):
        assert np.all((wide - narrow) * [-1.0, 1.0] >= -1e-6)
    assert np.all(np.ptp(bands[1][hitch.team.layout.clasps], axis=-1) > 1e-4)


@pytest.mark.parametrize("friction", [0.01, 0.05, 0.1])
def test_ends_of_a_triangles_band_solve_its_five_equations(friction: float) -> None:
    """Unknowns of one vertex, one drone and one cable; symmetry determines the others."""
    hitch, side = triangle(), 1.2
    setpoint, vertex = hitch.drones[0], hitch.vertices[0]
    outward = unit(vertex - np.mean(hitch.vertices, axis=0))
    edge, feed_forward = unit(hitch.vertices[1] - vertex), TENSION * unit(setpoint - vertex)

    def missing(unknowns: np.ndarray, friction: float) -> np.ndarray:
        drone, distance, tension = unknowns[:3], unknowns[3], unknowns[4]
        leg = drone - (vertex + distance * outward)
        size = float(np.linalg.norm(leg))
        turn = np.arccos(-(leg / size) @ edge)  # of a helix, whose contact both cables share
        pull = tension * np.exp(friction * np.pi * np.sin(0.5 * turn) ** 2)
        balance = STIFFNESS * (setpoint - drone) + feed_forward - pull * leg / size
        clasp = pull * (leg @ outward) / size - tension * np.cos(np.pi / 6)
        total = 2.0 * size + side + np.sqrt(3.0) * distance - 2.4
        return np.array([*balance, clasp, total])

    rest = settle_hitch(hitch, friction=friction, axial_stiffness=1e6)
    for column, sense in enumerate((-1.0, 1.0)):
        start = np.array([*setpoint, 0.0, TENSION])
        for share in np.linspace(0.0, 1.0, 41):
            solution = root(missing, start, args=(sense * share * friction,), tol=1e-12)
            assert solution.success
            start = solution.x
        np.testing.assert_allclose(rest.band[:, column], start[3], atol=1e-5)
        movement = (rest.rests[column, 0] - vertex) @ outward
        assert movement == pytest.approx(
            start[3], abs=1e-5
        )  # a stronger pull of the leg moves it outward


def test_tolerances_contain_the_band_of_the_teams_friction() -> None:
    hitch = triangle(cable_friction=0.05)
    bands = ho.tolerance(resting_motion(hitch), [0.5, 1.0]).band
    np.testing.assert_allclose(bands, [settle_hitch(hitch).band] * 2, atol=1e-7)
    assert np.all(np.sign(bands) == [-1.0, 1.0])
    assert np.all(np.abs(bands) > 0.05)
    assert np.all(np.isinf(settle_hitch(triangle(), friction=3.0).band).any(axis=-1))


def tolerance_of(hitch: ho.Hitch, **conditions: Any) -> Tolerance:
    return ho.tolerance(resting_motion(hitch), [1.0], **conditions)


def gradients(hitch: ho.Hitch, **conditions: Any) -> list[np.ndarray]:
    """Return derivatives of tensions and points by lengths, setpoints and forces."""
    rest, n = settle_hitch(hitch, **conditions), hitch.team.robots
    positions = np.concatenate([rest.drones, rest.vertices[hitch.team.layout.clasps]])
    matrix = responses(resting_energy(hitch, **conditions), positions[None])[:, : 5 * n]
    return np.split(matrix, [n, 3 * n], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("rigid", [False, True])
def test_gradients_are_those_of_settled_hitches(topology: str, rigid: bool) -> None:
    hitch = random_hitch(3, 4, topology)
    team, h = hitch.team, 1e-5
    stiffness = team.stiffness.copy()
    if rigid:
        stiffness[[0, 3]] = np.inf
    conditions: dict[str, Any] = {
        "stiffness": stiffness,
        "cable_density": 0.008,
        "axial_stiffness": 500,
    }
    by_length, by_place, by_force = gradients(hitch, **conditions)

    def difference(name: str, middle: Any, step: np.ndarray) -> np.ndarray:
        up, down = (
            settle_hitch(hitch, **(conditions | {name: middle + s * step})) for s in (h, -h)
        )
        differences = up.tensions - down.tensions, (up.vertices - down.vertices).ravel()
        return np.concatenate(differences) / (2 * h)

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
def test_samples_are_within_bounds(seed: int, n: int, topology: str, density: float) -> None:
    hitch, rng = random_hitch(seed, n, topology), np.random.default_rng(seed)
    errors = {"cable_error": 0.01, "position_error": 0.01, "force_error": 0.02}
    tolerance = tolerance_of(hitch, **errors, cable_density=density)
    offsets, forces = unit(rng.normal(size=(2, 150, 2 * n, 3)))  # on the bounds' surface
    lengths = hitch.team.cable_length + 0.01 * rng.choice([-1.0, 1.0], (150, n))
    conditions = {"cable_length": lengths, "offsets": 0.01 * offsets, "forces": 0.02 * forces}
    samples = settle_hitch(hitch, cable_density=density, **conditions)
    excess = (samples.tensions[..., None] - tolerance.tensions[0]) * [-1.0, 1.0]
    assert np.max(excess) <= 1e-9
    deviations = samples.vertices - tolerance.equilibrium.vertices[0]
    assert np.all(
        np.abs(deviations) <= tolerance.vertex_halves[0] + tolerance.vertex_remainders[0] + 1e-9
    )
    # Vertices are within their ellipsoids, widened by the remainders.
    shapes = tolerance.ellipsoids[0] + 1e-18 * np.eye(3)
    for k in range(deviations.shape[1]):
        sizes, axes = np.linalg.eigh(shapes[k])
        widths = np.sqrt(np.maximum(sizes, 0.0)) + tolerance.vertex_remainders[0] + 1e-9
        assert np.all(np.sum((deviations[:, k] @ axes / widths) ** 2, axis=-1) <= 1.0)
    assert np.all(np.linalg.norm(deviations, axis=-1) <= tolerance.radii[0] + 1e-9)
    # Remainders are a small part of the bounds.
    assert tolerance.tension_remainders[0] < 0.25 * np.max(tolerance.tension_halves)


def test_ends_of_ranges_are_reached() -> None:
    hitch = random_hitch(21, 4)
    tolerance = tolerance_of(hitch, cable_error=0.004)
    signs = np.array(list(itertools.product([-1.0, 1.0], repeat=4)))
    corners = settle_hitch(hitch, cable_length=hitch.team.cable_length + 0.004 * signs).tensions
    extremes = np.stack([np.min(corners, axis=0), np.max(corners, axis=0)], axis=-1)
    margins = (tolerance.tensions[0] - extremes) * [-1.0, 1.0]
    assert np.all((margins >= 0.0) & (margins <= 3.0 * tolerance.tension_remainders[0] + 1e-9))


@pytest.mark.slow
def test_standard_deviations_are_those_of_samples() -> None:
    hitch, rng = random_hitch(5, 4), np.random.default_rng(1)
    tolerance = tolerance_of(hitch, cable_error="sd:0.002", position_error="sd:0.003")
    lengths = hitch.team.cable_length + 0.002 * rng.normal(size=(1500, 4))
    offsets = 0.003 * rng.normal(size=(1500, 8, 3))
    samples = settle_hitch(hitch, cable_length=lengths, offsets=offsets)
    tension_halves, vertex_halves = (
        3.0 * np.std(each, axis=0) for each in (samples.tensions, samples.vertices)
    )
    np.testing.assert_allclose(tolerance.tension_halves[0], tension_halves, rtol=0.08)
    np.testing.assert_allclose(tolerance.vertex_halves[0], vertex_halves, rtol=0.1, atol=1e-4)
    shapes = [np.cov(samples.vertices[:, k].T) * 9.0 for k in range(4)]
    np.testing.assert_allclose(tolerance.ellipsoids[0], shapes, atol=0.15 * np.max(shapes))


def test_bounds_add_and_no_error_has_no_width() -> None:
    hitch, one, two = random_hitch(9, 5), {"cable_error": 0.003}, {"force_error": 0.01}
    cable, force, both, zero = (tolerance_of(hitch, **each) for each in (one, two, one | two, {}))
    for name in ("tension_halves", "vertex_halves"):
        total = getattr(cable, name) + getattr(force, name)
        np.testing.assert_allclose(getattr(both, name), total, rtol=1e-9)
        assert not np.any(getattr(zero, name))
    assert not np.any(zero.ellipsoids)
    assert np.max(zero.tension_remainders) < 1e-9
    np.testing.assert_allclose(zero.tensions[0, :, 0], hitch.team.tension, atol=1e-8)


def test_remainders_beyond_first_order_are_taken_at_three_standard_deviations() -> None:
    """For cable errors the worst case is at plus or minus three standard deviations."""
    hitch, step = random_hitch(9, 3, stiffness=2.0), 1e-5 * np.array([[1.0], [-1.0]])
    lengths, tolerances = hitch.team.cable_length, []
    for size in (0.002, 0.004):
        tolerances.append(tolerance_of(hitch, cable_error=f"sd:{size}"))
        assert (
            0.0 < tolerances[-1].tension_remainders[0] < 0.2 * np.max(tolerances[-1].tension_halves)
        )
    up, down = (settle_hitch(hitch, cable_length=lengths + h * np.eye(3)).tensions for h in step)
    slopes = (up - down).T / 2e-5  # of each tension by each length
    worst = 3.0 * 0.004 * unit(slopes)
    remainders = []
    for errors in (worst, -worst):
        rest = settle_hitch(hitch, cable_length=lengths + errors).tensions
        remainders.append(np.abs(rest - hitch.team.tension - errors @ slopes.T))
    assert tolerances[1].tension_remainders[0] >= 2.0 * np.max(remainders) * (1.0 - 1e-3)
    ratio = tolerances[1].tension_remainders / tolerances[0].tension_remainders
    np.testing.assert_allclose(ratio, 4.0, rtol=0.1)  # second order


def test_cables_whose_range_reaches_zero_are_slack() -> None:
    assert tolerance_of(regular_hitch(3), cable_error=0.01, stiffness=20.0).slack_cables == ()
    loose = tolerance_of(regular_hitch(3), cable_error=0.01, stiffness=120.0)
    assert loose.slack_cables == ("c0", "c1", "c2")
    assert np.all(loose.tensions[..., 0] == 0.0)


def test_error_sizes_are_parsed_or_refused() -> None:
    assert ErrorSize.of("--x", "0.01") == ErrorSize.of("--x", 0.01) == ErrorSize(0.01)
    assert ErrorSize.of("--x", "sd:0.02") == ErrorSize(deviation=0.02)
    for text in ("", "sd:", "sd:-1", "-1", "nan", "1 cm", -1.0):
        with pytest.raises(ho.InputError, match=r"^--x = "):
            ErrorSize.of("--x", text)


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_pictures_draw_the_edges_of_rings_and_chains(topology: str) -> None:
    rest = ho.equilibrium(resting_motion(random_hitch(9, 3, topology)), [1.0])
    figure = draw_statics(rest, None)
    _, from_above = figure.axes
    edges = np.array(from_above.lines[0].get_xydata())
    layout = rest.team.layout
    np.testing.assert_allclose(edges[:-1], rest.vertices[0, layout.starts, :2])
    np.testing.assert_allclose(edges[1:], rest.vertices[0, layout.ends, :2])


def test_taut_times_exclude_rising_tensions() -> None:
    motion = resting_motion(regular_hitch(3))
    np.testing.assert_allclose(taut_times(motion, 5), [0.0, 0.5, 1.0, 1.5, 2.0], atol=0.02)
    assert taut_times(motion, 1).tolist() == [0.0]
    rising = PiecewisePolynomial(np.array([0.0, 2.0]), 0.5 * np.outer(np.ones(3), [0.0, 1.0])[None])
    times = taut_times(motion.replaced(tensions=rising), 5)
    np.testing.assert_allclose(times[[0, -1]], [1.8, 2.0], atol=0.03)
