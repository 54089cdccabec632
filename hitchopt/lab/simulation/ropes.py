"""Simulated ropes: resolution, initial shapes, compensation of thickness, and linking numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from hitchopt.errors import HitchoptError, InputError, rounded_up
from hitchopt.geometry.vectors import EAST, dot, length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import hanging_cable
from hitchopt.hitch.team import Layout
from hitchopt.lab.simulation.settings import Preset, Settings
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array

# Largest ratio of the time step to the time in which a transverse wave passes a segment
COURANT = 0.7

TENSION_RESERVE = (
    2.0  # Tension that the lightest ropes hold without smaller steps, over the planned
)
MAX_SUBSTEPS = 8  # Largest number of substeps, for light ropes
ROUNDING = 1e-9  # Tolerance of a number of segments: 2.4 m are 96 of 0.025 m in spite of rounding

GAP_DIAMETERS = 3.5  # Minimum distance of the two bends of a loose clasp, in diameters
GAP_SEGMENTS = 1.7  # The same in segments, so that a bend consists of several segments

REACH = 2.0  # Distance from a clasp, over its gap, at which a cable meets the planned line
SPACING_ROUNDS = 50  # Rounds in which clasps of short edges move apart; a few suffice

# Corners of a bend: along the direction in which it opens, and across it
BEND = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))

SLOPE_TOLERANCE = 1e-6  # Tolerance of equal slopes of legs
OVERHANG = 0.5  # Extension of a cable's line beyond its drone, for its last segments [m]
FOLD_LINKS = 4  # Links per fold of excess cable on the ground

# Length used by coarse segments in a bend of 180°, over the squared segment length over the
# diameter: within 1 mm at clasps of regular hitches of 3 to 12 cables, in both presets
COARSENESS = 0.15

TINY = 1e-300  # Smallest divisor of normals [m²]: coplanar edges span no solid angle
UP = np.array([0.0, 0.0, 1.0])  # Direction opposite to gravity


class ShapeError(HitchoptError):
    """Two drones start at a distance larger than the length of their cable."""


@dataclass(frozen=True, eq=False)
class Ropes:
    """n cables, each divided into segments of equal length."""

    lengths: Array  # (n,) [m]
    density: Array | float  # mass per length [kg/m], common or of each cable (n,)
    friction: Array | float  # between cables and with the ground, common or of each cable (n,)
    preset: Preset  # resolution

    @classmethod
    def of(cls, team: Team, settings: Settings, lengths: Array, tension: float = 0.0) -> Ropes:
        """Return ropes of some lengths (n,) [m]; settings override density and friction of a team.

        Time steps are smaller than the preset's for light ropes under a ``tension`` [N]. Ropes of
        cables without weight are the lightest ones for it.
        """
        density = simulated_density(team, settings, tension)
        friction = team.friction if settings.friction is None else settings.friction
        ropes = cls(lengths, density, friction, settings.preset)
        step = settings.preset.time_step / ropes.substeps(tension)
        return replace(ropes, preset=replace(settings.preset, time_step=step))

    @classmethod
    def joined(cls, each: Sequence[Ropes]) -> Ropes:
        """Return the ropes of several teams, with the smallest time step."""
        if len(each) == 1:
            return each[0]
        lengths, density, friction = (
            np.concatenate([np.broadcast_to(getattr(x, name), x.lengths.shape) for x in each])
            for name in ("lengths", "density", "friction")
        )
        return cls(
            lengths,
            density,
            friction,
            min((x.preset for x in each), key=lambda preset: preset.time_step),
        )

    def substeps(self, tension: float) -> int:
        """Return the number of substeps for a tension [N], at most MAX_SUBSTEPS."""
        ratio = self.preset.reserve * max(tension, 0.0) / self.largest_tension
        return min(max(math.ceil(math.sqrt(ratio) - ROUNDING), 1), MAX_SUBSTEPS)

    @cached_property
    def segments(self) -> NDArray[np.intp]:
        """Number of segments of each cable (n,), even."""
        halves = np.ceil(self.lengths / (2.0 * self.preset.segment) - ROUNDING)
        counts: NDArray[np.intp] = 2 * np.maximum(halves, 1.0).astype(np.intp)
        return counts

    @cached_property
    def segment_lengths(self) -> Array:
        """Length of one segment of each cable (n,) [m]."""
        return self.lengths / self.segments

    @cached_property
    def largest_tension(self) -> float:
        """Largest tension at which waves and contacts are resolved [N]."""
        wave = COURANT * self.segment_lengths / self.preset.time_step
        return float(np.min(self.density * wave**2))

    def check_tension(self, tension: float) -> None:
        """Raise InputError if ropes are too light for a plan's largest tension [N]."""
        needed = TENSION_RESERVE * tension
        if self.largest_tension < needed:
            needed_density = float(np.max(self.density)) * needed / self.largest_tension
            bound = f"at least {rounded_up(needed_density, 3):.3g} kg/m to hold {needed:.3g} N"
            raise InputError("density", self.density, bound, "simulate heavier cables (density=)")


