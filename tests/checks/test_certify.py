"""The certificate as a whole: its table, symmetries, rounding, and what it says of nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import hitchopt as ho
from hitchopt.checks import Certificate, Check, certify, merged
from hitchopt.checks.registry import QUANTITIES, RULES
from hitchopt.checks.rule import approach
from hitchopt.hitch import Team
from hitchopt.hitch.pairs import FIXED
from hitchopt.hitch.requirements import Limits, Prism, Requirements, Separation
from hitchopt.mission.advice import WIDENED
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.planners.rests import rest_plan
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, known
from hitchopt.values.fields import keys_of
from tests.helpers.motions import (
    ARENA,
    TRIANGLE,
    altered,
    cut,
    free_motion,
    held_at,
    plus,
    random_chain,
    random_flight,
    random_motion,
    replaced,
    row,
    single,
    still,
    triangle,
    with_parts,
)

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
    "body_rate": ("max", 90.0),
    "legs": ("min", 0.16),
    "cable_length": ("max", 1e-4),
    "equilibrium": ("max", 5e-3),
    "convexity": ("min", 0.0),
    "arena": ("min", 0.0),
    "floor": ("min", 0.0),
    "keep_out": ("min", 0.12),
    "tension": ("max", 1e-4),
    "continuity": ("max", 1e-6),
    "duration": ("max", 9.0),
    "tracking_radius": ("min", None),
    "vertex_error": ("max", None),
    "stoppable": ("max", None),
}
"""Checks of a motion, with senses and limits."""


def test_checks_follow_the_table_and_report_progress() -> None:
    tilt, turn = math.radians(44.0), math.radians(90.0)
    limits = Limits(1.1, 2.2, 3.3, tilt, 0.55, 0.16, 9.0, body_rate=turn)
    requirements = {"separation": Separation(cable=0.11, crossing=0.06), "arena": ARENA}
    wall = Prism(TRIANGLE + 20.0, 0.0, 1.0)
    motion = random_motion(4, 2, limits=limits, keep_out=(wall,), **requirements)
    heard: list[str] = []
    certificate = certify(motion, heard.append)
    names = [check.name for check in certificate.checks]
    assert names == [each.name for each in QUANTITIES if each.name in names]
    *parts, whole = names
    counted = [f"{name}, {i} of {len(parts)}" for i, name in enumerate(parts)]
    assert heard == [*counted, f"{whole}, of the whole motion"]
    result = {c.name: (c.sense, c.limit and round(c.limit, 9)) for c in certificate.checks}
    assert {name: result[name] for name in TABLE} == TABLE
    assert certificate["duration"].worst == certificate.duration == motion.duration
    fewer = [check.name for check in certify(random_motion(3, 1)).checks]
    assert set(TABLE) - set(fewer) == {"arena", "keep_out", "duration", "body_rate"}


def test_lists_of_limits_follow_from_the_bodies_that_they_state() -> None:
    assert {rule.name for rule in RULES if rule.pairs} == WIDENED | {"floor"}
    keys = {f"limits.{key.name}" for key in keys_of(Limits).values()}
    assert {rule.key for rule in RULES if rule.key.startswith("limits.")} <= keys
    for rule in RULES:  # only drones err: what stands does not
        if rule.pairs and {kind for pair in rule.pairs for kind in pair} <= {"drones", *FIXED}:
            drones = max(pair.count("drones") for pair in rule.pairs)
            assert approach(rule.bodies, 3.0, hitched=True) == drones


def transformed(matrix: Array, shift: ArrayLike = 0.0) -> Callable[[Motion], Motion]:
    def mapped(c: Array) -> Array:
        moved: Array = np.einsum("ij,...jk->...ik", matrix, c) + np.broadcast_to(shift, 3)[:, None]
        return moved

    def changed(motion: Motion) -> Motion:
        floor = known(motion.requirements.limits.floor) + float(np.broadcast_to(shift, 3)[2])
        moved = altered(altered(motion, "drones", mapped), "vertices", mapped)
        return replaced(moved, floor=floor)

    return changed


def renumbered(motion: Motion) -> Motion:
    changed = replace(
        motion, team=replace(motion.team, cable_length=np.roll(motion.team.cable_length, -3))
    )
    for part, by in (("drones", 6), ("vertices", 3), ("legs", 3), ("tensions", 3)):
        changed = altered(changed, part, lambda c, by=by: np.roll(c, -by, axis=1))  # type: ignore[misc]
    return changed


@dataclass(frozen=True)
class Symmetry:
    """A change of a motion, and its effect on worst values and on numbers in names."""

    change: Callable[[Motion], Motion]
    factors: dict[str, float]
    number: int = 0


C, S = math.cos(1.1), math.sin(1.1)
SLOWER = {"speed": 2.0, "acceleration": 4.0, "jerk": 8.0, "vertex_speed": 2.0}
SYMMETRIES = {
    "shifted and turned": Symmetry(
        transformed(np.array([[C, -S, 0.0], [S, C, 0.0], [0.0, 0.0, 1.0]]), [12.0, -7.0, 2.0]), {}
    ),
    "flown backwards": Symmetry(lambda m: with_parts(m, PiecewisePolynomial.reversed), {}),
    "cut": Symmetry(lambda m: with_parts(m, cut), {}),
    "mirrored": Symmetry(transformed(np.diag([-1.0, 1.0, 1.0])), {"convexity": math.nan}),
    "renumbered": Symmetry(renumbered, {}, number=3),
    "slower by two": Symmetry(
        lambda m: with_parts(m, lambda part: part.stretched(2.0)),
        dict.fromkeys(("thrust", "tilt", "stoppable"), math.nan) | SLOWER,
    ),
}


def free() -> Motion:
    """Return four cables that hang far above the ground."""
    team, drones = random_flight(2, pieces=1)
    return free_motion(replace(team, cable_density=0.0), drones.stretched(20.0))


MOTIONS = {"taut": lambda: random_motion(5, 8), "free": free}


LOOSE = {"cable_clearance", "tracking_radius"}
"""Checks that are within millimetres while cables hang."""


@cache
def certified(kind: str) -> tuple[Motion, Certificate]:
    """Return a motion and its certificate."""
    motion = MOTIONS[kind]()
    return motion, certify(motion)


def limits_of(name: str, value: float) -> ho.Limits:
    """Return the default limits with another one."""
    limit: dict[str, Any] = {name: value}
    return ho.Limits(**limit)


@pytest.mark.parametrize("name", SYMMETRIES)
@pytest.mark.parametrize("kind", MOTIONS)
def test_certificates_are_invariant_to_place_time_and_numbering(name: str, kind: str) -> None:
    symmetry, (motion, first) = SYMMETRIES[name], certified(kind)
    n, loose = motion.team.robots, LOOSE if kind == "free" else set()
    second = certify(symmetry.change(motion))
    for a, b in zip(first.checks, second.checks, strict=True):
        factor = symmetry.factors.get(a.name, 1.0)
        if a.name == "continuity" or math.isnan(factor):  # it measures the fit's own noise
            continue
        if not a.is_evaluated:  # a single piece has no joints
            continue
        least = 1e-2 if a.name in loose else 1e-6
        heights = [check.number if check.name == "floor" else 0.0 for check in (a, b)]
        found, moved = (check.worst - z for check, z in zip((a, b), heights, strict=True))
        assert found == pytest.approx(factor * moved, rel=3e-4, abs=least), a.name
        if a.name in {"separation", "cable_clearance", "speed", "jerk", "legs"} - loose:
            back = {f"{w[:-1]}{(int(w[-1]) + symmetry.number) % n}" for w in b.where}
            assert back == set(a.where), a.name
        if a.name == "convexity":
            assert (a.holds, b.holds) == (True, name != "mirrored")  # it turns the wrong way


@pytest.mark.parametrize("end", [0, -1])
def test_weights_that_ramp_with_the_tension_need_the_same_length(end: int) -> None:
    team = Team(3, [2.4, 2.5, 2.6], tension=0.5, cable_density=0.01)
    motion = still(team, TRIANGLE, [0.35, 0.5, 0.45])
    leg = (motion.drones.coefficients[:, 0] - motion.vertices.coefficients[:, 0])[end, :, end]
    longer = plus((end, 0, slice(None), end), 1e-6 * leg / np.linalg.norm(leg))  # at that end
    rise = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5])[:: 1 if end == 0 else -1]
    rising = altered(motion, "tensions", lambda c: np.broadcast_to(rise, (len(c), 3, 8)))
    result = row(altered(rising, "drones", longer), "cable_length")
    assert 1e-6 / 2.4 <= result.worst <= 1e-6 / 2.4 + 2e-7
    assert result.where == ("cable 0",)


def upward(seed: int) -> Motion:
    """Return a short piece, far up, on which one drone moves in z with growing derivatives."""
    rng = np.random.default_rng(seed)
    motion = held_at(triangle(altitude=900.0), [0.3, 0.3 + rng.uniform(1e-3, 1e-2)], 6)
    path = np.arange(7) ** 5 * rng.uniform(0.9, 1.0) * 1e-3 + rng.uniform(0.0, 1e-9, 7)
    return altered(motion, "drones", plus((0, 2, 2), path))


def exact_at_end(motion: Motion, order: int) -> Fraction:
    """Return the derivative in z of drone 2 at the end of its piece, exactly."""
    c = [Fraction(float(x)) for x in motion.drones.coefficients[0, 2, 2]]
    first, last = (Fraction(float(t)) for t in motion.drones.breaks)
    degree = len(c) - 1
    for k in range(order):
        c = [(degree - k) * (b - a) / (last - first) for a, b in pairwise(c)]
    return c[-1]


@pytest.mark.parametrize("seed", range(6))
def test_derivatives_and_thrusts_are_not_rounded_below_their_exact_values(seed: int) -> None:
    motion = upward(seed)
    slack = altered(motion, "tensions", np.zeros_like)
    exact = {
        name: exact_at_end(motion, k) for k, name in enumerate(("speed", "acceleration", "jerk"), 1)
    }
    exact["thrust"] = Fraction(0.132) * (exact["acceleration"] + Fraction(9.81))
    for name, value in exact.items():
        worst = row(slack, name).worst
        assert Fraction(worst) >= value, name
        assert worst == pytest.approx(float(value), rel=1e-6)


def test_differences_that_round_to_zero_are_not_zero() -> None:
    """Coefficients are 1 - 2**-54, 1 + 2**-53 and 1, so there is a jerk."""
    first = 1.0 - 2.0**-10 - 2.0**-53
    c = np.array([-(2.0**-10) - 2.0**-54, first, *(2.0 - 2.0**-10 + np.arange(6))])
    assert np.all(np.diff(c) == 1.0)
    path = np.array([1.0, 0.0, 0.0])[:, None] * c
    curve = PiecewisePolynomial(np.array([0.0, 1e-3]), path[None, None])
    exact = 7 * 6 * 5 * 1.25 * 2.0**-52 / 1e-9
    assert exact <= row(single(curve), "jerk").worst < 100.0 * exact


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
@pytest.mark.parametrize("far", [10.0, 900.0])
def test_distances_shrink_by_the_stated_share_of_coordinates(far: float) -> None:
    motion = still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE + far, [0.35, 0.5, 0.45], altitude=far)
    x, p = motion.drones.coefficients[0, :, :, 0], motion.vertices.coefficients[0, :, :, 0]
    leg = min(math.dist(x[0], p[0]), math.dist(x[2], p[1]), math.dist(x[4], p[2]))
    scaled = x / [0.24, 0.24, 0.6]
    ratio = min(math.dist(scaled[i], scaled[j]) for i in range(6) for j in range(i))
    for name, value, size in (("legs", leg, 1.0), ("separation", ratio, 0.24)):
        margin = 2.0**-40 * float(np.max(np.abs(motion.drones.coefficients))) / size
        assert value - row(motion, name).worst == pytest.approx(margin, rel=0.05, abs=1e-14)


def test_worst_is_null_without_items() -> None:
    """All parts of a chain of two cables share its clasp: no pair is checked."""
    certificate = certify(random_chain(2, 0))
    check = certificate["crossing"]
    assert (check.worst, check.holds, check.where) == (math.inf, True, ())
    assert not check.is_evaluated
    text = json.dumps(certificate.to_dict(), allow_nan=False)
    worst_values = {entry["name"]: entry["worst"] for entry in json.loads(text)["checks"]}
    assert [name for name, worst in worst_values.items() if worst is None] == ["crossing"]
    assert row(random_chain(3, 0), "crossing").is_evaluated


@pytest.mark.parametrize("sense", ["min", "max"])
def test_only_infinities_that_hold_become_null(sense: str) -> None:
    good = math.inf if sense == "min" else -math.inf
    nothing = Check.of("x", good, 1.0, sense, "m", 2.0, ("q0",))
    assert (nothing.worst, nothing.holds, nothing.where) == (good, True, ())
    assert not nothing.is_evaluated
    for bad in (-good, math.nan):
        check = Check.of("x", bad, 1.0, sense, "m", 2.0, ("q0",))
        assert not check.holds
        assert check.is_evaluated
        assert check.where == ("q0",)
    some = Check.of("x", 3.0, 3.0, sense, "m", 0.0, ())
    assert max((nothing, some), key=lambda each: each.utilization) is some


@pytest.fixture(scope="module")
def parts() -> list[Motion]:
    """Four steps of a triangle with drones of unequal thrust, off the origin."""
    kinds = [ho.Quadrotor(0.132, 2.6), ho.Quadrotor(0.140, 3.1), ho.Quadrotor(0.125, 2.9)]
    hitch = ho.Hitch.spread(ho.Team(3, 2.4, quadrotor=kinds), TRIANGLE - [0.0, 1.0])
    arena = ho.Arena((-1.0, -4.0, 0.0), (6.0, 4.0, 3.0))
    plans = (
        ho.solve(hitch, ho.MoveVertex(0, by=[0.0, 0.4]), arena=arena),
        ho.solve(hitch, ho.Hold(0.7), arena=arena),
        ho.solve(hitch, ho.Adjust(hitch.q_legs + [0.05, -0.05, 0.02]), arena=arena),
        ho.solve(hitch, ho.Transport([3.1, 1.0, 1.2], yaw=0.3), arena=arena),
    )
    return [plan.motion for plan in plans]


def of_parts(parts: list[Motion]) -> Certificate:
    """Parts are joined even if they do not match: continuity must fail."""
    return merged(concatenated(parts), [certify(part) for part in parts])


@pytest.mark.parametrize(
    ("count", "duration", "slower"),
    [(1, None, 1.0), (4, 100.0, 1.0), (4, 0.5, 1.0), (3, None, 0.7)],
)
def test_merged_certificates_equal_recomputed_ones(
    parts: list[Motion], duration: float | None, count: int, slower: float
) -> None:
    """Also for parts that violate limits."""
    parts = [part.slowed(slower) for part in parts[:count]]
    whole = replaced(concatenated(parts), duration=duration)
    anew, ours = certify(whole), merged(whole, [certify(part) for part in parts])
    assert ours.duration == anew.duration
    assert [c.name for c in ours.checks] == [c.name for c in anew.checks]
    for mine, other in zip(ours.checks, anew.checks, strict=True):
        for field in ("limit", "sense", "unit", "method", "holds"):
            assert getattr(mine, field) == getattr(other, field)
        assert mine.worst == pytest.approx(other.worst, rel=1e-4, abs=2e-7)
        assert 0.0 <= mine.time <= whole.duration
    assert ours["jerk"].holds is (slower == 1.0)
    for name in ("speed", "vertex_speed", "jerk"):
        assert ours[name].time == pytest.approx(anew[name].time, abs=0.05)


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("tracking", [0.02, ho.Tube(0.02, 0.03)])
def test_parts_with_wider_distances_give_the_certificate_of_stated_errors(
    parts: list[Motion], count: int, tracking: float | ho.Tube
) -> None:
    """Of a single part to the last bit, and though a part breaks what only planners require."""
    stated = [replaced(part, tracking=tracking, leg=0.1) for part in parts[:count]]
    whole = concatenated(stated)
    wider = [certify(part.replaced(requirements=part.requirements.with_reserve)) for part in stated]
    anew, ours = certify(whole), merged(whole, wider)
    assert {"tracking_radius", "separation"} <= {check.name for check in ours.limited}
    if count == 1:
        assert ours.checks == anew.checks
    for mine, other in zip(ours.checks, anew.checks, strict=True):
        assert (mine.name, mine.limit, mine.holds) == (other.name, other.limit, other.holds)
        assert mine.worst == pytest.approx(other.worst, rel=1e-4, abs=2e-7)
    marked = [
        replace(each, limited=tuple(replace(check, method="marked") for check in each.limited))
        for each in wider
    ]
    of_parts = {row.name for row in merged(whole, marked).limited if row.method == "marked"}
    assert {"speed", "tilt", "equilibrium"} <= of_parts
    assert of_parts.isdisjoint({*WIDENED, "tracking_radius"})


def test_jumps_between_parts_are_detected(parts: list[Motion]) -> None:
    certificate = of_parts([parts[1], altered(parts[1], "drones", plus(..., 0.01))])
    assert not certificate["tension"].holds  # legs turn at once, and thrusts with them
    check = certificate["continuity"]
    assert not check.holds
    assert check.worst == pytest.approx(0.01 * np.sqrt(3.0), rel=1e-6)
    assert check.time == pytest.approx(parts[1].duration)


TEAM = ho.Team(3, 2.4)
HITCH = ho.Hitch.spread(TEAM, ho.regular_polygon(3, 1.0), altitude=1.0)


@pytest.mark.parametrize(("sense", "out"), [("min", -1.0), ("max", 1.0)])
@pytest.mark.parametrize(("limit", "size"), [(0.0, 1.0), (0.15, 4.0), (50.0, 1.0)])
def test_a_check_holds_within_its_tolerance(
    limit: float, size: float, sense: str, out: float
) -> None:
    for share, holds in ((0.9, True), (1.1, False)):
        worst = limit + out * share * 1e-9 * max(limit, size)
        check = Check.of("legs", worst, limit, sense, "m", 0.0, (), size)
        assert (check.holds, check.worst) == (holds, worst)


def rest(**requirements: Any) -> ho.Certificate:
    return rest_plan(HITCH, Requirements(**requirements)).certificate


def test_limits_reached_to_the_last_digit_hold() -> None:
    usual = rest()
    legs = np.linalg.norm(HITCH.drones - HITCH.vertices[TEAM.layout.anchors], axis=1)
    exact: dict[str, Any] = {"leg": float(np.min(legs)), "tilt": math.radians(usual["tilt"].worst)}
    radius = 0.12 * usual["separation"].worst
    certificate = rest(
        limits=ho.Limits(**exact),
        separation=ho.Separation(radius=radius, cable=usual["cable_clearance"].worst),
        arena=ho.Arena(np.min(HITCH.drones, axis=0), np.max(HITCH.drones, axis=0) + [0, 0, 1]),
    )
    assert certificate.certified, certificate.violated
    assert certificate["arena"].worst == pytest.approx(0.0, abs=1e-9)
    assert certificate["legs"].worst < exact["leg"]  # a bound still, rounding included
    for name, off in (("leg", 1e-6), ("tilt", -1e-6)):
        assert not rest(limits=limits_of(name, exact[name] * (1.0 + off))).certified


@pytest.mark.parametrize("duration", [0.1 + 0.2, 0.3 * (1.0 - 5e-10)])
def test_a_plan_whose_duration_is_its_limit_is_certified(duration: float) -> None:
    certificate = ho.solve(HITCH, ho.Hold(0.3), limits=ho.Limits(duration=duration)).certificate
    assert certificate.certified
    assert certificate["duration"].worst == pytest.approx(0.3, abs=1e-16)


def passing(apart: Any, **requirements: Any) -> ho.Problem:
    """Return two drones that exchange places, or separate."""
    start = np.array([[0.0, 0.5, 1.0], [apart, 0.5, 1.0]])
    goal = start[::-1].copy() if apart > 1.0 else start + [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    return ho.Problem(ho.Swarm(2), start, [ho.Fly(goal)], **requirements)


def test_drones_may_start_on_a_wall_and_touching() -> None:
    walls = ho.Arena([0.0, -4.0, 0.0], [3.0, 4.0, 3.0])
    assert row(ho.separate(passing(3.0, arena=walls)).motion, "arena").holds
    assert ho.separate(passing(0.24)).certificate.certified
    with pytest.raises(ho.InfeasibleError, match="separation"):
        ho.separate(passing(0.24 - 1e-8))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
@pytest.mark.parametrize(("name", "limit"), [("speed", 1e-6), ("acceleration", 1e-9)])
def test_the_slowest_limits_are_planned(name: str, limit: float) -> None:
    slow, polygon = limits_of(name, limit), ho.regular_polygon(3, 0.9)
    for plan in (ho.separate(passing(3.0, limits=slow)), ho.morph(HITCH, polygon, limits=slow)):
        assert plan.certificate.certified
        assert plan.certificate[name].worst <= limit
        ends = plan.motion.drones.at(np.array([0.0, plan.duration]))
        farthest = float(np.max(np.linalg.norm(ends[1] - ends[0], axis=-1)))
        least = farthest / limit if name == "speed" else 2.0 * math.sqrt(farthest / limit)
        assert least < plan.duration < 1.3 * least
