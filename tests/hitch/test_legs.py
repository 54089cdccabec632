"""Lengths and roll of legs: against a grid of all slack splits, closed forms, margins in space."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import Arena, Hitch, InputError, Limits, Separation, Team
from hitchopt.geometry import regular_polygon
from hitchopt.hitch.pairs import CROSSING, SEPARATION, TautBodies
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LegBodies, LegTask
from hitchopt.hitch.team import layout_of
from hitchopt.planners.ends import RolledLegs, split_hitch
from hitchopt.steps.keys import slack_split
from hitchopt.values import Array
from problems.random_morph import random_convex_polygon
from tests.helpers.clasp_balance import random_outline

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
KEPT: dict[str, Any] = {"limits": Limits(), "separation": Separation()}


def margins(p: Array, x: Array) -> Array:
    """(m,): minimum distance over its limit of drones (m, 2n, 3), written out pair by pair."""
    i, j = np.triu_indices(x.shape[1], 1)
    smallest = [np.min(np.linalg.norm((x[:, i] - x[:, j]) / [0.24, 0.24, 0.6], axis=-1), axis=1)]
    for k, following in enumerate(np.roll(p, -1, axis=0)):
        own = np.arange(x.shape[1]) // 2 == k
        q_leg, r_leg = (p[k], x[:, 2 * k, None], ~own), (following, x[:, 2 * k + 1, None], ~own)
        for start, end, drones in ((p[k], following, slice(None)), q_leg, r_leg):
            along, off = end - start, x[:, drones] - start
            share = np.sum(off * along, axis=-1) / np.sum(along**2, axis=-1)
            off = off - np.clip(share, 0.0, 1.0)[..., None] * along
            smallest.append(np.min(np.linalg.norm(off, axis=-1), axis=1) / 0.10)
    least: Array = np.min(smallest, axis=0)
    return least


def margin(h: Hitch) -> float:
    return float(margins(h.vertices, h.drones[None])[0])


@pytest.mark.parametrize("length", [2.0, 2.2, 2.4, 2.6])
def test_spread_is_the_nearest_to_balanced_of_all_on_a_grid(length: float) -> None:
    hitch = Hitch.spread(Team(3, length), TRIANGLE)
    p, slack, u = hitch.vertices, hitch.slack, hitch.polygon.edge_directions
    u = np.pad(u, ((0, 0), (0, 1)))
    axes = [np.linspace(0.151, s - 0.151, 31) for s in slack]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    q = p + grid[..., None] * np.roll(u, 1, axis=0)
    r = np.roll(p, -1, axis=0) - (slack - grid)[..., None] * np.roll(u, -1, axis=0)
    every = margins(p, np.stack([q, r], axis=2).reshape(-1, 6, 3))
    deviation = np.sum((grid - 0.5 * slack) ** 2, axis=1)
    if np.max(every) >= 1.5:
        assert margin(hitch) >= 1.5
        best = float(np.min(deviation[every >= 1.5]))
        assert float(np.sum((hitch.q_legs - 0.5 * slack) ** 2)) <= best + 1e-9
    else:
        assert np.max(every) - 1e-6 <= margin(hitch) < 1.5


@given(seeds := st.integers(0, 2**32 - 1), st.integers(3, 8), st.floats(-3.0, 3.0), st.booleans())
@settings(max_examples=12)
def test_legs_move_along_with_their_hitch(seed: int, n: int, angle: float, closed: bool) -> None:
    """A search may end before convergence, up to 0.2 mm away."""
    topology = "closed" if closed else "open"
    outline: Any = random_outline(seed, n, topology)
    lengths = outline.edge_lengths + np.random.default_rng(seed).uniform(0.8, 1.0, n)

    def spread(lengths: Array, outline: Any) -> Array:
        return Hitch.spread(Team(n, lengths, topology=topology), outline).legs

    first = spread(lengths, outline)
    moved = spread(lengths, outline.rotated(angle).translated([1.0, 2.0]))
    np.testing.assert_allclose(moved, first, atol=1e-3)
    if closed:
        renumbered = spread(np.roll(lengths, -2), outline.renumbered(2))
        np.testing.assert_allclose(renumbered, np.roll(first, -2, axis=0), atol=1e-3)
    # In the mirror image edge k becomes edge n-2-k, of a chain n-1-k, and q becomes r.
    order = (n - 2 - np.arange(n)) % n if closed else np.arange(n)[::-1]
    mirrored = spread(lengths[order], outline.mirrored())
    np.testing.assert_allclose(mirrored, first[order, ::-1], atol=1e-3)


def test_nearest_keeps_feasible_fractions_and_otherwise_the_limits() -> None:
    team = Team(3, 2.4)
    wide = [[0.0, -0.5], [-0.6, 0.5], [0.6, 0.5]]
    kept = Hitch.nearest(team, wide, 1.0, [0.4, 0.5, 0.6], **KEPT)
    np.testing.assert_allclose(kept.fractions, [0.4, 0.5, 0.6], atol=1e-9)
    moved = Hitch.nearest(team, TRIANGLE, 1.0, [0.5, 0.5, 0.5], **KEPT)
    assert 1.0 <= margin(moved) < 1.01
    assert np.min(moved.legs) >= 0.15


def test_an_arena_limits_legs_and_a_small_one_gives_the_largest_margin() -> None:
    team, square = Team(4, 2.4), regular_polygon(4, 1.2, 0.3)
    free = Hitch.balanced(team, square)
    wall = float(np.max(free.drones[:, 0])) - 0.1
    arena = Arena([-9.0, -9.0, 0.0], [wall, 9.0, 3.0])
    kept = Hitch.nearest(team, square, 1.0, free.fractions, **KEPT, arena=arena)
    assert np.max(kept.drones[:, 0]) <= wall + 1e-6
    assert np.max(np.abs(kept.q_legs - free.q_legs)) > 0.05
    tight = Arena([-9.0, -9.0, 0.0], [9.0, 0.6, 3.0])
    hitch = Hitch.nearest(Team(3, 2.4), TRIANGLE, 1.0, [0.5] * 3, **KEPT, arena=tight)
    assert np.min(hitch.legs) >= 0.15
    assert margin(hitch) >= 0.9


@pytest.mark.parametrize(("robots", "size"), [(6, 3.0), (16, 8.0), (16, 1.0)])
def test_near_pairs_are_those_of_every_frame(robots: int, size: float) -> None:
    """Of drifting boxes: few; many, listed for all frames at once; a crowd, listed by halves."""
    bodies, rng = TautBodies.of(layout_of(robots, "closed")), np.random.default_rng(4)
    limits = np.array([0.24, 0.0, 0.05])
    count, cutoff = len(bodies.nodes), 0.3
    drift = 0.02 * np.arange(7)[:, None, None] * rng.normal(size=(count, 2))
    lowest = size * rng.uniform(size=(count, 2)) + drift
    highest = lowest + rng.uniform(0.0, 0.3, (count, 2))
    i, j = np.triu_indices(count, 1)
    gaps = np.maximum(lowest[:, i] - highest[:, j], lowest[:, j] - highest[:, i])
    close = np.linalg.norm(np.maximum(gaps, 0.0), axis=-1) <= cutoff
    kind = bodies.kind(i, j)
    frame, pair = np.nonzero(close & np.isin(kind, (SEPARATION, CROSSING)))
    expected = set(zip(frame, i[pair], j[pair], kind[pair], strict=True))
    assert len({pair[0] for pair in expected}) == 7
    near = bodies.near(lowest, highest, limits, cutoff)
    assert set(zip(*near, strict=True)) == expected


def test_spread_slides_the_free_legs_only() -> None:
    """Of a chain with a sharp clasp, as in the paper's triangle."""
    team = Team(4, [2.0, 2.4, 2.4, 2.1], topology="open")
    points = [[0.45, 1.7], [0.4, 0.5], [0.0, -1.0], [-0.4, 0.5], [-0.45, 1.7]]
    near, far = Hitch.balanced(team, points), Hitch.spread(team, points)
    i, j = np.triu_indices(8, 1)
    closest = [
        np.min(np.linalg.norm(h.drones[i] - h.drones[j], axis=1)) / 0.24 for h in (near, far)
    ]
    assert closest[0] < min(1.5, closest[1])
    np.testing.assert_array_equal(far.legs[[0, 3]], near.legs[[0, 3]])


