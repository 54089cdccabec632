"""The friction of a simulated clasp: the ratio of tensions around it is a capstan's.

Two cables clasp each other at a right angle, each in its own plane, the planes perpendicular to
each other, without gravity. One is drawn through slowly; the ratio of its tensions before and after
the clasp should be ``exp(μ π/2)``. Where both lie in one plane, as in a hitch, each passes under
the other on one side and over it on the other, and the ratio is larger: 1.21 for 1.17 at μ = 0.1.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.control import POSITION_GAIN, VELOCITY_GAIN
from hitchopt.simulation.ropes import Ropes, clasped
from hitchopt.simulation.settings import ACCURATE, Settings
from hitchopt.simulation.world import World, check_valid

LEG, SIDE = 0.4, 0.6  # Lengths of the cables' parts on both sides of the clasp [m]
DENSITY = 0.01  # Of the cables [kg/m]
SPEED = 0.05  # Of the one that slides [m/s]; more costs tension as segments pass the bend
FRICTION = 0.3

# Times at which cables are perpendicular, and tight, when one begins to slide; and times from and
# to which tensions are measured [s]
TURNED, DRAWN, MEASURED, END = 0.9, 1.0, 3.5, 4.0

DAMPING = 40.0  # Rate at which cables lose speed when they begin to be drawn tight [1/s]


@pytest.mark.slow
def test_the_accurate_preset_has_a_capstans_friction() -> None:
    given = {"tension": 0.5, "cable_density": DENSITY, "cable_friction": FRICTION}
    team = Team(2, LEG + SIDE, topology="open", **given)  # type: ignore[arg-type]
    hitch = Hitch(team, [[-SIDE, 0.0], [0.0, 0.0], [0.0, -SIDE]], 1.0, [0.0, LEG])
    ropes = Ropes.of(team, Settings(preset=ACCURATE), team.cable_length)
    world = World(ropes, team.mass, 0.0, {})
    world.model.opt.gravity[:] = 0.0
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    loose, clasp = world.drones - hitch.drones, hitch.vertices[1]
    along = np.vstack([0.0 * hitch.drones[:2], hitch.leg_directions[2:]])
    along[3] *= -1.0  # q1 outward, r1 after it
    edges = np.flatnonzero(world.edge_cables == 1)
    pulled, other = edges[2 : len(edges) // 4], edges[int(0.7 * len(edges)) : -2]
    node, sums = DENSITY * ropes.segment_lengths[0], np.zeros(2)
    for time in ACCURATE.time_step * np.arange(round(END / ACCURATE.time_step)):
        slid, drawn = max(time - DRAWN, 0.0), min(1.0, time / DRAWN)
        turn = 0.5 * np.pi * min(time / TURNED, 1.0)  # of cable 0 about the clasp's bisector
        turned = Rotation.from_rotvec(turn * np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0))
        goal, ahead = hitch.drones + SPEED * slid * along, -hitch.cable_forces
        ahead[:, 2] = 0.0  # no gravity here
        goal[:2], ahead[:2] = clasp + turned.apply(goal[:2] - clasp), turned.apply(ahead[:2])
        error = goal + (1.0 - drawn) * loose - world.drones
        rate = SPEED * along * (slid > 0.0) - world.data.qvel[world.drone_dofs]
        force = team.mass[:, None] * (POSITION_GAIN * error + VELOCITY_GAIN * rate)
        world.data.xfrc_applied[world.drone_bodies, :3] = force + drawn * ahead
        slowing = DAMPING * (1.0 - drawn) * node
        world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]
        world.step()
        check_valid(world, time)
        if time >= MEASURED:
            sums += [np.mean(world.tensions[part]) for part in (pulled, other)]
    assert sums[0] / sums[1] == pytest.approx(np.exp(0.5 * np.pi * FRICTION), rel=0.05)
