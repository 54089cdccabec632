"""The certificate's quantities by brute force over samples: hitches, open chains, free cables.

Shares nothing with the package but the evaluation of polynomials: who is where is listed by hand,
every distance, angle and force has its own formula here, and all pairs are looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at

Array = NDArray[np.float64]


class Samples:
    """Where everything is at times: drones x, points p, and which drone hangs on a leg."""

    def __init__(self, motion: Motion, times: Array) -> None:
        self.motion, self.team, self.n = motion, motion.team, motion.team.robots
        self.x, self.p, self.T = (
            part.at(times) for part in (motion.drones, motion.vertices, motion.tensions)
        )
        self.a, self.stored = motion.drones.at(times, 2), motion.legs.at(times)
        self.P = motion.pulls.at(times)  # of legs: friction makes them other than tensions
        points = self.p.shape[1]
        closed = points == self.n
        self.first, self.last = np.arange(self.n), (np.arange(self.n) + 1) % points
        self.own = np.stack([self.first, self.last], axis=1).ravel()  # each drone's point
        self.legged = np.ones(2 * self.n, dtype=np.bool_)
        if not closed:
            self.legged[[0, -1]] = False
        self.clasps = np.arange(points) if closed else np.arange(1, self.n)
        self.edges = self.p[:, self.last] - self.p[:, self.first]
        self.legs = self.x - self.p[:, self.own]
        self.half = 0.5 * 9.81 * self.team.cable_density


def sampled(motion: Motion, times: Array) -> dict[str, float]:
    """Return the worst value of every quantity over ``times``; thrust as a share of the largest."""
    s = Samples(motion, times)
    found = {**_distances(s), **_rates(motion, times), **_forces(s), **_shape(s)}
    if motion.requirements.limits.body_rate is not None:
        h = 1e-5  # [s] between samples and those that thrusts are differentiated by
        breaks = motion.drones.breaks
        smooth = times[np.min(np.abs(times[:, None] - breaks), axis=1) > 2.0 * h]
        before, after = (_thrusts(Samples(motion, smooth + sign * h)) for sign in (-1.0, 1.0))
        found["body_rate"] = _turning(0.5 * (before + after), (after - before) / (2.0 * h))
    return found


def sampled_free(motion: Motion, times: Array) -> dict[str, float]:
    """Return the same of drones whose cables hang free; thrusts as setpoints have them."""
    team, separation = motion.team, motion.requirements.separation
    x, states = motion.drones.at(times), states_at(motion, times)
    few = x[:: max(1, len(times) // 500)]
    points, each = cable_points(team.cable_length, few), np.arange(team.drones)
    apart = np.linalg.norm(few[:, :, None, None] - points[:, None], axis=-1)
    apart[:, each, each // 2] = math.inf
    chords = x[..., :2].reshape(len(times), -1, 2, 2)
    i, j = np.triu_indices(team.robots, 1)
    flat = np.concatenate([chords, np.zeros_like(chords[..., :1])], axis=-1)
    crossing = segment_to_segment(flat[:, i, 0], flat[:, i, 1], flat[:, j, 0], flat[:, j, 1])
    spans = np.linalg.norm(x[:, 1::2] - x[:, 0::2], axis=-1)
    thrust = states.thrusts(team)
    scaled = x / [2.0 * separation.radius] * [1.0, 1.0, separation.radius / separation.height]
    i, j = np.triu_indices(team.drones, 1)
    rates = _rates(motion, times)
    del rates["vertex_speed"]  # there are none
    return {
        **rates,
        **_walls(motion, x),
        "separation": float(np.min(np.linalg.norm(scaled[:, i] - scaled[:, j], axis=-1))),
        "cable_clearance": float(min(np.min(apart), np.min(points[..., 2]) - _floor(motion))),
        "crossing": float(np.min(crossing)),
        "span": float(np.max(spans / team.cable_length)),
        "thrust": float(np.max(np.linalg.norm(thrust, axis=-1) / team.max_thrust)),
        "tilt": _tilt(thrust),
        "body_rate": _turning(thrust, states.thrust_rates(team)),
    }


def _floor(motion: Motion) -> float:
    arena = motion.requirements.arena
    return 0.0 if arena is None else float(arena.lower[2])


def cable_points(length: Array, drones: Array, count: int = 201) -> Array:
    """Points (…, n, count, 3) of the hanging cables of drones (…, 2n, 3)."""
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    cables = Catenary.between(q, r, np.broadcast_to(length, q.shape[:-1]))
    mu = np.moveaxis(
        np.array([cables.place(share) for share in np.linspace(0.0, 1.0, count)]), 0, -1
    )
    points = q[..., None, :] + (0.5 * (1.0 + mu))[..., None] * (r - q)[..., None, :]
    stacked = Catenary(*(x[..., None] for x in vars(cables).values()))
    points[..., 2] -= stacked.depth(mu)
    return points


def _tilt(thrust: Array) -> float:
    """The largest lean [deg]."""
    level = np.hypot(thrust[..., 0], thrust[..., 1])
    return float(np.max(np.degrees(np.arctan2(level, thrust[..., 2]))))


def _turning(thrust: Array, rate: Array) -> float:
    """The largest turning rate [deg/s]."""
    turning = np.linalg.norm(np.cross(thrust, rate), axis=-1) / np.sum(thrust**2, axis=-1)
    return math.degrees(float(np.max(turning)))


def _distances(s: Samples) -> dict[str, float]:
    i, j = np.triu_indices(2 * s.n, 1)
    gap, separation = s.x[:, i] - s.x[:, j], s.motion.requirements.separation
    r, h = separation.radius, separation.height
    level = (gap[..., 0] ** 2 + gap[..., 1] ** 2) / (2 * r) ** 2
    found = {"separation": float(np.min(np.sqrt(level + gap[..., 2] ** 2 / (2 * h) ** 2)))}
    parts: list[tuple[bool, int, set[int], Array, Array]] = []
    for k, (a, b) in enumerate(zip(s.first.tolist(), s.last.tolist(), strict=True)):
        both = {a, b} & set(s.clasps.tolist())
        parts.append((True, k, both, s.p[:, a], s.p[:, b]))
        parts += [(False, k, {a}, s.p[:, a], s.x[:, 2 * k])] * bool(s.legged[2 * k])
        parts += [(False, k, {b}, s.p[:, b], s.x[:, 2 * k + 1])] * bool(s.legged[2 * k + 1])
    begin = np.stack([part[3] for part in parts], axis=1)
    end = np.stack([part[4] for part in parts], axis=1)
    d, m = np.array(
        [
            (drone, m)
            for drone in range(2 * s.n)
            for m, (is_edge, k, *_) in enumerate(parts)
            if drone // 2 != k or (is_edge and s.legged[drone])
        ]
    ).T
    found["cable_clearance"] = float(np.min(point_to_segment(s.x[:, d], begin[:, m], end[:, m])))
    apart = [(a, b) for a in range(len(parts)) for b in range(a) if not parts[a][2] & parts[b][2]]
    i, j = np.array(apart, dtype=np.intp).reshape(-1, 2).T
    between = segment_to_segment(begin[:, i], end[:, i], begin[:, j], end[:, j])
    return {**found, "crossing": float(np.min(between, initial=math.inf))}


def _rates(motion: Motion, times: Array) -> dict[str, float]:
    found = {
        name: float(np.max(np.linalg.norm(motion.drones.at(times, order), axis=-1)))
        for order, name in enumerate(("speed", "acceleration", "jerk"), start=1)
    }
    vertices = np.linalg.norm(motion.vertices.at(times, 1), axis=-1)
    return {**found, "vertex_speed": float(np.max(vertices))}


def _pulls(s: Samples) -> tuple[Array, Array]:
    """What cables pull drones with along their chords, and the lengths of these."""
    other = np.stack([s.last, s.first], axis=1).ravel()
    span = s.x - s.p[:, np.where(s.legged, s.own, other)]  # along which each cable pulls
    size = np.linalg.norm(span, axis=-1)
    root = np.sqrt(s.P**2 - (s.half * _level(span)) ** 2)
    return ((s.half * span[..., 2] + root) / size)[..., None] * span, size


def _thrusts(s: Samples) -> Array:
    pull, size = _pulls(s)
    thrust: Array = s.team.mass[:, None] * (s.a + np.array([0.0, 0.0, 9.81])) + pull
    thrust[..., 2] += s.half * size
    return thrust


def _forces(s: Samples) -> dict[str, float]:
    """Thrusts, and at clasps what legs, edges and weights leave."""
    (pull, _), thrust = _pulls(s), _thrusts(s)
    along = s.edges / np.linalg.norm(s.edges, axis=-1, keepdims=True)
    legs = np.linalg.norm(s.legs, axis=-1) * s.legged  # none at a chain's ends, right or wrong
    edge_pull = np.sqrt(s.T**2 - (s.half * _level(s.edges)) ** 2)
    balance = []
    for i, here in enumerate(s.clasps.tolist()):
        k, m = here, here - 1  # the cables ahead and behind
        T, T_m = s.T[:, k], s.T[:, m]
        ahead, behind = edge_pull[:, k, None], edge_pull[:, m, None]
        force = pull[:, 2 * k] + ahead * along[:, k] + pull[:, 2 * m + 1] - behind * along[:, m]
        carried = s.team.cable_length[[k, m]] - legs[:, [2 * k + 1, 2 * m]]
        force[:, 2] -= s.half * np.sum(carried, axis=1) + 9.81 * s.team.load[i]
        balance.append(np.max(np.linalg.norm(force, axis=-1) / np.minimum(T, T_m)))
    return {
        "thrust": float(np.max(np.linalg.norm(thrust, axis=-1) / s.team.max_thrust)),
        "tilt": _tilt(thrust),
        "equilibrium": float(max(balance)),
    }


def _level(spans: Array) -> Array:
    """The lengths of spans seen from above."""
    return np.hypot(spans[..., 0], spans[..., 1])


def _shape(s: Samples) -> dict[str, float]:
    legs = np.linalg.norm(s.legs, axis=-1)
    total = np.linalg.norm(s.edges, axis=-1) + legs[:, 0::2] + legs[:, 1::2]
    for span in (s.edges, s.legs[:, 0::2], s.legs[:, 1::2]):  # by how much each of them sags
        size = np.linalg.norm(span, axis=-1)
        total += (2.0 * s.half / s.T) ** 2 * size * _level(span) ** 2 / 24.0
    told = np.max(np.abs(s.stored - legs.reshape(s.stored.shape)), axis=-1)
    off = np.maximum(np.abs(total - s.team.cable_length), told) / s.team.cable_length
    heading = np.arctan2(s.edges[..., 1], s.edges[..., 0])
    exterior = heading[:, s.clasps - 1] - heading[:, s.clasps % s.n]
    exterior = (exterior + math.pi) % (2 * math.pi) - math.pi
    least = np.min(exterior)
    if len(s.clasps) < s.n:  # a chain must not go around more than once either
        least = min(least, np.min(2 * math.pi - np.sum(exterior, axis=1)))
    found = {
        "legs": float(np.min(legs[:, s.legged])),
        "cable_length": float(np.max(off)),
        "convexity": math.degrees(least),
    }
    return found | _walls(s.motion, s.x)


def _walls(motion: Motion, x: Array) -> dict[str, float]:
    if (arena := motion.requirements.arena) is None:
        return {}
    return {"arena": float(np.min(np.minimum(x - arena.lower, arena.upper - x)))}


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
