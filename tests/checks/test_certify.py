"""The certificate as a whole: never beaten by samples, tight, and the same from everywhere."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import (
    cut,
    moving,
    random_motion,
    still,
    wild_motion,
    with_drones,
    with_parts,
)
from certificate_sampling import sampled
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.checks import Certificate, Check, certify
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.search import ABSOLUTE

ORDER = [
    "separation",
    "cable_clearance",
    "crossing",
    "speed",
    "acceleration",
    "jerk",
    "vertex_speed",
    "thrust",
    "tilt",
    "legs",
    "cable_length",
    "equilibrium",
    "convexity",
    "arena",
    "tension",
    "continuity",
    "duration",
    "tracking_radius",
    "stoppable",
]
ARENA = Arena([-40.0, -50.0, -1.0], [45.0, 40.0, 3.0])


def measured(check: Check) -> float:
    """A check's worst value as the brute force counts it: thrust as a share of the largest."""
    return check.bound / check.number if check.name == "thrust" else check.bound


def assert_sound_and_tight(motion: Motion, samples: int, gap: float = 1e-2) -> None:
    certificate = certify(motion)
    found = sampled(motion, np.linspace(0.0, motion.duration, samples))
    for check in certificate.checks:
        if check.name in found:
            worst, value = measured(check), found[check.name]
            outside = value - worst if check.sense == "min" else worst - value
            assert outside >= 0.0, f"{check.name}: {worst} is beaten by a sample of {value}"
            assert outside <= max(gap * abs(value), 1e-6), f"{check.name}: {worst} for {value}"


@settings(max_examples=12)
@given(n=st.integers(3, 16), seed=st.integers(0, 10_000))
def test_no_sample_beats_a_bound_and_bounds_are_tight(n: int, seed: int) -> None:
    motion = random_motion(n, seed, arena=ARENA)
    assert_sound_and_tight(motion, 2001 if n < 8 else 401)


@pytest.mark.slow
@settings(max_examples=15)
@given(seed=st.integers(0, 100_000))
def test_no_sample_beats_a_bound_of_polynomials_that_are_no_hitch_at_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, pieces, order = (int(rng.integers(*span)) for span in ((3, 7), (1, 4), (1, 9)))
    motion = wild_motion(rng, n, pieces, order, 10.0 ** rng.uniform(-3.0, 0.7), ARENA)
    found = sampled(motion, np.linspace(0.0, motion.duration, 2001))
    for check in certify(motion).checks:
        if check.name in found:
            worst, value = measured(check), found[check.name]
            outside = value - worst if check.sense == "min" else worst - value
            assert outside >= 0.0, f"{check.name}: {worst} is beaten by a sample of {value}"


@pytest.mark.slow
def test_thousands_of_samples_with_tensions_weights_and_masses_that_differ() -> None:
    n = 5
    angles = 2.0 * math.pi * np.arange(n) / n
    start = np.array([7.0, -3.0]) + 1.1 * np.column_stack([np.cos(angles), -np.sin(angles)])
    kinds = [Quadrotor(0.1 + 0.02 * k, 3.0 - 0.3 * k) for k in range(n)]
    team = Team(n, 2.2 + 0.05 * np.arange(n), cable_density=0.004, quadrotor=kinds)

    def tension_at(t: np.ndarray) -> np.ndarray:
        return 0.5 + 0.05 * np.sin(0.7 * t[:, None] + np.arange(n))

    def polygon_at(t: np.ndarray) -> np.ndarray:
        return start + 0.15 * np.sin(t[:, None, None] * [0.8, 1.1] + start)

    motion = moving(
        team, polygon_at, 0.4 + 0.03 * np.arange(n), order=9, tension_at=tension_at, arena=ARENA
    )
    assert_sound_and_tight(motion, 6001)


def test_the_checks_come_in_the_order_of_the_table_and_progress_hears_of_each() -> None:
    motion = random_motion(3, 1, arena=ARENA, limits=Limits(duration=10.0))
    heard: list[str] = []
    certificate = certify(motion, heard.append)
    assert heard == [f"{name}, {i} of {len(ORDER)}" for i, name in enumerate(ORDER)]
    assert [check.name for check in certificate.checks] == ORDER
    assert certificate.duration == motion.duration
    assert certificate["duration"].worst == motion.duration
    assert Certificate.from_dict(certificate.to_dict()) == certificate


def test_arena_and_duration_are_left_out_where_none_is_given() -> None:
    names = [check.name for check in certify(random_motion(3, 1)).checks]
    assert names == [name for name in ORDER if name not in {"arena", "duration"}]


