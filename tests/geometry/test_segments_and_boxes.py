"""Closest points of segments and near boxes, against brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry import closest_offsets, nearby_boxes

SHARES = np.linspace(0.0, 1.0, 201)


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
@settings(max_examples=60, deadline=None)
def test_offsets_are_the_shortest_of_all_that_join_the_segments(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    a0, a1, b0, b1 = rng.normal(size=(4, 8, d))
    a1[0] = a0[0]  # a point
    b1[1], a1[1] = b0[1], a0[1]  # two points
    b1[2] = b0[2] + 2.0 * (a1[2] - a0[2])  # parallel
    b0[3] = a0[3]  # touching
    offsets = closest_offsets(a0, a1, b0, b1)
    on_a = a0[:, None] + SHARES[:, None] * (a1 - a0)[:, None]
    on_b = b0[:, None] + SHARES[:, None] * (b1 - b0)[:, None]
    sampled = np.linalg.norm(on_a[:, :, None] - on_b[:, None, :], axis=-1).min(axis=(1, 2))
    found = np.linalg.norm(offsets, axis=1)
    lengths = np.linalg.norm(a1 - a0, axis=1) + np.linalg.norm(b1 - b0, axis=1)
    assert np.all(found <= sampled + 1e-12)
    assert np.all(sampled - found <= lengths * 0.0026)
    reverse = closest_offsets(b0, b1, a0, a1)
    np.testing.assert_allclose(np.linalg.norm(reverse, axis=1), found, atol=1e-12)


def test_crossing_segments_in_the_plane_meet() -> None:
    offset = closest_offsets(*np.array([[[-1.0, 0.0]], [[1.0, 0.0]], [[0.3, -1.0]], [[0.3, 1.0]]]))
    np.testing.assert_allclose(offset, 0.0, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
@settings(max_examples=40, deadline=None)
def test_nearby_boxes_are_all_that_are_near(seed: int, cutoff: float) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-1.0, 1.0, (40, 3))
    upper = lower + rng.uniform(0.0, 0.4, (40, 3))
    found = {tuple(pair) for pair in nearby_boxes(lower, upper, cutoff).tolist()}
    gap = np.maximum(lower[:, None] - upper[None], lower[None] - upper[:, None])
    distance = np.linalg.norm(np.maximum(gap, 0.0), axis=-1)
    wanted = {(i, j) for i in range(40) for j in range(i + 1, 40) if distance[i, j] <= cutoff}
    beyond = {pair for pair in found if distance[pair] > cutoff * (1.0 + 1e-6) + 1e-12}
    assert wanted <= found
    assert not beyond
