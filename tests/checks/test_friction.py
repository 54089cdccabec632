"""What friction may do to legs' pulls, held against samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.values import Array
from tests.helpers.by_hand import Samples, assert_sound, sampled, slides
from tests.helpers.leaning import leaning
from tests.helpers.motions import SQUARE, altered, plus, row

SLIP = 0.2  # Logarithm of the largest ratio of pulls and tensions
FORCES = frozenset({"equilibrium", "tilt", "thrust"})


def team(friction: float) -> Team:
    tension = [0.5, 0.45, 0.55, 0.5]
    return Team(4, [2.9, 2.8, 2.7, 3.0], tension=tension, cable_friction=friction)


def moved(friction: float) -> Motion:
    start = ho.Hitch.spread(team(friction), SQUARE, altitude=1.2)
    return ho.solve(start, ho.MoveVertex(0, by=[0.25, 0.1], duration=4.0, settle=False)).motion


@pytest.fixture(scope="module")
def leaned() -> Motion:
    return leaning(moved(0.2), SLIP)


def at(motion: Motion, count: int = 4_001) -> tuple[Array, Array, Array]:
    """Return times, ratios of pulls and tensions, and their largest ratios with friction."""
    t = np.linspace(0.0, motion.duration, count)
    return t, *slides(Samples(motion, t))


def test_samples_never_exceed_bounds(leaned: Motion) -> None:
    assert certify(leaned).certified
    assert_sound(leaned, 4_001, 1e-3, 1e-6, FORCES)
    _, ratio, most = at(leaned)
    assert np.all((ratio <= most) & (ratio >= 1.0 / most))
    assert np.ptp(ratio) > 0.05  # there is something to hold against it


def test_legs_pull_as_their_cables_without_friction(leaned: Motion) -> None:
    plain = moved(0.0)
    assert not plain.leg_tensions_differ
    slack = plain.replaced(tensions=plain.tensions.replaced(0.9 * plain.tensions.coefficients))
    assert not slack.leg_tensions_differ
    assert not row(replace(leaned, team=team(0.0)), "equilibrium").holds


def swung(seed: int, least: float, most: float) -> Callable[[Array], None]:
    """Let pulls oscillate between breaks, with continuous joints."""

    def change(c: Array) -> None:
        swing = np.random.default_rng(seed).uniform(least, most, c.shape)
        swing[..., [0, -1]] = 1.0
        c *= swing

    return change


SWINGS = {"more": (0.9, 1.4), "less": (0.6, 1.05), "both": (0.5, 1.5)}


@pytest.mark.parametrize("case", [0.0, 0.02, 0.05, *SWINGS])
def test_pulls_beyond_friction_are_residuals(leaned: Motion, case: float | str) -> None:
    """With less friction than planned, and with infeasible pulls."""
    motion = replace(leaned, team=team(0.04 if isinstance(case, str) else case))
    if isinstance(case, str):
        finer = {part: getattr(leaned, part).elevated(7) for part in ("leg_tensions", "tensions")}
        motion = motion.replaced(**finer)
        motion = altered(motion, "leg_tensions", swung(1, *SWINGS[case]))
        motion = altered(motion, "tensions", swung(2, 0.97, 1.03))
    assert_sound(motion, 6_001, 1e-3, 1e-6, frozenset({"equilibrium"}))
    result = row(motion, "equilibrium")
    assert not result.holds
    if case == 0.0:
        t, ratio, most = at(motion)
        beyond = np.maximum(ratio - most, 1.0 / most - ratio)
        when, drone = np.unravel_index(np.argmax(beyond), beyond.shape)
        assert result.where == (f"p{(drone // 2 + drone % 2) % 4}",)
        assert result.time == pytest.approx(t[when], abs=0.05)


def test_residuals_are_relative_to_the_weaker_edge(leaned: Motion) -> None:
    """Legs' pulls may be larger than that of a weak edge."""
    less = plus((slice(None), 1), -0.9 * leaned.tensions.coefficients[:, 1])
    assert_sound(altered(leaned, "tensions", less), 4_001, 1e-3, 0.0, frozenset({"equilibrium"}))


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_ratios_of_pulls_at_zero_tension_are_limits(leaned: Motion, factor: float) -> None:
    rising = np.linspace(0.0, 0.5, leaned.drones.pieces + 1)
    c = np.repeat(np.stack([rising[:-1], rising[1:]], axis=-1)[:, None], 4, axis=1)
    motion = altered(leaned, "tensions", lambda _: c)
    pulls = factor * np.repeat(c[:, :, None], 2, axis=2)
    motion = altered(motion, "leg_tensions", lambda _: pulls)
    times, only = np.linspace(1e-3, leaned.duration, 4_001), {"equilibrium"}
    worst = sampled(motion, times, only)["equilibrium"]
    assert row(motion, "equilibrium").worst == pytest.approx(worst, rel=2e-3)


def test_legs_may_pull_within_friction_of_the_range(leaned: Motion) -> None:
    _, _, most = at(leaned)
    T = np.repeat(leaned.team.tension, 2)
    for factor in (1.6, 0.6):
        changed = altered(leaned, "leg_tensions", lambda c, f=factor: f * c)  # type: ignore[misc]
        pulls = changed.pulls.at(np.linspace(0.0, leaned.duration, 4_001)).reshape(most.shape)
        worst = float(np.max(np.maximum(pulls - T * most, T / most - pulls)))
        result = row(changed, "tension")
        assert 0.01 < worst <= result.worst <= worst * 1.001 + 1e-6
        assert result.where[0] in leaned.team.drone_names
    assert row(replace(changed, team=team(1.0)), "tension").holds


def test_friction_has_no_effect_at_a_chains_ends() -> None:
    chain = Team(3, 2.4, topology="open", tension=0.5, cable_friction=0.1)
    points = [[-1.5, -0.4], [-0.6, 0.2], [0.6, 0.2], [1.5, -0.4]]
    start = ho.Hitch.spread(chain, points, altitude=1.0)
    move = ho.MoveVertex(1, by=[0.0, -0.15], duration=4.0, settle=False)
    motion = leaning(ho.solve(start, move).motion, 0.1)
    assert motion.leg_tensions_differ
    assert row(motion, "equilibrium").holds
    for factor, (cable, end, point) in product((0.0, 0.98, 1.02), ((0, 0, 0), (2, 1, 3))):
        pulls = motion.leg_tensions.coefficients[:, cable, end]
        harder = plus((slice(None), cable, end), (factor - 1.0) * pulls)
        result = row(altered(motion, "leg_tensions", harder), "equilibrium")
        assert not result.holds
        assert result.worst == pytest.approx(abs(1.0 - factor), rel=1e-3)
        assert result.where == (f"p{point}",)
