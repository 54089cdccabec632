"""Where clasps are around an object and where they hold it: polygons of grips and below rims.

``best_grip`` searches the polygon that grips hardest within all limits, by sequential quadratic
programs (SLSQP) from several polygons. The search is local: failure does not prove that there is
no grip. Its result is evaluated anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation, check_time
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.holding import Grip, turn
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Quadrotor
from hitchopt.objects import Section, SolidObject
from hitchopt.values import Array, Indices

UNSTRETCHED, STRETCHES = np.ones(1), np.geomspace(0.25, 4.0, 81)
"""Candidate proportions of the polygon around an object that rests, and around one that is gripped,
over those of the polygon that holds it."""


@dataclass(frozen=True, eq=False)
class HoldPolygons:
    """Clasps around an object and clasps that hold it, in its frame; one polygon is stretched.

    Attributes
    ----------
    around: (n, 2) [m], outside of all of the object.
    closed: (n, 2) [m], below its rim, or with edges that grip it.
    """

    around: Array
    closed: Array

    @classmethod
    def about(
        cls,
        closed: Array,
        centre: Array,
        sections: tuple[Section, ...],
        gap: float,
        stretches: Array = UNSTRETCHED,
    ) -> HoldPolygons:
        """Return a polygon, and that polygon stretched about a centre until it keeps off sections.

        Of the stretches along its axes the one with the shortest longest edge leaves the most cable
        to legs, which keeps drones apart.

        Parameters
        ----------
        closed: (n, 2) [m], clockwise, the centre (2,) [m] inside of it.
        gap: between edges and sections [m].
        stretches: candidate proportions, over the polygon's own.
        """
        away = closed - centre
        axes = np.linalg.eigh(away.T @ away)[1]
        polygons = []
        for wide in np.sqrt(stretches):
            there = away @ (axes * [wide, 1.0 / wide]) @ axes.T
            outward, reach = sides_of(there)
            needed = [each.support(outward) + gap - outward @ centre for each in sections]
            polygons.append(float(np.max(np.max(needed, axis=0) / reach)) * there)
        around = min(polygons, key=lambda each: float(np.max(length(np.roll(each, -1, 0) - each))))
        return cls(ConvexPolygon(centre + around).vertices, ConvexPolygon(closed).vertices)


def sides_of(polygon: Array) -> tuple[Array, Array]:
    """Return outward normals (…, n, 2) of a clockwise polygon's edges, and their offsets [m]."""
    onward = np.roll(polygon, -1, axis=-2) - polygon
    outward = unit(np.stack([-onward[..., 1], onward[..., 0]], axis=-1))
    return outward, np.sum(outward * polygon, axis=-1)


# Grips.

MIN_GAP = 0.02
"""[m] Smallest distance of a clasp to the section: two ropes bend around each other there."""

DIFFERENCE = 1e-6
"""[m] Step of central differences of margins."""

LIFT_MARGIN = 0.05
"""Margin of all distances, over their limits: lifting moves drones by less."""

MAX_IMBALANCE = 1e-6
"""Largest level force on the section over the tension, and moment over tension and size."""

SCREENING, ITERATIONS, FINALISTS = 12, 60, 2
"""Maximum quadratic programs from every start and from the finalists, and the number of these."""

MAX_ROWS, SMALLEST = 36, 6
"""Quadratic programs contain all margins of a kind up to so many, or else its smallest ones."""

START_GAPS = ((0.25, 0.25), (0.12, 0.4), (0.4, 0.12))
"""Distances of every other starting vertex to the section, and of those between, over its mean
radius; the first pair if they do not alternate."""

TURNS = 3
"""Starting polygons, turned by equal parts of their symmetry, besides those that face sides."""

DECIMALS = 12
"""Decimal places of centroids and reported ratios: rounding errors become zero."""


