"""The certificate's quantities computed another way: by brute force over samples.

Shares nothing with the package but polynomials and the catenary: who is where is listed by hand,
every distance, angle and force has its own formula here, and all pairs are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Set
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import certify
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Prism, Separation
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.motions import row

G = 9.81
UNSAMPLED = {"continuity", "tension", "duration", "interlacing", "swing"}
"""Checks against limits of which samples say nothing."""


def assert_sound(
    motion: Motion, count: int, gap: float, least: float, only: Set[str] = frozenset()
) -> None:
    """Assert that bounds hold for samples, within a relative ``gap`` of the worst, or ``least``."""
    checks = [row(motion, name) for name in sorted(only)] or certify(motion).checks
    breaks = motion.drones.breaks  # where it may jump
    times = np.concatenate([np.linspace(breaks[0], breaks[-1], count), breaks, breaks[1:] - 1e-12])
    result = sampled(motion, times, only)
    counted = [check for check in checks if check.limit is not None]
    assert {check.name for check in counted} <= set(result) | UNSAMPLED
    for check in (each for each in counted if each.name in result):
        name, value = check.name, result[check.name]
        if math.isinf(value):  # a chain of two has no cables that could cross
            assert (check.is_evaluated, check.holds, check.where) == (False, True, ())
            continue
        worst = check.worst
        if name == "thrust":  # as a share of the largest
            worst /= motion.team.max_thrust[motion.team.drone_names.index(check.where[0])]
        outside = value - worst if check.sense == "min" else worst - value
        slack = {"body_rate": 1e-7}.get(name, 1e-9 * (not motion.formed.all())) * abs(value)
        assert outside >= -slack, f"{name}: {worst} is beaten by {value}"
        assert outside <= max(gap * abs(value), least), f"{name}: {worst} for {value}"


class Samples:
    """States at times: drones x, points p, and which drones have a leg."""

    def __init__(self, motion: Motion, times: Array) -> None:
        self.motion, self.team, self.n = motion, motion.team, motion.team.robots
        self.x, self.p, self.T = (
            part.at(times) for part in (motion.drones, motion.vertices, motion.tensions)
        )
        self.stored = motion.legs.at(times)
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
        # What of a cable is taut; a range of tensions is only stated where all is.
        ranged = motion.phases[0].tension is not None
        self.taut = np.minimum(self.T / self.team.tension, 1.0) if not ranged else self.T**0
        self.half = 0.5 * G * self.team.cable_density * self.taut

    def pulls(self) -> tuple[Array, Array]:
        """Return tensions of taut cables to drones (times, 2n, 3) [N]: at clasps, at drones."""
        other = np.stack([self.last, self.first], axis=1).ravel()
        span = self.x - self.p[:, np.where(self.legged, self.own, other)]
        start, end, _ = catenary(span, self.P, np.repeat(self.half, 2, axis=1))
        return start, end

    def forces(self) -> Array:
        """Return the forces of taut and hanging cables on drones (times, 2n, 3) [N]."""
        _, pull = self.pulls()
        result = -pull
        if self.team.cable_density:
            q, r = self.x[:, 0::2], self.x[:, 1::2]
            hanging = Catenary.between(q, r, self.team.cable_length).pull(q, r)
            rest = G * self.team.cable_density * (1.0 - self.taut)
            result += (rest[..., None, None] * hanging).reshape(result.shape)
        return result


def thrusts(motion: Motion, times: Array) -> Array:
    """Return thrusts (times, drones, 3) [N]."""
    own: Array = motion.team.mass[:, None] * (motion.drones.at(times, 2) + [0.0, 0.0, G])
    return own - Samples(motion, times).forces() if motion.team.has_cables else own


def sampled(motion: Motion, times: Array, only: Set[str] = frozenset()) -> dict[str, float]:
    """Return the worst value of every quantity over ``times``; thrust as a share of the largest.

    If some are named, those that take long are omitted where they are not.
    """

    def named(*names: str) -> bool:
        return not only or not only.isdisjoint(names)

    x, spec = motion.drones.at(times), motion.requirements
    result = dict[str, float]()
    if x.shape[1] > 1 and named("separation"):
        result["separation"] = float(np.min(ratios(x, spec.separation)))
    for order, name in enumerate(("speed", "acceleration", "jerk"), start=1):
        result[name] = float(np.max(np.linalg.norm(motion.drones.at(times, order), axis=-1)))
    if named("arena", "floor"):
        tied = motion.team.has_cables and bool(motion.formed.all())
        there = np.concatenate([x, sagging(Samples(motion, times))], axis=1) if tied else x
        if spec.limits.floor is not None:
            result["floor"] = float(np.min(there[..., 2]))
        if spec.arena is not None:
            inside = np.minimum(there - spec.arena.lower, spec.arena.upper - there)
            result["arena"] = float(np.min(inside))
    if spec.keep_out:
        result["keep_out"] = min(float(np.min(off_prism(x, prism))) for prism in spec.keep_out)
    if named("thrust", "tilt"):
        f = thrusts(motion, times)
        result["thrust"] = float(np.max(np.linalg.norm(f, axis=-1) / motion.team.max_thrust))
        result["tilt"] = float(np.max(np.degrees(np.arctan2(_level(f), f[..., 2]))))
    if spec.limits.body_rate is not None and named("body_rate"):
        h = 1e-5  # [s] between samples and those that thrusts are differentiated by
        apart = np.min(np.abs(times[:, None] - motion.drones.breaks), axis=1)
        before, after = (thrusts(motion, times[apart > 2.0 * h] + step) for step in (-h, h))
        f, rate = 0.5 * (before + after), (after - before) / (2.0 * h)
        turning = np.linalg.norm(np.cross(f, rate), axis=-1) / np.sum(f**2, axis=-1)
        result["body_rate"] = math.degrees(float(np.max(turning)))
    if not motion.team.has_cables:
        return result
    s = Samples(motion, times)
    if motion.formed.all():
        speeds = np.linalg.norm(motion.vertices.at(times, 1), axis=-1)
        result["vertex_speed"] = float(np.max(speeds))
        with np.errstate(invalid="ignore"):  # at the very end of a ramp nothing pulls
            distances = _taut_distances(s) if named("cable_clearance", "crossing") else {}
            return result | distances | _shape(s) | {"equilibrium": _unbalanced(s)}
    return result | _free_distances(s, motion.phases[0].state)


def ratios(x: Array, separation: Separation) -> Array:
    """Return separations (times, pairs) of drones (times, N, 3), ordered as ``triu_indices``."""
    i, j = np.triu_indices(x.shape[-2], 1)
    gap, r, h = x[:, i] - x[:, j], separation.radius, separation.height
    result: Array = np.hypot(_level(gap) / (2.0 * r), gap[..., 2] / (2.0 * h))
    return result


def _taut_distances(s: Samples) -> dict[str, float]:
    parts: list[tuple[int, int, set[int], Array, Array]] = []  # first an own end: -1 of edges
    for k, (a, b) in enumerate(zip(s.first.tolist(), s.last.tolist(), strict=True)):
        both = {a, b} & set(s.clasps.tolist())
        parts.append((-1, k, both, s.p[:, a], s.p[:, b]))
        for drone, at in ((2 * k, a), (2 * k + 1, b)):
            parts += [(drone, k, {at}, s.p[:, at], s.x[:, drone])] * bool(s.legged[drone])
    begin = np.stack([part[3] for part in parts], axis=1)
    end = np.stack([part[4] for part in parts], axis=1)
    d, m = np.array(
        [
            (drone, m)
            for drone in range(2 * s.n)
            for m, (leg_of, k, *_) in enumerate(parts)
            if drone // 2 != k or (leg_of != drone and (leg_of >= 0 or s.legged[drone]))
        ]
    ).T
    clear = point_to_segment(s.x[:, d], begin[:, m], end[:, m])
    apart = [(a, b) for a in range(len(parts)) for b in range(a) if not parts[a][2] & parts[b][2]]
    i, j = np.array(apart, dtype=np.intp).reshape(-1, 2).T
    between = segment_to_segment(begin[:, i], end[:, i], begin[:, j], end[:, j])
    least = float(np.min(between, initial=math.inf))
    return {"cable_clearance": float(np.min(clear)), "crossing": least}


def sagging(s: Samples, count: int = 33) -> Array:
    """Return points (times, 3 n count, 3) of legs and edges, below their chords."""
    k, share = np.arange(s.n), np.linspace(0.0, 1.0, count)[:, None]
    parts = [(s.p[:, s.first], s.p[:, s.last], s.T)]
    for end, own in enumerate((s.first, s.last)):
        parts.append((s.p[:, own], s.x[:, 2 * k + end], s.P[:, 2 * k + end]))
    result = []
    for a, b, pull in parts:
        with np.errstate(invalid="ignore"):  # at the very end of a ramp nothing pulls
            ratio = np.nan_to_num(s.half / pull)
        points = a[:, :, None] + share * (b - a)[:, :, None]
        _, _, size = catenary(b - a, pull, s.half)
        hanging = Catenary.between(a, b, np.maximum(size, 1e-9))  # a chain's ends have no legs
        stacked = Catenary(*(np.asarray(x)[..., None] for x in vars(hanging).values()))
        points[..., 2] -= np.where(ratio > 0.0, 1.0, 0.0)[..., None] * stacked.depth(
            2.0 * share[:, 0] - 1.0
        )
        result.append(points.reshape(len(points), -1, 3))
    return np.concatenate(result, axis=1)


def _free_distances(s: Samples, state: CableState) -> dict[str, float]:
    """Return distances of chords from above; clasped neighbours may cross."""
    few = s.x[:: max(1, len(s.x) // 500)]
    spans = np.linalg.norm(s.x[:, 1::2] - s.x[:, 0::2], axis=-1) / s.team.cable_length
    flat = s.x * [1.0, 1.0, 0.0]
    q, r = flat[:, 0::2], flat[:, 1::2]
    if state.on_ground:
        apart, lowest = point_to_segment(flat[:, :, None], q[:, None], r[:, None]), math.inf
    else:
        points = cable_points(s.team.cable_length, few)
        apart = np.min(np.linalg.norm(few[:, :, None, None] - points[:, None], axis=-1), axis=-1)
        spec = s.motion.requirements
        faces = [each.lower[2] for each in (spec.arena,) if each is not None]
        faces += [each for each in (spec.limits.floor,) if each is not None]
        lowest = float(np.min(points[..., 2])) - max(faces, default=-math.inf)
    each = np.arange(s.team.drones)
    apart[:, each, each // 2] = math.inf
    if not state.on_ground:
        lowest = min(lowest, own_cable_distance(s.motion, few))
    i, j = np.triu_indices(s.n, 1)
    if state.clasping or state.tightening:
        held = (j - i == 1) | ((i == 0) & (j == s.n - 1) & (len(s.clasps) == s.n))
        i, j = i[~held], j[~held]
    crossing = segment_to_segment(q[:, i], r[:, i], q[:, j], r[:, j])
    if state.clasping or state.tightening:
        outlines = clasped_outlines(s, state)
        crossing = hull_gaps(outlines[:, i], outlines[:, j])
        top = np.max(outlines[..., 2], axis=2)
        bottom = 0.5 * (s.x[:, 0::2, 2] + s.x[:, 1::2, 2] - s.team.cable_length)
        level = hull_gaps(s.x[:, :, None, None], outlines[:, None])
        up = np.maximum(s.x[:, :, None, 2] - top[:, None], bottom[:, None] - s.x[:, :, None, 2])
        beside = np.maximum(level, up)
        beside[:, each, each // 2] = math.inf
        for k in s.clasps.tolist() if state.clasping else ():
            m = k - 1 if k else s.n - 1  # drones that turn about the clasp
            beside[:, 2 * k, m] = beside[:, 2 * m + 1, k] = math.inf
        lowest = min(lowest, float(np.min(beside)))
    return {
        "cable_clearance": min(float(np.min(apart)), lowest),
        "crossing": float(np.min(crossing, initial=math.inf)),
        "span": float(np.max(spans)),
    }


def own_cable_distance(motion: Motion, drones: Array, count: int = 401) -> float:
    """Return the minimum distance of drones (times, 2n, 3) from their own hanging cables.

    These count where they rise again, from twice the distance of cables on.
    """
    spec, length = motion.requirements, motion.team.cable_length
    start = 2.0 * spec.separation.cable + 4.0 * spec.limits.tube.level
    points = cable_points(length, drones, count)
    smallest = math.inf
    for end, ordered in enumerate((points, points[:, :, ::-1])):
        own = drones[:, end::2]
        gaps = np.linalg.norm(ordered - own[:, :, None], axis=-1)
        along = np.linspace(0.0, 1.0, count) * length[:, None]
        rising = np.diff(ordered[..., 2], axis=-1) > 0.0
        counted = rising & (along[:, 1:] >= start)
        smallest = min(smallest, float(np.min(np.where(counted, gaps[..., 1:], math.inf))))
    return smallest


def clasped_outlines(s: Samples, state: CableState) -> Array:
    """Return drones and clasps (times, n, 4, 3) of cables that are clasped or tightened."""
    clasps = s.p.copy()
    if state.clasping:
        clasps[:, s.own[~s.legged]] = s.x[:, ~s.legged]
        for k in s.clasps.tolist():
            clasps[:, k] = 0.5 * (s.x[:, 2 * k] + s.x[:, (2 * k - 1) % (2 * s.n)])
    ends = s.x[:, 0::2], clasps[:, s.first], clasps[:, s.last], s.x[:, 1::2]
    return np.stack(ends, axis=2)


def hull_gaps(a: Array, b: Array) -> Array:
    """Return horizontal distances (…) of hulls of corners (…, k, 3); zero where they overlap."""
    flat = [each * [1.0, 1.0, 0.0] for each in (a, b)]
    sides = []
    for each in flat:
        i, j = np.triu_indices(each.shape[-2], 0)  # corners too
        sides.append((each[..., i, :] + 1e-13, each[..., j, :]))
    (p, q), (u, v) = ((x[..., :, None, :], y[..., :, None, :]) for x, y in sides)
    u, v = (np.swapaxes(x, -2, -3) for x in (u, v))
    gaps: Array = np.min(segment_to_segment(p, q, u, v), axis=(-1, -2))
    for one, other in (flat, flat[::-1]):
        point = other[..., :1, :]  # a hull may be inside the other one
        for corner in combinations(range(one.shape[-2]), 3):
            x, y, z = (one[..., [k], :] for k in corner)
            turns = [np.cross(f - e, point - e)[..., 0, 2] for e, f in ((x, y), (y, z), (z, x))]
            inside = np.all(np.array(turns) > 0.0, axis=0) | np.all(np.array(turns) < 0.0, axis=0)
            gaps = np.where(inside, 0.0, gaps)
    return gaps


def cable_points(length: ArrayLike, drones: Array, count: int = 201) -> Array:
    """Return points (…, n, count, 3) of the hanging cables of drones (…, 2n, 3)."""
    q, r = drones[..., 0::2, :], drones[..., 1::2, :]
    cables = Catenary.between(q, r, np.broadcast_to(length, q.shape[:-1]))
    mu = np.moveaxis(
        np.array([cables.parameter(share) for share in np.linspace(0.0, 1.0, count)]), 0, -1
    )
    points = q[..., None, :] + (0.5 * (1.0 + mu))[..., None] * (r - q)[..., None, :]
    stacked = Catenary(*(x[..., None] for x in vars(cables).values()))
    points[..., 2] -= stacked.depth(mu)
    return points


def _unbalanced(s: Samples) -> float:
    """Return residuals of legs, edges and weights at clasps, and of pulls beyond friction."""
    pull, _ = s.pulls()
    onward, _, _ = catenary(s.edges, s.T, s.half)
    back, _, _ = catenary(-s.edges, s.T, s.half)
    balance = []
    for i, k in enumerate(s.clasps.tolist()):
        m = k - 1  # the cables ahead and behind
        force = pull[:, 2 * k] + onward[:, k] + pull[:, 2 * m + 1] + back[:, m]
        for cable in (k, m):
            force[:, 2] -= 0.5 * G * s.team.load[i] * s.taut[:, cable]
        least = np.minimum(s.T[:, k], s.T[:, m])
        balance.append(np.max(np.linalg.norm(force, axis=-1) / least))
    if s.motion.leg_tensions_differ:
        ratio, most = slides(s)
        balance.append(np.max(np.maximum(ratio - most, 1.0 / most - ratio)))
    return float(max(balance))


def catenary(chords: Array, T: Array, half: Array) -> tuple[Array, Array, Array]:
    """Return tensions (…, 3) at the start and the end of parts, toward the end, and lengths (…).

    Parameters
    ----------
    chords: (…, 3) [m].
    T, half: (…), tension at the start [N], half of the weight per length [N/m].
    """
    across, rise = _level(chords), chords[..., 2]
    target = T + half * rise  # mean of both ends' tensions, half L coth σ
    low, high = np.full(across.shape, 1e-9), np.full(across.shape, 1.0)  # σ

    def length(sigma: Array) -> Array:  # √(h² + (D sinh σ / σ)²)
        return np.asarray(np.hypot(rise, across * np.sinh(sigma) / sigma))

    for _ in range(60):  # in the logarithm: steepness is small where cables are light
        middle = np.sqrt(low * high)
        is_tighter = half * length(middle) / np.tanh(middle) > target
        low, high = np.where(is_tighter, middle, low), np.where(is_tighter, high, middle)
    size = length(high)
    straight = np.linalg.norm(chords, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        level = np.where(half > 0.0, half / high, np.where(straight > 0.0, T / straight, 0.0))
        upward = np.where(half > 0.0, half / np.tanh(high), level) * rise
    start = np.concatenate([level[..., None] * chords[..., :2], upward[..., None]], axis=-1)
    weight = (half * size)[..., None] * [0.0, 0.0, 1.0]
    return (
        start - weight,
        start + weight,
        np.where(half > 0.0, size, np.linalg.norm(chords, axis=-1)),
    )


def slides(s: Samples) -> tuple[Array, Array]:
    """(times, 2n) each: a leg's pull over its tension, and what friction makes of it at most.

    A cable that turns on its way from the drone along its edge twists half a turn of a helix there.
    """
    inward = np.stack([s.edges, -s.edges], axis=2).reshape(s.legs.shape)
    cosine = -np.sum(s.legs * inward, axis=-1)
    with np.errstate(invalid="ignore"):
        cosine /= np.linalg.norm(s.legs, axis=-1) * np.linalg.norm(inward, axis=-1)
    turn = np.where(s.legged, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0)
    return s.P / np.repeat(s.T, 2, axis=1), np.exp(s.team.friction * np.pi * np.sin(0.5 * turn))


def _level(spans: Array) -> Array:
    """Return the horizontal lengths of spans."""
    return np.hypot(spans[..., 0], spans[..., 1])


def _shape(s: Samples) -> dict[str, float]:
    legs = np.linalg.norm(s.legs, axis=-1)
    total = np.zeros(s.T.shape)
    for span in (s.edges, s.legs[:, 0::2], s.legs[:, 1::2]):
        total += catenary(span, s.T, s.half)[2]
    leg_errors = np.max(np.abs(s.stored - legs.reshape(s.stored.shape)), axis=-1)
    off = np.maximum(np.abs(total - s.team.cable_length), leg_errors) / s.team.cable_length
    heading = np.arctan2(s.edges[..., 1], s.edges[..., 0])
    exterior = heading[:, s.clasps - 1] - heading[:, s.clasps % s.n]
    exterior = (exterior + math.pi) % (2 * math.pi) - math.pi
    least = np.min(exterior)
    if len(s.clasps) < s.n:  # a chain must not go around more than once either
        least = min(least, np.min(2 * math.pi - np.sum(exterior, axis=1)))
    return {
        "legs": float(np.min(legs[:, s.legged])),
        "cable_length": float(np.max(off)),
        "convexity": math.degrees(least),
    }


def off_prism(x: Array, prism: Prism) -> Array:
    """Return distances of points from a prism, horizontal or vertical."""
    corners = np.append(
        np.asarray(prism.polygon.vertices), np.zeros((len(prism.polygon), 1)), axis=1
    )
    flat, ends = (x * [1.0, 1.0, 0.0])[..., None, :], np.roll(corners, -1, axis=0)
    aside = np.min(point_to_segment(flat, corners, ends), axis=-1)
    right = np.cross(ends - corners, flat - corners)[..., 2] <= 0.0
    beyond = np.maximum(np.maximum(prism.lower - x[..., 2], x[..., 2] - prism.upper), 0.0)
    return np.hypot(np.where(np.all(right, axis=-1), 0.0, aside), beyond)


def point_to_segment(x: Array, a: Array, b: Array) -> Array:
    """Return distances of points from segments."""
    along = b - a
    foot = np.clip(np.sum((x - a) * along, axis=-1) / np.sum(along**2, axis=-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(x - a - foot[..., None] * along, axis=-1))


def segment_to_segment(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return distances of segments, by ends and along the common normal."""
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


