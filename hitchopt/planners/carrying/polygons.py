"""Polygons of clasps around an object and of its hold: grips and rests below rims.

``best_grip`` maximizes the slip load within all limits by sequential quadratic programming (SLSQP)
from several initial guesses. The search is local: failure does not prove infeasibility. Its result
is evaluated independently.
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
from hitchopt.geometry.vectors import cross, left_of, length, turn, unit
from hitchopt.hitch import Team
from hitchopt.hitch.holding import Grip
from hitchopt.hitch.quadrotor import Quadrotor
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import Section, SolidObject
from hitchopt.values import Array, Indices

REST_STRETCHES, GRIP_STRETCHES = np.ones(1), np.geomspace(0.25, 4.0, 81)
"""Candidate aspect ratios of the polygon around an object, for rests and for grips, over that of
the polygon that holds it."""


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
        axes = np.linalg.eigh(offsets.T @ offsets)[1]
        polygons = []
        for width in np.sqrt(stretches):
            stretched = offsets @ (axes * [width, 1.0 / width]) @ axes.T
            outward, distances = sides_of(stretched)
            required = [each.support(outward) + gap - outward @ centre for each in sections]
            polygons.append(float(np.max(np.max(required, axis=0) / distances)) * stretched)
        around = min(polygons, key=lambda each: float(np.max(length(np.roll(each, -1, 0) - each))))
        return cls(ConvexPolygon(centre + around).vertices, ConvexPolygon(clasps).vertices)


def sides_of(polygon: Array) -> tuple[Array, Array]:
    """Return outward normals (…, n, 2) of a clockwise polygon's edges, and their offsets [m]."""
    onward = np.roll(polygon, -1, axis=-2) - polygon
    outward = unit(left_of(onward))
    return outward, np.sum(outward * polygon, axis=-1)


# Grips.

MIN_GAP = 0.02
"""[m] Minimum distance of a clasp, where two ropes bend around each other, to the section."""

DIFFERENCE_STEP = 1e-6  # [m] Step of central differences of margins

LIFT_MARGIN = 0.05
"""Margin of all distances over their limits, which exceeds the changes by lifting."""

MAX_IMBALANCE = 1e-6
"""Largest horizontal force on the section over the tension, and moment over tension and size."""

SCREENING_ITERATIONS, MAX_ITERATIONS, FINALISTS = 12, 60, 2
"""Maximum iterations from every guess and from the finalists, and the number of finalists."""

MAX_ROWS, REDUCED_ROWS = 36, 6
"""Largest number of margins of a kind in a quadratic program, and number of the smallest margins
that represent larger kinds."""

GUESS_GAPS = ((0.25, 0.25), (0.12, 0.4), (0.4, 0.12))
"""Alternating distances of a guess's vertices to the section, over its mean radius; for odd numbers
of vertices only the first pair, of equal ones."""

EVEN_GUESSES, MAX_ALIGNED_GUESSES = 3, 6
"""Number of guesses turned by equal parts of their symmetry, and largest number along sides."""

DECIMALS = 12  # Decimal places of centroids and reported ratios, which round errors to zero


