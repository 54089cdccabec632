"""Cables at the start of a flight: chains of exact segments, linked or free."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scripted import regular_hitch

from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.cable_shapes import LYING_RADIUS, ShapeError, clasped, hanging
from hitchopt.simulation.linking_numbers import linking_matrix
from hitchopt.simulation.ropes import Ropes, ropes_of
from hitchopt.simulation.simulation_settings import ACCURATE, FAST, Preset, Settings

Array = NDArray[np.float64]


def assert_exact(cables: list[Array], ropes: Ropes) -> None:
    for cable, count, length in zip(cables, ropes.segments, ropes.segment_lengths, strict=True):
        assert cable.shape == (count + 1, 3)
        steps = np.linalg.norm(np.diff(cable, axis=0), axis=-1)
        np.testing.assert_allclose(steps, length, rtol=1e-9)


def least_distance(one: Array, other: Array) -> float:
    return float(np.min(cKDTree(one).query(other)[0]))


def dense(cable: Array, parts: int = 12) -> Array:
    share = np.arange(parts)[None, :, None] / parts
    return (cable[:-1, None] * (1.0 - share) + cable[1:, None] * share).reshape(-1, 3)


@pytest.mark.parametrize("preset", [FAST, ACCURATE], ids=lambda preset: preset.name)
@pytest.mark.parametrize("n", [3, 4, 6, 8, 12])
def test_regular_hitches_begin_linked_apart_and_near_their_drones(n: int, preset: Preset) -> None:
    hitch = regular_hitch(n)
    ropes = ropes_of(hitch.team, Settings(preset=preset))
    cables = clasped(ropes, hitch.team.layout, hitch.drones, hitch.vertices)
    assert_exact(cables, ropes)
    linking = linking_matrix(cables)
    wanted = np.roll(np.eye(n, dtype=int), 1, axis=1)
    np.testing.assert_array_equal(np.abs(linking), wanted + wanted.T)
    assert len(set(linking[linking != 0])) == 1  # all of one sense
    for k in range(n):
        gap = least_distance(dense(cables[k]), dense(cables[k - 1]))
        assert gap > preset.diameter
    ends = np.concatenate([cable[[0, -1]] for cable in cables])
    assert np.max(np.linalg.norm(ends - hitch.drones, axis=-1)) < 0.12


def test_a_sharp_triangle_of_unequal_cables_begins_linked() -> None:
    team = Team(3, [2.5, 2.4, 2.7], tension=[0.4, 0.42, 0.5], cable_density=0.01)
    hitch = Hitch.balanced(team, [[1.0, 1.0], [0.6, 2.5], [1.4, 2.5]], altitude=1.2)
    for preset in (FAST, ACCURATE):
        ropes = ropes_of(team, Settings(preset=preset))
        cables = clasped(ropes, team.layout, hitch.drones, hitch.vertices)
        assert_exact(cables, ropes)
        np.testing.assert_array_equal(np.abs(linking_matrix(cables)), 1 - np.eye(3))


@pytest.mark.parametrize("roll", [0.0, 20.0, -30.0])
@pytest.mark.parametrize("n", [3, 5, 12])
def test_heavy_and_rolled_hitches_begin_linked_and_apart(n: int, roll: float) -> None:
    """Legs that rise, alike or one more than the other, pass each other's bends."""
    team = Team(n, 2.2, cable_density=0.018)
    rng = np.random.default_rng(n)
    outline = ConvexPolygon(regular_polygon(n, 1.3).vertices + rng.uniform(-0.03, 0.03, (n, 2)))
    hitch = Hitch.spread(team, outline, 1.8, roll=np.full(n, np.radians(roll)))
    for preset in (FAST, ACCURATE):
        ropes = ropes_of(team, Settings(preset=preset))
        cables = clasped(ropes, team.layout, hitch.drones, hitch.vertices)
        assert_exact(cables, ropes)
        linked = np.roll(np.eye(n, dtype=int), 1, axis=1)
        np.testing.assert_array_equal(np.abs(linking_matrix(cables)), linked + linked.T)
        for k in range(n):
            assert least_distance(dense(cables[k]), dense(cables[k - 1])) > preset.diameter


def test_a_chain_begins_linked_at_its_clasps_only() -> None:
    team = Team(3, 2.4, topology="open", cable_density=0.01)
    points = [[0.0, 0.0], [0.8, 1.2], [2.2, 1.3], [3.0, 0.0]]
    hitch = Hitch.balanced(team, points, altitude=1.0)
    ropes = ropes_of(team, Settings())
    cables = clasped(ropes, team.layout, hitch.drones, hitch.vertices)
    assert_exact(cables, ropes)
    np.testing.assert_array_equal(np.abs(linking_matrix(cables)), [[0, 1, 0], [1, 0, 1], [0, 1, 0]])


