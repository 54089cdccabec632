"""Clasps that carry weight and legs that are rolled: balance, laws, limits and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from clasp_balance import random_hitch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.forces import ClaspLoads, cable_of, leg_directions, sag_factors, shortening

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(3, 9)

RHO = 9.81 * 0.01
"""[N/m] Weight of the cables here."""


@given(seeds, sizes)
@settings(max_examples=30)
def test_any_force_at_a_clasp_is_held(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    edges = rng.normal(size=(n, 3))
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    T = rng.uniform(0.8, 1.0, n)
    forces, roll = 0.05 * rng.normal(size=(n, 3)), rng.uniform(-1.0, 1.0, n)
    V = np.roll(T, 1)[:, None] * np.roll(edges, 1, axis=0) - T[:, None] * edges - forces
    size = np.linalg.norm(V, axis=1)
    if np.any(size > 0.98 * (T + np.roll(T, 1))) or np.any(size < 0.3):
        return
    none = np.zeros((n, 2))
    q, r = leg_directions(edges, T, loads=ClaspLoads(forces, none, roll, none))
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    held = T[:, None] * q + np.roll(T[:, None] * r, 1, axis=0)
    np.testing.assert_allclose(held, V, atol=1e-12)


@given(seeds, sizes)
@settings(max_examples=30)
def test_the_mirror_image_exchanges_q_and_r_and_the_sense_of_roll(seed: int, n: int) -> None:
    h = random_hitch(seed, n, kind="heavy")
    back = np.arange(n)[::-1]
    corners = np.roll(h.polygon.vertices[back] * [-1.0, 1.0], -1, axis=0)
    at = np.roll(back, -1)  # clasp k of the image is this one of the hitch
    cable = (at - 1) % n
    team = replace(
        h.team,
        cable_length=h.team.cable_length[cable],
        tension=h.team.tension[cable],
        load=h.team.load[at],
    )
    image = Hitch(team, corners, 0.8, h.r_legs[cable], -h.roll[at])
    expected = h.drones.reshape(n, 2, 3)[cable][:, ::-1] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(image.drones.reshape(n, 2, 3), expected, atol=1e-9)


def test_a_positive_roll_raises_q_and_lowers_the_other_drone_of_its_clasp() -> None:
    team = Team(5, 2.0)
    h = Hitch.balanced(team, regular_polygon(5, 1.0), roll=[0.0, 0.3, 0.0, -0.2, 0.0])
    raised = h.drones[0::2, 2] - 1.0
    lowered = np.roll(h.drones[1::2, 2], 1) - 1.0
    np.testing.assert_array_equal(np.sign(raised).round(9), [0.0, 1.0, 0.0, -1.0, 0.0])
    np.testing.assert_allclose(lowered, -raised, atol=1e-12)
    # Half of the interior angle is between legs and V, about which they turn.
    h_over_T = math.sin(0.5 * math.radians(108.0))
    assert raised[1] == pytest.approx(0.5 * h_over_T * math.sin(0.3), rel=1e-12)


@pytest.mark.parametrize("n", [3, 4, 6, 12])
def test_the_largest_weight_of_regular_hitches(n: int) -> None:
    """``W < 2 n T cos(π/n)`` of all clasps together; legs rise by ``sin α = W / 2nT``."""
    most = 2.0 * 0.6 * math.cos(math.pi / n)
    for share in (0.5, 0.999):
        team = Team(n, 2.0, tension=0.6, load=share * most / 9.81)
        h = Hitch.balanced(team, regular_polygon(n, 1.0))
        rise = (h.drones[:, 2] - 1.0) / 0.5
        np.testing.assert_allclose(rise, share * most / 1.2, rtol=1e-9)
    with pytest.raises(InfeasibleError, match=r"load: .* above the limit of .* at p\d") as told:
        Hitch.balanced(replace(team, load=np.full(n, 1.25 * most / 9.81)), regular_polygon(n, 1.0))
    (violation,) = told.value.violations
    assert violation.value == pytest.approx(1.25 * most, rel=1e-9)
    assert violation.limit == pytest.approx(most, rel=1e-9)
    assert "team.tension 1.25 times" in violation.remedy
    Hitch.balanced(
        replace(team, load=np.full(n, 1.25 * most / 9.81), tension=np.full(n, 0.6 * 1.26)),
        regular_polygon(n, 1.0),
    )


def test_what_a_clasp_is_refused_for_is_beyond_its_limit() -> None:
    """Nearly straight cables of unlike tensions, whose legs pull harder the higher they rise."""
    rng = np.random.default_rng(5)
    told: list[Violation] = []
    for _ in range(300):
        angles = np.cumsum(rng.uniform(0.0, 0.2, 2))
        u = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(2)])
        T, halves = rng.uniform(0.3, 0.5, 2), rng.uniform(0.0, 0.2, (1, 2))
        forces = np.zeros((1, 3))
        forces[0, 2] = -np.sum(halves) - rng.uniform(0.0, 0.4)
        forces[0, :2] = rng.choice([0.0, 0.3]) * rng.normal(size=2)
        loads = ClaspLoads(forces, halves, np.zeros(1), np.zeros((1, 2)))
        try:
            leg_directions(u, T, "open", loads)
        except InfeasibleError as error:
            told += error.violations
    assert {violation.constraint for violation in told} == {"load", "tension"}
    assert all(violation.value > violation.limit for violation in told)


def test_thrust_of_a_weight_shared_alike() -> None:
    """``(m g + ½ ρ g d + P sin α)² + (P cos α)²``, P the pull along the leg."""
    h = Hitch.balanced(
        Team(6, 2.2, tension=0.5, cable_density=0.01, load=0.01), regular_polygon(6, 1.0)
    )
    weight = 9.81 * 0.01 + RHO * (h.q_legs[0] + 2.2 - h.r_legs[0] - h.q_legs[0])
    d = h.legs[0, 0]
    sine = (h.drones[0, 2] - 1.0) / d
    half = 0.5 * RHO * d
    pull = half * sine + math.sqrt(0.25 - half**2 * (1.0 - sine**2))
    assert pull * sine == pytest.approx(0.5 * weight, rel=1e-5)
    force = h.cable_forces
    np.testing.assert_allclose(-force[:, 2], 0.5 * RHO * d + 0.5 * weight, rtol=1e-5)
    level = np.hypot(force[:, 0], force[:, 1])
    np.testing.assert_allclose(level, pull * math.sqrt(1.0 - sine**2), rtol=1e-9)


def test_the_roll_of_a_hitch_is_checked() -> None:
    team = Team(3, 2.4)
    points = [[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
    for roll in (1.6, float("nan"), [0.1, 0.2], "up"):
        with pytest.raises(InputError, match="roll"):
            Hitch.balanced(team, points, roll=roll)
    with pytest.raises(InputError, match=r"load = .*one per clasp"):
        Team(3, 2.4, load=[0.1, 0.2])
    with pytest.raises(InputError, match=r"load\[1\]"):
        Team(3, 2.4, load=[0.1, -0.2, 0.1])


def test_the_arc_of_a_span_and_its_chord() -> None:
    """A parabola's length by quadrature, and the inverse of the series."""
    team = Team(3, 2.4, tension=[0.4, 0.5, 0.6], cable_density=0.01)
    factors = sag_factors(team, team.tension)
    chord = np.array([[0.9, -0.5, 0.0], [0.3, 0.4, 0.35], [0.0, 0.0, 0.7]])
    x = np.linspace(-0.5, 0.5, 20_001)
    for k in range(3):
        level = math.hypot(chord[k, 0], chord[k, 1])
        size = float(np.linalg.norm(chord[k]))
        length = size
        if level > 0.0:  # the slope changes by weight over level pull from end to end
            slope = chord[k, 2] / level + RHO * size / (team.tension[k] * level / size) * x
            length = level * float(np.trapezoid(np.sqrt(1.0 + slope**2), x))
        cable = cable_of(chord, factors)[k]
        assert cable - size == pytest.approx(length - size, rel=0.02, abs=1e-9)
        share = factors[k] * cable**2 * (level / size) ** 2
        assert cable * shortening(np.asarray(share)) == pytest.approx(size, rel=1e-9)
