"""The mathematics of a hold: taut edges around an object, grips, balance, friction, capacities.

A section is a core of clockwise corners, rounded by discs of one radius. Edges run clockwise around
it, with the section on their right: tangent, arc and tangent between two clasps outside of it. The
edges at clasp k, with unit vectors ``b_{k-1}`` (arriving) and ``a_k`` (leaving), pull with ``V_k =
T (b_{k-1} - a_k)``. If all tensions are equal, legs lie along the neighbouring edges: ``q̂_k =
b_{k-1}`` and ``r̂_{k-1} = -a_k``. Arrays may have any leading axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.quadrotor import GRAVITY, Quadrotor
from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import cross, dot, first_smallest, left_of, length, turn, unit
from hitchopt.hitch.twists import bend, bend_together
from hitchopt.hitch.yaw import YawTerms, moves_of_ends, stiffness_of_turn
from hitchopt.objects import Section
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Bends:
    """The corners of a section's core about which edges bend."""

    touching: NDArray[np.bool_]  # (…, n), whether an edge touches the section, and so bends
    # (…, n, 2), the first and the last corner; twice the nearest one for a straight edge
    corners: Indices

    def differ(self, other: Bends) -> NDArray[np.bool_]:
        """Return whether any edge bends about other corners (…)."""
        has_moved = np.any(self.corners != other.corners, axis=-1) & self.touching
        has_changed = self.touching != other.touching
        return np.asarray(np.any(has_moved | has_changed, axis=-1))

    def __getitem__(self, item: Any) -> Bends:
        return Bends(self.touching[item], self.corners[item])


@dataclass(frozen=True, eq=False)
class Wraps:
    """Edges k from vertex k to vertex k+1, bent around a section if they touch it."""

    leaving: Array  # (…, n, 2), unit vector ``a_k`` of the edge at ``p_k``
    # (…, n, 2), unit vector ``b_k`` of the edge at ``p_{k+1}``; ``a_k`` if it is straight
    arriving: Array
    lengths: Array  # (…, n) [m], lengths of cable between the clasps
    arcs: Array  # (…, n) [m], arc lengths on the section
    angles: Array  # (…, n) [rad], wrap angles ``θ_k``; 0 for a straight edge
    contacts: Array
    """(…, n, 2, 2) [m], ends of the arc; of a straight edge twice the point nearest to the
    section."""

    bends: Bends  # The corners about which edges bend

    @property
    def clasp_angles(self) -> Array:
        """(…, n) [rad]: angle ``β_k`` between the two edges at every clasp."""
        return math.pi - np.abs(turn(np.roll(self.arriving, 1, axis=-2), self.leaving))


def wraps_around(section: Section, vertices: Array, bends: Bends | None = None) -> Wraps:
    """Return the taut edges of a clockwise polygon around a section.

    Parameters
    ----------
    vertices: (…, n, 2) [m], outside of the section.
    bends: (…, n), prescribed corners about which edges bend, so that curves continue smoothly
        beyond their changes; None for the corners that edges touch.
    """
    next_vertices = np.roll(vertices, -1, axis=-2)
    first_corners, last_corners = None, None
    if bends is not None:
        first_corners, last_corners = np.moveaxis(bends.corners, -1, 0)
    first = _tangents(section, vertices, 1.0, first_corners)
    last = _tangents(section, next_vertices, -1.0, last_corners)
    leaving = first.directions
    arriving = -last.directions
    chord = next_vertices - vertices
    chord_length = length(chord)
    straight = unit(chord)
    right_turn = -turn(leaving, arriving)
    if bends is None:
        is_bent = right_turn > 0.0
        touched = np.stack([first.corners, last.corners], axis=-1)
        nearest = np.argmax(left_of(straight) @ section.core.T, axis=-1)[..., None]
        bends = Bends(is_bent, np.where(is_bent[..., None], touched, nearest))
    touching = np.broadcast_to(bends.touching, right_turn.shape)
    sides = _sides_between(section, first.corners, last.corners)
    arcs = np.where(touching, sides + section.rounding * right_turn, 0.0)
    first_contact = vertices + first.lengths[..., None] * leaving
    last_contact = next_vertices - last.lengths[..., None] * arriving
    contacts = np.stack([first_contact, last_contact], axis=-2)
    to_nearest = dot(section.core[bends.corners[..., 0]] - vertices, straight)
    nearest_point = vertices + np.clip(to_nearest, 0.0, chord_length)[..., None] * straight
    return Wraps(
        leaving=np.where(touching[..., None], leaving, straight),
        arriving=np.where(touching[..., None], arriving, straight),
        lengths=np.where(touching, first.lengths + last.lengths + arcs, chord_length),
        arcs=arcs,
        angles=np.where(touching, right_turn, 0.0),
        contacts=np.where(touching[..., None, None], contacts, nearest_point[..., None, :]),
        bends=bends,
    )