def tracking_radius(motion: Motion, times: Array) -> float:
    """Return the tracking radius at ``times``, with vertex errors up to drone errors."""
    result, spec = sampled(motion, times), motion.requirements
    separation = spec.separation
    limits = {"cable_clearance": separation.cable, "crossing": separation.crossing}
    limits |= {"legs": spec.limits.leg, "arena": 0.0, "keep_out": separation.radius}
    limits |= {"floor": spec.limits.floor} if spec.limits.floor is not None else {}
    terms = [touching(motion.drones.at(times), separation)]
    for name, limit in limits.items():
        bodies = 1.0 if name in {"arena", "floor", "keep_out"} else 2.0
        terms.append(max(result.get(name, math.inf) - limit, 0.0) / bodies)
    if "span" in result:
        x, length = motion.drones.at(times), motion.team.cable_length
        terms.append(np.min(length - np.linalg.norm(x[:, 1::2] - x[:, 0::2], axis=-1)) / 2.0)
    return float(min(terms))


def touching(x: Array, separation: Separation) -> float:
    """Return the smallest radius at which two drones (times, N, 3) may touch."""
    i, j = np.triu_indices(x.shape[1], 1)
    offset = (x[:, i] - x[:, j]).reshape(-1, 3)
    scale = 0.5 / np.array([separation.radius, separation.radius, separation.height])
    low, high = np.zeros(len(offset)), np.linalg.norm(offset, axis=-1)
    for _ in range(40):
        middle = 0.5 * (low + high)
        moved = offset
        for _ in range(30):  # against the gradient of the ratio at where that leads
            way = scale**2 * moved
            moved = offset - middle[:, None] * way / np.linalg.norm(way, axis=-1, keepdims=True)
        touching = np.linalg.norm(moved * scale, axis=-1) < 1.0
        low, high = np.where(touching, low, middle), np.where(touching, middle, high)
    inside = np.linalg.norm(offset * scale, axis=-1) <= 1.0
    return float(np.min(np.where(inside, 0.0, 0.5 * high), initial=math.inf))


