"""The model: the hitch's own values, jets by differences, and the optimiser's functions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.hitch import Hitch
from hitchopt.hitch.model import CLASPS_PER_CHUNK, FlatJets, drone_jets
from hitchopt.planners.path import cables_of_legs
from hitchopt.values import Array
from tests.helpers.clasp_balance import KINDS, random_hitch

seeds = st.integers(0, 2**32 - 1)
topologies, kinds = st.sampled_from(["closed", "open"]), st.sampled_from(KINDS)


def along(rng: np.random.Generator, value: Array, size: Array | float, t: Array) -> Array:
    """A random quadratic of time t (J,) through a value, as jets (J, …, 4)."""
    a, b = size * rng.normal(size=(2, *value.shape))
    x = t.reshape(-1, *(1,) * value.ndim)
    rows = [value + a * x + b * x**2, a + 2.0 * b * x, 2.0 * b + 0.0 * x, 0.0 * value + 0.0 * x]
    return np.stack(np.broadcast_arrays(*rows), axis=-1)


def moving(h: Hitch, seed: int, t: Array) -> FlatJets:
    """Flat outputs on random quadratics of time through the hitch."""
    rng = np.random.default_rng(seed)
    legs = along(rng, h.q_legs, np.where(h.team.layout.has_leg[:, 0], 0.02, 0.0), t)
    tensions = along(rng, h.team.tension, 0.02 * (np.ptp(h.team.tension) > 0.0), t)
    roll = along(rng, h.roll, 0.1, t) if np.any(h.roll) else None
    return FlatJets(along(rng, h.vertices, 0.05, t), legs, tensions, roll)


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


@pytest.mark.parametrize("kind", KINDS)
def test_jets_in_chunks_equal_those_of_each_time(kind: str) -> None:
    """More clasps than are evaluated at once; in balance without weight only if all are alike."""
    h = random_hitch(5, 40, "closed", kind)
    t = np.linspace(-1e-3, 1e-3, 2 * CLASPS_PER_CHUNK // 40 + 3)
    flat = moving(h, 5, t)
    together = drone_jets(h.team, flat)
    for k in (0, len(t) // 2, len(t) - 1):
        alone = drone_jets(h.team, flat[k : k + 1])
        for name in ("positions", "legs", "cable_forces", "thrusts"):
            values = getattr(together, name)[k], getattr(alone, name)[0]
            np.testing.assert_allclose(*values, rtol=1e-12, atol=1e-12)


@given(seeds, st.integers(3, 6), topologies, kinds)
@settings(max_examples=25)
def test_jets_are_derivatives_along_a_curve(seed: int, n: int, topology: str, kind: str) -> None:
    h = random_hitch(seed, n, topology, kind)
    t = 1e-3 * np.arange(-2.0, 3.0)
    flat = moving(h, seed, t)
    jets = drone_jets(h.team, flat)
    inner = slice(None) if topology == "closed" else slice(1, -1)
    for values in (jets.positions[:, inner], jets.legs[:, inner]):
        for order in range(3):
            f = values[..., order]
            difference = (f[0] - 8 * f[1] + 8 * f[3] - f[4]) / (12 * 1e-3)
            scale = 1.0 + np.max(np.abs(values[2, ..., order + 1]))
            np.testing.assert_allclose(difference, values[2, ..., order + 1], atol=1e-5 * scale)


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_cables_of_legs_are_those_of_the_slack(topology: str) -> None:
    h = random_hitch(3, 4, topology, "heavy")
    flat, layout = moving(h, 3, np.zeros(1)), h.team.layout
    jets = drone_jets(h.team, flat)
    chords = jets.positions - flat.vertices[:, layout.anchors]
    cables = cables_of_legs(h.team, chords, jets.legs, flat.tensions)
    assert cables is not None
    np.testing.assert_allclose(cables[0, ..., 0], layout.legs_of(h.q_legs, h.slack), atol=1e-9)
