"""The capstan test: whether the friction of a simulated clasp is what it should be.

Two cables clasp each other at a right angle, each in its own plane, the planes square to each
other, without gravity. One is drawn through slowly; the ratio of its tensions before and after the
clasp is to be ``exp(μ π/2)``.

Where both cables lie in one plane, as in a hitch, each goes under the other on one side and over it
on the other, turns farther in all, and the ratio is larger: about 1.21 for 1.17 at μ = 0.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.cable_shapes import clasped
from hitchopt.simulation.drone_control import POSITION_GAIN, VELOCITY_GAIN
from hitchopt.simulation.mujoco_world import World, build_world, imported_mujoco
from hitchopt.simulation.ropes import ropes_of
from hitchopt.simulation.simulation_settings import Preset
from hitchopt.simulation.validity import check_valid, tensions

Array = NDArray[np.float64]

LENGTH, LEG = 1.0, 0.4
"""[m] Of each cable, and of its part from the clasp to the nearer drone."""

TENSION, DENSITY = 0.5, 0.01
"""[N], [kg/m]"""

DRAWN, TURNED = 1.0, 0.9
"""[s] After which the cables are tight and one begins to slide, and square to each other."""

HONEY = 40.0
"""[1/s] How fast cables lose their speed as they begin to be drawn tight; none once they are."""

SPEED = 0.05
"""[m/s] Of the sliding cable. Faster, its segments cost tension as they pass the bend."""


@dataclass(frozen=True)
class CapstanTest:
    """What was measured.

    Attributes
    ----------
    before, after: [N], mean tensions of the pulled side and of the other one.
    expected: the capstan's ratio.
    """

    before: float
    after: float
    expected: float

    @property
    def ratio(self) -> float:
        """Of the two tensions."""
        return self.before / self.after


def capstan_test(
    preset: Preset, friction: float, *, slide: float = 2.0, measured: float = 1.0
) -> CapstanTest:
    """Return the tensions on both sides of a right-angled clasp through which a cable slides.

    Parameters
    ----------
    preset: how finely the ropes are cut.
    friction: coefficient.
    slide: how long the cable slides before it is measured [s]; with more friction, longer.
    measured: for how long then [s].

    Raises
    ------
    InvalidRunError: the simulation left its range.
    UnsupportedError: mujoco is not installed.
    """
    mujoco = imported_mujoco()
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
    ropes = ropes_of(team, preset)
    world = build_world(ropes, team.mass, rigid=False, gravity=0.0)
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
        mujoco.mj_step(world.model, world.data)
        check_valid(world, time)
        if time >= DRAWN + slide:
            pull = tensions(world)
            sums += np.mean(pull[pulled]), np.mean(pull[other])
            count += 1
    return CapstanTest(
        float(sums[0] / count), float(sums[1] / count), float(np.exp(0.5 * np.pi * friction))
    )


MARGIN = 2
"""Segments next to a drone that are left out."""


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
    slowing = HONEY * (1.0 - drawn) * node
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
