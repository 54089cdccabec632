"""Thick ropes: what their bends take, and where their ends must be."""

from __future__ import annotations

import numpy as np
import pytest
from scripted import regular_hitch, standing

from hitchopt.simulate.thickness import thickness_allowance


@pytest.mark.parametrize("n", [3, 5, 12])
def test_thick_cables_need_as_much_more_as_their_bends_do(n: int) -> None:
    hitch = regular_hitch(n)
    _, vertices = standing(hitch, 0.1)
    found = thickness_allowance(hitch.team, vertices, 0.01)
    # Drawn as polygons: a circle of one diameter about the other cable, and tangents to the legs.
    turn = 2.0 * np.pi / n
    angle = np.linspace(0.5 * turn, np.pi - 0.5 * turn, 2001) + 0.5 * np.pi
    arc = 0.005 + 0.01 * np.cos(angle) + 1j * 0.01 * np.sin(angle)
    far = np.exp(0.5j * turn)
    path = np.array([far, *arc, far.conjugate()])
    longer = np.sum(np.abs(np.diff(path))) - 2.0
    np.testing.assert_allclose(found, 2.0 * longer, atol=2e-4)