def _sides_between(section: Section, first: Indices, last: Indices) -> Array | float:
    """Return the clockwise length (…) [m] of a core's outline between corners (…)."""
    side_lengths = length(np.roll(section.core, -1, 0) - section.core)
    along_outline = np.append(0.0, np.cumsum(side_lengths))
    perimeter = along_outline[-1]
    if perimeter == 0.0:  # a circle
        return 0.0
    return np.asarray((along_outline[last] - along_outline[first]) % perimeter)


class Tangents(NamedTuple):
    """Tangents from points to a section."""

    directions: Array  # (…, 2), unit vectors from the points
    lengths: Array  # (…) [m], distances of the points from their contacts
    corners: Indices  # (…), corners of the core that they touch


def _tangents(section: Section, points: Array, side: float, about: Indices | None) -> Tangents:
    """Return tangents from points (…, 2) [m].

    The section is on their right for side 1, on their left for -1. They touch the corners ``about``
    (…); if None, those for which the whole section is on that side.
    """
    to_corners = section.core - points[..., None, :]
    to_middle = np.mean(section.core, axis=0) - points
    distances = length(to_corners)
    sines = section.rounding / np.where(distances > 0.0, distances, 1.0)
    angles = side * turn(to_middle[..., None, :], to_corners) + np.arcsin(np.minimum(sines, 1.0))
    if about is None:
        corner = first_smallest(-angles, 1.0)  # either of two collinear corners is right
    else:
        corner = np.broadcast_to(about, points.shape[:-1])
    angle = np.take_along_axis(angles, corner[..., None], axis=-1)[..., 0]
    distance = np.take_along_axis(distances, corner[..., None], axis=-1)[..., 0]
    lengths = np.sqrt(np.maximum(distance**2 - section.rounding**2, 0.0))
    cosine = np.cos(side * angle)
    sine = np.sin(side * angle)
    x, y = np.moveaxis(unit(to_middle), -1, 0)
    directions = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
    return Tangents(directions, lengths, corner)


@dataclass(frozen=True, eq=False)
class Grip(OneLine):
    """Hitches that grip one section with one tension, in plan view, with any leading axes.

    Attributes
    ----------
    section: about its own origin.
    tension: of every cable [N].
    clasp_friction: friction coefficient between cables.
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
        """Return the grip with vertices (…, n, 2) [m] and two equal legs per cable."""
        wraps = wraps_around(section, vertices)
        legs = np.repeat(0.5 * (cable_length - wraps.lengths)[..., None], 2, axis=-1)
        return cls(section, tension, clasp_friction, wraps, vertices, legs)

    @property
    def leg_directions(self) -> Array:
        """(…, n, 2, 2): unit vectors from ``p_k`` to ``q_k`` and from ``p_{k+1}`` to ``r_k``."""
        behind = np.roll(self.wraps.arriving, 1, axis=-2)  # b_{k-1}
        ahead = np.roll(self.wraps.leaving, -1, axis=-2)  # a_{k+1}
        return np.stack([behind, -ahead], axis=-2)

    @property
    def drones(self) -> Array:
        """(…, n, 2, 2) [m]: ``q_k`` and ``r_k``."""
        ends = np.stack([self.vertices, np.roll(self.vertices, -1, axis=-2)], axis=-2)
        return np.asarray(ends + self.legs[..., None] * self.leg_directions)

    def slip_load(self, friction: float) -> Array:
        """Return the weight (…) [N] at which an object slips, for its friction coefficient.

        It is ``μ Σ T_k θ_k`` with the lowest edge tensions that clasp friction permits.
        """
        angles = self.wraps.clasp_angles
        larger_angles = np.maximum(angles, np.roll(angles, -1, axis=-1))
        tensions = self.tension * np.exp(-self.clasp_friction * bend(np.cos(larger_angles)))
        return np.asarray(friction * np.sum(tensions * self.wraps.angles, axis=-1))

    @property
    def pulls(self) -> Array:
        """(…, n, 2) [N]: outward forces ``V_k`` that hold the clasps."""
        arriving = np.roll(self.wraps.arriving, 1, axis=-2)
        return np.asarray(self.tension * (arriving - self.wraps.leaving))

    @property
    def imbalance(self) -> Array:
        """(…, 3): horizontal force [N] and vertical moment [N m] of the clasps on the section."""
        arms = self.vertices - self.section.centroid
        moment = arms[..., 0] * self.pulls[..., 1] - arms[..., 1] * self.pulls[..., 0]
        both = np.concatenate([self.pulls, moment[..., None]], axis=-1)
        return np.asarray(np.sum(both, axis=-2))

    @property
    def straight_parts(self) -> Array:
        """(…, n, 2, 2) [m]: from contacts to ``p_k``, and to ``p_{k+1}``."""
        ends = np.stack([self.vertices, np.roll(self.vertices, -1, axis=-2)], axis=-2)
        return np.asarray(ends - self.wraps.contacts)

    @property
    def yaw_stiffness(self) -> Array:
        """(…) [N m]: the stiffness of the section's yaw, as in ``YawTerms``."""
        parts = self.straight_parts
        per_length = self.tension / np.maximum(length(parts), MIN_PART)
        per_leg = self.tension / np.maximum(self.legs, MIN_PART)
        directions = unit(parts)
        levers = dot(directions, self.wraps.contacts - self.section.centroid)
        normals = left_of(directions)
        leg_normals = left_of(self.leg_directions)
        terms = YawTerms(
            turns=levers * (self.tension + levers * per_length),
            both=normals * (-levers * per_length)[..., None],
            parts=normals[..., :, None] * normals[..., None, :] * per_length[..., None, None],
            legs=leg_normals[..., :, None] * leg_normals[..., None, :] * per_leg[..., None, None],
        )
        return stiffness_of_turn(terms.matrix(moves_of_ends(self.vertices.shape[-2])))


