"""Open chains at rest: balance, lengths, symmetry, and what their ends leave no choice in."""

import math

import numpy as np
import pytest
from clasp_balance import random_outline
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import ConvexArc, Hitch, InfeasibleError, InputError, Separation, Team
from hitchopt.geometry import ConvexPolygon
from problems.random_morph import random_convex_polygon

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(2, 6))
@settings(max_examples=30)
def test_a_chain_is_a_closed_hitch_with_cables_left_out(seed: int, n: int) -> None:
    """Where both have a leg it ends in the same place, and pulls alike."""
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n + 3, 1.3, rng).translated([3.0, -2.0])
    length = polygon.edge_lengths + rng.uniform(0.5, 1.0, n + 3)
    tension = rng.uniform(0.4, 0.5, n + 3)
    closed = Hitch.balanced(Team(n + 3, length, tension=tension), polygon)
    team = Team(n, length[:n], topology="open", tension=tension[:n])
    d = closed.q_legs[:n].copy()
    d[0], d[-1] = 0.0, closed.slack[n - 1]
    h = Hitch(team, polygon.vertices[: n + 1], 1.0, d)
    middle = slice(2, 2 * n - 2)  # both legs of the inner cables
    np.testing.assert_allclose(h.drones[middle], closed.drones[middle], atol=1e-12)
    np.testing.assert_allclose(h.cable_forces[middle], closed.cable_forces[middle], atol=1e-12)


@given(seeds, st.integers(2, 8), st.floats(-3.0, 3.0))
@settings(max_examples=12)
def test_spread_chains_move_turn_and_reverse_with_their_arc(
    seed: int, n: int, angle: float
) -> None:
    outline = random_outline(seed, n, "open")
    length = outline.edge_lengths + np.random.default_rng(seed).uniform(0.8, 1.0, n)
    first = Hitch.spread(Team(n, length, topology="open"), outline)
    moved = Hitch.spread(
        Team(n, length, topology="open"), outline.rotated(angle).translated([1.0, 2.0])
    )
    np.testing.assert_allclose(moved.q_legs, first.q_legs, atol=1e-3)
    # The mirror image runs the other way: cable k becomes n - 1 - k, and q becomes r.
    mirrored = Hitch.spread(Team(n, length[::-1], topology="open"), outline.mirrored())
    np.testing.assert_allclose(mirrored.legs, first.legs[::-1, ::-1], atol=1e-3)
    swapped = first.drones.reshape(n, 2, 3)[::-1, ::-1].reshape(-1, 3) * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(mirrored.drones, swapped, atol=1e-3)


def test_spread_slides_the_free_legs_only() -> None:
    """A sharp clasp: balanced legs would stand too close, as in the paper's triangle."""
    team = Team(4, [2.0, 2.4, 2.4, 2.1], topology="open")
    points = [[0.45, 1.7], [0.4, 0.5], [0.0, -1.0], [-0.4, 0.5], [-0.45, 1.7]]
    near = Hitch.balanced(team, points)
    far = Hitch.spread(team, points)

    def closest(h: Hitch) -> float:
        i, j = np.triu_indices(8, 1)
        return float(np.min(np.linalg.norm(h.drones[i] - h.drones[j], axis=1))) / 0.24

    assert closest(near) < 1.5
    assert closest(far) > closest(near)
    np.testing.assert_array_equal(far.legs[[0, 3]], near.legs[[0, 3]])


def test_a_leg_at_a_chains_end_is_no_choice() -> None:
    team = Team(2, [2.0, 2.2], topology="open", tension=[0.4, 0.45])
    points = [[-0.6, -0.3], [0.5, 0.5], [1.7, -0.3]]
    slack = 2.2 - math.hypot(1.2, 0.8)
    h = Hitch(team, points, 1.2, [0.0, round(slack, 5)])  # to within 1e-4 of the cable: as meant
    assert h.q_legs[1] == pytest.approx(slack, abs=1e-15)
    with pytest.raises(InfeasibleError, match=r"above the limit of 0 m at q0; q0 stands at the ch"):
        Hitch(team, points, 1.2, [0.1, slack])
    with pytest.raises(InfeasibleError, match=r"at q1; r1 stands at the chain's end, .* 0\.75777"):
        Hitch(team, points, 1.2, [0.0, slack - 0.01])


def test_outlines_of_the_other_topology_or_count_are_refused() -> None:
    points = [[-0.6, -0.3], [0.5, 0.5], [1.7, -0.3]]
    with pytest.raises(InputError, match="a ConvexArc, the team being open"):
        Hitch.balanced(Team(2, 2.2, topology="open"), ConvexPolygon(points))
    with pytest.raises(InputError, match="a ConvexPolygon, the team being closed"):
        Hitch.balanced(Team(3, 2.2), ConvexArc(points))
    with pytest.raises(InputError, match="4 points, one more than robots"):
        Hitch.balanced(Team(3, 2.2, topology="open"), points)
    with pytest.raises(InputError, match="at least 2"):
        Team(1, 2.2, topology="open")


def test_a_chain_too_near_itself_is_shared_as_well_as_it_goes() -> None:
    """No margin can be had where the ends themselves stand too close: the rest is still shared."""
    team = Team(4, 2.4, topology="open")
    points = [[0.0, 0.0], [-0.4, 1.2], [0.6, 1.9], [1.5, 1.1], [0.2, -0.02]]
    h = Hitch.spread(team, points, separation=Separation(radius=0.12))
    assert np.linalg.norm(h.drones[0] - h.drones[-1]) < 0.24
    assert np.min(h.legs[h.team.layout.has_leg]) >= 0.15
