"""Thick ropes: the additional length of their bends, and the offsets of their ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted import regular_hitch, standing, unformed

from hitchopt.hitch import Hitch, Team
from hitchopt.simulation import rope_flight
from hitchopt.simulation.error_measures import effective_lengths
from hitchopt.simulation.rope_thickness import thickness_allowance, thickness_offsets
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import ACCURATE, Settings

Array = NDArray[np.float64]

DIAMETER = 0.012


def uneven_hitch() -> Hitch:
    """Return a hitch whose edges, angles, cables, legs and tensions all differ."""
    team = Team(4, [2.5, 2.6, 2.9, 2.7], tension=[0.5, 0.55, 0.45, 0.6])
    polygon = [[3.1, 1.4], [4.3, 1.1], [3.9, -0.3], [2.6, 0.1]]
    return Hitch(team, polygon, 1.7, [0.7, 0.5, 0.9, 0.6])


def reordered(team: Team, order: NDArray[np.intp]) -> Team:
    """Return the team of uneven_hitch with its robots in another order."""
    return Team(team.robots, team.cable_length[order], tension=team.tension[order])


def uneven_chain() -> Hitch:
    team = Team(3, [2.4, 2.3, 2.5], topology="open", tension=[0.5, 0.6, 0.45])
    points = [[1.0, 0.0], [1.8, 1.2], [3.2, 1.3], [4.0, 0.2]]
    return Hitch.balanced(team, points, altitude=1.6)


def offsets_of(hitch: Hitch, diameter: float = DIAMETER) -> Array:
    """Return the offsets (2n, 3) [m] of a hitch at rest."""
    found = thickness_offsets(standing(hitch, 0.02), diameter)
    np.testing.assert_array_equal(found, np.broadcast_to(found[0], found.shape))
    first: Array = found[0]
    return first


def tangents(point: complex, centre: complex, radius: float) -> tuple[complex, complex]:
    """Return the points at which the two lines from a point touch a circle."""
    away = point - centre
    angle = np.arccos(radius / abs(away))
    direction = radius * away / abs(away)
    return centre + direction * np.exp(1j * angle), centre + direction * np.exp(-1j * angle)


@pytest.mark.parametrize("n", [3, 5, 12])
def test_thick_cables_need_as_much_more_as_their_bends_do(n: int) -> None:
    found = thickness_allowance(standing(regular_hitch(n), 0.1), 0.01, 0.0)
    # Drawn as polygons: a circle of one diameter about the other cable, and tangents to the legs.
    turn = 2.0 * np.pi / n
    angle = np.linspace(0.5 * turn, np.pi - 0.5 * turn, 2001) + 0.5 * np.pi
    arc = 0.005 + 0.01 * np.cos(angle) + 1j * 0.01 * np.sin(angle)
    far = np.exp(0.5j * turn)
    path = np.array([far, *arc, far.conjugate()])
    longer = np.sum(np.abs(np.diff(path))) - 2.0
    np.testing.assert_allclose(found, 2.0 * longer, atol=2e-4)


@pytest.mark.parametrize(
    "hitch",
    [regular_hitch(3), regular_hitch(8), uneven_hitch(), uneven_chain()],
    ids=["triangle", "octagon", "uneven", "chain"],
)
def test_moved_aside_a_leg_around_the_other_cable_runs_as_planned(hitch: Hitch) -> None:
    layout = hitch.team.layout
    moved = hitch.drones + offsets_of(hitch)
    np.testing.assert_array_equal(moved[:, 2], hitch.drones[:, 2])
    for drone in layout.drones_with_legs:
        vertex = layout.anchors[drone]
        other = layout.ends[drone // 2] if drone % 2 == 0 else layout.starts[drone // 2]
        place, planned, corner, end = (
            complex(*point[:2])
            for point in (moved[drone], hitch.drones[drone], *hitch.vertices[[vertex, other]])
        )
        leg, edge = planned - corner, end - corner
        # The cable bends around the other's middle, half a diameter into the bend from the vertex.
        inward = leg / abs(leg) + edge / abs(edge)
        centre = corner + 0.5 * DIAMETER * inward / abs(inward)
        touches = tangents(place, centre, DIAMETER)
        # The tangent on the bend's far side: left of a leg that is left of its edge.
        side = np.sign((leg * edge.conjugate()).imag)
        touch = max(touches, key=lambda point: side * ((point - centre) * leg.conjugate()).imag)
        run = place - touch
        assert abs((run * leg.conjugate()).imag) < 1e-12 * abs(run) * abs(leg)
        aside = (place - planned) * leg.conjugate() / abs(leg)
        assert abs(aside.real) < 1e-12
        assert 0.5 * DIAMETER < side * aside.imag < DIAMETER


def test_offsets_turn_and_shift_with_the_hitch() -> None:
    hitch = uneven_hitch()
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    polygon = hitch.polygon.vertices @ turn.T + [5.0, -3.0]
    turned = Hitch(hitch.team, polygon, 4.0, hitch.q_legs)
    expected = offsets_of(hitch)
    expected[:, :2] = expected[:, :2] @ turn.T
    np.testing.assert_allclose(offsets_of(turned), expected, atol=1e-15)


def test_offsets_follow_the_names_of_robots() -> None:
    hitch = uneven_hitch()
    order = np.array([2, 3, 0, 1])
    renamed = Hitch(
        reordered(hitch.team, order),
        hitch.polygon.vertices[order],
        1.7,
        hitch.q_legs[order],
    )
    drones = (2 * order[:, None] + [0, 1]).ravel()
    np.testing.assert_allclose(offsets_of(renamed), offsets_of(hitch)[drones], atol=1e-15)


def test_offsets_of_the_mirror_image_are_mirrored() -> None:
    hitch = uneven_hitch()
    # Clockwise again, so that its points run backward, and cables from r to q.
    order = np.array([3, 2, 1, 0])
    mirrored = Hitch(
        reordered(hitch.team, order),
        hitch.polygon.vertices[[0, 3, 2, 1]] * [-1.0, 1.0],
        1.7,
        hitch.legs[order, 1],
    )
    drones = (2 * order[:, None] + [1, 0]).ravel()
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(mirrored.drones, hitch.drones[drones] * flip, atol=1e-12)
    np.testing.assert_allclose(offsets_of(mirrored), offsets_of(hitch)[drones] * flip, atol=1e-15)


def test_offsets_grow_with_the_diameter_alone() -> None:
    hitch = uneven_hitch()
    np.testing.assert_allclose(offsets_of(hitch, 0.03), 3.0 * offsets_of(hitch, 0.01), rtol=1e-12)
    np.testing.assert_array_equal(offsets_of(hitch, 0.0), 0.0)


def test_the_ends_of_a_chain_have_no_offsets() -> None:
    found = offsets_of(uneven_chain())
    np.testing.assert_array_equal(found[[0, -1]], 0.0)
    assert np.all(np.linalg.norm(found[1:-1], axis=-1) > 0.5 * DIAMETER)


@pytest.mark.parametrize("n", [3, 6])
def test_simulated_cables_are_as_long_as_planned(n: int) -> None:
    """Legs, edges and their arcs add up to the plan's length, whatever the ropes' bends use up."""
    task = standing(regular_hitch(n, cable_friction=0.0), 0.1)
    flight = simulate(task, Settings(body="point", pull_test=False)).flight
    np.testing.assert_allclose(effective_lengths(flight), task.team.cable_length, atol=4e-3)
    assert flight.compensation.longer > 0.015  # without which they would be as much too short


def test_no_hitch_no_offsets() -> None:
    task = unformed(standing(regular_hitch(3), 0.1))
    np.testing.assert_array_equal(thickness_offsets(task, DIAMETER), np.zeros((11, 6, 3)))
    np.testing.assert_array_equal(thickness_allowance(task, DIAMETER, 0.03), np.zeros(3))


def test_offsets_are_only_where_the_hitch_is_and_rise_with_its_tension() -> None:
    hitch = uneven_hitch()
    task = standing(hitch, 0.3)
    rows = np.arange(7, 24)
    share = np.linspace(0.0, 1.6, len(rows))  # a tension beyond the team's moves nothing farther
    formed, tensions = np.zeros_like(task.formed), task.tensions.copy()
    formed[rows], tensions[rows] = True, share[:, None] * hitch.team.tension
    found = thickness_offsets(replace(task, formed=formed, tensions=tensions), DIAMETER)
    expected = np.zeros_like(task.setpoints.positions)
    expected[rows] = np.minimum(share, 1.0)[:, None, None] * offsets_of(hitch)
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_every_sample_has_the_offsets_of_its_own_hitch() -> None:
    hitch = uneven_hitch()
    apart = Hitch(hitch.team, hitch.polygon.vertices * [1.1, 0.9], 1.7, [0.5, 0.6, 0.7, 0.8])
    task = standing(hitch, 0.01)
    both = replace(
        task,
        setpoints=replace(task.setpoints, positions=np.stack([hitch.drones, apart.drones])),
        vertices=np.stack([hitch.vertices, apart.vertices]),
    )
    found = thickness_offsets(both, DIAMETER)
    np.testing.assert_allclose(found, [offsets_of(hitch), offsets_of(apart)], atol=1e-15)


def test_without_offsets_a_standing_triangle_is_dragged_inward(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hitch = regular_hitch(3, cable_friction=0.0)
    task = standing(hitch, 0.05)
    settings = Settings(preset=ACCURATE, body="point", pull_test=False)
    with_offsets = simulate(task, settings).errors
    monkeypatch.setattr(
        rope_flight, "thickness_offsets", lambda *_: np.zeros_like(task.setpoints.positions)
    )
    without = simulate(task, settings)
    assert np.max(with_offsets.without_sag) < np.min(without.errors.without_sag) - 0.01
    outward = hitch.vertices - np.mean(hitch.vertices, axis=0)
    found = without.flight.record.vertices[without.errors.rows] - hitch.vertices
    assert np.all(np.sum(found * outward, axis=-1) < 0.0)