@pytest.mark.parametrize("across", [(1.2, 0.0, 0.0), (0.3, -0.4, 0.5), (1.5, 0.9, -0.4)])
def test_hanging_cables_are_catenaries(across: tuple[float, float, float]) -> None:
    ropes = Ropes(np.array([2.0]), 0.01, 0.0, dataclasses.replace(ACCURATE, segment=0.002))
    q = np.array([0.4, -0.7, 3.0])
    (cable,) = hanging(ropes, np.array([q, q + across]), 0.0)
    assert_exact([cable], ropes)
    np.testing.assert_allclose(cable[[0, -1]], [q, q + across], atol=1e-7)
    # The catenary of that length: L² = h² + (2a sinh(s/2a))², its lowest point by formula.
    span, rise, length = float(np.hypot(*across[:2])), across[2], 2.0
    chord = np.sqrt(length**2 - rise**2)
    a = brentq(lambda a: 2.0 * a * np.sinh(0.5 * span / a) - chord, 0.02, 50.0)
    middle = 0.5 * span - a * np.arctanh(rise / length)
    sag = a * (np.cosh(middle / a) - 1.0) if 0.0 <= middle <= span else max(-rise, 0.0)
    assert q[2] - np.min(cable[:, 2]) == pytest.approx(sag, abs=2e-3)


def test_cables_between_drones_straight_above_each_other_hang_in_a_fold() -> None:
    ropes = Ropes(np.array([2.0]), 0.01, 0.0, FAST)
    drones = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 2.4]])
    (cable,) = hanging(ropes, drones, 0.0)
    assert_exact([cable], ropes)
    np.testing.assert_allclose(cable[[0, -1]], drones, atol=float(ropes.segment_lengths[0]))
    assert np.min(cable[:, 2]) == pytest.approx(3.0 - 1.3, abs=0.05)


@pytest.mark.parametrize("preset", [FAST, ACCURATE], ids=lambda preset: preset.name)
@pytest.mark.parametrize(
    ("q", "r", "length"),
    [
        ((0.0, 0.0, 1.0), (0.7, 0.3, 1.0), 3.1),  # longer than what hangs and lies straight
        ((0.0, 0.0, 1.0), (0.7, 0.3, 0.6), 2.2),
        ((0.0, 0.0, 1.0), (-1.9, 0.3, 0.05), 2.6),
        ((0.0, 0.0, 0.1), (1.2, 0.5, 0.1), 2.0),
        ((0.0, 0.0, 0.0), (1.9, 0.0, 0.0), 2.0),  # drones that stand on the ground
    ],
)
def test_cables_that_reach_the_ground_hang_to_it_and_lie_on_it(
    q: tuple[float, ...], r: tuple[float, ...], length: float, preset: Preset
) -> None:
    ropes = Ropes(np.array([length]), 0.01, 0.0, preset)
    (cable,) = hanging(ropes, np.array([q, r]), -0.03)
    assert_exact([cable], ropes)
    np.testing.assert_allclose(cable[[0, -1]], [q, r], atol=1e-6)
    floor = -0.03 + 0.5 * preset.diameter
    lying = np.flatnonzero(cable[:, 2] < floor + 1e-9)
    assert np.min(cable[:, 2]) == pytest.approx(floor, abs=1e-9)
    np.testing.assert_array_equal(np.diff(lying), 1)  # all of it in one piece
    assert len(lying) > 0.1 * len(cable)
    along = np.subtract(r, q)[:2] / np.hypot(*np.subtract(r, q)[:2])
    off = (cable[:, :2] - np.array(q)[:2]) @ [-along[1], along[0]]
    # The meander: aside by a few radii, bent no tighter than its radius unless links are longer.
    link = float(ropes.segment_lengths[0])
    assert np.max(np.abs(off)) < 5.0 * max(LYING_RADIUS, link)
    flat = np.diff(cable[lying], axis=0)[:, :2] / link
    turns = np.arccos(np.clip(np.sum(flat[1:] * flat[:-1], axis=-1), -1.0, 1.0))
    if link <= LYING_RADIUS:
        assert np.max(turns, initial=0.0) < 1.5 * link / LYING_RADIUS
    for rising in (cable[lying[-1] :], cable[lying[0] :: -1]):  # a catenary: an even pull
        steps = np.diff(rising, axis=0)
        slopes = steps[:, 2] / np.maximum(np.hypot(*steps[:, :2].T), 1e-12)
        assert np.all(np.diff(slopes) > 0.0)
        np.testing.assert_allclose(np.diff(slopes[:6], n=2), 0.0, atol=1e-6 * slopes[-1])


def test_a_cable_that_just_touches_the_ground_hangs() -> None:
    ropes = Ropes(np.array([2.0]), 0.01, 0.0, FAST)
    drones = np.array([[0.0, 0.0, 1.0], [0.8, 0.0, 1.0]])
    (free,) = hanging(ropes, drones, -5.0)
    lowest = float(np.min(free[:, 2])) - 0.5 * FAST.diameter
    (cable,) = hanging(ropes, drones, lowest + 1e-4)
    np.testing.assert_allclose(cable, free, atol=1e-2)


def test_drones_too_far_apart_are_reported() -> None:
    ropes = Ropes(np.array([1.0]), 0.01, 0.0, FAST)
    with pytest.raises(ShapeError, match=r"cable 0: its drones start 1\.1 m apart"):
        hanging(ropes, np.array([[0.0, 0.0, 2.0], [1.1, 0.0, 2.0]]), 0.0)
