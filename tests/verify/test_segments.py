"""Distances of the independent verifier from bodies."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.values import Array
from hitchopt.verify.arithmetic import Line, norm
from hitchopt.verify.shapes import Slab

HEXAGON = np.array([[np.cos(a), -np.sin(a)] for a in np.arange(6) * np.pi / 3.0])
SLABS = {
    "circle": Slab(None, 0.4, -0.3, 0.5),
    "outline": Slab([0.7, 0.4] * HEXAGON, 0.0, 0.2, 0.9),
    "rounded": Slab([0.3, 0.5] * HEXAGON, 0.05, -0.1, 0.0),
}


def still(points: Array) -> Line:
    """Return points at rest."""
    zeros = np.zeros(len(points))
    return Line(points, np.zeros_like(points), zeros, zeros)


@pytest.mark.parametrize("kind", SLABS)
def test_the_gap_of_a_segment_is_that_of_its_nearest_point(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is found with few evaluations, also where segments touch the body at both ends."""
    slab, rng = SLABS[kind], np.random.default_rng(3)
    ends = rng.uniform(-1.5, 1.5, (2, 60, 3))
    ends[:, ::2, 2] += 2.0  # above the body, so that none of these enters it
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    sampled = ends[0] + share * (ends[1] - ends[0])
    distances = norm(slab.gap_vectors(sampled.reshape(-1, 3))).reshape(4001, -1)
    calls = list[int]()
    original = Slab.gap_vectors

    def counted(self: Slab, x: Array) -> Array:
        calls.append(len(x))
        return original(self, x)

    monkeypatch.setattr(Slab, "gap_vectors", counted)
    gaps = slab.gap(still(ends[0]), still(ends[1])).v[:, 0]
    nearest = np.min(distances, axis=0)
    outside = nearest > 1e-3
    assert np.sum(outside) > 30
    assert np.all(gaps <= nearest + 1e-12)
    np.testing.assert_allclose(gaps[outside], nearest[outside], atol=1e-5)
    assert np.all(gaps[~outside] < 2e-3)
    assert len(calls) <= 60
