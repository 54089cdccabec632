"""The spatial index: it finds what looking at all pairs finds, whatever moves and however far."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from certificate_cases import fitted, moving, random_motion, smooth_step, still
from certificate_sampling import sampled, segment_to_segment
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.checks import cable_clearance, certify, crossing, separation
from hitchopt.checks.bounds import close_spans, proximity
from hitchopt.checks.bounds.moving_bodies import Bodies
from hitchopt.checks.bounds.proximity import smallest_distance
from hitchopt.geometry import regular_polygon
from hitchopt.geometry.broadphase import Pairs, close_pairs, few_close_pairs
from hitchopt.hitch import Team
from hitchopt.requirements import Separation

FAR = 10**12


def every(i: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.ones(len(i), dtype=np.bool_)


def all_of_them(
    a: np.ndarray, b: np.ndarray, pairs: Pairs, margin: float, _: object
) -> tuple[np.ndarray, np.ndarray]:
    """Every piece of every pair."""
    assert (len(a), margin) == (len(b), 0.0)
    piece, pair = np.divmod(np.arange(len(a) * len(pairs)), len(pairs))
    return piece, pair


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
    first = Bodies(corners + drift + speed * rng.uniform(-0.1, 0.1, (pieces, 70, 1, 3, 4)))
    other = rng.uniform(-30.0, 30.0, (1, 50, 1, 3, 1))
    second = Bodies(other + drift + rng.uniform(-2.0, 2.0, (pieces, 50, 2, 3, 4)))
    for group in (None, second):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(proximity, "FEW", 0)
            indexed = smallest_distance(breaks, first, group, every, 0.0)
            patch.setattr(proximity, "FEW", FAR)
            paired = smallest_distance(breaks, first, group, every, 0.0)
            patch.setattr(proximity, "_near", all_of_them)
            plain = smallest_distance(breaks, first, group, every, 0.0)
        assert paired.worst == pytest.approx(plain.worst, rel=2e-4)
        assert paired.item == plain.item or abs(paired.value - plain.value) < 1e-3
        assert indexed.worst == pytest.approx(plain.worst, rel=2e-4, abs=1e-6)
        assert indexed.item == plain.item or abs(indexed.value - plain.value) < 1e-3


def test_spans_cover_all_of_the_time_and_are_cut_where_much_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A lattice whose spacing is 2 m at rest, in which one piece shakes all bodies by 1 km."""
    monkeypatch.setattr(proximity, "FEW", 0)
    lattice = np.stack(np.meshgrid(*[2.0 * np.arange(6)] * 3), axis=-1).reshape(-1, 3)
    corners = np.repeat(lattice[None, :, None, :, None], 20, axis=0).repeat(2, axis=-1)
    corners[12] += np.random.default_rng(0).uniform(-500.0, 500.0, (len(lattice), 1, 3, 1))
    spans = []
    close = close_spans._close

    def counted(a: np.ndarray, *rest: Any) -> Pairs | None:
        pairs = close(a, *rest)
        if pairs is not None:
            spans.append((len(a), len(pairs)))
        return pairs

    monkeypatch.setattr(close_spans, "_close", counted)
    corners[17, 5, 0, 0] += 1.5  # the one pair that is nearer
    found = smallest_distance(np.arange(21.0), Bodies(corners), None, every, 0.0)
    assert found.worst == pytest.approx(0.5, rel=1e-3)
    assert 17.0 <= found.time <= 18.0
    assert sum(pieces for pieces, _ in spans) == 20
    assert max(pieces for pieces, _ in spans) > 1
    assert max(pairs for _, pairs in spans) < 20 * len(lattice)


def test_pairs_that_do_not_count_are_left_out() -> None:
    breaks = np.array([0.0, 1.0])
    x = np.arange(100.0) ** 1.1
    corners = np.zeros((1, 100, 1, 3, 1))
    corners[0, :, 0, 0, 0] = x
    found = smallest_distance(breaks, Bodies(corners), None, lambda i, j: np.abs(i - j) >= 3, 0.0)
    assert found.worst == pytest.approx(x[3] - x[0], rel=1e-9)
    assert divmod(found.item, 100) == (0, 3)


