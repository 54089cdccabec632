"""Certificates of hitches whose clasps carry weight and whose legs are rolled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import still, with_drones
from certificate_sampling import sampled
from numpy.typing import NDArray

from hitchopt.checks import certify
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion

Array = NDArray[np.float64]


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
