"""``tracking_radius``: closed forms, an adversary, and laws."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from adversary import attack
from certificate_cases import random_motion, still
from free_cases import free_motion, random_flight, single
from numpy.typing import NDArray
from plans import planned

import hitchopt as ho
from hitchopt.checks import Check, certify
from hitchopt.checks.clearance import moved_by
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def radius_of(motion: Motion, gamma: float = 1.0) -> Check:
    return certify(motion, gamma=gamma)["tracking_radius"]


def lines(places: Array) -> Motion:
    """Drones without cables that fly from places (2, N, 3) [m] along lines, for a second."""
    coefficients = np.moveaxis(places, 0, -1)[None]
    return single(PiecewisePolynomial(np.array([0.0, 1.0]), coefficients))


def test_two_drones_at_rest_have_half_the_distance_of_their_ellipsoids() -> None:
    for offset, expected in (
        ([1.0, 0.0, 0.0], 0.5 * (1.0 - 0.24)),
        ([0.0, 0.0, 1.0], 0.5 * (1.0 - 0.60)),
        ([0.0, -0.3, 0.0], 0.03),
    ):
        places = np.tile([[0.0, 0.0, 3.0], np.add([0.0, 0.0, 3.0], offset)], (2, 1, 1))
        check = radius_of(lines(places))
        assert check.bound == pytest.approx(expected, rel=1e-6)
        assert (check.limit, check.holds, check.where) == (None, True, ("d0", "d1"))


@pytest.mark.parametrize(("n", "seed"), [(3, 1), (5, 2), (8, 3)])
def test_no_adversary_beats_it_and_it_is_tight_for_random_hitches(n: int, seed: int) -> None:
    arena = Arena([-40.0, -50.0, 0.5], [45.0, 40.0, 3.0])
    motion = random_motion(n, seed, arena=arena)
    radius, found = radius_of(motion).bound, attack(motion, count=30)
    assert 0.9 * found <= radius <= found * (1.0 + 1e-4)
    wider = radius_of(motion, 1.8).bound
    assert wider <= min(radius, attack(motion, 1.8, 30) * (1.0 + 1e-4))


@pytest.mark.parametrize(
    ("stem", "count"),
    [
        ("triangle", 30),
        ("open_pair", 30),
        pytest.param("form_triangle", 40, marks=pytest.mark.slow),
        ("swarms/stack", 30),
    ],
)
def test_no_adversary_beats_it_and_it_is_tight_for_plans(stem: str, count: int) -> None:
    motion = planned(stem).motion
    radius, found = radius_of(motion).bound, attack(motion, count=count)
    assert 0.9 * found <= radius <= found * (1.0 + 1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_crossing_drones_at_all_heights(seed: int) -> None:
    """Pairs one of which is higher: the pair of the least ratio need not be the one that counts."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-3.0, 3.0, (2, 9, 3)) + [0.0, 0.0, 5.0]
    motion = lines(places)
    check = certify(motion)["separation"]
    radius, found = radius_of(motion).bound, attack(motion, count=30)
    if not check.holds:
        assert radius == 0.0
    else:
        assert 0.95 * found <= radius <= found * (1.0 + 1e-4)
        assert radius >= 0.12 * (check.bound - 1.0) - 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_free_cables(seed: int) -> None:
    team, drones = random_flight(seed, n=3, pieces=1)
    motion = free_motion(team, drones)
    assert 0.0 <= radius_of(motion).bound <= attack(motion, count=12) * (1.0 + 1e-4)


def test_hanging_cables_come_down_to_the_ground_and_no_farther() -> None:
    ends = np.array([[0.0, 0.0, 0.8], [1.0, 0.1, 0.8], [9.0, 0.0, 3.0], [9.6, 0.0, 3.2]])
    motion = free_motion(
        Team(2, 1.5, topology="open"), PiecewisePolynomial.constant(np.array([0.0, 1.0]), ends)
    )
    left, radius = certify(motion)["cable_clearance"], radius_of(motion)
    assert (left.holds, left.where) == (True, radius.where)
    assert moved_by(motion)(radius.bound) == pytest.approx(left.bound - left.number, rel=1e-6)


