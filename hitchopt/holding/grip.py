"""A hitch that grips a section: edges wrapped around it, clasps in balance, legs and drones.

Clasps are outside of the section. At clasp k the edges' unit vectors ``b_{k-1}``, arriving, and
``a_k``, leaving, pull with ``V_k = λ T (b_{k-1} - a_k)``, λ the tension of edges over that of legs.
Both legs close a triangle with it: ``T q̂_k = V/2 + h m`` and ``T r̂_{k-1} = V/2 - h m``, ``h² = T² -
|V|²/4``, m along ``b_{k-1} + a_k``. So ``cos(β_legs/2) = λ cos(β_edges/2)``, and for λ = 1 legs
lie along the neighbours' tangents. A weight tilts edges and legs alike: clasps rise by ``z_k``
above the plane of contact, so that they carry its force and moments together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchopt.errors import InfeasibleError, OneLine, Violation
from hitchopt.geometry.segments import differences, shortest_offset
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.holding.wraps import Wraps, wraps_around
from hitchopt.objects import Section
from hitchopt.values import Array, Indices

PASSES = 4
"""Times that the clasps' heights are computed: the last one moves them by less than 1e-6 m."""


@dataclass(frozen=True, eq=False)
class Grip(OneLine):
    """Hitches that grip one section with one tension, with any leading axes.

    Attributes
    ----------
    section: about its own origin.
    tension: of every leg at its clasp [N].
    clasp_friction: coefficient of cables on each other.
    weight: what is lifted [N]; 0 before it leaves its support.
    ratio: λ, tension of edges over that of legs.
    wraps: the edges, seen from above.
    vertices: (…, n, 3) [m], clasps above the plane of contact.
    legs: (…, n, 2) [m], ``d_k`` and ``e_k``; negative where the cable is too short.
    leg_directions: (…, n, 2, 3), unit vectors from ``p_k`` to ``q_k`` and from ``p_{k+1}`` to
        ``r_k``.
    """

    section: Section
    tension: float
    clasp_friction: float
    weight: float
    ratio: float
    wraps: Wraps
    vertices: Array
    legs: Array
    leg_directions: Array

    @classmethod
    def of(
        cls,
        section: Section,
        vertices: Array,
        cable_length: float,
        tension: float,
        *,
        clasp_friction: float = 0.0,
        weight: float = 0.0,
        ratio: float = 1.0,
    ) -> Grip:
        """Return the grip with vertices (…, n, 2) [m] and what is left of cables in equal legs.

        Raises
        ------
        InfeasibleError: edges too acute or pulling too hard for any direction of the legs.
        """
        wraps = wraps_around(section, vertices)
        z = _heights(section, vertices, wraps, ratio * tension, weight)
        arriving, leaving, rises = _tilted(wraps, z)
        pull = ratio * (arriving - leaving)  # of edges on the clasp, over the legs' tension
        squared = 1.0 - 0.25 * dot(pull, pull)
        if not np.all(squared > 0.0):
            raise _too_acute(wraps, ratio, tension)
        across = unit(arriving + leaving)
        across -= unit(pull) * dot(across, unit(pull))[..., None]
        aside = np.sqrt(squared)[..., None] * unit(across)
        q, r = 0.5 * pull + aside, np.roll(0.5 * pull - aside, -1, axis=-2)
        edges = wraps.arcs + rises[..., 0] + np.roll(rises[..., 1], -1, axis=-1)
        legs = np.repeat(0.5 * (cable_length - edges)[..., None], 2, axis=-1)
        return cls(
            section, tension, clasp_friction, weight, ratio, wraps,
            np.concatenate([vertices, z[..., None]], axis=-1),
            legs, np.stack([q, r], axis=-2),
        )  # fmt: skip

    @property
    def drones(self) -> Array:
        """(…, n, 2, 3) [m]: ``q_k`` and ``r_k``, above the plane of contact."""
        ends = np.stack([self.vertices, np.roll(self.vertices, -1, axis=-2)], axis=-2)
        drones: Array = ends + self.legs[..., None] * self.leg_directions
        return drones

    @property
    def clasp_wraps(self) -> Array:
        """(…, n) [rad]: angles by which cables bend at every clasp, means of edges' and legs'."""
        q, r = self.leg_directions[..., 0, :], np.roll(self.leg_directions[..., 1, :], 1, axis=-2)
        legs = np.arccos(np.clip(dot(q, r), -1.0, 1.0))
        return 0.5 * (legs + self.wraps.clasp_angles)

    @property
    def slip_factors(self) -> Array:
        """(…, n) [N]: ``Σ T_k θ_k`` by cables, friction at both clasps taking the most off edges.

        The object slips under ``μ`` times their sum.
        """
        worst = np.maximum(self.clasp_wraps, np.roll(self.clasp_wraps, -1, axis=-1))
        least = self.tension * np.exp(-self.clasp_friction * worst)
        factors: Array = least * self.wraps.angles
        return factors

    def slip_load(self, friction: float) -> Array:
        """Return the weight (…) [N] at which an object with that friction slips, without factor."""
        load: Array = friction * np.sum(self.slip_factors, axis=-1)
        return load

    @property
    def pulls(self) -> Array:
        """(…, n, 3) [N]: forces ``V_k`` of the clasps on object and cables, outward."""
        q, r = self.leg_directions[..., 0, :], np.roll(self.leg_directions[..., 1, :], 1, axis=-2)
        pulls: Array = self.tension * (q + r)
        return pulls

    @property
    def level_imbalance(self) -> Array:
        """(…, 3): level force [N] and upright moment [N m] that clasps put on the section."""
        arms = self.vertices[..., :2] - self.section.centroid
        force = self.pulls[..., :2]
        moment = arms[..., 0] * force[..., 1] - arms[..., 1] * force[..., 0]
        both = np.concatenate([force, moment[..., None]], axis=-1)
        return np.asarray(np.sum(both, axis=-2))

    def thrusts(self, mass: float, gravity: float) -> Array:
        """Return the thrust (…, n, 2, 3) [N] of drones of a mass [kg] at rest."""
        thrusts: Array = self.tension * self.leg_directions + mass * gravity * np.array([0, 0, 1.0])
        return thrusts