@dataclass(frozen=True, eq=False)
class GripTask:
    """The problem of a grip."""

    section: Section  # to grip
    robots: int  # number n
    cable_length: float  # of all cables [m]
    tension: float  # of all cables [N]
    clasp_friction: float  # friction coefficient between cables
    requirements: Requirements  # distances to be kept
    kind: Quadrotor  # of all quadrotors

    def grip(self, vertices: Array) -> Grip:
        """Return the grip with vertices (…, n, 2) [m]."""
        return Grip.of(self.section, vertices, self.cable_length, self.tension, self.clasp_friction)

    def distances(self, grip: Grip) -> dict[str, Array]:
        """Return the relative margins (…, items) of all distances of a grip.

        Keys are names of the certificate's checks, and ``gap``, of clasps to the section.
        """
        n, shape, contacts = self.robots, grip.vertices.shape[:-2], grip.wraps.contacts
        drones = grip.drones.reshape(*shape, 2 * n, 2)
        vertices, onward = grip.vertices, np.roll(grip.vertices, -1, axis=-2)
        starts = vertices, vertices, contacts[..., 1, :], onward  # q-legs, both tangents, r-legs
        ends = grip.drones[..., 0, :], contacts[..., 0, :], onward, grip.drones[..., 1, :]
        parts = np.stack([np.concatenate(each, axis=-2) for each in (starts, ends)], axis=-2)
        (one, two), (drone, near), (i, j) = _pairs(n)
        clearance = self.section.clearance
        distances = {
            "separation": length(drones[..., one, :] - drones[..., two, :]),
            "cable_clearance": _distances(drones[..., drone, None, :], parts[..., near, :, :]),
            "crossing": _distances(parts[..., i, :, :], parts[..., j, :, :]),
            "keep_out": clearance(drones)[0],
            "legs": grip.legs.reshape(*shape, 2 * n),
            "gap": clearance(grip.vertices)[0],
        }
        items = ((name, each, self.limits[name]) for name, each in distances.items())
        return {name: each / limit - 1.0 if limit else each for name, each, limit in items}

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
        }

    def shortest(self, grip: Grip) -> tuple[float, str]:
        """Return the smallest margin of all distances, and its name."""
        return min((float(np.min(each)), name) for name, each in self.distances(grip).items())

    def offset_of_centroid(self, vertices: Array) -> Array:
        """Return the distances (…) [m] of the centroid from lines through two clasps (…, 2, 2).

        An object that hangs at two clasps tilts unless its centre of mass is below their line.
        """
        onward = unit(vertices[..., 1, :] - vertices[..., 0, :])
        arms = self.section.centroid - vertices[..., 0, :]
        return cross(onward, arms)

    def merit(self, grip: Grip) -> float:
        """Return the slip load over friction [N] of a grip, or minus its largest violation."""
        edges = np.roll(grip.vertices, -1, axis=0) - grip.vertices
        turns = turn(edges, np.roll(edges, -1, axis=0))
        is_single = np.all(turns < 0.0) and np.sum(turns) >= -3.0 * math.pi  # clockwise turn
        if self.robots > 2 and not is_single:
            return -math.inf
        scale = np.array([1.0, 1.0, math.sqrt(self.section.area)]) * self.tension
        imbalance = float(np.max(np.abs(grip.imbalance) / scale)) - MAX_IMBALANCE
        if self.robots == 2:
            offset = abs(float(self.offset_of_centroid(grip.vertices)))
            imbalance = max(imbalance, offset / math.sqrt(self.section.area) - MAX_IMBALANCE)
        unwrapped = -float(np.min(grip.wraps.angles))
        violation = max(-self.shortest(grip)[0], imbalance, 0.0)
        if violation > 0.0 or unwrapped >= 0.0:
            return -violation - max(unwrapped, 0.0)
        return float(grip.slip_load(1.0))


