"""Polygons of clasps around an object and of its hold: grips and rests below rims.

``grips`` maximises the slip load within all limits by sequential quadratic programming (SLSQP)
from several initial guesses. The search is local: failure does not prove infeasibility. Its result
is evaluated independently.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from hitchopt.carrying.holding import Grip
from hitchopt.drones.quadrotor import Quadrotor
from hitchopt.errors import (
    InfeasibleError,
    Reason,
    RequestError,
    Violation,
    check_time,
    violations_at,
)
from hitchopt.geometry import ConvexPolygon, differences, shortest_offset
from hitchopt.geometry.vectors import left_of, length, turn, unit
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import Section, SolidObject
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array, Indices

REST_STRETCHES = np.ones(1)
"""Candidate aspect ratio of the polygon around an object that is to rest on clasps, over that of
the polygon that holds it."""

GRIP_STRETCHES = np.geomspace(0.25, 4.0, 81)  # The same ratios for grips


@dataclass(frozen=True, eq=False)
class HoldPolygons:
    """Clasps around an object and clasps that hold it, in its frame."""

    around: Array  # (n, 2) [m], clear of the object
    clasps: Array  # (n, 2) [m], below its rim, or with edges that grip it
    # (n, 2) [m] each, below its rim, nearer to the rim's edge where legs may rise more steeply
    outer: tuple[Array, ...] = ()

    @property
    def below_rim(self) -> tuple[Array, ...]:
        """Candidate clasps (n, 2) [m] below the rim, in order of preference."""
        return self.clasps, *self.outer

    @classmethod
    def about(
        cls,
        clasps: Array,
        centre: Array,
        sections: tuple[Section, ...],
        gap: float,
        stretches: Array = REST_STRETCHES,
    ) -> HoldPolygons:
        """Return a polygon and its scaled copy around sections.

        The copy is stretched along its axes so that its longest edge is smallest.

        Parameters
        ----------
        clasps: (n, 2) [m], clockwise.
        centre: (2,) [m], inside of it.
        sections: to be enclosed.
        gap: between edges and sections [m].
        stretches: candidate aspect ratios, over the polygon's own.
        """
        offsets = clasps - centre
        _, axes = np.linalg.eigh(offsets.T @ offsets)
        polygons = list[Array]()
        longest_edges = list[float]()
        for width in np.sqrt(stretches):
            stretched = offsets @ (axes * [width, 1.0 / width]) @ axes.T
            outward, distances = sides_of(stretched)
            required = [section.support(outward) + gap - outward @ centre for section in sections]
            scale = float(np.max(np.max(required, axis=0) / distances))
            polygons.append(scale * stretched)
            edges = np.roll(polygons[-1], -1, axis=0) - polygons[-1]
            longest_edges.append(float(np.max(length(edges))))
        around = polygons[int(np.argmin(longest_edges))]
        return cls(ConvexPolygon(centre + around).vertices, ConvexPolygon(clasps).vertices)


def sides_of(polygon: Array) -> tuple[Array, Array]:
    """Return outward normals (…, n, 2) of a clockwise polygon's edges, and their offsets [m]."""
    onward = np.roll(polygon, -1, axis=-2) - polygon
    outward = unit(left_of(onward))
    return outward, np.sum(outward * polygon, axis=-1)


# Grips.

MIN_GAP = 0.02
"""[m] Minimum distance of a clasp, where two ropes bend around each other, to the section."""

MIN_STRAIGHT = 0.05
"""[m] Minimum length of straight parts of edges around corners: clasps beside a corner that are off
by 2 cm bend edges about another one."""

YAW_RESERVES = (0.15, 0.0)
"""Stiffnesses of yaw over tension and size, in order of preference. Ropes 18 mm thick, with which
crates are larger, turned one of 0.05 by 30° in simulation."""

DIFFERENCE_STEP = 1e-6  # [m] Step of central differences of margins

LIFT_MARGIN = 0.05
"""Margin of all distances over their limits, which exceeds the changes by lifting."""

