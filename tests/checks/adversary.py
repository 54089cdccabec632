"""An adversary that displaces drones and vertices until a distance is broken.

It shares nothing with ``tracking_radius`` but the polynomials: at sampled times it pushes bodies
toward each other in many directions, measures the displaced geometry, and halves the interval in
which the smallest radius lies that breaks a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.segments import differences, shortest_offset
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.parts import CABLE, CROSSING, Parts
from hitchopt.motion.motion import CableState, Motion

Array = NDArray[np.float64]
Index = NDArray[np.intp]

TIMES = 100
"""Sampled times of a plan besides its breaks, and half as many about the one that is worst."""

CANDIDATES = 12
"""Pairs of bodies of a kind, the nearest ones, that are displaced at one time."""

DIRECTIONS = 32
"""Directions in which each pair is pushed, besides along its shortest connection."""

HALVINGS = 24
"""Halvings of the interval in which the radius of a pair lies."""

LARGEST = 2.0
"""[m] Displacements that are tried at most."""

POINTS = np.linspace(-1.0, 1.0, 81)
"""Places on a hanging cable at which its distance is measured."""


@dataclass(frozen=True)
class Attack:
    """The smallest displacement that was found to break something.

    Attributes
    ----------
    radius: [m]
    time: [s]
    what: which distance.
    """

    radius: float
    time: float = 0.0
    what: str = ""


def attack(motion: Motion, gamma: float = 1.0, count: int = TIMES) -> Attack:
    """Return the smallest radius at which a displacement was found that breaks a distance.

    Parameters
    ----------
    gamma: how many times farther than drones vertices may be off.
    count: sampled times, besides the plan's breaks.
    """
    rng = np.random.default_rng(0)
    start, end = float(motion.drones.breaks[0]), float(motion.drones.breaks[-1])
    times = np.union1d(np.linspace(start, end, count), motion.drones.breaks)
    best = _worst(motion, times, gamma, rng)
    step = (end - start) / count
    near = np.linspace(max(start, best.time - step), min(end, best.time + step), count // 2)
    return min(best, _worst(motion, near, gamma, rng), key=lambda found: found.radius)


def _worst(motion: Motion, times: Array, gamma: float, rng: np.random.Generator) -> Attack:
    best = Attack(LARGEST)
    for t in times:
        moment = _Moment(motion, float(t), gamma, rng)
        for radius, what in moment.attacks(lambda: best.radius):  # noqa: B023
            if radius < best.radius:
                best = Attack(radius, float(t), what)
    return best


@dataclass(eq=False)
class _Moment:
    """A plan at one time, to be displaced."""

    motion: Motion
    t: float
    gamma: float
    rng: np.random.Generator

    def attacks(self, known: Callable[[], float]) -> Iterator[tuple[float, str]]:
        """Yield radii that break something, and what; those beyond ``known`` may be left out."""
        drones, requirements = self.motion.drones.at(self.t), self.motion.requirements
        yield self._drones(drones), "separation"
        if requirements.arena is not None:
            walls = (drones - requirements.arena.lower, requirements.arena.upper - drones)
            yield float(max(np.min(walls), 0.0)), "arena"
        for prism in requirements.keep_out:
            gap = np.min(prism.clearance(drones).distance) - requirements.separation.radius
            yield float(max(gap, 0.0)), "keep_out"
        if not self.motion.team.has_cables:
            return
        i = int(np.searchsorted(self.motion.drones.breaks[1:-1], self.t))
        state = self.motion.phases[int(self.motion.phase_of_piece[i])].state
        if state is CableState.HITCHED:
            yield from self._hitch(drones, known)
        else:
            apart = np.linalg.norm(drones[1::2] - drones[0::2], axis=-1)
            yield float(np.min(self.motion.team.cable_length - apart)) / 2.0, "span"
            yield from self._free(drones, state, known)

    def _drones(self, drones: Array) -> float:
        """Displace pairs of drones: along a direction their ellipsoids touch at a quadratic's root.

        Each moves by half of it.
        """
        i, j = np.triu_indices(len(drones), 1)
        if len(i) == 0:
            return LARGEST
        scale = self.motion.requirements.separation.scale
        offsets = drones[i] - drones[j]
        ratio = np.linalg.norm(offsets * scale, axis=-1)
        chosen = np.argsort(ratio)[: 4 * CANDIDATES]
        offsets = offsets[chosen]
        if np.min(ratio) <= 1.0:
            return 0.0
        aims, spread = -offsets, 1.0
        best = np.full(len(offsets), LARGEST)
        for _ in range(6):  # directions about the best one so far, ever closer
            noise = self.rng.normal(size=(len(offsets), DIRECTIONS, 3))
            tried = _unit(aims)[:, None] + spread * noise * (np.arange(DIRECTIONS) > 0)[:, None]
            along = _unit(tried) * scale
            here = offsets[:, None] * scale
            a, b = np.sum(along**2, axis=-1), np.sum(along * here, axis=-1)
            c = np.sum(here**2, axis=-1) - 1.0
            root = b * b - a * c
            met = (root >= 0.0) & (b < 0.0)
            shift = np.where(met, (-b - np.sqrt(np.maximum(root, 0.0))) / a, 2.0 * LARGEST)
            least = np.argmin(shift, axis=1)
            each = np.arange(len(offsets))
            better = 0.5 * shift[each, least] < best
            best = np.where(better, 0.5 * shift[each, least], best)
            aims = np.where(better[:, None], tried[each, least], aims)
            spread *= 0.4
        return float(np.min(best))

    def _hitch(self, drones: Array, known: Callable[[], float]) -> Iterator[tuple[float, str]]:
        """Displace pairs of drones and taut parts, and of taut parts."""
        team, requirements = self.motion.team, self.motion.requirements
        parts = Parts.of(team.robots, team.topology)
        vertices = self.motion.vertices.at(self.t)
        nodes = np.concatenate([vertices, drones])
        reach = np.concatenate([np.full(len(vertices), self.gamma), np.ones(len(drones))])
        legs = parts.layout.drones_with_legs
        lengths = np.linalg.norm(drones - vertices[parts.layout.anchors], axis=-1)[legs]
        yield (
            max(float(np.min(lengths)) - requirements.limits.leg, 0.0) / (1.0 + self.gamma),
            "legs",
        )
        i, j = np.triu_indices(len(parts.nodes), 1)
        kind = parts.kind(i, j)
        for which, limit, name in (
            (CABLE, requirements.separation.cable, "cable_clearance"),
            (CROSSING, requirements.separation.crossing, "crossing"),
        ):
            first, second = (parts.nodes[index[kind == which]] for index in (i, j))
            yield self._bodies(nodes, reach, first, second, limit, known()), name

    def _free(
        self, drones: Array, state: CableState, known: Callable[[], float]
    ) -> Iterator[tuple[float, str]]:
        """Displace chords as seen from above, and drones against hanging cables."""
        team, separation = self.motion.team, self.motion.requirements.separation
        flat, ones = drones * [1.0, 1.0, 0.0], np.ones(len(drones))
        chords = np.arange(len(drones)).reshape(-1, 2)
        i, j = np.triu_indices(team.robots, 1)
        if state in {CableState.CLASPING, CableState.TIGHTENING}:
            layout = team.layout
            held = {tuple(sorted(pair)) for pair in zip(layout.ahead, layout.behind, strict=True)}
            apart = np.array([(a, b) not in held for a, b in zip(i, j, strict=True)], dtype=bool)
            i, j = i[apart], j[apart]
        limit = separation.crossing
        yield self._bodies(flat, ones, chords[i], chords[j], limit, known()), "crossing"
        if state is CableState.GROUND:
            d, k = (index.ravel() for index in np.indices((len(drones), team.robots)))
            d, k = d[d // 2 != k], k[d // 2 != k]
            points = np.stack([d, d], axis=1)
            limit = separation.cable
            yield self._bodies(flat, ones, points, chords[k], limit, known()), "cable_clearance"
        else:
            yield self._hanging(drones, known()), "cable_clearance"

    def _bodies(
        self, nodes: Array, reach: Array, first: Index, second: Index, limit: float, most: float
    ) -> float:
        """Return the smallest radius at which displaced ends (m, 2) of bodies break the limit."""
        if len(first) == 0:
            return LARGEST

        def offset(pairs: tuple[Index, Index], shift: Array) -> Array:
            """Return the shortest offsets (…, m, 3) with ends moved by ``shift`` (…, m, 3)."""
            ends = [
                nodes[pair] + sign * reach[pair][..., None] * shift[..., None, :]
                for pair, sign in zip(pairs, (1.0, -1.0), strict=True)
            ]
            return shortest_offset(differences(*ends))

        here = offset((first, second), np.zeros((len(first), 3)))
        gaps = np.linalg.norm(here, axis=-1)
        chosen = np.argsort(gaps)[:CANDIDATES]
        chosen = chosen[gaps[chosen] < limit + 2.0 * max(1.0, self.gamma) * most]
        if len(chosen) == 0:
            return LARGEST
        pairs = (first[chosen], second[chosen])
        noise = 0.3 * self.rng.normal(size=(DIRECTIONS, len(chosen), 3))
        noise[0] = 0.0
        flat = not np.any(nodes[:, 2])
        towards = -_unit(_unit(here[chosen]) + noise * ([1.0, 1.0, 0.0] if flat else 1.0))

        def broken(radius: float) -> bool:
            return bool(np.min(np.linalg.norm(offset(pairs, radius * towards), axis=-1)) < limit)

        return _halved(broken, most)

    def _hanging(self, drones: Array, most: float) -> float:
        """Displace drones toward hanging cables, and ends of these in any direction."""
        limit, floor = self.motion.requirements.separation.cable, self.motion.requirements.floor
        L = self.motion.team.cable_length
        points = _cables(drones[0::2], drones[1::2], L)
        gaps = np.linalg.norm(drones[:, None, None] - points, axis=-1)
        gaps[np.arange(len(drones)), np.arange(len(drones)) // 2] = np.inf
        order = np.argsort(np.min(gaps, axis=2), axis=None)[:CANDIDATES]
        d, k = np.unravel_index(order, gaps.shape[:2])
        nearest = points[k, np.argmin(gaps[d, k], axis=-1)]
        pull = _unit(drones[d] - nearest)  # the cable goes there, the drone comes
        noise = self.rng.normal(size=(2, DIRECTIONS, len(d), 3))
        noise[:, 0] = 0.0
        ends = _unit(pull + 0.7 * noise)
        low = np.array([0.0, 0.0, -1.0])
        sinking = _unit(low + 0.7 * self.rng.normal(size=(2, DIRECTIONS, len(L), 3)))

        def broken(radius: float) -> bool:
            q, r = drones[0::2][k] + radius * ends[0], drones[1::2][k] + radius * ends[1]
            moved = drones[d] - radius * pull
            apart = np.linalg.norm(_cables(q, r, L[k]) - moved[:, None], axis=-1)
            sunk = _cables(
                drones[0::2] + radius * sinking[0], drones[1::2] + radius * sinking[1], L
            )
            return bool(np.min(apart) < limit or np.min(sunk[..., 2]) - floor < limit)

        return _halved(broken, most)


def _halved(broken: Callable[[float], bool], most: float) -> float:
    """Return about the smallest radius at most ``most`` that breaks something, else ``LARGEST``."""
    if not broken(most):
        return LARGEST
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if broken(middle) else (middle, high)
    return high


def _cables(q: Array, r: Array, length: Array) -> Array:
    """Return points (…, POINTS, 3) of cables that hang between ends (…, 3)."""
    cable = Catenary.between(q, r, np.broadcast_to(length, q.shape[:-1]))
    wide = Catenary(*(np.asarray(value)[..., None] for value in vars(cable).values()))
    share = 0.5 * (1.0 + POINTS)[:, None]
    points = (1.0 - share) * q[..., None, :] + share * r[..., None, :]
    points[..., 2] -= wide.depth(POINTS)
    return points


def _unit(vectors: Array) -> Array:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = vectors / np.where(size > 0.0, size, 1.0)
    return unit
