"""Clasps nearer to a rim's edge, where legs of those farther inside would cut the rim."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from benchmarks.families import wild_carry
from hitchopt import verify
from hitchopt.carrying.polygons import MIN_INSET, OUTER_INSET, rest_polygons
from hitchopt.objects import Rim, Section

RIMS = {
    "round": ho.SolidObject(
        Section(radius=0.08), 0.0, 0.4, rim=Rim(Section(radius=0.26), 0.3), mass=0.3
    ),
    "long": ho.SolidObject(
        Section(np.array([[-0.12, -0.08], [0.12, -0.08], [0.12, 0.08], [-0.12, 0.08]])),
        0.0,
        0.4,
        rim=Rim(Section(np.array([[-0.36, -0.2], [0.36, -0.2], [0.36, 0.2], [-0.36, 0.2]])), 0.3),
        mass=0.3,
    ),
}


def legs_below(rim: Section, polygon: np.ndarray) -> float:
    """Return the longest way [m] from a clasp to the rim's edge along its edges, by bisection."""
    longest = 0.0
    for k, clasp in enumerate(polygon):
        for other in (polygon[k - 1], polygon[(k + 1) % len(polygon)]):
            along = (clasp - other) / np.linalg.norm(clasp - other)
            low, high = 0.0, 2.0
            for _ in range(60):
                middle = 0.5 * (low + high)
                inside = rim.clearance((clasp + middle * along)[None])[0][0] <= 0.0
                low, high = (middle, high) if inside else (low, middle)
            longest = max(longest, high)
    return longest


@pytest.mark.parametrize(
    ("name", "robots"),
    [(name, n) for name in RIMS for n in (3, 4, 5, 6) if (name, n) != ("long", 3)],
)
def test_outer_clasps_are_nearer_to_the_edge_and_still_below_the_rim(
    name: str, robots: int
) -> None:
    body = RIMS[name]
    assert body.rim is not None
    rim = body.rim.section
    for polygons in rest_polygons("thing", body, robots, 0.08):
        first, *others = polygons.below_rim
        insets = [-float(np.max(rim.clearance(each)[0])) for each in (first, *others)]
        assert min(insets) >= MIN_INSET - 1e-9
        assert np.all(np.array(insets[1:]) <= max(insets[0], OUTER_INSET) + 1e-9)
        if others:
            assert min(legs_below(rim, each) for each in others) < legs_below(rim, first)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1001, 1029])
def test_objects_are_held_where_legs_would_cut_the_rim_farther_inside(
    seed: int, tmp_path: Path
) -> None:
    plan = ho.solve(ho.problem_from_dict(wild_carry(seed)))
    assert plan.certificate.certified
    plan.save(tmp_path)
    assert {row.verdict for row in verify.verify(tmp_path)} <= set(verify.PASSING)
