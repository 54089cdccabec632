"""How a hitch holds an object, at one time: taut edges around it, grips, and the largest masses.

A section is its core of clockwise corners with discs of one radius about them. Edges run clockwise
around it and keep it on their right: tangent, arc, tangent between two clasps outside of it. At
clasp k the edges' unit vectors ``b_{k-1}``, arriving, and ``a_k``, leaving, pull with ``V_k = T
(b_{k-1} - a_k)``; with one tension everywhere legs lie along the neighbours' edges, ``q̂_k =
b_{k-1}`` and ``r̂_{k-1} = -a_k``. Arrays carry any leading axes.

``best_grip`` looks for the polygon that grips hardest within all limits. The search is local, by
sequential quadratic programs (SLSQP) from several polygons: failure does not prove that there is
no grip. What it returns is measured anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, OneLine, Violation, check_time
from hitchopt.geometry import Outline, differences, shortest_offset
from hitchopt.geometry.vectors import first_smallest, length, unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_program import LIMIT_MARGIN, LegTask
from hitchopt.hitch.legs import reference_margin
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.objects import Section
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class Bends:
    """The corners of a section's core about which edges turn.

    Attributes
    ----------
    touching: (…, n), whether they turn at all.
    corners: (…, n, 2), the first and the last corner; of straight ones twice the first to touch.
    """

    touching: NDArray[np.bool_]
    corners: Indices

    def differ(self, other: Bends) -> NDArray[np.bool_]:
        """Return (…) whether any edge turns about other corners."""
        moved = np.any(self.corners != other.corners, axis=-1) & self.touching
        found: NDArray[np.bool_] = np.any(moved | (self.touching != other.touching), axis=-1)
        return found

    def __getitem__(self, item: Any) -> Bends:
        return Bends(self.touching[item], self.corners[item])


@dataclass(frozen=True, eq=False)
class Wraps:
    """Edges k from vertex k to vertex k+1, around a section where they touch it.

    Attributes
    ----------
    leaving, arriving: (…, n, 2) unit vectors ``a_k``, ``b_k`` of the edge at ``p_k`` and at
        ``p_{k+1}``; alike where the edge is straight.
    lengths: (…, n) [m], of cable between the clasps.
    arcs: (…, n) [m], lengths on the section.
    angles: (…, n) [rad], wraps ``θ_k``; 0 of a straight edge.
    contacts: (…, n, 2, 2) [m], where the arc begins and ends; the middle of a straight edge.
    bends: about what edges turn.
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
        behind = np.roll(self.arriving, 1, axis=-2)
        return math.pi - np.abs(_turn(behind, self.leaving))


def wraps_around(section: Section, vertices: Array, bends: Bends | None = None) -> Wraps:
    """Return the taut edges of a clockwise polygon around a section.

    Parameters
    ----------
    vertices: (…, n, 2) [m], outside of the section.
    bends: (…, n), about what edges are to turn, so that curves continue smoothly beyond the last
        place at which they do; None for what they do.
    """
    onward = np.roll(vertices, -1, axis=-2)
    given = (None, None) if bends is None else np.moveaxis(bends.corners, -1, 0)
    a, first, corner = _tangents(section, vertices, 1.0, given[0])
    b, last, corner_after = _tangents(section, onward, -1.0, given[1])
    b = -b
    right = -_turn(a, b)
    touching = right > 0.0 if bends is None else np.broadcast_to(bends.touching, right.shape)
    ring = np.append(0.0, np.cumsum(length(np.roll(section.core, -1, 0) - section.core)))
    sides = (ring[corner_after] - ring[corner]) % ring[-1] if ring[-1] > 0.0 else 0.0
    chord = onward - vertices
    straight = unit(chord)
    touches = touching[..., None]
    if bends is None:
        left = np.stack([-straight[..., 1], straight[..., 0]], axis=-1)
        corners = np.stack([corner, corner_after], axis=-1)
        first_to_touch = np.argmax(left @ section.core.T, axis=-1)[..., None]
        bends = Bends(touching, np.where(touches, corners, first_to_touch))
    contacts = np.stack([vertices + first[..., None] * a, onward - last[..., None] * b], axis=-2)
    middle = 0.5 * (vertices + onward)
    arcs = np.where(touching, sides + section.rounding * right, 0.0)
    return Wraps(
        np.where(touches, a, straight),
        np.where(touches, b, straight),
        np.where(touching, first + last + arcs, length(chord)),
        arcs,
        np.where(touching, right, 0.0),
        np.where(touches[..., None], contacts, middle[..., None, :]),
        bends,
    )


