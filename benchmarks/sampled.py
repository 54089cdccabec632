"""A motion checked by samples alone, by formulas of its own: what certificates are held against.

Nothing here is shared with the certificate: polynomials are evaluated by scipy, distances of
segments come from their ends and an orientation test. Hitches are level, as in all benchmarks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from scipy.spatial import KDTree

import hitchopt as ho
from benchmarks.tasks import Task

Array = NDArray[np.float64]
Index = NDArray[np.intp]

COARSE = 0.05
"""[s] Between the times at which bodies that can come near are looked for."""

REACH = 0.4
"""[m] Bodies farther apart than this at all of those times keep every limit: they would have to
near each other at 5 m/s."""

FLAT = 1e-6
"""Sine of the smallest exterior angle: convex, and told from rounding."""

MISSED = 1e-4
"""[m] By which a drone may miss its place at either end."""

BLOCK = 400_000
"""Samples times drones that are held in memory at once."""


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion at some times.

    Attributes
    ----------
    positions, velocities, accelerations, jerks: of the drones q0, r0, … (J, 2n, 3), SI.
    vertices, vertex_velocities: (J, n, 3) [m], [m/s].
    """

    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    vertices: Array
    vertex_velocities: Array


Sampler = Callable[[Array], Samples]
"""Gives the motion at times (J,) [s], ascending."""


@dataclass(frozen=True)
class Finding:
    """The worst sample of one quantity.

    Attributes
    ----------
    name: of the limit.
    worst, limit: in its unit.
    excess: by how much of the limit it is broken; negative where it is kept.
    """

    name: str
    worst: float
    limit: float
    excess: float


def of_motion(motion: ho.Motion) -> Sampler:
    """Return the sampler of a plan's polynomials."""

    def poly(part: ho.PiecewisePolynomial) -> BPoly:
        return BPoly(np.moveaxis(part.coefficients, -1, 0), part.breaks)

    drones, vertices = poly(motion.drones), poly(motion.vertices)
    velocities, accelerations, jerks = (drones.derivative(order) for order in (1, 2, 3))
    speeds = vertices.derivative()

    def sample(t: Array) -> Samples:
        return Samples(drones(t), velocities(t), accelerations(t), jerks(t), vertices(t), speeds(t))

    return sample


