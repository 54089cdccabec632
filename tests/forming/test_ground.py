"""Forming and releasing above a floor at any height, and without the ground."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.forming.steps import Form, Land, Release
from hitchopt.mission.starts import DronesStart
from hitchopt.steps import Step

OUTLINE = ho.ConvexPolygon([[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]])
Q = np.array([[-0.5, 1.0, 0.0], [-0.5, 0.0, 0.0], [-0.5, -1.0, 0.0]])
R = Q * [-1.0, 1.0, 1.0]


def tied_from(height: float, floor: float | None) -> ho.Problem:
    """Return the problem of a triangle that is tied from a height [m], untied and landed."""
    up = np.array([0.0, 0.0, height])
    steps: tuple[Step, ...] = (Form(OUTLINE, altitude=height + 1.3), Release(), Land())
    start = DronesStart(Q + up, R + up)
    return ho.Problem(ho.Team(3, 2.4), start, steps, limits=ho.Limits(floor=floor))


def untied_at(altitude: float, floor: float | None, *further: Step) -> ho.Problem:
    """Return the problem of a triangle that is untied at an altitude [m]."""
    start = ho.HitchStart(OUTLINE, altitude)
    steps = (Release(), *further)
    return ho.Problem(ho.Team(3, 2.4), start, steps, limits=ho.Limits(floor=floor))


@pytest.mark.parametrize("height", [-3.7, 2.5])
def test_a_floor_at_another_height_moves_the_plan_along(height: float) -> None:
    """Drones stand on it, cables lie on it at start and landing, and hang above it in flight."""
    plan, moved = ho.solve(tied_from(0.0, 0.0)), ho.solve(tied_from(height, height))
    assert moved.duration == pytest.approx(plan.duration, rel=1e-6)
    for t in np.linspace(0.0, plan.duration, 17):
        there = plan.at(t).positions + [0.0, 0.0, height]
        np.testing.assert_allclose(moved.at(t).positions, there, atol=1e-6)
    for found, other in zip(moved.certificate.checks, plan.certificate.checks, strict=True):
        shift = height if found.name == "floor" else 0.0
        assert found.holds
        if found.name not in ("stoppable", "continuity"):
            assert found.worst == pytest.approx(other.worst + shift, rel=1e-4, abs=1e-5), found.name
    assert moved.certificate["floor"].worst == pytest.approx(height, abs=1e-8)


@pytest.mark.parametrize("depth", [0.4, 2.0])
def test_a_release_below_the_floor_is_refused_unless_it_is_lower(depth: float) -> None:
    with pytest.raises(ho.InfeasibleError, match=r"floor: .* below the limit of 0 m"):
        ho.solve(untied_at(-depth, 0.0))
    assert ho.solve(untied_at(-depth, -depth - 3.0)).certificate.certified


@pytest.mark.parametrize(
    ("problem", "purpose"),
    [
        (tied_from(0.0, None), "a cable that hangs free"),
        (untied_at(1.5, None), "a cable that hangs free"),
    ],
)
def test_without_the_ground_it_is_asked_for(problem: ho.Problem, purpose: str) -> None:
    with pytest.raises(ho.InputError, match=rf"limits\.floor = None: .*{purpose} needs the ground"):
        ho.solve(problem)


def test_an_arena_is_the_ground_where_there_is_no_floor() -> None:
    options: dict[str, Any] = {"arena": ho.Arena([-4, -4, -0.5], [4, 4, 4])}
    problem = untied_at(1.5, None, Land())
    walled = ho.Problem(problem.team, problem.start, problem.mission, problem.limits, **options)
    end = ho.solve(walled).motion.drones.coefficients[-1, :, 2, -1]
    np.testing.assert_allclose(end, -0.5, atol=1e-9)
