"""Open chains in motion, and the certificate's quantities for them by brute force over samples.

The sampling shares nothing with the package but the evaluation of polynomials: parts are listed by
hand, with their own clasps, and every distance, angle and force has its own formula.
"""

from __future__ import annotations

import math

import numpy as np
from certificate_cases import fitted, smooth_step
from certificate_sampling import point_to_segment, segment_to_segment
from numpy.typing import ArrayLike, NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion, Phase
from hitchopt.requirements import Arena, Limits, Requirements, Separation
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]


def bent(headings: ArrayLike, lengths: ArrayLike, origin: ArrayLike = (1.5, -0.7)) -> Array:
    """(n + 1, 2): edges of these headings [deg] and lengths [m], one after the other."""
    angle = np.radians(np.asarray(headings, dtype=np.float64))
    steps = np.asarray(lengths)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points: Array = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + np.asarray(origin)
    return points


def chain_motion(
    team: Team,
    start: Array,
    end: Array,
    q_legs: ArrayLike,
    *,
    seconds: float = 3.0,
    pieces: int = 6,
    order: int = 7,
    separation: Separation | None = None,
    arena: Arena | None = None,
) -> Motion:
    """Return points that go straight from start to end, inner q-legs constant."""
    breaks = np.linspace(0.0, seconds, pieces + 1)

    def hitches(t: Array) -> list[Hitch]:
        found = []
        for s in smooth_step(t / seconds):
            points = start + s * (end - start)
            d = np.array(q_legs, dtype=np.float64)
            d[0] = 0.0
            d[-1] = team.cable_length[-1] - math.dist(points[-2], points[-1])
            found.append(Hitch(team, points, 1.3, d))
        return found

    def through(name: str) -> PiecewisePolynomial:
        return fitted(breaks, lambda t: np.array([getattr(h, name) for h in hitches(t)]), order)

    return Motion(
        team,
        Requirements(Limits(), separation or Separation(), arena),
        through("drones"),
        through("vertices"),
        through("legs"),
        PiecewisePolynomial.constant(breaks, team.tension),
        (Phase("morph", 0, 0.0, seconds),),
    )


