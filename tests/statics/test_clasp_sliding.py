"""Friction of cables that slide through their clasps: the law, and what counts how much."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.geometry.vectors import unit
from hitchopt.statics.friction import (
    COSINES,
    IN_SPACE,
    TURNS,
    friction_pulls,
)


def test_friction_is_coulombs_in_space() -> None:
    """Against vectors: it opposes one surface's velocity over the other's, swapped or reversed."""
    random = np.random.default_rng(7)
    for turn in np.radians([20.0, 52.0, 88.0, 119.0]):
        c, space = np.interp(turn, TURNS, COSINES), np.interp(turn, TURNS, IN_SPACE)
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        along_a, along_b = frame[0], c * frame[0] + np.sqrt(1.0 - c**2) * frame[1]
        assert along_a @ along_b == pytest.approx(c)
        for rates in random.normal(size=(20, 2)):
            over = unit(rates[0] * along_a - rates[1] * along_b)
            on_a, on_b = -turn * space * over, turn * space * over
            # Where friction pulls a cable back, its leg is pulled the harder by as much.
            expected = [-on_a @ along_a, -on_b @ along_b]
            turns = np.full(2, turn)
            np.testing.assert_allclose(friction_pulls(turns, rates), expected)
            np.testing.assert_allclose(friction_pulls(turns, rates[::-1]), expected[::-1])
            np.testing.assert_allclose(friction_pulls(turns, -rates), np.negative(expected))
            np.testing.assert_allclose(friction_pulls(turns, 7.0 * rates), expected)
