"""Holds below a rim with any clasps, splits and rolls, where those of regular polygons fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from benchmarks.families import wild_carry
from hitchopt import verify
from hitchopt.carrying.hold_search import START_SPLITS, HoldSearch
from hitchopt.carrying.holds import RestHold
from hitchopt.carrying.polygons import rest_polygons
from hitchopt.geometry.vectors import length
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import RIM_CUT
from hitchopt.objects import Rim, Section

BODY = ho.SolidObject(
    Section(np.array([[-0.11, -0.08], [-0.11, 0.08], [0.11, 0.08], [0.11, -0.08]])),
    0.0,
    0.45,
    mass=0.2,
    rim=Rim(Section(np.array([[-0.3, -0.27], [-0.3, 0.27], [0.3, 0.27], [0.3, -0.27]])), 0.4),
)


def search_of(robots: int, cable: float) -> HoldSearch:
    team = ho.Team(robots, cable, cable_density=0.005, tension=1.0)
    polygons = rest_polygons("thing", BODY, robots, 0.08)[0]
    level = np.zeros(robots)
    start = RestHold(team, BODY, polygons.clasps, 0.4, np.full(robots, 0.5), level)
    around = replace(start, polygon=polygons.around)
    return HoldSearch(start, around, team.tension, Requirements(), 0.045)


def guess(search: HoldSearch, split: float) -> np.ndarray:
    clasps = search.start.polygon
    n = len(clasps)
    return np.column_stack([clasps, np.full(n, split), np.zeros(n)])


@pytest.mark.parametrize("robots", [3, 5, 6])
def test_margins_of_many_guesses_are_those_of_each(robots: int) -> None:
    search = search_of(robots, 1.35)
    rng = np.random.default_rng(robots)
    guesses = guess(search, 0.4) + 0.02 * rng.normal(size=(7, robots, 4))
    each = np.array([search.margins(one) for one in guesses])
    np.testing.assert_allclose(search.margins(guesses), each, atol=1e-12)


@pytest.mark.parametrize(("robots", "cable"), [(5, 1.37), (6, 1.3)])
def test_found_holds_keep_limits_that_regular_polygons_break(robots: int, cable: float) -> None:
    """Evaluated here from drones and clasps, without and with the whole weight."""
    search = search_of(robots, cable)
    for split in (0.5, *START_SPLITS):
        assert np.min(search.margins(guess(search, split))) < 0.0
    hold = next(search.holds())
    assert BODY.rim is not None
    rim = BODY.rim.section
    assert np.all(rim.clearance(hold.polygon)[0] < 0.0)
    assert np.min(hold.supports.shares) > 0.0
    for load_share in (0.0, 1.0):
        curves = hold.at_rest(hold.team.tension, load_share)
        drones, vertices = curves["drones"][0], curves["vertices"][0]
        scaled = drones / [0.24, 0.24, 0.6]
        apart = length(scaled[:, None] - scaled) + 9.0 * np.eye(len(drones))
        assert np.min(apart) > 1.0
        assert np.min(curves["legs"]) > 0.15
        for k, drone in enumerate(drones):
            clasp = vertices[hold.team.layout.anchors[k]]
            points = clasp + np.linspace(0.0, 1.0, 301)[:, None] * (drone - clasp)
            within = rim.clearance(points[:, :2])[0] <= 0.0
            assert np.max(points[within, 2]) <= hold.height + RIM_CUT


def test_no_hold_is_found_of_a_weight_that_tensions_do_not_bear() -> None:
    search = search_of(5, 1.37)
    heavy = ho.SolidObject(BODY.section, 0.0, 0.45, mass=2.0, rim=BODY.rim)
    search = replace(search, start=replace(search.start, body=heavy))
    assert np.all(search.margins(guess(search, 0.35)) == -np.inf)
    assert not list(search.holds())


def test_short_cables_hold_with_legs_that_change_while_they_close() -> None:
    """Around the object such legs are shorter than the limit."""
    rim = Rim(Section(radius=0.23), 0.38)
    body = ho.SolidObject(Section(radius=0.061), 0.0, 0.43, mass=0.6, rim=rim)
    team = ho.Team(5, 0.86, cable_density=0.003, tension=1.11)
    limits = ho.Limits(tilt_deg=60)
    polygons = rest_polygons("thing", body, 5, 0.08)[0]
    spread = ho.Hitch.spread(team, polygons.around, 1.0, limits=limits)
    legs = spread.fractions, spread.roll
    around = RestHold(team, body, polygons.around, 0.38, *legs)
    start = replace(around, polygon=polygons.below_rim[0])
    search = HoldSearch(start, around, team.tension, Requirements(limits), 0.045)
    hold = next(search.holds())
    at_once = replace(hold, polygon=around.polygon).at_rest(team.tension, 0.0)["legs"]
    assert np.min(at_once) < limits.leg
    changed = search.changed_legs(hold).at_rest(team.tension, 0.0)["legs"]
    assert np.min(changed) > limits.leg


def test_holds_keep_clear_of_other_objects() -> None:
    search = search_of(5, 1.37)
    first = next(search.holds())
    drones = first.at_rest(first.team.tension, 1.0)["drones"][0]
    post = ho.SolidObject(Section(radius=0.05), 0.0, 1.0, at=[*drones[0, :2], 0.0], fixed=True)
    beside = replace(search, requirements=Requirements(objects={"post": post}))
    other = next(beside.holds())
    found = np.column_stack([first.polygon, first.fractions, first.roll])
    assert np.min(beside.margins(found)) < 0.0
    for load_share in (0.0, 1.0):
        drones = other.at_rest(other.team.tension, load_share)["drones"][0]
        gaps = np.linalg.norm(drones[:, :2] - post.at[:2], axis=1) - 0.05
        assert np.min(gaps) > Requirements().separation.radius


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 27, 39, 1039])
def test_objects_are_carried_on_found_holds(seed: int, tmp_path: Path) -> None:
    plan = ho.solve(ho.problem_from_dict(wild_carry(seed)))
    assert plan.certificate.certified
    plan.save(tmp_path, picture=False)
    assert {row.verdict for row in verify.verify(tmp_path)} <= set(verify.PASSING)
