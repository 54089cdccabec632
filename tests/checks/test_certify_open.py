"""Certificates of open chains: sound and tight against brute force; what only they can break."""

from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import with_drones
from certificate_sampling import sampled
from open_chain_cases import bent, chain_motion, random_chain

from hitchopt.checks import certify
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Arena, Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial


def check_against_samples(motion: Motion, count: int) -> None:
    """No sample may beat a worst, and a fine sampling has to come near to it."""
    certificate = certify(motion)
    samples = sampled(motion, np.linspace(0.0, motion.duration, count))
    limit = dict(zip(motion.team.drone_names, motion.team.max_thrust, strict=True))
    names = {check.name for check in certificate.checks if check.limit is not None}
    assert set(samples) | {"continuity", "tension"} == names
    for name, sample in samples.items():
        check = certificate[name]
        worst = check.bound
        if name == "thrust":
            worst /= limit[check.where[0]]
        if name == "crossing" and motion.team.robots == 2:
            assert (check.where, check.holds) == ((), True)
            continue
        if check.sense == "min":
            assert worst <= sample, name
        else:
            assert worst >= sample, name
        assert worst == pytest.approx(sample, rel=2e-3, abs=1e-5), name


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_worsts_hold_for_all_samples_and_are_tight(n: int) -> None:
    check_against_samples(random_chain(n, 40 + n), 2001)


def test_the_first_and_the_last_edge_come_close() -> None:
    """A chain curled up nearly to a square: its end points at its first edge."""
    team = Team(4, [3.0, 2.1, 2.2, 2.4], topology="open", cable_density=0.004)
    start = bent([100.0, 15.0, -70.0, -165.0], [2.0, 1.3, 1.1, 0.9])
    end = bent([100.0, 15.0, -70.0, -163.0], [2.0, 1.3, 1.1, 1.1])
    arena = Arena([-9.0, -9.0, 0.1], [9.0, 9.0, 2.9])
    motion = chain_motion(team, start, end, [0.0, 0.3, 0.4, 0.0], arena=arena)
    check_against_samples(motion, 2001)
    certificate = certify(motion)
    assert certificate["crossing"].where == ("edge 0", "edge 3")


@pytest.mark.parametrize(("n", "seed"), [(2, 1), (3, 2), (5, 3)])
def test_worsts_hold_for_plans_that_are_wrong_as_well(n: int, seed: int) -> None:
    """Drones off their places by centimetres, those at the ends included."""
    motion = random_chain(n, seed)
    rng = np.random.default_rng(seed)
    shape = motion.drones.coefficients.shape
    wrong = with_drones(motion, motion.drones.coefficients + 0.02 * rng.normal(size=shape))
    certificate = certify(wrong)
    breaks = wrong.drones.breaks[1:]
    times = [np.linspace(0.0, wrong.duration, 4001), breaks - 1e-12]  # it jumps at the joints
    samples = sampled(wrong, np.concatenate(times))
    assert not certificate["cable_length"].holds
    for name in ("cable_length", "equilibrium", "separation", "cable_clearance", "legs", "tilt"):
        check = certificate[name]
        sample = samples[name]
        assert check.bound <= sample if check.sense == "min" else check.bound >= sample, name
        assert check.worst == pytest.approx(sample, rel=0.01, abs=1e-4), name


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