def _tangents(
    section: Section, points: Array, side: float, about: Indices | None
) -> tuple[Array, Array, Indices]:
    """Return tangents from points (…, 2): directions, lengths [m], and the corners touched.

    The section is on the right of them with side 1, on the left with -1. They touch the corners
    ``about`` (…), or else those with all of the section on that side.
    """
    to_corners = section.core - points[..., None, :]
    to_middle = np.mean(section.core, axis=0) - points
    far = length(to_corners)
    lean = np.arcsin(np.minimum(section.rounding / np.where(far > 0.0, far, 1.0), 1.0))
    angles = side * _turn(to_middle[..., None, :], to_corners) + lean
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


def _turn(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] from vectors (…, 2) to others, positive to the left."""
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    angles: Array = np.arctan2(cross, np.sum(first * second, axis=-1))
    return angles


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
    legs: (…, n, 2) [m], ``d_k`` and ``e_k``; negative where the cable is too short.
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
        """Return the grip with vertices (…, n, 2) [m] and what is left of cables in equal legs."""
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
        drones: Array = ends + self.legs[..., None] * self.leg_directions
        return drones

    def slip_load(self, friction: float) -> Array:
        """Return the weight (…) [N] at which an object with that friction slips, without factor.

        It is ``μ Σ T_k θ_k``, with friction at both clasps taking the most off edges' tensions.
        """
        bent = self.wraps.clasp_angles
        worst = np.maximum(bent, np.roll(bent, -1, axis=-1))
        least = self.tension * np.exp(-self.clasp_friction * worst)
        load: Array = friction * np.sum(least * self.wraps.angles, axis=-1)
        return load

    @property
    def pulls(self) -> Array:
        """(…, n, 2) [N]: forces ``V_k`` of the clasps on object and cables, outward."""
        arriving = np.roll(self.wraps.arriving, 1, axis=-2)
        return np.asarray(self.tension * (arriving - self.wraps.leaving))

    @property
    def imbalance(self) -> Array:
        """(…, 3): level force [N] and upright moment [N m] that clasps put on the section."""
        arms = self.vertices - self.section.centroid
        moment = arms[..., 0] * self.pulls[..., 1] - arms[..., 1] * self.pulls[..., 0]
        both = np.concatenate([self.pulls, moment[..., None]], axis=-1)
        return np.asarray(np.sum(both, axis=-2))


LEAST_GAP = 0.02
"""[m] Least distance of a clasp to the section: two ropes bend around each other there."""

STEP = 1e-6
"""[m] Step of central differences of margins."""

KEPT = 0.05
"""Margin of all distances, over their limits: lifting moves drones by less."""

BALANCED = 1e-6
"""Largest level force on the section over the tension, and moment over tension and size."""

SCREENING, ITERATIONS, FINALISTS = 12, 60, 2
"""Most quadratic programs from every start, most from the finalists, and how many these are."""

ALL, SMALLEST = 36, 6
"""Every quadratic program contains so many margins of a kind, or else its smallest ones."""

OFFSETS = ((0.25, 0.25), (0.12, 0.4), (0.4, 0.12))
"""Distances of every other starting vertex to the section, and of those between, over its mean
radius; the first pair where they do not alternate."""

TURNS = 3
"""Starting polygons, turned by equal parts of their symmetry, besides those that face sides."""

PLACES = 12
"""Decimal places of centroids: what rounding leaves of none is none."""


@dataclass(frozen=True, eq=False)
class GripTask:
    """A grip to be found of a section, by n robots of one kind, cable length [m] and tension [N].

    ``clasp_friction`` is that of cables on each other.
    """

    section: Section
    robots: int
    cable_length: float
    tension: float
    clasp_friction: float
    requirements: Requirements
    kind: Quadrotor

    def grip(self, vertices: Array) -> Grip:
        """Return the grip with vertices (…, n, 2) [m]."""
        return Grip.of(self.section, vertices, self.cable_length, self.tension, self.clasp_friction)

    def distances(self, grip: Grip) -> dict[str, Array]:
        """Return by how much (…, items) a grip keeps each distance: ratio minus 1.

        Keys are names of the certificate's checks, and ``gap``, of clasps to the section.
        """
        n, shape, contacts = self.robots, grip.vertices.shape[:-2], grip.wraps.contacts
        drones = grip.drones.reshape(*shape, 2 * n, 2)
        here, onward, k = grip.vertices, np.roll(grip.vertices, -1, axis=-2), np.arange(n)
        starts = here, here, contacts[..., 1, :], onward  # q-legs, both tangents, r-legs
        ends = grip.drones[..., 0, :], contacts[..., 0, :], onward, grip.drones[..., 1, :]
        parts = np.stack([np.concatenate(each, axis=-2) for each in (starts, ends)], axis=-2)
        cable, clasp = np.tile(k, 4), np.concatenate([k, k, (k + 1) % n, (k + 1) % n])
        leg = np.repeat([True, False, False, True], n)
        one, two = np.triu_indices(2 * n, 1)
        apart = length(drones[..., one, :] - drones[..., two, :])
        # Own tangents count, as the own edge of any hitch does; own legs do not.
        near = np.argwhere((np.arange(2 * n)[:, None] // 2 != cable) | ~leg)
        gaps = _distances(drones[..., near[:, :1], :], parts[..., near[:, 1], :, :])
        i, j = np.triu_indices(4 * n, 1)
        both, own = leg[i] & leg[j], cable[i] == cable[j]
        counts = (clasp[i] != clasp[j]) & (leg[i] | leg[j]) & (both | ~own)
        crossing = _distances(parts[..., i[counts], :, :], parts[..., j[counts], :, :])
        clear = self.section.clearance
        found = {
            "separation": apart,
            "cable_clearance": gaps,
            "crossing": crossing,
            "keep_out": clear(drones)[0],
            "legs": grip.legs.reshape(*shape, 2 * n),
            "gap": clear(grip.vertices)[0],
        }
        limits = self.limits
        return {k: each / limits[k] - 1.0 if limits[k] else each for k, each in found.items()}

    @property
    def limits(self) -> dict[str, float]:
        """Limits of these distances by name [m]."""
        separation = self.requirements.separation
        return {
            "separation": 2.0 * separation.radius,
            "cable_clearance": separation.cable,
            "crossing": separation.crossing,
            "keep_out": separation.radius,
            "legs": self.requirements.limits.leg,
            "gap": LEAST_GAP,
        }

    def shortest(self, grip: Grip) -> tuple[float, str]:
        """Return the smallest of all distances' margins, and whose it is."""
        return min((float(np.min(each)), name) for name, each in self.distances(grip).items())

    def merit(self, grip: Grip) -> float:
        """Return the slip load over friction [N] of a grip within all limits, or what it lacks."""
        edges = np.roll(grip.vertices, -1, axis=0) - grip.vertices
        turns = _turn(edges, np.roll(edges, -1, axis=0))
        if not np.all(turns < 0.0) or np.sum(turns) < -3.0 * math.pi:  # not once around, clockwise
            return -math.inf
        scale = np.array([1.0, 1.0, math.sqrt(self.section.area)]) * self.tension
        unbalanced = float(np.max(np.abs(grip.imbalance) / scale)) - BALANCED
        loose = -float(np.min(grip.wraps.angles))
        lacking = max(-self.shortest(grip)[0], unbalanced, 0.0)
        if lacking > 0.0 or loose >= 0.0:
            return -lacking - max(loose, 0.0)
        return float(grip.slip_load(1.0))


