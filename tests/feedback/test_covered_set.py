"""Offsets of the covered set keep all distances, by points on straight cables at many times."""

from __future__ import annotations

from functools import cache

import numpy as np

import hitchopt as ho
from hitchopt.feedback.covered_set import CoveredSet, HalfSpaces, cell_breaks, covered_set
from hitchopt.values import Array

RESERVE = 0.005
ALONG = np.linspace(0.0, 1.0, 41)[:, None]


@cache
def plan_of() -> ho.Plan:
    """An acute triangle off the origin whose vertex moves."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[1.0, 1.0], [0.6, 2.5], [1.4, 2.5]], 1.0)
    return ho.move_vertex(start, 0, by=[0.05, 0.5])


@cache
def set_of() -> CoveredSet:
    motion = plan_of().motion
    return covered_set(motion, cell_breaks(motion), RESERVE)


def cell(covered: CoveredSet, index: int) -> HalfSpaces:
    found = covered.cells[index]
    assert found is not None
    return found


def distances(drones: Array, vertices: Array) -> dict[str, float]:
    """The smallest distances of a triangle's hitch, cables being straight."""
    n = len(vertices)
    parts = []
    for k in range(n):
        before, after = vertices[k], vertices[(k + 1) % n]
        ends = [(before, drones[2 * k]), (before, after), (after, drones[2 * k + 1])]
        touched = [{k}, {k, (k + 1) % n}, {(k + 1) % n}]
        parts += [
            (k, kind, a + ALONG * (b - a), points)
            for kind, ((a, b), points) in enumerate(zip(ends, touched, strict=True))
        ]
    apart = drones[:, None] - drones
    level = np.sum(apart[..., :2] ** 2, axis=-1) / 0.24**2
    ratio = np.sqrt(level + apart[..., 2] ** 2 / 0.6**2) + 9.0 * np.eye(len(drones))
    foreign = [
        np.linalg.norm(line - drones[i], axis=-1).min()
        for i in range(len(drones))
        for k, kind, line, _ in parts
        if i // 2 != k or kind == 1
    ]
    crossing = [
        np.linalg.norm(a[2][:, None] - b[2], axis=-1).min()
        for i, a in enumerate(parts)
        for b in parts[i + 1 :]
        if not a[3] & b[3]
    ]
    anchors = [p for k in range(n) for p in (k, (k + 1) % n)]
    legs = np.linalg.norm(drones - vertices[anchors], axis=-1)
    return {
        "separation": float(np.min(ratio)),
        "cable": float(np.min(foreign)),
        "crossing": float(np.min(crossing, initial=9.0)),
        "leg": float(np.min(legs)),
    }


def test_every_distance_is_kept_at_every_time_of_a_cell() -> None:
    plan, covered = plan_of(), set_of()
    rng = np.random.default_rng(3)
    need = plan.motion.requirements
    limits = {"separation": 1.0, "cable": need.separation.cable, "leg": need.limits.leg}
    limits["crossing"] = need.separation.crossing
    tightest = np.inf
    for index in range(len(covered.cells)):
        for _ in range(12):
            asked = rng.normal(0.0, 0.08, (6, 3)) + rng.normal(0.0, 0.1, 3)
            offsets = cell(covered, index).within(asked)
            time = rng.uniform(covered.breaks[index], covered.breaks[index + 1])
            states = plan.at(time)
            away = rng.normal(0.0, 1.0, (9, 3))
            away *= RESERVE / np.linalg.norm(away, axis=-1, keepdims=True)
            common = offsets.mean(axis=0)
            found = distances(
                states.positions + offsets + away[:6], states.vertices + common + away[6:]
            )
            for name, limit in limits.items():
                assert found[name] >= limit - 1e-9, name
            tightest = min(tightest, found["cable"] - limits["cable"])
    assert tightest < 0.05  # the set reaches far


def test_what_is_within_stays_and_a_common_shift_is_free() -> None:
    rng = np.random.default_rng(5)
    for index in range(len(set_of().cells)):
        half_spaces = cell(set_of(), index)
        small = rng.normal(0.0, 0.002, (6, 3))
        np.testing.assert_allclose(half_spaces.within(small), small, atol=1e-12)
        asked, shift = rng.normal(0.0, 0.08, (6, 3)), np.array([0.05, -0.1, 0.12])
        asked -= asked.mean(axis=0)
        one, other = half_spaces.within(asked), half_spaces.within(asked + shift)
        np.testing.assert_allclose(other, one + shift, atol=1e-12)
        np.testing.assert_allclose(half_spaces.within(one), one, atol=1e-9)


def test_the_arena_limits_the_common_shift() -> None:
    motion = plan_of().motion
    arena = ho.Arena([-4, -4, 0], [4, 4, 1.3])
    plan = ho.hold(plan_of().end, 1.0, arena=arena)
    covered = covered_set(plan.motion, cell_breaks(plan.motion), RESERVE)
    risen = cell(covered, 0).within(np.tile([0.0, 0.0, 0.3], (6, 1)))
    assert np.max(risen[:, 2]) <= 0.3 - RESERVE
    assert motion.requirements.arena is None