MAX_IMBALANCE = 1e-6
"""Largest horizontal force on the section over the tension, and moment over tension and size."""

SCREENING_ITERATIONS = 12  # Maximum number of iterations from every guess
FINALISTS = 3  # Number of best grips that are refined further: mirror images, and another one
MAX_ITERATIONS = 60  # Maximum number of iterations from the finalists
MERIT_TOLERANCE = 1e-7  # Change of the slip load over the tension at which a refinement ends
MAX_ROWS = 36  # Largest number of margins of a kind in a quadratic program
REDUCED_ROWS = 6  # Number of the smallest margins of a kind that has more than MAX_ROWS

GUESS_GAPS = ((0.25, 0.25), (0.12, 0.4), (0.4, 0.12))
"""Pairs of distances of a guess's vertices to the section, over its mean radius, which alternate
along the vertices; for odd numbers of vertices only the first pair, whose distances are equal."""

EVEN_GUESSES = 3  # Number of guesses turned by equal parts of their symmetry
MAX_ALIGNED_GUESSES = 6  # Largest number of guesses aligned with sides
DECIMALS = 12  # Decimal places of centroids and reported ratios, which round errors to zero


class ClearancePairs(NamedTuple):
    """Pairs of the bodies of a grip that need clearance: n cables, 2n drones, 4n straight parts.

    Drones are ``q_0, r_0, q_1, …``. Parts are all q-legs, then all tangents at ``p_k``, all
    tangents at ``p_{k+1}`` and all r-legs.
    """

    drones: Indices  # (2, pairs): two drones
    drones_with_parts: Indices  # (2, pairs): a drone, and a part other than the leg that ends at it
    parts: Indices  # (2, pairs): two parts


@dataclass(frozen=True, eq=False)
class GripTask:
    """The problem of a grip."""

    section: Section  # The section to grip
    robots: int  # Number n of robots
    cable_length: float  # Length of all cables [m]
    tension: float  # Tension of all cables [N]
    clasp_friction: float  # Friction coefficient between cables
    requirements: Requirements  # Distances to be kept
    kind: Quadrotor  # Kind of all quadrotors
    yaw_reserve: float = YAW_RESERVES[0]  # Smallest stiffness of yaw over tension and size

    def grip(self, vertices: Array) -> Grip:
        """Return the grip with vertices (…, n, 2) [m]."""
        return Grip.of(self.section, vertices, self.cable_length, self.tension, self.clasp_friction)

    def distances(self, grip: Grip) -> dict[str, Array]:
        """Return the relative margins (…, items) of all distances of a grip.

        Keys are names of the certificate's checks, ``gap``, of clasps to the section, and ``bend``,
        of straight parts. That of ``yaw`` is a stiffness over tension and size.
        """
        shape = grip.vertices.shape[:-2]
        drones = grip.drones.reshape(*shape, 2 * self.robots, 2)
        parts = _straight_parts(grip)
        pairs = _clearance_pairs(self.robots)
        first_drone, second_drone = pairs.drones
        drone, part = pairs.drones_with_parts
        first_part, second_part = pairs.parts
        clearance = self.section.clearance
        distances = {
            "separation": length(drones[..., first_drone, :] - drones[..., second_drone, :]),
            "cable_clearance": _distances(drones[..., drone, None, :], parts[..., part, :, :]),
            "crossing": _distances(parts[..., first_part, :, :], parts[..., second_part, :, :]),
            "keep_out": clearance(drones)[0],
            "legs": grip.legs.reshape(*shape, 2 * self.robots),
            "gap": clearance(grip.vertices)[0],
        }
        if self.section.radius is None:
            size = self.section.circumradius
            distances["bend"] = length(grip.straight_parts).reshape(*shape, 2 * self.robots)
            stiffness = grip.yaw_stiffness[..., None] / (self.tension * size)
            distances["yaw"] = stiffness - self.yaw_reserve
        limits = self.limits
        margins = {}
        for name, values in distances.items():
            limit = limits[name]
            margins[name] = values / limit - 1.0 if limit else values
        return margins

    @property
    def limits(self) -> dict[str, float]:
        """Limits of all distances by name [m]."""
        separation = self.requirements.separation
        return {
            "separation": 2.0 * separation.radius,
            "cable_clearance": separation.cable,
            "crossing": separation.crossing,
            "keep_out": separation.radius,
            "legs": self.requirements.limits.leg,
            "gap": MIN_GAP,
            "bend": MIN_STRAIGHT,
            "yaw": 0.0,
        }

    def shortest(self, grip: Grip) -> tuple[float, str]:
        """Return the smallest margin of all distances, and its name."""
        margins = self.distances(grip)
        return min((float(np.min(values)), name) for name, values in margins.items())

    def merit(self, grip: Grip) -> float:
        """Return the slip load over friction [N] of a grip, or minus its largest violation."""
        if not _is_single_turn(grip.vertices):
            return -math.inf
        size = math.sqrt(self.section.area)
        scale = np.array([1.0, 1.0, size]) * self.tension
        imbalance = float(np.max(np.abs(grip.imbalance) / scale)) - MAX_IMBALANCE
        shortest, _ = self.shortest(grip)
        unwrapped = -float(np.min(grip.wraps.angles))
        violation = max(-shortest, imbalance, 0.0)
        if violation > 0.0 or unwrapped >= 0.0:
            return -violation - max(unwrapped, 0.0)
        return float(grip.slip_load(1.0))