def crossings(drones: PiecewisePolynomial, count: int = 20_001) -> dict[tuple[int, int], int]:
    """Return how often chords passed through each other, with signs, by the volume of their ends.

    At samples; where that changes its sign, the lines meet at shares of both chords.
    """
    t = np.linspace(drones.breaks[0], drones.breaks[-1], count)
    ends, result = drones.at(t).reshape(count, -1, 2, 3), {}
    for i in range(ends.shape[1]):
        for j in range(i + 1, ends.shape[1]):
            (q, r), (a, b) = np.moveaxis(ends[:, [i, j]], (1, 2), (0, 1))
            normal = np.cross(r - q, b - a)
            volume = np.sum((a - q) * normal, axis=1)
            m = np.flatnonzero(np.sign(volume[1:]) != np.sign(volume[:-1]))
            size = np.sum(normal[m] ** 2, axis=1)
            shares = [
                np.sum(np.cross((a - q)[m], along[m]) * normal[m], axis=1) / size
                for along in (b - a, r - q)
            ]
            inside = np.all([(share > 0.0) & (share < 1.0) for share in shares], axis=0)
            result[i, j] = int(np.sum(np.sign(volume[m + 1])[inside]))
    return result


def in_sheets(
    drones: PiecewisePolynomial, length: Array, count: int = 20_001
) -> set[tuple[int, int]]:
    """Return pairs of cables, a drone of one between chord and hanging cable of the other."""
    t = np.linspace(drones.breaks[0], drones.breaks[-1], count)
    x, result = drones.at(t), set()
    for k in range(len(length)):
        q, along = x[:, 2 * k], x[:, 2 * k + 1] - x[:, 2 * k]
        for d in range(x.shape[1]):
            to = x[:, d] - q
            side = np.sign(along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0])
            m = np.flatnonzero(side[1:] != side[:-1])
            share = np.sum((to * along)[m, :2], axis=1) / np.sum(along[m, :2] ** 2, axis=1)
            m, share = m[(share > 0.0) & (share < 1.0)], share[(share > 0.0) & (share < 1.0)]
            if d // 2 == k or not len(m):
                continue
            cable = Catenary.between(q[m], q[m] + along[m], np.full(len(m), length[k]))
            below = share * along[m, 2] - to[m, 2]
            if np.any((below > 0.0) & (below < cable.depth(2.0 * share - 1.0))):
                result.add((min(d // 2, k), max(d // 2, k)))
    return result
