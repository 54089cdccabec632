from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pictured import make_motion

from hitchopt.view import curves
from hitchopt.view.curves import sampled_curves, smallest_separations

Array = NDArray[np.float64]


def brute_force(positions: Array, scale: Array) -> Array:
    offsets = (positions[:, :, None] - positions[:, None]) * scale
    distances = np.sqrt(np.sum(offsets**2, axis=-1))
    distances[:, np.arange(positions.shape[1]), np.arange(positions.shape[1])] = np.inf
    smallest: Array = np.min(distances, axis=(1, 2))
    return smallest


@given(st.integers(0, 2**32), st.integers(1, 6), st.integers(2, 9))
def test_separations_are_those_over_all_pairs(seed: int, samples: int, drones: int) -> None:
    chance = np.random.default_rng(seed)
    positions = chance.normal([40.0, -7.0, 2.0], 3.0, (samples, drones, 3))
    scale = 1.0 / chance.uniform(0.2, 0.9, 3)
    found = smallest_separations(positions, scale)
    np.testing.assert_allclose(found, brute_force(positions, scale), rtol=1e-9)


def test_drones_in_one_place_have_no_separation() -> None:
    positions = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [3, 0, 0]]])
    np.testing.assert_allclose(smallest_separations(positions, np.ones(3)), [0.0, 1.0])
    everywhere = np.broadcast_to([40.0, -7.0, 2.0], (3, 4, 3))
    np.testing.assert_array_equal(smallest_separations(everywhere, np.ones(3)), np.zeros(3))
    assert np.all(np.isinf(smallest_separations(everywhere[:, :1], np.ones(3))))


def test_curves_are_the_plan_s_worst_values() -> None:
    motion = make_motion(5, thrusts=(2.6, 1.9))
    found = sampled_curves(motion)
    drones, anchors = motion.drones.at(found.t), np.repeat(np.arange(5), 2) + [0, 1] * 5
    speeds = np.linalg.norm(motion.drones.at(found.t, 1), axis=-1)
    np.testing.assert_allclose(found.speed, np.max(speeds, axis=1), atol=1e-9)
    leg = drones - motion.vertices.at(found.t)[:, anchors % 5]
    mass = np.array([0.13, 0.13, 0.14, 0.14] * 2 + [0.13, 0.13])[:, None]
    force = mass * (motion.drones.at(found.t, 2) + np.array([0.0, 0.0, 9.81]))
    force += 0.4 * leg / np.linalg.norm(leg, axis=-1, keepdims=True)
    share = np.linalg.norm(force, axis=-1) / np.array([2.6, 2.6, 1.9, 1.9] * 2 + [2.6, 2.6])
    np.testing.assert_allclose(found.thrust, np.max(share, axis=1), rtol=1e-8)
    expected = brute_force(drones, np.array([1 / 0.22, 1 / 0.22, 1 / 0.5]))
    np.testing.assert_allclose(found.separation, expected, rtol=1e-9)


def test_times_go_from_the_start_over_every_joint_to_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    motion = make_motion(4)
    t = sampled_curves(motion).t
    assert (t[0], t[-1]) == (0.0, motion.duration)
    assert 2.2 in t
    assert len(t) <= curves.MAX_SAMPLES + 3
    monkeypatch.setattr(curves, "POINTS", 8 * 200)
    assert len(sampled_curves(motion).t) <= 203
