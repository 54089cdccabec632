"""Morphs between irregular polygons: wild ends, whose legs are rolled, and fair ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import hitchopt as ho

PAIRS: list[dict[str, Any]] = json.loads(
    Path(__file__).with_name("irregular_pairs.json").read_text(encoding="utf-8")
)
"""Polygons whose hitches are certified: fair ones without roll, wild ones with automatic roll."""


def planned(pair: dict[str, Any]) -> ho.Plan:
    """Return the plan of a pair between hitches with spread legs."""
    team = ho.Team(pair["n"], pair["cable_length"])
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    return ho.morph(start, pair["goal"])


@pytest.mark.parametrize("index", [33, 34])
def test_distances_between_rolled_hitches_are_those_in_space(index: int) -> None:
    """Cables pass each other above and below, which touch in plan view."""
    plan = planned(PAIRS[index])
    assert plan.certificate.certified
    assert "optimised" in str(plan.motion.phases[0].remark)