def largest_tension(task: TeamTask) -> float:
    """Return the largest tension of a team's cables and of their plan [N]."""
    return float(max(np.max(task.team.tension), np.max(task.states.tensions)))


def simulated_density(team: Team, settings: Settings, tension: float = 0.0) -> float:
    """Return the density of ropes [kg/m]: the settings', the team's, or the lightest possible.

    The lightest ropes bear the team's or a larger ``tension`` [N] with the preset's time step;
    lighter ones whip while they are loose. Their density is rounded up to two digits.
    """
    if density := settings.density or team.cable_density:
        return density
    preset = settings.preset
    # The shortest segments of cables of about these lengths, since their number is even
    segment = preset.segment / (1.0 + 2.0 * preset.segment / float(np.min(team.cable_length)))
    wave = COURANT * segment / preset.time_step
    needed = TENSION_RESERVE * max(tension, float(np.max(team.tension))) / wave**2
    digit = 10.0 ** (math.floor(math.log10(needed)) - 1)
    return float(f"{math.ceil(needed / digit) * digit:.2g}")


def clasped(ropes: Ropes, layout: Layout, drones: Array, vertices: Array) -> list[Array]:
    """Return loosely interlaced cables of a formed hitch for drones (2n, 3) [m].

    Cables are chains of segments of exact length, n of (segments + 1, 3) [m], which end slightly
    inward of the drones. At a clasp the cables overlap like two links of a chain: cable k is
    horizontal, cable k-1 vertical, with its leg below, or above if it rises more than the other
    leg. Clasps of an edge that is too short for two loose clasps begin further apart; settling
    brings them closer.
    """
    longest_segment = float(np.max(ropes.segment_lengths))
    gap = max(GAP_DIAMETERS * ropes.preset.diameter, GAP_SEGMENTS * longest_segment)
    vertices = _spaced(layout, vertices, 2.0 * REACH * gap)
    corners = _interlaced_corners(layout, drones, vertices, gap)
    sizes = zip(ropes.segments, ropes.segment_lengths, strict=True)
    return [
        _chain(polyline, int(count), float(size))
        for polyline, (count, size) in zip(corners, sizes, strict=True)
    ]