def test_limits_and_senses_are_those_of_the_problem() -> None:
    limits = Limits(1.1, 2.2, 3.3, math.radians(44.0), 0.55, 0.16, 9.0)
    separation = Separation(cable=0.11, crossing=0.06)
    certificate = certify(random_motion(4, 2, limits=limits, separation=separation, arena=ARENA))
    told = {check.name: (check.sense, check.limit) for check in certificate.checks}
    told["tilt"] = (told["tilt"][0], round(certificate["tilt"].number, 9))
    assert told == {
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


TURN = np.array(
    [[math.cos(1.1), -math.sin(1.1), 0.0], [math.sin(1.1), math.cos(1.1), 0.0], [0.0, 0.0, 1.0]]
)


def transformed(motion: Motion, turn: np.ndarray, shift: np.ndarray) -> Motion:
    def mapped(part: PiecewisePolynomial) -> PiecewisePolynomial:
        c = np.einsum("ij,...jk->...ik", turn, part.coefficients) + shift[:, None]
        return PiecewisePolynomial(part.breaks, c)

    return replace(motion, drones=mapped(motion.drones), vertices=mapped(motion.vertices))


def renumbered(motion: Motion, k: int) -> Motion:
    def rolled(part: PiecewisePolynomial, by: int) -> PiecewisePolynomial:
        return PiecewisePolynomial(part.breaks, np.roll(part.coefficients, -by, axis=1))

    team = Team(motion.team.robots, np.roll(motion.team.cable_length, -k))
    return replace(
        motion,
        team=team,
        drones=rolled(motion.drones, 2 * k),
        vertices=rolled(motion.vertices, k),
        legs=rolled(motion.legs, k),
        tensions=rolled(motion.tensions, k),
    )


def assert_same(first: Certificate, second: Certificate, but: tuple[str, ...] = ()) -> None:
    for a, b in zip(first.checks, second.checks, strict=True):
        if a.name not in {"continuity", *but}:  # that one measures the fit's own noise
            assert a.worst == pytest.approx(b.worst, rel=3e-4, abs=1e-6), a.name


@pytest.mark.parametrize(
    ("change", "n", "seed"),
    [
        (lambda motion: transformed(motion, TURN, np.array([12.0, -7.0, 2.0])), 6, 5),
        (lambda motion: with_parts(motion, PiecewisePolynomial.reversed), 4, 9),
        (lambda motion: with_parts(motion, cut), 5, 11),
    ],
    ids=["shifted and turned", "flown backwards", "cut"],
)
def test_where_and_which_way_it_flies_and_in_which_pieces_does_not_matter(
    change: Callable[[Motion], Motion], n: int, seed: int
) -> None:
    motion = random_motion(n, seed)
    first, second = certify(motion), certify(change(motion))
    assert_same(first, second)
    time = 4.0 - first["speed"].time if n == 4 else first["speed"].time
    assert second["speed"].time == pytest.approx(time, abs=1e-2)


def test_a_mirrored_hitch_turns_the_wrong_way_and_changes_nothing_else() -> None:
    motion = random_motion(5, 6)
    certificate = certify(motion)
    mirrored = certify(transformed(motion, np.diag([-1.0, 1.0, 1.0]), np.zeros(3)))
    assert_same(certificate, mirrored, but=("convexity",))
    assert certificate["convexity"].holds
    assert mirrored["convexity"].bound < -70.0


def test_numbering_changes_names_only() -> None:
    motion = random_motion(7, 8)
    n, k = 7, 3
    first, second = certify(motion), certify(renumbered(motion, k))
    assert_same(first, second)
    for a, b in zip(first.checks, second.checks, strict=True):
        if a.name in {"separation", "cable_clearance", "speed", "jerk", "legs", "convexity"}:
            back = {f"{w.rstrip('0123456789')}{(int(w[-1]) + k) % n}" for w in b.where}
            assert back == set(a.where), a.name


def test_slower_by_two_divides_rates_by_powers_of_two() -> None:
    motion = random_motion(5, 10)
    slow = with_parts(motion, lambda part: part.stretched(2.0))
    first, second = certify(motion), certify(slow)
    for name, power in (("speed", 1), ("acceleration", 2), ("jerk", 3), ("vertex_speed", 1)):
        assert first[name].worst == pytest.approx(second[name].worst * 2**power, rel=3e-4)
    for name in ("separation", "crossing", "legs", "convexity", "equilibrium", "tracking_radius"):
        assert first[name].worst == pytest.approx(second[name].worst, rel=3e-4, abs=1e-6)


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
    check = certify(replace(motion, legs=PiecewisePolynomial(motion.legs.breaks, c)))[
        "cable_length"
    ]
    assert not check.holds
    assert check.where == ("cable 2",)
    assert check.worst == pytest.approx(1e-3 / motion.team.cable_length[2], rel=1e-3)


def test_a_hitch_at_rest_has_its_configuration_s_own_numbers() -> None:
    polygon = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
    motion = still(Team(3, [2.4, 2.5, 2.6]), polygon, [0.35, 0.5, 0.45])
    certificate = certify(motion)
    assert certificate["speed"].worst == pytest.approx(0.0, abs=1e-9)
    assert certificate["jerk"].worst == pytest.approx(0.0, abs=1e-6)
    assert certificate["legs"].worst == pytest.approx(0.35, abs=1e-9)
    weight, pull = 0.132 * 9.81, 0.4
    assert certificate["thrust"].worst == pytest.approx(math.hypot(weight, pull), rel=1e-9)
    lean = math.degrees(math.atan2(pull, weight))
    assert certificate["tilt"].worst == pytest.approx(lean, rel=1e-9)
    exterior = math.degrees(math.pi - math.acos(0.4 / math.hypot(0.4, 1.5)))
    assert certificate["convexity"].worst == pytest.approx(exterior, rel=1e-6)


@pytest.mark.parametrize("end", [0, -1])
def test_weights_that_come_and_go_with_the_tension_need_the_same_length(end: int) -> None:
    polygon = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
    team = Team(3, [2.4, 2.5, 2.6], tension=0.5, cable_density=0.01)
    motion = still(team, polygon, [0.35, 0.5, 0.45])
    drones = motion.drones.coefficients.copy()
    q0, p0 = drones[end, 0, :, end], motion.vertices.coefficients[end, 0, :, end]
    drones[end, 0, :, end] += 1e-6 * (q0 - p0) / np.linalg.norm(q0 - p0)  # longest at that end
    rise = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5])[:: 1 if end == 0 else -1]
    pull = np.broadcast_to(rise, (motion.tensions.pieces, 3, 8))
    tensions = PiecewisePolynomial(motion.tensions.breaks, pull)
    found = certify(replace(with_drones(motion, drones), tensions=tensions))["cable_length"]
    assert 1e-6 / 2.4 <= found.bound <= 1e-6 / 2.4 + ABSOLUTE
    assert found.where == ("cable 0",)
