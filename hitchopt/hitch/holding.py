"""The mathematics of a hold: taut edges around an object, grips, balance, friction, capacities.

A section is its core of clockwise corners with discs of one radius about them. Edges run clockwise
around it and keep it on their right: tangent, arc, tangent between two clasps outside of it. At
clasp k the edges' unit vectors ``b_{k-1}``, arriving, and ``a_k``, leaving, pull with ``V_k = T
(b_{k-1} - a_k)``; with one tension everywhere legs lie along the neighbours' edges, ``q̂_k =
b_{k-1}`` and ``r̂_{k-1} = -a_k``. Arrays carry any leading axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, OneLine
from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import dot, first_smallest, length, unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import (
    LIMIT_MARGIN,
    SPREAD_MARGIN,
    LegTask,
    reference_margin,
    split_slack,
)
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.objects import Section
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Bends:
    """The corners of a section's core about which edges bend.

    Attributes
    ----------
    touching: (…, n), whether they bend at all.
    corners: (…, n, 2), the first and the last corner; of a straight edge twice the nearest.
    """

    touching: NDArray[np.bool_]
    corners: Indices

    def differ(self, other: Bends) -> NDArray[np.bool_]:
        """Return (…) whether any edge bends about other corners."""
        moved = np.any(self.corners != other.corners, axis=-1) & self.touching
        return np.asarray(np.any(moved | (self.touching != other.touching), axis=-1))

    def __getitem__(self, item: Any) -> Bends:
        return Bends(self.touching[item], self.corners[item])


@dataclass(frozen=True, eq=False)
class Wraps:
    """Edges k from vertex k to vertex k+1, around a section where they touch it.

    Attributes
    ----------
    leaving, arriving: (…, n, 2) unit vectors ``a_k``, ``b_k`` of the edge at ``p_k`` and at
        ``p_{k+1}``; equal if the edge is straight.
    lengths: (…, n) [m], of cable between the clasps.
    arcs: (…, n) [m], lengths on the section.
    angles: (…, n) [rad], wraps ``θ_k``; 0 of a straight edge.
    contacts: (…, n, 2, 2) [m], where the arc begins and ends; of a straight edge its point nearest
        to touching the section.
    bends: the corners about which edges bend.
    """

    leaving: Array
    arriving: Array
    lengths: Array
    arcs: Array
    angles: Array
    contacts: Array
    bends: Bends

    @property
    def clasp_angles(self) -> Array:
        """(…, n) [rad]: angles ``β_k`` between the two edges at every clasp."""
        return math.pi - np.abs(turn(np.roll(self.arriving, 1, axis=-2), self.leaving))


def wraps_around(section: Section, vertices: Array, bends: Bends | None = None) -> Wraps:
    """Return the taut edges of a clockwise polygon around a section.

    Parameters
    ----------
    vertices: (…, n, 2) [m], outside of the section.
    bends: (…, n), the corners about which edges bend, so that curves continue smoothly beyond the
        places at which these change; None for the corners that they touch.
    """
    onward = np.roll(vertices, -1, axis=-2)
    given = (None, None) if bends is None else np.moveaxis(bends.corners, -1, 0)
    a, first, corner = _tangents(section, vertices, 1.0, given[0])
    b, last, corner_after = _tangents(section, onward, -1.0, given[1])
    b, chord = -b, onward - vertices
    straight, right = unit(chord), -turn(a, b)
    if bends is None:
        left = np.stack([-straight[..., 1], straight[..., 0]], axis=-1)
        nearest = np.argmax(left @ section.core.T, axis=-1)[..., None]
        corners = np.stack([corner, corner_after], axis=-1)
        bends = Bends(right > 0.0, np.where((right > 0.0)[..., None], corners, nearest))
    touching = np.broadcast_to(bends.touching, right.shape)
    touches = touching[..., None]
    ring = np.append(0.0, np.cumsum(length(np.roll(section.core, -1, 0) - section.core)))
    sides = (ring[corner_after] - ring[corner]) % ring[-1] if ring[-1] > 0.0 else 0.0
    arcs = np.where(touching, sides + section.rounding * right, 0.0)
    bent = np.stack([vertices + first[..., None] * a, onward - last[..., None] * b], axis=-2)
    ahead = dot(section.core[bends.corners[..., 0]] - vertices, straight)
    closest = vertices + np.clip(ahead, 0.0, length(chord))[..., None] * straight
    return Wraps(
        np.where(touches, a, straight),
        np.where(touches, b, straight),
        np.where(touching, first + last + arcs, length(chord)),
        arcs,
        np.where(touching, right, 0.0),
        np.where(touches[..., None], bent, closest[..., None, :]),
        bends,
    )


def _tangents(
    section: Section, points: Array, side: float, about: Indices | None
) -> tuple[Array, Array, Indices]:
    """Return tangents from points (…, 2): directions, lengths [m], and the corners touched.

    The section is on their right with side 1, on their left with -1. They touch the corners
    ``about`` (…), or else those that leave all of the section on that side.
    """
    to_corners = section.core - points[..., None, :]
    to_middle = np.mean(section.core, axis=0) - points
    far = length(to_corners)
    lean = np.arcsin(np.minimum(section.rounding / np.where(far > 0.0, far, 1.0), 1.0))
    angles = side * turn(to_middle[..., None, :], to_corners) + lean
    if about is None:
        corner = first_smallest(-angles, 1.0)  # of two corners on one side, either is right
    else:
        corner = np.broadcast_to(about, points.shape[:-1])
    chosen = np.take_along_axis(angles, corner[..., None], axis=-1)[..., 0]
    reach = np.take_along_axis(far, corner[..., None], axis=-1)[..., 0]
    lengths = np.sqrt(np.maximum(reach**2 - section.rounding**2, 0.0))
    c, s = np.cos(side * chosen), np.sin(side * chosen)
    x, y = np.moveaxis(unit(to_middle), -1, 0)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1), lengths, corner


def turn(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] from vectors (…, 2) to others, positive to the left."""
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return np.asarray(np.arctan2(cross, np.sum(first * second, axis=-1)))