@dataclass(frozen=True, eq=False)
class GripTask:
    """The search of a grip.

    Attributes
    ----------
    section: to grip.
    robots: number n, all of one ``kind`` with cables of ``cable_length`` [m] and tension [N].
    clasp_friction: coefficient of cables on each other.
    requirements: distances to keep.
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
        """Return the margins (…, items) of all distances of a grip, over their limits.

        Keys are names of the certificate's checks, and ``gap``, of clasps to the section.
        """
        n, shape, contacts = self.robots, grip.vertices.shape[:-2], grip.wraps.contacts
        drones = grip.drones.reshape(*shape, 2 * n, 2)
        here, onward = grip.vertices, np.roll(grip.vertices, -1, axis=-2)
        starts = here, here, contacts[..., 1, :], onward  # q-legs, both tangents, r-legs
        ends = grip.drones[..., 0, :], contacts[..., 0, :], onward, grip.drones[..., 1, :]
        parts = np.stack([np.concatenate(each, axis=-2) for each in (starts, ends)], axis=-2)
        (one, two), (drone, near), (i, j) = _pairs(n)
        apart = length(drones[..., one, :] - drones[..., two, :])
        gaps = _distances(drones[..., drone, None, :], parts[..., near, :, :])
        crossing = _distances(parts[..., i, :, :], parts[..., j, :, :])
        clear = self.section.clearance
        distances = {
            "separation": apart,
            "cable_clearance": gaps,
            "crossing": crossing,
            "keep_out": clear(drones)[0],
            "legs": grip.legs.reshape(*shape, 2 * n),
            "gap": clear(grip.vertices)[0],
        }
        over = ((name, each, self.limits[name]) for name, each in distances.items())
        return {name: each / limit - 1.0 if limit else each for name, each, limit in over}

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
            "gap": MIN_GAP,
        }

    def shortest(self, grip: Grip) -> tuple[float, str]:
        """Return the smallest margin of all distances, and its name."""
        return min((float(np.min(each)), name) for name, each in self.distances(grip).items())

    def merit(self, grip: Grip) -> float:
        """Return the slip load over friction [N] of a grip, or minus its worst violation."""
        edges = np.roll(grip.vertices, -1, axis=0) - grip.vertices
        turns = turn(edges, np.roll(edges, -1, axis=0))
        if not np.all(turns < 0.0) or np.sum(turns) < -3.0 * math.pi:  # not once clockwise
            return -math.inf
        scale = np.array([1.0, 1.0, math.sqrt(self.section.area)]) * self.tension
        unbalanced = float(np.max(np.abs(grip.imbalance) / scale)) - MAX_IMBALANCE
        loose = -float(np.min(grip.wraps.angles))
        lacking = max(-self.shortest(grip)[0], unbalanced, 0.0)
        if lacking > 0.0 or loose >= 0.0:
            return -lacking - max(loose, 0.0)
        return float(grip.slip_load(1.0))


@lru_cache
def _pairs(n: int) -> tuple[Indices, Indices, Indices]:
    """Return the pairs (2, pairs) that keep off each other: drones, drones and parts, parts.

    All parts count for drones but the leg that ends at them.
    """
    k = np.arange(n)
    cable, clasp = np.tile(k, 4), np.concatenate([k, k, (k + 1) % n, (k + 1) % n])
    leg = np.repeat([True, False, False, True], n)
    near = np.nonzero(np.arange(4 * n) != np.column_stack([k, 3 * n + k]).reshape(-1, 1))
    i, j = np.triu_indices(4 * n, 1)
    both, own = leg[i] & leg[j], cable[i] == cable[j]
    crossing = (clasp[i] != clasp[j]) & (leg[i] | leg[j]) & (both | ~own)
    drones = np.stack(np.triu_indices(2 * n, 1))
    return drones, np.stack(near), np.stack([i[crossing], j[crossing]])


def _distances(first: Array, second: Array) -> Array:
    """Return distances (…) [m] of points or segments (…, 1 or 2, 2) to segments (…, 2, 2)."""
    return length(shortest_offset(differences(first, second)))


def best_grip(task: GripTask) -> Grip:
    """Return the grip with the largest slip load within all limits, before it lifts anything.

    The search is about the section's centroid: the outline's origin does not matter.

    Raises
    ------
    InfeasibleError: the search failed; the violation is that of the nearest grip.
    """
    centre = np.round(task.section.centroid, DECIMALS)
    outline = task.section.outline
    centred = task
    if outline is not None and np.any(centre):
        centred = replace(task, section=Section(outline - centre))
    starts = _starts(centred)
    for iterations, number in ((SCREENING, FINALISTS), (ITERATIONS, 1)):
        grips = [centred.grip(_refined(centred, start, iterations)) for start in starts]
        ranked = sorted(grips, key=centred.merit, reverse=True)[:number]
        starts = [each.vertices for each in ranked]
    (best,) = ranked
    if centred.merit(best) <= 0.0:
        raise _no_grip(centred, best)
    return task.grip(best.vertices + centre)


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
    starts = []
    for angle in turns[np.sort(first)]:
        angles = angle - symmetry * np.arange(n)
        out = np.column_stack([np.cos(angles), np.sin(angles)])
        on_rays = np.linspace(0.0, 3.0, 601)[:, None, None] * task.section.circumradius * out
        gaps = task.section.clearance(centre + on_rays)[0]
        for pair in START_GAPS if n % 2 == 0 else START_GAPS[:1]:
            first = np.argmax(gaps >= size * np.resize(pair, n), axis=0)
            starts.append(centre + on_rays[first, np.arange(n)])
    return starts


def _refined(task: GripTask, start: Array, iterations: int) -> Array:
    """Return the vertices (n, 2) [m] that sequential quadratic programs reach from a polygon.

    A disc has no moment in any grip, and all its turned grips are equal: its third imbalance is the
    turn of the vertices from their start.
    """
    from scipy.optimize import minimize

    turning = None
    if len(task.section.core) == 1:
        away = start - task.section.centroid
        turning = (away[:, ::-1] * [-1.0, 1.0]).ravel() / np.linalg.norm(away)

    def smallest(margins: Array) -> Array:
        if margins.shape[-1] <= MAX_ROWS:
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
    def at(x: tuple[float, ...]) -> Array:
        """Return values (rows,) at vertices x (2 n,) [m]."""
        return values(np.array(x))

    @lru_cache(maxsize=1)
    def slopes(x: tuple[float, ...]) -> Array:
        """Return the slopes (rows, 2 n) of values at vertices x (2 n,) [m], by differences."""
        moves = DIFFERENCE * np.eye(len(x))
        after, before = np.split(values(np.array(x) + np.concatenate([moves, -moves])), 2)
        return np.asarray((after - before).T / (2.0 * DIFFERENCE))

    def part(
        of: Callable[[tuple[float, ...]], Array], rows: Any, sign: float = 1.0, least: float = 0.0
    ) -> Callable[[Array], Any]:
        return lambda x: sign * of(tuple(x))[rows] - least

    check_time()
    kinds = ("eq", slice(1, 4), 0.0), ("ineq", slice(4, None), LIFT_MARGIN)
    constraints: Any = [
        {"type": kind, "fun": part(at, rows, least=least), "jac": part(slopes, rows)}
        for kind, rows, least in kinds
    ]
    found = minimize(
        part(at, 0, -1.0),
        start.ravel(),
        method="SLSQP",
        jac=part(slopes, 0, -1.0),
        constraints=constraints,
        options={"maxiter": iterations, "ftol": 1e-7},
    )
    return np.asarray(found.x).reshape(start.shape)


def _no_grip(task: GripTask, nearest: Grip) -> InfeasibleError:
    """Return the error of the limit that the nearest grip breaks most, or that it does not wrap."""
    margin, worst = task.shortest(nearest)
    name, ratio = (worst, 1.0 + margin) if margin < 0.0 else ("grip", 0.0)
    limit, unit = (1.0, "ratio") if name in {"grip", "separation"} else (task.limits[name], "m")
    cables = "shorter cables, whose legs do not meet" if name == "crossing" else "other cables"
    remedy = f"use {cables}, or a larger section, or rest it on a rim"
    if task.robots > 3:
        remedy += ", or use three cables"
    note = f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found"
    value = round(ratio * limit, DECIMALS)
    return InfeasibleError([Violation(name, value, limit, "min", unit, (), "", remedy)], note)


SEARCH_PULL = 0.9
"""Pull of the search over the largest level pull: polygons do not depend on it."""


def grip_polygons(
    name: str, body: SolidObject, team: Team, requirements: Requirements, gap: float
) -> HoldPolygons:
    """Return the polygons of the grip with the largest slip load.

    Parameters
    ----------
    name, body: the object.
    gap: distance of the edges around it [m].

    Raises
    ------
    InputError: cables or drones that differ.
    InfeasibleError: the search of a grip failed.
    """
    for key, values in (("cable_length", team.cable_length), ("quadrotor", team.quadrotor)):
        if len(set(values)) > 1:
            bound = "equal for all robots if they grip an object"
            raise InputError(f"team.{key}", list(values), bound, "use one kind")
    drone, cable = team.quadrotor[0], float(team.cable_length[0])
    pull = SEARCH_PULL * drone.level_pull(requirements.limits.tilt)[0]
    friction, section = team.cable_friction, body.section
    task = GripTask(section, team.robots, cable, pull, friction, requirements, drone)
    try:
        closed = best_grip(task).vertices
    except InfeasibleError as error:
        words = f"around objects.{name}"
        raise InfeasibleError([replace(v, when=words) for v in error.violations]) from None
    return HoldPolygons.about(closed, body.centre_of_mass[:2], (body.section,), gap, STRETCHES)


# Rests.

ROOM = 0.045
"""[m] Reserve of distances to an object: 25 mm, the largest observed error of edges, and 20 mm for
the error of the object's place."""