def _interlaced_corners(
    layout: Layout, drones: Array, vertices: Array, gap: float
) -> Iterator[Array]:
    """Yield the corners (corners, 3) [m] of each cable, from its q-drone to its r-drone.

    Both bends of a clasp are ``gap`` [m] wide. ``drones`` (2n, 3) and ``vertices`` are in metres.
    """
    q, r = drones[0::2], drones[1::2]
    u = unit(layout.edges(vertices))
    p, after, before = vertices[layout.clasps], layout.ahead, layout.behind
    q_hat, r_hat = unit(q[after] - p), unit(r[before] - p)
    q_level = unit(q_hat * [1.0, 1.0, 0.0])
    along = 0.5 * gap * unit(q_level + u[after])  # the direction in which cable k's bend opens
    across = 0.5 * gap * unit(q_level - u[after])  # to the side of the legs
    # The bend of cable k-1 is upright. ``edge_side`` is 1 where its edge is above cable k, and -1
    # where it is below; its leg is on the other side
    leg_rises_more = r_hat[:, 2] > q_hat[:, 2] + SLOPE_TOLERANCE
    edge_side = np.where(leg_rises_more, -1.0, 1.0)
    to_edge = 0.5 * gap * edge_side[:, None] * UP
    leg_corner = p + REACH * gap * r_hat
    height_to_edge_side = edge_side * (leg_corner - p)[:, 2]
    # Past the bend of cable k
    leg_corner[:, 2] += edge_side * np.minimum(-0.5 * gap - height_to_edge_side, 0.0)
    starts, ends = [[point] for point in q], [[point] for point in r]
    for c, (k, j) in enumerate(zip(after, before, strict=True)):
        starts[k] = [
            q[k] + OVERHANG * q_hat[c],
            p[c] + REACH * gap * q_hat[c],
            *(p[c] + x * along[c] + y * across[c] for x, y in BEND),
            p[c] + REACH * gap * u[k],
        ]
        ends[j] = [
            p[c] - REACH * gap * u[j],
            *(p[c] - x * along[c] + y * to_edge[c] for x, y in BEND),
            leg_corner[c],
            r[j] + OVERHANG * r_hat[c],
        ]
    for start, end in zip(starts, ends, strict=True):
        yield np.array([*start, *end])