@dataclass(frozen=True, eq=False)
class Grip(OneLine):
    """Hitches that grip one section with one tension, as seen from above, with any leading axes.

    Attributes
    ----------
    section: about its own origin.
    tension: of every cable [N].
    clasp_friction: coefficient of cables on each other.
    wraps: the edges.
    vertices: (…, n, 2) [m], clasps.
    legs: (…, n, 2) [m], ``d_k`` and ``e_k``; negative if the cable is too short.
    """

    section: Section
    tension: float
    clasp_friction: float
    wraps: Wraps
    vertices: Array
    legs: Array

    @classmethod
    def of(
        cls,
        section: Section,
        vertices: Array,
        cable_length: float,
        tension: float,
        clasp_friction: float = 0.0,
    ) -> Grip:
        """Return the grip with vertices (…, n, 2) [m], whose cables end in equal legs."""
        wraps = wraps_around(section, vertices)
        legs = np.repeat(0.5 * (cable_length - wraps.lengths)[..., None], 2, axis=-1)
        return cls(section, tension, clasp_friction, wraps, vertices, legs)

    @property
    def leg_directions(self) -> Array:
        """(…, n, 2, 2): unit vectors from ``p_k`` to ``q_k`` and from ``p_{k+1}`` to ``r_k``."""
        arriving, leaving = np.roll(self.wraps.arriving, 1, axis=-2), self.wraps.leaving
        return np.stack([arriving, -np.roll(leaving, -1, axis=-2)], axis=-2)

    @property
    def drones(self) -> Array:
        """(…, n, 2, 2) [m]: ``q_k`` and ``r_k``."""
        ends = np.stack([self.vertices, np.roll(self.vertices, -1, axis=-2)], axis=-2)
        return np.asarray(ends + self.legs[..., None] * self.leg_directions)

    def slip_load(self, friction: float) -> Array:
        """Return the weight (…) [N] at which an object with that friction slips.

        It is ``μ Σ T_k θ_k``, edges' tensions lowered by as much as clasp friction can.
        """
        bent = self.wraps.clasp_angles
        worst = np.maximum(bent, np.roll(bent, -1, axis=-1))
        least = self.tension * np.exp(-self.clasp_friction * worst)
        return np.asarray(friction * np.sum(least * self.wraps.angles, axis=-1))

    @property
    def pulls(self) -> Array:
        """(…, n, 2) [N]: forces ``V_k`` of the clasps on object and cables, outward."""
        arriving = np.roll(self.wraps.arriving, 1, axis=-2)
        return np.asarray(self.tension * (arriving - self.wraps.leaving))

    @property
    def imbalance(self) -> Array:
        """(…, 3): level force [N] and vertical moment [N m] of clasps on the section."""
        arms = self.vertices - self.section.centroid
        moment = arms[..., 0] * self.pulls[..., 1] - arms[..., 1] * self.pulls[..., 0]
        both = np.concatenate([self.pulls, moment[..., None]], axis=-1)
        return np.asarray(np.sum(both, axis=-2))