def check_samples(task: Task, duration: float, sample: Sampler, rate: float) -> list[Finding]:
    """Return the worst sample of every limit, the most broken one first.

    Parameters
    ----------
    task: whose limits are looked at.
    duration: of the motion [s].
    sample: the motion.
    rate: [Hz]
    """
    n = task.robots
    coarse = sample(np.linspace(0.0, duration, 2 + int(duration / COARSE)))
    near = _near(n, coarse)
    times = np.append(np.arange(int(duration * rate) + 1) / rate, duration)
    largest: dict[str, float] = {}
    smallest: dict[str, float] = {}
    step = max(2, BLOCK // (2 * n))
    for first in range(0, len(times), step):
        block = sample(times[first : first + step])
        for name, value in _motion(task, block):
            largest[name] = max(largest.get(name, -np.inf), value)
        for name, value in _distances(task, block, near):
            smallest[name] = min(smallest.get(name, np.inf), value)
    kept = _limits(task)
    findings = [Finding(k, v, kept[k], v / kept[k] - 1.0) for k, v in largest.items()]
    findings += [Finding(k, v, kept[k], 1.0 - v / kept[k]) for k, v in smallest.items()]
    for name, drones, hitch in (
        ("start", coarse.positions[0], task.start),
        ("end", coarse.positions[-1], task.end),
    ):
        missed = float(np.max(np.linalg.norm(drones - hitch.drones, axis=-1)))
        findings.append(Finding(name, missed, MISSED, missed / MISSED - 1.0))
    return sorted(findings, key=lambda finding: -finding.excess)


def _limits(task: Task) -> dict[str, float]:
    limits, separation = task.limits, task.separation
    return {
        "speed": limits.speed,
        "acceleration": limits.acceleration,
        "jerk": limits.jerk,
        "vertex_speed": limits.vertex_speed,
        "thrust": float(task.start.team.max_thrust[0]),
        "tilt": limits.tilt,
        "cable_length": 1e-4,
        "equilibrium": 5e-3,
        "legs": limits.leg,
        "convexity": FLAT,
        "separation": 1.0,
        "cable_clearance": separation.cable,
        "crossing": separation.crossing,
    }


def _motion(task: Task, s: Samples) -> Iterator[tuple[str, float]]:
    """Yield the largest value of everything that is not to exceed its limit."""
    team = task.start.team
    for name, values in (
        ("speed", s.velocities),
        ("acceleration", s.accelerations),
        ("jerk", s.jerks),
        ("vertex_speed", s.vertex_velocities),
    ):
        yield name, float(np.max(np.linalg.norm(values, axis=-1)))
    edges = np.roll(s.vertices, -1, axis=1) - s.vertices
    lengths = np.linalg.norm(edges, axis=-1)
    q = s.positions[:, 0::2] - s.vertices
    r = s.positions[:, 1::2] - np.roll(s.vertices, -1, axis=1)
    q_legs, r_legs = np.linalg.norm(q, axis=-1), np.linalg.norm(r, axis=-1)
    error = np.abs(q_legs + lengths + r_legs - team.cable_length) / team.cable_length
    yield "cable_length", float(np.max(error))
    u, q_hat, r_hat = edges / lengths[..., None], q / q_legs[..., None], r / r_legs[..., None]
    tension = team.tension[:, None]
    ahead, behind = tension * (q_hat + u), tension * (r_hat - u)
    residual = ahead + np.roll(behind, 1, axis=1)
    yield "equilibrium", float(np.max(np.linalg.norm(residual, axis=-1) / team.tension))
    upward = np.array([0.0, 0.0, 9.81])
    outward = np.stack([tension * q_hat, tension * r_hat], axis=2).reshape(s.positions.shape)
    thrust = team.mass[:, None] * (s.accelerations + upward) + outward
    yield "thrust", float(np.max(np.linalg.norm(thrust, axis=-1)))
    tilt = np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2])
    yield "tilt", float(np.max(tilt))


def _distances(task: Task, s: Samples, near: Near) -> Iterator[tuple[str, float]]:
    """Yield the smallest value of everything that is not to fall below its limit."""
    q = np.linalg.norm(s.positions[:, 0::2] - s.vertices, axis=-1)
    r = np.linalg.norm(s.positions[:, 1::2] - np.roll(s.vertices, -1, axis=1), axis=-1)
    yield "legs", float(min(np.min(q), np.min(r)))
    edges = np.roll(s.vertices, -1, axis=1) - s.vertices
    back = np.roll(edges, 1, axis=1)
    clockwise = back[..., 1] * edges[..., 0] - back[..., 0] * edges[..., 1]
    lengths = np.linalg.norm(edges, axis=-1)
    yield "convexity", float(np.min(clockwise / (lengths * np.roll(lengths, 1, axis=1))))
    apart = s.positions[:, near.drones[:, 0]] - s.positions[:, near.drones[:, 1]]
    scale = 0.5 / np.array([task.separation.radius] * 2 + [task.separation.height])
    if apart.size:
        yield "separation", float(np.min(np.linalg.norm(apart * scale, axis=-1)))
    first, last = _parts(s)
    if near.cables.size:
        point = s.positions[:, near.cables[:, 0], :2]
        part = near.cables[:, 1]
        yield "cable_clearance", float(np.min(_to_segment(point, first[:, part], last[:, part])))
    if near.parts.size:
        i, j = near.parts.T
        gap = _between(first[:, i], last[:, i], first[:, j], last[:, j])
        yield "crossing", float(np.min(gap))


