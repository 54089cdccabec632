"""The model of clasps that carry weight: the hitch's own values, jets by differences, no surprises.

Derivatives of the functions themselves are compared in ``test_robot_model``.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.geometry import ConvexArc
from hitchopt.hitch import Hitch, Team
from hitchopt.model import evaluation
from hitchopt.model.evaluation import FlatJets, drone_jets, slipping_drones
from hitchopt.model.loaded_clasp import loaded_planar_function
from hitchopt.planners.friction.leaning import cables_of_legs
from problems.random_morph import random_convex_polygon

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
topologies = st.sampled_from(["closed", "open"])


def hitch(seed: int, n: int, topology: str, density: float) -> Hitch:
    """A rolled hitch with loads."""
    rng = np.random.default_rng(seed)
    closed = topology == "closed"
    polygon = random_convex_polygon(n if closed else n + 3, 1.2, rng).translated(rng.normal(size=2))
    outline = polygon if closed else ConvexArc(polygon.vertices[: n + 1])
    clasps = n if closed else n - 1
    lengths = outline.edge_lengths + rng.uniform(0.7, 1.0, n)
    tension, load = rng.uniform(0.8, 0.9, n), rng.uniform(0.0, 0.006, clasps)
    team = Team(n, lengths, topology=topology, tension=tension, cable_density=density, load=load)
    found = Hitch.balanced(team, outline, 0.8, rng.uniform(-0.6, 0.6, clasps))
    legs = team.layout.q_legs_of(found.slack * rng.uniform(0.4, 0.6, n), found.slack)
    return Hitch(team, outline, 0.8, legs, found.roll)


def moving(h: Hitch, seed: int, t: Array) -> FlatJets:
    """Flat outputs on random quadratics of time t (J,) through the hitch, as jets."""
    rng = np.random.default_rng(seed)

    def along(value: Array, size: float) -> Array:
        a, b = size * rng.normal(size=(2, *value.shape))
        x = t.reshape(-1, *(1,) * value.ndim)
        rows = [value + a * x + b * x**2, a + 2.0 * b * x, 2.0 * b + 0.0 * x, 0.0 * value + 0.0 * x]
        return np.stack(np.broadcast_arrays(*rows), axis=-1)

    legs = along(h.q_legs, 0.02)
    if not h.team.layout.closed:
        legs[:, 0] = 0.0
    return FlatJets(along(h.vertices, 0.05), legs, along(h.team.tension, 0.02), along(h.roll, 0.1))


@pytest.mark.parametrize("loaded", [True, False])
def test_drones_are_the_same_however_many_are_evaluated_at_a_time(
    monkeypatch: pytest.MonkeyPatch, loaded: bool
) -> None:
    h = hitch(3, 5, "closed", 0.01)
    flat = moving(h, 4, np.linspace(0.0, 1.0, 130))
    if not loaded:
        h, flat = Hitch.balanced(Team(5, 3.0), h.polygon), replace(flat, roll=None)
    found = {}
    for chunk in (5 * 65, 10**6):  # no part has so few columns that casadi evaluates it
        monkeypatch.setattr(evaluation, "CHUNK", chunk)
        found[chunk] = drone_jets(h.team, flat)
    for field in fields(found[10**6]):
        np.testing.assert_array_equal(*(getattr(jets, field.name) for jets in found.values()))


@given(seeds, st.integers(3, 7), topologies, st.sampled_from([0.0, 0.01]))
@settings(max_examples=30)
def test_values_are_the_hitchs_own(seed: int, n: int, topology: str, density: float) -> None:
    h = hitch(seed, n, topology, density)
    jets = drone_jets(h.team, moving(h, seed, np.zeros(1)))
    np.testing.assert_allclose(jets.positions[0, ..., 0], h.drones, atol=1e-12)
    np.testing.assert_allclose(jets.cable_forces[0], h.cable_forces, atol=1e-12)
    np.testing.assert_allclose(jets.legs[0, ..., 0], h.legs, atol=1e-12)


@given(seeds, st.integers(3, 6), topologies, st.sampled_from([0.0, 0.01]))
@settings(max_examples=15)
def test_jets_are_the_derivatives_along_a_curve(
    seed: int, n: int, topology: str, density: float
) -> None:
    h = hitch(seed, n, topology, density)
    step = 1e-3
    jets = drone_jets(h.team, moving(h, seed, step * np.arange(-2.0, 3.0)))
    inner = slice(None) if topology == "closed" else slice(1, -1)
    for values in (jets.positions[:, inner], jets.legs[:, inner]):
        for order in range(3):
            f = values[..., order]
            difference = (f[0] - 8 * f[1] + 8 * f[3] - f[4]) / (12 * step)
            scale = 1.0 + np.max(np.abs(values[2, ..., order + 1]))
            np.testing.assert_allclose(difference, values[2, ..., order + 1], atol=1e-5 * scale)


@given(seeds, st.integers(3, 6))
@settings(max_examples=15)
def test_zero_weight_and_zero_roll_are_those_of_the_plain_model(seed: int, n: int) -> None:
    """Through the loaded function, as a roll of zero is given."""
    h = hitch(seed, n, "closed", 0.0)
    plain = Hitch(replace(h.team, load=np.zeros(n)), h.polygon, 0.8, h.q_legs)
    flat = moving(plain, seed, np.array([0.0, 0.1]))
    expected = drone_jets(plain.team, replace(flat, roll=None))
    found = drone_jets(plain.team, replace(flat, roll=np.zeros((2, n, 4))))
    for name in ("positions", "cable_forces", "thrusts", "legs"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9)


@pytest.mark.parametrize("density", [0.0, 0.01])
def test_from_above_the_planar_model_is_the_same(density: float) -> None:
    n, h = 5, hitch(7, 5, "closed", density)
    team, layout = h.team, h.team.layout
    around = (np.arange(n)[:, None] + np.arange(-1, 3)) % n
    ends = np.column_stack([layout.starts, layout.ends])
    loads = np.zeros((n, 2, 3))
    loads[..., 2] = -9.81 * team.load[ends]
    for k in range(n):
        place, turn = loaded_planar_function(density > 0.0)(
            h.polygon.vertices[around[k]].ravel(),
            h.q_legs[layout.neighbours[k]],
            team.tension[layout.neighbours[k]],
            team.cable_length[layout.neighbours[k, :2]],
            h.roll[ends[k]],
            loads[k].ravel(),
            9.81 * density,
        )
        expected = np.concatenate(
            [h.drones[2 * k, :2], h.drones[2 * k + 1, :2], h.r_legs[k : k + 1]]
        )
        np.testing.assert_allclose(np.asarray(place).ravel(), expected, atol=1e-12)
        assert float(turn) == pytest.approx(np.sin(h.polygon.exterior_angles[k]), rel=1e-9)


@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("density", [0.0, 0.01])
def test_legs_that_pull_like_their_edges_stay_where_they_are_rolled_and_loaded(
    topology: str, density: float
) -> None:
    h = hitch(3, 4, topology, density)
    flat = moving(h, 3, np.zeros(1))
    jets = drone_jets(h.team, flat)
    pulls = np.repeat(flat.tensions[:, :, None], 2, axis=2)
    layout = h.team.layout
    chords = jets.positions - flat.vertices[:, layout.anchors]
    cables = cables_of_legs(h.team, chords, jets.legs, flat.tensions)
    if cables is not None:
        lengths = np.where(layout.has_leg, np.column_stack([h.q_legs, h.slack - h.q_legs]), 0.0)
        np.testing.assert_allclose(cables[0, ..., 0], lengths, atol=1e-9)
    found = slipping_drones(
        h.team, flat.vertices, jets.legs, flat.tensions, pulls, jets.positions, cables
    )
    expected = np.stack(
        [jets.positions[:, 2 * layout.behind + 1], jets.positions[:, 2 * layout.ahead]], axis=2
    )
    np.testing.assert_allclose(found[..., 0], expected[..., 0], atol=1e-8)
    whole = slice(None) if topology == "closed" else slice(-1)  # a chain's end moves off its cable
    np.testing.assert_allclose(found[:, whole], expected[:, whole], atol=1e-8)