def test_the_margin_is_taken_off_and_no_distance_is_negative() -> None:
    breaks = np.array([0.0, 1.0])
    corners = np.zeros((1, 2, 1, 3, 1))
    corners[0, 1, 0, 1, 0] = 0.5
    assert smallest_distance(breaks, Bodies(corners), None, every, 0.1).worst == pytest.approx(0.4)
    assert smallest_distance(breaks, Bodies(corners), None, every, 0.7).worst == 0.0


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
    found = smallest_distance(breaks, Bodies(paths[None, :, None]), None, every, 0.0)
    times = np.linspace(0.0, 1.0, 8001)[:, None, None]
    a, b = paths[:60], paths[60:]
    a = a[..., 0] + times * (a[..., 1] - a[..., 0])
    b = b[..., 0] + times * (b[..., 1] - b[..., 0])
    best = min(float(np.min(np.linalg.norm(a - b[:, k : k + 1], axis=-1))) for k in range(60))
    assert found.worst <= best
    assert found.worst == pytest.approx(best, rel=5e-3)  # samples are 1 cm apart


def test_forty_unequal_robots_against_samples() -> None:
    motion = random_motion(40, 21)
    found = sampled(motion, np.linspace(0.0, 4.0, 201))
    certificate = certify(motion)
    for name in ("separation", "cable_clearance", "crossing"):
        assert found[name] * 0.99 <= certificate[name].bound <= found[name], name


def test_two_thousand_drones_at_rest_show_what_all_pairs_show() -> None:
    n, rng = 1000, np.random.default_rng(5)
    polygon = regular_polygon(n, 1.3, 0.3).translated([20.0, -10.0]).vertices
    q_legs = rng.uniform(0.25, 0.45, n)
    motion = still(Team(n, 2.0), polygon, q_legs, separation=Separation(cable=1e-3))
    certificate = certify(motion)
    x, p = motion.drones.at(0.0), motion.vertices.at(0.0)
    separation = min(
        float(np.min(np.linalg.norm((x[i] - x[i + 1 :]) / [0.24, 0.24, 0.6], axis=-1)))
        for i in range(2 * n - 1)
    )
    assert certificate["separation"].worst == pytest.approx(separation, rel=1e-6)
    following = np.roll(p, -1, axis=0)
    edge = following - p
    own = np.abs(np.cross(x[0::2] - p, edge)[:, 2]) / np.linalg.norm(edge, axis=1)
    other = np.abs(np.cross(x[1::2] - p, edge)[:, 2]) / np.linalg.norm(edge, axis=1)
    clearance = min(np.min(own), np.min(other))
    assert certificate["cable_clearance"].worst == pytest.approx(clearance, rel=1e-6)
    legs = segment_to_segment(p, x[0::2], following, x[1::2])
    assert certificate["crossing"].worst == pytest.approx(float(np.min(legs)), rel=1e-6)
    assert certificate.certified


def test_listed_pairs_grow_in_step_with_the_drones(monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[int] = []

    def counted(find: Callable[..., Pairs | None]) -> Callable[..., Pairs | None]:
        def found(*given: object) -> Pairs | None:
            pairs = find(*given)
            listed.append(0 if pairs is None else len(pairs))
            return pairs

        return found

    monkeypatch.setattr(close_spans, "close_pairs", counted(close_pairs))
    monkeypatch.setattr(close_spans, "few_close_pairs", counted(few_close_pairs))

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
        for looked_at in (separation, cable_clearance, crossing):
            looked_at.RULE.check(motion)
        return sum(listed)

    few, many = count(100), count(800)
    assert few >= 4 * 100  # at least one pair a robot and piece: else nothing was looked at
    assert many < 10 * few  # all pairs would be 64 times as many


def test_a_curved_path_between_two_posts() -> None:
    """A point on a circle of 1 m about a post, with another post outside: both distances known."""
    breaks = np.linspace(0.0, 1.0, 5)
    circle = fitted(
        breaks,
        lambda t: np.stack([np.cos(2 * math.pi * t), np.sin(2 * math.pi * t), 0 * t], axis=-1),
        9,
    )
    corners = np.zeros((4, 3, 1, 3, 10))
    corners[:, 0, 0] = circle.coefficients
    corners[:, 2, 0, 0] = 1.9
    found = smallest_distance(breaks, Bodies(corners), None, every, 0.0)
    assert found.worst == pytest.approx(0.9, rel=2e-4)
    near = smallest_distance(breaks, Bodies(corners[:, :2]), None, every, 0.0)
    assert near.worst == pytest.approx(1.0, rel=2e-4)
