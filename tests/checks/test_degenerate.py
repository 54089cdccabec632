"""Motions that no planner should make: the certificate fails them, and always returns."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from certificate_cases import random_motion, with_drones, with_parts

from hitchopt.checks import Certificate, certify
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


@pytest.fixture
def motion() -> Motion:
    return random_motion(4, 3)


def certified(motion: Motion) -> Certificate:
    """Return the certificate, all of whose numbers a file can hold."""
    certificate = certify(motion)
    for check in certificate.checks:
        assert check.worst is None or math.isfinite(check.worst), check
        assert math.isfinite(check.time), check
    return certificate


def told(motion: Motion, part: str, c: np.ndarray) -> Motion:
    """Return the motion with other coefficients of a part."""
    given: dict[str, Any] = {part: PiecewisePolynomial(motion.drones.breaks, c)}
    return replace(motion, **given)


def own_vertex(motion: Motion) -> np.ndarray:
    return motion.vertices.coefficients[:, 2]


def test_a_drone_on_its_vertex_for_all_of_the_time(motion: Motion) -> None:
    c = motion.drones.coefficients.copy()
    c[:, 4] = own_vertex(motion)
    certificate = certified(with_drones(motion, c))
    assert certificate["legs"].worst == 0.0
    assert certificate["legs"].where == ("q-leg 2",)
    for name in ("legs", "cable_length", "equilibrium", "cable_clearance"):
        assert not certificate[name].holds, name
    assert certificate["thrust"].bound >= 0.132 * 9.81 + 0.4  # the pull may point anywhere


def test_a_drone_through_its_vertex_at_one_instant(motion: Motion) -> None:
    leg = motion.drones.coefficients[:, 4] - own_vertex(motion)
    piece = 5
    c = motion.drones.coefficients.copy()
    share = np.linspace(1.0, -2.0, c.shape[-1])
    c[piece, 4] = own_vertex(motion)[piece] + leg[piece, :, :1] * share
    certificate = certified(with_drones(motion, c))
    assert 0.0 <= certificate["legs"].bound < 1e-6
    third = motion.drones.breaks[piece] + motion.drones.durations[piece] / 3.0
    assert certificate["legs"].time == pytest.approx(third, abs=1e-4)
    assert not certificate["equilibrium"].holds
    assert not certificate["cable_length"].holds


Worst = dict[str, float | None]
"""Checks that have to fail, and their worst values where these are known."""


def at_one_place(c: Array) -> Array:
    return np.broadcast_to(c[:, :1], c.shape).copy()


def put(where: Any, value: Any) -> Callable[[Array], Array]:
    """Put a value, or another item, into coefficients."""

    def change(c: Array) -> Array:
        c[where] = c[value] if isinstance(value, tuple) else value
        return c

    return change


def slack_at(tension: float) -> Callable[[Array], Array]:
    return lambda c: put((3, 1, 1), tension)(np.repeat(c, 2, axis=-1))


ALL = slice(None)
BEYOND: Worst = dict.fromkeys(("speed", "acceleration", "thrust", "cable_length"))
CASES: dict[str, tuple[str, Callable[[Array], Array], Worst]] = {
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
def test_what_no_planner_should_make_fails(motion: Motion, name: str) -> None:
    part, change, worst = CASES[name]
    certificate = certified(told(motion, part, change(getattr(motion, part).coefficients.copy())))
    for check, value in worst.items():
        assert not certificate[check].holds, check
        assert value is None or certificate[check].worst == value, check
    where = {"two drones at one place": ("r0", "q3")}.get(name)
    assert where is None or certificate["separation"].where == where
    if name == "slack everywhere":
        assert certificate["thrust"].worst == pytest.approx(0.132 * 9.81, rel=1e-2)


def test_sixty_robots_at_one_place() -> None:
    motion = random_motion(60, 3)
    certificate = certified(told(motion, "drones", at_one_place(motion.drones.coefficients)))
    assert certificate["separation"].worst == certificate["cable_clearance"].worst == 0.0
    assert not certificate["cable_length"].holds


def test_a_thrust_of_nothing_points_anywhere(motion: Motion) -> None:
    """In free fall without a pull there is no thrust, and so no angle that could be kept."""
    one = with_parts(motion, lambda p: PiecewisePolynomial(p.breaks[:2], p.coefficients[:1]))
    place = one.drones.coefficients[..., :1] * np.ones(3)
    place[0, 3, 2] += -0.5 * 9.81 * one.duration**2 * np.array([0.0, 0.0, 1.0])  # of t²
    slack = PiecewisePolynomial.constant(one.drones.breaks, np.zeros(4))
    falling = with_drones(replace(one, tensions=slack), place)
    check = certified(falling)["tilt"]
    assert check.worst == pytest.approx(180.0)
    assert check.where == ("r1",)
