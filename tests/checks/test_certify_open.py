"""Certificates of open chains: sound and tight against brute force; what only they can break."""

from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import with_drones
from open_chain_cases import bent, chain_motion, random_chain

from hitchopt.checks import certify
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial


def test_an_end_drone_off_its_point_breaks_the_cable_length_only_there() -> None:
    motion = random_chain(3, 7)
    off = motion.drones.coefficients.copy()
    off[:, 5, 2] += 0.003  # r2, upward: the edge is no longer than before
    check = certify(with_drones(motion, off))["cable_length"]
    assert check.where == ("cable 2",)
    assert not check.holds
    assert check.worst == pytest.approx(0.003 / motion.team.cable_length[2], rel=1e-3)


def test_the_stored_zero_is_checked() -> None:
    motion = random_chain(4, 9)
    legs = motion.legs.coefficients.copy()
    legs[:, 0, 0] = 0.01
    wrong = replace(motion, legs=PiecewisePolynomial(motion.legs.breaks, legs))
    check = certify(wrong)["cable_length"]
    assert (check.where, check.holds) == (("cable 0",), False)
    assert check.worst == pytest.approx(0.01 / motion.team.cable_length[0], rel=1e-6)


def still_chain(turn: float, n: int, lengths: object = 1.3) -> Motion:
    """A chain at rest whose every corner turns by ``turn`` [deg]; it may spiral."""
    points = bent(100.0 - turn * np.arange(n), np.broadcast_to(np.asarray(lengths), n))
    return spiral(points, points)


def spiral(start: np.ndarray, end: np.ndarray) -> Motion:
    """Points alone matter here: drones stand where a chain that is bent less has them."""
    n = len(start) - 1
    gentle = bent(100.0 - 20.0 * np.arange(n), np.full(n, 1.3))
    team = Team(n, 2.2, topology="open")
    motion = chain_motion(team, gentle, gentle, np.full(n, 0.4), order=3, separation=Separation())
    breaks = motion.vertices.breaks
    share = (breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(4) / 3.0) / breaks[-1]
    flat = start[:, :, None] + share[:, None, None] * (end - start)[:, :, None]
    level = np.full((*flat.shape[:2], 1, 4), 1.3)
    return replace(
        motion, vertices=PiecewisePolynomial(breaks, np.concatenate([flat, level], axis=2))
    )


@pytest.mark.parametrize(
    ("turn", "n", "worst", "where"),
    [
        (50.0, 4, 50.0, None),
        (85.0, 5, 20.0, ("p0", "p5")),
        (91.0, 5, -4.0, ("p0", "p5")),
        (119.0, 4, 3.0, ("p0", "p4")),
        (100.0, 9, -440.0, ("p0", "p9")),
        (-10.0, 4, -10.0, None),
    ],
)
def test_convexity_counts_all_turning(
    turn: float, n: int, worst: float, where: tuple[str, ...] | None
) -> None:
    check = certify(still_chain(turn, n))["convexity"]
    assert check.worst == pytest.approx(worst, abs=1e-4)
    assert check.bound <= worst
    assert check.holds == (worst > 0.0)
    assert where is None or check.where == where


def test_a_chain_that_curls_up_on_the_way_is_refused() -> None:
    """Every corner turns right at all times; only their sum passes 360°, and comes back."""
    lengths = np.array([1.3, 1.1, 1.0, 0.9, 1.2])
    straight = bent(100.0 - 84.0 * np.arange(5), lengths)
    curled = bent(100.0 - 96.0 * np.arange(5), lengths)
    motion = spiral(straight, curled)
    check = certify(motion)["convexity"]
    assert not check.holds
    assert check.where == ("p0", "p5")
    # By samples: 360° is passed inside the motion, all corners being convex.
    p = motion.vertices.at(np.linspace(0.0, motion.duration, 999))
    steps = np.diff(p[..., 0] + 1j * p[..., 1], axis=1)
    exterior = -np.degrees(np.angle(steps[:, 1:] / steps[:, :-1]))
    total = np.sum(exterior, axis=1)
    assert np.min(exterior) > 20.0
    assert total[0] < 360.0 < total[-1]
    within = spiral(straight, straight + 0.9 * _share_below(total) * (curled - straight))
    assert certify(within)["convexity"].holds


def _share_below(total: np.ndarray) -> float:
    return float(np.argmax(total > 360.0)) / len(total)
