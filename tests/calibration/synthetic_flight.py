"""Recordings computed from the laws alone: clasps in balance, drones that give way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fsolve

from hitchopt.calibration.recordings import Recording
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.flight_task import Setpoints, Task

Array = NDArray[np.float64]

RATE = 20.0
HELD, MOVED = 2.0, 6.0
"""Times at rest, before and after, and time of the movement [s]."""


def turns(team: Team, drones: Array, points: Array) -> Array:
    """Angles (2n,) by which cables turn at the clasps."""
    layout, u = team.layout, unit(team.layout.edges(points))
    found = np.zeros(team.drones)
    for i in np.flatnonzero(layout.has_leg.ravel()):
        leg = unit(drones[i] - points[layout.anchors[i]])
        edge = u[i // 2] if i % 2 == 0 else -u[i // 2]
        found[i] = np.arccos(np.clip(-leg @ edge, -1.0, 1.0))
    return found


def clasp_forces(
    team: Team, density: float, drones: Array, points: Array, edges: Array, ratio: Array
) -> Array:
    """Force on every clasp (clasps, 3) [N]; cable by cable, part by part."""
    layout = team.layout
    forces = np.zeros((layout.points, 3))
    legs = np.repeat(edges, 2) * np.exp(ratio * turns(team, drones, points))
    for k in range(team.robots):
        a, b = layout.starts[k], layout.ends[k]
        along = points[b] - points[a]
        forces[a] += edges[k] * unit(along)
        forces[b] -= edges[k] * unit(along)
        for end in (a, b):
            forces[end, 2] -= 0.5 * GRAVITY * density * np.linalg.norm(along)
        for i, p in ((2 * k, a), (2 * k + 1, b)):
            if layout.has_leg.ravel()[i]:
                leg = drones[i] - points[p]
                forces[p] += legs[i] * unit(leg)
                forces[p, 2] -= 0.5 * GRAVITY * density * np.linalg.norm(leg)
    return forces[layout.clasps]


def balanced_points(
    team: Team, density: float, drones: Array, guess: Array, edges: Array, ratio: Array
) -> Array:
    """Points (points, 3) [m] at which all clasps are in balance."""
    layout = team.layout

    def points_of(x: Array) -> Array:
        points = guess.copy()
        points[layout.anchors] = drones
        points[layout.clasps] = x.reshape(-1, 3)
        return points

    def force(x: Array) -> Array:
        return clasp_forces(team, density, drones, points_of(x), edges, ratio).ravel()

    x, _, done, words = fsolve(force, guess[layout.clasps].ravel(), xtol=1e-12, full_output=True)
    assert done == 1 or np.max(np.abs(force(x))) < 1e-9, words
    return points_of(x)


def on_drones(
    team: Team, density: float, drones: Array, points: Array, edges: Array, ratio: Array
) -> Array:
    """Forces of cables on the drones (2n, 3) [N]."""
    legs = np.repeat(edges, 2) * np.exp(ratio * turns(team, drones, points))
    leads = drones - points[team.layout.pulled_to]
    forces = -legs[:, None] * unit(leads)
    forces[:, 2] -= 0.5 * GRAVITY * density * np.linalg.norm(leads, axis=-1)
    return forces


def recorded(
    first: Hitch,
    second: Hitch,
    stiffness: Array,
    density: float,
    friction: float = 0.0,
    wind: tuple[float, float] = (0.0, 0.0),
    share: float = 1.0,
) -> tuple[Task, Recording]:
    """Return a plan from one hitch to another, whose drones do not know the cables' weight, flown.

    ``share``: of the true tension that drones feed forward.
    """
    team, layout, n = first.team, first.team.layout, first.team.robots
    t = np.arange(round((2.0 * HELD + MOVED) * RATE) + 1) / RATE
    s = np.clip((t - HELD) / MOVED, 0.0, 1.0)
    s = s * s * (3.0 - 2.0 * s)
    drones = first.drones + s[:, None, None] * (second.drones - first.drones)
    points, commanded, forces = [], [], []
    guess, legs = first.vertices, []
    for i in (0, len(t) // 2, len(t) - 1):  # without friction, to see which way cables slide
        guess = balanced_points(team, density, drones[i], guess, team.tension, np.zeros(2 * n))
        legs.append(np.linalg.norm(drones[i] - guess[layout.anchors], axis=-1))
    early, late = np.diff(legs, axis=0)
    slides = np.where(early * late > 0.0, np.sign(late), 0.0) * layout.has_leg.ravel()
    guess = first.vertices
    ratio = friction * slides  # clasps about to slide before they do, and stuck afterwards
    for place in drones:
        guess = balanced_points(team, density, place, guess, team.tension, ratio)
        points.append(guess)
        known = share * on_drones(team, 0.0, place, guess, team.tension, 0.0 * ratio)
        true = on_drones(team, density, place, guess, team.tension, ratio)
        true[:, :2] += wind
        forces.append(known)
        commanded.append(place - (true - known) / stiffness[:, None])
    zero = np.zeros_like(drones)
    setpoints = Setpoints(
        np.array(commanded), zero, zero, zero, np.zeros(drones.shape[:2]), np.array(forces)
    )
    count = len(t)
    task = Task(
        team,
        t,
        setpoints,
        np.ones(count, dtype=np.bool_),
        np.array(points),
        np.tile(team.tension, (count, 1)),
    )
    return task, Recording(t, drones, np.array(points))


def shaken(recording: Recording, noise: float, seed: int) -> Recording:
    """Return the recording with white measurement noise."""
    random = np.random.default_rng(seed)
    return replace(
        recording,
        drones=recording.drones + noise * random.normal(size=recording.drones.shape),
        vertices=recording.vertices + noise * random.normal(size=recording.vertices.shape),
    )
