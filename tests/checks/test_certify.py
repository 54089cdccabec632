"""The certificate as a whole: its table, and symmetries; ``test_bounds`` holds it to samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from certificate_cases import cut, random_motion, still, with_drones, with_parts
from numpy.typing import ArrayLike

from hitchopt.checks import certify
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.search import ABSOLUTE
from hitchopt.values import Array

ARENA = Arena([-40.0, -50.0, -1.0], [45.0, 40.0, 3.0])
TABLE: dict[str, tuple[str, float | None]] = {
    "separation": ("min", 1.0),
    "cable_clearance": ("min", 0.11),
    "crossing": ("min", 0.06),
    "speed": ("max", 1.1),
    "acceleration": ("max", 2.2),
    "jerk": ("max", 3.3),
    "vertex_speed": ("max", 0.55),
    "thrust": ("max", 2.6),
    "tilt": ("max", 44.0),
    "legs": ("min", 0.16),
    "cable_length": ("max", 1e-4),
    "equilibrium": ("max", 5e-3),
    "convexity": ("min", 0.0),
    "arena": ("min", 0.0),
    "tension": ("max", 1e-4),
    "continuity": ("max", 1e-6),
    "duration": ("max", 9.0),
    "tracking_radius": ("min", None),
    "stoppable": ("max", None),
}
"""Checks in their order, with senses and limits."""


def test_checks_have_the_order_senses_and_limits_of_the_table_and_progress_hears_of_each() -> None:
    limits = Limits(1.1, 2.2, 3.3, math.radians(44.0), 0.55, 0.16, 9.0)
    separation = Separation(cable=0.11, crossing=0.06)
    motion = random_motion(4, 2, limits=limits, separation=separation, arena=ARENA)
    heard: list[str] = []
    certificate = certify(motion, heard.append)
    assert heard == [f"{name}, {i} of {len(TABLE)}" for i, name in enumerate(TABLE)]
    found = {c.name: (c.sense, c.limit and round(c.limit, 9)) for c in certificate.checks}
    assert list(found.items()) == list(TABLE.items())
    assert certificate["duration"].worst == certificate.duration == motion.duration
    told = certificate.to_dict()
    assert [entry["name"] for entry in told["checks"]] == list(TABLE)
    assert (told["certified"], told["duration"]) == (certificate.certified, motion.duration)
    fewer = [check.name for check in certify(random_motion(3, 1)).checks]
    assert fewer == [name for name in TABLE if name not in {"arena", "duration"}]


def transformed(matrix: Array, shift: ArrayLike = 0.0) -> Callable[[Motion], Motion]:
    def mapped(part: PiecewisePolynomial) -> PiecewisePolynomial:
        c = np.einsum("ij,...jk->...ik", matrix, part.coefficients)
        return PiecewisePolynomial(part.breaks, c + np.broadcast_to(shift, 3)[:, None])

    return lambda m: replace(m, drones=mapped(m.drones), vertices=mapped(m.vertices))


def renumbered(motion: Motion) -> Motion:
    def rolled(part: PiecewisePolynomial, by: int) -> PiecewisePolynomial:
        return PiecewisePolynomial(part.breaks, np.roll(part.coefficients, -by, axis=1))

    return replace(
        motion,
        team=Team(motion.team.robots, np.roll(motion.team.cable_length, -3)),
        drones=rolled(motion.drones, 6),
        vertices=rolled(motion.vertices, 3),
        legs=rolled(motion.legs, 3),
        tensions=rolled(motion.tensions, 3),
    )


def stretched(part: PiecewisePolynomial) -> PiecewisePolynomial:
    return part.stretched(2.0)


@dataclass(frozen=True)
class Symmetry:
    """A change of a motion, what it makes of worst values, of times, and of numbers in names."""

    change: Callable[[Motion], Motion]
    factors: dict[str, float]
    time: Callable[[float], float] = lambda t: t
    number: int = 0


C, S = math.cos(1.1), math.sin(1.1)
SLOWER = {"speed": 2.0, "acceleration": 4.0, "jerk": 8.0, "vertex_speed": 2.0}
SYMMETRIES = {
    "shifted and turned": Symmetry(
        transformed(np.array([[C, -S, 0.0], [S, C, 0.0], [0.0, 0.0, 1.0]]), [12.0, -7.0, 2.0]), {}
    ),
    "flown backwards": Symmetry(
        lambda m: with_parts(m, PiecewisePolynomial.reversed), {}, lambda t: 4.0 - t
    ),
    "cut": Symmetry(lambda m: with_parts(m, cut), {}),
    "mirrored": Symmetry(transformed(np.diag([-1.0, 1.0, 1.0])), {"convexity": math.nan}),
    "renumbered": Symmetry(renumbered, {}, number=3),
    "slower by two": Symmetry(
        lambda m: with_parts(m, stretched),
        dict.fromkeys(("thrust", "tilt", "stoppable"), math.nan) | SLOWER,
        lambda t: 2.0 * t,
    ),
}


@pytest.mark.parametrize("name", SYMMETRIES)
@pytest.mark.parametrize(("n", "seed"), [(4, 9), (7, 8)])
def test_where_how_fast_and_in_which_numbers_it_flies_changes_nothing_else(
    name: str, n: int, seed: int
) -> None:
    symmetry, motion = SYMMETRIES[name], random_motion(n, seed)
    first, second = certify(motion), certify(symmetry.change(motion))
    for a, b in zip(first.checks, second.checks, strict=True):
        factor = symmetry.factors.get(a.name, 1.0)
        if a.name == "continuity" or math.isnan(factor):  # it measures the fit's own noise
            continue
        assert a.bound == pytest.approx(factor * b.bound, rel=3e-4, abs=1e-6), a.name
        if a.name in {"separation", "cable_clearance", "speed", "jerk", "legs"}:
            back = {f"{w[:-1]}{(int(w[-1]) + symmetry.number) % n}" for w in b.where}
            assert back == set(a.where), a.name
            if a.name == "speed":
                assert b.time == pytest.approx(symmetry.time(a.time), abs=2e-2)
    assert first["convexity"].holds
    assert second["convexity"].holds is (name != "mirrored")  # it turns the wrong way


@pytest.mark.parametrize(("axis", "index"), [(0, 0), (1, 3), (2, 4)])
def test_a_coefficient_moved_by_a_hundredth_of_a_millimetre_shows(axis: int, index: int) -> None:
    motion = random_motion(4, 12)
    before = certify(motion)
    c = motion.drones.coefficients.copy()
    c[3, 5, axis, index] += 1e-5
    after = certify(with_drones(motion, c))
    changed = [
        a.name
        for a, b in zip(before.checks, after.checks, strict=True)
        if abs(a.bound - b.bound) > 1e-6 or a.holds != b.holds
    ]
    assert changed
    if index == 0:  # at a joint: it jumps
        assert not after["continuity"].holds
        assert after["continuity"].where == ("r2",)


def test_legs_that_do_not_tell_the_truth_fail() -> None:
    motion = random_motion(4, 13)
    c = motion.legs.coefficients.copy()
    c[:, 2, 0] += 1e-3
    c[:, 2, 1] -= 1e-3  # the sum is still right
    wrong = replace(motion, legs=PiecewisePolynomial(motion.legs.breaks, c))
    check = certify(wrong)["cable_length"]
    assert (check.where, check.holds) == (("cable 2",), False)
    assert check.worst == pytest.approx(1e-3 / motion.team.cable_length[2], rel=1e-3)


TRIANGLE = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])


def test_a_hitch_at_rest_has_its_configuration_s_own_numbers() -> None:
    certificate = certify(still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, [0.35, 0.5, 0.45]))
    weight, pull = 0.132 * 9.81, 0.4
    for name, value, within in (
        ("speed", 0.0, 1e-9),
        ("jerk", 0.0, 1e-6),
        ("legs", 0.35, 1e-9),
        ("thrust", math.hypot(weight, pull), 2e-9),
        ("tilt", math.degrees(math.atan2(pull, weight)), 2e-8),
        ("convexity", math.degrees(math.pi - math.acos(0.4 / math.hypot(0.4, 1.5))), 1e-4),
    ):
        assert certificate[name].worst == pytest.approx(value, abs=within), name


@pytest.mark.parametrize("end", [0, -1])
def test_weights_that_come_and_go_with_the_tension_need_the_same_length(end: int) -> None:
    team = Team(3, [2.4, 2.5, 2.6], tension=0.5, cable_density=0.01)
    motion = still(team, TRIANGLE, [0.35, 0.5, 0.45])
    drones = motion.drones.coefficients.copy()
    q0, p0 = drones[end, 0, :, end], motion.vertices.coefficients[end, 0, :, end]
    drones[end, 0, :, end] += 1e-6 * (q0 - p0) / np.linalg.norm(q0 - p0)  # longest at that end
    rise = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5])[:: 1 if end == 0 else -1]
    pull = np.broadcast_to(rise, (motion.tensions.pieces, 3, 8))
    tensions = PiecewisePolynomial(motion.tensions.breaks, pull)
    found = certify(replace(with_drones(motion, drones), tensions=tensions))["cable_length"]
    assert 1e-6 / 2.4 <= found.bound <= 1e-6 / 2.4 + ABSOLUTE
    assert found.where == ("cable 0",)
