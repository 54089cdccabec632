"""Robots join a hitch in flight, leave it and are replaced: rings, outlines, senses, refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import PROBLEMS, planned

import hitchopt as ho
from hitchopt.mission.problem import DronesStart, HitchStart
from hitchopt.motion.chapters import chapters
from hitchopt.motion.motion import CableState
from hitchopt.planners.forming.ring_change import corner_cut, corner_restored
from hitchopt.planners.timing.ramps import MIN_PHASE, fastest_clock, fastest_ramps
from hitchopt.steps.ring_change import cut_outlines
from hitchopt.steps.step import RolledLegs

Q = np.array([[-0.8, 1.8, 0], [-0.8, 0.6, 0], [-0.8, -0.6, 0], [-0.8, -1.8, 0], [-2.8, -1.0, 0]])
R = Q + [1.6, 0.0, 0.0]
R[4] = [-2.8, 0.6, 0.0]
SQUARE = [[-0.6, 0.6], [0.6, 0.6], [0.6, -0.6], [-0.6, -0.6]]
TRIANGLE = [[0.0, 0.808], [0.7, -0.404], [-0.7, -0.404]]


def mission(spares: int = 1, **form: Any) -> ho.Mission:
    """Four robots tied to a square, and spare ones that wait beside each other."""
    team = ho.Team(robots=4 + spares, cable_length=2.1, cable_density=0.01, tension=0.7)
    row = np.array([-0.8, 0.0, 0.0]) * np.arange(1, spares)[:, None]
    drones = DronesStart(*(np.vstack([x, x[4] + row]) for x in (Q, R)))
    start: dict[str, Any] = {
        "polygon": SQUARE,
        "altitude": 1.9,
        "by": "laying",
        "robots": [0, 1, 2, 3],
    } | form
    return ho.Mission(team, start=drones).form(**start)


@given(
    n=st.integers(3, 8),
    seed=st.integers(0, 2**31),
    vertex=st.integers(0, 8),
    share=st.floats(0.05, 0.9),
)
@settings(deadline=None, max_examples=40)
def test_a_corner_that_is_cut_off_is_restored(n: int, seed: int, vertex: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    angles = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    middle = rng.uniform(-3.0, 3.0, 2)
    outline = ho.ConvexPolygon(middle + np.column_stack([np.cos(-angles), np.sin(-angles)]))
    vertex %= n + 1  # the first one as well with its new edge last
    lengths = outline.edge_lengths[[vertex - 1, vertex % n]]
    cut = corner_cut(outline, vertex, share * float(np.min(lengths)))
    new = cut.vertices[[vertex, (vertex + 1) % (n + 1)]]
    corner = outline.vertices[vertex % n]
    off = np.linalg.norm(new - corner, axis=1)
    np.testing.assert_allclose(off, share * np.min(lengths), rtol=1e-12)
    back, grown = corner_restored(cut, vertex, 0)
    np.testing.assert_allclose(back.vertices, outline.vertices, atol=1e-9)
    np.testing.assert_allclose(grown, off, rtol=1e-7)
    for place in range(n):
        for at, beside in cut_outlines(outline, place, share / 2.0):
            ring = [*range(at), n, *range(at, n)]
            back, _ = corner_restored(beside, ring.index(place), 0)
            ring.remove(place)
            assert ring == [*range(place), n, *range(place + 1, n)]
            np.testing.assert_allclose(back.vertices, outline.vertices, atol=1e-9)


def test_a_robot_joins_between_two_others_and_leaves_upward() -> None:
    plan = planned("join_a_fourth")
    rings = [chapter.groups[0].motion for chapter in chapters(plan.motion)]
    assert [ring.team.labels for ring in rings] == [(0, 1, 2), (3, 0, 1, 2), (0, 1, 2)]
    cut = corner_cut(ho.ConvexPolygon(TRIANGLE), 0, 0.5).vertices
    np.testing.assert_allclose(rings[1].vertices.coefficients[-1, :, :2, -1], cut, atol=1e-9)
    np.testing.assert_allclose(rings[2].vertices.coefficients[-1, :, :2, -1], TRIANGLE, atol=1e-9)
    robot = plan.motion.drones.coefficients[-1, 6:8, :, -1]
    assert np.all(robot[:, 2] > np.max(plan.motion.drones.coefficients[-1, :6, 2, -1]) + 0.7)
    assert {each.state for each in plan.phases} >= {CableState.LYING, CableState.ROLLING}
    tied = [ring.formed[-1] and not ring.formed[0] for ring in rings]
    assert tied == [True, False, False]  # from the first ring on the hitch is never untied


def test_a_robot_is_replaced_and_the_outline_is_as_before() -> None:
    """The one that leaves is on top of both neighbours: the other one comes from below."""
    motion = planned("replace_in_flight").motion
    first, *_, last = (chapter.groups[0].motion for chapter in chapters(motion))
    assert (first.team.labels, last.team.labels) == ((0, 1, 2, 3), (0, 4, 2, 3))
    np.testing.assert_allclose(last.vertices.coefficients[-1, :, :2, -1], SQUARE, atol=1e-9)
    down = next(i for i, p in enumerate(motion.phases) if p.name == "lower")
    pieces = motion.phase_of_piece == down
    heights = motion.drones.coefficients[pieces][:, 8:, 2]
    assert np.all(heights[-1, :, -1] > heights[0, :, 0])


@pytest.mark.slow
def test_a_robot_on_its_way_avoids_those_that_wait() -> None:
    """Robots 1 and 2, which have left, wait at heights at which robot 4 passes."""
    plan = mission(spares=3).replace(1, 6).replace(2, 5).replace(3, 4).solve()
    last = chapters(plan.motion)[-1].groups[0].motion
    assert last.team.labels == (0, 6, 5, 4)
    np.testing.assert_allclose(last.vertices.coefficients[-1, :, :2, -1], SQUARE, atol=1e-9)


@pytest.mark.parametrize("roll", [pytest.param(0.0, marks=pytest.mark.slow), 20.0])
def test_a_laid_hitch_is_released_with_legs_with_which_it_cannot_unroll(roll: float) -> None:
    laid = ho.load_problem(PROBLEMS / "lay_triangle.yaml")
    rolled = ho.Adjust(legs=RolledLegs("balanced", np.full(3, np.radians(roll))))
    steps = (laid.mission[0], replace(rolled, settle=False), ho.Release())
    plan = ho.solve(replace(laid, mission=steps))
    names = [phase.name for phase in plan.phases]
    assert names.count("adjust") == 2
    assert names[names.index("adjust") + 1 :][:2] == ["adjust", "unroll"]


def test_what_cannot_be_is_refused_by_its_key() -> None:
    square = mission()
    cases: list[tuple[str, Callable[[], Any]]] = [
        ("robot = 1: must be one that waits: 4", lambda: square.join(1, 0, 0.3)),
        ("vertex = 4: must be 0 to 3", lambda: square.join(4, 4, 0.3)),
        ("cut = 1.3: must be less than 1.2 m", lambda: square.join(4, 0, 1.3)),
        ("robot = 4: must be one of the ring: 0, 1, 2, 3", lambda: square.withdraw(4)),
        ("whose edge the lines of its neighbours meet", lambda: square.withdraw(0)),
        ("by = 2: must be one that waits: 4", lambda: square.replace(1, 2)),
        ("robots = .*each once", lambda: mission(robots=[0, 1, 1, 3])),
        ("order = .*each of the robots 0, 1, 2, 3 once", lambda: mission(order=[0, 1, 2, 4])),
        (
            "robot = 0: must be of a ring of at least 4",
            lambda: mission(robots=[0, 2, 4], polygon=TRIANGLE).withdraw(0),
        ),
    ]
    for words, change in cases:
        with pytest.raises(ho.InputError, match=words):
            change()


def test_a_hitch_that_changes_its_robots_carries_nothing() -> None:
    team = ho.Team(robots=4, cable_length=2.3, cable_density=0.01, tension=0.7)
    start = HitchStart(ho.ConvexPolygon(SQUARE), 1.9)
    box = ho.SolidObject(ho.Section(radius=0.2), 0.0, 0.3, mass=0.05, friction=0.5)
    carried = ho.Mission(team, start=start, objects={"box": box}).enclose("box").leave("box")
    with pytest.raises(ho.InputError, match=r"mission\[0\]\.enclose\.object = 'box': must be left"):
        carried.morph([[-0.3, 0.6], [0.3, 0.6], [0.8, -0.6], [-0.8, -0.6]]).withdraw(0)


def test_a_cable_over_one_neighbour_and_under_the_other_does_not_leave() -> None:
    """As of every hitch that is taken to be tied by turns of equal sense."""
    team = ho.Team(robots=4, cable_length=2.3, cable_density=0.01, tension=0.7)
    outline = [[-0.3, 0.6], [0.3, 0.6], [0.8, -0.6], [-0.8, -0.6]]
    start = HitchStart(ho.ConvexPolygon(outline), 1.5)
    with pytest.raises(ho.InfeasibleError, match="can neither be lifted nor let down"):
        ho.Mission(team, start=start).withdraw(0).solve()


def test_no_phase_of_a_clock_is_too_brief_for_its_derivatives() -> None:
    """A flight that all but reaches its acceleration cruises there for microseconds."""
    v, a, j = 1.0, 2.0, 20.0
    min_distance = 2.0 * a**3 / j**2  # reaches the acceleration, without a time of it
    for beyond in (1e-9, 1e-6, 1e-5, 1e-4):
        clock = fastest_clock(min_distance + beyond, v, a, j)
        assert np.min(np.diff(clock.breaks)) >= MIN_PHASE
        (fastest,), _ = fastest_ramps(np.array([min_distance + beyond]), v, a, j)
        assert fastest * (1.0 - 1e-9) <= clock.duration <= 1.03 * fastest
