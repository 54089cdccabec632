"""No sample beats a bound, and bounds are tight: one table of motions, every check of each."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from hitchopt.checks.hanging import chains
from hitchopt.errors import UnitWarning
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Arena, Limits, Prism, Separation
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from tests.helpers.by_hand import assert_sound, cable_points, point_to_segment
from tests.helpers.motions import (
    ARENA,
    SQUARE,
    added,
    altered,
    bent,
    chain_motion,
    free_motion,
    held_at,
    lines,
    loaded_motion,
    outlined,
    plus,
    random_chain,
    random_curves,
    random_flight,
    random_motion,
    row,
    single,
    still,
    triangle,
    wild_motion,
)

TURNING = Limits(body_rate=1.0)
HELD = {"equilibrium": 1.5e-3, "cable_length": 1e-6}
"""Bounds of hitches as planned: by laws, not only by samples."""

OUTLINE = np.array([[1.0, -0.5], [0.2, 0.4], [0.9, 1.3], [2.1, 0.6]])
PRISMS = (Prism(OUTLINE, 0.4, 1.7), Prism(OUTLINE + 3.0, -1.0, 0.2))


@dataclass(frozen=True)
class Case:
    """A motion for a seed, its samples, and the largest gap of bounds, relative or absolute."""

    make: Callable[[int], Motion]
    count: int = 1001
    gap: float = 1e-2
    least: float = 1e-6
    only: frozenset[str] = frozenset()
    seeds: int = 3
    slow: bool = False


def some(seed: int, least: int, most: int) -> tuple[int, int]:
    """Return a number of robots, and another seed."""
    rng = np.random.default_rng(seed)
    return int(rng.integers(least, most)), int(rng.integers(10_000))


def hitch(seed: int) -> Motion:
    return random_motion(*some(seed, 3, 9), arena=ARENA, limits=TURNING)


def loaded(seed: int) -> Motion:
    n, other = some(seed, 3, 8)
    return loaded_motion(other, n, 0.01 * (seed != 1))


def curled(_: int) -> Motion:
    """A chain curled up nearly to a square, with its end toward its first edge."""
    team = Team(4, [3.0, 2.1, 2.2, 2.4], topology="open", cable_density=0.004)
    start, end = (
        bent([100.0, 15.0, -70.0, turn], [2.0, 1.3, 1.1, last])
        for turn, last in ((-165.0, 0.9), (-163.0, 1.1))
    )
    arena = Arena([-9.0, -9.0, 0.1], [9.0, 9.0, 2.9])
    return chain_motion(team, start, end, [0.0, 0.3, 0.4, 0.0], arena=arena)


def wild(seed: int) -> Motion:
    """Random polynomials as a hitch."""
    rng = np.random.default_rng(seed)
    n, pieces, order = (int(rng.integers(*span)) for span in ((3, 7), (1, 4), (1, 9)))
    noise = 10.0 ** rng.uniform(-3.0, 0.5)
    return wild_motion(rng, n, pieces, order, noise, limits=TURNING, arena=ARENA)


def wrong_chain(seed: int) -> Motion:
    """Drones displaced by centimetres, also at the ends; they jump at joints."""
    motion = random_chain(2 + seed, seed)
    off = 0.02 * np.random.default_rng(seed).normal(size=motion.drones.coefficients.shape)
    return altered(motion, "drones", plus(..., off))


def free(seed: int, state: CableState) -> Motion:
    """Heavy cables that hang or lie on the ground; their pull turns thrusts."""
    team, drones = random_flight(seed)
    heavy = replace(team, cable_density=0.05)
    return free_motion(heavy, drones.stretched(20.0), state, limits=TURNING)


def apart(seed: int, floor: float) -> Motion:
    """Robots far apart, closest to the ground or the arena's floor."""
    team, drones = random_flight(seed, n=2)
    c = drones.coefficients.copy()
    c[:, 2:, 0] += 30.0
    arena = Arena([-50, -50, floor], [50, 50, 9]) if floor else None
    return free_motion(team, PiecewisePolynomial(drones.breaks, c), arena=arena)


