"""Hitches whose clasps rub on each other and do not open by legs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import hitchopt as ho
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.carrying.grip_polygon import check_opens, grip_left
from hitchopt.values import Array


def polygon(n: int, radius: float) -> Array:
    """Return the vertices of a regular polygon off the origin."""
    angles = 0.3 - 2.0 * np.pi * np.arange(n) / n
    vertices: Array = radius * np.column_stack([np.cos(angles), np.sin(angles)]) + [0.7, -0.2]
    return vertices


def regular(n: int, radius: float, friction: float) -> ho.Hitch:
    team = ho.Team(n, 1.6, cable_friction=friction)
    return ho.Hitch.balanced(team, ho.ConvexPolygon(polygon(n, radius)), altitude=1.0)


def opens(hitch: ho.Hitch, radius: float) -> bool:
    try:
        check_opens(hitch, polygon(hitch.team.robots, radius), Requirements(), "tie it larger")
    except ho.InfeasibleError:
        return False
    return True


def test_the_triangle_that_stayed_as_small_is_refused() -> None:
    """In simulation, tied at 0.4 m with a friction of 0.15, it did not open to 0.56 m."""
    assert not opens(regular(3, 0.4, 0.15), 0.56)
    assert opens(regular(3, 0.56, 0.15), 0.56)
    assert opens(regular(3, 0.4, 0.15), 0.3)
    assert opens(regular(3, 0.4, 0.0), 0.56)
    assert opens(regular(4, 0.4, 0.15), 0.56)


def test_the_suggested_friction_is_the_largest_that_opens() -> None:
    hitch = regular(3, 0.4, 0.15)
    with pytest.raises(ho.InfeasibleError, match=r"larger, or use smoother cables") as caught:
        check_opens(hitch, 1.4 * hitch.polygon.vertices, Requirements(), "tie it larger")
    (violation,) = caught.value.violations
    most = float(violation.remedy.split("cable_friction ")[1].split()[0])
    assert opens(regular(3, 0.4, most), 0.56)
    assert not opens(regular(3, 0.4, most + 0.002), 0.56)
    # At the limit both sides of the clasp's balance are the same, drones side by side.
    leg = float(hitch.legs[0, 0])
    legs = np.arcsin(Requirements().separation.radius / leg)
    exact = np.log(np.cos(legs) / np.cos(np.pi / 6.0)) / (legs + np.pi / 6.0)
    assert most == pytest.approx(exact, abs=1e-3)


def legs_at(angle: float, n: int) -> Array:
    """Return legs (n, 2, 2) [m] of unequal lengths that enclose an angle [rad] at every clasp."""
    turned = 0.7 + 2.0 * np.pi * np.arange(n) / n
    pair = [[np.cos(turned + side), np.sin(turned + side)] for side in (-angle / 2, angle / 2)]
    legs: Array = np.moveaxis(np.array(pair), (0, 1, 2), (1, 2, 0)) * [[[0.5], [0.3]]]
    return legs


def test_what_grip_is_left_solves_the_law_of_clasps() -> None:
    """Found by bisection: edges pull e^(mu theta) times as hard as legs where clasps stick."""
    between, mu = np.radians(50.0), 0.15

    def excess(edges: float) -> float:
        pulled = np.exp(mu * 0.5 * (edges + between)) * np.cos(0.5 * edges)
        return float(np.cos(0.5 * between) - pulled)

    edges = float(brentq(excess, between, np.pi))
    wrapped = 3.0 * edges - np.pi
    harder = np.exp(mu * 0.5 * (edges + between))
    found = grip_left(legs_at(between, 3), np.array([0.3, 0.2, 0.1]), mu, 0.4)
    assert found == pytest.approx(0.4 * 0.3 * harder * wrapped, rel=1e-9)
    assert wrapped > 0.5
