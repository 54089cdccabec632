"""Ropes as MuJoCo simulates them: their resolution, first shapes, thickness and links."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from hitchopt.errors import HitchoptError, InputError
from hitchopt.geometry.vectors import EAST, dot, length, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import hanging_cable
from hitchopt.hitch.team import Layout
from hitchopt.simulation.settings import DENSITY, Preset, Settings
from hitchopt.simulation.task import Task
from hitchopt.values import Array

# Largest ratio of the time step to the time in which a transverse wave passes a segment
COURANT = 0.7

RESERVE = 2.0  # Tension that steps must bear, over the plan's or present one; pull tests take 1.5
FINEST = 8  # Most time steps for one of a preset, for light ropes
ROUNDING = 1e-9  # Tolerance of a count of segments: 2.4 m are 96 of 0.025 m in spite of rounding

# Least distance of the two bends of a clasp that is not yet drawn tight, in diameters and in
# segments: a bend must consist of several
CLEARANCE, CLEARANCE_SEGMENTS = 3.5, 1.7

REACH = 2.0  # Distance from a clasp, over that of its bends, from which on a cable follows the plan

# Corners of a bend: along the direction in which it opens, and across it
BEND = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))

SAME_RISE = 1e-6  # Difference of the legs' slopes up to which they rise alike
BEYOND = 0.5  # Length by which a cable's line continues beyond its drone, for its last segments [m]

FOLD = 4  # Links of a cable from one of its folds to the next on the ground, where it is too long

# Length that coarse segments use up in a bend of 180°, over the square of a segment's length over
# the diameter: within 1 mm at clasps of regular hitches of 3 to 12 cables, in both presets
COARSENESS = 0.15

# Least length of a normal [m²]: edges in one plane have none, and span no solid angle
TINY = 1e-300

UP = np.array([0.0, 0.0, 1.0])  # Direction opposite to gravity


class ShapeError(HitchoptError):
    """Two drones that start farther apart than their cable is long."""


@dataclass(frozen=True, eq=False)
class Ropes:
    """n cables, each divided into segments of equal length.

    Parameters
    ----------
    lengths: cable lengths (n,) [m].
    density: mass per length [kg/m], of all or of each (n,).
    friction: coefficient between cables, and with the ground, likewise.
    preset: resolution.
    """

    lengths: Array
    density: Array | float
    friction: Array | float
    preset: Preset

    @classmethod
    def of(cls, team: Team, settings: Settings, lengths: Array, tension: float = 0.0) -> Ropes:
        """Return ropes of some lengths (n,) [m]; density and friction are a team's, or given.

        For light ropes under a ``tension`` [N] time steps are smaller than the preset's.
        """
        density = settings.density or team.cable_density or DENSITY
        friction = team.cable_friction if settings.friction is None else settings.friction
        ropes = cls(lengths, density, friction, settings.preset)
        step = settings.preset.time_step / ropes.finer(tension)
        return replace(ropes, preset=replace(settings.preset, time_step=step))

    @classmethod
    def joined(cls, each: Sequence[Ropes]) -> Ropes:
        """Return the ropes of several teams, with the shortest of their time steps."""
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

    def finer(self, tension: float) -> int:
        """Return how many time steps a tension [N] needs in place of one, at most FINEST."""
        needed = math.ceil(math.sqrt(RESERVE * max(tension, 0.0) / self.largest_tension) - ROUNDING)
        return min(max(needed, 1), FINEST)

    @property
    def segments(self) -> NDArray[np.intp]:
        """Number of segments of each cable (n,), even."""
        halves = np.ceil(self.lengths / (2.0 * self.preset.segment) - ROUNDING)
        counts: NDArray[np.intp] = 2 * np.maximum(halves, 1.0).astype(np.intp)
        return counts

    @property
    def segment_lengths(self) -> Array:
        """Length of one segment of each cable (n,) [m]."""
        return self.lengths / self.segments

    @property
    def largest_tension(self) -> float:
        """Largest tension at which waves and contacts are resolved [N]; beyond it ropes pass."""
        wave = COURANT * self.segment_lengths / self.preset.time_step
        return float(np.min(self.density * wave**2))

    def check_tension(self, tension: float) -> None:
        """Raise InputError where ropes are too light for a plan's largest tension [N]."""
        needed = RESERVE * tension
        if self.largest_tension < needed:
            least = self.density * needed / self.largest_tension
            bound = f"at least {least:.3g} kg/m to bear {needed:.3g} N"
            raise InputError("density", self.density, bound, "simulate heavier cables (--density)")