# Stability of yaw.

MIN_PART = 1e-4  # [m] Smallest divisor of second derivatives of lengths
DAMPING = 1e-2  # Damping over stiffness, which keeps clasps from turning about nearly round objects
DIFFERENCE_STEP = 1e-6  # [m] Step of the central differences of the edges' pulls

MAX_STEP = 0.5
"""Largest step of a clasp over the shorter of its straight parts, within which pulls are nearly
linear in the clasps' positions."""


def straight_parts(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``.

    The heights of clasps (…, n, 2) [m] above the plane of contacts (…, n, 2, 2) [m] are z (…, n).
    """
    parts = _parts(polygon, z, _contacts_at_clasps(contacts))
    return -parts[..., 0, :], np.roll(parts[..., 1, :], -1, axis=-2)


def _contacts_at_clasps(contacts: Array) -> Array:
    """Return the contacts (…, n, 2, 2) [m] of the edges that leave and reach each clasp."""
    return np.stack([contacts[..., 0, :], np.roll(contacts[..., 1, :], 1, axis=-2)], axis=-2)


def _parts(polygon: Array, z: Array, contacts: Array) -> Array:
    """Return the straight parts (…, n, 2, 3) [m] from contacts (…, n, 2, 2) to their clasps."""
    level = polygon[..., None, :] - contacts
    height = np.broadcast_to(z[..., None, None], (*level.shape[:-1], 1))
    return np.concatenate([level, height], axis=-1)


class PlannedClasps(NamedTuple):
    """Clasps from which only a share of the displacement to balanced ones applies."""

    positions: Array  # (…, n, 2) [m], relative to the centre of mass
    share: Array  # (…), the share of the displacement that applies


def step_toward_balance(
    clasps: Array,
    tensions: Array,
    arms: Array,
    load: Array,
    planned: PlannedClasps | None = None,
) -> Array:
    """Return the clasps (…, n, 3) [m] after one Newton step toward edges that bear a load.

    All clasps translate and turn together, and each moves vertically. The step is damped, since no
    edge can turn a disc, and limited in length.

    Parameters
    ----------
    clasps: (…, n, 3) [m], relative to the centre of mass and the plane of contact.
    tensions: (…, n) [N], of edges.
    arms: (…, n, 2, 2) [m], contacts, relative to the centre of mass.
    load: (…, 3) [N], horizontal force on the object there, and weight.
    planned: clasps to which the step returns in part; None for the full displacement.
    """
    polygon = clasps[..., :2]
    z = clasps[..., 2]
    size = np.mean(length(arms), axis=(-2, -1))[..., None, None]
    contacts = _contacts_at_clasps(arms)
    pulls = np.stack([tensions, np.roll(tensions, 1, axis=-1)], axis=-1)
    weight = load[..., 2]
    rotation = left_of(polygon) / size
    along_x = 0.0 * rotation + [1.0, 0.0]
    along_y = 0.0 * rotation + [0.0, 1.0]
    rigid_moves = np.stack([along_x, along_y, rotation])  # (3, …, n, 2)

    def residual(polygon: Array) -> Array:
        """Return the unbalanced horizontal force, and moment over size (…, 3) [N]."""
        heights = _raised(polygon, z, pulls, contacts, weight)
        forces = pulls[..., None] * unit(_parts(polygon, heights, contacts))
        moments = cross(contacts, forces) / size
        loads = np.stack([forces[..., 0], forces[..., 1], moments], axis=-1)
        return np.asarray(load * [1.0, 1.0, 0.0] - np.sum(loads, axis=(-3, -2)))

    after = residual(polygon + DIFFERENCE_STEP * rigid_moves)
    before = residual(polygon - DIFFERENCE_STEP * rigid_moves)
    stiffness = np.moveaxis(before - after, 0, -1) / (2.0 * DIFFERENCE_STEP)
    lengths = _damped_solution(stiffness, residual(polygon))
    moved = polygon + np.einsum("j...ni,...j->...ni", rigid_moves, lengths)
    if planned is not None:
        share = planned.share[..., None, None]
        moved = planned.positions + share * (moved - planned.positions)
    raised = _raised(moved, z, pulls, contacts, weight)
    step = np.concatenate([moved, raised[..., None]], axis=-1) - clasps
    max_step = MAX_STEP * np.min(length(_parts(polygon, z, contacts)), axis=-1)
    factor = np.min(max_step / np.maximum(length(step), max_step), axis=-1)
    return np.asarray(clasps + factor[..., None, None] * step)


def _damped_solution(stiffness: Array, residual: Array) -> Array:
    """Return the lengths (…, 3) [m] of three moves that cancel a residual (…, 3), in least squares.

    The damping is DAMPING times the norm of the stiffness (…, 3, 3).
    """
    norms = np.linalg.norm(stiffness, axis=(-2, -1))
    damping = (DAMPING * norms)[..., None, None] ** 2 * np.eye(3)
    transposed = np.swapaxes(stiffness, -2, -1)
    right_side = transposed @ residual[..., None]
    lengths: Array = np.linalg.solve(transposed @ stiffness + damping, right_side)[..., 0]
    return lengths


def _raised(polygon: Array, z: Array, pulls: Array, contacts: Array, weight: Array) -> Array:
    """Return the clasps' heights (…, n) [m] after a Newton step toward bearing a weight.

    The vertical forces are the most equal ones that bear it without a moment about horizontal axes.
    Parts of the pulls (…, n, 2) [N] lead from contacts (…, n, 2, 2) [m] to their clasps; a clasp at
    the height z lifts by z times the sum of the pulls over the lengths of its parts.
    """
    parts = _parts(polygon, z, contacts)
    lift_rates = pulls / length(parts)  # [N/m]
    with_force = np.concatenate([np.ones_like(contacts[..., :1]), contacts], axis=-1)
    total_rate = np.sum(lift_rates, axis=-1)
    # Force and moments per vertical force of a clasp (…, n, 3)
    effects = np.sum(with_force * lift_rates[..., None], axis=-2) / total_rate[..., None]
    # Minimise the sum of (f - W/n)² subject to effectsᵀ f = (W, 0, 0)
    imbalance = weight[..., None] * ([1.0, 0.0, 0.0] - np.mean(effects, axis=-2))
    gram = np.swapaxes(effects, -1, -2) @ effects
    clasps = z.shape[-1]
    if clasps == 2:  # no moment about the line through both clasps
        multipliers = np.linalg.pinv(gram, hermitian=True) @ imbalance[..., None]
    else:
        multipliers = np.linalg.solve(gram, imbalance[..., None])
    forces = weight[..., None] / clasps + (effects @ multipliers)[..., 0]
    stiffness = np.sum(lift_rates * (1.0 - unit(parts)[..., 2] ** 2), axis=-1)
    return np.asarray(z + (forces - total_rate * z) / stiffness)


# Friction at clasps.

FIXED_POINT_STEPS = 20
"""Steps of the fixed-point iteration for the angle by which sliding cables turn."""

MIN_FRICTION_ANGLE = 1e-12
"""Added to products of friction and angle, whose quotients are then finite without friction."""


def _other_half(friction: Array, angle: Array) -> Array:
    """Return half of the angle (…) [rad] between legs from that between edges, or the reverse.

    While cables slide alike, ``cos x = e^{-μ γ} cos(β/2)``: 2x is the angle on the side with the
    higher tension, β that on the other side, and γ the ``bend_together`` for turns by ``β/2 + x``.
    """
    half = 0.5 * angle
    other_half = half
    for _ in range(FIXED_POINT_STEPS):
        tension_ratio = np.exp(-friction * bend_together(half + other_half))
        other_half = np.arccos(np.clip(tension_ratio * np.cos(half), -1.0, 1.0))
    return other_half


def edge_ratios(friction: Array, edges: Array) -> Array:
    """Return tensions of edges over those of their legs (…, n) while all cables slide alike.

    The smaller friction of a cable's two clasps applies, as a smooth minimum.

    Parameters
    ----------
    friction: (…), mobilized friction coefficient between cables; negative while clasps open.
    edges: (…, n) [rad], angles between edges at clasps.
    """
    friction = friction[..., None]
    turns = 0.5 * edges + _other_half(friction, edges)
    exponents = np.abs(friction) * bend_together(turns) + MIN_FRICTION_ANGLE
    of_next_clasp = np.roll(exponents, -1, axis=-1)
    mean_power = 0.5 * (exponents**8 + of_next_clasp**8)
    smaller = exponents * of_next_clasp / mean_power**0.125
    return np.asarray(np.exp(-np.sign(friction) * smaller))


def residual_grip(legs: Array, tension: Array, clasp_friction: float, friction: float) -> float:
    """Return the largest slip load [N] of a hitch that has opened as far as friction permits.

    All cables slide alike until friction balances edges and legs. The excess of the angles
    between edges over those of a polygon is the angle by which edges still wrap the object.

    Parameters
    ----------
    legs: (n, 2, 2) [m], the two legs at every clasp in plan view.
    tension: (n,) [N], of legs.
    clasp_friction: friction coefficient between cables.
    friction: friction coefficient of cables on the object.
    """
    first_leg, second_leg = np.moveaxis(unit(legs), 1, 0)
    cosines = np.sum(first_leg * second_leg, axis=-1)
    between_legs = np.arccos(np.clip(cosines, -1.0, 1.0))
    half_between_edges = _other_half(np.asarray(clasp_friction), between_legs)
    turns = half_between_edges + 0.5 * between_legs
    largest_ratio = float(np.max(np.exp(clasp_friction * bend_together(turns))))
    angles_of_polygon = (len(legs) - 2) * math.pi
    wrapped = max(2.0 * float(np.sum(half_between_edges)) - angles_of_polygon, 0.0)
    return friction * float(np.max(tension)) * largest_ratio * wrapped


# Capacities: the largest masses that hitches hold.

SUGGESTIONS = {
    "grip": "raise the tension, or use rougher cables",
    "tilt": "raise limits.tilt_deg",
    "thrust": "use stronger drones, or lower the tension",
    "separation": "use cables of a different length",
    "cable_clearance": "use longer cables",
    "crossing": "use shorter cables",
    "keep_out": "use longer cables",
    "legs": "use longer cables",
    "equilibrium": "raise the tension",
    "support": "use a wider rim, or lower the centre of mass",
    "object_clearance": "use a different number of robots, or a rounder rim",
    "robots": "use 3 robots or more",
}
"""Changes that increase the capacity, by binding limit."""


@dataclass(frozen=True)
class Capacity(OneLine):
    """The largest mass [kg] that a hold carries, and the binding limit, as a check's name.

    The mass is 0 if the hold violates a limit without a load.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that increases the capacity."""
        if self.mass == 0.0 and self.binding not in SUGGESTIONS:
            return "use a different number of robots, or cables of a different length"
        return SUGGESTIONS.get(self.binding, "use longer cables")


def grip_capacity(grip: Grip, kind: Quadrotor, friction: float, factor: float) -> Capacity:
    """Return the largest mass [kg] that a grip lifts within the limits of friction and thrust.

    Every leg lifts the same share w of the weight at the same tension T, so that a drone's thrust
    is ``√(T² - w² + (m g + w)²)``. The slip load is at least ``factor`` times the load.
    """
    weight = GRAVITY * kind.mass
    legs = 2.0 * grip.vertices.shape[-2]
    # w from T² + (m g)² + 2 m g w = (largest thrust)²
    spare = max(kind.max_thrust**2 - grip.tension**2 - weight**2, 0.0)
    loads = {
        "grip": float(grip.slip_load(friction)) / factor,
        "thrust": legs * spare / (2.0 * weight),
    }
    binding = min(loads, key=lambda name: loads[name])
    return Capacity(loads[binding] / GRAVITY, binding)
