"""The certificate's quantities by brute force over samples.

Shares nothing with the package but the evaluation of polynomials: every distance, angle and force
has its own formula here, and all pairs are looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hitchopt.motion.motion import Motion

Array = NDArray[np.float64]


def sampled(motion: Motion, times: Array) -> dict[str, float]:
    """Return the worst value of every quantity over ``times``; thrust as a share of the largest."""
    return {
        **_distances(motion, times),
        **_rates(motion, times),
        **_forces(motion, times),
        **_shape(motion, times),
    }


def _distances(motion: Motion, times: Array) -> dict[str, float]:
    n = motion.team.robots
    x, p = motion.drones.at(times), motion.vertices.at(times)
    i, j = np.triu_indices(2 * n, 1)
    gap = x[:, i] - x[:, j]
    r, h = motion.requirements.separation.radius, motion.requirements.separation.height
    level = (gap[..., 0] ** 2 + gap[..., 1] ** 2) / (2 * r) ** 2
    found = {"separation": float(np.min(np.sqrt(level + gap[..., 2] ** 2 / (2 * h) ** 2)))}
    parts: list[tuple[str, int, set[int], Array, Array]] = []
    for k in range(n):
        m = (k + 1) % n
        parts.append(("q", k, {k}, p[:, k], x[:, 2 * k]))
        parts.append(("edge", k, {k, m}, p[:, k], p[:, m]))
        parts.append(("r", k, {m}, p[:, m], x[:, 2 * k + 1]))
    begin = np.stack([part[3] for part in parts], axis=1)
    end = np.stack([part[4] for part in parts], axis=1)
    foreign = [
        (drone, m)
        for drone in range(2 * n)
        for m, (kind, k, *_) in enumerate(parts)
        if drone // 2 != k or kind == "edge"
    ]
    d, m_ = np.array(foreign).T
    found["cable_clearance"] = float(np.min(point_to_segment(x[:, d], begin[:, m_], end[:, m_])))
    apart = [(a, b) for a in range(3 * n) for b in range(a) if not parts[a][2] & parts[b][2]]
    a, b = np.array(apart).T
    between = segment_to_segment(begin[:, a], end[:, a], begin[:, b], end[:, b])
    return {**found, "crossing": float(np.min(between))}


def _rates(motion: Motion, times: Array) -> dict[str, float]:
    found = {
        name: float(np.max(np.linalg.norm(motion.drones.at(times, order), axis=-1)))
        for order, name in enumerate(("speed", "acceleration", "jerk"), start=1)
    }
    vertices = np.linalg.norm(motion.vertices.at(times, 1), axis=-1)
    return {**found, "vertex_speed": float(np.max(vertices))}


def _forces(motion: Motion, times: Array) -> dict[str, float]:
    n = motion.team.robots
    x, p = motion.drones.at(times), motion.vertices.at(times)
    T = motion.tensions.at(times)
    edges = np.roll(p, -1, axis=1) - p
    u = edges / np.sqrt(np.sum(edges**2, axis=-1, keepdims=True))
    force = np.empty((len(times), n, 3))
    thrust = np.empty((len(times), 2 * n, 3))
    a = motion.drones.at(times, 2)
    for k in range(n):
        q, r = x[:, 2 * k] - p[:, k], x[:, 2 * k - 1] - p[:, k]  # r of cable k - 1
        q_hat = q / np.linalg.norm(q, axis=-1)[:, None]
        r_hat = r / np.linalg.norm(r, axis=-1)[:, None]
        T_k, T_before = T[:, k, None], T[:, k - 1, None]
        force[:, k] = T_k * q_hat + T_k * u[:, k] + T_before * r_hat - T_before * u[:, k - 1]
        thrust[:, 2 * k] = T_k * q_hat
        thrust[:, 2 * k - 1] = T_before * r_hat
    rho, L = 9.81 * motion.team.cable_density, motion.team.cable_length
    for k in range(n):
        d = np.linalg.norm(x[:, 2 * k] - p[:, k], axis=-1)
        e_behind = np.linalg.norm(x[:, 2 * k - 1] - p[:, k], axis=-1)
        e = np.linalg.norm(x[:, 2 * k + 1] - p[:, (k + 1) % n], axis=-1)
        d_behind = np.linalg.norm(x[:, 2 * k - 2] - p[:, k - 1], axis=-1)
        weight = 0.5 * rho * (L[k] - e + L[k - 1] - d_behind) + 9.81 * motion.team.load[k]
        force[:, k, 2] -= weight
        for drone, leg in ((2 * k, d), (2 * k - 1, e_behind)):
            climb = x[:, drone] - p[:, k]
            grown = 0.5 * rho * climb[:, 2] / leg
            thrust[:, drone] += grown[:, None] * climb
            thrust[:, drone, 2] += 0.5 * rho * leg
            force[:, k] += grown[:, None] * climb
    thrust += motion.team.mass[:, None] * (a + np.array([0.0, 0.0, 9.81]))
    norm = np.linalg.norm(thrust, axis=-1)
    lean = np.degrees(np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2]))
    residual = np.linalg.norm(force, axis=-1) / np.minimum(T, np.roll(T, 1, axis=1))
    return {
        "thrust": float(np.max(norm / motion.team.max_thrust)),
        "tilt": float(np.max(lean)),
        "equilibrium": float(np.max(residual)),
    }


def _shape(motion: Motion, times: Array) -> dict[str, float]:
    n = motion.team.robots
    x, p = motion.drones.at(times), motion.vertices.at(times)
    L = motion.team.cable_length
    edge = np.roll(p, -1, axis=1) - p
    d = np.linalg.norm(x[:, 0::2] - p, axis=-1)
    e = np.linalg.norm(x[:, 1::2] - np.roll(p, -1, axis=1), axis=-1)
    total = np.abs(np.linalg.norm(edge, axis=-1) + d + e + _sag(motion, times) - L)
    stored = np.abs(motion.legs.at(times) - np.stack([d, e], axis=-1))
    heading = np.arctan2(edge[..., 1], edge[..., 0])
    exterior = np.roll(heading, 1, axis=1) - heading
    found = {
        "legs": float(min(np.min(d), np.min(e))),
        "cable_length": float(np.max(np.maximum(total, np.max(stored, axis=-1)) / L)),
        "convexity": float(np.degrees(np.min((exterior + math.pi) % (2 * math.pi) - math.pi))),
    }
    assert n == len(L)
    if motion.requirements.arena is not None:
        walls = np.minimum(x - motion.requirements.arena.lower, motion.requirements.arena.upper - x)
        found["arena"] = float(np.min(walls))
    return found


def _sag(motion: Motion, times: Array) -> Array:
    """By how much cables (times, n) are longer than their straight spans [m]."""
    x, p = motion.drones.at(times), motion.vertices.at(times)
    ratio = 9.81 * motion.team.cable_density / motion.tensions.at(times)
    after = np.roll(p, -1, axis=1)
    longer = np.zeros(ratio.shape)
    for a, b in ((p, x[:, 0::2]), (p, after), (after, x[:, 1::2])):
        level = np.hypot(b[..., 0] - a[..., 0], b[..., 1] - a[..., 1])
        longer += ratio**2 * np.linalg.norm(b - a, axis=-1) * level**2 / 24.0
    return longer


def point_to_segment(x: Array, a: Array, b: Array) -> Array:
    """Distance of points from segments: perpendicular if its foot is between the ends."""
    along = b - a
    length = np.linalg.norm(along, axis=-1)
    foot = np.sum((x - a) * along, axis=-1) / length
    beside = np.linalg.norm(np.cross(x - a, along), axis=-1) / length
    at_ends = np.minimum(np.linalg.norm(x - a, axis=-1), np.linalg.norm(x - b, axis=-1))
    distance: Array = np.where((foot > 0.0) & (foot < length), beside, at_ends)
    return distance


def segment_to_segment(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distance of segments: by ends, and along the common normal where both feet are inside."""
    best = np.minimum(
        np.minimum(point_to_segment(a, c, d), point_to_segment(b, c, d)),
        np.minimum(point_to_segment(c, a, b), point_to_segment(d, a, b)),
    )
    normal = np.cross(b - a, d - c)
    size = np.sum(normal**2, axis=-1)
    skew = size > 1e-12
    safe = np.where(skew, size, 1.0)
    s = np.sum(np.cross(c - a, d - c) * normal, axis=-1) / safe
    t = np.sum(np.cross(c - a, b - a) * normal, axis=-1) / safe
    inside = skew & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    across = np.abs(np.sum((c - a) * normal, axis=-1)) / np.sqrt(safe)
    distance: Array = np.where(inside, np.minimum(across, best), best)
    return distance
