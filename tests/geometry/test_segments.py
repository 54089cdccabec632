"""Closest points of points and segments, against brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry import differences, shortest_offset

SHARES = np.linspace(0.0, 1.0, 201)


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
@settings(max_examples=60)
def test_offsets_are_the_shortest_of_all_that_join_the_segments(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    a0, a1, b0, b1 = rng.normal(size=(4, 8, d))
    a1[0] = a0[0]  # a point
    b1[1], a1[1] = b0[1], a0[1]  # two points
    b1[2] = b0[2] + 2.0 * (a1[2] - a0[2])  # parallel
    b0[3] = a0[3]  # touching
    a, b = np.stack([a0, a1], axis=1), np.stack([b0, b1], axis=1)
    offsets = shortest_offset(differences(a, b))
    on_a = a0[:, None] + SHARES[:, None] * (a1 - a0)[:, None]
    on_b = b0[:, None] + SHARES[:, None] * (b1 - b0)[:, None]
    sampled = np.linalg.norm(on_a[:, :, None] - on_b[:, None, :], axis=-1).min(axis=(1, 2))
    found = np.linalg.norm(offsets, axis=1)
    lengths = np.linalg.norm(a1 - a0, axis=1) + np.linalg.norm(b1 - b0, axis=1)
    assert np.all(found <= sampled + 1e-12)
    assert np.all(sampled - found <= lengths * 0.0026)
    reverse = shortest_offset(differences(b, a))
    np.testing.assert_allclose(np.linalg.norm(reverse, axis=1), found, atol=1e-12)