@pytest.mark.parametrize("n", [24, 29, 50, 200])
def test_large_regular_hitches_get_the_smallest_roll_that_clears_their_edges(n: int) -> None:
    """``d √(1 - (q̂·u)²)`` from its own edge, at 1.5 times the limit, by the closed form."""
    team, polygon = Team(n, 2.2), regular_polygon(n, 1.3).translated([3.0, -2.0])
    h, phi = Hitch.spread(team, polygon), 2.0 * math.pi / n

    def clearance(roll: float) -> float:
        # The legs are at half of the interior angle from V and turn about it.
        along = math.cos(0.5 * phi) ** 2 * math.cos(roll) - math.sin(0.5 * phi) ** 2
        return 0.45 * math.sqrt(1.0 - along**2)

    if clearance(0.0) >= 0.1:
        np.testing.assert_array_equal(h.roll, 0.0)
        assert margin(h) >= 1.0
        return
    assert np.ptp(h.roll) == 0.0
    assert margin(h) >= 1.5 - 1e-6
    assert clearance(h.roll[0]) == pytest.approx(0.15, abs=2e-3)
    assert margin(Hitch.balanced(team, polygon)) < 1.0


@pytest.mark.parametrize("density", [0.0, 0.02])
def test_legs_are_split_for_drones_where_the_hitch_has_them(density: float) -> None:
    polygon = random_convex_polygon(4, 1.2, np.random.default_rng(2))
    lengths = float(np.max(polygon.edge_lengths)) + np.array([0.8, 0.85, 0.9, 0.95])
    team = Team(4, lengths, tension=0.9, cable_density=density)
    hitch = Hitch(team, polygon, 0.0, 0.45 * (lengths - polygon.edge_lengths))
    task = LegTask.at_rest(team, polygon, hitch.q_legs, Requirements(), 1.5)
    nodes = LegBodies.within_bounds(task).nodes(hitch.q_legs[None])[4:]
    sizes = nodes.shape[-1]
    np.testing.assert_allclose(nodes, hitch.drones[:, :sizes], atol=1e-4)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(3, 6))
