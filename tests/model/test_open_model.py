"""The model at the ends of open chains: mirrored stencils against formulas and differences."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry import ConvexArc
from hitchopt.hitch import Hitch, Team
from hitchopt.model.evaluation import DroneJets, FlatJets, drone_jets
from problems.random_morph import random_convex_polygon

H = 1e-4
TIMES = H * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])


def chain(seed: int, n: int, *, equal: bool) -> Hitch:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n + 3, 1.2, rng).translated(rng.normal(size=2))
    outline = ConvexArc(polygon.vertices[: n + 1])
    length = outline.edge_lengths + rng.uniform(0.5, 1.0, n)
    tension = 0.5 if equal else rng.uniform(0.4, 0.6, n)
    team = Team(n, length, topology="open", tension=tension)
    return Hitch.balanced(team, outline, 0.8)


def bending(h: Hitch, seed: int) -> DroneJets:
    """Points on straight lines in time, fractions kept, as jets at five times around zero."""
    rate = 0.2 * np.random.default_rng(seed).normal(size=h.vertices.shape)
    vertices = np.zeros((5, *h.vertices.shape, 4))
    vertices[..., 0] = h.vertices + TIMES[:, None, None] * rate
    vertices[..., 1] = rate
    # |a + b t| and its derivatives, by hand.
    a, b = np.diff(vertices[..., 0], axis=1), np.diff(rate, axis=0)
    length = np.linalg.norm(a, axis=-1)
    along, square = np.sum(a * b, axis=-1), np.sum(b * b, axis=-1)
    second = square / length - along**2 / length**3
    third = 3.0 * (along**3 / length**5 - along * square / length**3)
    edges = np.stack([length, along / length, second, third], axis=-1)
    slack = -edges
    slack[..., 0] += h.team.cable_length
    tensions = np.zeros((5, h.team.robots, 4))
    tensions[..., 0] = h.team.tension
    return drone_jets(h.team, FlatJets(vertices, h.fractions[:, None] * slack, tensions))


@given(st.integers(0, 2**32 - 1), st.integers(2, 8), st.booleans())
@settings(max_examples=15)
def test_drones_forces_and_legs_are_those_of_the_hitch(seed: int, n: int, equal: bool) -> None:
    h = chain(seed, n, equal=equal)
    jets = bending(h, seed)
    np.testing.assert_allclose(jets.positions[2, ..., 0], h.drones, atol=1e-9)
    np.testing.assert_allclose(jets.cable_forces[2], h.cable_forces, atol=1e-9)
    np.testing.assert_allclose(jets.legs[2, :, :, 0], h.legs, atol=1e-12)
    x, p = jets.positions[2, ..., 0], h.vertices
    used = np.linalg.norm(x - np.repeat(p, 2, axis=0)[1:-1], axis=-1).reshape(n, 2).sum(axis=1)
    used += np.linalg.norm(np.diff(p, axis=0), axis=-1)
    np.testing.assert_allclose(used, h.team.cable_length, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(2, 8), st.booleans())
@settings(max_examples=15)
def test_end_drones_ride_on_their_points_to_every_order(seed: int, n: int, equal: bool) -> None:
    h = chain(seed, n, equal=equal)
    jets = bending(h, seed)
    rate = 0.2 * np.random.default_rng(seed).normal(size=h.vertices.shape)
    for drone, point in ((0, 0), (2 * n - 1, n)):
        x = jets.positions[:, drone]
        np.testing.assert_allclose(x[..., 1], np.tile(rate[point], (5, 1)), atol=1e-9)
        np.testing.assert_allclose(x[..., 2:], 0.0, atol=1e-8)
    # The others' derivatives by differences: the mirrored points must not bend them either.
    central = (jets.positions[3, ..., 0] - jets.positions[1, ..., 0]) / (2.0 * H)
    np.testing.assert_allclose(jets.positions[2, ..., 1], central, atol=1e-5)
    bend = (jets.positions[3, ..., 1] - jets.positions[1, ..., 1]) / (2.0 * H)
    np.testing.assert_allclose(jets.positions[2, ..., 2], bend, atol=1e-4)
    jerk = (jets.positions[3, ..., 2] - jets.positions[1, ..., 2]) / (2.0 * H)
    np.testing.assert_allclose(jets.positions[2, ..., 3], jerk, atol=1e-2, rtol=1e-4)