INSET, MIN_INSET = 0.05, 0.01
"""[m] Sufficient and smallest distance of clasps inside of a rim, and of edges off the body."""

ANGLES, ASPECTS = 12, 17
"""Numbers of candidate orientations and proportions."""

SHRINKS = np.linspace(0.05, 1.0, 96)
"""Candidate sizes of a polygon below a rim, over the rim's own."""


def rest_polygons(name: str, body: SolidObject, robots: int, gap: float) -> HoldPolygons:
    """Return the polygons of a hitch below an object's rim.

    Candidates are regular polygons about the centre of mass, turned, and stretched along the rim's
    axes. Chosen is the one with clasps farthest inside of the rim and edges farthest off the body;
    of those with INSET to both the one with the widest support.

    Parameters
    ----------
    name, body: the object; it has a rim.
    robots: number of vertices.
    gap: distance of the edges around it [m].

    Raises
    ------
    InfeasibleError: no polygon fits between body and rim.
    """
    assert body.rim is not None
    rim, centre = body.rim.section, body.centre_of_mass[:2]
    frame, size = _axes(rim)
    angles = 2.0 * math.pi / robots * np.arange(ANGLES) / ANGLES
    corners = angles[:, None] - 2.0 * math.pi * np.arange(robots) / robots
    regular = math.sqrt(2.0) * np.stack([np.cos(corners), np.sin(corners)], axis=-1)
    wide = np.geomspace(0.5, 2.0, ASPECTS)[:, None, None] ** [0.5, -0.5]
    shapes = (regular[:, None] * wide).reshape(-1, robots, 2)
    places = (shapes[:, None] * SHRINKS[:, None, None] * size) @ frame.T + centre
    inside = -np.max(rim.clearance(places)[0], axis=-1)
    outward, offsets = sides_of(places)
    width = np.min(offsets - outward @ centre, axis=-1)
    inset = np.minimum(inside, INSET)
    if body.stem is not None:
        inset = np.minimum(inset, np.min(offsets - body.stem.support(outward), axis=-1))
    best = np.unravel_index(int(np.argmax(inset + 1e-3 * width)), inset.shape)
    if inset[best] < MIN_INSET:
        value, when = float(inset[best]), "below the rim of the object"
        remedy = (
            f"give objects.{name} a wider rim, or use another number of robots: `hitchopt fit` "
            "tells with which its outline is held"
        )
        raise InfeasibleError(
            [Violation("support", value, MIN_INSET, "min", "m", (name,), when, remedy)]
        )
    return HoldPolygons.about(places[best], centre, (rim, body.section), gap)


def _axes(section: Section) -> tuple[Array, Array]:
    """Return the axes (2, 2) of a section as columns, and half of its widths along them [m]."""
    core = section.core
    if len(core) < 3:
        return np.eye(2), np.full(2, section.rounding)
    sides = unit(np.roll(core, -1, axis=0) - core)
    turned = np.stack([sides, np.stack([-sides[:, 1], sides[:, 0]], axis=1)], axis=2)
    widths = np.ptp(np.einsum("pd,sdi->spi", core, turned), axis=1)  # (sides, 2)
    best = int(np.argmin(np.prod(widths, axis=1)))
    return turned[best], 0.5 * widths[best]
