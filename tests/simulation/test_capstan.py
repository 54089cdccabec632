"""Friction of a simulated clasp, compared with the capstan's exponential."""

from __future__ import annotations

import math

import pytest

from benchmarks.capstan import capstan_test
from hitchopt.simulation.simulation_settings import ACCURATE


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "slide"), [(0.0, 0.6), (0.1, 0.8), (0.3, 2.5)])
def test_the_accurate_preset_has_a_capstans_friction(friction: float, slide: float) -> None:
    found = capstan_test(ACCURATE, friction, slide=slide, measured=0.5)
    assert found.expected == pytest.approx(math.exp(friction * math.pi / 2.0))
    assert found.ratio == pytest.approx(found.expected, rel=0.05)