# Balance of clasps.

DAMPING = 1e-2
"""Damping over stiffness: clasps do not turn about objects that are nearly round."""

PROBE = 1e-6
"""[m] Step of differences of edges' pulls."""

MAX_STEP = 0.5
"""Longest step of a clasp over the shorter of its straight parts: within it pulls are nearly linear
in the clasps' places."""


def straight_parts(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``.

    Clasps (…, n, 2) [m] are z (…, n) [m] above the plane of contacts (…, n, 2, 2) [m].
    """
    parts = _parts(polygon, z, _contacts_at_clasps(contacts))
    return -parts[..., 0, :], np.roll(parts[..., 1, :], -1, axis=-2)


def _contacts_at_clasps(contacts: Array) -> Array:
    """Return the contacts (…, n, 2, 2) [m] next to clasps: of the edges that leave and arrive."""
    return np.stack([contacts[..., 0, :], np.roll(contacts[..., 1, :], 1, axis=-2)], axis=-2)


def _parts(polygon: Array, z: Array, at: Array) -> Array:
    """Return the straight parts (…, n, 2, 3) [m] from contacts next to clasps to their clasps."""
    level = polygon[..., None, :] - at
    height = np.broadcast_to(z[..., None, None], (*level.shape[:-1], 1))
    return np.concatenate([level, height], axis=-1)


def balanced(
    clasps: Array, T: Array, arms: Array, load: Array, back: tuple[Array, Array] | None = None
) -> Array:
    """Return clasps (…, n, 3) [m], moved and turned together and raised, whose edges bear a load.

    It is one damped Newton step, shortened if it is long. No edge turns a disc.

    Parameters
    ----------
    clasps: (…, n, 3) [m], from the centre of mass, and above the plane of contact.
    T: (…, n) [N], tensions of edges.
    arms: (…, n, 2, 2) [m], contacts, from the centre of mass.
    load: (…, 3) [N], level force on the object there, and weight.
    back: (…, n, 2) [m], clasps as planned, and (…) the share by which they are moved from there;
        None for all.
    """
    polygon, z = clasps[..., :2], clasps[..., 2]
    size = np.mean(length(arms), axis=(-2, -1))[..., None, None]
    at, pull = _contacts_at_clasps(arms), np.stack([T, np.roll(T, 1, axis=-1)], axis=-1)
    turned = np.stack([-polygon[..., 1], polygon[..., 0]], axis=-1) / size
    moves = np.stack([0.0 * turned + [1.0, 0.0], 0.0 * turned + [0.0, 1.0], turned])

    def residual(there: Array) -> Array:
        """Return the level force, and moment over size (…, 3) [N], that edges lack."""
        parts = _parts(there, _raised(there, z, pull, at, load[..., 2]), at)
        pulls = pull[..., None] * unit(parts)
        moments = at[..., 0] * pulls[..., 1] - at[..., 1] * pulls[..., 0]
        pulls[..., 2] = moments / size
        return np.asarray(load * [1.0, 1.0, 0.0] - np.sum(pulls, axis=(-3, -2)))

    after, before = (residual(polygon + step * moves) for step in (PROBE, -PROBE))
    stiffness = np.moveaxis(before - after, 0, -1) / (2.0 * PROBE)
    norms = np.linalg.norm(stiffness, axis=(-2, -1))
    damping = (DAMPING * norms)[..., None, None] ** 2 * np.eye(3)
    transposed = np.swapaxes(stiffness, -2, -1)
    right = transposed @ residual(polygon)[..., None]
    amounts = np.linalg.solve(transposed @ stiffness + damping, right)[..., 0]
    there = polygon + np.einsum("j...ni,...j->...ni", moves, amounts)
    if back is not None:
        planned, share = back
        there = planned + share[..., None, None] * (there - planned)
    raised = _raised(there, z, pull, at, load[..., 2])
    step = np.concatenate([there, raised[..., None]], axis=-1) - clasps
    reach = MAX_STEP * np.min(length(_parts(polygon, z, at)), axis=-1)
    part = np.min(reach / np.maximum(length(step), reach), axis=-1)
    return np.asarray(clasps + part[..., None, None] * step)


def _raised(polygon: Array, z: Array, pull: Array, at: Array, weight: Array) -> Array:
    """Return the clasps' heights (…, n) [m] after a Newton step towards bearing a weight.

    Of all vertical forces that bear it without a moment about level axes they take those nearest to
    equal ones.
    """
    parts = _parts(polygon, z, at)
    rates = pull / length(parts)
    lifts = np.concatenate([np.ones_like(at[..., :1]), at], axis=-1) * rates[..., None]
    whole = np.sum(rates, axis=-1)
    means = np.sum(lifts, axis=-2) / whole[..., None]  # (…, n, 3), of force and moments
    lacking = weight[..., None] * ([1.0, 0.0, 0.0] - np.mean(means, axis=-2))
    squares = np.swapaxes(means, -1, -2) @ means
    forces = weight[..., None] / z.shape[-1]
    forces = forces + (means @ np.linalg.solve(squares, lacking[..., None]))[..., 0]
    stiff = np.sum(rates * (1.0 - unit(parts)[..., 2] ** 2), axis=-1)
    return np.asarray(z + (forces - whole * z) / stiff)


# Friction at clasps.

FIXED_POINT_STEPS = 20
"""Steps of the fixed-point iteration for the angle by which sliding cables turn."""

TINY = 1e-12
"""Keeps quotients of friction finite without friction."""


def _other_half(friction: Array, angle: Array) -> Array:
    """Return half of the angle (…) [rad] that legs enclose if edges enclose one, or the reverse.

    Where cables slide on each other, ``cos x = e^{-μ θ} cos(β/2)``: x and β are of the side that
    pulls harder and of the other one, μ is the friction and cables turn by ``θ = β/2 + x``.
    """
    half = other = 0.5 * angle
    for _ in range(FIXED_POINT_STEPS):
        ratio = np.exp(-friction * (half + other))
        other = np.arccos(np.clip(ratio * np.cos(half), -1.0, 1.0))
    return other


def edge_ratios(friction: Array, edges: Array) -> Array:
    """Return tensions of edges over those of their legs (…, n) while cables slide at clasps.

    Of both clasps of a cable the lesser friction counts.

    Parameters
    ----------
    friction: (…), coefficient of cables on each other that counts; negative while clasps open.
    edges: (…, n) [rad], between edges at clasps.
    """
    friction = friction[..., None]
    one = np.abs(friction) * (0.5 * edges + _other_half(friction, edges)) + TINY
    other = np.roll(one, -1, axis=-1)
    lesser = one * other / (0.5 * (one**8 + other**8)) ** 0.125
    return np.asarray(np.exp(-np.sign(friction) * lesser))


def residual_grip(legs: Array, tension: Array, clasp_friction: float, friction: float) -> float:
    """Return the largest slip load [N] of a hitch that has opened as far as friction lets it.

    Cables slide on each other until friction balances edges and legs. By as much as the angles
    between edges then exceed those of a polygon, edges still wrap the object.

    Parameters
    ----------
    legs: (n, 2, 2) [m], the two legs at every clasp as seen from above.
    tension: (n,) [N], of legs.
    clasp_friction: coefficient of cables on each other.
    friction: coefficient of cables on the object.
    """
    one, other = np.moveaxis(unit(legs), 1, 0)
    between = np.arccos(np.clip(np.sum(one * other, axis=-1), -1.0, 1.0))
    half = _other_half(np.asarray(clasp_friction), between)
    ratio = float(np.max(np.exp(clasp_friction * (half + 0.5 * between))))
    wrapped = max(2.0 * float(np.sum(half)) - (len(legs) - 2) * math.pi, 0.0)
    return friction * float(np.max(tension)) * ratio * wrapped


# Capacities: the largest masses that are held.

RESOLUTION = 1e-7
"""[kg] Resolution of masses."""

TOLERANCE = 1e-9
"""Margin below zero at which a limit still holds, as in the certificate."""

SUGGESTED = {
    "grip": "raise the tension, or use rougher cables",
    "tilt": "raise limits.tilt_deg",
    "thrust": "use stronger drones, or lower the tension",
    "separation": "use cables of another length",
    "cable_clearance": "use longer cables",
    "crossing": "use shorter cables",
    "keep_out": "use longer cables",
    "legs": "use longer cables",
    "equilibrium": "raise the tension",
    "support": "use a wider rim, or lower the centre of mass",
}
"""Changes that let a hold carry more, by the limit that binds."""


@dataclass(frozen=True)
class Capacity(OneLine):
    """The largest mass [kg] that a hold carries, and the limit that binds, as a check's name.

    It is 0 if the hold breaks a limit without a load.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that raises it."""
        if self.mass == 0.0 and self.binding not in SUGGESTED:
            return "use another number of robots, or cables of another length"
        return SUGGESTED.get(self.binding, "use longer cables")


MAX_ACCELERATION = 1.0
"""[m/s²] Largest acceleration of loads."""


def rest_capacity(
    polygon: Outline,
    cable_length: float,
    tension: float,
    kind: Quadrotor,
    requirements: Requirements,
    height: float,
) -> Capacity:
    """Return the largest mass [kg] that rests on a polygon's edges within all limits.

    Its centroid is under the centre of mass, ``height`` [m] above the edges; all cables have one
    length [m] and one tension [N].
    """
    n, limits = len(polygon), requirements.limits
    away, u = polygon.vertices - polygon.centroid, polygon.edge_directions
    inside = np.min(away[:, 1] * u[:, 0] - away[:, 0] * u[:, 1])
    support = float(inside) - height * MAX_ACCELERATION / GRAVITY  # of the force line [m]
    unloaded = Team(n, cable_length, tension=tension, quadrotor=kind)
    shape = polygon.vertices[None], balanced_legs(unloaded, polygon)[None]
    spread = LegTask(unloaded, requirements, *shape, limits.leg, SPREAD_MARGIN)
    legs = split_slack(spread).q_legs

    def worst(mass: float) -> tuple[float, str]:
        """Return the smallest margin with a mass [kg], and the name of its limit."""
        team = Team(n, cable_length, tension=tension, quadrotor=kind, load=mass / n)
        try:
            hitch = Hitch(team, polygon, 1.0, legs[0])
            thrusts = -hitch.cable_forces + [0.0, 0.0, GRAVITY * kind.mass]
        except InfeasibleError as error:
            return -1.0, error.violations[0].constraint
        tilt = np.arctan2(length(thrusts[:, :2]), thrusts[:, 2])
        task = replace(spread, team=team, reference=legs, margin=LIMIT_MARGIN)
        margins = {
            "thrust": 1.0 - float(np.max(length(thrusts))) / kind.max_thrust,
            "tilt": 1.0 - float(np.max(tilt)) / limits.tilt,
            "legs": float(np.min(hitch.legs)) / limits.leg - 1.0,
            "separation": reference_margin(task) - 1.0,
            "support": support,
        }
        return min((margin, name) for name, margin in margins.items())

    margin, name = worst(0.0)
    if margin < -TOLERANCE:
        return Capacity(0.0, name)
    low, high = 0.0, 2.5 * n * tension / GRAVITY  # all legs upright bear less
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        margin, reason = worst(middle)
        if margin >= -TOLERANCE:
            low = middle
        else:
            high, name = middle, reason
    return Capacity(low, name)


def grip_capacity(grip: Grip, kind: Quadrotor, friction: float, factor: float) -> Capacity:
    """Return the largest mass [kg] that a grip lifts, by friction and thrust, and what binds.

    Every leg lifts the same share w of the weight at the same tension T, so that a drone's thrust
    is ``√(T² - w² + (m g + w)²)``. The slip load is at least ``factor`` times the load.
    """
    weight, legs = GRAVITY * kind.mass, 2.0 * grip.vertices.shape[-2]
    spare = kind.max_thrust**2 - grip.tension**2 - weight**2
    loads = {
        "grip": float(grip.slip_load(friction)) / factor,
        "thrust": legs * max(spare, 0.0) / (2.0 * weight),
    }
    binding = min(loads, key=lambda name: loads[name])
    return Capacity(loads[binding] / GRAVITY, binding)
