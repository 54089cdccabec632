"""Scenes: drones and cables where the plan has them, linked as it ties them, objects, ghosts."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pictured import make_motion, with_box

import hitchopt as ho
from hitchopt.holding.wraps import wraps_around
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import states_at
from hitchopt.objects import Section
from hitchopt.simulation.ropes import linking_matrix
from hitchopt.view.cables import CLASPS, clasp_senses, wrapped_edges
from hitchopt.view.scene import concerned, ghost_scene, recorded_scene, scene_at, scene_of


@pytest.fixture(scope="module")
def tied() -> Motion:
    """Return a hitch tied, held and untied."""
    team = ho.Team(robots=3, cable_length=2.4, cable_density=0.004)
    q = np.array([[-0.6, -1.2, 1.0], [-0.6, 0, 1.0], [-0.6, 1.2, 1.0]])
    triangle = [[0.1, 0.7], [0.6, -0.2], [-0.4, -0.3]]
    return ho.form(team, q, q + [1.2, 0.0, 0.0], triangle, altitude=1.5).motion


def linking(motion: Motion, time: float) -> np.ndarray:
    return np.abs(linking_matrix(list(scene_at(motion, np.array([time])).cables[0])))


def test_a_scene_is_the_plan_at_its_times(tied: Motion) -> None:
    scene = scene_of(tied, 40_000)
    states = states_at(tied, scene.t)
    np.testing.assert_array_equal(scene.drones, states.positions)
    np.testing.assert_array_equal(scene.cable_forces, states.cable_forces)
    np.testing.assert_allclose(scene.cables[:, :, 0], scene.drones[:, 0::2], atol=1e-9)
    np.testing.assert_allclose(scene.cables[:, :, -1], scene.drones[:, 1::2], atol=1e-9)
    assert all(np.min(np.abs(scene.t - phase.end)) < 1e-5 for phase in tied.phases)
    time = 0.37 * tied.duration
    np.testing.assert_allclose(scene.at(time).drones, tied.drones.at(time), atol=5e-3)


def test_free_cables_are_as_long_as_they_are(tied: Motion) -> None:
    free = next(phase for phase in tied.phases if phase.state is CableState.FREE)
    points = scene_at(tied, np.linspace(free.start, free.end, 9)[1:-1]).cables
    length = np.sum(np.linalg.norm(np.diff(points, axis=2), axis=-1), axis=-1)
    np.testing.assert_allclose(length, np.tile(tied.team.cable_length, (7, 1)), rtol=5e-3)


def test_neighbours_are_linked_in_the_hitch_and_not_before(tied: Motion) -> None:
    assert not np.any(linking(tied, 0.5 * tied.phases[0].end))
    np.testing.assert_array_equal(linking(tied, tied.duration - 0.1), 1 - np.eye(3))


@pytest.mark.parametrize("n", [3, 4, 12])
def test_only_neighbours_are_linked(n: int) -> None:
    k = np.arange(n)
    expected = np.isin((k[:, None] - k) % n, (1, n - 1)).astype(int)
    np.testing.assert_array_equal(linking(make_motion(n), 1.0), expected)


def test_an_open_chain_ends_without_legs() -> None:
    team = ho.Team(robots=3, cable_length=2.4, topology="open")
    start = ho.Hitch.spread(team, [[-2.0, 0.0], [-0.7, 0.5], [0.7, 0.5], [2.0, 0.0]], altitude=1.0)
    found = linking(ho.hold(start, 1.0).motion, 0.5)
    np.testing.assert_array_equal(found, [[0, 1, 0], [1, 0, 1], [0, 1, 0]])


def test_turning_the_other_way_links_the_other_way(tied: Motion) -> None:
    flip = np.array([1.0, 1.0, -1.0])[:, None]
    mirrored: dict[str, Any] = {
        name: dataclasses.replace(curves, coefficients=curves.coefficients * flip)
        for name, curves in (("drones", tied.drones), ("vertices", tied.vertices))
    }
    found = clasp_senses(dataclasses.replace(tied, **mirrored))
    np.testing.assert_array_equal(found, -clasp_senses(tied))


def test_bends_are_at_the_vertices() -> None:
    motion = make_motion(5)
    scene = scene_at(motion, np.array([0.7]))
    vertices = motion.vertices.at(0.7)
    for which, points in zip(CLASPS, (vertices, np.roll(vertices, -1, axis=0)), strict=True):
        apart = np.linalg.norm(scene.cables[0, :, which] - points, axis=-1)
        np.testing.assert_allclose(apart, 2.2 * scene.radius, rtol=1e-6)


def test_edges_around_a_circle_touch_it_and_points_are_even() -> None:
    angles = 0.3 - 2.0 * np.pi * np.arange(3) / 3
    flat = 0.24 * np.column_stack([np.cos(angles), np.sin(angles)])
    wraps = wraps_around(Section(radius=0.2), flat)
    first = np.column_stack([flat, np.zeros(3)])
    contacts = np.concatenate([wraps.contacts, np.zeros((3, 2, 1))], axis=-1)
    last, shares = np.roll(first, -1, axis=0), np.tile(np.linspace(0.0, 1.0, 2001), (3, 1))
    lengths, points = wrapped_edges(first, last, contacts, shares)
    np.testing.assert_allclose(lengths, wraps.lengths, atol=1e-12)
    np.testing.assert_allclose(points[:, [0, -1]], np.stack([first, last], axis=1), atol=1e-12)
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    np.testing.assert_allclose(2000 * steps / lengths[:, None], 1.0, rtol=1e-3)
    away = np.linalg.norm(points, axis=-1)
    assert np.min(away) > 0.2 - 1e-12
    share = wraps.arcs / wraps.lengths
    np.testing.assert_allclose(np.mean(away < 0.2 + 1e-9, axis=1), share, atol=2e-3)
    middle = np.repeat(0.5 * (first + last)[:, None], 2, axis=1)  # no contact: straight
    straight = wrapped_edges(first, last, middle, shares)[1]
    expected = first[:, None] + shares[..., None] * (last - first)[:, None]
    np.testing.assert_allclose(straight, expected, atol=1e-9)


@pytest.mark.parametrize("yaw", [-8.0, 0.7, 3.2])
def test_objects_are_where_they_stand(yaw: float) -> None:
    place = scene_of(with_box(yaw), 0).at(1.0).objects[0]
    np.testing.assert_allclose(place[:3], [1.5, 2.0, 0.4], atol=1e-12)
    assert np.linalg.norm(place[3:]) == pytest.approx(1.0)
    assert np.cos(2.0 * np.arctan2(place[6], place[3]) - yaw) == pytest.approx(1.0)


def test_what_a_check_names_is_found(tied: Motion) -> None:
    found = concerned(tied, ("q1", "r2", "cable 0", "p2", "q-leg 1", "phase 3 (swap 1)", "floor"))
    assert (found.drones, found.cables, found.vertices) == ((2, 5), (0, 1), (2,))


def test_a_recorded_flight_is_a_scene(tmp_path: Path) -> None:
    motion, poses = make_motion(3), np.zeros((6, 0, 7))
    nodes = np.zeros((6, 30, 3), dtype=np.float32)
    nodes[..., 0] = np.arange(30)
    nodes[..., 2] = np.arange(6)[:, None]
    t, first = 0.1 * np.arange(-2.0, 4.0), np.array([0, 10, 20, 30])
    np.savez_compressed(tmp_path / "recording.npz", t=t, nodes=nodes, cables=first, poses=poses)
    found = ghost_scene(tmp_path, motion)
    np.testing.assert_allclose(found.t, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(found.drones[:, :, 0], np.tile([0, 9, 10, 19, 20, 29], (4, 1)))
    again = recorded_scene(motion, t, nodes, first, poses)
    np.testing.assert_array_equal(again.cables, found.cables)
    with pytest.raises(ho.FileError, match="a flight of 3 cables"):
        ghost_scene(tmp_path, make_motion(4))
    with pytest.raises(ho.FileError, match="holds neither"):
        ghost_scene(tmp_path.parent, motion)