def _tilted(wraps: Wraps, z: Array) -> tuple[Array, Array, Array]:
    """Return the edges at clasps of heights (…, n) [m] above the section's plane of contact.

    Returns
    -------
    arriving, leaving: (…, n, 3) unit vectors of edges k-1 and k at ``p_k``.
    lengths: (…, n, 2) [m], of tangents k and k-1 there.
    """
    behind, ahead = wraps.at_clasps
    level = np.roll(wraps.arriving, 1, axis=-2) * behind[..., None]
    arriving = np.concatenate([level, z[..., None]], axis=-1)
    leaving = np.concatenate([wraps.leaving * ahead[..., None], -z[..., None]], axis=-1)
    return unit(arriving), unit(leaving), np.stack([length(leaving), length(arriving)], axis=-1)


def _heights(
    section: Section, vertices: Array, wraps: Wraps, tension: float, weight: float
) -> Array:
    """Return the heights (…, n) [m] at which clasps carry a weight, as evenly as moments allow.

    Clasp k carries ``f_k = T z_k (1/t + 1/t')``, t and t' its tangents; its level pull at ``z_k``
    turns the object as well. Of all ``f`` with that sum and no moment about level axes the nearest
    to equal ones is taken.
    """
    z = np.zeros(vertices.shape[:-1])
    if weight == 0.0:
        return z
    arms = vertices - section.centroid
    equal = np.full_like(z, weight / vertices.shape[-2])
    wanted = np.array([weight, 0.0, 0.0])
    for _ in range(PASSES):
        arriving, leaving, tangents = _tilted(wraps, z)
        rate = tension * np.sum(1.0 / tangents, axis=-1)
        level = tension * (arriving - leaving)[..., :2]
        turning = arms - level / rate[..., None]
        rows = np.stack([np.ones(z.shape), turning[..., 0], turning[..., 1]], axis=-2)
        short = wanted - np.einsum("...ij,...j->...i", rows, equal)
        forces = equal + np.einsum("...ij,...j->...i", np.linalg.pinv(rows), short)
        z = forces / rate
    return z


def _too_acute(wraps: Wraps, ratio: float, tension: float) -> InfeasibleError:
    """Return the refusal of clasps whose edges pull with more than their legs can."""
    pulls = 2.0 * ratio * np.cos(0.5 * wraps.clasp_angles).reshape(-1, wraps.angles.shape[-1])
    worst = int(np.argmax(np.max(pulls, axis=0)))
    remedy = "move clasps nearer to the section, raise the tension, or lower weight or friction"
    most, place = tension * float(np.max(pulls)), (f"p{worst}",)
    broken = Violation("equilibrium", most, 2.0 * tension, "max", "N", place, "", remedy)
    return InfeasibleError([broken])


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
