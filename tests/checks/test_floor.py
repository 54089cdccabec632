"""The check ``floor``: motion below it is refused, whatever flies, and moves along with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.checks import Check, certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.steps import Step
from hitchopt.steps.moving import Adjust, FollowVertex, Hold, Morph, MoveEdge, MoveVertex, Transport
from tests.helpers.by_hand import sampled
from tests.helpers.motions import (
    altered,
    lines,
    loaded_motion,
    plus,
    random_chain,
    random_curves,
    random_motion,
    replaced,
    row,
    single,
    triangle,
)
from tests.helpers.refusals import assert_refused

SQUARE = ho.ConvexPolygon([[0.7, 0.6], [0.7, -0.6], [-0.6, -0.7], [-0.7, 0.6]])
OTHER = ho.ConvexPolygon([[0.8, 0.6], [0.7, -0.6], [-0.6, -0.6], [-0.7, 0.7]])
CORNER = SQUARE.vertices[1]
LEVEL = {"legs": "balanced"}
ROLLED = {"legs": {"sharing": "balanced", "roll_deg": [20.0, 10.0, -15.0, 25.0]}}
STEPS: dict[str, Callable[[float], Step]] = {
    "hold": lambda _: Hold(0.5),
    "morph": lambda _: Morph(OTHER),
    "move_vertex": lambda _: MoveVertex(0, by=np.array([-0.1, 0.0])),
    "move_edge": lambda _: MoveEdge(2, by=np.array([0.02, 0.1])),
    "follow_vertex": lambda _: FollowVertex(
        1, np.array([[1.5, CORNER[0] + 0.05, CORNER[1]], [3.0, *CORNER]])
    ),
    "adjust": lambda _: Adjust("spread"),
    "transport": lambda z: Transport(np.array([0.3, 0.2, z + 0.2])),
}
"""Steps of a square at an altitude [m], none of which needs the ground."""


def square(altitude: float, step: str, legs: dict[str, Any], floor: float | None) -> ho.Problem:
    """Return the problem of a step of a square hitch."""
    team = ho.Team(4, 2.4)
    start = ho.HitchStart(SQUARE, altitude, **legs)
    return ho.Problem(team, start, (STEPS[step](altitude),), limits=ho.Limits(floor=floor))


def chain(altitude: float, floor: float | None) -> ho.Problem:
    """Return the problem of an open chain."""
    outline = [[-1.6, -0.8], [-0.8, 0.5], [0.8, 0.5], [1.6, -0.8]]
    team = ho.Team(3, 3.0, topology="open")
    steps = (MoveVertex(1, by=np.array([0.05, 0.05])),)
    return ho.Problem(team, ho.HitchStart(outline, altitude), steps, limits=ho.Limits(floor=floor))


PROBLEMS: dict[str, Callable[[float, float | None], ho.Problem]] = {
    **{
        name: lambda z, floor, name=name: square(z, name, LEVEL, floor)  # type: ignore[misc]
        for name in STEPS
    },
    "rolled legs": lambda z, floor: square(z, "morph", ROLLED, floor),
    "open chain": chain,
}


def moved_up(motion: Motion, by: float) -> Motion:
    """Return a motion at other heights [m], without objects."""
    up = plus((..., 2, slice(None)), by)
    return altered(altered(motion, "drones", up), "vertices", up)


@pytest.mark.parametrize("kind", PROBLEMS)
@settings(max_examples=3)
@given(depth=st.floats(0.01, 5.0))
def test_every_step_below_the_floor_is_refused_unless_it_is_lower(kind: str, depth: float) -> None:
    """And it is as far from a floor that moves along, in as much time."""
    problem = PROBLEMS[kind]
    with pytest.raises(ho.InfeasibleError) as refused:
        ho.solve(problem(-depth, 0.0))
    assert {each.constraint for each in refused.value.violations} == {"floor"}
    assert "lower limits.floor" in str(refused.value)
    low, high = ho.solve(problem(-depth, -3.0 - depth)), ho.solve(problem(3.0, 0.0))
    assert low.duration == pytest.approx(high.duration, rel=1e-6)
    for found, other in zip(low.certificate.checks, high.certificate.checks, strict=True):
        heights = [each.number if each.name == "floor" else 0.0 for each in (found, other)]
        assert found.holds, found.name
        if found.name not in ("stoppable", "continuity"):
            worst = found.worst - heights[0]
            assert worst == pytest.approx(other.worst - heights[1], rel=1e-5, abs=1e-5), found.name


@settings(max_examples=20)
@given(depth=st.floats(1e-6, 100.0), floor=st.floats(-50.0, 50.0))
def test_single_drones_keep_above_any_floor(depth: float, floor: float) -> None:
    places = np.array([[0.0, 0.0, floor], [1.0, 0.0, floor + 1.0]])
    flown = replaced(lines(places, places + [0.0, 0.0, 1.0]), floor=floor)
    stands = row(flown, "floor")
    assert stands.holds
    assert stands.worst == pytest.approx(floor, abs=1e-9 * abs(floor) + 1e-9)
    sunk = row(replaced(flown, floor=floor + depth), "floor")
    assert not sunk.holds
    assert sunk.where == ("d0",)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["ring", "chain", "loaded", "single"])
def test_no_sample_is_lower_than_the_bound(kind: str, seed: int) -> None:
    """Heavy cables sag below all vertices; bounds are that of parabolas."""
    motion = {
        "ring": lambda: random_motion(4, seed),
        "chain": lambda: random_chain(4, seed),
        "loaded": lambda: loaded_motion(seed, 4),
        "single": lambda: single(random_curves(3, seed)),
    }[kind]()
    start, end = motion.drones.breaks[[0, -1]].tolist()
    times = np.linspace(start, end, 2001)
    lowest = sampled(motion, times, {"floor"})["floor"]
    found = row(motion, "floor")
    assert found.worst <= lowest + 1e-9
    assert found.worst >= lowest - (5e-3 if kind == "loaded" else 1e-3)


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_bound_decides_at_the_lowest_point(sense: float) -> None:
    motion = loaded_motion(1, 3)
    lowest = row(motion, "floor")
    floor = lowest.worst + sense * 1e-3
    assert row(replaced(motion, floor=floor), "floor").holds is (sense < 0.0)


def test_without_a_floor_there_is_no_row_and_an_arena_is_the_ground() -> None:
    motion = moved_up(triangle(), -3.0)
    assert RULE_OF["floor"].check(replaced(motion, floor=None)) is None
    for floor, lower, ground in (
        (0.0, None, 0.0),
        (0.0, -2.0, 0.0),
        (-2.0, 0.5, 0.5),
        (None, -7.0, -7.0),
        (None, None, None),
    ):
        arena = None if lower is None else ho.Arena([-9, -9, lower], [9, 9, 9])
        assert Requirements(ho.Limits(floor=floor), arena=arena).floor == ground


@pytest.mark.parametrize("lower", [-9.0, -1.0, 0.3])
def test_an_arena_below_the_floor_does_not_lower_it(lower: float) -> None:
    motion = moved_up(triangle(), -1.5)
    arena = ho.Arena([-99, -99, lower], [99, 99, 99])
    walled = motion.replaced(requirements=replace(motion.requirements, arena=arena))
    assert {each.name for each in certify(walled).violated} >= {"floor"}
    free = row(replaced(walled, floor=None), "arena")
    assert free.worst == pytest.approx(-0.5 - lower)


def test_tracking_errors_may_reach_the_floor_but_not_where_drones_stand_on_it() -> None:
    """A drone that is raised straight from the floor does not count; one beside it does."""
    places = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.07]])
    raised = lines(places, places + [[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]])

    def radius(floor: float | None) -> Check:
        return row(replaced(raised, floor=floor), "tracking_radius")

    assert radius(0.0).worst == pytest.approx(0.07, rel=1e-6)
    assert radius(0.0).binding == "floor"
    assert radius(-0.02).worst == pytest.approx(0.02, rel=1e-6)
    assert radius(None).worst > 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf, "low", True, [0.0]])
def test_floors_are_heights_or_null(value: Any) -> None:
    assert_refused(lambda: ho.Limits(floor=value), "floor", "")
    assert ho.Limits().floor == 0.0
    assert ho.Limits(floor=None).floor is None


def test_what_needs_the_ground_names_the_floor_without_one() -> None:
    with pytest.raises(ho.InputError, match=r"limits\.floor = None.*a landing needs the ground"):
        Requirements(ho.Limits(floor=None)).ground_for("a landing")
