"""No sample beats a bound, and bounds are tight: one table of motions, every check of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import loaded_motion, random_motion, wild_motion, with_drones
from certificate_sampling import sampled, sampled_free
from free_cases import free_motion, random_flight
from open_chain_cases import bent, chain_motion, random_chain

from hitchopt.checks import certify
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Arena, Limits
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

ARENA = Arena([-40.0, -50.0, -1.0], [45.0, 40.0, 3.0])
TURNING = Limits(body_rate=1.0)
UNSAMPLED = {"continuity", "tension", "duration", "interlacing"}
"""Checks against limits of which samples say nothing."""

HELD = {"equilibrium": 1.5e-3, "cable_length": 1e-6}
"""Bounds of hitches as planned: by laws, not only by samples."""


def assert_sound(
    motion: Motion, count: int, gap: float, least: float, only: frozenset[str] = frozenset()
) -> None:
    """No sample beats a bound; each is within ``gap`` of the worst, relative, or ``least``."""
    certificate = certify(motion)
    free = "interlacing" in {check.name for check in certificate.checks}
    before = motion.drones.breaks[1:] - 1e-12  # it may jump at joints
    times = np.concatenate([np.linspace(0.0, motion.duration, count), before])
    found = (sampled_free if free else sampled)(motion, times)
    names = {check.name for check in certificate.checks if check.limit is not None}
    assert names <= set(found) | UNSAMPLED
    ratios = motion.team.max_thrust
    for name in only or found:
        check, value = certificate[name], found[name]
        if np.isinf(value):  # a chain of two has no cables that could cross
            assert (check.worst, check.holds, check.where) == (None, True, ())
            continue
        worst = check.bound
        if name == "thrust":  # as a share of the largest
            worst /= ratios[motion.team.drone_names.index(check.where[0])]
        outside = value - worst if check.sense == "min" else worst - value
        slack = {"body_rate": 1e-7}.get(name, 1e-9 * free) * abs(value)
        assert outside >= -slack, f"{name}: {worst} is beaten by {value}"
        assert outside <= max(gap * abs(value), least), f"{name}: {worst} for {value}"


def hitch(rng: np.random.Generator) -> Motion:
    n, seed = int(rng.integers(3, 17)), int(rng.integers(10_000))
    return random_motion(n, seed, arena=ARENA, limits=TURNING)


def loaded(rng: np.random.Generator) -> Motion:
    return loaded_motion(
        int(rng.integers(10_000)), int(rng.integers(3, 8)), rng.choice([0.0, 0.01])
    )


def chain(rng: np.random.Generator) -> Motion:
    return random_chain(int(rng.integers(2, 9)), int(rng.integers(10_000)))


@pytest.mark.parametrize(
    ("make", "gap", "least"), [(hitch, 1e-2, 1e-6), (loaded, 1e-2, 2e-6), (chain, 2e-3, 1e-5)]
)
@pytest.mark.parametrize("seed", range(3))
def test_hitches(
    make: Callable[[np.random.Generator], Motion], gap: float, least: float, seed: int
) -> None:
    motion = make(np.random.default_rng(seed))
    assert_sound(motion, 2001 if motion.team.robots < 8 else 401, gap, least)
    for name, most in HELD.items():
        assert certify(motion)[name].bound < most


@pytest.mark.slow
def test_forty_unequal_robots() -> None:
    close = frozenset({"separation", "cable_clearance", "crossing"})
    assert_sound(random_motion(40, 21), 201, 1e-2, 0.0, close)


def test_the_first_and_the_last_edge_come_close() -> None:
    """A chain curled up nearly to a square: its end points at its first edge."""
    team = Team(4, [3.0, 2.1, 2.2, 2.4], topology="open", cable_density=0.004)
    start, end = (
        bent([100.0, 15.0, -70.0, turn], [2.0, 1.3, 1.1, last])
        for turn, last in ((-165.0, 0.9), (-163.0, 1.1))
    )
    arena = Arena([-9.0, -9.0, 0.1], [9.0, 9.0, 2.9])
    motion = chain_motion(team, start, end, [0.0, 0.3, 0.4, 0.0], arena=arena)
    assert_sound(motion, 2001, 2e-3, 1e-5)
    assert certify(motion)["crossing"].where == ("edge 0", "edge 3")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_polynomials_that_are_no_hitch_at_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, pieces, order = (int(rng.integers(*span)) for span in ((3, 7), (1, 4), (1, 9)))
    noise = 10.0 ** rng.uniform(-3.0, 0.5)
    motion = wild_motion(rng, n, pieces, order, noise, limits=TURNING, arena=ARENA)
    assert_sound(motion, 2001, 0.0, np.inf)


@pytest.mark.parametrize(("n", "seed"), [(2, 1), (3, 2), (5, 3)])
def test_chains_that_are_wrong(n: int, seed: int) -> None:
    """Drones off their places by centimetres, those at the ends included; they jump at joints."""
    motion = random_chain(n, seed)
    rng = np.random.default_rng(seed)
    off = 0.02 * rng.normal(size=motion.drones.coefficients.shape)
    wrong = with_drones(motion, motion.drones.coefficients + off)
    names = {"cable_length", "equilibrium", "separation", "cable_clearance", "legs", "tilt"}
    assert_sound(wrong, 4001, 1e-2, 1e-4, frozenset(names))
    assert not certify(wrong)["cable_length"].holds


CLOSE = frozenset({"cable_clearance", "crossing"})


@pytest.mark.parametrize("seed", range(2))
def test_free_cables(seed: int) -> None:
    team, drones = random_flight(seed)
    heavy = replace(team, cable_density=0.05)  # whose pull turns thrusts
    motion = free_motion(heavy, drones.stretched(20.0), limits=TURNING)
    assert_sound(motion, 401, 1.0, 6e-3, CLOSE)  # links of cables, and the search's tolerance
    others = frozenset({"separation", "span", "thrust", "tilt", "body_rate"})
    assert_sound(motion, 4001, 1e-2, 0.0, others)


@pytest.mark.parametrize("seed", range(2))
def test_the_ground_is_the_arenas_floor(seed: int) -> None:
    """Robots a long way apart, so that the ground is what is nearest."""
    team, drones = random_flight(seed, n=2)
    offset: Array = np.repeat([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]], 2, axis=0)
    apart = PiecewisePolynomial(drones.breaks, drones.coefficients + offset[..., None])
    for floor in (0.8, 0.0):
        arena = Arena([-50, -50, floor], [50, 50, 9]) if floor else None
        motion = free_motion(team, apart, arena=arena)
        assert_sound(motion, 1501, 0.0, 6e-3, frozenset({"cable_clearance"}))
        assert certify(motion)["cable_clearance"].where[0] == "ground"