@lru_cache
def _pairs(n: int) -> tuple[Indices, Indices, Indices]:
    """Return the pairs (2, pairs) that need clearance: drones, drones with parts, and parts.

    A drone needs no clearance to the leg that ends at it.
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
    """Return the unloaded grip with the largest slip load within all limits.

    Coordinates of the search are relative to the section's centroid.

    Raises
    ------
    InfeasibleError: the search failed; the violation is that of the grip nearest to feasible.
    """
    centre = np.round(task.section.centroid, DECIMALS)
    outline = task.section.outline
    centred = task
    if outline is not None and np.any(centre):
        centred = replace(task, section=Section(outline - centre))
    # The best two clasps around most sections are in line with the centroid without that constraint
    for in_line in (False, True) if task.robots == 2 else (False,):
        guesses = _guesses(centred)
        for iterations, number in ((SCREENING_ITERATIONS, FINALISTS), (MAX_ITERATIONS, 1)):
            found = (_refined(centred, guess, iterations, in_line=in_line) for guess in guesses)
            ranked = sorted(map(centred.grip, found), key=centred.merit, reverse=True)[:number]
            guesses = [each.vertices for each in ranked]
        (best,) = ranked
        if centred.merit(best) > 0.0:
            return task.grip(best.vertices + centre)
    raise _no_grip(centred, best)


def _guesses(task: GripTask) -> list[Array]:
    """Return polygons (n, 2) [m] around the section: evenly turned, and aligned with its sides."""
    core, n = task.section.core, task.robots
    symmetry = 2.0 * math.pi / n
    sides = task.section.sides[:, 1] - core
    aligned = np.arctan2(sides[:, 0], -sides[:, 1])[np.argsort(-np.hypot(*sides.T), kind="stable")]
    even = 0.5 * math.pi - symmetry * np.arange(EVEN_GUESSES) / EVEN_GUESSES
    turns = even[:1] if len(core) == 1 else np.append(aligned[:MAX_ALIGNED_GUESSES], even)
    _, first = np.unique(np.round(turns % symmetry, 6) % symmetry, return_index=True)
    centre, size = task.section.centroid, math.sqrt(task.section.area / math.pi)
    guesses = []
    for angle in turns[np.sort(first)]:
        angles = angle - symmetry * np.arange(n)
        outward = np.column_stack([np.cos(angles), np.sin(angles)])
        rays = np.linspace(0.0, 3.0, 601)[:, None, None] * task.section.circumradius * outward
        gaps = task.section.clearance(centre + rays)[0]
        for pair in GUESS_GAPS if n % 2 == 0 else GUESS_GAPS[:1]:
            first = np.argmax(gaps >= size * np.resize(pair, n), axis=0)
            guesses.append(centre + rays[first, np.arange(n)])
    return guesses


def _refined(task: GripTask, guess: Array, iterations: int, *, in_line: bool) -> Array:
    """Return the vertices (n, 2) [m] that sequential quadratic programming reaches from a guess.

    Those of two clasps that are ``in_line`` have the centroid between them.

    Since grips of a disc have no moment and may be turned, its third equation is zero rotation of
    the vertices from the guess instead.
    """
    from scipy.optimize import minimize

    rotation = None
    if len(task.section.core) == 1:
        offsets = guess - task.section.centroid
        rotation = (offsets[:, ::-1] * [-1.0, 1.0]).ravel() / np.linalg.norm(offsets)

    def smallest(margins: Array) -> Array:
        if margins.shape[-1] <= MAX_ROWS:
            return margins
        return np.sort(np.partition(margins, REDUCED_ROWS - 1)[..., :REDUCED_ROWS])

    def values(x: Array) -> Array:
        """Return slip load, imbalances and margins (…, rows) at vertices x (…, 2 n) [m]."""
        grip = task.grip(x.reshape(*x.shape[:-1], *guess.shape))
        margins = [smallest(each) for each in (*task.distances(grip).values(), grip.wraps.angles)]
        objective = grip.slip_load(1.0)[..., None] / task.tension
        imbalance = grip.imbalance / task.tension
        if rotation is not None:
            imbalance[..., 2] = (x - guess.ravel()) @ rotation
        elif in_line:
            offset = task.offset_of_centroid(grip.vertices)[..., None]
            imbalance = np.concatenate([imbalance, offset], axis=-1)
        return np.concatenate([objective, imbalance, *margins], axis=-1)

    @lru_cache(maxsize=1)
    def at(x: tuple[float, ...]) -> Array:
        """Return values (rows,) at vertices x (2 n,) [m]."""
        return values(np.array(x))

    @lru_cache(maxsize=1)
    def jacobian(x: tuple[float, ...]) -> Array:
        """Return the Jacobian (rows, 2 n) of values at vertices x (2 n,) [m], by differences."""
        moves = DIFFERENCE_STEP * np.eye(len(x))
        after, before = np.split(values(np.array(x) + np.concatenate([moves, -moves])), 2)
        return np.asarray((after - before).T / (2.0 * DIFFERENCE_STEP))

    def part(
        of: Callable[[tuple[float, ...]], Array], rows: Any, sign: float = 1.0, lower: float = 0.0
    ) -> Callable[[Array], Any]:
        return lambda x: sign * of(tuple(x))[rows] - lower

    check_time()
    first = 5 if in_line and rotation is None else 4
    kinds = ("eq", slice(1, first), 0.0), ("ineq", slice(first, None), LIFT_MARGIN)
    constraints: Any = [
        {"type": kind, "fun": part(at, rows, lower=lower), "jac": part(jacobian, rows)}
        for kind, rows, lower in kinds
    ]
    result = minimize(
        part(at, 0, -1.0),
        guess.ravel(),
        method="SLSQP",
        jac=part(jacobian, 0, -1.0),
        constraints=constraints,
        options={"maxiter": iterations, "ftol": 1e-7},
    )
    return np.asarray(result.x).reshape(guess.shape)


def _no_grip(task: GripTask, nearest: Grip) -> InfeasibleError:
    """Return the error of the limit that the nearest grip violates most, or of wraps."""
    margin, worst = task.shortest(nearest)
    name, ratio = (worst, 1.0 + margin) if margin < 0.0 else ("grip", 0.0)
    limit, unit = (1.0, "ratio") if name in {"grip", "separation"} else (task.limits[name], "m")
    note = f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found"
    remedy = f"{note}: this distance is the one that the nearest one lacks most"
    value = round(ratio * limit, DECIMALS)
    return InfeasibleError([Violation(name, value, limit, "min", unit, (), "", remedy)], note)


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
    clasps = grip_clasps(name, body, team, requirements)
    centre, section = body.centre_of_mass[:2], body.section
    return HoldPolygons.about(clasps, centre, (section,), gap, GRIP_STRETCHES)


def grip_clasps(name: str, body: SolidObject, team: Team, requirements: Requirements) -> Array:
    """Return the clasps (n, 2) [m] of the grip of an object with the largest slip load.

    Raises
    ------
    InputError: cables or drones that differ.
    InfeasibleError: the search of a grip failed.
    """
    kinds = [kind.uncalibrated for kind in team.quadrotor]
    for key, values in (("cable_length", team.cable_length), ("quadrotor", kinds)):
        if len(set(values)) > 1:
            bound = "equal for all robots if they grip an object"
            raise InputError(f"team.{key}", list(values), bound, "use one kind")
    drone, cable = kinds[0], float(team.cable_length[0])
    tension = SEARCH_TENSION_RATIO * drone.level_pull(requirements.limits.tilt)[0]
    friction, section = team.cable_friction, body.section
    task = GripTask(section, team.robots, cable, tension, friction, requirements, drone)
    try:
        return best_grip(task).vertices
    except InfeasibleError as error:
        words = f"around objects.{name}"
        raise InfeasibleError([replace(v, when=words) for v in error.violations]) from None


# Rests.

EDGE_MARGIN = 0.045
"""[m] Margin of edges' distances to an object: 25 mm for the largest observed error of edges, and
20 mm for the position error of the object."""

SUFFICIENT_INSET, MIN_INSET = 0.05, 0.01
"""[m] Sufficient and minimum distance of clasps to the rim's outline, and of edges to the body."""

