"""How far a grip is from every limit: distances over their limits, tilt, thrust and legs."""

from __future__ import annotations

import math

import numpy as np

from hitchopt.errors import Violation
from hitchopt.geometry.segments import differences, shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.holding.grip_statics import Grip
from hitchopt.requirements import Requirements
from hitchopt.values import Array, Indices

LEAST_GAP = 0.02
"""[m] Least distance of a clasp to the section: two ropes bend around each other there."""

DECIMALS = 9
"""Decimals that are told of a value."""

NO_GRIP = "use cables of another length, or a larger section, or rest it on a rim"
"""What to do where no grip was found."""


def grip_margins(grip: Grip, requirements: Requirements, kind: Quadrotor) -> dict[str, Array]:
    """Return by how much (…, items) a grip keeps each limit: ratio minus 1, not negative if kept.

    Keys are names of the certificate's checks, and ``gap``, the distance of clasps to the section.
    """
    separation, limits = requirements.separation, requirements.limits
    shape = grip.vertices.shape[:-2]
    n = grip.vertices.shape[-2]
    drones = grip.drones.reshape(*shape, 2 * n, 3)
    thrusts = grip.thrusts(kind.mass, GRAVITY).reshape(*shape, 2 * n, 3)
    tilt = np.arctan2(length(thrusts[..., :2]), thrusts[..., 2])
    parts, clasp, cable = _straight_parts(grip)
    one, two = np.triu_indices(2 * n, 1)
    apart = length((drones[..., one, :] - drones[..., two, :]) * separation.scale)
    # Own tangents count, as the own edge of any hitch does; own legs do not.
    robot, leg = np.arange(2 * n) // 2, np.arange(4 * n) % 4 % 3 == 0
    near = np.argwhere((robot[:, None] != cable) | ~leg)
    gaps = _distances(drones[..., near[:, :1], :], parts[..., near[:, 1], :, :])
    i, j = np.triu_indices(4 * n, 1)
    free = (
        (clasp[i] == clasp[j]) | ~(leg[i] | leg[j]) | ((cable[i] == cable[j]) & ~(leg[i] & leg[j]))
    )
    i, j = i[~free], j[~free]
    crossing = _distances(parts[..., i, :, :], parts[..., j, :, :])
    section = grip.section
    found = {
        "separation": apart,
        "cable_clearance": gaps / separation.cable if separation.cable else gaps + 1.0,
        "crossing": crossing / separation.crossing if separation.crossing else crossing + 1.0,
        "keep_out": section.clearance(drones[..., :2])[0] / separation.radius,
        "legs": grip.legs.reshape(*shape, 2 * n) / limits.leg,
        "gap": section.clearance(grip.vertices[..., :2])[0] / LEAST_GAP,
        "tilt": 2.0 - tilt / limits.tilt,
        "thrust": 2.0 - length(thrusts) / kind.max_thrust,
    }
    return {name: ratio - 1.0 for name, ratio in found.items()}


def broken_limit_of(
    name: str, margin: float, requirements: Requirements, kind: Quadrotor
) -> Violation:
    """Return the violation of a limit by a margin of ``grip_margins``, its value as it is."""
    separation, limits = requirements.separation, requirements.limits
    least = {
        "separation": (1.0, "ratio"),
        "cable_clearance": (separation.cable, "m"),
        "crossing": (separation.crossing, "m"),
        "keep_out": (separation.radius, "m"),
        "legs": (limits.leg, "m"),
        "gap": (LEAST_GAP, "m"),
    }
    if name in least:
        limit, unit = least[name]
        value = round(limit * (1.0 + margin), DECIMALS)
        return Violation(name, value, limit, "min", unit, (), "", NO_GRIP)
    limit, unit = {
        "tilt": (math.degrees(limits.tilt), "deg"),
        "thrust": (kind.max_thrust, "N"),
    }[name]
    value = round(limit * (1.0 - margin), DECIMALS)
    return Violation(name, value, limit, "max", unit, (), "", NO_GRIP)


def _straight_parts(grip: Grip) -> tuple[Array, Indices, Indices]:
    """Return ends (…, 4 n, 2, 3) [m] of q-legs, tangents and r-legs, their clasps and cables."""
    wraps, vertices, drones = grip.wraps, grip.vertices, grip.drones
    n = vertices.shape[-2]
    contacts = np.concatenate([wraps.contacts, np.zeros((*wraps.contacts.shape[:-1], 1))], axis=-1)
    onward = np.roll(vertices, -1, axis=-2)
    ends = [
        (vertices, drones[..., 0, :]),
        (vertices, contacts[..., 0, :]),
        (contacts[..., 1, :], onward),
        (onward, drones[..., 1, :]),
    ]
    parts = np.stack([np.stack(pair, axis=-2) for pair in ends], axis=-3)
    k = np.arange(n)[:, None]
    clasps = ((k + [0, 0, 1, 1]) % n).ravel()
    return parts.reshape(*parts.shape[:-4], 4 * n, 2, 3), clasps, np.repeat(np.arange(n), 4)


def _distances(first: Array, second: Array) -> Array:
    """Return distances (…) [m] of points or segments (…, 1 or 2, 3) to segments (…, 2, 3)."""
    return length(shortest_offset(differences(first, second)))


def largest_tension(requirements: Requirements, kind: Quadrotor) -> tuple[float, str]:
    """Return the largest level pull [N] that a drone can hold at rest, and the limit that binds."""
    weight = GRAVITY * kind.mass
    by_tilt = weight * math.tan(requirements.limits.tilt)
    by_thrust = math.sqrt(max(kind.max_thrust**2 - weight**2, 0.0))
    return (by_tilt, "tilt") if by_tilt <= by_thrust else (by_thrust, "thrust")
