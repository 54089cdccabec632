"""Legs that lean against clasp friction: tensions of edges over those of legs."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.planners.carrying.clasp_lean import edge_ratios

ANGLES = np.radians([130.0, 130.0, 130.0])
LONG = np.ones(3)


@pytest.mark.parametrize("friction", [0.15, 0.05, -0.05, -0.15])
def test_ratios_are_those_of_a_capstan(friction: float) -> None:
    """Found another way: by bisection of what edges and legs enclose."""
    ratio = edge_ratios(np.array([friction]), ANGLES[None], LONG[None], 0.0)
    low, high = 0.0, np.pi
    for _ in range(80):
        legs = 0.5 * (low + high)
        found = np.exp(-friction * 0.5 * (ANGLES[0] + legs))
        too_wide = np.cos(0.5 * legs) < found * np.cos(0.5 * ANGLES[0])
        low, high = (low, legs) if too_wide else (legs, high)
    np.testing.assert_allclose(ratio, found, rtol=1e-4)


def test_without_friction_edges_pull_as_legs_do() -> None:
    ratio = edge_ratios(np.zeros(1), ANGLES[None], LONG[None], 0.3)
    np.testing.assert_allclose(ratio, 1.0, atol=1e-9)


def test_of_both_clasps_of_a_cable_the_lesser_friction_counts() -> None:
    angles = np.radians([[150.0, 100.0, 150.0]])
    alone = [
        edge_ratios(np.array([0.1]), np.full((1, 3), a), LONG[None], 0.0)[0, 0]
        for a in (angles[0, 0], angles[0, 1])
    ]
    mixed = edge_ratios(np.array([0.1]), angles, LONG[None], 0.0)[0]
    weaker, stronger = max(alone), min(alone)
    assert np.all(mixed[:2] > stronger)
    assert np.all(np.log(mixed[:2]) > 1.1 * np.log(weaker))


def test_legs_that_would_meet_lean_less() -> None:
    acute, short = np.radians([[50.0, 50.0, 50.0]]), np.full((1, 3), 0.3)
    friction = np.array([-0.15])
    free = edge_ratios(friction, acute, np.full((1, 3), 5.0), 0.0)
    kept = edge_ratios(friction, acute, short, 0.28)
    assert np.all((kept >= 1.0) & (kept < free))