def falling(seed: int) -> Motion:
    """A drone leans beyond the horizon."""
    path = np.zeros((1, 3, 4))
    path[0, 2] = -(2.5, 10.0)[seed] * np.array([0.0, 0.0, 1.0 / 3.0, 1.0])  # of t²
    path[0, :2] += np.array([[0.1], [-0.2]]) * np.array([0.0, 0.3, -0.2, 0.1])
    return added(held_at(triangle(), [0.0, 1.0]), 2, path)


def inward(_: int) -> Motion:
    """A vertex crosses the straight line between its neighbours."""
    end = SQUARE.copy()
    end[0] += 1.2 * (np.mean(SQUARE[[1, 3]], axis=0) - SQUARE[0])
    return outlined(still(Team(4, 2.9), SQUARE, [0.4] * 4), SQUARE, end)


def slackened(_: int) -> Motion:
    """A cable above the ground, taut except at two times."""
    wave = bernstein.interpolate(np.sin(2.0 * np.pi * bernstein.nodes(8)) ** 2)
    ends = np.array([[0, 0, 1.0], [1.195, 0, 1.0], [0, 9, 9], [1, 9, 9]])[..., None] + 0.0 * wave
    ends[0, 0] += 0.0085 * wave
    ends[1, 0] -= 0.0085 * wave
    drones = PiecewisePolynomial(np.array([0.0, 1.0]), ends[None])
    return without_own_cables(free_motion(Team(2, 1.2, topology="open"), drones))


def without_own_cables(motion: Motion) -> Motion:
    """Return the motion with a limit so large that no drone's own cable is long enough to count."""
    requirements = motion.requirements
    longest = float(max(motion.team.cable_length))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitWarning)  # far beyond usual distances
        separation = replace(requirements.separation, cable=longest)
    return replace(motion, requirements=replace(requirements, separation=separation))


def under(_: int) -> Motion:
    """A drone at rest below a deep hanging cable, and one above it, farther away."""
    places = [[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.5, 0.15, 1.7], [0.5, 0.3, 3.4]]
    at_rest = PiecewisePolynomial.constant(np.linspace(0.0, 1.0, 101), places)
    motion = free_motion(Team(2, [2.8, 1.9], topology="open"), at_rest)
    motion = replace(motion, phases=(motion.phases[0].retimed(0.0, 1.0),))
    return without_own_cables(motion)


def swarm(seed: int) -> Motion:
    curves = random_curves(9, seed, 0.6, (1.5, 0.5, 1.2))
    return single(curves, keep_out=PRISMS, separation=Separation(0.02, 0.05))


def crowd(_: int) -> Motion:
    """30 drones a metre apart fly across 30 others, the nearest ones last, in one piece."""
    rng, row = np.random.default_rng(3), np.arange(30.0)[:, None] * [1.0, 0.0, 0.0]
    against = row[::-1] + [0.0, 0.05, 0.0] + rng.uniform(0.2, 0.6, (30, 1)) * [0.0, 0.0, 1.0]
    start = np.concatenate([row, against])
    end = np.concatenate([row + [40.0, 0.0, 0.0], against * [1.0, 1.0, 0.5] - [40.0, 0.0, 0.0]])
    return lines(start, end + [70.0, -30.0, 20.0], separation=Separation(0.02, 0.02))


def lattice(_: int) -> Motion:
    """216 drones at rest 2 m apart, for a while shaken by 1 km, for another one a pair nearer."""
    each = np.stack(np.meshgrid(*[2.0 * np.arange(6)] * 3), axis=-1).reshape(-1, 3)
    c = np.repeat(each[None, :, :, None], 5, axis=0)
    c[2] += np.random.default_rng(0).uniform(-500.0, 500.0, (216, 3, 1))
    c[3, 5, 0] += 1.5
    curves = PiecewisePolynomial(np.arange(6.0), c)
    return single(curves, separation=Separation(0.1, 0.1))


