"""Legs that lean against friction: what they leave as it is, how far they go, and laws."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.friction import FARTHEST, ROOM, Leaning, leaning

Array = NDArray[np.float64]

POLYGON = np.array([[2.0, 0.3], [1.2, -1.0], [0.1, -0.4], [0.5, 0.6]])
GOAL = np.array([[2.2, 0.4], [1.2, -1.0], [0.1, -0.4], [0.45, 0.75]])
LENGTHS, TENSIONS = [2.9, 2.8, 2.7, 3.0], [0.5, 0.45, 0.55, 0.5]


def rubbing(motion: Motion, friction: float) -> Motion:
    return replace(motion, team=replace(motion.team, cable_friction=friction))


def planned(polygon: Array = POLYGON, goal: Array = GOAL, seconds: float | None = 4.0) -> Motion:
    """A morph of cables without friction, by fractions that stay, so that laws are exact."""
    team = ho.Team(4, LENGTHS, tension=TENSIONS)
    start = ho.Hitch.balanced(team, polygon, altitude=1.2)
    motion = ho.morph(start, goal, legs="balanced", duration=seconds).motion
    assert isinstance(motion, Motion)
    return motion


def leaned(motion: Motion, friction: float = 0.1, share: float = 1.0) -> Leaning:
    found = leaning(rubbing(motion, friction), motion.requirements.limits, share, slower=True)
    assert found is not None
    return found


def sampled(motion: Motion) -> Array:
    return np.linspace(0.0, motion.duration, 201)


def leans(motion: Motion, plain: Motion, share_of_time: Array) -> Array:
    """(times, 2n) [rad] between the legs of two motions, at the same shares of their times."""
    ways = []
    for m in (motion, plain):
        t = share_of_time * m.duration
        way = m.drones.at(t) - m.vertices.at(t)[:, m.team.layout.anchors]
        ways.append(way / np.linalg.norm(way, axis=-1, keepdims=True))
    angles: Array = np.arccos(np.clip(np.sum(ways[0] * ways[1], axis=-1), -1.0, 1.0))
    return angles


def test_the_hitch_stays_as_it_is() -> None:
    plain = planned()
    motion = leaned(plain).motion
    t = sampled(plain)
    slow = motion.duration / plain.duration
    for name in ("vertices", "legs", "tensions"):
        np.testing.assert_allclose(
            getattr(motion, name).at(slow * t), getattr(plain, name).at(t), atol=1e-9
        )
    legs = motion.drones.at(t * slow) - motion.vertices.at(t * slow)[:, motion.team.layout.anchors]
    np.testing.assert_allclose(
        np.linalg.norm(legs, axis=-1), plain.legs.at(t).reshape(len(t), -1), atol=1e-6
    )


def test_drones_begin_and_end_at_rest_where_they_did() -> None:
    plain = planned(seconds=None)
    motion = leaned(plain).motion
    for derivative in range(3):
        for end in (0, -1):
            found, wanted = (m.drones.ends(derivative)[end][end] for m in (motion, plain))
            np.testing.assert_allclose(found, wanted if derivative == 0 else 0.0, atol=1e-7)
    pulls = motion.pulls.ends()
    for end in (0, -1):
        np.testing.assert_allclose(pulls[end][end], np.repeat(TENSIONS, 2), atol=1e-9)


@pytest.mark.parametrize("friction", [0.05, 0.3])
def test_legs_that_grow_pull_harder_and_all_by_no_more_than_friction(friction: float) -> None:
    plain = planned()
    motion = leaned(plain, friction).motion
    t = sampled(motion)
    inner = t[40:-40]
    rates = motion.legs.at(inner, 1).reshape(len(inner), -1)
    ratio = np.log(motion.pulls.at(inner) / np.repeat(motion.tensions.at(inner), 2, axis=1))
    sliding = np.abs(rates) > 0.3 * np.max(np.abs(rates))
    assert np.sum(sliding) > 100
    assert np.all(np.sign(rates[sliding]) == np.sign(ratio[sliding]))
    assert np.max(np.abs(ratio)) > 0.2 * friction
    assert np.max(np.abs(ratio)) < np.pi * friction


def test_one_cable_that_slides_alone_counts_on_all_that_it_wraps() -> None:
    """Of unequal tensions the weaker cable turns by more than the other one, by half of V each."""
    team = ho.Team(4, LENGTHS, tension=[0.5, 0.42, 0.58, 0.5], cable_friction=0.03)
    start = ho.Hitch.balanced(team, POLYGON, altitude=1.2)
    legs = start.legs[:, 0] + [0.0, 0.1, 0.0, 0.0]
    plain = ho.adjust(start, legs, duration=6.0).motion
    assert isinstance(plain, Motion)
    found = plain.leg_tensions
    assert found is not None
    ratio = np.log(found.at(3.0) / plain.tensions.at(3.0)[:, None])
    p, x = plain.vertices.at(3.0), start.drones
    for end, sign in ((0, 1.0), (1, -1.0)):  # both of cable 1, one let out, one drawn in
        arriving, leaving = p[1 + end] - x[2 + end], p[2 - end] - p[1 + end]
        cosine = arriving @ leaving / np.linalg.norm(arriving) / np.linalg.norm(leaving)
        alone = 0.03 * np.arccos(cosine) / 1.1  # a tenth of the largest speed counts as still
        assert ratio[1, end] == pytest.approx(sign * alone, rel=0.03)
    assert np.max(np.abs(ratio[[0, 2, 3]])) < 1e-9


@pytest.mark.parametrize("friction", [0.05, 2.0])
def test_no_leg_leans_farther_than_it_may_and_drones_keep_apart(friction: float) -> None:
    """At large friction both limits bind: a sharp vertex would lock."""
    plain = planned()
    found = leaned(plain, friction)
    s = np.linspace(0.0, 1.0, 401)
    angles = leans(found.motion, plain, s)
    assert np.max(angles) <= FARTHEST * 1.05
    assert found.turned == pytest.approx(np.max(angles), rel=0.02)
    layout, limits = plain.team.layout, plain.requirements.separation
    gaps = []
    for m in (found.motion, plain):
        x = m.drones.at(s * m.duration)
        pairs = x[:, 2 * layout.ahead] - x[:, 2 * layout.behind + 1]
        gaps.append(np.linalg.norm(pairs, axis=-1) / (2.0 * limits.radius))
    assert np.all(gaps[0] >= np.minimum(gaps[1], ROOM) - 0.01)


def test_it_leans_as_much_as_is_counted_on() -> None:
    plain = planned()
    turned = [leaned(plain, 0.04, share).turned for share in (0.25, 0.5, 1.0)]
    np.testing.assert_allclose(turned[1:], [2.0 * turned[0], 4.0 * turned[0]], rtol=0.1)
    np.testing.assert_allclose(leaned(plain, 0.02).turned, turned[1], rtol=1e-9)


def test_where_nothing_slides_nothing_leans() -> None:
    plain = planned(goal=POLYGON + 1e-9)
    assert leaning(rubbing(plain, 0.3), plain.requirements.limits, 1.0, slower=True) is None
    assert (
        leaning(rubbing(planned(), 1e-3), plain.requirements.limits, 1.0, slower=True) is None
    )  # too little
