"""The hanging cable against its definition: balance and minimum energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.catenary import (
    Catenary,
    bounded_radius,
    depth_rate,
    depth_terms,
    displacement_bound,
    pull_terms,
    steepness,
)
from hitchopt.hitch.forces import hanging_forces

# Share of what is left across, height over length, length.
SPANS = st.tuples(st.floats(0.02, 0.98), st.floats(-0.9, 0.9), st.floats(0.3, 3.0))


def cable(case: tuple[float, float, float]) -> Catenary:
    share, height, length = case
    rise = 0.9 * height * length
    return Catenary.spanning(share * math.sqrt(length**2 - rise**2), rise, length)


@given(SPANS)
@settings(max_examples=60)
def test_every_part_of_the_cable_is_in_balance(case: tuple[float, float, float]) -> None:
    """The slope is proportional to the length from the lowest point."""
    c, step = cable(case), 1e-5
    shares = np.linspace(0.1, 0.9, 7)
    mu = c.parameter(shares) + np.array([[step], [-step]])
    heights = 0.5 * (1.0 + mu) * c.rise - c.depth(mu)
    slopes = (heights[0] - heights[1]) / (step * c.across)
    growth = np.diff(slopes) / (np.diff(shares) * c.length)
    assert growth == pytest.approx(np.full(6, growth[0]), rel=2e-4)
    inward, _ = pull_terms(c.sigma)
    assert 1.0 / growth[0] == pytest.approx(0.5 * float(c.across * inward), rel=2e-4)


@given(SPANS)
@settings(max_examples=40)
def test_lowest_point_and_mirror_image(case: tuple[float, float, float]) -> None:
    c = cable(case)
    mu = np.linspace(-1.0, 1.0, 20001)
    heights = 0.5 * (1.0 + mu) * float(c.rise) - c.depth(mu)
    assert float(c.lowest) <= np.min(heights) + 1e-12
    assert float(c.lowest) == pytest.approx(np.min(heights), abs=1e-3 * float(c.length))
    other = Catenary.spanning(c.across, -c.rise, c.length)
    np.testing.assert_allclose(other.depth(-mu), c.depth(mu), atol=1e-12)
    larger = Catenary.spanning(3.0 * c.across, 3.0 * c.rise, 3.0 * c.length)
    np.testing.assert_allclose(larger.depth(mu), 3.0 * c.depth(mu), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_pulls_are_gradients_of_the_energy(seed: int) -> None:
    """Finite differences of the potential energy by the ends' positions; unequal cables."""
    drones = np.random.default_rng(seed).uniform(-0.5, 0.5, (6, 3)) + [3.0, -2.0, 5.0]
    team = Team(3, [1.9, 2.1, 2.4], cable_density=0.013)
    share = (np.arange(4000) + 0.5)[:, None] / 4000

    def energy(places: np.ndarray) -> float:
        q, r = places[0::2], places[1::2]
        c = Catenary.between(q, r, team.cable_length)
        mu = c.parameter(share)
        z = q[:, 2] + 0.5 * (1.0 + mu) * (r - q)[:, 2] - c.depth(mu)
        return float(np.sum(GRAVITY * 0.013 * team.cable_length * np.mean(z, axis=0)))

    forces, step = hanging_forces(team, drones), 1e-4
    for i, axis in np.ndindex(drones.shape):
        moved = np.zeros(drones.shape)
        moved[i, axis] = step
        by_energy = (energy(drones - moved) - energy(drones + moved)) / (2.0 * step)
        assert forces[i, axis] == pytest.approx(by_energy, rel=2e-3, abs=2e-4)
    weights = -GRAVITY * 0.013 * team.cable_length[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(forces.reshape(3, 2, 3).sum(axis=1), weights, rtol=1e-12, atol=1e-12)
    assert not np.any(hanging_forces(Team(3, team.cable_length), drones))  # without weight


@pytest.mark.parametrize("ratio", [1.0 + 1e-12, 1.0 + 1e-7, 1.001, 1.7, 2.999, 3.001, 20.0, 1e6])
def test_steepness_solves_its_equation(ratio: float) -> None:
    sigma = float(steepness(ratio))
    if sigma > 1e-3:
        assert math.sinh(sigma) / sigma == pytest.approx(ratio, rel=1e-13)
    else:
        assert sigma**2 / 6.0 + sigma**4 / 120.0 == pytest.approx(ratio - 1.0, rel=1e-4)
    assert float(steepness(0.7)) == 0.0  # taut


def test_the_shape_changes_by_at_most_a_quarter_per_steepness() -> None:
    """The bound of enclosures of hanging cables, on a fine grid, and its tightness."""
    sigma, mu = np.meshgrid(np.linspace(0.002, 15.0, 1501), np.linspace(-1.0, 1.0, 401))
    above, below = (np.array(depth_terms(sigma + s, mu)) for s in (1e-5, -1e-5))
    level, skew = np.max(np.abs(above - below), axis=(1, 2)) / 2e-5
    assert 0.249 < level < 0.25 + 1e-6
    assert skew < 0.25
    depth = np.max(np.abs(above[0] - below[0]), axis=0) / 2e-5
    share = depth / depth_rate(sigma[0])
    assert np.max(share) < 1.0 + 1e-6  # of a steeper one by less, and not by half of the bound
    assert np.min(share) > 0.5


@given(SPANS, st.floats(0.001, 0.2), st.sampled_from([1.0, 2.5]), st.integers(0, 2**32 - 1))
@settings(max_examples=100)
def test_points_move_with_both_ends_by_no_more_than_the_bound(
    case: tuple[float, float, float], off: float, ratio: float, seed: int
) -> None:
    c, rng, flat = cable(case), np.random.default_rng(seed), np.array([1.0, 1.0, 1.0 / ratio])
    mu = np.linspace(-1.0, 1.0, 101)[:, None]

    def points(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        found = first + 0.5 * (1.0 + mu) * (second - first)
        return np.column_stack([*found.T[:2], found[:, 2] - Catenary.between(
            first, second, c.length).depth(mu[:, 0])])  # fmt: skip

    ends = np.array([[0.0, 0.0, 0.0], [float(c.across), 0.0, float(c.rise)]])
    span = (c.across, c.across), np.abs(c.rise), c.length
    bound = float(displacement_bound(*span, off, ratio))
    ways = rng.normal(size=(20, 2, 3))
    ways[0] = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]  # toward each other
    for way in off * ways / np.linalg.norm(ways * flat, axis=-1, keepdims=True):
        moved = (points(*(ends + way)) - points(*ends)) * flat
        assert np.max(np.linalg.norm(moved, axis=-1)) <= bound * (1.0 + 1e-9)
    smaller = displacement_bound(*span, 0.5 * off, ratio)
    assert smaller <= 0.5 * bound * (1.0 + 1e-9)
    assert c.extra_displacement(0.0, ratio) == 0.0


def test_cables_that_upright_errors_may_straighten_have_no_bound() -> None:
    steep = Catenary.spanning(0.2, 0.9, 1.0)
    bounds = [float(steep.extra_displacement(0.01, ratio)) for ratio in (1.0, 2.0, 4.9, 5.0, 6.0)]
    assert np.isfinite(bounds[0])
    assert bounds == sorted(bounds)
    assert bounds[3:] == [np.inf, np.inf]  # chords as long as the cable


@pytest.mark.parametrize("height_ratio", [1.0, 2.5])
def test_displacements_are_bounded_up_to_a_radius(height_ratio: float) -> None:
    rng = np.random.default_rng(5)
    length = rng.uniform(1.0, 3.0, 200)
    farthest = length * rng.uniform(0.2, 0.95, 200)
    across = farthest * rng.uniform(0.2, 1.0, 200), farthest
    radii = bounded_radius(across, length, height_ratio)
    for share, is_finite in ((0.999, True), (1.001, False)):
        bounds = [
            displacement_bound((low, high), np.zeros(1), size, share * radius, height_ratio)
            for low, high, size, radius in zip(*across, length, radii, strict=True)
        ]
        assert np.all(np.isfinite(bounds) == is_finite)