@dataclass(frozen=True, eq=False)
class Near:
    """Pairs (m, 2) that come near each other: drones, drone and part, parts."""

    drones: Index
    cables: Index
    parts: Index


def _parts(s: Samples) -> tuple[Array, Array]:
    """Return both ends (J, 3n, 2) [m] of q-leg, edge and r-leg of cable 0, of cable 1, …."""
    here, there = s.vertices, np.roll(s.vertices, -1, axis=1)
    q, r = s.positions[:, 0::2], s.positions[:, 1::2]
    count = len(here)
    first = np.stack([here, here, there], axis=2).reshape(count, -1, 3)
    last = np.stack([q, there, r], axis=2).reshape(count, -1, 3)
    return first[..., :2], last[..., :2]


def _near(n: int, coarse: Samples) -> Near:
    """Return the pairs that are not free to touch and come near at one of the coarse times."""
    first, last = _parts(coarse)
    middle, half = 0.5 * (first + last), 0.5 * float(np.max(np.linalg.norm(last - first, axis=-1)))
    drones, cables, parts = [], [], []
    for point, centre in zip(coarse.positions[..., :2], middle, strict=True):
        tree, part_tree = KDTree(point), KDTree(centre)
        drones.append(tree.query_pairs(REACH, output_type="ndarray"))
        found = tree.sparse_distance_matrix(part_tree, half + REACH, output_type="ndarray")
        cables.append(np.column_stack([found["i"], found["j"]]))
        parts.append(part_tree.query_pairs(2.0 * half + REACH, output_type="ndarray"))
    pairs = [np.unique(np.concatenate(kind), axis=0) for kind in (drones, cables, parts)]
    drone, part = pairs[1].T
    pairs[1] = pairs[1][(drone // 2 != part // 3) | (part % 3 == 1)]
    i, j = pairs[2].T
    clasps = [np.stack([k // 3 + (k % 3 == 2), k // 3 + (k % 3 > 0)]) % n for k in (i, j)]
    shared = np.any(clasps[0][:, None] == clasps[1][None, :], axis=(0, 1))
    pairs[2] = pairs[2][~shared]
    gaps = [
        _to_segment(coarse.positions[:, pairs[1][:, 0], :2], *_ends(first, last, pairs[1][:, 1])),
        _between(*_ends(first, last, pairs[2][:, 0]), *_ends(first, last, pairs[2][:, 1])),
    ]
    close = [pair[np.min(gap, axis=0) < REACH] for pair, gap in zip(pairs[1:], gaps, strict=True)]
    return Near(pairs[0], *close)


def _ends(first: Array, last: Array, part: Index) -> tuple[Array, Array]:
    return first[:, part], last[:, part]


def _to_segment(point: Array, first: Array, last: Array) -> Array:
    """Return the distances of points to segments, (…, 2) each [m]."""
    along = last - first
    share = np.sum((point - first) * along, axis=-1) / np.sum(along * along, axis=-1)
    foot = first + np.clip(share, 0.0, 1.0)[..., None] * along
    distance: Array = np.linalg.norm(point - foot, axis=-1)
    return distance


def _between(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distances of segments ab and cd in the plane, (…, 2) each [m]."""

    def side(p: Array, q: Array, x: Array) -> Array:
        u, v = q - p, x - p
        return np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    # Disjoint segments of one line, as legs along one edge are, seem to cross by their rounding.
    lower = np.maximum(np.minimum(a, b), np.minimum(c, d))
    upper = np.minimum(np.maximum(a, b), np.maximum(c, d))
    crosses = np.all(lower <= upper, axis=-1)
    crosses &= (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)
    ends = [
        _to_segment(a, c, d),
        _to_segment(b, c, d),
        _to_segment(c, a, b),
        _to_segment(d, a, b),
    ]
    return np.where(crosses, 0.0, np.min(ends, axis=0))
