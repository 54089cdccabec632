"""Recordings computed from the laws alone: clasps in balance, drones that give way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fsolve

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.simulation.task import Setpoints, Task
from hitchopt.statics.friction import COSINES, IN_SPACE, TURNS
from hitchopt.statics.recordings import Recording

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


def friction_ratios(team: Team, drones: Array, points: Array, rates: Array) -> Array:
    """Logarithms (2n,) of leg over edge tensions at a friction of 1, clasp by clasp."""
    found, angles = np.zeros(team.drones), turns(team, drones, points)
    for ahead, behind in zip(team.layout.ahead, team.layout.behind, strict=True):
        a, b = 2 * ahead, 2 * behind + 1
        turn = 0.5 * (angles[a] + angles[b])
        c = np.interp(turn, TURNS, COSINES)
        # The surfaces' relative velocity, in the plane that the two cables span.
        first, second = np.array([1.0, 0.0]), np.array([c, np.sqrt(1.0 - c**2)])
        sliding = rates[a] * first - rates[b] * second
        if (speed := np.linalg.norm(sliding)) > 0.0:
            space = np.interp(turn, TURNS, IN_SPACE)
            found[a] = space * angles[a] * (sliding @ first) / speed
            found[b] = -space * angles[b] * (sliding @ second) / speed
    return found


def leg_tensions(
    team: Team, density: float, drones: Array, points: Array, edges: Array, ratio: Array
) -> Array:
    """Tensions along the legs' chords (2n,) [N], ``exp(ratio)`` the edges' at the clasps."""
    found, half = np.zeros(team.drones), 0.5 * GRAVITY * density
    for i, p in enumerate(team.layout.anchors):
        k = i // 2
        other = team.layout.ends[k] if i % 2 == 0 else team.layout.starts[k]
        along = points[other] - points[p]
        pull = edges[k] * unit(along) - [0.0, 0.0, half * np.linalg.norm(along)]
        tension = np.linalg.norm(pull) * np.exp(ratio[i])
        leg = drones[i] - points[p]
        length = np.linalg.norm(leg)
        rise = leg[2] / length if length > 0.0 else 0.0
        weight = half * length
        found[i] = weight * rise + np.sqrt(tension**2 - weight**2 * (1.0 - rise**2))
    legless = ~team.layout.has_leg.ravel()
    found[legless] = np.repeat(edges, 2)[legless]
    return found


def clasp_forces(
    team: Team, density: float, drones: Array, points: Array, edges: Array, ratio: Array
) -> Array:
    """Force on every clasp (clasps, 3) [N]; cable by cable, part by part."""
    layout = team.layout
    forces = np.zeros((layout.points, 3))
    legs = leg_tensions(team, density, drones, points, edges, ratio)
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
    legs = leg_tensions(team, density, drones, points, edges, ratio)
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
    points: list[Array] = []
    commanded, forces = [], []
    moving = np.flatnonzero((t > HELD + 0.8) & (t < HELD + MOVED - 0.8))
    rates = np.zeros((len(t), 2 * n))
    for _ in range(2 if friction else 1):  # which way cables slide follows from the flight itself
        guess, points = first.vertices, []
        for _ in range(4):
            ratio = friction * friction_ratios(team, drones[0], guess, rates[0])
            guess = balanced_points(team, density, drones[0], guess, team.tension, ratio)
        for place, rate in zip(drones, rates, strict=True):
            ratio = friction * friction_ratios(team, place, guess, rate)
            guess = balanced_points(team, density, place, guess, team.tension, ratio)
            points.append(guess)
        legs = np.linalg.norm(drones - np.array(points)[:, layout.anchors], axis=-1)
        # Clasps are about to slide before they do, and stick afterwards.
        final, rates = rates, np.gradient(legs, t, axis=0)
        rates = rates[np.clip(np.arange(len(t)), moving[0], moving[-1])]
    for place, guess, rate in zip(drones, points, final, strict=True):
        ratio = friction * friction_ratios(team, place, guess, rate)
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
