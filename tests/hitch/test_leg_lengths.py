"""Leg lengths, against a search over a grid of all slack splits, and the rows of their program."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt import Arena, Hitch, Limits, Separation, Team
from hitchopt.geometry import regular_polygon
from hitchopt.hitch.leg_program import (
    CABLE,
    CROSSING,
    SEPARATION,
    Parts,
    QuadraticProgram,
    solve_qp,
)
from problems.random_morph import random_convex_polygon

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])


def margins(team: Team, points: np.ndarray, q_legs: np.ndarray) -> np.ndarray:
    """Smallest distance over its limit of leg lengths (m, n), written out pair by pair."""
    n = len(points)
    following = np.roll(points, -1, axis=0)
    u = following - points
    edge = np.linalg.norm(u, axis=1)
    u /= edge[:, None]
    r_legs = team.cable_length - edge - q_legs
    q = points + q_legs[..., None] * np.roll(u, 1, axis=0)
    r = following - r_legs[..., None] * np.roll(u, -1, axis=0)
    drones = {**{f"q{k}": q[:, k] for k in range(n)}, **{f"r{k}": r[:, k] for k in range(n)}}
    smallest = np.full(len(q_legs), np.inf)
    names = list(drones)
    for i, a in enumerate(names):
        for b in names[:i]:
            apart = np.linalg.norm(drones[a] - drones[b], axis=1) / 0.24
            smallest = np.minimum(smallest, apart)
        for k in range(n):
            own = int(a[1:]) == k
            parts = [(points[k] + 0 * q[:, k], following[k] + 0 * q[:, k])]
            if not own:
                parts += [(points[k] + 0 * q[:, k], q[:, k]), (following[k] + 0 * q[:, k], r[:, k])]
            for start, end in parts:
                along = end - start
                share = np.sum((drones[a] - start) * along, axis=1) / np.sum(along**2, axis=1)
                nearest = start + np.clip(share, 0.0, 1.0)[:, None] * along
                smallest = np.minimum(smallest, np.linalg.norm(drones[a] - nearest, axis=1) / 0.10)
    return smallest


@pytest.mark.parametrize("length", [2.0, 2.2, 2.4, 2.6])
def test_spread_is_the_nearest_to_balanced_of_all_on_a_grid(length: float) -> None:
    team = Team(3, length)
    hitch = Hitch.spread(team, TRIANGLE)
    slack = hitch.slack
    axes = [np.linspace(0.151, s - 0.151, 46) for s in slack]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    margin = margins(team, TRIANGLE, grid)
    deviation = np.sum((grid - 0.5 * slack) ** 2, axis=1)
    own = float(margins(team, TRIANGLE, hitch.q_legs[None])[0])
    if np.max(margin) >= 1.5:
        assert own >= 1.5
        best = float(np.min(deviation[margin >= 1.5]))
        assert float(np.sum((hitch.q_legs - 0.5 * slack) ** 2)) <= best + 1e-9
    else:
        assert own >= np.max(margin) - 1e-6
        assert own < 1.5


def test_spread_is_balanced_where_balanced_will_do() -> None:
    team = Team(6, 2.0)
    hexagon = regular_polygon(6, 1.3, 0.2).translated([3.0, -2.0])
    np.testing.assert_allclose(
        Hitch.spread(team, hexagon).q_legs, Hitch.balanced(team, hexagon).q_legs, atol=1e-9
    )


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(3, 8), st.floats(-3.0, 3.0), st.integers(0, 7))
@settings(max_examples=15)
def test_moving_turning_renumbering_and_mirroring_move_the_legs_along(
    seed: int, n: int, angle: float, shift: int
) -> None:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 1.0, rng)
    lengths = float(np.max(polygon.edge_lengths)) + rng.uniform(0.7, 0.9, n)
    first = Hitch.spread(Team(n, lengths), polygon)
    moved = Hitch.spread(Team(n, lengths), polygon.rotated(angle).translated([1.0, 2.0]))
    # The search may end before it has settled: up to 0.2 mm off have been seen.
    np.testing.assert_allclose(moved.q_legs, first.q_legs, atol=1e-3)
    renumbered = Hitch.spread(Team(n, np.roll(lengths, -shift)), polygon.renumbered(shift))
    np.testing.assert_allclose(renumbered.q_legs, np.roll(first.q_legs, -shift), atol=1e-3)
    # In the mirror image edge k becomes edge n-2-k, and q becomes r.
    order = (n - 2 - np.arange(n)) % n
    mirrored = Hitch.spread(Team(n, lengths[order]), polygon.mirrored())
    np.testing.assert_allclose(mirrored.q_legs, first.legs[order, 1], atol=1e-3)


def test_nearest_keeps_the_fractions_where_they_will_do_and_limits_where_not() -> None:
    team = Team(3, 2.4)
    limits, separation = Limits(), Separation()
    wide = [[0.0, -0.5], [-0.6, 0.5], [0.6, 0.5]]
    kept = Hitch.nearest(team, wide, 1.0, [0.4, 0.5, 0.6], limits=limits, separation=separation)
    np.testing.assert_allclose(kept.fractions, [0.4, 0.5, 0.6], atol=1e-9)
    moved = Hitch.nearest(
        team, TRIANGLE, 1.0, [0.5, 0.5, 0.5], limits=limits, separation=separation
    )
    margin = float(margins(team, TRIANGLE, moved.q_legs[None])[0])
    assert 1.0 <= margin < 1.01
    assert np.min(moved.legs) >= limits.leg


def test_an_arena_pushes_a_leg_back() -> None:
    team = Team(4, 2.4)
    square = regular_polygon(4, 1.2, 0.3)
    free = Hitch.balanced(team, square)
    reach = float(np.max(free.drones[:, 0]))
    arena = Arena([-9.0, -9.0, 0.0], [reach - 0.1, 9.0, 3.0])
    kept = Hitch.nearest(
        team, square, 1.0, free.fractions, limits=Limits(), separation=Separation(), arena=arena
    )
    assert np.max(kept.drones[:, 0]) <= reach - 0.1 + 1e-6
    assert np.max(np.abs(kept.q_legs - free.q_legs)) > 0.05


def test_an_arena_too_small_for_any_legs_still_gives_the_best_one() -> None:
    team = Team(3, 2.4)
    tight = Arena([-9.0, -9.0, 0.0], [9.0, 0.6, 3.0])
    hitch = Hitch.nearest(
        team, TRIANGLE, 1.0, [0.5] * 3, limits=Limits(), separation=Separation(), arena=tight
    )
    assert np.min(hitch.legs) >= 0.15
    assert float(margins(team, TRIANGLE, hitch.q_legs[None])[0]) >= 0.9


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_near_pairs_are_those_that_all_pairs_in_all_frames_show(topology: str) -> None:
    rng = np.random.default_rng(5)
    found = Parts.of(6, topology)
    middles = rng.normal(size=(1, len(found.nodes), 2)) + 0.3 * rng.normal(size=(7, 1, 2))
    middles += 0.1 * rng.normal(size=(7, len(found.nodes), 2)) + [3.0, -2.0]
    sizes = rng.uniform(0.0, 0.3, middles.shape)
    limits = np.array([0.24, 0.1, 0.0])  # crossings without a limit
    near = found.near(middles - sizes, middles + sizes, limits, 0.4)
    i, j = np.triu_indices(len(found.nodes), 1)
    gaps = np.abs(middles[:, i] - middles[:, j]) - sizes[:, i] - sizes[:, j]
    kind = found.kind(i, j)
    close = np.linalg.norm(np.maximum(gaps, 0.0), axis=-1) <= 0.4
    frame, pair = np.nonzero(close & ((kind == SEPARATION) | (kind == CABLE)))
    expected = zip(frame, i[pair], j[pair], kind[pair], strict=True)
    assert sorted(zip(*near, strict=True)) == sorted(expected)
    assert 100 < len(frame) < 7 * len(i) / 2


@pytest.mark.parametrize("n", [3, 4, 7])
def test_kinds_of_pairs_are_those_of_the_definition(n: int) -> None:
    """By names of parts and sets of clasps, not by indices."""
    bodies: list[tuple[str, int, set[int]]] = [
        *((end, k, set()) for k in range(n) for end in "qr"),
        *(
            part
            for k in range(n)
            for part in (
                ("q-leg", k, {k}),
                ("edge", k, {k, (k + 1) % n}),
                ("r-leg", k, {(k + 1) % n}),
            )
        ),
    ]
    listed = Parts.of(n)
    i, j = np.triu_indices(len(bodies), 1)
    found = listed.kind(i, j)
    for a, b, kind in zip(i, j, found, strict=True):
        (first, k, clasps), (second, m, others) = bodies[a], bodies[b]
        if first in "qr" and second in "qr":
            wanted = SEPARATION
        elif first in "qr":
            wanted = CABLE if k != m or second == "edge" else -1
        else:
            wanted = CROSSING if not clasps & others else -1
        assert kind == wanted, (bodies[a], bodies[b])


def test_rows_of_programs_may_be_stored_in_any_order_and_hold_zeros() -> None:
    """The point nearest to (3, 2, 1) with ``x0 + 2 x1 <= 4`` and ``x2 >= 2`` is (2.4, 0.8, 2)."""
    data, rows = np.array([1.0, 0.0, 0.0, 2.0, 1.0]), np.array([0, 1, 1, 0, 1])
    A = sp.csc_array((data, rows, np.array([0, 2, 4, 5])), shape=(2, 3))
    assert not A.has_sorted_indices
    q, bounds = np.array([-3.0, -2.0, -1.0]), (np.array([-np.inf, 2.0]), np.array([4.0, np.inf]))
    x = solve_qp(QuadraticProgram(sp.csc_array(np.eye(3)), q, A, *bounds))
    assert x is not None
    assert x == pytest.approx([2.4, 0.8, 2.0], abs=1e-6)
