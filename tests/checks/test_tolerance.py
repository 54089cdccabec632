"""Limits that are met to the last digit hold, by the tolerance of checks and by nothing more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from motions import row

import hitchopt as ho
from hitchopt.checks import Check
from hitchopt.hitch.requirements import Requirements
from hitchopt.steps.certified_motions import at_rest

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


def rest(**kept: Any) -> ho.Certificate:
    return at_rest(HITCH, Requirements(**kept)).certificate


def test_limits_that_a_hitch_meets_to_the_last_digit_hold() -> None:
    usual = rest()
    legs = np.linalg.norm(HITCH.drones - HITCH.vertices[TEAM.layout.anchors], axis=1)
    exact = {"leg": float(np.min(legs)), "tilt": math.radians(usual["tilt"].bound)}
    radius = 0.12 * usual["separation"].bound
    met = rest(
        limits=ho.Limits(**exact),
        separation=ho.Separation(radius=radius, cable=usual["cable_clearance"].bound),
        arena=ho.Arena(np.min(HITCH.drones, axis=0), np.max(HITCH.drones, axis=0) + [0, 0, 1]),
    )
    assert met.certified, met.violated
    assert met["arena"].bound == pytest.approx(0.0, abs=1e-9)
    assert met["legs"].bound < exact["leg"]  # a bound still, rounding included
    for name, off in (("leg", 1e-6), ("tilt", -1e-6)):
        assert not rest(limits=ho.Limits(**{name: exact[name] * (1.0 + off)})).certified


@pytest.mark.parametrize("duration", [0.1 + 0.2, 0.3 * (1.0 - 5e-10)])
def test_a_plan_whose_duration_is_its_limit_is_certified(duration: float) -> None:
    certificate = ho.hold(HITCH, 0.3, limits=ho.Limits(duration=duration)).certificate
    assert certificate.certified
    assert certificate["duration"].worst == pytest.approx(0.3, abs=1e-16)


def passing(apart: Any, **kept: Any) -> ho.SwarmProblem:
    """Two drones that exchange places, or that go apart."""
    start = np.array([[0.0, 0.5, 1.0], [apart, 0.5, 1.0]])
    goal = start[::-1].copy() if apart > 1.0 else start + [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    return ho.SwarmProblem(ho.Swarm(2), start, goal, **kept)


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
    slow, polygon = ho.Limits(**{name: limit}), ho.regular_polygon(3, 0.9)
    for plan in (ho.separate(passing(3.0, limits=slow)), ho.morph(HITCH, polygon, limits=slow)):
        assert plan.certificate.certified
        assert plan.certificate[name].bound <= limit
        ends = plan.motion.drones.at(np.array([0.0, plan.duration]))
        farthest = float(np.max(np.linalg.norm(ends[1] - ends[0], axis=-1)))
        least = farthest / limit if name == "speed" else 2.0 * math.sqrt(farthest / limit)
        assert least < plan.duration < 1.3 * least
