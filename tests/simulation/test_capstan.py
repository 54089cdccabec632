"""The capstan test of the friction of a simulated clasp.

Two cables clasp each other at a right angle, each in its own plane, the planes perpendicular to
each other, without gravity. One is drawn through slowly; the ratio of its tensions before and after
the clasp should be ``exp(μ π/2)``.

Where both cables lie in one plane, as in a hitch, each goes under the other on one side and over it
on the other, turns farther in all, and the ratio is larger: about 1.21 for 1.17 at μ = 0.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.control import POSITION_GAIN, VELOCITY_GAIN
from hitchopt.simulation.ropes import clasped, ropes_of
from hitchopt.simulation.settings import ACCURATE, Preset, Settings
from hitchopt.simulation.world import World, check_valid, tensions
from hitchopt.values import Array

LENGTH, LEG = 1.0, 0.4
"""Length of each cable, and of its part from the clasp to the nearer drone [m]."""

TENSION, DENSITY = 0.5, 0.01
"""Tension [N] and density [kg/m] of the cables."""

DRAWN, TURNED = 1.0, 0.9
"""Times at which the cables are tight and one begins to slide, and are perpendicular [s]."""

DAMPING = 40.0
"""Rate at which cables lose speed when they begin to be drawn tight [1/s]; zero once they are."""

SPEED = 0.05
"""Speed of the sliding cable [m/s]; a higher one costs tension as segments pass the bend."""

MARGIN = 2
"""Number of segments next to a drone that are left out."""


@dataclass(frozen=True)
class CapstanTest:
    """Measured tensions.

    Attributes
    ----------
    before, after: mean tensions of the pulled side and of the other one [N].
    expected: ratio of a capstan.
    """

    before: float
    after: float
    expected: float

    @property
    def ratio(self) -> float:
        """Ratio of the two tensions."""
        return self.before / self.after


def capstan_test(
    preset: Preset, friction: float, *, slide: float = 2.0, measured: float = 1.0
) -> CapstanTest:
    """Return the tensions on both sides of a right-angled clasp through which a cable slides.

    Parameters
    ----------
    preset: resolution of the ropes.
    friction: coefficient.
    slide: time in which the cable slides before the measurement [s]; longer with more friction.
    measured: duration of the measurement [s].

    Raises
    ------
    InvalidRunError: the simulation left its valid range.
    UnsupportedError: mujoco is not installed.
    """
    team = Team(
        2,
        LENGTH,
        topology="open",
        tension=TENSION,
        cable_density=DENSITY,
        cable_friction=friction,
    )
    side = LENGTH - LEG
    hitch = Hitch(team, [[-side, 0.0], [0.0, 0.0], [0.0, -side]], 1.0, [0.0, LEG])
    ropes = ropes_of(team, Settings(preset=preset))
    world = World(ropes, team.mass, rigid=False, gravity=0.0)
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    loose = world.drones - hitch.drones
    edges = np.split(np.arange(len(world.edge_cables)), [int(ropes.segments[0])])[1]
    pulled = edges[MARGIN : int(0.25 * len(edges))]
    other = edges[int(0.7 * len(edges)) : -MARGIN]
    sums, count = np.zeros(2), 0
    end = DRAWN + slide + measured
    for step in range(round(end / preset.time_step)):
        time = step * preset.time_step
        _pull(world, team, hitch, loose, time)
        world.step()
        check_valid(world, time)
        if time >= DRAWN + slide:
            pull = tensions(world)
            sums += np.mean(pull[pulled]), np.mean(pull[other])
            count += 1
    return CapstanTest(
        float(sums[0] / count), float(sums[1] / count), float(np.exp(0.5 * np.pi * friction))
    )


def _pull(world: World, team: Team, hitch: Hitch, loose: Array, time: float) -> None:
    """Let point drones pull; cable 0 turns about the clasp's bisector, then cable 1 slides."""
    slid = max(time - DRAWN, 0.0)
    angle = 0.5 * np.pi * min(time / TURNED, 1.0)
    along = hitch.leg_directions[2:] * np.array([[1.0], [-1.0]])  # q1 outward, r1 after it
    goal = hitch.drones.copy()
    clasp = hitch.vertices[1]
    goal[:2] = clasp + _turned(goal[:2] - clasp, angle)
    goal[2:] += SPEED * slid * along
    drawn = min(1.0, time / DRAWN)
    goal += (1.0 - drawn) * loose
    pace = np.zeros_like(goal)
    pace[2:] = SPEED * along * (slid > 0.0)
    ahead = -hitch.cable_forces
    ahead[:, 2] = 0.0  # no gravity here
    ahead[:2] = _turned(ahead[:2], angle)
    error, rate = goal - world.drones, pace - world.data.qvel[world.drone_dofs]
    force = team.mass[:, None] * (POSITION_GAIN * error + VELOCITY_GAIN * rate)
    world.data.xfrc_applied[world.drone_bodies, :3] = force + drawn * ahead
    node = DENSITY * world.ropes.segment_lengths[0]
    slowing = DAMPING * (1.0 - drawn) * node
    world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]


def _turned(vectors: Array, angle: float) -> Array:
    """Return vectors (k, 3) turned about the clasp's bisector."""
    axis = np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)
    turned: Array = (
        np.cos(angle) * vectors
        + np.sin(angle) * np.cross(axis, vectors)
        + (1.0 - np.cos(angle)) * (vectors @ axis)[:, None] * axis
    )
    return turned


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "slide"), [(0.0, 0.6), (0.1, 0.8), (0.3, 2.5)])
def test_the_accurate_preset_has_a_capstans_friction(friction: float, slide: float) -> None:
    found = capstan_test(ACCURATE, friction, slide=slide, measured=0.5)
    assert found.expected == pytest.approx(math.exp(friction * math.pi / 2.0))
    assert found.ratio == pytest.approx(found.expected, rel=0.05)
