"""Grips: shortest paths around sections, balance, figures of rope simulations, capacities."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

import hitchopt as ho
from hitchopt.carrying.holding import Grip, grip_capacity, step_toward_balance, wraps_around
from hitchopt.carrying.polygons import GripTask, grips
from hitchopt.hitch.requirements import Requirements
from hitchopt.values import Array

BOX = ho.Section([[0.2, 0.15], [0.2, -0.15], [-0.2, -0.15], [-0.2, 0.15]])
DISC = ho.Section(radius=0.2)
ODD = ho.Section([[0.35, 0.1], [0.15, -0.2], [-0.15, -0.15], [-0.2, 0.2], [0.15, 0.25]])
SECTIONS = (BOX, DISC, ODD)
SIMULATED_FRICTION = 0.15
STEEP = Requirements(ho.Limits(tilt=math.radians(60.0)))


def regular(n: int, radius: float, turn: float = 0.5 * math.pi) -> Array:
    angles = turn - 2.0 * math.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def rhombus(off: float) -> Array:
    return np.array([[0, 0.15 + off], [0.2 + off, 0], [0, -0.15 - off], [-0.2 - off, 0]])


def disc_triangle(total: float) -> Array:
    """Vertices of three cables that wrap a disc of 0.2 m by ``total`` [deg] in all."""
    half = 0.5 * math.radians((total + 180.0) / 3.0)
    return regular(3, 0.2 / math.sin(half))


@pytest.mark.parametrize("section", SECTIONS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(3, 6))
def test_taut_edges_are_hulls_of_section_and_clasps(section: ho.Section, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    centre, size = section.centroid, section.circumradius + np.linalg.norm(section.centroid)
    vertices = centre + regular(n, 1.0, rng.uniform(0, 6)) * size * rng.uniform(1.02, 1.9, (n, 1))
    wraps = wraps_around(section, vertices)
    points = (section.core[:, None] + regular(3000, section.rounding)).reshape(-1, 2)
    for k, (first, last) in enumerate(zip(vertices, np.roll(vertices, -1, axis=0), strict=True)):
        chord, away = last - first, points - first
        left = points[chord[0] * away[:, 1] - chord[1] * away[:, 0] > 0.0]  # past the chord
        if len(left) == 0:
            assert wraps.angles[k] == pytest.approx(0.0, abs=0.05)
            continue
        hull = ConvexHull(np.concatenate([[first, last], left]))
        shortest = hull.area - float(np.linalg.norm(chord))  # a hull's area is its perimeter in 2-D
        assert wraps.lengths[k] == pytest.approx(shortest, rel=2e-5, abs=2e-6)


@pytest.mark.parametrize("n", [3, 5])
def test_legs_continue_the_neighbouring_edges_and_balance_them(n: int) -> None:
    vertices = regular(n, 0.38) * [1.05, 0.97] + ODD.centroid
    grip = Grip.of(ODD, vertices, 1.6, 1.3)
    q, r = grip.leg_directions[:, 0], np.roll(grip.leg_directions[:, 1], 1, axis=0)
    wraps = grip.wraps
    np.testing.assert_allclose(q, np.roll(wraps.arriving, 1, axis=0), atol=1e-12)
    np.testing.assert_allclose(r, -wraps.leaving, atol=1e-12)
    np.testing.assert_allclose(grip.pulls, 1.3 * (q + r), atol=1e-12)
    np.testing.assert_allclose(grip.legs.sum(axis=1) + wraps.lengths, 1.6, atol=1e-12)
    arms = vertices - ODD.centroid
    moment = np.sum(arms[:, 0] * grip.pulls[:, 1] - arms[:, 1] * grip.pulls[:, 0])
    np.testing.assert_allclose(grip.imbalance, [*grip.pulls.sum(axis=0), moment], atol=1e-12)


def test_capacities_of_a_disc_by_tension_friction_and_thrust() -> None:
    """A cylinder of 100 g needs 1.3 N; by hand legs rise by their share of the weight over T."""
    (one, _), (other, binding) = (capacity(tension, 0.5) for tension in (1.0, 1.3))
    assert one < 0.1 < other
    assert binding == "grip"
    mass, binding = capacity(1.4, 100.0)
    assert binding == "thrust"
    rise = math.asin(mass * 9.81 / 6.0 / 1.4)
    upward = 0.132 * 9.81 + 1.4 * math.sin(rise)
    assert math.hypot(1.4 * math.cos(rise), upward) == pytest.approx(2.6, rel=1e-3)


def capacity(tension: float, friction: float) -> tuple[float, str]:
    """Return the mass [kg] that three cables around a disc hold, and the limit that binds."""
    search = task(DISC, 3, 1.6, tension)
    most = grip_capacity(next(grips(search)), search.kind, friction, 1.5)
    return most.mass, most.binding


def test_figures_of_rope_simulations() -> None:
    """Drones 0.24 m apart at 212°; 71 g at 1 N with 60° per cable; the rhombus about a box."""
    grip = Grip.of(DISC, disc_triangle(212.0), 1.95, 1.0)
    assert np.degrees(grip.wraps.angles).sum() == pytest.approx(212.0)
    assert np.linalg.norm(grip.drones[0, 0] - grip.drones[0, 1]) == pytest.approx(0.24, abs=1e-3)
    grip = Grip.of(DISC, disc_triangle(180.0), 1.6, 1.0, clasp_friction=SIMULATED_FRICTION)
    assert grip.slip_load(0.5) / (1.5 * 9.81) == pytest.approx(0.071, abs=1e-3)
    for off, wrap, apart in ((0.09, 137.0, 0.23), (0.12, 77.0, 0.34)):
        grip = Grip.of(BOX, rhombus(off), 0.9, 1.3)
        assert np.degrees(grip.wraps.angles).sum() == pytest.approx(wrap, abs=5.0)
        assert np.min(pdist(grip.drones.reshape(-1, 2))) == pytest.approx(apart, abs=0.01)


def task(section: ho.Section, n: int, cable: float, tension: float = 1.3) -> GripTask:
    return GripTask(section, n, cable, tension, SIMULATED_FRICTION, STEEP, ho.Quadrotor())


def test_the_best_grip_does_not_depend_on_the_outlines_origin() -> None:
    shift = np.array([-100.0, 40.0])
    one, two = (
        next(grips(task(ho.Section(BOX.core + by), 4, 0.95))) for by in (0.0 * shift, shift)
    )
    assert two.slip_load(0.5) == pytest.approx(one.slip_load(0.5))
    # A box has two best grips, mirror images: rounding chooses one.
    here, there = (np.linalg.norm(v, axis=-1) for v in (one.vertices, two.vertices - shift))
    np.testing.assert_allclose(np.sort(there), np.sort(here), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("section", "n", "cable"), [(DISC, 3, 1.6), (BOX, 4, 0.95)])
def test_no_sampled_grip_beats_the_best_one(section: ho.Section, n: int, cable: float) -> None:
    made, rng = task(section, n, cable), np.random.default_rng(5)
    found = next(grips(made))
    assert made.shortest(found)[0] >= 0.0
    np.testing.assert_allclose(found.imbalance, 0.0, atol=1e-5)
    base = regular(n, 1.0) if section is DISC else rhombus(0.0) / np.array([0.2, 0.15])
    for _ in range(200):
        vertices = base * rng.uniform(0.2, 0.45, 2 if section is BOX else 1)
        if np.min(section.clearance(vertices)[0]) > 0.021:
            tried = made.grip(vertices)
            worse = tried.slip_load(0.5) <= found.slip_load(0.5) * (1.0 + 1e-4)
            assert worse or made.shortest(tried)[0] < 0.05


CRATE = ho.Section([[0.16, 0.13], [0.16, -0.13], [-0.16, -0.13], [-0.16, 0.13]])


def energy(grip: Grip, turn: float) -> float:
    """Return the energy [J] of cables around a turned section, as all else yields."""
    drones = grip.drones

    def of_moves(moves: Array) -> float:
        """Return the energy for moves of the section and of clasps [m]."""
        clasps = grip.vertices + moves[2:].reshape(-1, 2)
        back = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        local = (clasps - moves[:2] - grip.section.centroid) @ back + grip.section.centroid
        ends = np.stack([clasps, np.roll(clasps, -1, axis=0)], axis=1)
        legs = np.sum(np.linalg.norm(drones - ends, axis=-1))
        return grip.tension * float(np.sum(wraps_around(grip.section, local).lengths) + legs)

    return float(minimize(of_moves, np.zeros(2 + grip.vertices.size), options={"gtol": 1e-9}).fun)


@pytest.mark.parametrize(
    ("section", "vertices"),
    [
        (CRATE, np.array([[0.0, 0.18], [0.0, -0.18]])),
        (CRATE, np.array([[0.28, 0.0], [-0.28, 0.0]])),
        (ho.Section(regular(6, 0.15)), regular(3, 0.2)),
    ],
)
def test_stiffness_of_yaw_is_that_of_the_cables_lengths(
    section: ho.Section, vertices: Array
) -> None:
    grip = Grip.of(section, vertices, 2.4, 1.3)
    turn = 5e-3
    there, here, back = (energy(grip, angle) for angle in (turn, 0.0, -turn))
    assert (there - 2.0 * here + back) / turn**2 == pytest.approx(grip.yaw_stiffness, rel=2e-2)


def test_crates_turn_between_clasps_beside_their_sides() -> None:
    """Clasps 2 cm off the sides: a crate turned by 23° in simulation, and tipped as it rose.

    With clasps at fixed places, on the line through two sides' middles, it is stable where their
    distance d to sides of width 2 b exceeds b²/a, a the distance of the sides from the centre.
    """
    for gap, holds in ((0.02, False), (0.10, False), (0.11, True)):
        clasps = np.array([[0.16 + gap, 0.0], [-0.16 - gap, 0.0]])
        assert (Grip.of(CRATE, clasps, 2.4, 1.0).yaw_stiffness > 0.0) == holds
        assert (gap > 0.13**2 / 0.16) == holds


SQUARE = ho.Section([[0.18, 0.18], [0.18, -0.18], [-0.18, -0.18], [-0.18, 0.18]])
NEAR_A_CORNER = np.array([[-0.164, 0.2], [0.255, 0.0], [-0.164, -0.2]])
"""Clasps [m] of a grip of it: two are 2.6 cm from corners, and turn and rise about these."""


@pytest.mark.parametrize("load", [[0.0, 0.0, 0.0], [0.03, -0.05, 0.0], [-0.06, -0.065, 0.86]])
@pytest.mark.parametrize(
    ("section", "polygon"),
    [(ODD, regular(3, 0.4, 0.3) * [1.02, 0.99]), (SQUARE, NEAR_A_CORNER)],
)
def test_moved_clasps_bear_the_load(section: ho.Section, polygon: Array, load: list[float]) -> None:
    tensions, steps = np.array([1.3, 1.4, 1.25]), []
    clasps = np.pad(polygon, ((0, 0), (0, 1)))

    def arms() -> Array:
        wraps = wraps_around(section, section.centroid + clasps[:, :2])
        return wraps.contacts - section.centroid

    for _ in range(12):
        before, clasps = clasps, step_toward_balance(clasps, tensions, arms(), np.asarray(load))
        steps.append(float(np.max(np.abs(clasps - before))))
    assert all(later < 0.1 * step + 1e-14 for step, later in pairwise(steps[2:]))
    at = np.pad(arms(), ((0, 0), (0, 0), (0, 1)))  # in the plane of contact
    parts = np.stack([clasps, np.roll(clasps, -1, axis=0)], axis=1) - at
    pulls = tensions[:, None, None] * parts / np.linalg.norm(parts, axis=2, keepdims=True)
    np.testing.assert_allclose(pulls.sum(axis=(0, 1)), load, atol=1e-10)
    np.testing.assert_allclose(np.cross(at, pulls).sum(axis=(0, 1)), 0.0, atol=1e-10)


def test_failed_searches_and_level_pulls_name_their_limits() -> None:
    with pytest.raises(ho.InfeasibleError, match="no grip by 6 cables") as caught:
        next(grips(task(DISC, 6, 1.0)))
    (violation,) = caught.value.violations
    assert violation.value < violation.limit
    most, binding = ho.Quadrotor().level_pull(Requirements().limits.tilt)
    assert binding == "tilt"
    assert 1.29 < most < 1.3
    assert ho.Quadrotor().level_pull(STEEP.limits.tilt)[0] > 1.5
