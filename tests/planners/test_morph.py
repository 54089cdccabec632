"""Morphs: legs that make way, lead and lag; shut ways and their diagnosis."""

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import Hitch, InfeasibleError, Limits, Quadrotor, Separation, Team, regular_polygon
from hitchopt.hitch.legs import reference_margin
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.legs import leg_task_along, with_legs_clear
from hitchopt.planners.morph.morph import StraightMorph
from hitchopt.planners.morph.path import ShapePath, shapes_along

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
ENDS = np.array([0.0, 1.0])


def distances_on_the_way(path: ShapePath) -> float:
    s = np.linspace(0.0, 1.0, 301)
    return reference_margin(leg_task_along(path, Requirements(), s, 1.0))


def test_legs_make_way_where_a_linear_change_of_sharing_does_not() -> None:
    """From one sharing of the sharp triangle to its mirror image: even sharing is too close."""
    team = Team(3, 2.4)
    start = Hitch.spread(team, TRIANGLE)
    end = Hitch(team, TRIANGLE, 1.0, start.slack - start.q_legs)
    linear = ShapePath.straight(start, end)
    assert distances_on_the_way(linear) < 1.0
    clear = with_legs_clear(linear, Requirements())
    assert distances_on_the_way(clear) >= 1.0
    legs = shapes_along(clear, ENDS).legs
    np.testing.assert_allclose(legs, [start.legs, end.legs], atol=1e-9)
    flight = StraightMorph(start, end, Requirements()).solve()
    assert flight is not None
    np.testing.assert_allclose(flight.drones.at(flight.duration), end.drones, atol=1e-9)
    assert StraightMorph(start, start, Requirements()).solve() is None  # nothing to do


def test_a_straight_way_that_loses_convexity_says_where() -> None:
    """PAPER.md's pair of quadrilaterals; half turns, which collapse to a point."""
    first = [[1.0, 1.0], [1.0, 2.0], [2.0, 0.0], [2.0, -1.0]]
    second = [[1.0, 0.0], [-1.0, 1.0], [1.0, 1.0], [2.0, 0.0]]
    square = np.array([[0.0, 0.0], [0.0, 1.3], [1.3, 1.3], [1.3, 0.0]])
    turned, arc = np.roll(square, 2, axis=0), Team(3, 2.2, topology="open")
    for team, one, other in (
        (Team(4, 6.0), first, second),
        (Team(4, 2.2), square, turned),
        (arc, square, turned),
    ):
        start, end = (Hitch.balanced(team, p) for p in (one, other))
        with pytest.raises(InfeasibleError, match=r"convexity: .* at p\d .*of the path") as caught:
            StraightMorph(start, end, Requirements()).solve()
        assert caught.value.violations[0].value == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("thrust", [1.35, 1.37])
def test_too_weak_drones_are_told_apart_from_slow_ones(thrust: float) -> None:
    needed = np.hypot(0.132 * 9.81, 0.4)  # 1.356 N
    team = Team(3, 2.4, quadrotor=Quadrotor(0.132, thrust))
    start, end = (Hitch.spread(team, [[0.0, y], *TRIANGLE[1:]]) for y in (-1.0, -0.8))
    morph = StraightMorph(start, end, Requirements())
    if thrust > needed:
        assert morph.solve() is not None
        return
    with pytest.raises(InfeasibleError, match="thrust") as caught:
        morph.solve()
    assert caught.value.violations[0].value == pytest.approx(needed, rel=1e-9)


def test_an_optimised_turn_is_faster_than_its_vertices_would_be_with_drones_in_step() -> None:
    """At ``v`` on a chord D with drones in step: at least D/v + v/a, here with a ramp a/j more."""
    polygon, close = regular_polygon(12, 1.3), Separation(cable=0.07, crossing=0.05)
    start = Hitch.spread(Team(12, 2.0), polygon, separation=close)
    goal = polygon.rotated(0.24)
    limits = Limits()
    plan = ho.morph(start, goal, limits=limits, separation=close, optimize=True)
    plan.certificate.raise_if_violated()
    chord = float(np.max(np.linalg.norm(goal.vertices - polygon.vertices, axis=1)))
    v, a = limits.vertex_speed, limits.acceleration
    assert chord / v < plan.duration < chord / v + v / a + a / limits.jerk - 0.05
