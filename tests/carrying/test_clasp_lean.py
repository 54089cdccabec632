"""Legs that lean against clasp friction: tensions of edges over those of legs."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.planners.carrying.grip import edge_ratios

ANGLES = np.radians([130.0, 130.0, 130.0])


@pytest.mark.parametrize("friction", [0.15, 0.05, 0.0, -0.15])
def test_ratios_are_those_of_a_capstan(friction: float) -> None:
    """Found another way: by bisection of what edges and legs enclose."""
    ratio = edge_ratios(np.array([friction]), ANGLES[None])
    low, high = 0.0, np.pi
    for _ in range(80):
        legs = 0.5 * (low + high)
        found = np.exp(-friction * 0.5 * (ANGLES[0] + legs))
        too_wide = np.cos(0.5 * legs) < found * np.cos(0.5 * ANGLES[0])
        low, high = (low, legs) if too_wide else (legs, high)
    np.testing.assert_allclose(ratio, found, rtol=1e-4)