def _distances(first: Array, second: Array) -> Array:
    """Return distances (…) [m] of points or segments (…, 1 or 2, 2) to segments (…, 2, 2)."""
    return length(shortest_offset(differences(first, second)))


def best_grip(task: GripTask) -> Grip:
    """Return the grip whose slip load is largest, within all limits, before it lifts anything.

    It is searched about the section's centroid: where the outline has its origin does not matter.

    Raises
    ------
    InfeasibleError: none was found; the violation is that of the nearest one.
    """
    centre = np.round(task.section.centroid, PLACES)
    outline = task.section.outline
    given = task
    if outline is not None and np.any(centre):
        task = replace(task, section=Section(outline - centre))
    starts = _starts(task)
    for iterations, kept in ((SCREENING, FINALISTS), (ITERATIONS, 1)):
        grips = [task.grip(_refined(task, start, iterations)) for start in starts]
        ranked = sorted(grips, key=task.merit, reverse=True)[:kept]
        starts = [each.vertices for each in ranked]
    (best,) = ranked
    if task.merit(best) <= 0.0:
        raise _no_grip(task, best)
    return given.grip(best.vertices + centre)


def _starts(task: GripTask) -> list[Array]:
    """Return polygons (n, 2) [m] around the section: turned evenly, and facing its sides."""
    core, n = task.section.core, task.robots
    symmetry = 2.0 * math.pi / n
    sides = task.section.sides[:, 1] - core
    facing = np.arctan2(sides[:, 0], -sides[:, 1])[np.argsort(-np.hypot(*sides.T), kind="stable")]
    even = 0.5 * math.pi - symmetry * np.arange(TURNS) / TURNS
    turns = even[:1] if len(core) == 1 else np.append(facing[:SMALLEST], even)
    _, first = np.unique(np.round(turns % symmetry, 6) % symmetry, return_index=True)
    centre, size = task.section.centroid, math.sqrt(task.section.area / math.pi)
    found = []
    for turn in turns[np.sort(first)]:
        angles = turn - symmetry * np.arange(n)
        out = np.column_stack([np.cos(angles), np.sin(angles)])
        on_rays = np.linspace(0.0, 3.0, 601)[:, None, None] * task.section.circumradius * out
        gaps = task.section.clearance(centre + on_rays)[0]
        for pair in OFFSETS if n % 2 == 0 else OFFSETS[:1]:
            first = np.argmax(gaps >= size * np.resize(pair, n), axis=0)
            found.append(centre + on_rays[first, np.arange(n)])
    return found


