"""Linking numbers, against crossings counted in a projection."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.simulation.linking_numbers import linking_matrix, linking_number

Array = NDArray[np.float64]


def ring(centre: Array, normal: int, corners: int = 17, turns: int = 1) -> Array:
    """A circle about an axis, gone around some times, rising a little so as not to meet itself."""
    angle = 2.0 * np.pi * np.arange(corners * turns) / corners
    plane = np.array([np.cos(angle), np.sin(angle), 0.05 * np.sin(angle / max(turns, 1))])
    points: Array = centre + np.roll(plane, normal, axis=0).T
    return points


def crossings(one: Array, other: Array) -> float:
    """Return half the signed crossings seen from above, which is the same number."""
    total = 0.0
    for a, b in zip(one, np.roll(one, -1, axis=0), strict=True):
        for c, d in zip(other, np.roll(other, -1, axis=0), strict=True):
            u, v, w = b - a, d - c, c - a
            area = u[0] * v[1] - u[1] * v[0]
            s, t = (w[0] * v[1] - w[1] * v[0]) / area, (w[0] * u[1] - w[1] * u[0]) / area
            if 0.0 < s < 1.0 and 0.0 < t < 1.0:
                above = a[2] + s * u[2] > c[2] + t * v[2]
                total += 0.5 * np.sign(area) * (1.0 if above else -1.0)
    return total


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_rings_are_linked_as_often_as_one_goes_around_the_other(turns: int) -> None:
    one = ring(np.zeros(3), 0)
    other = ring(np.array([1.0, 0.1, 0.0]), 2, turns=turns)
    assert abs(linking_number(one, other)) == turns
    assert linking_number(one, other) == linking_number(other, one)
    assert linking_number(one, other[::-1]) == -linking_number(one, other)
    mirror = np.array([1.0, 1.0, -1.0])
    assert linking_number(one * mirror, other * mirror) == -linking_number(one, other)


def test_rings_apart_and_side_by_side_are_not_linked() -> None:
    one = ring(np.zeros(3), 0)
    assert linking_number(one, ring(np.array([2.5, 0.0, 0.0]), 2)) == 0
    assert linking_number(one, ring(np.array([1.0, 0.0, 0.4]), 0)) == 0  # one above the other


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_random_polygons_are_linked_as_their_crossings_say(seed: int) -> None:
    random = np.random.default_rng(seed)
    one, other = random.normal(size=(7, 3)), 0.3 + random.normal(size=(9, 3))
    expected = crossings(one, other)
    assert linking_number(one, other) == expected
    turn = Rotation.random(random_state=seed)
    shift = random.normal(size=3)
    assert linking_number(turn.apply(one) + shift, turn.apply(other) + shift) == expected


def test_the_matrix_names_the_pairs_that_are_linked() -> None:
    rings = [
        ring(np.array([1.4 * k, 0.0, 0.0]), 2 * (k % 2), corners=12) for k in range(4)
    ]  # a chain of four
    expected = np.diag([1, 1, 1], 1) + np.diag([1, 1, 1], -1)
    np.testing.assert_array_equal(np.abs(linking_matrix(rings)), expected)