def _chain(corners: Array, count: int, size: float) -> Array:
    """Return points (count + 1, 3) of ``count`` segments of a ``size`` [m] along a polyline.

    It is built outward from the middle of the corners (corners, 3), with half of them either way.
    """
    middle = len(corners) // 2
    centre = 0.5 * (corners[middle - 1] + corners[middle])
    onward = _steps(np.vstack([centre, corners[middle:]]), count // 2, size)
    back = _steps(np.vstack([centre, corners[:middle][::-1]]), count // 2, size)
    return np.vstack([back[:0:-1], onward])


def _spaced(layout: Layout, vertices: Array, shortest: float) -> Array:
    """Return vertices (vertices, 3) [m] whose edges have at least about the ``shortest`` length.

    Both ends of a shorter edge move along it, by equal distances; neighbours follow in rounds.
    """
    for _ in range(SPACING_ROUNDS):
        edges = layout.edges(vertices)
        missing = np.maximum(shortest - length(edges), 0.0)
        if not missing.any():
            break
        shifts = 0.5 * missing[:, None] * unit(edges)
        vertices = vertices.copy()
        np.subtract.at(vertices, layout.starts, shifts)
        np.add.at(vertices, layout.ends, shifts)
    return vertices


def _steps(corners: Array, count: int, size: float) -> Array:
    """Return points (count + 1, 3) on a polyline at distances ``size`` from point to point."""
    points, here, leg = [corners[0]], corners[0], 0
    for _ in range(count):
        while leg < len(corners) - 2 and np.linalg.norm(corners[leg + 1] - here) < size:
            leg += 1
        start, along = corners[leg], unit(corners[leg + 1] - corners[leg])
        offset = start - here
        b, c = float(offset @ along), float(offset @ offset) - size**2
        here = start + (np.sqrt(max(b * b - c, 0.0)) - b) * along
        points.append(here)
    return np.array(points)


def hanging(ropes: Ropes, drones: Array, ground: float) -> list[Array]:
    """Return cables that hang between their drones, or partly lie on the ground at a height [m].

    Cables are chains of segments of exact length, n of (segments + 1, 3) [m], which end within a
    segment of their drones (2n, 3) [m]; settling removes the difference.
    """
    chains, floor = [], ground + 0.5 * ropes.preset.diameter
    for k, (count, size) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        q, r, whole = drones[2 * k], drones[2 * k + 1], float(count * size)
        if (distance := float(np.linalg.norm(r - q))) > whole * (1.0 + 1e-6):
            problem = f"its drones start {distance:.4g} m apart, more than its {whole:.4g} m"
            raise ShapeError(f"cable {k}: {problem}; lengthen it, or start closer")
        curve = hanging_cable(q, r, max(whole, distance), int(count) + 1)
        along, lies = unit(np.diff(curve, axis=0), fallback=-UP), np.min(curve[:, 2]) < floor
        if lies:
            along = _lying(q, r, int(count), float(size), floor)
        chain = size * np.vstack([np.zeros(3), np.cumsum(along, axis=0)])
        chain += 0.5 * (q + r - chain[-1])  # both ends share the difference
        if lies:
            chain[:, 2] += floor - np.min(chain[:, 2])
        chains.append(chain)
    return chains


def _lying(q: Array, r: Array, count: int, size: float, floor: float) -> Array:
    """Return directions (count, 3) of links of a ``size`` [m] from q via the floor to r [m].

    From the floor, a cable rises as catenaries with a common parameter a, tension over weight per
    length: the slope at an arc length s is s / a. If the cable is too long for any tension, a is
    one link, and the part on the floor zigzags at a constant angle.
    """
    whole = count * size
    offset = r - q
    span = float(np.hypot(*offset[:2]))
    forward = unit(offset * [1.0, 1.0, 0.0], fallback=EAST)
    heights = np.maximum(np.array([q[2], r[2]]) - floor, 0.0)

    def rising_lengths(a: float) -> Array:
        """Return the lengths (2,) [m] of cable above the floor at q and r."""
        return np.asarray(np.sqrt(heights * (heights + 2.0 * a)))

    def surplus(a: float) -> float:
        """Return the length [m] on the floor, less the distance there."""
        arcs = rising_lengths(a)
        return float(whole - span - np.sum(arcs - a * np.arcsinh(arcs / a)))

    slackest = size
    tightest = 1e3 * whole
    is_straight = surplus(slackest) < 0.0 < surplus(tightest)
    a = brentq(surplus, slackest, tightest) if is_straight else slackest
    q_arc, r_arc = rising_lengths(a)
    # Slopes at the links' middles, which are zero on the floor
    arc = size * (np.arange(count) + 0.5)
    descent = np.maximum(q_arc - arc, 0.0)
    ascent = np.maximum(arc - whole + r_arc, 0.0)
    slope = (ascent - descent) / a
    # Zigzag on the floor
    lying = max(whole - float(q_arc + r_arc), size)
    cosine = min(max(1.0 - surplus(a) / lying, 0.0), 1.0)
    folds = 2 * max(round(lying / (2 * FOLD_LINKS * size)), 1)
    side = (-1.0) ** np.floor(folds * np.clip((arc - q_arc) / lying, 0.0, 1.0))
    sideways = math.sqrt(1.0 - cosine**2) * side[:, None] * np.cross(UP, forward)
    on_floor = cosine * forward + sideways
    rising = forward + slope[:, None] * UP
    return unit(np.where(slope[:, None] == 0.0, on_floor, rising))


def thickness_allowance(task: TeamTask, diameter: float, segment: float) -> Array:
    """Return the additional length of thick cables for their bends (n,) [m].

    Without it the tension would exceed the plan's. It is the sum of ``bend_lengths`` of a cable's
    clasps and, for a cable around an object, half a diameter times the turn seen from above.
    """
    layout, allowance = task.team.layout, np.zeros(task.team.robots)
    longer = bend_lengths(task, diameter, segment)
    np.add.at(allowance, layout.ahead, longer)
    np.add.at(allowance, layout.behind, longer)
    if task.states.formed.any():
        leaving, arriving = (unit(each * [1.0, 1.0, 0.0]) for each in _edge_ends(task))
        turns = np.arccos(np.clip(dot(leaving, arriving), -1.0, 1.0))
        allowance += 0.5 * diameter * np.mean(turns, axis=0)
    return allowance


def bends_about(task: TeamTask, diameter: float, segment: float, cable: int) -> Array:
    """Return the ``bend_lengths`` of other cables about one of them (n,) [m]."""
    layout, allowance = task.team.layout, np.zeros(task.team.robots)
    longer = bend_lengths(task, diameter, segment)
    for own, other in ((layout.ahead, layout.behind), (layout.behind, layout.ahead)):
        np.add.at(allowance, own[other == cable], longer[other == cable])
    return allowance


def bend_lengths(task: TeamTask, diameter: float, segment: float) -> Array:
    """Return the additional length of each cable of a clasp due to thickness (clasps,) [m].

    A cable turns by ``π - φ`` about another, where φ is the angle between the edges. Its centre
    line follows a circle with a radius of one diameter, whose far side is half a diameter from the
    vertex. It is ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. A chain of
    segments needs another ``COARSENESS · segment²/diameter · cos(φ/2)``. Values are means over the
    time with a carried object, which short ropes would grip harder, or else with a hitch.
    """
    layout = task.team.layout
    if not task.states.formed.any():
        return np.zeros(len(layout.clasps))
    leaving, arriving = _edge_ends(task)
    cosine = dot(leaving[:, layout.ahead], arriving[:, layout.behind])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    half = np.cos(0.5 * turn)
    bends = diameter * (np.pi - turn - half) + COARSENESS * segment**2 / diameter * half
    return np.asarray(np.mean(bends, axis=0))


def _edge_ends(task: TeamTask) -> tuple[Array, Array]:
    """Return unit vectors (samples, n, 3) along edges at both ends, see ``bend_lengths``."""
    layout, motion = task.team.layout, task.motion
    formed = task.states.formed
    if motion is None or not motion.has_wraps:
        straight = unit(layout.edges(task.states.vertices[formed]))
        return straight, straight
    carrying = formed & np.any(task.cargo.carried, axis=-1)
    counted = carrying if carrying.any() else formed
    vertices = task.states.vertices[counted]
    times = np.clip(task.states.t[counted], *motion.contacts.breaks[[0, -1]])
    first, last = np.moveaxis(motion.contacts.at(times), 2, 0)
    return unit(first - vertices[:, layout.starts]), unit(vertices[:, layout.ends] - last)


def leg_end_offsets(task: TeamTask, diameter: float) -> Array:
    """Return offsets of the ends of thick ropes from their drones (samples, 2n, 3) [m].

    The circle of a bend, see ``bend_lengths``, displaces a leg from the vertex by ``1 - sin(h)/2``
    diameters, where h is half of the angle between leg and edge. Without an equal offset at the
    drone, legs would point inward and triangles, which are soft, deform by 2 cm. Offsets are
    proportional to the tension up to the team's.
    """
    layout, team = task.team.layout, task.team
    edges = unit(layout.edges(task.states.vertices))
    along = np.stack([edges, -edges], axis=-2).reshape(task.states.positions.shape)
    legs = unit(task.states.positions - task.states.vertices[:, layout.pulled_to])
    cosine = dot(legs, along)[..., None]
    half = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))
    ratio = np.repeat(np.clip(task.states.tensions / team.tension, 0.0, 1.0), 2, axis=-1)
    offsets: Array = unit(cosine * legs - along) * (1.0 - 0.5 * np.sin(half)) * ratio[..., None]
    return diameter * offsets


