"""Rows of verify against samples of curves: walls, prisms, reserves, sag and tracking errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.registry import RULE_OF
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.requirements import Prism
from hitchopt.motion.flight import TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import slice_time
from hitchopt.values import Array
from hitchopt.values.fields import with_fields
from hitchopt.verify import driver
from tests.helpers.plans import planned


def required(motion: Motion, *, limits: dict[str, Any] | None = None, **changes: Any) -> Motion:
    """Return a motion with other requirements."""
    old = motion.requirements
    new = replace(old, limits=with_fields(old.limits, **(limits or {})), **changes)
    return motion.replaced(requirements=new)


def rows(motion: Motion, name: str, folder: Path) -> list[second.Row]:
    """Return the rows of a check, unless nothing was proven there."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    (own,), _ = second.read(folder / "plan.npz")
    return [row for row in driver.plan_rows(own) if row.name == name and row.samples]


def worst(motion: Motion, name: str, folder: Path) -> float:
    """Return the smallest value of a check whose limits are lower bounds."""
    return min(row.worst for row in rows(motion, name, folder))


def samples(motion: Motion, curve: str = "drones") -> Array:
    """Return positions (times, points, 3) [m]."""
    breaks = motion.drones.breaks
    part = getattr(motion, curve)
    return np.asarray(part.at(np.linspace(breaks[0], breaks[-1], 1001)))


def box(middle: Array, half: float) -> Prism:
    """Return a prism from below the ground to the ceiling."""
    x, y = middle[:2]
    corners = [
        [x - half, y - half],
        [x - half, y + half],
        [x + half, y + half],
        [x + half, y - half],
    ]
    return Prism(corners, -1.0, 9.0)


def gap(motion: Motion, middle: Array, half: float) -> float:
    """Return the smallest horizontal distance of drones from a box [m]."""
    outside = np.maximum(np.abs(samples(motion)[..., :2] - middle[:2]) - half, 0.0)
    return float(np.min(np.linalg.norm(outside, axis=-1)))


@pytest.mark.parametrize("drone", [0, 3])
@pytest.mark.parametrize("place", [0, 1])
def test_prisms_stand_in_the_way(drone: int, place: int, tmp_path: Path) -> None:
    """One of two prisms is across the path of a drone, or at a distance from it."""
    motion = planned("triangle").motion
    across = samples(motion)[500, drone]
    away = across + 0.9 * np.append(across[:2] - np.mean(samples(motion)[500, :, :2], axis=0), 0.0)
    for middle, is_clear in ((across, False), (away, True)):
        prisms = [box(np.array([50.0, 50.0]), 0.1)]
        prisms.insert(place, box(middle, 0.05))
        walled = required(motion, keep_out=tuple(prisms))
        (_, one, other) = [None, *rows(walled, "keep_out", tmp_path)]
        row = (one, other)[place]
        assert isinstance(row, second.Row)
        assert (row.verdict == "proven") is is_clear
        assert row.worst == pytest.approx(gap(motion, middle, 0.05), abs=2e-3)


@pytest.mark.parametrize("tracking", [None, {"level": 0.03, "height": 0.05}])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_walls_are_as_far_as_drones_may_err(
    tracking: dict[str, float] | None, axis: int, side: float, tmp_path: Path
) -> None:
    """The floor alone needs no room for errors: drones stand on it."""
    motion = planned("triangle").motion
    points = np.concatenate([samples(motion), samples(motion, "vertices")], axis=1)
    lower, upper = np.full(3, -9.0), np.full(3, 9.0)
    farthest = side * float(np.max(side * points[..., axis])) + 0.2 * side
    (upper if side > 0.0 else lower)[axis] = farthest
    closed = required(motion, limits={"tracking": tracking}, arena=ho.Arena(lower, upper))
    errors = tracking or {"level": 0.0, "height": 0.0}
    error = errors["level"] if axis < 2 else errors["height"] if side > 0.0 else 0.0
    assert worst(closed, "arena", tmp_path) == pytest.approx(0.2 - error, abs=2e-3)


