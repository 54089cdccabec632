"""Ties: what rounding alone tells apart is ordered by index."""

from __future__ import annotations

import numpy as np

from hitchopt.geometry.vectors import first_smallest, tied_order


def test_the_first_of_equals_is_the_smallest() -> None:
    values = np.array([[3.0, 1.0, 1.0 - 1e-14], [1e-15, 0.0, 2.0], [2.0, 1.0, 0.999]])
    assert first_smallest(values, 1.0).tolist() == [1, 0, 2]
    assert first_smallest(values, np.full(3, 1e-9)).tolist() == [2, 1, 2]


def test_equals_stay_in_their_order() -> None:
    values = np.array([2.0, 1.0 + 1e-14, 0.5, 1.0, 2.0 - 1e-14, 1.001])
    assert tied_order(values, 1.0).tolist() == [2, 1, 3, 5, 0, 4]
    assert tied_order(values, 1e-9).tolist() == [2, 3, 1, 5, 4, 0]
