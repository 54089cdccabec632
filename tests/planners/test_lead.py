"""Legs that lead and lag: what they leave as it was, and what they gain."""

import numpy as np

import hitchopt as ho
from hitchopt.geometry import regular_polygon
from hitchopt.planners.morph.legs import leading
from hitchopt.planners.morph.path import ShapePath, drones_along

ENDS = np.array([0.0, 1.0])
CLOSE = ho.Separation(cable=0.07, crossing=0.05)


def turned(n: int, angle: float) -> ShapePath:
    """A regular n-gon off the origin that turns straight."""
    first, last = (regular_polygon(n, 1.3).rotated(a).translated([2.0, -1.0]) for a in (0.0, angle))
    start = ho.Hitch.balanced(ho.Team(n, 2.0), first)
    goal = ho.Hitch.balanced(start.team, last)
    return ShapePath.straight(start, goal)


def test_ends_vertices_and_edges_stay_as_they_are() -> None:
    path = turned(9, 0.3)
    s = np.linspace(0.0, 1.0, 11)
    led = list(leading(path, ho.Limits()))
    assert len(led) == 1
    for other in led:
        np.testing.assert_allclose(
            drones_along(other, ENDS).positions[..., 0], drones_along(path, ENDS).positions[..., 0]
        )
        np.testing.assert_array_equal(other.flat(s).vertices, path.flat(s).vertices)
        assert np.max(np.abs(other.flat(s).q_legs - path.flat(s).q_legs)) > 0.01


def test_an_optimised_turn_is_faster_than_its_vertices_would_be_with_drones_in_step() -> None:
    """At ``v`` on a chord D with drones in step: at least D/v + v/a, here with a ramp a/j more."""
    polygon = regular_polygon(12, 1.3)
    start = ho.Hitch.spread(ho.Team(12, 2.0), polygon, separation=CLOSE)
    goal = polygon.rotated(0.24)
    limits = ho.Limits()
    plan = ho.morph(start, goal, limits=limits, separation=CLOSE, optimize=True)
    plan.certificate.raise_if_violated()
    chord = float(np.max(np.linalg.norm(goal.vertices - polygon.vertices, axis=1)))
    v, a = limits.vertex_speed, limits.acceleration
    assert chord / v < plan.duration < chord / v + v / a + a / limits.jerk - 0.05
