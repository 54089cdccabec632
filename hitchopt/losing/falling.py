"""Where a lost drone falls and hangs, and what the survivors carry then.

Cables run over clasps without friction: where the team comes to rest with the lost drone as a dead
weight on its cable is the minimum of a convex energy (``hitchopt.settling``). That and the fall are
no bounds for all of time: they are computed at samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.settling.conditions import Conditions
from hitchopt.settling.energy_minimum import settled_nodes
from hitchopt.settling.settle import energy_of
from hitchopt.values import Array

LOOSE = 1e-6
"""[N/m] Stiffness of a drone that is a mere weight."""

GAIN, STIFFER = 36.0, (8.0, 30.0)
"""[1/s²] Stiffness over mass of usual position loops, and factors by which survivors are stiffer
that feed forward what cables pull at rest: they stay within 3 or 0.7 cm/N of their setpoints."""

JAMMED = 0.05
"""[m] Legs that are shorter at rest leave a drone at its clasp: no such rest is taken."""

STRETCH = 1e3
"""[N] EA of the cables here: 0.2 % at 2 N, and a softer one converges sooner from afar."""

BALANCED = 1e-3
"""[N] Largest force without balance of a rest that is believed."""

BELOW = 0.8
"""[m] Height below its clasp at which the search for a hanging drone begins."""

STEP = 0.02
"""[s] Time between samples of a free fall."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Where a hitch comes to rest with a drone lost.

    Attributes
    ----------
    positions: (2n, 3) [m], of all drones, the lost one among them.
    vertices: (points, 3) [m]
    thrust: largest thrust with which a survivor hovers, over its largest one.
    pulls: (2n, 3) [N], of the cables on the drones.
    lies: whether the lost drone lies on the ground; else it hangs.
    stiffer: by how much survivors are stiffer for it.
    """

    positions: Array
    vertices: Array
    thrust: float
    pulls: Array
    lies: bool
    stiffer: float


def resting_place(motion: Motion, states: States, lost: int) -> Rest | None:
    """Return where a hitch comes to rest with a drone lost; None where no rest is found.

    Where the lost drone would hang below the ground it lies there, and weighs less on the others.

    Parameters
    ----------
    states: of one time, of a hitch; survivors stay close to its positions by feeding the cable
        forces of the rest forward.
    lost: the drone.
    """
    found = (_rest(motion, states, lost, stiffer) for stiffer in STIFFER)
    return next((rest for rest in found if rest is not None), None)


def _rest(motion: Motion, states: States, lost: int, stiffer: float) -> Rest | None:
    """Return the rest of survivors that are stiffer by a factor; None where it is not found."""
    team = motion.team
    stiffness = stiffer * GAIN * team.mass
    conditions = Conditions(stiffness=stiffness, integral=False, axial_stiffness=STRETCH)
    zero = np.zeros((1, team.drones, 3))
    energy, start = energy_of(
        motion,
        conditions,
        states.positions[None],
        states.vertices[None],
        states.tensions[None],
        states.cable_forces[None],
        team.cable_length[None],
        zero,
        zero,
    )
    stiffness = stiffness.copy()
    weight = GRAVITY * team.mass[lost]
    forces, start = energy.forces.copy(), start.copy()
    place = states.vertices[team.layout.pulled_to[lost]] - [0.0, 0.0, BELOW]
    forces[0, lost] = 0.0, 0.0, -weight
    stiffness[lost] = LOOSE
    start[0, lost] = place
    energy = replace(energy, stiffness=stiffness, forces=forces)
    x = settled_nodes(energy, start)
    slopes = energy.slopes(x)[0]
    if not np.max(np.abs(slopes[energy.rigging.free])) <= BALANCED:
        return None
    here = x[0, : team.drones]
    vertices = x[0, energy.rigging.points]
    legs = np.linalg.norm(here - vertices[team.layout.pulled_to], axis=-1)
    if np.min(legs) < JAMMED:
        return None
    away = here - states.positions
    pulls = states.cable_forces + stiffness[:, None] * away
    pulls[lost] = 0.0
    thrusts = np.linalg.norm(team.mass[:, None] * [0.0, 0.0, GRAVITY] - pulls, axis=-1)
    thrusts[lost] = 0.0
    share = float(np.max(thrusts / team.max_thrust))
    lies = bool(here[lost, 2] <= motion.requirements.floor)
    return Rest(here, vertices, share, pulls, lies, stiffer)


def free_fall(position: Array, velocity: Array, floor: float) -> tuple[Array, Array]:
    """Return times (k,) [s] and places (k, 3) [m] of a free fall, the last one on the ground."""
    height, up = position[2] - floor, velocity[2]
    lasts = (up + np.sqrt(max(up**2 + 2.0 * GRAVITY * height, 0.0))) / GRAVITY
    times = np.append(np.arange(0.0, lasts, STEP), lasts)
    places = position + times[:, None] * velocity
    places[:, 2] -= 0.5 * GRAVITY * times**2
    return times, np.maximum(places, [-np.inf, -np.inf, floor])