def test_cables_sag_toward_the_floor(tmp_path: Path) -> None:
    motion = planned("weight_hexagon").motion
    p, T = samples(motion, "vertices"), motion.team.tension
    ends = np.roll(p, -1, axis=1)
    # Level cables of span s hang by H/w (cosh σ - 1), for σ = w s / 2 H and T = H cosh σ
    share = motion.team.cable_density * GRAVITY * np.linalg.norm(ends - p, axis=-1) / (2.0 * T)
    sigma = share
    for _ in range(50):
        sigma = share * np.cosh(sigma)
    sag = np.linalg.norm(ends - p, axis=-1) * (np.cosh(sigma) - 1.0) / (2.0 * sigma)
    lowest = np.min(0.5 * (p + ends)[..., 2] - sag)
    floor = min(float(np.min(p[..., 2])), float(np.min(samples(motion)[..., 2]))) - 1e-3
    assert lowest < floor
    arena = ho.Arena([-9.0, -9.0, floor], [9.0, 9.0, 9.0])
    low = required(motion, limits={"tracking": None}, arena=arena)
    check = RULE_OF["arena"].check(low)
    assert check is not None
    found = worst(low, "arena", tmp_path)
    assert found == pytest.approx(lowest - floor, abs=1e-4)
    assert found == pytest.approx(check.worst, abs=1e-4)


def unproven(motion: Motion, folder: Path) -> tuple[set[str], set[str]]:
    """Return the names of limits without any value, of check and of verify."""
    flight = ho.Flight.of(motion)
    write_plan(folder / "plan.npz", flight)
    empty = {check.name for check in ho.certify(flight).checks if not check.is_evaluated}
    nothing = "nothing to check"
    return empty, {row.name for row in second.verify(folder) if row.verdict == nothing}


def test_limits_without_values_say_so_in_both(tmp_path: Path) -> None:
    pair = ho.Hitch.balanced(ho.Team(2, 1.6, topology="open"), [[-1, 0], [0, 1], [1, 0]], 1.2)
    held = ho.solve(pair, ho.Hold(1.0)).motion  # one piece, and no parts that could cross
    joined = ho.solve(pair, ho.Transport(to=[0.3, 0.0, 1.2])).motion
    assert unproven(held, tmp_path) == ({"continuity", "crossing"}, {"continuity", "crossing"})
    assert unproven(joined, tmp_path) == ({"crossing"}, {"crossing"})


def test_a_flight_compares_joints_of_a_team_of_several(tmp_path: Path) -> None:
    team, polygon = ho.Team(3, 2.4), np.array(ho.regular_polygon(3, 1.0).vertices)
    away = ho.Hitch.spread(team, polygon + 9.0, altitude=1.2)
    far = ho.solve(away, ho.Transport(to=[9.1, 9.0, 1.2])).motion
    near = ho.solve(ho.Hitch.spread(team, polygon, altitude=1.2), ho.Hold(far.duration)).motion
    flight = ho.Flight((TeamMotion("a", near), TeamMotion("b", far)))
    write_plan(tmp_path / "plan.npz", flight)
    verdicts = [row.verdict for row in second.verify(tmp_path) if row.name == "continuity"]
    assert {*verdicts} == {"proven"}


@pytest.mark.parametrize("reserve", [1.0, 0.6])
def test_reserves_are_left_for_stops(reserve: float, tmp_path: Path) -> None:
    motion = required(planned("triangle").motion, limits={"reserve": reserve})
    limits = motion.requirements.limits
    for name, limit in (
        ("speed", limits.speed),
        ("acceleration", reserve * limits.acceleration),
        ("jerk", reserve * limits.jerk),
    ):
        (row,) = rows(motion, name, tmp_path)
        assert row.limit == pytest.approx(limit)


@pytest.mark.parametrize("tracking", [0.02, {"level": 0.02, "height": 0.06}])
def test_distances_are_wider_by_errors_of_drones(tracking: Any, tmp_path: Path) -> None:
    """Both drones of a pair err; prisms do not."""
    motion = required(planned("triangle").motion, limits={"tracking": tracking})
    separation, leg = motion.requirements.separation, motion.requirements.limits.leg
    walled = required(motion, keep_out=(box(np.array([50.0, 50.0]), 0.1),))
    for name, limit in (
        ("cable_clearance", separation.cable + 0.04),
        ("crossing", separation.crossing + 0.04),
        ("legs", leg + 0.04),
        ("keep_out", separation.radius + 0.02),
    ):
        found = [row.limit for row in rows(walled, name, tmp_path)]
        assert found == pytest.approx([limit] * len(found))