def linking_number(one: Array, other: Array) -> int:
    """Return Gauss's linking number of two closed polygons (corners, 3) [m], with its sign.

    It is the sum over all pairs of edges of the solid angle spanned by their directions, over 4π
    (Banchoff 1976; Klenin and Langowski 2000).
    """
    a, b = one[:, None], np.roll(one, -1, axis=0)[:, None]
    c, d = other[None], np.roll(other, -1, axis=0)[None]
    ac, ad, bc, bd = c - a, d - a, c - b, d - b
    normals = [np.cross(ac, ad), np.cross(ad, bd), np.cross(bd, bc), np.cross(bc, ac)]
    units = [n / np.maximum(length(n)[..., None], TINY) for n in normals]
    angles = sum(np.arcsin(np.clip(dot(units[i - 1], units[i]), -1.0, 1.0)) for i in range(4))
    signs = np.sign(dot(np.cross(d - c, b - a), ac))
    return round(float(np.sum(angles * signs)) / (4.0 * np.pi))


def linking_matrix(cables: list[Array]) -> NDArray[np.int64]:
    """Return linking numbers of all pairs of cables (nodes, 3) [m] as a symmetric matrix (n, n).

    Each cable is closed by the straight line between its drones. This is meaningful at the hitch
    and before it is formed, when these lines are clear of the other cables.
    """
    matrix = np.zeros((len(cables),) * 2, dtype=np.int64)
    for i, j in combinations(range(len(cables)), 2):
        matrix[i, j] = matrix[j, i] = linking_number(cables[i], cables[j])
    return matrix
