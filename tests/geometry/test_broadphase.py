"""The spatial index, against looking at all pairs."""

import itertools
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.geometry.broadphase import Boxes, close_pairs


def gap(a: Boxes, i: int, b: Boxes, j: int) -> float:
    """The distance of two boxes, axis by axis."""
    per_axis = [
        max(a.lower[i, x] - b.upper[j, x], b.lower[j, x] - a.upper[i, x], 0.0) for x in range(3)
    ]
    return math.sqrt(sum(p * p for p in per_axis))


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