def clasped(ropes: Ropes, layout: Layout, drones: Array, vertices: Array) -> list[Array]:
    """Return the cables of a formed hitch, loosely interlaced, for drones (2n, 3) [m].

    They are chains of segments of exactly their length, n of (segments + 1, 3) [m], and end a
    little inward of the drones. At a clasp both overlap like two links of a chain: cable k is
    level, cable k-1 upright within it, its leg below, or above where it rises more than the other.
    """
    lengths = ropes.segment_lengths
    gap = max(CLEARANCE * ropes.preset.diameter, CLEARANCE_SEGMENTS * float(np.max(lengths)))
    q, r = drones[0::2], drones[1::2]
    u = unit(layout.edges(vertices))
    p, after, before = vertices[layout.clasps], layout.ahead, layout.behind
    q_hat, r_hat = unit(q[after] - p), unit(r[before] - p)
    q_level = unit(q_hat * [1.0, 1.0, 0.0])
    along = 0.5 * gap * unit(q_level + u[after])  # the direction in which cable k's bend opens
    aside = 0.5 * gap * unit(q_level - u[after])  # to the side of the legs
    side = np.where(r_hat[:, 2] > q_hat[:, 2] + SAME_RISE, -1.0, 1.0)  # of the leg of cable k-1
    lift = 0.5 * gap * side[:, None] * UP
    leaving = p + REACH * gap * r_hat
    height = side * (leaving - p)[:, 2]
    leaving[:, 2] += side * np.minimum(-0.5 * gap - height, 0.0)  # past the other cable's bend
    starts, ends = [[each] for each in q], [[each] for each in r]
    for c, (k, j) in enumerate(zip(after, before, strict=True)):
        starts[k] = [
            q[k] + BEYOND * q_hat[c],
            p[c] + REACH * gap * q_hat[c],
            *(p[c] + x * along[c] + y * aside[c] for x, y in BEND),
            p[c] + REACH * gap * u[k],
        ]
        ends[j] = [
            p[c] - REACH * gap * u[j],
            *(p[c] - x * along[c] + y * lift[c] for x, y in BEND),
            leaving[c],
            r[j] + BEYOND * r_hat[c],
        ]
    chains = []
    for k, (count, size) in enumerate(zip(ropes.segments, lengths, strict=True)):
        corners = np.array([*starts[k], *ends[k]])  # built from its middle outward
        middle = len(corners) // 2
        centre = 0.5 * (corners[middle - 1] + corners[middle])
        onward, back = (
            _steps(np.vstack([centre, part]), int(count) // 2, float(size))
            for part in (corners[middle:], corners[:middle][::-1])
        )
        chains.append(np.vstack([back[:0:-1], onward]))
    return chains


def _steps(corners: Array, count: int, size: float) -> Array:
    """Return points (count + 1, 3) on the line, each at a distance ``size`` from the last one."""
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
    """Return cables that hang between their drones, and lie on the ground where they reach it.

    They are chains of segments of exactly their length, n of (segments + 1, 3) [m], that end within
    a segment of their drones (2n, 3) [m]: the settling draws these back. ``ground`` is its height.
    """
    chains, floor = [], ground + 0.5 * ropes.preset.diameter
    for k, (count, size) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        q, r, whole = drones[2 * k], drones[2 * k + 1], float(count * size)
        if (apart := float(np.linalg.norm(r - q))) > whole * (1.0 + 1e-6):
            words = f"its drones start {apart:.4g} m apart, more than its {whole:.4g} m"
            raise ShapeError(f"cable {k}: {words}; lengthen it, or start closer")
        curve = hanging_cable(q, r, max(whole, apart), int(count) + 1)
        along, lies = unit(np.diff(curve, axis=0), fallback=-UP), np.min(curve[:, 2]) < floor
        if lies:
            along = _lying(q, r, int(count), float(size), floor)
        chain = size * np.vstack([np.zeros(3), np.cumsum(along, axis=0)])
        chain += 0.5 * (q + r - chain[-1])  # what is left over is shared by both ends
        if lies:
            chain[:, 2] += floor - np.min(chain[:, 2])
        chains.append(chain)
    return chains


def _lying(q: Array, r: Array, count: int, size: float, floor: float) -> Array:
    """Return the directions (count, 3) of links, ``size`` long, from q to the floor and to r [m].

    From the floor a cable rises as a catenary whose parameter a, its tension over its weight per
    length, is equal at both ends: at an arc s its slope is s / a. Where the cable is too long for
    any tension, a is one link, and the part on the floor goes to and fro by an equal angle.
    """
    offset, whole = r - q, count * size
    span = float(np.hypot(*offset[:2]))
    forward = unit(offset * [1.0, 1.0, 0.0], fallback=EAST)
    heights = np.maximum(np.array([q[2], r[2]]) - floor, 0.0)

    def surplus(a: float) -> float:
        """Return the length [m] on the floor, less the distance that it has to bridge there."""
        arcs = np.sqrt(heights * (heights + 2.0 * a))
        return float(whole - span - np.sum(arcs - a * np.arcsinh(arcs / a)))

    a, tightest = size, 1e3 * whole
    if surplus(a) < 0.0 < surplus(tightest):
        a = brentq(surplus, a, tightest)
    arcs = np.sqrt(heights * (heights + 2.0 * a))
    lying = max(whole - float(np.sum(arcs)), size)
    share = min(max(1.0 - surplus(a) / lying, 0.0), 1.0)
    place = size * (np.arange(count) + 0.5)
    slope = np.maximum(place - whole + arcs[1], 0.0) - np.maximum(arcs[0] - place, 0.0)
    folds = 2 * max(round(lying / (2 * FOLD * size)), 1)
    side = (-1.0) ** np.floor(folds * np.clip((place - arcs[0]) / lying, 0.0, 1.0))
    level = share * forward + math.sqrt(1.0 - share**2) * side[:, None] * np.cross(UP, forward)
    return unit(np.where(slope[:, None] == 0.0, level, forward + (slope / a)[:, None] * UP))


def thickness_allowance(task: Task, diameter: float, segment: float) -> Array:
    """Return (n,) [m]: the additional length with which thick cables take their bends.

    Without it ropes would be too short, and pull harder than planned. It is what ``bend_lengths``
    says of both clasps of a cable and, of one that is wrapped around an object, half a diameter
    times the angle by which it turns there, seen from above.
    """
    layout, allowance = task.team.layout, np.zeros(task.team.robots)
    longer = bend_lengths(task, diameter, segment)
    np.add.at(allowance, layout.ahead, longer)
    np.add.at(allowance, layout.behind, longer)
    if task.formed.any():
        leaving, arriving = (unit(each * [1.0, 1.0, 0.0]) for each in _edge_ends(task))
        turns = np.arccos(np.clip(dot(leaving, arriving), -1.0, 1.0))
        allowance += 0.5 * diameter * np.mean(turns, axis=0)
    return allowance


def bend_lengths(task: Task, diameter: float, segment: float) -> Array:
    """Return (clasps,) [m]: by how much each of a clasp's two cables is longer for its thickness.

    Where a cable turns by ``π - φ`` about another, φ the angle between the edges there, its centre
    line follows a circle of one diameter whose far side is half a diameter from the vertex. That is
    ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. A chain of segments cannot
    follow the circle; it uses up ``COARSENESS · segment²/diameter · cos(φ/2)`` besides. It is the
    mean over the time with a hitch, or with what that grips: ropes too short grip harder.
    """
    layout = task.team.layout
    if not task.formed.any():
        return np.zeros(len(layout.clasps))
    leaving, arriving = _edge_ends(task)
    cosine = dot(leaving[:, layout.ahead], arriving[:, layout.behind])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    half = np.cos(0.5 * turn)
    bends = diameter * (np.pi - turn - half) + COARSENESS * segment**2 / diameter * half
    return np.asarray(np.mean(bends, axis=0))


def _edge_ends(task: Task) -> tuple[Array, Array]:
    """Return unit vectors (samples, n, 3) along edges at both ends, as ``bend_lengths`` samples."""
    layout, motion = task.team.layout, task.motion
    carrying = task.formed & np.any(task.cargo.carried, axis=-1)
    if motion is None or motion.contacts is None or not carrying.any():
        straight = unit(layout.edges(task.vertices[task.formed]))
        return straight, straight
    vertices = task.vertices[carrying]
    times = np.clip(task.t[carrying], *motion.contacts.breaks[[0, -1]])
    first, last = np.moveaxis(motion.contacts.at(times), 2, 0)
    return unit(first - vertices[:, layout.starts]), unit(vertices[:, layout.ends] - last)


def legs_aside(task: Task, diameter: float) -> Array:
    """Return (samples, 2n, 3) [m]: where legs of thick cables end, from where thin ones do.

    The circle of a bend, see ``bend_lengths``, leads a leg past the vertex, ``1 - sin(h)/2``
    diameters aside from its edge, h half of the angle between leg and edge. Legs that ended at
    their drones would point too far inward; triangles, which are soft, would give way by 2 cm. As
    far as the tension of a leg is below its team's, it ends nearer to its drone.
    """
    layout, team = task.team.layout, task.team
    edges = unit(layout.edges(task.vertices))
    along = np.stack([edges, -edges], axis=-2).reshape(task.setpoints.positions.shape)
    legs = unit(task.setpoints.positions - task.vertices[:, layout.pulled_to])
    cosine = dot(legs, along)[..., None]
    half = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))
    tight = np.repeat(np.clip(task.tensions / team.tension, 0.0, 1.0), 2, axis=-1)
    away: Array = unit(cosine * legs - along) * (1.0 - 0.5 * np.sin(half)) * tight[..., None]
    return diameter * away


def linking_number(one: Array, other: Array) -> int:
    """Return Gauss's linking number of two closed polygons (corners, 3) [m], with its sign.

    It is the sum over all pairs of edges of the solid angle that their directions span, over 4π
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
    """Return (n, n), symmetric: the linking number of every pair of cables (nodes, 3) [m].

    Each cable is closed by the straight line between its drones. That is meaningful with the drones
    at the hitch or before it is formed, where these lines stay clear of the other cables.
    """
    matrix = np.zeros((len(cables),) * 2, dtype=np.int64)
    for i, j in combinations(range(len(cables)), 2):
        matrix[i, j] = matrix[j, i] = linking_number(cables[i], cables[j])
    return matrix