def random_chain(n: int, seed: int) -> Motion:
    """Return a chain of unequal cables and tensions, off the origin, that bends and stretches."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.6, 1.0, n - 1)
    headings = rng.uniform(0.0, 360.0) - np.append(0.0, np.cumsum(turn)) * min(60.0, 200.0 / n)
    lengths = rng.uniform(1.1, 1.4, n)
    start = bent(headings, lengths, rng.uniform(-3.0, 3.0, 2))
    end = bent(
        0.9 * headings + rng.uniform(-20.0, 20.0),
        lengths * rng.uniform(0.92, 1.08, n),
        start[0] + rng.uniform(-0.4, 0.4, 2),
    )
    team = Team(
        n,
        1.1 * lengths + rng.uniform(0.7, 0.9, n),
        topology="open",
        tension=rng.uniform(0.4, 0.44, n),
        cable_density=0.004,
    )
    arena = Arena(np.append(start[0] - 30.0, 0.1), np.append(start[0] + 31.0, 2.9))
    return chain_motion(team, start, end, rng.uniform(0.3, 0.5, n), arena=arena)


def sampled_chain(motion: Motion, times: Array) -> dict[str, float]:
    """Return the worst value of every quantity over ``times``; thrust as a share of the largest."""
    drones, vertices = motion.drones, motion.vertices
    found = {
        name: _largest(np.linalg.norm(drones.at(times, order), axis=-1))
        for order, name in enumerate(("speed", "acceleration", "jerk"), start=1)
    }
    found["vertex_speed"] = _largest(np.linalg.norm(vertices.at(times, 1), axis=-1))
    if motion.requirements.arena is not None:
        x = drones.at(times)
        found["arena"] = _smallest(
            np.minimum(x - motion.requirements.arena.lower, motion.requirements.arena.upper - x)
        )
    return {
        **found,
        **_distances(motion, times),
        **_lengths(motion, times),
        **_forces(motion, times),
        "convexity": _turning(vertices.at(times)),
    }


def _distances(motion: Motion, times: Array) -> dict[str, float]:
    n = motion.team.robots
    x, p = motion.drones.at(times), motion.vertices.at(times)
    clasps = set(range(1, n))
    i, j = np.triu_indices(2 * n, 1)
    ratios = np.linalg.norm((x[:, i] - x[:, j]) / [0.24, 0.24, 0.6], axis=-1)
    parts: list[tuple[str, int, set[int], Array, Array]] = []
    for k in range(n):
        parts.append(("edge", k, {k, k + 1} & clasps, p[:, k], p[:, k + 1]))
        parts += [("q-leg", k, {k}, p[:, k], x[:, 2 * k])] if k in clasps else []
        parts += [("r-leg", k, {k + 1}, p[:, k + 1], x[:, 2 * k + 1])] if k + 1 in clasps else []
    clearance, crossing = [np.inf], [np.inf]
    for index, (kind, k, touched, begin, end) in enumerate(parts):
        for drone in range(2 * n):
            stands_there = drone in {0, 2 * n - 1}
            if drone // 2 != k or (kind == "edge" and not stands_there):
                clearance.append(_smallest(point_to_segment(x[:, drone], begin, end)))
        for _, _, others, first, last in parts[:index]:
            if not touched & others:
                crossing.append(_smallest(segment_to_segment(begin, end, first, last)))
    return {
        "separation": _smallest(ratios),
        "cable_clearance": min(clearance),
        "crossing": min(crossing),
    }


def _lengths(motion: Motion, times: Array) -> dict[str, float]:
    n, length = motion.team.robots, motion.team.cable_length
    x, p, stored = (part.at(times) for part in (motion.drones, motion.vertices, motion.legs))
    used, legs = [], []
    for k in range(n):
        d = np.linalg.norm(x[:, 2 * k] - p[:, k], axis=-1)
        e = np.linalg.norm(x[:, 2 * k + 1] - p[:, k + 1], axis=-1)
        edge = np.linalg.norm(p[:, k + 1] - p[:, k], axis=-1)
        sag = (9.81 * motion.team.cable_density / motion.team.tension[k]) ** 2 / 24.0
        spans = [p[:, k] - x[:, 2 * k], p[:, k + 1] - p[:, k], x[:, 2 * k + 1] - p[:, k + 1]]
        level = [np.linalg.norm(s[:, :2], axis=-1) for s in spans]
        arcs = sag * sum(s * h**2 for s, h in zip((d, edge, e), level, strict=True))
        off = [d + edge + e + arcs - length[k], stored[:, k, 0] - d, stored[:, k, 1] - e]
        used.append(_largest(np.abs(off)) / length[k])
        legs += [_smallest(d)] if k > 0 else []
        legs += [_smallest(e)] if k < n - 1 else []
    return {"cable_length": max(used), "legs": min(legs)}


def _forces(motion: Motion, times: Array) -> dict[str, float]:
    n, team = motion.team.robots, motion.team
    x, p, T = (part.at(times) for part in (motion.drones, motion.vertices, motion.tensions))
    a = motion.drones.at(times, 2)
    thrust, lean, balance = [], [], []
    for drone in range(2 * n):
        k, is_r = divmod(drone, 2)
        own, other = (k + 1, k) if is_r else (k, k + 1)
        from_point = p[:, own if 0 < own < n else other]
        lift = team.mass[drone] * (a[:, drone] + [0.0, 0.0, 9.81])
        half, span = 0.5 * 9.81 * team.cable_density, x[:, drone] - from_point
        lift = lift + (T[:, k] + half * span[:, 2])[:, None] * _unit(span)
        lift[:, 2] += half * np.linalg.norm(span, axis=-1)
        size = np.linalg.norm(lift, axis=-1)
        thrust.append(_largest(size) / team.max_thrust[drone])
        lean.append(_largest(np.degrees(np.arccos(lift[:, 2] / size))))
    for k in range(1, n):
        here, ahead, behind = p[:, k], T[:, k, None], T[:, k - 1, None]
        force = ahead * (_unit(x[:, 2 * k] - here) + _unit(p[:, k + 1] - here))
        force = force + behind * (_unit(x[:, 2 * k - 1] - here) + _unit(p[:, k - 1] - here))
        half = 0.5 * 9.81 * team.cable_density
        for drone in (2 * k, 2 * k - 1):
            span = x[:, drone] - here
            force += half * span[:, 2:] * _unit(span)
        e = np.linalg.norm(x[:, 2 * k + 1] - p[:, k + 1], axis=-1)
        d_behind = np.linalg.norm(x[:, 2 * k - 2] - p[:, k - 1], axis=-1)
        # A cable's ends at the chain's ends stand on their points, wrong plans or not.
        e, d_behind = e * (k + 1 < n), d_behind * (k > 1)
        force[:, 2] -= half * (team.cable_length[k] - e + team.cable_length[k - 1] - d_behind)
        ratio = np.linalg.norm(force, axis=-1) / np.minimum(ahead, behind)[:, 0]
        balance.append(_largest(ratio))
    return {"thrust": max(thrust), "tilt": max(lean), "equilibrium": max(balance)}


def _turning(p: Array) -> float:
    steps = np.diff(p[..., 0] + 1j * p[..., 1], axis=1)
    exterior = -np.degrees(np.angle(steps[:, 1:] / steps[:, :-1]))
    return min(_smallest(exterior), _smallest(360.0 - np.sum(exterior, axis=1)))


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _smallest(values: ArrayLike) -> float:
    return float(np.min(np.asarray(values)))


def _largest(values: ArrayLike) -> float:
    return float(np.max(np.asarray(values)))
