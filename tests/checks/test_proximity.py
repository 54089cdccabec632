"""The spatial index: it finds what looking at all pairs finds, whatever moves and however far."""

import math

import numpy as np
import pytest
from certificate_cases import moving, smooth_step
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.checks import distances
from hitchopt.checks.clearance import CABLE_CLEARANCE
from hitchopt.checks.distances import CROSSING, SEPARATION, Moving, gap, near, smallest
from hitchopt.geometry import regular_polygon
from hitchopt.geometry.broadphase import Pairs
from hitchopt.hitch import Team
from hitchopt.trajectory.search import worst

FAR = 10**12


@pytest.mark.slow
@settings(max_examples=15)
@given(
    seed=st.integers(0, 10_000),
    ends=st.sampled_from([1, 2]),
    speed=st.floats(0.0, 30.0),
    pieces=st.sampled_from([2, 13]),
)
def test_with_and_without_the_index_the_distance_is_the_same(
    seed: int, ends: int, speed: float, pieces: int
) -> None:
    """Bodies on curves of their own, all of them drifting along as well."""
    rng = np.random.default_rng(seed)
    breaks = np.cumsum(rng.uniform(0.1, 1.0, pieces + 1))
    drift = rng.uniform(-100.0, 100.0, (pieces, 1, 1, 3, 4))
    corners = rng.uniform(-30.0, 30.0, (1, 70, 1, 3, 1)) + rng.uniform(
        -1.0, 1.0, (pieces, 70, ends, 3, 4)
    )
    first = corners + drift + speed * rng.uniform(-0.1, 0.1, (pieces, 70, 1, 3, 4))
    other = rng.uniform(-30.0, 30.0, (1, 50, 1, 3, 1))
    second = other + drift + rng.uniform(-2.0, 2.0, (pieces, 50, 2, 3, 4))
    for group in (None, second):
        bodies = Moving(breaks, first, group)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(distances, "FEW", 0)
            indexed = smallest(bodies)
            patch.setattr(distances, "FEW", FAR)
            paired = smallest(bodies)
            plain = worst(near(bodies, lambda: math.inf), gap, "min")
        assert paired.worst == pytest.approx(plain.worst, rel=2e-4)
        assert paired.item == plain.item or abs(paired.value - plain.value) < 1e-3
        assert indexed.worst == pytest.approx(plain.worst, rel=2e-4, abs=1e-6)
        assert indexed.item == plain.item or abs(indexed.value - plain.value) < 1e-3


def test_spans_cover_all_of_the_time_and_are_cut_where_much_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A lattice whose spacing is 2 m at rest, in which one piece shakes all bodies by 1 km."""
    monkeypatch.setattr(distances, "FEW", 0)
    lattice = np.stack(np.meshgrid(*[2.0 * np.arange(6)] * 3), axis=-1).reshape(-1, 3)
    corners = np.repeat(lattice[None, :, None, :, None], 20, axis=0).repeat(2, axis=-1)
    corners[12] += np.random.default_rng(0).uniform(-500.0, 500.0, (len(lattice), 1, 3, 1))
    corners[17, 5, 0, 0] += 1.5  # the one pair that is nearer
    bodies = Moving(np.arange(21.0), corners)
    found = smallest(bodies)
    assert found.worst == pytest.approx(0.5, rel=1e-3)
    assert 17.0 <= found.time <= 18.0
    close = [spans for spans in near(bodies, lambda: found.value) if not spans.points]
    assert sum(len(spans) for spans in close) < 20 * len(lattice)


def test_the_margin_is_taken_off_and_no_distance_is_negative() -> None:
    breaks = np.array([0.0, 1.0])
    corners = np.zeros((1, 2, 1, 3, 1))
    corners[0, 1, 0, 1, 0] = 0.5
    assert smallest(Moving(breaks, corners, margin=0.1)).worst == pytest.approx(0.4)
    assert smallest(Moving(breaks, corners, margin=0.7)).worst == 0.0


@pytest.mark.slow
def test_bodies_that_fly_across_each_other_within_one_piece() -> None:
    """Slow spacing against fast motion: 60 bodies of 1 m spacing crossing 60 others in 1 s."""
    rng = np.random.default_rng(3)
    breaks = np.array([0.0, 1.0])
    grid = np.arange(60.0)
    start, end = np.zeros((60, 3)), np.zeros((60, 3))
    start[:, 0], end[:, 0] = grid, grid + 40.0
    height = rng.uniform(0.2, 0.6, 60)
    against = np.column_stack([grid[::-1], np.full(60, 0.05), height])
    paths = np.concatenate(
        [np.stack([start, end], axis=-1), np.stack([against, against - [40.0, 0.0, 0.0]], axis=-1)]
    )
    found = smallest(Moving(breaks, paths[None, :, None]))
    times = np.linspace(0.0, 1.0, 8001)[:, None, None]
    a, b = paths[:60], paths[60:]
    a = a[..., 0] + times * (a[..., 1] - a[..., 0])
    b = b[..., 0] + times * (b[..., 1] - b[..., 0])
    best = min(float(np.min(np.linalg.norm(a - b[:, k : k + 1], axis=-1))) for k in range(60))
    assert found.worst <= best
    assert found.worst == pytest.approx(best, rel=5e-3)  # samples are 1 cm apart


def test_listed_pairs_grow_in_step_with_the_drones(monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[int] = []
    boxes = Moving.gaps

    def counted(bodies: Moving, pairs: Pairs) -> NDArray[np.float64]:
        listed.append(len(pairs))
        return boxes(bodies, pairs)

    monkeypatch.setattr(Moving, "gaps", counted)

    def count(n: int) -> int:
        base = regular_polygon(n, 1.3).vertices  # where all neighbours are equally near
        across = np.array([3.0, 1.5])
        motion = moving(
            Team(n, 2.0),
            lambda t: base + smooth_step(t / 4.0)[:, None, None] * across,
            np.full(n, 0.3),
            pieces=4,
        )
        listed.clear()
        for rule in (SEPARATION, CABLE_CLEARANCE, CROSSING):
            rule.check(motion)
        return sum(listed)

    few, many = count(100), count(800)
    assert few >= 4 * 100  # at least one pair a robot and piece: else nothing was looked at
    assert many < 10 * few  # all pairs would be 64 times as many
