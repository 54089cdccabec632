"""A hitch that grips a section, seen from above: wrapped edges, clasps in balance, drones.

Clasps are outside of the section. At clasp k the edges' unit vectors ``b_{k-1}``, arriving, and
``a_k``, leaving, pull with ``V_k = T (b_{k-1} - a_k)``; with one tension everywhere legs lie along
the neighbours' edges, ``q̂_k = b_{k-1}`` and ``r̂_{k-1} = -a_k``.

``best_grip`` looks for the polygon that grips hardest within all limits. The search is local, by
sequential quadratic programs (SLSQP) from several polygons: failure does not prove that there is
no grip. What it returns is measured anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation, check_time
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import length
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.holding.capacity import Capacity
from hitchopt.holding.wraps import Wraps, wraps_around
from hitchopt.objects import Section
from hitchopt.values import Array


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
        return {
            name: found[name] / limit - 1.0 if limit else found[name]
            for name, limit in self.limits.items()
        }

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
        found = [_refined(task, start, iterations) for start in starts]
        grips = [task.grip(each) for each in found if _turns_once(each)]
        ranked = sorted(grips, key=task.merit, reverse=True)[:kept]
        starts = [each.vertices for each in ranked]
    if not ranked or task.merit(ranked[0]) <= 0.0:
        raise _no_grip(task, ranked)
    return given.grip(ranked[0].vertices + centre)


def _turns_once(vertices: Array) -> bool:
    """Return whether a polygon (n, 2) turns right at all vertices, once around in all."""
    try:
        ConvexPolygon(vertices)
    except InputError:
        return False
    return True


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
    """Return the vertices (n, 2) [m] that sequential quadratic programs reach from a polygon."""
    from scipy.optimize import minimize

    values = _program(task, start)
    known: dict[bytes, tuple[Array, Array]] = {}

    def at(x: Array) -> tuple[Array, Array]:
        """Return values (rows,) at vertices x (2 n,) [m], and their slopes by differences."""
        if x.tobytes() not in known:
            moves = STEP * np.eye(x.size)
            here, *around = values(x + np.concatenate([np.zeros((1, x.size)), moves, -moves]))
            known.clear()
            after, before = np.split(np.array(around), 2)
            known[x.tobytes()] = here, ((after - before) / (2.0 * STEP)).T
        return known[x.tobytes()]

    check_time()
    rows = [("eq", slice(1, 4), 0.0), ("ineq", slice(4, None), KEPT)]
    constraints: list[Any] = [
        {
            "type": kind,
            "fun": lambda x, part=part, least=least: at(x)[0][part] - least,
            "jac": lambda x, part=part: at(x)[1][part],
        }
        for kind, part, least in rows
    ]
    options: Any = {"maxiter": iterations, "ftol": 1e-7}

    def lost(x: Array) -> Any:
        return -float(at(x)[0][0]), -at(x)[1][0]

    given: Any = {"jac": True, "constraints": constraints, "options": options}
    found = minimize(lost, start.ravel(), method="SLSQP", **given)
    return np.asarray(found.x).reshape(start.shape)


def _program(task: GripTask, start: Array) -> Callable[[Array], Array]:
    """Return slip load, imbalances and smallest margins (…, rows), by vertices (…, 2 n) [m].

    A disc has no moment, however it is gripped, and all turned grips of it are equal: there the
    third imbalance is how far vertices turn from where they start.
    """
    turning = None
    if len(task.section.core) == 1:
        x, y = (start - task.section.centroid).T
        turning = np.column_stack([-y, x]).ravel() / math.hypot(*x, *y)

    def smallest(margins: Array) -> Array:
        if margins.shape[-1] <= ALL:
            return margins
        return np.sort(np.partition(margins, SMALLEST - 1)[..., :SMALLEST])

    def values(x: Array) -> Array:
        grip = task.grip(x.reshape(*x.shape[:-1], *start.shape))
        kept = [smallest(each) for each in (*task.distances(grip).values(), grip.wraps.angles)]
        goal = grip.slip_load(1.0)[..., None] / task.tension
        unbalanced = grip.imbalance / task.tension
        if turning is not None:
            unbalanced[..., 2] = (x - start.ravel()) @ turning
        return np.concatenate([goal, unbalanced, *kept], axis=-1)

    return values


def _no_grip(task: GripTask, nearest: list[Grip]) -> InfeasibleError:
    """Return the refusal: what the nearest grip breaks most, or that it does not wrap."""
    name, ratio = "grip", 0.0
    for grip in nearest:
        margin, worst = task.shortest(grip)
        if margin < 0.0:
            name, ratio = worst, 1.0 + margin
    limit, unit = (1.0, "ratio") if name in {"grip", "separation"} else (task.limits[name], "m")
    cables = "shorter cables, whose legs do not meet" if name == "crossing" else "other cables"
    remedy = f"use {cables}, or a larger section, or rest it on a rim"
    if task.robots > 3:
        remedy += ", or use three cables"
    note = f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found"
    value = round(ratio * limit, PLACES)
    return InfeasibleError([Violation(name, value, limit, "min", unit, (), "", remedy)], note)