@settings(max_examples=10)
def test_legs_with_weight_are_split_for_their_distances_in_space(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 1.2, rng)
    lengths = float(np.max(polygon.edge_lengths)) + rng.uniform(0.8, 0.9, n)
    light, heavy = (
        Hitch.spread(Team(n, lengths, tension=0.9, cable_density=rho), polygon)
        for rho in (0.0, 0.01)
    )
    if margin(light) >= 1.5 + 1e-3:  # weight moves drones by centimetres only
        assert margin(heavy) >= 1.5 - 1e-6
    assert np.min(heavy.legs) >= 0.149


def test_the_next_hitch_keeps_its_roll_or_has_the_smallest_feasible_one() -> None:
    few = Team(8, 2.2), regular_polygon(8, 1.3), 1.0, np.full(8, 0.5)
    np.testing.assert_array_equal(Hitch.nearest(*few, roll=0.2, **KEPT).roll, 0.2)
    team, polygon = Team(40, 2.2), regular_polygon(40, 1.3)
    raised = Hitch.nearest(team, polygon, 1.0, np.full(40, 0.5), **KEPT)
    assert 0.0 < raised.roll[0] < Hitch.spread(team, polygon).roll[0]
    legs = slack_split({"sharing": "balanced", "roll_deg": "auto"}, team)
    given = split_hitch(team, polygon, 1.0, legs, Requirements())
    assert 1.0 <= min(margin(raised), margin(given)) <= max(margin(raised), margin(given)) < 1.05
    np.testing.assert_allclose(given.q_legs, 0.45)


def test_forms_of_the_roll_in_files() -> None:
    team, polygon = Team(4, 2.2), regular_polygon(4, 1.2)

    def rolled(legs: Any) -> Hitch:
        return split_hitch(team, polygon, 1.0, slack_split(legs, team), Requirements())

    np.testing.assert_allclose(rolled({"roll_deg": 20.0}).roll, math.radians(20.0))
    listed = rolled({"sharing": "balanced", "roll_deg": [0.0, 10.0, -10.0, 5.0]})
    np.testing.assert_allclose(np.degrees(listed.roll), [0.0, 10.0, -10.0, 5.0])
    given = rolled({"sharing": [0.4, 0.5, 0.5, 0.6], "roll_deg": "auto"})
    np.testing.assert_array_equal([given.roll, given.q_legs], [[0.0] * 4, [0.4, 0.5, 0.5, 0.6]])
    np.testing.assert_array_equal(rolled(RolledLegs("spread", np.full(4, 0.3))).roll, 0.3)
    for legs, words in (
        ({"roll_deg": "up"}, r"legs\.roll_deg = 'up'"),
        ({"roll_deg": 90.0}, r"legs\.roll_deg = 90"),
        ({"roll_deg": [1.0, 2.0]}, r"legs\.roll_deg.*one per clasp"),
        ({"roll": 0.1}, r"legs\.roll = 0.1"),
        ({"sharing": "even"}, "legs.sharing = 'even'"),
    ):
        with pytest.raises(InputError, match=words):
            slack_split(legs, team)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_additional_roll_has_the_sign_of_the_prescribed_one(sense: float) -> None:
    team, polygon = Team(29, 2.2), regular_polygon(29, 1.3)
    least = Hitch.spread(team, polygon).roll
    given: dict[str, Any] = {**KEPT, "separation": Separation(cable=0.16), "roll": sense * least}
    following = Hitch.nearest(team, polygon, 1.0, np.full(29, 0.5), **given)
    assert np.all(sense * following.roll > least)
