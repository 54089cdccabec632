"""Masses on rims: legs that would cut the rim bound them, and another number of robots is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.motion.loads import RIM_CUT
from hitchopt.objects import Rim, Section
from hitchopt.outline_fit import fit
from hitchopt.planners.carrying.capacity import CUT_RESOLUTION, best_rim_hold, team_for_rim
from hitchopt.planners.carrying.holds import RestHold
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.planners.carrying.polygons import EDGE_MARGIN, rest_polygons
from hitchopt.values import Array
from problems.random_morph import is_certified

GAP = 0.035 + EDGE_MARGIN
LIMITS = Limits(tilt=np.radians(60.0))
STEPS = np.linspace(0.0, 1.0, 4001)[:, None]


def rectangle(half_widths: tuple[float, float], at: tuple[float, float] = (0.0, 0.0)) -> Array:
    corners = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    return corners * half_widths + at


def oblong(mass: float) -> ho.SolidObject:
    """An object with a rim twice as wide as its body, off the origin of its frame."""
    stem = Section(rectangle((0.095, 0.13), (0.05, -0.03)))
    rim = Rim(Section(rectangle((0.19, 0.26), (0.05, -0.03))), 0.35)
    return ho.SolidObject(stem, 0.0, 0.4, mass=mass, rim=rim)


def highest_at_rim(body: ho.SolidObject, clasps: Array, cable: float, tension: float) -> float:
    """The largest height [m] above the rim of samples of straight loaded legs inside of it."""
    n = len(clasps)
    team = ho.Team(n, cable, tension=tension)
    rim = body.rim
    assert rim is not None
    hold = RestHold(team, body, clasps, rim.height, np.full(n, 0.5), np.zeros(n))
    tensions = np.stack([team.tension, team.tension])
    rest = Move(np.zeros(4), np.zeros(4), tensions, (1.0, 1.0), SmoothLaw(1.0))
    curves = hold.curves(rest, np.zeros(1))
    vertices, drones = curves["vertices"][0], curves["drones"][0]
    highest = -np.inf
    for k in range(n):
        for drone, clasp in ((2 * k, k), (2 * k + 1, (k + 1) % n)):
            leg = vertices[clasp] + STEPS * (drones[drone] - vertices[clasp])
            is_inside = rim.section.clearance(leg[:, :2])[0] <= 0.0
            highest = max(highest, float(np.max(leg[is_inside, 2])) - rim.height)
    return highest


def test_the_capacity_is_where_sampled_legs_cut_the_rim() -> None:
    cable, tension = 1.37, 1.0
    polygons = rest_polygons("thing", oblong(0.2), 5, GAP)[0]
    load = polygons, cable, tension, ho.Quadrotor(), Requirements(LIMITS)
    clasps, capacity = best_rim_hold(oblong(0.2), *load)
    assert capacity.binding == "object_clearance"
    lighter, heavier = capacity.mass - CUT_RESOLUTION, capacity.mass + 2.0 * CUT_RESOLUTION
    assert highest_at_rim(oblong(lighter), clasps, cable, tension) <= RIM_CUT
    assert highest_at_rim(oblong(heavier), clasps, cable, tension) > RIM_CUT


def test_fit_counts_legs_that_cut_the_rim() -> None:
    held = fit(rectangle((0.19, 0.26)), 5, stem=0.1, height=0.35, tension=1.0, limits=LIMITS)
    capacities = held.capacities("rest")
    assert capacities[5].binding == "object_clearance"
    assert "number of robots" in capacities[5].suggested
    assert capacities[4].mass > capacities[5].mass


def mission(robots: int, mass: float, cable: float) -> dict[str, Any]:
    angles = 0.3 - 2.0 * np.pi * np.arange(robots) / robots
    radius = 0.36 / np.sin(np.pi / robots)
    hitch = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    body = {
        "at": [2.0, 0.4, 0.0],
        "outline": rectangle((0.095, 0.13)).tolist(),
        "to": 0.4,
        "rim": {"at": 0.35, "outline": rectangle((0.19, 0.26)).tolist()},
        "mass": mass,
    }
    return {
        "team": {"robots": robots, "cable_length": cable, "tension": 1.0, "cable_density": 0.005},
        "limits": {"tilt_deg": 60},
        "objects": {"thing": body},
        "start": {"hitch": {"polygon": np.round(hitch, 3).tolist(), "altitude": 1.3}},
        "mission": [{"transport_object": {"object": "thing", "to": [3.4, 1.0, 0.0]}}],
    }


@pytest.mark.slow
def test_drones_beside_the_held_object_need_longer_cables_not_another_place() -> None:
    with pytest.raises(ho.InfeasibleError) as refused:
        ho.solve(ho.problem_from_dict(mission(5, 0.05, 1.35)))
    (violation,) = refused.value.violations
    assert violation.constraint == "keep_out"
    assert violation.remedy.endswith("or use longer cables")
    with pytest.raises(ho.InfeasibleError) as longer:
        ho.solve(ho.problem_from_dict(mission(5, 0.05, 1.6)))
    assert "keep_out" not in {each.constraint for each in longer.value.violations}


@pytest.mark.slow
def test_the_number_of_robots_that_a_refusal_names_holds_the_object() -> None:
    mass = 0.19
    with pytest.raises(ho.InfeasibleError, match="use 4 robots") as refused:
        ho.solve(ho.problem_from_dict(mission(5, mass, 1.4)))
    load, *_ = refused.value.violations
    assert load.constraint == "load"
    assert 0.0 < load.limit < mass
    assert ho.solve(ho.problem_from_dict(mission(4, mass, 1.5))).certificate.certified


def test_another_team_is_named_with_cables_that_it_needs() -> None:
    requirements = Requirements(LIMITS)
    rest = 1.0, ho.Quadrotor(), requirements, GAP
    assert team_for_rim(5, oblong(0.19), 1.4, *rest) == (4, 1.4)
    other = team_for_rim(5, oblong(0.19), 0.7, *rest)
    assert other is not None
    assert other.robots == 4
    around = rest_polygons("thing", oblong(0.19), 4, GAP)[0].around.tolist()
    start = {"hitch": {"polygon": around, "altitude": 1.0, "legs": "spread"}}
    certified = [
        is_certified({"robots": 4, "cable_length": length, "tension": 1.0}, start)
        for length in (0.7, other.cable_length)
    ]
    assert certified == [False, True]


def test_no_team_is_named_for_what_none_holds() -> None:
    requirements = Requirements(LIMITS)
    assert team_for_rim(5, oblong(5.0), 1.4, 1.0, ho.Quadrotor(), requirements, GAP) is None
