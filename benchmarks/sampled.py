"""A motion checked by samples alone, by formulas of its own: what certificates are held against.

Nothing here is shared with the certificate. Hitches are level, as in all benchmarks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.near import Near, between, cable_parts, length, near_pairs, to_segment
from benchmarks.samples import Sampler, Samples, slowed
from benchmarks.tasks import Task

Array = NDArray[np.float64]

COARSE = 0.05
"""[s] Between the times at which bodies that can come near are looked for."""

FLAT = 1e-6
"""Sine of the smallest exterior angle: convex, and told from rounding."""

MISSED = 1e-4
"""[m] By which a drone may miss its place at either end."""

BLOCK = 400_000
"""Samples times drones that are held in memory at once."""

FORCES = ("thrust", "tilt")
ORDERS = {
    "speed": 1,
    "vertex_speed": 1,
    "acceleration": 2,
    "jerk": 3,
    "thrust": 2,
    "tilt": 2,
}
"""Limits of motion: what falls with which power of the time, that of the forces about."""

LET_OFF = ("cable_clearance", "crossing")
"""What rivals need not keep."""

HALVINGS = 12


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
    near = near_pairs(n, coarse)
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
        missed = float(np.max(length(drones - hitch.drones)))
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
        yield name, float(np.max(length(values)))
    edges = np.roll(s.vertices, -1, axis=1) - s.vertices
    lengths = length(edges)
    q = s.positions[:, 0::2] - s.vertices
    r = s.positions[:, 1::2] - np.roll(s.vertices, -1, axis=1)
    q_legs, r_legs = length(q), length(r)
    error = np.abs(q_legs + lengths + r_legs - team.cable_length) / team.cable_length
    yield "cable_length", float(np.max(error))
    u, q_hat, r_hat = edges / lengths[..., None], q / q_legs[..., None], r / r_legs[..., None]
    tension = team.tension[:, None]
    ahead, behind = tension * (q_hat + u), tension * (r_hat - u)
    residual = ahead + np.roll(behind, 1, axis=1)
    yield "equilibrium", float(np.max(length(residual) / team.tension))
    upward = np.array([0.0, 0.0, 9.81])
    outward = np.stack([tension * q_hat, tension * r_hat], axis=2).reshape(s.positions.shape)
    thrust = team.mass[:, None] * (s.accelerations + upward) + outward
    yield "thrust", float(np.max(length(thrust)))
    tilt = np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2])
    yield "tilt", float(np.max(tilt))


def _distances(task: Task, s: Samples, near: Near) -> Iterator[tuple[str, float]]:
    """Yield the smallest value of everything that is not to fall below its limit."""
    q = length(s.positions[:, 0::2] - s.vertices)
    r = length(s.positions[:, 1::2] - np.roll(s.vertices, -1, axis=1))
    yield "legs", float(min(np.min(q), np.min(r)))
    edges = np.roll(s.vertices, -1, axis=1) - s.vertices
    back = np.roll(edges, 1, axis=1)
    clockwise = back[..., 1] * edges[..., 0] - back[..., 0] * edges[..., 1]
    lengths = length(edges)
    yield "convexity", float(np.min(clockwise / (lengths * np.roll(lengths, 1, axis=1))))
    apart = s.positions[:, near.drones[:, 0]] - s.positions[:, near.drones[:, 1]]
    scale = 0.5 / np.array([task.separation.radius] * 2 + [task.separation.height])
    if apart.size:
        yield "separation", float(np.min(length(apart * scale)))
    first, last = cable_parts(s)
    if near.cables.size:
        point = s.positions[:, near.cables[:, 0], :2]
        part = near.cables[:, 1]
        yield "cable_clearance", float(np.min(to_segment(point, first[:, part], last[:, part])))
    if near.parts.size:
        i, j = near.parts.T
        gap = between(first[:, i], last[:, i], first[:, j], last[:, j])
        yield "crossing", float(np.min(gap))


def kept_duration(
    task: Task, duration: float, sample: Sampler, rate: float, findings: Sequence[Finding]
) -> float | None:
    """Return what a motion would last if it were slowed until samples keep all limits of motion.

    None where it breaks one that going slower does not mend: a distance, a leg, an end. Distances
    that rivals are let off do not count.

    Parameters
    ----------
    task, duration, sample, rate: as of check_samples.
    findings: what that has found.
    """
    excess = {finding.name: finding.excess for finding in findings}
    if any(excess[name] > 0.0 for name in excess if name not in {*ORDERS, *LET_OFF}):
        return None
    direct = [(1.0 + excess[name]) ** (1.0 / k) for name, k in ORDERS.items() if name not in FORCES]
    factor = float(max(1.0, *direct))
    times = np.append(np.arange(int(duration * rate) + 1) / rate, duration)

    def forces_kept(factor: float) -> bool:
        kept = _limits(task)
        found = dict(_motion(task, slowed(sample, factor)(factor * times)))
        return all(found[name] <= kept[name] for name in FORCES)

    if all(excess[name] <= 0.0 for name in FORCES) or forces_kept(factor):
        return factor * duration
    lower, upper = factor, 2.0 * factor
    if not forces_kept(upper):
        return None
    for _ in range(HALVINGS):
        middle = 0.5 * (lower + upper)
        lower, upper = (lower, middle) if forces_kept(middle) else (middle, upper)
    return upper * duration
