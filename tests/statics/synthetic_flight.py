"""Recordings computed from the laws alone: clasps in balance, drones that give way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.task import Setpoints, Task
from hitchopt.statics.calibrate import friction_pulls
from hitchopt.statics.recordings import Recording
from hitchopt.statics.settle import conditions_of, energy_of

Array = NDArray[np.float64]

RATE = 20.0
HELD, MOVED = 2.0, 6.0
"""Times at rest, before and after, and time of the movement [s]."""


def balanced(
    team: Team, density: float, drones: Array, guess: Array, rates: Array, friction: float
) -> tuple[Array, Array]:
    """Points (points, 3) [m] at which clasps are in balance, and forces (2n, 3) [N] on drones."""
    layout, n = team.layout, team.robots
    zero = np.zeros((1, 2 * n, 3))
    conditions = conditions_of(team, cable_density=density, stiffness=1.0, feed_forward=False)
    none = dict.fromkeys(("cable_forces", "offsets", "forces"), zero)
    plan = {"positions": drones, "vertices": guess, "tensions": team.tension}
    plan |= {"cable_length": team.cable_length}
    energy = energy_of(team, conditions, none | {name: v[None] for name, v in plan.items()})

    nodes, ahead, behind = energy.nodes, layout.ahead, layout.behind

    def pulls(x: Array) -> Array:
        at = np.concatenate([drones, x.reshape(-1, 3)])[None]
        units = unit(np.diff(at[:, nodes], axis=-2))
        bends = np.arccos(np.clip(np.sum(units[..., 1:, :] * units[..., :-1, :], axis=-1), -1, 1))
        used = np.zeros((team.robots, 2))
        turned = np.stack([bends[0, ahead, 0], bends[0, behind, 1]], axis=-1)
        pulled = friction_pulls(
            turned, np.stack([rates[2 * ahead], rates[2 * behind + 1]], axis=-1)
        )
        used[ahead, 0], used[behind, 1] = friction * (pulled / turned).T
        forces = energy.forces(at[:, nodes], team.tension[None], used)[0]
        return np.asarray(energy.pulls(forces)[0])

    def missing(x: Array) -> Array:
        return pulls(x)[2 * n :].ravel()

    x = root(missing, guess[layout.clasps].ravel(), tol=1e-12).x
    assert np.max(np.abs(pulls(x)[2 * n :])) < 1e-9
    points = guess.copy()
    points[layout.anchors] = drones  # a chain's ends
    points[layout.clasps] = x.reshape(-1, 3)
    return points, -pulls(x)[: 2 * n]


def recorded(
    first: Hitch,
    second: Hitch,
    stiffness: Array,
    density: float,
    friction: float = 0.0,
    wind: tuple[float, float] = (0.0, 0.0),
) -> tuple[Task, Recording]:
    """Return a plan from one hitch to another, whose drones do not know the cables' weight."""
    team, layout = first.team, first.team.layout
    t = np.arange(round((2.0 * HELD + MOVED) * RATE) + 1) / RATE
    s = np.clip((t - HELD) / MOVED, 0.0, 1.0)
    s = s * s * (3.0 - 2.0 * s)
    drones = first.drones + s[:, None, None] * (second.drones - first.drones)
    moving = np.flatnonzero((t > HELD + 0.8) & (t < HELD + MOVED - 0.8))
    rates = np.zeros(drones.shape[:2])
    for _ in range(2 if friction else 1):  # which way cables slide follows from the flight itself
        points, forces, guess = np.zeros((len(t), layout.points, 3)), 0.0 * drones, first.vertices
        for _ in range(4):
            guess, _ = balanced(team, density, drones[0], guess, rates[0], friction)
        for i, (place, rate) in enumerate(zip(drones, rates, strict=True)):
            guess, forces[i] = balanced(team, density, place, guess, rate, friction)
            points[i] = guess
        # Clasps are about to slide before they do, and stick afterwards.
        rates = np.gradient(np.linalg.norm(drones - points[:, layout.anchors], axis=-1), t, axis=0)
        rates = rates[np.clip(np.arange(len(t)), moving[0], moving[-1])]
    known = -np.repeat(team.tension, 2)[:, None] * unit(drones - points[:, layout.pulled_to])
    commanded = drones - (forces + [*wind, 0.0] - known) / stiffness[:, None]
    zero = np.zeros_like(drones)
    setpoints = Setpoints(commanded, zero, zero, zero, known)
    formed, tensions = np.ones(len(t), dtype=np.bool_), np.tile(team.tension, (len(t), 1))
    return Task(team, t, setpoints, formed, points, tensions), Recording(t, drones, points)


def shaken(recording: Recording, noise: float, seed: int) -> Recording:
    """Return the recording with white measurement noise."""
    random = np.random.default_rng(seed)
    places = recording.drones, recording.vertices
    drones, vertices = (each + noise * random.normal(size=each.shape) for each in places)
    return replace(recording, drones=drones, vertices=vertices)
