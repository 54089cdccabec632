"""Certificates of hitches whose clasps carry weight and whose legs are rolled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import moving, still, with_drones
from certificate_sampling import sampled
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.checks import certify
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Quadrotor, Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at

Array = NDArray[np.float64]

FORCES = ("thrust", "tilt", "equilibrium", "cable_length", "legs", "separation", "cable_clearance")


def motion(seed: int, n: int, *, density: float = 0.01) -> Motion:
    """Return a hitch of unequal cables in which everything moves, off the origin."""
    rng = np.random.default_rng(seed)
    angles = 2.0 * math.pi * (np.arange(n) + 0.15 * rng.uniform(-1.0, 1.0, n)) / n
    start = np.array([4.0, -3.0]) + np.column_stack([np.cos(angles), -np.sin(angles)])
    edges = np.linalg.norm(np.roll(start, -1, axis=0) - start, axis=1)
    team = Team(
        n,
        edges + rng.uniform(0.9, 1.1, n),
        tension=0.9,
        cable_density=density,
        load=rng.uniform(0.0, 0.006, n),
        quadrotor=[Quadrotor(0.13 + 0.01 * k, 3.0) for k in range(n)],
    )
    phases = rng.uniform(0.0, 6.0, n)

    def polygon_at(t: Array) -> Array:
        points: Array = start + 0.06 * np.sin(t[:, None, None] * [0.8, 1.1] + start)
        return points

    def tension_at(t: Array) -> Array:
        return 0.9 + 0.03 * np.sin(0.7 * t[:, None] + phases)

    return moving(
        team,
        polygon_at,
        0.4 + 0.05 * rng.uniform(0.0, 1.0, n),
        order=9,
        tension_at=tension_at,
        roll=rng.uniform(-0.5, 0.5, n),
    )


@given(st.integers(0, 10_000), st.integers(3, 7), st.sampled_from([0.0, 0.01]))
@settings(max_examples=12)
def test_no_sample_beats_a_bound_and_bounds_are_tight(seed: int, n: int, density: float) -> None:
    whole = motion(seed, n, density=density)
    # A range of tensions, so that cables are taut all of the time.
    phases = tuple(replace(phase, tension=(0.8, 1.0)) for phase in whole.phases)
    whole = replace(whole, phases=phases)
    certificate = certify(whole)
    found = sampled(whole, np.linspace(0.0, whole.duration, 1001))
    for name in FORCES:
        check = certificate[name]
        worst = check.bound / check.number if name == "thrust" else check.bound
        outside = found[name] - worst if check.sense == "min" else worst - found[name]
        assert outside >= 0.0, f"{name}: {worst} is beaten by a sample of {found[name]}"
        assert outside <= max(1e-2 * abs(found[name]), 2e-6), f"{name}: {worst}, {found[name]}"
    assert certificate["equilibrium"].bound < 1.5e-3
    assert certificate["cable_length"].bound < 1e-6


def resting(team: Team, roll: float = 0.0) -> Motion:
    polygon = np.array([2.0, 1.0]) + regular_polygon(team.robots, 1.0).vertices
    q_legs = Hitch.balanced(team, polygon).q_legs
    return still(team, polygon, q_legs, roll=np.full(team.robots, roll))


@pytest.mark.parametrize("change", ["density", "load"])
def test_level_legs_do_not_carry_weight(change: str) -> None:
    """A plan without weight under a team that has it: the clasps fall, by the weight over T."""
    light = Team(6, 2.0, tension=0.5)
    heavier = {
        "density": Team(6, 2.0, tension=0.5, cable_density=0.01),
        "load": Team(6, 2.0, tension=0.5, load=0.015),
    }[change]
    assert certify(resting(light)).certified
    wrong = certify(replace(resting(light), team=heavier))
    team_density = heavier.cable_density
    weight = 9.81 * (1.5 * team_density if change == "density" else 0.015)
    # Level edges of 1 m pull less along their chords than legs of 0.5 m.
    half = 0.5 * 9.81 * team_density
    apart = math.sqrt(0.25 - (0.5 * half) ** 2) - math.sqrt(0.25 - half**2)
    expected = math.hypot(weight, apart) / 0.5
    assert wrong["equilibrium"].worst == pytest.approx(expected, rel=1e-6)
    assert not wrong["equilibrium"].holds
    # Massless spans leave no cable over for sagging ones.
    arcs = (0.0981 / 0.5) ** 2 / 24.0 * (1.0 + 2.0 * 0.5**3) if change == "density" else 0.0
    assert wrong["cable_length"].worst == pytest.approx(arcs / 2.0, rel=1e-6, abs=1e-11)
    right = certify(resting(heavier))
    assert right.certified
    assert right["equilibrium"].bound < 3e-4


def test_rolled_legs_are_in_balance_and_thrusts_share_the_weight() -> None:
    team = Team(6, 2.0, tension=0.5, cable_density=0.01, load=0.005)
    for roll in (0.0, 0.3, -0.6):
        whole = resting(team, roll)
        certificate = certify(whole)
        assert certificate["equilibrium"].bound < 1e-3, roll
        state = states_at(whole, 0.7)
        thrust = np.sum(state.thrusts(team), axis=0)
        carried = 12 * 0.132 + 6 * 0.005 + 0.01 * 12.0
        np.testing.assert_allclose(thrust, [0.0, 0.0, 9.81 * carried], atol=9.81 * 1e-4)


def test_a_clasp_that_does_not_bear_is_infinitely_far_from_balance() -> None:
    """In balance to the last digit, but with a cable that its own clasp would have to push down."""
    team = Team(3, 2.4, tension=0.5, load=0.05)
    held = resting(team)
    assert certify(held)["equilibrium"].holds
    # Exchanged, each cable runs nearly straight on, and nothing holds the two together.
    x = held.drones.coefficients.copy()
    layout = team.layout
    anchors = held.vertices.coefficients[:, layout.anchors]
    legs = (x - anchors).reshape(len(x), 3, 2, 3, -1)
    other = legs.copy()
    other[:, layout.ahead, 0] = legs[:, layout.behind, 1]
    other[:, layout.behind, 1] = legs[:, layout.ahead, 0]
    through = with_drones(held, other.reshape(x.shape) + anchors)
    assert sampled(through, np.array([0.5]))["equilibrium"] < 1e-9
    found = certify(through)["equilibrium"]
    assert found.bound > 1e300
    assert not found.holds
