"""The model: the hitch's own values, jets by differences, and the optimiser's functions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from clasp_balance import KINDS, clasp_residuals, random_hitch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.hitch import Hitch
from hitchopt.hitch.model import FlatJets, drone_jets, planar, slipping_drones
from hitchopt.planners.morph.friction import cables_of_legs

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
topologies, kinds = st.sampled_from(["closed", "open"]), st.sampled_from(KINDS)


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
    tensions = along(h.team.tension, 0.02 * (np.ptp(h.team.tension) > 0.0))
    roll = along(h.roll, 0.1) if np.any(h.roll) else None
    return FlatJets(along(h.vertices, 0.05), legs, tensions, roll)


@given(seeds, st.integers(3, 9), topologies, kinds)
@settings(max_examples=40)
def test_values_are_the_hitchs_own(seed: int, n: int, topology: str, kind: str) -> None:
    h = random_hitch(seed, n, topology, kind)
    jets = drone_jets(h.team, moving(h, seed, np.zeros(1)))
    np.testing.assert_allclose(jets.positions[0, ..., 0], h.drones, atol=1e-12)
    np.testing.assert_allclose(jets.cable_forces[0], h.cable_forces, atol=1e-12)
    np.testing.assert_allclose(jets.legs[0, ..., 0], h.legs, atol=1e-12)
    weight = h.team.mass[:, None] * (jets.positions[..., 2] + [0.0, 0.0, 9.81])
    np.testing.assert_allclose(jets.thrusts, weight - jets.cable_forces, atol=1e-12)
    if topology == "closed" and kind in KINDS[:2]:
        x = jets.positions[..., 0]
        residuals = clasp_residuals(h.vertices[None], x[:, 0::2], x[:, 1::2], h.team.tension[None])
        np.testing.assert_allclose(residuals, 0.0, atol=1e-9)


@given(seeds, st.integers(3, 6), topologies, kinds)
@settings(max_examples=25)
def test_jets_are_the_derivatives_along_a_curve(
    seed: int, n: int, topology: str, kind: str
) -> None:
    h = random_hitch(seed, n, topology, kind)
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
def test_zero_roll_is_that_of_the_plain_model(seed: int, n: int) -> None:
    plain = random_hitch(seed, n, "closed", "unequal")
    flat = moving(plain, seed, np.array([0.0, 0.1]))
    expected = drone_jets(plain.team, flat)
    found = drone_jets(plain.team, replace(flat, roll=np.zeros((2, n, 4))))
    for name in ("positions", "cable_forces", "thrusts", "legs"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9)


def planar_inputs(h: Hitch, k: int) -> list[Any]:
    """What the optimiser's function of robot k takes."""
    team, layout, n = h.team, h.team.layout, h.team.robots
    near, ends = layout.neighbours[k], [k, (k + 1) % n]
    corners = h.polygon.vertices[(k + np.arange(-1, 3)) % n].ravel()
    if not team.loaded:
        return [corners, h.q_legs[k], team.tension[near], team.cable_length[k]]
    loads = np.zeros((2, 3))
    loads[:, 2] = -9.81 * team.load[ends]
    constants = [team.cable_length[near[:2]], h.roll[ends], loads.ravel()]
    return [corners, h.q_legs[near], team.tension[near], *constants, 9.81 * team.cable_density]


@pytest.mark.parametrize("kind", KINDS)
def test_from_above_the_planar_model_is_the_same(kind: str) -> None:
    h = random_hitch(7, 5, "closed", kind)
    for k in range(5):
        place, turn = planar(h.team.loaded, kind in ("equal", "heavy"))(*planar_inputs(h, k))
        expected = np.concatenate(
            [h.drones[2 * k, :2], h.drones[2 * k + 1, :2], h.r_legs[k : k + 1]]
        )
        np.testing.assert_allclose(np.asarray(place).ravel(), expected, atol=1e-12)
        assert float(turn) == pytest.approx(np.sin(h.polygon.exterior_angles[k]), rel=1e-9)


@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("kind", KINDS)
def test_legs_that_pull_like_their_edges_stay_where_they_are(topology: str, kind: str) -> None:
    h = random_hitch(3, 4, topology, kind)
    flat, layout = moving(h, 3, np.zeros(1)), h.team.layout
    jets = drone_jets(h.team, flat)
    pulls = np.repeat(flat.tensions[:, :, None], 2, axis=2)
    chords = jets.positions - flat.vertices[:, layout.anchors]
    cables = cables_of_legs(h.team, chords, jets.legs, flat.tensions)
    if cables is not None:
        lengths = np.where(layout.has_leg, np.column_stack([h.q_legs, h.slack - h.q_legs]), 0.0)
        np.testing.assert_allclose(cables[0, ..., 0], lengths, atol=1e-9)
    planned = jets.positions if np.any(h.roll) else None
    found = slipping_drones(h.team, flat.vertices, jets.legs, flat.tensions, pulls, planned, cables)
    expected = np.stack(
        [jets.positions[:, 2 * layout.behind + 1], jets.positions[:, 2 * layout.ahead]], axis=2
    )
    np.testing.assert_allclose(found[..., 0], expected[..., 0], atol=1e-8)
    whole = slice(None) if topology == "closed" else slice(-1)  # a chain's end moves off its cable
    np.testing.assert_allclose(found[:, whole], expected[:, whole], atol=1e-8)
