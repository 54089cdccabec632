"""Hitches at rest: balance at the clasps, lengths of cables, closed forms of the paper's class."""

import math

import numpy as np
import pytest
from clasp_balance import KINDS, random_hitch
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.forces import contact_forces

seeds = st.integers(0, 2**32 - 1)
topologies = st.sampled_from(["closed", "open"])


@given(seeds, st.integers(3, 9), topologies, st.sampled_from(KINDS))
@settings(max_examples=120)
def test_clasps_balance_and_cables_have_their_length(
    seed: int, n: int, topology: str, kind: str
) -> None:
    """Written out: at every clasp half of the cables about it, and the arc of every span."""
    h = random_hitch(seed, n, topology, kind)
    T, layout, rho = h.team.tension, h.team.layout, 9.81 * h.team.cable_density
    p, x = h.vertices, h.drones.reshape(-1, 2, 3)
    here, following = p[layout.starts], p[layout.ends]
    spans = np.stack([x[:, 0] - here, following - here, x[:, 1] - following], axis=1)
    length = np.linalg.norm(spans, axis=-1)
    level = np.hypot(spans[..., 0], spans[..., 1])
    arcs = length + (rho / T[:, None]) ** 2 * length * level**2 / 24.0
    tolerance = 2e-7 if rho else 1e-12
    np.testing.assert_allclose(np.sum(arcs, axis=1), h.team.cable_length, rtol=tolerance)
    np.testing.assert_allclose(h.legs, length[:, ::2], atol=1e-15)
    if kind in KINDS[:2]:
        np.testing.assert_allclose(x[..., 2], 0.8)
    if topology == "open":
        np.testing.assert_array_equal(x[0, 0], p[0])
        np.testing.assert_allclose(x[-1, 1], p[-1], atol=1e-15)
    # The pull of legs with weight is found by iteration; lengths of parts count as their cables'.
    tolerance = {"loaded": 1e-12, "heavy": 3e-4}.get(kind, 1e-9)
    for k, clasp in enumerate(layout.clasps):
        a, b = layout.ahead[k], layout.behind[k]
        weight = 0.5 * rho * (arcs[a, 0] + arcs[a, 1] + arcs[b, 1] + arcs[b, 2])
        force = np.array([0.0, 0.0, -weight - 9.81 * h.team.load[k]])
        for cable, part, sign in ((a, 0, 1.0), (a, 1, 1.0), (b, 2, 1.0), (b, 1, -1.0)):
            half, sine = (
                0.5 * rho * length[cable, part],
                spans[cable, part, 2] / length[cable, part],
            )
            pull = half * sine + math.sqrt(T[cable] ** 2 - half**2 * (1.0 - sine**2))
            force += sign * pull * spans[cable, part] / length[cable, part]
        assert np.linalg.norm(force) < tolerance * T[a], clasp


@given(seeds, st.integers(3, 30))
@settings(max_examples=30)
def test_equal_tensions_give_the_papers_positions(seed: int, n: int) -> None:
    """Its eq. (4), written out robot by robot."""
    h = random_hitch(seed, n, kind="equal")
    p, u = h.polygon.vertices, h.polygon.edge_directions
    for k in range(n):
        d, e = h.legs[k]
        ahead = (k + 1) % n
        np.testing.assert_allclose(h.drones[2 * k, :2], p[k] + d * u[k - 1], atol=1e-12)
        np.testing.assert_allclose(h.drones[2 * k + 1, :2], p[ahead] - e * u[ahead], atol=1e-12)


@given(seeds, st.integers(3, 30))
@settings(max_examples=30)
def test_whatever_the_tensions_the_legs_enclose_the_interior_angle(seed: int, n: int) -> None:
    h = random_hitch(seed, n)
    beta = math.pi - h.polygon.exterior_angles
    d, e_behind = h.legs[:, 0], np.roll(h.legs[:, 1], 1)
    q, r_behind = h.drones[0::2], np.roll(h.drones[1::2], 1, axis=0)
    expected = d**2 + e_behind**2 - 2.0 * d * e_behind * np.cos(beta)
    np.testing.assert_allclose(np.sum((q - r_behind) ** 2, axis=1), expected, rtol=1e-9)


@given(seeds, st.integers(3, 12), topologies)
@settings(max_examples=60)
def test_contact_forces_follow_the_closed_form_and_press(seed: int, n: int, topology: str) -> None:
    h = random_hitch(seed, n, topology)
    layout, u, T = h.team.layout, h.polygon.edge_directions, h.team.tension
    a, b = layout.ahead, layout.behind
    V = T[b, None] * u[b] - T[a, None] * u[a]
    sine = u[b, 1] * u[a, 0] - u[b, 0] * u[a, 1]
    forces = contact_forces(u, T, topology)
    expected = 2.0 * T[a] * T[b] * sine / np.linalg.norm(V, axis=1)
    np.testing.assert_allclose(forces, expected, rtol=1e-9)
    assert np.all(forces > 0.0)


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_the_cable_pulls_drones_toward_their_vertices(topology: str) -> None:
    """Toward its edge's other end where a chain's end has no leg."""
    team = Team(3, 2.4, topology=topology, tension=[0.4, 0.5, 0.45])
    points = [[1.0, 0.0], [0.6, 1.5], [1.4, 1.5], [1.7, 0.5]]
    h = Hitch.balanced(team, points[: len(points) - (topology == "closed")])
    p = h.vertices
    ends = [(p[k], p[(k + 1) % len(p)]) for k in range(3)]
    if topology == "open":
        ends[0], ends[-1] = (p[1], p[1]), (p[2], p[2])
    toward = np.reshape(ends, (6, 3)) - h.drones
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    expected = np.repeat([0.4, 0.5, 0.45], 2)[:, None] * toward
    np.testing.assert_allclose(h.cable_forces, expected, atol=1e-12)