def _is_single_turn(vertices: Array) -> bool:
    """Return whether a polygon (n, 2) [m] turns right at all vertices, once altogether."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    turns = turn(edges, np.roll(edges, -1, axis=0))
    return bool(np.all(turns < 0.0) and np.sum(turns) >= -3.0 * math.pi)


def _straight_parts(grip: Grip) -> Array:
    """Return the straight parts (…, 4n, 2, 2) [m] of cables, in the order of ClearancePairs."""
    vertices = grip.vertices
    next_vertices = np.roll(vertices, -1, axis=-2)
    contacts = grip.wraps.contacts
    q_legs = np.stack([vertices, grip.drones[..., 0, :]], axis=-2)
    leaving = np.stack([vertices, contacts[..., 0, :]], axis=-2)
    arriving = np.stack([contacts[..., 1, :], next_vertices], axis=-2)
    r_legs = np.stack([next_vertices, grip.drones[..., 1, :]], axis=-2)
    return np.concatenate([q_legs, leaving, arriving, r_legs], axis=-3)


@lru_cache
def _clearance_pairs(n: int) -> ClearancePairs:
    """Return the pairs of a grip of n cables that need clearance."""
    k = np.arange(n)
    cable = np.tile(k, 4)
    clasp = np.concatenate([k, k, (k + 1) % n, (k + 1) % n])
    is_leg = np.repeat([True, False, False, True], n)

    leg_of_drone = np.column_stack([k, 3 * n + k]).reshape(-1, 1)
    drones_with_parts = np.nonzero(np.arange(4 * n) != leg_of_drone)

    i, j = np.triu_indices(4 * n, 1)
    are_legs = is_leg[i] & is_leg[j]
    has_leg = is_leg[i] | is_leg[j]
    of_two_clasps = clasp[i] != clasp[j]
    of_two_cables = cable[i] != cable[j]
    may_cross = of_two_clasps & has_leg & (are_legs | of_two_cables)
    return ClearancePairs(
        drones=np.stack(np.triu_indices(2 * n, 1)),
        drones_with_parts=np.stack(drones_with_parts),
        parts=np.stack([i[may_cross], j[may_cross]]),
    )


def _distances(first: Array, second: Array) -> Array:
    """Return distances (…) [m] of points or segments (…, 1 or 2, 2) to segments (…, 2, 2)."""
    return length(shortest_offset(differences(first, second)))


def grips(task: GripTask) -> Iterator[Grip]:
    """Yield unloaded grips within all limits: the one with the largest slip load, then the others.

    These bend about other corners, as the best ones that do. Coordinates of the search are relative
    to the section's centroid.

    Raises
    ------
    InfeasibleError: the search failed; the violation is that of the grip nearest to feasible.
    """
    centre = np.round(task.section.centroid, DECIMALS)
    outline = task.section.outline
    centred = task
    if outline is not None and np.any(centre):
        centred = replace(task, section=Section(outline - centre))
    for reserve in YAW_RESERVES:
        centred = replace(centred, yaw_reserve=reserve)
        screened = _best_refined(centred, _guesses(centred), SCREENING_ITERATIONS)
        finalists = [grip.vertices for grip in screened[:FINALISTS]]
        best = _best_refined(centred, finalists, MAX_ITERATIONS)[0]
        if centred.merit(best) <= 0.0:
            if centred.shortest(best)[1] != "yaw":
                break
            continue
        yield task.grip(best.vertices + centre)
        bent = {_corners(best)}
        for grip in screened:
            if _corners(grip) not in bent:
                (other,) = _best_refined(centred, [grip.vertices], MAX_ITERATIONS)
                if centred.merit(other) > 0.0 and _corners(other) not in bent:
                    yield task.grip(other.vertices + centre)
                bent |= {_corners(grip), _corners(other)}
        return
    raise _no_grip(centred, best)


def _corners(grip: Grip) -> frozenset[tuple[int, ...]]:
    """Return the corners about which edges bend, for edges in any order."""
    return frozenset(tuple(corners) for corners in grip.wraps.bends.corners.tolist())


def _best_refined(task: GripTask, guesses: list[Array], iterations: int) -> list[Grip]:
    """Return the grips that are reached from guesses (n, 2) [m], the best first."""
    grips = [task.grip(_refined(task, guess, iterations)) for guess in guesses]
    return sorted(grips, key=task.merit, reverse=True)


def _guesses(task: GripTask) -> list[Array]:
    """Return polygons (n, 2) [m] around the section: evenly turned, and aligned with its sides."""
    section = task.section
    n = task.robots
    symmetry = 2.0 * math.pi / n
    size = math.sqrt(section.area / math.pi)
    gap_pairs = GUESS_GAPS if n % 2 == 0 else GUESS_GAPS[:1]
    distances = np.linspace(0.0, 3.0, 601)[:, None, None] * section.circumradius
    guesses = []
    for angle in _guessed_angles(section, symmetry):
        angles = angle - symmetry * np.arange(n)
        outward = np.column_stack([np.cos(angles), np.sin(angles)])
        rays = distances * outward
        gaps = section.clearance(section.centroid + rays)[0]
        for gap_pair in gap_pairs:
            needed = size * np.resize(gap_pair, n)
            first = np.argmax(gaps >= needed, axis=0)
            guesses.append(section.centroid + rays[first, np.arange(n)])
    return guesses


def _guessed_angles(section: Section, symmetry: float) -> Array:
    """Return distinct angles [rad] of first vertices: aligned with long sides, and even ones."""
    even = 0.5 * math.pi - symmetry * np.arange(EVEN_GUESSES) / EVEN_GUESSES
    core = section.core
    if len(core) == 1:
        angles = even[:1]
    else:
        sides = section.sides[:, 1] - core
        longest_first = np.argsort(-np.hypot(*sides.T), kind="stable")
        aligned = np.arctan2(sides[:, 0], -sides[:, 1])[longest_first]
        angles = np.append(aligned[:MAX_ALIGNED_GUESSES], even)
    rounded = np.round(angles % symmetry, 6) % symmetry
    _, first = np.unique(rounded, return_index=True)
    return np.asarray(angles[np.sort(first)])


def _refined(task: GripTask, guess: Array, iterations: int) -> Array:
    """Return the vertices (n, 2) [m] that sequential quadratic programming reaches from a guess.

    Since grips of a disc have no moment and may be turned, its third equation is zero rotation of
    the vertices from the guess instead.
    """
    from scipy.optimize import minimize

    is_disc = len(task.section.core) == 1
    rotation = np.zeros(guess.size)
    if is_disc:
        offsets = guess - task.section.centroid
        rotation = (offsets[:, ::-1] * [-1.0, 1.0]).ravel() / np.linalg.norm(offsets)

    def smallest(margins: Array) -> Array:
        """Return margins (…, items), of many items only the smallest in ascending order."""
        if margins.shape[-1] <= MAX_ROWS:
            return margins
        return np.sort(np.partition(margins, REDUCED_ROWS - 1)[..., :REDUCED_ROWS])

    def values(flat: Array) -> Array:
        """Return slip load, imbalances and margins (…, rows) at vertices (…, 2 n) [m]."""
        grip = task.grip(flat.reshape(*flat.shape[:-1], *guess.shape))
        objective = (grip.slip_load(1.0) / task.tension)[..., None]
        imbalance = grip.imbalance / task.tension
        if is_disc:
            imbalance[..., 2] = (flat - guess.ravel()) @ rotation
        kinds = [*task.distances(grip).values(), grip.wraps.angles]
        margins = [smallest(kind) for kind in kinds]
        return np.concatenate([objective, imbalance, *margins], axis=-1)

    @lru_cache(maxsize=1)
    def at(flat: tuple[float, ...]) -> Array:
        """Return values (rows,) at vertices (2 n,) [m]."""
        return values(np.array(flat))

    @lru_cache(maxsize=1)
    def jacobian(flat: tuple[float, ...]) -> Array:
        """Return the Jacobian (rows, 2 n) of values at vertices (2 n,) [m], by differences."""
        moves = DIFFERENCE_STEP * np.eye(len(flat))
        both = np.concatenate([moves, -moves])
        after, before = np.split(values(np.array(flat) + both), 2)
        return np.asarray((after - before).T / (2.0 * DIFFERENCE_STEP))

    def cost(flat: Array) -> float:
        """Return minus the slip load over the tension [1]."""
        return -float(at(tuple(flat))[0])

    def gradient(flat: Array) -> Array:
        """Return the gradient (2 n,) [1/m] of the cost."""
        return np.asarray(-jacobian(tuple(flat))[0])

    imbalances = slice(1, 4)
    margins = slice(4, None)
    is_balanced = {
        "type": "eq",
        "fun": lambda flat: at(tuple(flat))[imbalances],
        "jac": lambda flat: jacobian(tuple(flat))[imbalances],
    }
    is_clear = {
        "type": "ineq",
        "fun": lambda flat: at(tuple(flat))[margins] - LIFT_MARGIN,
        "jac": lambda flat: jacobian(tuple(flat))[margins],
    }
    constraints: Any = [is_balanced, is_clear]
    check_time()
    result = minimize(
        cost,
        guess.ravel(),
        method="SLSQP",
        jac=gradient,
        constraints=constraints,
        options={"maxiter": iterations, "ftol": MERIT_TOLERANCE},
    )
    return np.asarray(result.x).reshape(guess.shape)


def _no_grip(task: GripTask, nearest: Grip) -> InfeasibleError:
    """Return the error of the limit that the nearest grip violates most, or of its wraps."""
    margin, worst = task.shortest(nearest)
    name, ratio = (worst, 1.0 + margin) if margin < 0.0 else ("grip", 0.0)
    limit, unit = (1.0, "ratio") if name in {"grip", "separation"} else (task.limits[name], "m")
    value = round(ratio * limit, DECIMALS)
    if name == "yaw":
        value, unit = float(nearest.yaw_stiffness), "N·m"
    remedy = (
        f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found: the best attempt "
        "misses this limit"
    )
    return InfeasibleError([Violation(name, value, limit, "min", unit, (), "", remedy)])


SEARCH_TENSION_RATIO = 0.9
"""Tension of the search over the largest horizontal pull; polygons do not depend on it."""


def grip_polygons(
    name: str, body: SolidObject, team: Team, requirements: Requirements, gap: float
) -> HoldPolygons:
    """Return the polygons of the grip with the largest slip load.

    Errors are those of ``grip_clasps``.

    Parameters
    ----------
    name, body: the object.
    gap: distance of the edges around it [m].
    """
    clasps = next(grip_clasps(name, body, team, requirements))
    centre, section = body.centre_of_mass[:2], body.section
    return HoldPolygons.about(clasps, centre, (section,), gap, GRIP_STRETCHES)


def grip_clasps(
    name: str, body: SolidObject, team: Team, requirements: Requirements
) -> Iterator[Array]:
    """Yield the clasps (n, 2) [m] of ``grips`` of an object, the strongest first.

    Raises
    ------
    InputError: cables or drones that differ.
    InfeasibleError: the search of a grip failed.
    """
    kinds = [kind.uncalibrated for kind in team.quadrotor]
    for key, values in (("cable_length", team.cable_length), ("quadrotor", kinds)):
        if len(set(values)) > 1:
            feature, neighbour = Feature.GRIPPING, Neighbour.UNEQUAL_KINDS
            raise refused_value(feature, neighbour, list(values), RequestError, name=key)
    drone, cable = kinds[0], float(team.cable_length[0])
    tension = SEARCH_TENSION_RATIO * drone.level_pull(requirements.limits.tilt)[0]
    friction, section = team.friction, body.section
    task = GripTask(section, team.robots, cable, tension, friction, requirements, drone)
    with violations_at(f"around objects.{name}", object=name, reason=Reason.NO_GRIP):
        yield from (grip.vertices for grip in grips(task))


# Rests.

EDGE_MARGIN = 0.045
"""[m] Margin of edges' distances to an object: 25 mm for the largest observed error of edges, and
20 mm for the position error of the object."""

SUFFICIENT_INSET = 0.05
"""[m] Sufficient distance of clasps to the rim's outline, and of edges to the body."""

