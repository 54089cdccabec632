"""Cables are drawn from drone to drone, as long as they are, and linked as the plan ties them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pictured import make_motion

import hitchopt as ho
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import states_at
from hitchopt.simulation.linking_numbers import linking_matrix
from hitchopt.view.cable_curves import CLASPS, cable_curves, clasp_senses
from hitchopt.view.scene import concerned, scene_of


@pytest.fixture(scope="module")
def tied() -> Motion:
    """Return a hitch tied, held and untied."""
    team = ho.Team(robots=3, cable_length=2.4, cable_density=0.004)
    q = [[-0.6, -1.2, 1.0], [-0.6, 0, 1.0], [-0.6, 1.2, 1.0]]
    r = [[0.6, -1.2, 1.0], [0.6, 0, 1.0], [0.6, 1.2, 1.0]]
    triangle = [[0.1, 0.7], [0.6, -0.2], [-0.4, -0.3]]
    plan = ho.form(team, np.array(q), np.array(r), triangle, altitude=1.5)
    return plan.motion


def linking(motion: Motion, time: float) -> np.ndarray:
    curves = cable_curves(motion, states_at(motion, np.array([time])))
    return linking_matrix(list(curves.points[0]))


def test_cables_run_from_drone_to_drone(tied: Motion) -> None:
    t = np.linspace(0.0, tied.duration, 60)
    states = states_at(tied, t)
    points = cable_curves(tied, states).points
    np.testing.assert_allclose(points[:, :, 0], states.positions[:, 0::2], atol=1e-9)
    np.testing.assert_allclose(points[:, :, -1], states.positions[:, 1::2], atol=1e-9)


def test_free_cables_are_as_long_as_they_are(tied: Motion) -> None:
    free = next(phase for phase in tied.phases if phase.state is CableState.FREE)
    states = states_at(tied, np.linspace(free.start, free.end, 9)[1:-1])
    points = cable_curves(tied, states).points
    length = np.sum(np.linalg.norm(np.diff(points, axis=2), axis=-1), axis=-1)
    np.testing.assert_allclose(length, np.tile(tied.team.cable_length, (7, 1)), rtol=5e-3)


def test_neighbours_are_linked_in_the_hitch_and_not_before(tied: Motion) -> None:
    last = tied.phases[-1]
    assert last.state is CableState.HITCHED
    assert not np.any(linking(tied, 0.5 * tied.phases[0].end))
    found = linking(tied, 0.5 * (last.start + last.end))
    np.testing.assert_array_equal(np.abs(found), 1 - np.eye(3))


def test_turning_the_other_way_links_the_other_way(tied: Motion) -> None:
    mirrored = replace(
        tied,
        **{
            name: replace(getattr(tied, name), coefficients=getattr(tied, name).coefficients * axes)
            for name, axes in (
                ("drones", np.array([1.0, 1.0, -1.0])[:, None]),
                ("vertices", np.array([1.0, 1.0, -1.0])[:, None]),
            )
        },
    )
    np.testing.assert_array_equal(clasp_senses(mirrored), -clasp_senses(tied))


@pytest.mark.parametrize("n", [3, 4, 12])
def test_only_neighbours_are_linked(n: int) -> None:
    found = np.abs(linking(make_motion(n), 1.0))
    k = np.arange(n)
    expected = np.isin((k[:, None] - k) % n, (1, n - 1)).astype(int)
    np.testing.assert_array_equal(found, expected)


def test_bends_are_at_the_vertices() -> None:
    motion = make_motion(5)
    curves = cable_curves(motion, states_at(motion, np.array([0.7])))
    vertices = motion.vertices.at(0.7)
    for which, points in zip(CLASPS, (vertices, np.roll(vertices, -1, axis=0)), strict=True):
        apart = np.linalg.norm(curves.points[0, :, which] - points, axis=-1)
        np.testing.assert_allclose(apart, 2.2 * curves.radius, rtol=1e-6)


def test_an_open_chain_ends_without_legs() -> None:
    team = ho.Team(robots=3, cable_length=2.4, topology="open")
    start = ho.Hitch.spread(team, [[-2.0, 0.0], [-0.7, 0.5], [0.7, 0.5], [2.0, 0.0]], altitude=1.0)
    motion = ho.hold(start, 1.0).motion
    points = cable_curves(motion, states_at(motion, np.array([0.5]))).points[0]
    assert np.all(np.isfinite(points))
    found = np.abs(linking_matrix(list(points)))
    np.testing.assert_array_equal(found, [[0, 1, 0], [1, 0, 1], [0, 1, 0]])


def test_a_scene_holds_the_ends_of_all_phases_and_interpolates(tied: Motion) -> None:
    scene = scene_of(tied, 40_000)
    for phase in tied.phases:
        assert np.min(np.abs(scene.t - phase.end)) < 1e-5
    time = 0.37 * tied.duration
    np.testing.assert_allclose(scene.at(time).drones, tied.drones.at(time), atol=5e-3)


def test_what_a_check_names_is_found(tied: Motion) -> None:
    found = concerned(tied, ("q1", "r2", "cable 0", "p2", "q-leg 1", "phase 3 (swap 1)", "floor"))
    assert found.drones == (2, 5)
    assert found.cables == (0, 1)
    assert found.vertices == (2,)