CLOSE = frozenset({"cable_clearance", "crossing"})
NEAR = CLOSE | {"separation"}
FREE, GROUND, CLASPING = CableState.FREE, CableState.GROUND, CableState.CLASPING
CASES = {
    "hitch": Case(hitch, 601, 2e-3),
    "loaded hitch": Case(loaded, 2001, 5e-4, 2e-6),
    "chain": Case(lambda seed: random_chain(*some(seed, 2, 9)), gap=2e-3, least=1e-5),
    "curled chain": Case(curled, gap=2e-3, least=1e-5, seeds=1),
    "chain that is wrong": Case(
        wrong_chain,
        2001,
        least=1e-4,
        only=NEAR - {"crossing"} | {"cable_length", "equilibrium", "legs", "tilt"},
    ),
    "no hitch at all": Case(wild, gap=0.0, least=np.inf, seeds=6, slow=True),
    "forty robots": Case(lambda _: random_motion(40, 21), 201, 1e-2, 0.0, NEAR, 1, slow=True),
    # Links of cables, and the search's tolerance, are what bounds are off.
    "free cables": Case(partial(free, state=FREE), 401, 1.0, 6e-3, CLOSE, 2),
    "free drones": Case(
        partial(free, state=FREE),
        4001,
        1e-3,
        0.0,
        frozenset({"separation", "span", "thrust", "tilt", "body_rate"}),
    ),
    "cables on the ground": Case(partial(free, state=GROUND), 1501, 0.0, 2e-3, CLOSE, 2),
    "cables in clasping": Case(partial(free, state=CLASPING), 1501, 0.0, 6e-3, CLOSE, 2),
    "above a floor": Case(partial(apart, floor=0.8), 1501, 0.0, 6e-3, CLOSE - {"crossing"}, 2),
    "above the ground": Case(partial(apart, floor=0.0), 1501, 0.0, 6e-3, CLOSE - {"crossing"}, 1),
    "a cable that sinks": Case(slackened, 1501, 0.0, 6e-3, CLOSE - {"crossing"}, 1),
    "under a cable": Case(under, 3, 0.0, 6e-3, CLOSE - {"crossing"}, 1),
    "a falling drone": Case(falling, 5001, 1e-2, 0.0, frozenset({"tilt"}), 2),
    "a vertex that moves in": Case(inward, 2001, 1e-3, 0.0, frozenset({"convexity"}), 1),
    "single drones": Case(
        swarm, 20_001, least=2e-3, only=frozenset({"separation", "keep_out", "speed"}), seeds=6
    ),
    "a crowd": Case(crowd, 1001, 0.1, 0.0, frozenset({"separation"}), 1),
    "a lattice": Case(lattice, 11, 1e-2, 0.0, frozenset({"separation"}), 1),
}
SLOW = pytest.mark.slow
QUICK = {"chain", "hitch", "chain that is wrong", "above a floor", "wild"}
"""Motions of which two seeds take less than half a second."""


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param(
            name,
            seed,
            marks=SLOW if case.slow or seed > (name in QUICK) else (),
            id=f"{name}-{seed}",
        )
        for name, case in CASES.items()
        for seed in range(case.seeds)
    ],
)
def test_no_sample_exceeds_a_bound(name: str, seed: int) -> None:
    case = CASES[name]
    motion = case.make(seed)
    assert_sound(motion, case.count, case.gap, case.least, case.only)
    if name in {"hitch", "loaded hitch", "chain"}:
        for check, most in HELD.items():
            assert row(motion, check).worst < most


def test_close_pairs_are_named() -> None:
    assert row(curled(0), "crossing").where == ("edge 0", "edge 3")
    assert row(apart(0, 0.8), "cable_clearance").where == ("r1", "cable 1")  # its own
    assert row(without_own_cables(apart(0, 0.8)), "cable_clearance").where[0] == "ground"
    assert row(under(0), "cable_clearance").where == ("q1", "cable 0")
    check = row(inward(0), "convexity")
    assert (check.where, check.worst < -10.0) == (("p0",), True)
    assert not row(wrong_chain(0), "cable_length").holds


@pytest.mark.parametrize("seed", range(4))
def test_hanging_cables_stay_within_bounds_of_their_links(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    q, length = rng.normal(size=3), rng.uniform(1.0, 3.0)
    r = q + rng.uniform(0.4, 0.9) * length * unit(rng.normal(size=3) * [1.0, 1.0, 0.4])
    points, off = chains(q[None, :, None], r[None, :, None], np.array([length]))
    corners = points[0, ..., 0]
    there = cable_points([length], np.stack([q, r]), 4001)[0]
    apart = point_to_segment(there[:, None], corners[None, :-1], corners[None, 1:])
    nearest = np.argmin(apart, axis=1)
    links = np.unique(nearest)
    shares = [np.max(apart[nearest == link, link]) / off[0, link] for link in links]
    assert 0.9 < max(shares) <= 1.0 + 1e-6
