"""Force balance at the clasps, in the paper's class and for any tensions."""

import math

import numpy as np
from clasp_balance import clasp_residuals
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.forces import contact_forces
from problems.random_morph import random_convex_polygon


def hitch(seed: int, n: int, *, equal: bool) -> Hitch:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 1.2, rng).translated(rng.normal(size=2))
    longest = float(np.max(polygon.edge_lengths))
    tension = 0.7 if equal else rng.uniform(0.4, 0.6, n)
    team = Team(n, longest + rng.uniform(0.5, 1.0, n), tension=tension)
    slack = team.cable_length - polygon.edge_lengths
    return Hitch(team, polygon, 0.8, slack * rng.uniform(0.2, 0.8, n))


@given(st.integers(0, 2**32 - 1), st.integers(3, 30), st.booleans())
@settings(max_examples=60)
def test_clasps_are_in_balance_and_cables_of_their_length(seed: int, n: int, equal: bool) -> None:
    h = hitch(seed, n, equal=equal)
    drones = h.drones.reshape(n, 2, 3)
    residual = clasp_residuals(h.vertices, drones[:, 0], drones[:, 1], h.team.tension)
    assert np.max(np.abs(residual)) < 1e-9
    ends = np.roll(h.vertices, -1, axis=0)
    length = (
        np.linalg.norm(drones[:, 0] - h.vertices, axis=1)
        + np.linalg.norm(ends - h.vertices, axis=1)
        + np.linalg.norm(drones[:, 1] - ends, axis=1)
    )
    np.testing.assert_allclose(length, h.team.cable_length, rtol=1e-12)
    np.testing.assert_allclose(drones[..., 2], 0.8)


@given(st.integers(0, 2**32 - 1), st.integers(3, 30))
@settings(max_examples=30)
def test_equal_tensions_give_the_papers_positions(seed: int, n: int) -> None:
    """Its eq. (4), written out robot by robot."""
    h = hitch(seed, n, equal=True)
    p, u = h.polygon.vertices, h.polygon.edge_directions
    for k in range(n):
        d, e = h.legs[k]
        np.testing.assert_allclose(h.drones[2 * k, :2], p[k] + d * u[k - 1], atol=1e-12)
        following = (k + 1) % n
        np.testing.assert_allclose(
            h.drones[2 * k + 1, :2], p[following] - e * u[following], atol=1e-12
        )


@given(st.integers(0, 2**32 - 1), st.integers(3, 30))
@settings(max_examples=30)
def test_whatever_the_tensions_the_legs_enclose_the_interior_angle(seed: int, n: int) -> None:
    h = hitch(seed, n, equal=False)
    beta = math.pi - h.polygon.exterior_angles
    d, e_behind = h.legs[:, 0], np.roll(h.legs[:, 1], 1)
    q, r_behind = h.drones[0::2], np.roll(h.drones[1::2], 1, axis=0)
    expected = d**2 + e_behind**2 - 2.0 * d * e_behind * np.cos(beta)
    np.testing.assert_allclose(np.sum((q - r_behind) ** 2, axis=1), expected, rtol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
@settings(max_examples=30)
def test_contact_forces_follow_the_closed_form_and_press(seed: int, n: int) -> None:
    h = hitch(seed, n, equal=False)
    u, T = h.polygon.edge_directions, h.team.tension
    V = np.roll(T, 1)[:, None] * np.roll(u, 1, axis=0) - T[:, None] * u
    expected = (
        2.0 * T * np.roll(T, 1) * np.sin(h.polygon.exterior_angles) / np.linalg.norm(V, axis=1)
    )
    forces = contact_forces(u, T)
    np.testing.assert_allclose(forces, expected, rtol=1e-9)
    assert np.all(forces > 0.0)


def test_the_cable_pulls_drones_toward_their_vertices() -> None:
    team = Team(3, 2.4, tension=[0.4, 0.5, 0.45])
    h = Hitch.balanced(team, [[1.0, 0.0], [0.6, 1.5], [1.4, 1.5]])
    ends = np.stack([h.vertices, np.roll(h.vertices, -1, axis=0)], axis=1).reshape(-1, 3)
    toward = ends - h.drones
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    expected = np.repeat([0.4, 0.5, 0.45], 2)[:, None] * toward
    np.testing.assert_allclose(h.cable_forces, expected, atol=1e-12)
