"""Grips: shortest paths around sections, balance, figures of rope simulations, capacities."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import hitchopt as ho
from hitchopt.hitch.holding import GripTask, best_grip, grip_capacity, largest_tension, wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.carrying.grip import balanced, contacts_of
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


def boundary(section: ho.Section, count: int = 3000) -> Array:
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    disc = section.rounding * np.column_stack([np.cos(angles), np.sin(angles)])
    return (section.core[:, None] + disc).reshape(-1, 2)


@pytest.mark.parametrize("section", SECTIONS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(3, 6))
def test_a_taut_edge_is_the_hull_of_section_and_clasps(
    section: ho.Section, seed: int, n: int
) -> None:
    rng = np.random.default_rng(seed)
    centre, size = section.centroid, section.circumradius + np.linalg.norm(section.centroid)
    vertices = centre + regular(n, 1.0, rng.uniform(0, 6)) * size * rng.uniform(1.02, 1.9, (n, 1))
    wraps = wraps_around(section, vertices)
    for k in range(n):
        first, last = vertices[k], vertices[(k + 1) % n]
        chord = last - first
        points = boundary(section)
        away = points - first
        left = points[chord[0] * away[:, 1] - chord[1] * away[:, 0] > 0.0]  # past the chord
        if len(left) == 0:
            assert wraps.angles[k] == pytest.approx(0.0, abs=0.05)
            continue
        hull = ConvexHull(np.concatenate([[first, last], left]))
        shortest = hull.area - float(np.linalg.norm(chord))  # a hull's area is its perimeter in 2-D
        assert wraps.lengths[k] == pytest.approx(shortest, rel=2e-5, abs=2e-6)


@pytest.mark.parametrize("n", [3, 5])
def test_legs_go_on_along_the_neighbours_edges_and_balance_them(n: int) -> None:
    vertices = regular(n, 0.38) * [1.05, 0.97] + ODD.centroid
    grip = ho.Grip.of(ODD, vertices, 1.6, 1.3)
    q, r = grip.leg_directions[:, 0], np.roll(grip.leg_directions[:, 1], 1, axis=0)
    wraps = grip.wraps
    np.testing.assert_allclose(q, np.roll(wraps.arriving, 1, axis=0), atol=1e-12)
    np.testing.assert_allclose(r, -wraps.leaving, atol=1e-12)
    np.testing.assert_allclose(grip.pulls, 1.3 * (q + r), atol=1e-12)
    np.testing.assert_allclose(grip.legs.sum(axis=1) + wraps.lengths, 1.6, atol=1e-12)
    arms = vertices - ODD.centroid
    moment = np.sum(arms[:, 0] * grip.pulls[:, 1] - arms[:, 1] * grip.pulls[:, 0])
    np.testing.assert_allclose(grip.imbalance, [*grip.pulls.sum(axis=0), moment], atol=1e-12)


def test_thrust_binds_where_legs_that_lift_pull_as_hard_as_before() -> None:
    """By hand: legs rise by the angle whose sine is their share of the weight over T."""
    made = task(DISC, 3, 1.6, 1.4)
    found = grip_capacity(made, best_grip(made), 100.0, 1.5)
    assert found.binding == "thrust"
    rise = math.asin(found.mass * 9.81 / 6.0 / 1.4)
    upward = 0.132 * 9.81 + 1.4 * math.sin(rise)
    assert math.hypot(1.4 * math.cos(rise), upward) == pytest.approx(2.6, rel=1e-3)


def test_figures_of_rope_simulations() -> None:
    """Drones 0.24 m apart at 212°; 77 g at 1 N with 60° per cable; the rhombus about a box."""
    grip = ho.Grip.of(DISC, disc_triangle(212.0), 1.95, 1.0)
    assert np.degrees(grip.wraps.angles).sum() == pytest.approx(212.0)
    assert np.linalg.norm(grip.drones[0, 0] - grip.drones[0, 1]) == pytest.approx(0.24, abs=1e-3)
    grip = ho.Grip.of(DISC, disc_triangle(180.0), 1.6, 1.0, clasp_friction=SIMULATED_FRICTION)
    assert grip.slip_load(0.5) / (1.5 * 9.81) == pytest.approx(0.077, abs=1e-3)
    for off, wrap, apart in ((0.09, 137.0, 0.23), (0.12, 77.0, 0.34)):
        grip = ho.Grip.of(BOX, rhombus(off), 0.9, 1.3)
        assert np.degrees(grip.wraps.angles).sum() == pytest.approx(wrap, abs=5.0)
        drones = grip.drones.reshape(-1, 2)
        pairs = np.linalg.norm(drones[:, None] - drones, axis=-1)[np.triu_indices(8, 1)]
        assert np.min(pairs) == pytest.approx(apart, abs=0.01)


def task(section: ho.Section, n: int, cable: float, tension: float = 1.3) -> GripTask:
    return GripTask(section, n, cable, tension, SIMULATED_FRICTION, STEEP, ho.Quadrotor())


def test_the_best_grip_does_not_depend_on_the_outlines_origin() -> None:
    shift = np.array([-100.0, 40.0])
    one, two = (best_grip(task(ho.Section(BOX.core + by), 4, 0.95)) for by in (0.0 * shift, shift))
    assert two.slip_load(0.5) == pytest.approx(one.slip_load(0.5))
    # A box has two best grips, mirror images: rounding chooses one.
    here, there = (np.linalg.norm(v, axis=-1) for v in (one.vertices, two.vertices - shift))
    np.testing.assert_allclose(np.sort(there), np.sort(here), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("section", "n", "cable"), [(DISC, 3, 1.6), (BOX, 4, 0.95)])
def test_the_best_grip_keeps_every_limit_and_no_tried_one_is_better(
    section: ho.Section, n: int, cable: float
) -> None:
    found = best_grip(task(section, n, cable))
    assert task(section, n, cable).shortest(found)[0] >= 0.0
    np.testing.assert_allclose(found.imbalance, 0.0, atol=1e-5)
    rng = np.random.default_rng(5)
    base = regular(n, 1.0) if section is DISC else rhombus(0.0) / np.array([0.2, 0.15])
    for _ in range(200):
        scale = np.array([1.0, 1.0]) * rng.uniform(0.2, 0.45, 2 if section is BOX else 1)
        vertices = base * scale
        if np.min(section.clearance(vertices)[0]) <= 0.021:
            continue
        tried = task(section, n, cable).grip(vertices)
        if task(section, n, cable).shortest(tried)[0] >= 0.05:
            assert tried.slip_load(0.5) <= found.slip_load(0.5) * (1.0 + 1e-4)


SQUARE = ho.Section([[0.18, 0.18], [0.18, -0.18], [-0.18, -0.18], [-0.18, 0.18]])
NEAR_A_CORNER = np.array([[-0.164, 0.2], [0.255, 0.0], [-0.164, -0.2]])
"""Clasps [m] of a grip of it: two are 2.6 cm from corners, and turn and rise about these."""


@pytest.mark.parametrize("load", [[0.0, 0.0, 0.0], [0.03, -0.05, 0.0], [-0.06, -0.065, 0.86]])
@pytest.mark.parametrize(
    ("section", "polygon"),
    [(ODD, regular(3, 0.4, 0.3) * [1.02, 0.99]), (SQUARE, NEAR_A_CORNER)],
)
def test_moved_clasps_bear_the_load_without_a_moment(
    section: ho.Section, polygon: Array, load: list[float]
) -> None:
    tensions = np.array([1.3, 1.4, 1.25])
    clasps, steps = np.pad(polygon, ((0, 0), (0, 1))), []
    for _ in range(12):
        places = section.centroid + clasps[:, :2]
        arms = contacts_of(places, wraps_around(section, places), section.core) - section.centroid
        before, clasps = clasps, balanced(clasps, tensions, arms, np.asarray(load))
        steps.append(float(np.max(np.abs(clasps - before))))
    assert all(later < 0.1 * step + 1e-14 for step, later in pairwise(steps[2:]))
    places = section.centroid + clasps[:, :2]
    arms = contacts_of(places, wraps_around(section, places), section.core) - section.centroid
    forces, moments = np.zeros(3), np.zeros(3)
    for i, end in enumerate((clasps, np.roll(clasps, -1, axis=0))):
        at = np.pad(arms[:, i], ((0, 0), (0, 1)))  # in the plane of contact
        pulls = tensions[:, None] * (end - at) / np.linalg.norm(end - at, axis=1)[:, None]
        forces += pulls.sum(axis=0)
        moments += np.cross(at, pulls).sum(axis=0)
    np.testing.assert_allclose(forces, load, atol=1e-10)
    np.testing.assert_allclose(moments, 0.0, atol=1e-10)


def test_a_cylinder_of_100_g_needs_a_tension_of_1_3_n() -> None:
    held = [
        grip_capacity(made, best_grip(made), 0.5, 1.5)
        for made in (task(DISC, 3, 1.6, tension) for tension in (1.0, 1.3))
    ]
    assert held[0].mass < 0.1 < held[1].mass
    assert held[1].binding == "grip"


def test_more_cables_do_not_grip_a_disc() -> None:
    with pytest.raises(ho.InfeasibleError, match="no grip by 6 cables") as told:
        best_grip(task(DISC, 6, 1.0))
    (violation,) = told.value.violations
    assert violation.value < violation.limit


def test_level_pulls_are_limited_by_tilt() -> None:
    most, binding = largest_tension(Requirements(), ho.Quadrotor())
    assert binding == "tilt"
    assert 1.29 < most < 1.3
    assert largest_tension(STEEP, ho.Quadrotor())[0] > 1.5
