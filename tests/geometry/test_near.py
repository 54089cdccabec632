"""Close pairs of boxes, and closest points of segments, against brute force."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs

SHARES = np.linspace(0.0, 1.0, 201)


def gap(a: Boxes, i: int, b: Boxes, j: int) -> float:
    """The distance of two boxes, axis by axis."""
    apart = np.maximum(a.lower[i] - b.upper[j], b.lower[j] - a.upper[i])
    return float(np.linalg.norm(np.maximum(apart, 0.0)))


def boxes(rng: np.random.Generator, count: int, scale: float) -> Boxes:
    """Boxes of sizes from 1e-4 to 10, some of them points."""
    centres = rng.uniform(-scale, scale, (count, 3))
    sizes = 10.0 ** rng.uniform(-4.0, 1.0, (count, 3)) * (rng.random((count, 1)) > 0.3)
    return Boxes(centres - sizes, centres + sizes)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), cutoff=st.floats(0.0, 3.0), one=st.booleans())
def test_close_pairs_are_those_that_all_pairs_show(seed: int, cutoff: float, one: bool) -> None:
    rng = np.random.default_rng(seed)
    a, b = boxes(rng, 30, 20.0), boxes(rng, 20, 20.0)
    pairs = close_pairs(a, None if one else b, cutoff)
    found = list(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    if one:
        both = itertools.combinations(range(30), 2)
        expected = {(i, j) for i, j in both if gap(a, i, a, j) <= cutoff}
    else:
        expected = {(i, j) for i in range(30) for j in range(20) if gap(a, i, b, j) <= cutoff}
    assert len(found) == len(set(found))
    assert set(found) == expected


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
