"""Compiled planning says what that in numpy says, to rounding."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.compiled.kernel_switch import kernels
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_lengths import reference_margin, reference_margins
from hitchopt.hitch.leg_task import LegTask
from hitchopt.planners.path.shape_path import ShapePath, path_jets, shapes_along
from hitchopt.planners.timing import time_warp
from hitchopt.planners.timing.demands import Demands
from hitchopt.planners.timing.fastest_rate import RateProgram, fastest_rate
from hitchopt.planners.timing.fly_path import fly
from hitchopt.planners.timing.speed_profile import TimingError, fastest_profile, path_grid
from hitchopt.planners.timing.time_estimates import quick_profile
from hitchopt.requirements import Requirements
from hitchopt.values import Array
from problems.random_morph import random_convex_polygon

T = TypeVar("T")

LIMITS = (
    ho.Limits(),
    ho.Limits(speed=0.5, vertex_speed=5.0, acceleration=1.0),
    ho.Limits(speed=3.0, vertex_speed=3.0, tilt=math.radians(20.0), jerk=60.0),
)


@pytest.fixture(autouse=True)
def _needs_numba() -> None:
    pytest.importorskip("numba")


def straight(seed: int) -> ShapePath:
    """Return a random turn and shift, off the origin; tensions are equal for even seeds."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 8))
    first = random_convex_polygon(n, 1.2, rng, 0.18)
    last = first.rotated(rng.uniform(-0.4, 0.4)).translated(0.3 * rng.normal(size=2))
    team = Team(n, 2.4, tension=rng.uniform(0.38, 0.42, n) if seed % 2 else 0.4)
    return ShapePath.straight(Hitch.balanced(team, first), Hitch.balanced(team, last))


def chain() -> ShapePath:
    """Return an open chain that moves and turns."""
    team = Team(3, [2.0, 2.1, 1.9], topology="open")
    arc = np.array([[0.0, 0.0], [0.5, 0.9], [1.4, 1.2], [2.3, 0.9]])
    moved = arc @ np.array([[0.98, 0.199], [-0.199, 0.98]]) + [0.3, 0.1]
    return ShapePath.straight(Hitch.balanced(team, arc), Hitch.balanced(team, moved))


def both(work: Callable[..., T], *given: object) -> tuple[T, T]:
    """Return what work returns in numpy, and compiled."""
    plain = work(*given)
    with kernels():
        return plain, work(*given)


@pytest.mark.parametrize("path", [straight(0), straight(1), straight(2), chain()])
def test_jets_of_paths(path: ShapePath) -> None:
    s = np.linspace(0.0, 1.0, 23)
    plain = path_jets(path, s)
    with kernels():
        compiled = path_jets(path, s)
    for one, other in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", range(3))
def test_what_limits_allow_and_profiles(seed: int, limits: ho.Limits) -> None:
    path, s = straight(seed), path_grid(60)
    demands = Demands.along(path, limits, s)
    angle = np.linspace(0.0, math.pi, 17)
    u, x = (np.tile(values, (len(s), 1)) for values in (3.0 * np.cos(angle), np.sin(angle)))
    np.testing.assert_allclose(*both(demands.reach, u, x), rtol=1e-12)
    for profile in (quick_profile, fastest_profile):
        plain = profile(s, demands).speed
        with kernels():
            compiled = profile(s, demands).speed
        np.testing.assert_allclose(compiled, plain, rtol=1e-9, atol=1e-9)


def test_profiles_that_do_not_exist_are_refused() -> None:
    path, s = straight(0), path_grid(60)
    demands = Demands.along(path, ho.Limits(tilt=math.radians(8.0)), s)
    with kernels():
        assert np.all(demands.reach(np.ones((61, 1)), np.ones((61, 1))) == 0.0)
        for profile in (quick_profile, fastest_profile):
            with pytest.raises(TimingError):
                profile(s, demands)


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", range(3))
def test_fastest_rates(seed: int, limits: ho.Limits, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[RateProgram, Array]] = []

    def recorded(program: RateProgram, start: Array) -> Array:
        calls.append((program, start))
        return fastest_rate(program, start)

    monkeypatch.setattr(time_warp, "fastest_rate", recorded)
    fly(straight(seed), limits)
    for program, start in calls:
        plain, compiled = both(fastest_rate, program, start)
        assert np.max(np.abs(plain - start)) > 0.01
        np.testing.assert_allclose(compiled, plain, rtol=1e-10)
        np.testing.assert_array_equal(*both(fastest_rate, program, 1e9 * plain))


@pytest.mark.parametrize("seed", range(40))
def test_margins_of_hitches(seed: int) -> None:
    """Those beyond the wanted margin may be any number beyond it."""
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(3, 9)), int(rng.integers(1, 12))
    polygons = np.stack([random_convex_polygon(n, 1.1, rng).vertices for _ in range(count)])
    team = Team(n, 2.0, tension=rng.uniform(0.38, 0.42, n) if seed % 2 else 0.4)
    margin = rng.uniform(0.5, 1.6, count) if seed % 3 else 1.05
    fixed = rng.uniform(size=count) < 0.3 if seed % 4 == 1 else None
    slack = LegTask(team, Requirements(), polygons, np.zeros((count, n)), 0.0, 1.0).slack
    q_legs = rng.uniform(0.25, 0.75, (count, n)) * slack
    task = LegTask(team, Requirements(), polygons, q_legs, 0.0, margin, fixed=fixed)
    for margins in both(reference_margins, task), both(reference_margin, task):
        plain, compiled = np.minimum(margins, task.wanted)
        np.testing.assert_allclose(compiled, plain, rtol=1e-12, atol=1e-12)


def test_margins_of_chains() -> None:
    path = chain()
    shapes = shapes_along(path, np.linspace(0.0, 1.0, 9))
    for margin in (1.2, 2.5):
        task = LegTask(path.team, Requirements(), shapes.polygons, shapes.legs[..., 0], 0.0, margin)
        plain, compiled = np.minimum(both(reference_margins, task), margin)
        np.testing.assert_allclose(compiled, plain, rtol=1e-12)
    assert np.min(plain) < margin


def test_an_optimised_morph() -> None:
    square = ho.regular_polygon(4, 1.3)
    start = Hitch.spread(Team(4, 2.0), square)
    goal = square.rotated(0.3)
    plain = ho.morph(start, goal, optimize=True)
    with kernels():
        compiled = ho.morph(start, goal, optimize=True)
    assert compiled.certificate.certified
    np.testing.assert_allclose(compiled.motion.drones.breaks, plain.motion.drones.breaks, rtol=1e-9)
    np.testing.assert_allclose(
        compiled.motion.drones.coefficients, plain.motion.drones.coefficients, atol=1e-9
    )
