"""Limits that are met to the last digit hold, by the tolerance of checks and by nothing more."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

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
    allowed = 1e-9 * max(limit, size)

    def check(beyond: float) -> Check:
        return Check.of("legs", limit + out * beyond, limit, sense, "m", 0.0, (), size)

    assert check(0.9 * allowed).holds
    assert not check(1.1 * allowed).holds
    assert check(0.9 * allowed).worst == limit + out * 0.9 * allowed


def rest(limits: ho.Limits, separation: ho.Separation, arena: ho.Arena | None) -> ho.Certificate:
    return at_rest(HITCH, Requirements(limits, separation, arena)).certificate


def test_limits_that_a_hitch_meets_to_the_last_digit_hold() -> None:
    usual = rest(ho.Limits(), ho.Separation(), None)
    legs = np.linalg.norm(HITCH.drones - HITCH.vertices[TEAM.layout.anchors], axis=1)
    exact = {"leg": float(np.min(legs)), "tilt": math.radians(usual["tilt"].bound)}
    scale = usual["separation"].bound
    separation = ho.Separation(radius=0.12 * scale, cable=usual["cable_clearance"].bound)
    wall = ho.Arena(np.min(HITCH.drones, axis=0), np.max(HITCH.drones, axis=0) + [0, 0, 1])
    met = rest(ho.Limits(**exact), separation, wall)
    assert {"legs", "tilt", "separation", "cable_clearance", "arena"} <= {
        c.name for c in met.checks
    }
    assert met.certified, met.violated
    assert met["legs"].bound < exact["leg"]  # a bound still, rounding included
    for name, value in exact.items():
        off = 1e-6 if name == "leg" else -1e-6
        broken = rest(ho.Limits(**{name: value * (1.0 + off)}), ho.Separation(), None)
        assert not broken.certified


def test_a_plan_whose_duration_is_its_limit_is_certified() -> None:
    limits = ho.Limits(duration=0.1 + 0.2)  # 0.30000000000000004
    plan = ho.hold(HITCH, 0.3, limits=limits)
    assert plan.certificate.certified
    exact = replace(limits, duration=0.3 * (1.0 - 5e-10))
    assert ho.hold(HITCH, 0.3, limits=exact).certificate["duration"].worst == 0.3


def swarm(**options: object) -> ho.SwarmProblem:
    ends = np.array([[-1.5, 0.5, 1.0], [1.5, 0.5, 1.0]])
    return ho.SwarmProblem(ho.Swarm(2), ends, ends[::-1].copy(), **options)  # type: ignore[arg-type]


def test_drones_may_start_on_a_wall_and_touching() -> None:
    walls = ho.Arena([-1.5, -4.0, 0.0], [1.5, 4.0, 3.0])
    assert ho.separate(swarm(arena=walls)).certificate["arena"].holds
    start = np.array([[0.0, 0.0, 1.0], [0.24, 0.0, 1.0]])
    goal = start + np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    plan = ho.separate(ho.SwarmProblem(ho.Swarm(2), start, goal))
    assert plan.certificate.certified
    closer = start + np.array([[1e-8, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(ho.InfeasibleError, match="separation"):
        ho.separate(ho.SwarmProblem(ho.Swarm(2), closer, goal))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
@pytest.mark.parametrize("limits", [{"speed": 1e-6}, {"acceleration": 1e-9}])
def test_the_slowest_limits_are_planned(limits: dict[str, float]) -> None:
    slow = ho.Limits(**limits)
    ((name, limit),) = limits.items()
    polygon = ho.regular_polygon(3, 0.9)
    for plan in (ho.separate(swarm(limits=slow)), ho.morph(HITCH, polygon, limits=slow)):
        assert plan.certificate.certified
        assert plan.certificate[name].bound <= limit
        ends = plan.motion.drones.at(np.array([0.0, plan.duration]))
        farthest = float(np.max(np.linalg.norm(ends[1] - ends[0], axis=-1)))
        least = farthest / limit if name == "speed" else 2.0 * math.sqrt(farthest / limit)
        assert least < plan.duration < 1.3 * least


def test_what_a_double_does_not_resolve_is_said_to_be_so() -> None:
    with pytest.raises(ho.InputError, match=r"altitude = 1000000000\.0: must be within"):
        ho.Hitch.spread(TEAM, ho.regular_polygon(3, 1.0), altitude=1e9)
    with pytest.raises(ho.InputError, match=r"start\[0\]"):
        ho.SwarmProblem(ho.Swarm(1), [[0.0, 0.0, 1e9]], [[0.0, 0.0, 1.0]])  # type: ignore[arg-type]