def test_hanging_cables_move_no_farther_than_said() -> None:
    rng = np.random.default_rng(5)
    mu = np.linspace(-1.0, 1.0, 301)[:, None]
    for _ in range(40):
        length = rng.uniform(1.0, 2.0)
        q, r = rng.uniform(-0.35, 0.35, (2, 3)) * length + [[0.0, 0.0, 5.0], [0.5, 0.0, 5.0]]
        if np.linalg.norm(q - r) > 0.93 * length:
            continue
        team = Team(2, length, topology="open")
        ends = np.stack([q, r, q + 9.0, r + 9.0])
        still_there = PiecewisePolynomial.constant(np.array([0.0, 1.0]), ends)
        needed = moved_by(free_motion(team, still_there))
        for radius in (0.001, 0.01, 0.04):
            shifts = rng.normal(size=(2, 60, 3))
            shifts *= radius / np.linalg.norm(shifts, axis=-1, keepdims=True)
            places = []
            for a, b in ((q[None], r[None]), (q + shifts[0], r + shifts[1])):
                cable = Catenary.between(a, b, length)
                points = a + 0.5 * (1.0 + mu[..., None]) * (b - a)
                points[..., 2] -= cable.depth(mu)
                places.append(points)
            moved = np.max(np.linalg.norm(places[1] - places[0], axis=-1))
            assert moved + radius <= needed(radius) * (1.0 + 1e-9)


def test_a_larger_gamma_never_helps_and_is_stated() -> None:
    motion = random_motion(4, 7)
    radii = [radius_of(motion, gamma).bound for gamma in (0.0, 0.5, 1.0, 1.5, 3.0)]
    assert radii == sorted(radii, reverse=True)
    certificate = certify(motion, gamma=1.5)
    entry = certificate.to_dict()["checks"][-2]
    assert (entry["name"], entry["gamma"], entry["limit"]) == ("tracking_radius", 1.5, None)
    assert entry["holds"] is True
    assert all("gamma" not in other for other in certificate.to_dict()["checks"][:-2])
    with pytest.raises(ho.InputError, match="gamma"):
        certify(motion, gamma=-1.0)


def test_what_binds_is_named() -> None:
    """Of a triangle at rest the legs, the walls, and with a long leg limit nothing is left."""
    triangle = np.array([[0.0, -1.0], [-0.8, 0.6], [0.8, 0.6]])
    motion = still(Team(3, 3.0), triangle, [0.4] * 3)

    def limited(**limits: float) -> Motion:
        return replace(motion, requirements=Requirements(Limits(**limits), Separation()))

    short = limited(leg=0.39)
    shortest = certify(short)["legs"]
    check = radius_of(short)
    assert check.bound == pytest.approx((shortest.bound - 0.39) / 2.0, rel=1e-6)
    assert check.where == shortest.where
    assert radius_of(short, 3.0).bound == pytest.approx((shortest.bound - 0.39) / 4.0, rel=1e-6)
    assert radius_of(limited(leg=0.9)).bound == 0.0
    for name, number, moved in (("crossing", 2.0, 6.0), ("cable", 2.0, 4.0)):  # for γ = 1 and 3
        kept = certify(motion)["cable_clearance" if name == "cable" else name].bound - 1e-3
        near = replace(motion, requirements=Requirements(Limits(), Separation(**{name: kept})))
        assert radius_of(near).bound == pytest.approx(1e-3 / number, rel=1e-3), name
        assert radius_of(near, 3.0).bound == pytest.approx(1e-3 / moved, rel=1e-3), name
    low = replace(motion, requirements=Requirements(arena=Arena([-9, -9, 0.999], [9, 9, 3])))
    assert radius_of(low).bound == pytest.approx(1e-3, rel=1e-6)


def test_nothing_counted_is_null() -> None:
    check = radius_of(lines(np.zeros((2, 1, 3)) + 1.0))
    assert (check.worst, check.holds, check.where) == (None, True, ())
    assert math.isinf(check.bound)
