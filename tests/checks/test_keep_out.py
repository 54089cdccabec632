"""Prisms: distances to them; ``test_bounds`` holds the check to samples."""

from __future__ import annotations

import numpy as np
import pytest
from by_hand import off_prism
from motions import lines
from refusals import assert_refused

from hitchopt.checks import certify
from hitchopt.hitch.requirements import Prism
from hitchopt.values import Array

OUTLINE = np.array([[1.0, -0.5], [0.2, 0.4], [0.9, 1.3], [2.1, 0.6]])
PRISM = Prism(OUTLINE, 0.4, 1.7)


def test_distances_and_the_ways_out_of_a_prism() -> None:
    points = np.random.default_rng(1).uniform([-1.0, -2.0, -1.0], [4.0, 3.0, 3.0], (400, 3))
    found, apart = PRISM.clearance(points), off_prism(points, PRISM)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=-1), 1.0)
    np.testing.assert_allclose(np.maximum(found.distance, 0.0), apart, atol=1e-9)
    assert np.any(found.distance < 0.0)
    feet = points - found.distance[:, None] * found.normals  # on its surface, from either side
    np.testing.assert_allclose(off_prism(feet + 1e-3 * found.normals, PRISM), 1e-3, atol=1e-9)


def test_the_check_has_the_radius_for_its_limit_and_only_prisms_make_one() -> None:
    still = [[0.0, -1.0, 1.0]]
    check = certify(lines(still, still, keep_out=(PRISM,)))["keep_out"]
    assert (check.limit, check.sense, check.unit) == (0.12, "min", "m")
    assert "keep_out" not in [c.name for c in certify(lines(still, still)).checks]


@pytest.mark.parametrize(
    ("outline", "lower", "upper", "key", "words"),
    [
        (OUTLINE[::-1], 0.0, 1.0, "polygon", "clockwise"),
        (OUTLINE, 1.0, 1.0, "upper", "greater than lower 1"),
        (OUTLINE, np.nan, 1.0, "lower", "finite"),
    ],
)
def test_prisms_that_are_wrong(
    outline: Array, lower: float, upper: float, key: str, words: str
) -> None:
    assert_refused(lambda: Prism(outline, lower, upper), key, words)
