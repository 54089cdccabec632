"""No sample of a plan between irregular polygons beats its certificate, and bounds are tight."""

from __future__ import annotations

import pytest

import hitchopt as ho
from problems.random_morph import irregular_pairs
from tests.helpers.by_hand import assert_sound

PAIRS = irregular_pairs()
FAST = {1, 33}
"""Pairs that are planned soon: one with level legs, one with rolled ones."""


@pytest.mark.parametrize(
    "index", [pytest.param(i, marks=[] if i in FAST else pytest.mark.slow) for i in range(60)]
)
def test_samples_of_plans_between_irregular_polygons_beat_no_bound(index: int) -> None:
    pair = PAIRS[index]
    start = ho.Hitch.spread(ho.Team(pair["n"], pair["cable_length"]), pair["start"], 1.5)
    assert_sound(ho.morph(start, pair["goal"]).motion, count=2001, gap=0.05, least=1e-4)
