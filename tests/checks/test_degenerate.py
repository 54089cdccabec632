"""Motions that no planner should make: the certificate fails them, and always returns."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hitchopt.checks import Certificate, certify
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.motions import altered, random_motion, with_parts

MOTION = random_motion(4, 3)
OWN = MOTION.vertices.coefficients[:, 2]
"""The vertex of q2."""

PIECE = 5
THIRD = MOTION.drones.breaks[PIECE] + MOTION.drones.durations[PIECE] / 3.0


def certified(motion: Motion) -> Certificate:
    """Return the certificate; all of its numbers can be stored in files."""
    certificate = certify(motion)
    for check in certificate.checks:
        assert math.isfinite(check.worst) or not check.where, check
        assert math.isfinite(check.time), check
    return certificate


Worst = dict[str, float | None]
"""Checks that have to fail, and their worst values where these are known."""


def put(where: Any, value: Any) -> Callable[[Array], None]:
    """Put a value, or another item, into coefficients."""

    def change(c: Array) -> None:
        c[where] = c[value] if isinstance(value, tuple) else value

    return change


def at_one_place(c: Array) -> Array:
    return np.broadcast_to(c[:, :1], c.shape)


def through_its_vertex(c: Array) -> None:
    leg = c[PIECE, 4] - OWN[PIECE]
    c[PIECE, 4] = OWN[PIECE] + leg[:, :1] * np.linspace(1.0, -2.0, c.shape[-1])


def slack_at(tension: float) -> Callable[[Array], Array]:
    def change(c: Array) -> Array:
        c = np.repeat(c, 2, axis=-1)
        c[3, 1, 1] = tension
        return c

    return change


ALL = slice(None)
BEYOND: Worst = dict.fromkeys(("speed", "acceleration", "thrust", "cable_length"))
CASES: dict[str, tuple[str, Callable[[Array], Array | None], Worst]] = {
    "a drone on its vertex for all of the time": (
        "drones",
        put((ALL, 4), OWN),
        {"legs": 0.0, "cable_length": None, "equilibrium": None, "cable_clearance": None},
    ),
    "a drone through its vertex at one instant": (
        "drones",
        through_its_vertex,
        {"legs": None, "equilibrium": None, "cable_length": None},
    ),
    "two drones at one place": ("drones", put((ALL, 1), (ALL, 6)), {"separation": 0.0}),
    "all drones at one place": (
        "drones",
        at_one_place,
        {"separation": 0.0, "cable_clearance": 0.0, "cable_length": None},
    ),
    "an edge of no length": (
        "vertices",
        put((ALL, 1), (ALL, 2)),
        {"convexity": -180.0, "equilibrium": None, "cable_length": None},
    ),
    "all vertices at one place": ("vertices", at_one_place, {"convexity": None, "crossing": 0.0}),
    "no tension": ("tensions", slack_at(0.0), {"equilibrium": None}),
    "less than none": ("tensions", slack_at(-0.1), {"equilibrium": None}),
    "slack everywhere": ("tensions", np.zeros_like, {"equilibrium": None}),
    "far away": ("drones", put((2, 3, 1, 4), 1e9), BEYOND),
    "beyond all measure": ("drones", put((2, 3, 1, 4), 1e300), BEYOND),
}


@pytest.mark.parametrize("name", CASES)
def test_degenerate_motions_fail(name: str) -> None:
    part, change, worst = CASES[name]
    certificate = certified(altered(MOTION, part, change))
    for check, value in worst.items():
        assert not certificate[check].holds, check
        assert value is None or certificate[check].worst == value, check
    if name == "two drones at one place":
        assert certificate["separation"].where == ("r0", "q3")
    elif name == "slack everywhere":
        assert certificate["thrust"].worst == pytest.approx(0.132 * 9.81, rel=1e-2)
    elif name == "a drone on its vertex for all of the time":
        assert certificate["legs"].where == ("q-leg 2",)
        assert certificate["thrust"].worst >= 0.132 * 9.81 + 0.4  # the pull may point anywhere
    elif name == "a drone through its vertex at one instant":
        assert 0.0 <= certificate["legs"].worst < 1e-6
        assert certificate["legs"].time == pytest.approx(THIRD, abs=1e-4)


def test_many_robots_at_one_place() -> None:
    certificate = certified(altered(random_motion(30, 3), "drones", at_one_place))
    assert certificate["separation"].worst == certificate["cable_clearance"].worst == 0.0
    assert not certificate["cable_length"].holds


def test_zero_thrust_has_any_direction() -> None:
    """In free fall without a pull, there is no thrust and no angle."""
    one = with_parts(MOTION, lambda p: PiecewisePolynomial(p.breaks[:2], p.coefficients[:1]))
    place = one.drones.coefficients[..., :1] * np.ones(3)
    place[0, 3, 2] += -0.5 * 9.81 * one.duration**2 * np.array([0.0, 0.0, 1.0])  # of t²
    slack = PiecewisePolynomial.constant(one.drones.breaks, np.zeros(4))
    falling = one.replaced(tensions=slack, drones=PiecewisePolynomial(one.drones.breaks, place))
    check = certified(falling)["tilt"]
    assert check.worst == pytest.approx(180.0)
    assert check.where == ("r1",)
