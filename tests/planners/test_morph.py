"""Morphs: legs that make way, shut ways and their diagnosis."""

import numpy as np
import pytest

from hitchopt import Hitch, InfeasibleError, Limits, Quadrotor, Separation, Team
from hitchopt.hitch.legs import reference_margin
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.legs import leg_task_along, with_legs_clear
from hitchopt.planners.morph.morph import StraightMorph
from hitchopt.planners.morph.path import ShapePath, shapes_along

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
KEPT = Requirements(Limits(), Separation(), None)


def distances_on_the_way(path: ShapePath) -> float:
    s = np.linspace(0.0, 1.0, 301)
    return reference_margin(leg_task_along(path, KEPT, s, 1.0))


def test_legs_make_way_where_a_linear_change_of_sharing_does_not() -> None:
    """From one sharing of the sharp triangle to its mirror image: even sharing is too close."""
    team = Team(3, 2.4)
    start = Hitch.spread(team, TRIANGLE)
    end = Hitch(team, TRIANGLE, 1.0, start.slack - start.q_legs)
    linear = ShapePath.straight(start, end)
    assert distances_on_the_way(linear) < 1.0
    clear = with_legs_clear(linear, KEPT)
    assert distances_on_the_way(clear) >= 1.0
    legs = shapes_along(clear, np.array([0.0, 1.0])).legs
    np.testing.assert_allclose(legs, [start.legs, end.legs], atol=1e-9)
    flight = StraightMorph(start, end, Requirements()).solve()
    assert flight is not None
    np.testing.assert_allclose(flight.drones.at(flight.duration), end.drones, atol=1e-9)


def test_nothing_to_do_is_no_flight() -> None:
    hitch = Hitch.spread(Team(3, 2.4), TRIANGLE)
    assert StraightMorph(hitch, hitch, Requirements()).solve() is None


def test_a_straight_way_that_loses_convexity_says_where() -> None:
    """PAPER.md's pair of quadrilaterals: convex at both ends, not half way."""
    team = Team(4, 6.0)
    first = [[1.0, 1.0], [1.0, 2.0], [2.0, 0.0], [2.0, -1.0]]
    second = [[1.0, 0.0], [-1.0, 1.0], [1.0, 1.0], [2.0, 0.0]]
    start, end = (Hitch.balanced(team, p) for p in (first, second))
    with pytest.raises(InfeasibleError, match="convexity") as caught:
        StraightMorph(start, end, Requirements()).solve()
    violation = caught.value.violations[0]
    assert violation.value == pytest.approx(0.0, abs=0.01)  # p0 goes flat half way, no farther
    assert violation.where[0].startswith("p")
    assert "of the path" in violation.when


def test_too_weak_drones_are_told_apart_from_slow_ones() -> None:
    weak = Team(3, 2.4, quadrotor=Quadrotor(0.132, 1.35))  # hovering needs 1.356 N
    start, end = (Hitch.spread(weak, p) for p in (TRIANGLE, [[0.0, -0.8], *TRIANGLE[1:]]))
    with pytest.raises(InfeasibleError, match="thrust") as caught:
        StraightMorph(start, end, Requirements()).solve()
    violation = caught.value.violations[0]
    assert violation.value == pytest.approx(np.hypot(0.132 * 9.81, 0.4), rel=1e-9)
    strong = Team(3, 2.4, quadrotor=Quadrotor(0.132, 1.37))
    start, end = (Hitch.spread(strong, p) for p in (TRIANGLE, [[0.0, -0.8], *TRIANGLE[1:]]))
    flight = StraightMorph(start, end, Requirements()).solve()
    assert flight is not None


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_a_half_turn_that_collapses_to_a_point_says_so(topology: str) -> None:
    square = np.array([[0.0, 0.0], [0.0, 1.3], [1.3, 1.3], [1.3, 0.0]])
    team = Team(4 if topology == "closed" else 3, 2.2, topology=topology)
    start, end = (Hitch.balanced(team, p) for p in (square, np.roll(square, 2, axis=0)))
    with pytest.raises(InfeasibleError, match=r"convexity: 0 deg .* at p"):
        StraightMorph(start, end, Requirements()).solve()