MIN_INSET = 0.01  # [m] Minimum of these distances

OUTER_INSET = 0.02
"""[m] Sufficient distance where none with a SUFFICIENT_INSET holds: legs may rise more steeply
near the rim's edge without cutting it."""

WIDTH_WEIGHT = 1e-3  # Weight of a support's width against an inset
ANGLES = 12  # Number of candidate orientations
ASPECTS = 17  # Number of candidate aspect ratios
SIZES = np.linspace(0.05, 1.0, 96)  # Candidate sizes of a polygon below a rim, over the rim's own


class RestCandidates(NamedTuple):
    """Candidate polygons of clasps below a rim, by orientation, and what they are compared by."""

    polygons: Array  # (angles, candidates, n, 2) [m]
    insets: Array
    """(angles, candidates) [m], smaller distance of clasps to the rim's outline and of edges to the
    body."""

    widths: Array  # (angles, candidates) [m], smallest distance of the centre of mass to an edge
    # (angles, candidates) [m], largest length of a leg below the rim; inf without a MIN_INSET
    longest: Array

    @classmethod
    def of(cls, body: SolidObject, rim: Section, robots: int) -> RestCandidates:
        """Return the regular polygons about the centre of mass, turned and stretched."""
        centre = body.centre_of_mass[:2]
        frame, size = _axes(rim)
        # Regular polygons (ANGLES, n, 2), and these stretched by aspects (ASPECTS, 1, 2)
        orientations = 2.0 * math.pi / robots * np.arange(ANGLES) / ANGLES
        corners = orientations[:, None] - 2.0 * math.pi * np.arange(robots) / robots
        regular = math.sqrt(2.0) * np.stack([np.cos(corners), np.sin(corners)], axis=-1)
        aspects = np.geomspace(0.5, 2.0, ASPECTS)[:, None, None] ** [0.5, -0.5]
        shapes = (regular[:, None] * aspects).reshape(-1, robots, 2)

        # All shapes in all sizes (ANGLES ASPECTS, sizes, n, 2), along the axes of the rim
        polygons = (shapes[:, None] * SIZES[:, None, None] * size) @ frame.T + centre
        outward, offsets = sides_of(polygons)
        widths = np.min(offsets - outward @ centre, axis=-1)
        insets = -np.max(rim.clearance(polygons)[0], axis=-1)
        if body.stem is not None:
            of_edges = np.min(offsets - body.stem.support(outward), axis=-1)
            insets = np.minimum(insets, of_edges)
        longest = np.where(insets >= MIN_INSET, _longest_below(rim, polygons), np.inf)

        return cls(
            polygons.reshape(ANGLES, -1, robots, 2),
            insets.reshape(ANGLES, -1),
            widths.reshape(ANGLES, -1),
            longest.reshape(ANGLES, -1),
        )

    def merits(self, sufficient: float) -> Array:
        """Return merits (angles, candidates): the inset up to a sufficient one, then the width."""
        return np.asarray(np.minimum(self.insets, sufficient) + WIDTH_WEIGHT * self.widths)