def _refined(task: GripTask, start: Array, iterations: int) -> Array:
    """Return the vertices (n, 2) [m] that sequential quadratic programs reach from a polygon.

    A disc has no moment, however it is gripped, and all turned grips of it are equal: there the
    third imbalance is how far vertices turn from where they start.
    """
    from scipy.optimize import minimize

    turning = None
    if len(task.section.core) == 1:
        away = start - task.section.centroid
        turning = (away[:, ::-1] * [-1.0, 1.0]).ravel() / np.linalg.norm(away)

    def smallest(margins: Array) -> Array:
        if margins.shape[-1] <= ALL:
            return margins
        return np.sort(np.partition(margins, SMALLEST - 1)[..., :SMALLEST])

    def values(x: Array) -> Array:
        """Return slip load, imbalances and margins (…, rows), by vertices x (…, 2 n) [m]."""
        grip = task.grip(x.reshape(*x.shape[:-1], *start.shape))
        margins = [smallest(each) for each in (*task.distances(grip).values(), grip.wraps.angles)]
        goal = grip.slip_load(1.0)[..., None] / task.tension
        unbalanced = grip.imbalance / task.tension
        if turning is not None:
            unbalanced[..., 2] = (x - start.ravel()) @ turning
        return np.concatenate([goal, unbalanced, *margins], axis=-1)

    @lru_cache(maxsize=1)
    def at(x: tuple[float, ...]) -> tuple[Array, Array]:
        """Return values (rows,) at vertices x (2 n,) [m], and their slopes by differences."""
        moves = STEP * np.eye(len(x))
        here, *around = values(
            np.asarray(x) + np.concatenate([np.zeros((1, len(x))), moves, -moves])
        )
        after, before = np.split(np.array(around), 2)
        return here, ((after - before) / (2.0 * STEP)).T

    def part(i: int, rows: Any, sign: float = 1.0, least: float = 0.0) -> Callable[[Array], Any]:
        return lambda x: sign * at(tuple(x))[i][rows] - least

    check_time()
    kinds = ("eq", slice(1, 4), 0.0), ("ineq", slice(4, None), KEPT)
    constraints: Any = [
        {"type": kind, "fun": part(0, rows, least=least), "jac": part(1, rows)}
        for kind, rows, least in kinds
    ]
    found = minimize(
        part(0, 0, -1.0),
        start.ravel(),
        method="SLSQP",
        jac=part(1, 0, -1.0),
        constraints=constraints,
        options={"maxiter": iterations, "ftol": 1e-7},
    )
    return np.asarray(found.x).reshape(start.shape)


