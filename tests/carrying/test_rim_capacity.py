"""Masses on rims: legs that would cut the rim bound them, and another number of robots is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.carrying.grasps import (
    MASS_RESOLUTION,
    HoldJudge,
    hold_polygons,
    team_for_rim,
)
from hitchopt.carrying.holds import RestHold
from hitchopt.carrying.moves import Move, SmoothLaw
from hitchopt.carrying.outline_fit import fit
from hitchopt.carrying.polygons import EDGE_MARGIN
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import Rim, Section
from hitchopt.values import Array

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


def search(robots: int, mass: float, cable: float) -> HoldJudge:
    """The search for holds of the oblong by its rim, at a tension of 1 N."""
    requirements = Requirements(LIMITS, objects={"thing": oblong(mass)})
    team = ho.Team(robots, cable, tension=1.0)
    polygons = hold_polygons("thing", team, requirements, HoldBy.REST, GAP)
    return HoldJudge.of("thing", team, requirements, polygons)


def test_the_heaviest_object_is_held_and_no_heavier_one() -> None:
    searched = search(4, 0.2, 1.4)
    mass = searched.heaviest.capacity.mass
    hold = searched.heaviest.hold
    assert hold is not None
    assert searched.with_mass(mass).violation(hold) is None
    assert not searched.carries((1.0 + 2.0 * MASS_RESOLUTION) * mass)


@pytest.mark.slow
def test_fit_counts_weight_cables_and_drones_beside_the_object() -> None:
    """What it states is what the search around that object holds, with its cables."""
    size: dict[str, Any] = {
        "stem": 0.061,
        "height": 0.38,
        "tension": 1.11,
        "limits": LIMITS,
        "compared": (),
    }
    holding = fit(0.23, 5, **size).holding
    stated = holding.rest_capacity.mass
    body = ho.SolidObject(
        Section(radius=0.061), 0.0, 0.43, mass=stated, rim=Rim(Section(radius=0.23), 0.38)
    )
    requirements = Requirements(LIMITS, objects={"thing": body})
    team = ho.Team(5, holding.cable_length, tension=1.11, cable_density=0.003)
    polygons = hold_polygons("thing", team, requirements, HoldBy.REST, GAP)
    searched = HoldJudge.of("thing", team, requirements, polygons)
    resolution = 1.0 - MASS_RESOLUTION
    assert searched.with_mass(0.95 * stated).heaviest.capacity.mass >= resolution * stated
    assert searched.heaviest.capacity.mass < 1.05 * stated
    heavier = fit(0.23, 5, mass=1.1 * stated, **size).holding
    assert heavier.cable_length > holding.cable_length


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
@pytest.mark.parametrize(("mass", "cable"), [(0.05, 1.35), (0.19, 1.4)])
def test_objects_are_carried_as_legs_change_while_they_close(mass: float, cable: float) -> None:
    plan = ho.solve(ho.problem_from_dict(mission(5, mass, cable)))
    assert plan.certificate.certified


def test_another_team_is_named_with_cables_that_it_needs() -> None:
    other = team_for_rim(search(5, 0.19, 1.4))
    assert other is not None
    assert other.robots == 4
    longer = float(other.cable_length[0])
    assert search(4, 0.19, longer).carries(0.19)


def test_no_team_is_named_for_what_none_holds() -> None:
    assert team_for_rim(search(5, 5.0, 1.4)) is None
