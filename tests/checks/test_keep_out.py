"""Prisms: distances to them, and bounds that no sample beats."""

from __future__ import annotations

import numpy as np
import pytest
from certificate_cases import applied
from free_cases import random_curves, single

from hitchopt.checks import certify
from hitchopt.checks.clearance import KEEP_OUT
from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Limits, Prism
from hitchopt.trajectory import PiecewisePolynomial

OUTLINE = np.array([[1.0, -0.5], [0.2, 0.4], [0.9, 1.3], [2.1, 0.6]])
PRISM = Prism(OUTLINE, 0.4, 1.7)


def clearance(curves: PiecewisePolynomial, *prisms: Prism) -> float:
    """Smallest distance of drones on curves (N, 3) to prisms."""
    return applied(KEEP_OUT, single(curves, keep_out=prisms)).bound


def crowded(prism: Prism, n: int, seed: int) -> np.ndarray:
    """Points all over a prism, its faces, edges and corners among them."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.full(len(prism.corners), 0.3), n)
    return np.vstack([weights @ prism.corners, prism.corners])


def test_distances_are_those_to_the_nearest_of_many_points() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-1.0, -2.0, -1.0], [4.0, 3.0, 3.0], (200, 3))
    found = PRISM.clearance(points)
    many = crowded(PRISM, 20_000, 2)
    for point, distance, normal in zip(points, found.distance, found.normals, strict=True):
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        nearest = float(np.min(np.linalg.norm(many - point, axis=1)))
        if distance > 0.0:
            assert distance <= nearest + 1e-12
            assert nearest <= distance + 0.12
            foot = point - distance * normal
            assert PRISM.clearance(foot).distance == pytest.approx(0.0, abs=1e-9)
        else:  # along the normal it is so far to the outside
            out = point + (1e-9 - distance) * normal
            assert PRISM.clearance(out).distance > 0.0
            assert nearest < 0.2


@pytest.mark.parametrize("seed", range(6))
def test_no_sample_beats_the_bound_and_it_is_tight(seed: int) -> None:
    curves = random_curves(2, seed, 0.6, (1.5, 0.5, 1.2))
    found = clearance(curves, PRISM, Prism(OUTLINE + 3.0, -1.0, 0.2))
    points = curves.at(np.linspace(0.0, 2.4, 20_001))
    sampled = min(
        float(np.min(prism.clearance(points).distance))
        for prism in (PRISM, Prism(OUTLINE + 3.0, -1.0, 0.2))
    )
    assert found <= max(sampled, 0.0) + 1e-12
    assert found >= max(sampled, 0.0) - 2e-3


def test_the_check_names_drone_and_limit_and_only_prisms_make_one() -> None:
    breaks = np.array([0.0, 1.0])
    line = np.array([[[0.0, 0.0], [-1.0, 3.0], [1.0, 1.0]], [[-2.0, -2.0], [0.0, 0.0], [1.0, 1.0]]])
    curves, fast = PiecewisePolynomial(breaks, line[None]), Limits(speed=9.0)
    check = certify(single(curves, limits=fast, keep_out=(PRISM,)))["keep_out"]
    assert check.where == ("d0",)
    assert (check.limit, check.sense, check.unit) == (0.12, "min", "m")
    outward = np.array([-0.9, 0.8]) / np.linalg.norm([0.9, 0.8])
    assert check.worst == pytest.approx(0.2, rel=1e-3) or check.worst == pytest.approx(
        float(outward @ (np.array([0.0, 0.4]) - OUTLINE[1])), rel=1e-3
    )
    assert check.holds
    assert "keep_out" not in [c.name for c in certify(single(curves, limits=fast)).checks]


def test_within_a_prism_the_distance_is_zero() -> None:
    inside = PiecewisePolynomial.constant([0.0, 1.0], PRISM.corners.mean(axis=0)[None], 3)
    assert clearance(inside, PRISM) == 0.0


@pytest.mark.parametrize(
    ("outline", "lower", "upper", "key"),
    [
        (OUTLINE[::-1], 0.0, 1.0, "polygon"),
        (OUTLINE, 1.0, 1.0, "upper"),
        (OUTLINE, np.nan, 1.0, "lower"),
    ],
)
def test_prisms_that_are_wrong(outline: np.ndarray, lower: float, upper: float, key: str) -> None:
    with pytest.raises(InputError, match=key):
        Prism(outline, lower, upper)
