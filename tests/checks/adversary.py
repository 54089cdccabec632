"""An adversary that displaces drones and vertices until a distance is broken.

It shares nothing with ``tracking_radius`` but the polynomials: at sampled times it pushes bodies
toward each other in many directions, measures the displaced geometry, and halves the interval in
which the smallest radius lies that breaks a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np
from certificate_sampling import cable_points
from numpy.typing import NDArray

from hitchopt.geometry.vectors import differences, shortest_offset, unit
from hitchopt.hitch.leg_program import CABLE, CROSSING, Parts
from hitchopt.motion.motion import CableState, Motion

Array = NDArray[np.float64]

CANDIDATES, DIRECTIONS = 12, 32
"""Nearest pairs of bodies that are displaced at one time, and directions that are tried."""

LARGEST = 2.0
"""[m] Displacements that are tried at most."""


def attack(motion: Motion, gamma: float = 1.0, count: int = 100) -> float:
    """Return the smallest radius at which a displacement was found that breaks a distance.

    Vertices may be off ``gamma`` times farther than drones; ``count`` times besides the breaks.
    """
    rng, breaks = np.random.default_rng(0), motion.drones.breaks
    times = np.union1d(np.linspace(breaks[0], breaks[-1], count), breaks)
    best, when = LARGEST, float(breaks[0])
    step = motion.duration / count
    for finer in (False, True):
        if finer:
            near = np.linspace(when - step, when + step, count // 2)
            times = np.clip(near, breaks[0], breaks[-1])
        for t in times.tolist():
            for broken in _ways(motion, t, gamma, rng):
                if broken(best):
                    best, when = _halved(broken, best), t
    return best


def _halved(broken: Callable[[float], bool], most: float) -> float:
    low, high = 0.0, most
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if broken(middle) else (middle, high)
    return high


def _ways(
    motion: Motion, t: float, gamma: float, rng: np.random.Generator
) -> Iterator[Callable[[float], bool]]:
    """Yield functions that say whether a radius breaks something at a time."""
    drones, requirements, team = motion.drones.at(t), motion.requirements, motion.team
    separation = requirements.separation
    i, j = np.triu_indices(len(drones), 1)
    offsets = drones[i] - drones[j]

    def touching(radius: float) -> bool:
        """Each pair moves where its scaled offset shrinks most, which a few steps find."""
        moved, scale = offsets, separation.scale
        for _ in range(30):
            moved = offsets - 2.0 * radius * unit(scale**2 * moved)
        through = np.linalg.norm(offsets, axis=-1) <= 2.0 * radius
        through |= np.linalg.norm(offsets * scale, axis=-1) <= 1.0
        return bool(np.any(through | (np.linalg.norm(moved * scale, axis=-1) < 1.0)))

    if len(offsets):
        yield touching
    rest = []
    if (arena := requirements.arena) is not None:
        rest += [np.min(drones - arena.lower), np.min(arena.upper - drones)]
    for prism in requirements.keep_out:
        rest.append(np.min(prism.clearance(drones).distance) - separation.radius)
    if team.has_cables:
        piece = int(np.searchsorted(motion.drones.breaks[1:-1], t))
        state = motion.phases[int(motion.phase_of_piece[piece])].state
        if state is CableState.HITCHED:
            yield from _taut(motion, t, gamma, rng)
            vertices = motion.vertices.at(t)[team.layout.anchors]
            legs = np.linalg.norm(drones - vertices, axis=-1)[team.layout.has_leg.ravel()]
            rest.append((np.min(legs) - requirements.limits.leg) / (1.0 + gamma))
        else:
            apart = np.linalg.norm(drones[1::2] - drones[0::2], axis=-1)
            rest.append(np.min(team.cable_length - apart) / 2.0)
            yield from _free(motion, drones, state, rng)
    if rest:
        yield lambda radius: bool(radius > max(min(rest), 0.0))


def _taut(
    motion: Motion, t: float, gamma: float, rng: np.random.Generator
) -> Iterator[Callable[[float], bool]]:
    """Displace pairs of drones and taut parts, and of taut parts."""
    parts = Parts.of(motion.team.robots, motion.team.topology)
    vertices, drones = motion.vertices.at(t), motion.drones.at(t)
    nodes = np.concatenate([vertices, drones])
    reach = np.repeat([gamma, 1.0], [len(vertices), len(drones)])
    i, j = np.triu_indices(len(parts.nodes), 1)
    separation, kind = motion.requirements.separation, parts.kind(i, j)
    for which, limit in ((CABLE, separation.cable), (CROSSING, separation.crossing)):
        pairs = parts.nodes[i[kind == which]], parts.nodes[j[kind == which]]
        yield from _bodies(nodes, reach, pairs, limit, rng)


def _bodies(
    nodes: Array,
    reach: Array,
    pairs: tuple[NDArray[np.intp], NDArray[np.intp]],
    limit: float,
    rng: np.random.Generator,
) -> Iterator[Callable[[float], bool]]:
    """Displace ends (m, 2) of the nearest bodies toward each other."""

    def offset(pairs: tuple[NDArray[np.intp], ...], shift: Array) -> Array:
        ends = [
            nodes[pair] + sign * reach[pair][..., None] * shift[..., None, :]
            for pair, sign in zip(pairs, (1.0, -1.0), strict=True)
        ]
        return shortest_offset(differences(*ends))

    if len(pairs[0]) == 0:
        return
    here = offset(pairs, np.zeros((len(pairs[0]), 3)))
    chosen = np.argsort(np.linalg.norm(here, axis=-1))[:CANDIDATES]
    near = pairs[0][chosen], pairs[1][chosen]
    noise = 0.3 * rng.normal(size=(DIRECTIONS, len(chosen), 3))
    noise[0] = 0.0
    toward = -unit(unit(here[chosen]) + noise * [1.0, 1.0, float(np.any(nodes[:, 2]))])
    yield lambda radius: bool(
        np.min(np.linalg.norm(offset(near, radius * toward), axis=-1)) < limit
    )


def _free(
    motion: Motion, drones: Array, state: CableState, rng: np.random.Generator
) -> Iterator[Callable[[float], bool]]:
    """Displace chords as seen from above, and drones and the ground against hanging cables."""
    team, separation = motion.team, motion.requirements.separation
    flat, ones = drones * [1.0, 1.0, 0.0], np.ones(len(drones))
    chords, layout = np.arange(len(drones)).reshape(-1, 2), team.layout
    held = set()
    if state in {CableState.CLASPING, CableState.TIGHTENING}:
        held = {tuple(sorted(pair)) for pair in zip(layout.ahead, layout.behind, strict=True)}
    crossing = [pair for pair in combinations(range(team.robots), 2) if pair not in held]
    i, j = np.array(crossing, dtype=np.intp).reshape(-1, 2).T
    yield from _bodies(flat, ones, (chords[i], chords[j]), separation.crossing, rng)
    d, k = (index.ravel() for index in np.indices((len(drones), team.robots)))
    d, k = d[d // 2 != k], k[d // 2 != k]
    if state is CableState.GROUND:
        points = np.stack([d, d], axis=1)
        yield from _bodies(flat, ones, (points, chords[k]), separation.cable, rng)
        return
    cables, length = cable_points(team.cable_length, drones, 81), team.cable_length
    gaps = np.linalg.norm(drones[d, None] - cables[k], axis=-1)
    near = np.argsort(np.min(gaps, axis=-1))[:CANDIDATES]
    d, k, nearest = d[near], k[near], np.argmin(gaps[near], axis=-1)
    pull = unit(drones[d] - cables[k, nearest])  # the cable goes there, the drone comes
    ends = np.stack([2 * k, 2 * k + 1], axis=1).ravel()
    noise = rng.normal(size=(2, DIRECTIONS, max(len(ends), len(drones)), 3))
    noise[:, 0] = 0.0
    aside = unit(np.repeat(pull, 2, axis=0) + 0.7 * noise[0, :, : len(ends)])
    sinking = unit([0.0, 0.0, -1.0] + 0.7 * noise[1, :, : len(drones)])

    def broken(radius: float) -> bool:
        moved = cable_points(length[k], drones[ends] + radius * aside, 81)
        gaps = np.linalg.norm(moved - (drones[d] - radius * pull)[:, None], axis=-1)
        lowest = np.min(cable_points(length, drones + radius * sinking, 81)[..., 2])
        floor = motion.requirements.floor
        return bool(np.min(gaps) < separation.cable or lowest - floor < separation.cable)

    yield broken