def rest_polygons(
    name: str, body: SolidObject, robots: int, gap: float
) -> tuple[HoldPolygons, ...]:
    """Return the polygons of hitches below an object's rim, one per orientation, the best first.

    Candidates are regular polygons about the centre of mass, turned, and stretched along the rim's
    axes. The best have the largest inset, the smaller distance of clasps to the rim's outline and
    of edges to the body; of those with a SUFFICIENT_INSET, the widest support. Outer clasps
    are the widest with an OUTER_INSET, and those with the shortest legs below the rim.

    Parameters
    ----------
    name, body: the object, with a rim.
    robots: number of vertices.
    gap: distance of the edges around it [m].

    Raises
    ------
    InfeasibleError: no polygon fits between body and rim.
    InputError: no rim.
    """
    if body.rim is None:
        raise RequestError(f"objects.{name}.rim", None, "given", "add a rim, or grasp it by: grip")
    rim = body.rim.section
    centre = body.centre_of_mass[:2]
    candidates = RestCandidates.of(body, rim, robots)
    merits = candidates.merits(SUFFICIENT_INSET)
    outer_merits = candidates.merits(OUTER_INSET)
    largest_inset = float(candidates.insets.flat[np.argmax(merits)])
    if largest_inset < MIN_INSET:
        when = "below the rim of the object"
        remedy = (
            f"widen the rim of objects.{name}, or use the number of robots that `hitchopt fit` "
            "recommends"
        )
        violation = Violation(
            "support", largest_inset, MIN_INSET, "min", "m", (name,), when, remedy
        )
        raise InfeasibleError([violation])
    chosen = list[tuple[float, HoldPolygons]]()
    for k in range(ANGLES):
        polygons = candidates.polygons[k]
        best = int(np.argmax(merits[k]))
        if candidates.insets[k, best] < MIN_INSET:
            continue
        widest_outer = int(np.argmax(outer_merits[k]))
        shortest_legs = int(np.argmin(candidates.longest[k]))
        distinct = dict.fromkeys((widest_outer, shortest_legs))
        outer = tuple(ConvexPolygon(polygons[i]).vertices for i in distinct if i != best)
        about = HoldPolygons.about(polygons[best], centre, (rim, body.section), gap)
        chosen.append((float(merits[k, best]), replace(about, outer=outer)))
    chosen.sort(key=lambda candidate: -candidate[0])
    return tuple(polygons for _, polygons in chosen)


def _longest_below(rim: Section, polygons: Array) -> Array:
    """Return the largest lengths (…) [m] of legs below a rim, which extend edges (…, n, 2) [m]."""
    following = np.roll(polygons, -1, axis=-2)
    along = unit(following - polygons)
    onward = rim.reach(following, along)
    back = rim.reach(polygons, -along)
    return np.asarray(np.max(np.maximum(onward, back), axis=-1))


def _axes(section: Section) -> tuple[Array, Array]:
    """Return the axes (2, 2) of a section as columns, and half of its widths along them [m]."""
    core = section.core
    if len(core) < 3:
        return np.eye(2), np.full(2, section.rounding)
    sides = unit(np.roll(core, -1, axis=0) - core)
    frames = np.stack([sides, left_of(sides)], axis=2)
    widths = np.ptp(np.einsum("pd,sdi->spi", core, frames), axis=1)  # (sides, 2)
    best = int(np.argmin(np.prod(widths, axis=1)))
    return frames[best], 0.5 * widths[best]