def _no_grip(task: GripTask, nearest: Grip) -> InfeasibleError:
    """Return the refusal: what the nearest grip breaks most, or that it does not wrap."""
    margin, worst = task.shortest(nearest)
    name, ratio = (worst, 1.0 + margin) if margin < 0.0 else ("grip", 0.0)
    limit, unit = (1.0, "ratio") if name in {"grip", "separation"} else (task.limits[name], "m")
    cables = "shorter cables, whose legs do not meet" if name == "crossing" else "other cables"
    remedy = f"use {cables}, or a larger section, or rest it on a rim"
    if task.robots > 3:
        remedy += ", or use three cables"
    note = f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found"
    value = round(ratio * limit, PLACES)
    return InfeasibleError([Violation(name, value, limit, "min", unit, (), "", remedy)], note)


# The largest masses that are held.

RESOLUTION = 1e-7
"""[kg] Resolution of masses."""

ROUNDING = 1e-9
"""Margin below zero at which a limit is kept, as by the certificate: pulls may be at a limit."""

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

    It is 0 where the hold breaks a limit without a load.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that raises it."""
        if self.mass == 0.0 and self.binding not in SUGGESTED:
            return "use another number of robots, or cables of another length"
        return SUGGESTED.get(self.binding, "use longer cables")


CARRIED_AT = 1.0
"""[m/s²] Acceleration at which loads are carried at most."""


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
    stands = float(inside) - height * CARRIED_AT / GRAVITY  # of the force line while carried [m]
    unloaded = Team(n, cable_length, tension=tension, quadrotor=kind)
    legs = Hitch.spread(unloaded, polygon, limits=limits, separation=requirements.separation).q_legs

    def worst(mass: float) -> tuple[float, str]:
        """Return the smallest margin with a mass [kg], and the limit that it is of."""
        team = Team(n, cable_length, tension=tension, quadrotor=kind, load=mass / n)
        try:
            hitch = Hitch(team, polygon, 1.0, legs)
            thrusts = -hitch.cable_forces + [0.0, 0.0, GRAVITY * kind.mass]
        except InfeasibleError as error:
            return -1.0, error.violations[0].constraint
        tilt = np.arctan2(length(thrusts[:, :2]), thrusts[:, 2])
        task = LegTask(
            team, requirements, polygon.vertices[None], legs[None], limits.leg, LIMIT_MARGIN
        )
        found = {
            "thrust": 1.0 - float(np.max(length(thrusts))) / kind.max_thrust,
            "tilt": 1.0 - float(np.max(tilt)) / limits.tilt,
            "legs": float(np.min(hitch.legs)) / limits.leg - 1.0,
            "separation": reference_margin(task) - 1.0,
            "support": stands,
        }
        return min((margin, name) for name, margin in found.items())

    margin, name = worst(0.0)
    if margin < -ROUNDING:
        return Capacity(0.0, name)
    low, high = 0.0, 2.5 * n * tension / GRAVITY  # all legs upright bear less
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        margin, reason = worst(middle)
        if margin >= -ROUNDING:
            low = middle
        else:
            high, name = middle, reason
    return Capacity(low, name)


def largest_tension(requirements: Requirements, kind: Quadrotor) -> tuple[float, str]:
    """Return the largest level pull [N] that a drone can hold at rest, and the limit that binds."""
    weight = GRAVITY * kind.mass
    by_tilt = weight * math.tan(requirements.limits.tilt)
    by_thrust = math.sqrt(max(kind.max_thrust**2 - weight**2, 0.0))
    return (by_tilt, "tilt") if by_tilt <= by_thrust else (by_thrust, "thrust")


def grip_capacity(task: GripTask, grip: Grip, friction: float, factor: float) -> Capacity:
    """Return the largest mass [kg] that a grip lifts, by friction and thrust, and what binds.

    Every leg lifts the same share w of the weight and pulls with the tension T all the same, so
    that thrust is ``√(T² - w² + (m g + w)²)``. Slip load over load is at least ``factor``.
    """
    weight, legs = GRAVITY * task.kind.mass, 2.0 * task.robots
    spare = task.kind.max_thrust**2 - task.tension**2 - weight**2
    loads = {
        "grip": float(grip.slip_load(friction)) / factor,
        "thrust": legs * max(spare, 0.0) / (2.0 * weight),
    }
    binding = min(loads, key=lambda name: loads[name])
    return Capacity(loads[binding] / GRAVITY, binding)
