"""Roll of the legs: when there is one, that it is small, and that it keeps its margins in space."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt import Hitch, InputError, Limits, Separation, Team
from hitchopt.geometry import regular_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.steps.certified_motions import split_hitch
from hitchopt.steps.step import RolledLegs, slack_split
from problems.random_morph import random_convex_polygon

Array = NDArray[np.float64]


def margin(h: Hitch) -> float:
    """Smallest distance over its limit, written out pair by pair in space."""
    n, p, x = h.team.robots, h.vertices, h.drones
    i, j = np.triu_indices(2 * n, 1)
    smallest = [float(np.min(np.linalg.norm((x[i] - x[j]) / [0.24, 0.24, 0.6], axis=1)))]
    following = np.roll(p, -1, axis=0)
    for k in range(n):
        for start, end, others in (
            (p[k], following[k], np.ones(2 * n, dtype=bool)),
            (p[k], x[2 * k], np.arange(2 * n) // 2 != k),
            (following[k], x[2 * k + 1], np.arange(2 * n) // 2 != k),
        ):
            along = end - start
            share = np.clip((x[others] - start) @ along / (along @ along), 0.0, 1.0)
            off = x[others] - start - share[:, None] * along
            smallest.append(float(np.min(np.linalg.norm(off, axis=1))) / 0.10)
    return min(smallest)


@pytest.mark.parametrize("n", [6, 12, 24])
def test_hitches_whose_level_legs_keep_their_limits_are_not_rolled(n: int) -> None:
    h = Hitch.spread(Team(n, 2.2), regular_polygon(n, 1.3))
    np.testing.assert_array_equal(h.roll, 0.0)
    np.testing.assert_array_equal(h.drones[:, 2], 1.0)
    assert margin(h) >= 1.0


@pytest.mark.parametrize("n", [29, 50, 200])
def test_large_regular_hitches_get_the_smallest_roll_that_clears_their_edges(n: int) -> None:
    """``d √(1 - (q̂·u)²)`` from its own edge, at 1.5 times the limit, by the closed form."""
    team, polygon = Team(n, 2.2), regular_polygon(n, 1.3).translated([3.0, -2.0])
    h = Hitch.spread(team, polygon)
    assert np.ptp(h.roll) == 0.0
    assert margin(h) >= 1.5 - 1e-6
    phi = 2.0 * math.pi / n
    d = 0.45

    def clearance(roll: float) -> float:
        # The legs are at half of the interior angle from V and turn about it.
        along = math.cos(0.5 * phi) ** 2 * math.cos(roll) - math.sin(0.5 * phi) ** 2
        return d * math.sqrt(1.0 - along**2)

    assert clearance(0.0) < 0.1
    assert clearance(h.roll[0]) == pytest.approx(0.15, abs=2e-3)
    level = Hitch.balanced(team, polygon)
    assert margin(level) < 1.0


def test_a_thousand_robots_are_rolled_in_linear_time() -> None:
    h = Hitch.spread(Team(1000, 2.2), regular_polygon(1000, 1.3))
    assert 0.2 < h.roll[0] < 0.4
    own = h.drones[0::2] - h.vertices
    edges = np.roll(h.vertices, -1, axis=0) - h.vertices
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    aside = own - np.sum(own * edges, axis=1, keepdims=True) * edges
    assert np.min(np.linalg.norm(aside, axis=1)) >= 0.15 - 1e-6


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(3, 6))
@settings(max_examples=10)
def test_legs_with_weight_are_split_for_their_distances_in_space(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 1.2, rng)
    lengths = float(np.max(polygon.edge_lengths)) + rng.uniform(0.8, 0.9, n)
    team = Team(n, lengths, tension=0.9, cable_density=0.01)
    h = Hitch.spread(team, polygon)
    light = Hitch.spread(Team(n, lengths, tension=0.9), polygon)
    if margin(light) >= 1.5 + 1e-3:  # weight moves drones by centimetres only
        assert margin(h) >= 1.5 - 1e-6
    assert np.min(h.legs) >= 0.149


def test_other_lengths_are_chosen_where_they_need_less_roll() -> None:
    polygon = random_convex_polygon(16, 0.7, np.random.default_rng(4))
    team = Team(16, float(np.max(polygon.edge_lengths)) + np.linspace(0.5, 0.6, 16), tension=0.6)
    h = Hitch.spread(team, polygon)
    as_they_are = Hitch.balanced(team, polygon).least_rolled(Requirements())
    assert margin(h) >= 1.0
    assert margin(as_they_are) >= 1.0
    assert 0.0 < h.roll[0] < 0.9 * as_they_are.roll[0]


def test_a_hitch_that_follows_keeps_its_roll_or_gets_one_where_it_must() -> None:
    keep: dict[str, Any] = {"limits": Limits(), "separation": Separation()}
    small = Team(8, 2.2)
    kept = Hitch.nearest(small, regular_polygon(8, 1.3), 1.0, np.full(8, 0.5), roll=0.2, **keep)
    np.testing.assert_array_equal(kept.roll, 0.2)
    large = Team(40, 2.2)
    polygon = regular_polygon(40, 1.3)
    raised = Hitch.nearest(large, polygon, 1.0, np.full(40, 0.5), **keep)
    assert 0.0 < raised.roll[0] < Hitch.spread(large, polygon).roll[0]
    assert 1.0 <= margin(raised) < 1.05


def test_what_a_user_may_write_for_the_roll() -> None:
    team, polygon = Team(4, 2.2), regular_polygon(4, 1.2)
    requirements = Requirements()

    def rolled(legs: Any) -> Hitch:
        return split_hitch(team, polygon, 1.0, slack_split(legs, team), requirements)

    np.testing.assert_allclose(rolled({"roll_deg": 20.0}).roll, math.radians(20.0))
    listed = rolled({"sharing": "balanced", "roll_deg": [0.0, 10.0, -10.0, 5.0]})
    np.testing.assert_allclose(np.degrees(listed.roll), [0.0, 10.0, -10.0, 5.0])
    given = rolled({"sharing": [0.4, 0.5, 0.5, 0.6], "roll_deg": "auto"})
    np.testing.assert_array_equal(given.roll, 0.0)
    np.testing.assert_array_equal(given.q_legs, [0.4, 0.5, 0.5, 0.6])
    np.testing.assert_array_equal(rolled(RolledLegs("spread", np.full(4, 0.3))).roll, 0.3)
    for legs, key in (
        ({"roll_deg": "up"}, r"legs\.roll_deg = 'up'"),
        ({"roll_deg": 90.0}, r"legs\.roll_deg = 90"),
        ({"roll_deg": [1.0, 2.0]}, r"legs\.roll_deg.*one per clasp"),
        ({"roll": 0.1}, r"legs\.roll = 0.1"),
        ({"sharing": "even"}, "legs = 'even'"),
    ):
        with pytest.raises(InputError, match=key):
            slack_split(legs, team)


def test_given_legs_with_automatic_roll_are_rolled_where_they_must_be() -> None:
    team, polygon = Team(40, 2.2), regular_polygon(40, 1.3)
    legs = slack_split({"sharing": "balanced", "roll_deg": "auto"}, team)
    h = split_hitch(team, polygon, 1.0, legs, Requirements())
    assert 1.0 <= margin(h) < 1.05
    np.testing.assert_allclose(h.q_legs, 0.45)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_more_roll_has_the_sense_of_what_is_given(sense: float) -> None:
    team, polygon = Team(29, 2.2), regular_polygon(29, 1.3)
    least = Hitch.spread(team, polygon).roll
    limits, separation = Limits(), Separation(cable=0.16)
    given: dict[str, Any] = {"limits": limits, "separation": separation, "roll": sense * least}
    following = Hitch.nearest(team, polygon, 1.0, np.full(29, 0.5), **given)
    assert np.all(sense * following.roll > least)