@pytest.mark.parametrize("radius", [0.1, 0.13, 0.15, 0.17, 0.2, 0.26])
def test_ellipsoids_that_hold_keep_apart_with_all_errors(radius: float, tmp_path: Path) -> None:
    """No pair that is proven apart touches where both drones err by up to 4 cm."""
    rng, motion = np.random.default_rng(3), planned("triangle").motion
    separation = replace(motion.requirements.separation, radius=radius)
    near = required(motion, limits={"tracking": 0.04}, separation=separation)
    (row,) = rows(near, "separation", tmp_path)
    x = samples(motion)[::20]
    i, j = np.triu_indices(x.shape[1], 1)
    errors = rng.normal(size=(400, 3)) * [1.0, 1.0, 0.3]
    errors *= 0.08 / np.linalg.norm(errors, axis=-1, keepdims=True)
    gaps = (x[:, i] - x[:, j])[..., None, :] + errors
    scaled = gaps / (2.0 * np.array([separation.radius, separation.radius, separation.height]))
    least = float(np.min(np.linalg.norm(scaled, axis=-1)))
    assert (row.verdict == "proven") <= (least >= 1.0)
    assert (least >= 1.1) <= (row.verdict == "proven")


@pytest.mark.parametrize("tracking", [0.04, {"level": 0.03, "height": 0.07}])
@pytest.mark.parametrize("radius", [0.05, 0.12, 0.4])
def test_ellipsoids_contain_those_of_drones_with_errors(
    radius: float, tracking: Any, tmp_path: Path
) -> None:
    """By support functions: with the smallest radius, and then with the smallest height."""
    separation = replace(planned("triangle").motion.requirements.separation, radius=radius)
    motion = required(
        planned("triangle").motion, limits={"tracking": tracking}, separation=separation
    )
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    (own,), _ = second.read(tmp_path / "plan.npz")
    tube, (level, same_level, upright) = motion.requirements.limits.tube, 0.5 / own.scale
    angle = np.linspace(0.0, 0.5 * np.pi, 2001)

    def support(radius: float, height: float) -> Array:
        return np.asarray(np.hypot(radius * np.cos(angle), height * np.sin(angle)))

    needed = support(radius, separation.height) + support(tube.level, tube.height)
    assert level == same_level == pytest.approx(radius + tube.level)
    assert np.all(support(level, upright) >= needed - 1e-12)
    assert np.any(support(level, 0.99 * upright) < needed)


@pytest.mark.parametrize("tracking", [None, 0.03, {"level": 0.03, "height": 0.06}])
def test_hanging_cables_are_longer_than_chords_with_errors(tracking: Any, tmp_path: Path) -> None:
    plan = planned("form_square").motion
    hanging = slice_time(plan, plan.phases[0].start, plan.phases[0].end)
    motion = required(hanging, limits={"tracking": tracking})
    start, end = motion.drones.breaks[[0, -1]].tolist()
    times = np.linspace(start, end, 501)
    chords = motion.drones.at(times)[:, 1::2] - motion.drones.at(times)[:, 0::2]
    tube = motion.requirements.limits.tube
    if tube.level == tube.height:
        longest = np.linalg.norm(chords, axis=-1) + 2.0 * tube.level
    else:
        level = np.linalg.norm(chords[..., :2], axis=-1) + 2.0 * tube.level
        longest = np.hypot(level, np.abs(chords[..., 2]) + 2.0 * tube.height)
    (row,) = rows(motion, "span", tmp_path)
    assert row.worst == pytest.approx(np.max(longest / motion.team.cable_length), abs=1e-3)


def kinked(motion: Motion, order: int) -> Motion:
    """Return a motion with a jump of a derivative at a joint, and none of lower ones."""
    c = motion.drones.coefficients.copy()
    c[len(c) // 2, 1, 0, order] += 1e-3
    return motion.replaced(drones=motion.drones.replaced(c))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_no_derivative_up_to_the_acceleration_jumps(order: int, tmp_path: Path) -> None:
    motion = kinked(planned("triangle").motion, order)
    (row,) = rows(motion, "continuity", tmp_path)
    assert (row.verdict, row.where) == ("violated", motion.team.drone_names[1])
    breaks = motion.drones.breaks
    assert row.time == pytest.approx(breaks[motion.drones.pieces // 2])


def test_outlines_turn_once(tmp_path: Path) -> None:
    """A pentagram turns to one side everywhere, twice."""
    motion = planned("pentagon").motion
    for order, is_convex in (([0, 1, 2, 3, 4], True), ([0, 2, 4, 1, 3], False)):
        vertices = motion.vertices.replaced(motion.vertices.coefficients[:, order])
        shuffled = motion.replaced(vertices=vertices)
        turns = rows(shuffled, "outline_turn", tmp_path)
        assert [row.verdict == "proven" for row in turns] == [is_convex]