OUTER_INSET = 0.02
"""[m] Sufficient distance where none with a SUFFICIENT_INSET holds: legs may rise more steeply
near the rim's edge without cutting it."""

ANGLES, ASPECTS = 12, 17  # Numbers of candidate orientations and aspect ratios
SIZES = np.linspace(0.05, 1.0, 96)  # Candidate sizes of a polygon below a rim, over the rim's own


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
        raise InputError(f"objects.{name}.rim", None, "given", "rest objects with a rim on clasps")
    rim, centre = body.rim.section, body.centre_of_mass[:2]
    frame, size = _axes(rim)
    angles = 2.0 * math.pi / robots * np.arange(ANGLES) / ANGLES
    corners = angles[:, None] - 2.0 * math.pi * np.arange(robots) / robots
    regular = math.sqrt(2.0) * np.stack([np.cos(corners), np.sin(corners)], axis=-1)
    widths = np.geomspace(0.5, 2.0, ASPECTS)[:, None, None] ** [0.5, -0.5]
    shapes = (regular[:, None] * widths).reshape(-1, robots, 2)
    polygons = (shapes[:, None] * SIZES[:, None, None] * size) @ frame.T + centre
    inside = -np.max(rim.clearance(polygons)[0], axis=-1)
    outward, offsets = sides_of(polygons)
    width = np.min(offsets - outward @ centre, axis=-1)
    inset = inside
    if body.stem is not None:
        inset = np.minimum(inset, np.min(offsets - body.stem.support(outward), axis=-1))
    longest = np.where(inset >= MIN_INSET, _longest_below(rim, polygons), np.inf)
    merit = np.minimum(inset, SUFFICIENT_INSET) + 1e-3 * width
    best = np.unravel_index(int(np.argmax(merit)), inset.shape)
    if inset[best] < MIN_INSET:
        value, when = float(inset[best]), "below the rim of the object"
        remedy = (
            f"give objects.{name} a wider rim, or use the number of robots that `hitchopt fit` "
            "recommends"
        )
        raise InfeasibleError(
            [Violation("support", value, MIN_INSET, "min", "m", (name,), when, remedy)]
        )
    chosen = list[tuple[float, HoldPolygons]]()
    for k in np.split(np.arange(len(polygons)), ANGLES):
        candidates, insets, widths = (
            x[k].reshape(-1, *x.shape[2:]) for x in (polygons, inset, width)
        )
        merits = np.minimum(insets, SUFFICIENT_INSET) + 1e-3 * widths
        first = int(np.argmax(merits))
        if insets[first] < MIN_INSET:
            continue
        outer = int(np.argmax(np.minimum(insets, OUTER_INSET) + 1e-3 * widths))
        level = int(np.argmin(longest[k]))
        others = [i for i in dict.fromkeys((outer, level)) if i != first]
        about = HoldPolygons.about(candidates[first], centre, (rim, body.section), gap)
        about = replace(about, outer=tuple(ConvexPolygon(candidates[i]).vertices for i in others))
        chosen.append((float(merits[first]), about))
    chosen.sort(key=lambda each: -each[0])
    return tuple(polygons for _, polygons in chosen)


def _longest_below(rim: Section, polygons: Array) -> Array:
    """Return the largest lengths (…) [m] of legs below a rim, which extend edges (…, n, 2) [m]."""
    following = np.roll(polygons, -1, axis=-2)
    along = unit(following - polygons)
    onward, back = rim.reach(following, along), rim.reach(polygons, -along)
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
