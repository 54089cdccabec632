"""Ropes as MuJoCo simulates them: their resolution, first shapes, thickness and links."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, root

from hitchopt.errors import HitchoptError, InputError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Team
from hitchopt.hitch.team import Layout
from hitchopt.simulation.settings import DENSITY, Preset, Settings
from hitchopt.simulation.task import Task
from hitchopt.values import Array, not_negative, per_robot, positive

COURANT = 0.7
"""Largest ratio of the time step to the time in which a transverse wave passes a segment."""

RESERVE = 2.0
"""Tension that a simulation must bear, over the team's; the pull test takes 1.5."""

ROUNDING = 1e-9
"""Tolerance of a count of segments: 2.4 m are 96 of 0.025 m in spite of rounding."""


@dataclass(frozen=True, eq=False)
class Ropes:
    """n cables, each divided into segments of equal length.

    Parameters
    ----------
    lengths: cable lengths (n,) [m].
    density: mass per length [kg/m].
    friction: coefficient between cables, and with the ground.
    preset: resolution.
    """

    lengths: Array
    density: float
    friction: float
    preset: Preset

    def __post_init__(self) -> None:
        lengths = per_robot("lengths", self.lengths, len(self.lengths))
        object.__setattr__(self, "lengths", lengths)
        object.__setattr__(self, "density", positive("density", self.density))
        object.__setattr__(self, "friction", not_negative("friction", self.friction))

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
        wave = COURANT * float(np.min(self.segment_lengths)) / self.preset.time_step
        return self.density * wave**2

    def check_tension(self, tension: float) -> None:
        """Check that the time step suits cables of a given tension [N].

        Raises
        ------
        InputError: a time step that is too long.
        """
        needed = RESERVE * tension
        if self.largest_tension < needed:
            shortest = float(np.min(self.segment_lengths))
            step = COURANT * shortest * math.sqrt(self.density / needed)
            raise InputError(
                "time_step",
                self.preset.time_step,
                f"at most {step:.3g} s for cables of {self.density:g} kg/m in segments of "
                f"{shortest:.3g} m that pull with up to {needed:.3g} N",
                "shorten it, or simulate heavier cables",
            )


def ropes_of(team: Team, settings: Settings, lengths: ArrayLike | None = None) -> Ropes:
    """Return the ropes of a team's cables.

    Parameters
    ----------
    team: supplies what the settings leave open.
    settings: resolution; density and friction where they replace the team's.
    lengths: (n,) [m]; None: the team's.

    Raises
    ------
    InputError: a resolution that cannot bear the team's tension.
    """
    ropes = Ropes(
        team.cable_length if lengths is None else np.asarray(lengths),
        settings.density or team.cable_density or DENSITY,
        team.cable_friction if settings.friction is None else settings.friction,
        settings.preset,
    )
    ropes.check_tension(float(np.max(team.tension)))
    return ropes


CLEARANCE = 3.5
"""Least distance of the two bends of a clasp that is not yet drawn tight, in diameters."""

CLEARANCE_SEGMENTS = 1.7
"""Least distance of the two bends in segments: a bend must consist of several."""

REACH = 2.0
"""Distance from a clasp, over that of its bends, from which on a cable follows the plan."""

BEND = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
"""Corners of a bend: along the direction in which it opens, and across it."""

SAME_RISE = 1e-6
"""Difference of the legs' slopes up to which they rise alike."""

BEYOND = 0.5
"""Length by which a cable's line continues beyond its drone, for its last segments [m]."""

LYING_RADIUS = 0.02
"""Radius of the bends of a cable that lies on the ground, being longer than its place [m]."""

SMALL_SWING, MOST_SWING = 0.1, 2.6
"""Range of the angle by which a lying cable swings to either side [rad]; beyond it ends recede."""

LEAST_PULL, MOST_PULL = 1e-3, 1e3
"""Range of the tension along the floor, in weights of a link and of the cable: from ends that hang
straight down to a cable that is all but taut."""

COARSENESS = 0.15
"""Length that coarse segments use up in a bend of 180°, over the square of a segment's length over
the diameter: within 1 mm at a clasp for regular hitches of n = 3, 6, 12 with segments of 30 mm, and
n = 3, 6 with 10 mm (12 mm thick, 10 g/m at 0.5 N)."""

TINY = 1e-300
"""Least length of a normal [m²]: edges in one plane have none, and span no solid angle."""

UP = np.array([0.0, 0.0, 1.0])
"""Direction opposite to gravity."""


class ShapeError(HitchoptError):
    """Two drones that are farther apart than their cable is long."""


def clasped(ropes: Ropes, layout: Layout, drones: Array, vertices: Array) -> list[Array]:
    """Return the cables of a formed hitch, loosely interlaced; drones are placed slightly inward.

    They are chains of segments of exactly their length, n of (segments + 1, 3) [m]. At a clasp both
    cables bend toward each other and overlap like two links of a chain: cable k is level, cable k-1
    upright within it, its leg below, or above where it rises more than the other one.

    Parameters
    ----------
    ropes: n of them.
    layout: defines which cables meet where.
    drones: (2n, 3) [m]
    vertices: (points, 3) [m]
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
    for k, (count, length) in enumerate(zip(ropes.segments, lengths, strict=True)):
        corners = np.array([*starts[k], *ends[k]])  # built from its middle outward
        middle = len(corners) // 2
        centre = 0.5 * (corners[middle - 1] + corners[middle])
        onward, back = (
            _steps(np.vstack([centre, part]), int(count) // 2, float(length))
            for part in (corners[middle:], corners[:middle][::-1])
        )
        chains.append(np.vstack([back[:0:-1], onward]))
    return chains


def _steps(corners: Array, count: int, length: float) -> Array:
    """Return points (count + 1, 3) on the line, each at ``length`` from the previous one."""
    points, here, leg = [corners[0]], corners[0], 0
    for _ in range(count):
        while leg < len(corners) - 2 and np.linalg.norm(corners[leg + 1] - here) < length:
            leg += 1
        start, along = corners[leg], unit(corners[leg + 1] - corners[leg])
        offset = start - here
        b, c = float(offset @ along), float(offset @ offset) - length**2
        here = start + (np.sqrt(max(b * b - c, 0.0)) - b) * along
        points.append(here)
    return np.array(points)


def hanging(ropes: Ropes, drones: Array, ground: float) -> list[Array]:
    """Return cables that hang between their drones, and lie on the ground where they reach it.

    They are chains of segments of exactly their length, n of (segments + 1, 3) [m].

    Parameters
    ----------
    ropes: n of them.
    drones: (2n, 3) [m]
    ground: height of the ground [m].

    Raises
    ------
    ShapeError: drones farther apart than their cable is long.
    """
    found = []
    floor = ground + 0.5 * ropes.preset.diameter
    for k, (count, length) in enumerate(zip(ropes.segments, ropes.segment_lengths, strict=True)):
        q, r = drones[2 * k], drones[2 * k + 1]
        if np.linalg.norm(r - q) > count * length * (1.0 + 1e-6):
            raise ShapeError(
                f"cable {k}: its drones start {np.linalg.norm(r - q):.4g} m apart, more than its "
                f"{count * length:.4g} m; lengthen it, or start closer"
            )
        chain = _hanging_chain(q, r, int(count), float(length))
        if np.min(chain[:, 2]) < floor:
            lying = _lying_chain(q, r, int(count), float(length), floor)
            chain = chain if lying is None else lying
        found.append(chain)
    return found


def _hanging_chain(q: Array, r: Array, count: int, length: float) -> Array:
    """Return the chain of equal links in equilibrium between q and r: a discrete catenary.

    Where q is straight above r it may end up to a link's length from r, because only whole links
    hang down.
    """
    across = r - q
    level, span = _level(across)
    rank = np.arange(count) - 0.5 * (count - 1)

    def links(unknown: Array) -> tuple[Array, Array]:
        pull, steep = np.exp(unknown[0]), rank + unknown[1]  # in units of one link's weight
        size = np.hypot(pull, steep)
        return length * pull / size, length * steep / size

    def gap(unknown: Array) -> Array:
        x, z = links(unknown)
        return np.array([np.sum(x) - span, np.sum(z) - across[2]]) / (count * length)

    slack = max(1.0 - float(np.linalg.norm(across)) / (count * length), 1e-9)
    for guess in (np.log(count / (5.0 * np.sqrt(slack))), np.log(0.05 * count), 8.0, 0.0):
        found = root(gap, np.array([guess, 0.0]), tol=1e-13)
        if np.max(np.abs(gap(found.x))) < 1e-8:
            break
    x, z = links(found.x)
    return np.vstack([q, q + np.cumsum(x[:, None] * level + z[:, None] * UP, axis=0)])


def _lying_chain(q: Array, r: Array, count: int, length: float, floor: float) -> Array | None:
    """Return the chain that hangs from q down to the floor, lies on it, and rises to r.

    The result is None where no whole link lies: the cable just touches the floor.

    The tension along the floor is equal at both ends. Where the cable is too long for any tension,
    the two ends hang down, and the part between them meanders.

    Parameters
    ----------
    q, r: positions of the drones (3,) [m].
    count, length: number of links, and length of each [m].
    floor: height of a cable on the floor [m].
    """
    level, span = _level(r - q)
    heights = np.maximum(np.array([q[2], r[2]]) - floor, 0.0) / length

    def ends(log_pull: float) -> list[tuple[Array, Array]]:
        return [_risen(float(np.exp(log_pull)), height) for height in heights]

    def surplus(log_pull: float) -> float:
        """Return the number of links on the floor, less those that fit between the two ends."""
        used = sum(len(x) - float(np.sum(x)) for x, _ in ends(log_pull))
        return count - used - span / length

    log_pull, tightest = np.log(LEAST_PULL), np.log(MOST_PULL * count)
    if surplus(log_pull) < 0.0 < surplus(tightest):
        log_pull = brentq(surplus, log_pull, tightest)
    (x_q, z_q), (x_r, z_r) = ends(log_pull)
    lying = count - len(x_q) - len(x_r)
    if lying < 0:
        return None
    aside, forward = _meander(lying, span / length - float(np.sum(x_q) + np.sum(x_r)), length)
    x = np.concatenate([x_q[::-1], forward, x_r])
    z = np.concatenate([-z_q[::-1], np.zeros(lying), z_r])
    y = np.concatenate([np.zeros(len(x_q)), aside, np.zeros(len(x_r))])
    steps = np.column_stack([x, y, z]) @ np.array([level, np.cross(UP, level), UP])
    start = np.array([*q[:2], floor + length * heights[0]])
    return np.vstack([start, start + length * np.cumsum(steps, axis=0)])


def _meander(count: int, reach: float, length: float) -> tuple[Array, Array]:
    """Return the parts across and along (count,) of links that meander on the floor.

    Their direction swings like a sine along the cable, which bends it least: a cable in folds as
    narrow as its links would turn these so fast, when it is picked up, that they stretch. They
    advance by ``reach`` links in all, each of a length [m].
    """
    if count < 2:
        return np.zeros(count), np.ones(count)

    def swing(phases: Array) -> float:
        """Return the largest angle with which links advance by their share."""

        def missing(angle: float) -> float:
            return float(np.mean(np.cos(angle * np.sin(phases)))) - reach / count

        if missing(0.0) <= 0.0:
            return 0.0
        return brentq(missing, 0.0, MOST_SWING) if missing(MOST_SWING) < 0.0 else MOST_SWING

    wide = max(swing(np.linspace(0.0, 2.0 * np.pi, 65)[:-1]), SMALL_SWING)
    periods = round(count * length / (2.0 * np.pi * LYING_RADIUS * wide))
    periods = min(max(periods, 1), max(count // 4, 1))
    phases = 2.0 * np.pi * periods * (np.arange(count) + 0.5) / count
    turned = swing(phases) * np.sin(phases)
    return np.sin(turned), np.cos(turned)


def _risen(pull: float, height: float) -> tuple[Array, Array]:
    """Return the links above the floor, lowest first: their level and upward parts, (links,) each.

    The lowest of them carries part of a link's weight, each of the others a whole link more.

    Parameters
    ----------
    pull: tension along the floor, in weights of a link.
    height: height of the end, in links.
    """
    if height <= 0.0:
        return np.zeros(0), np.zeros(0)
    whole = np.arange(1.0, np.ceil(height + np.sqrt(2.0 * pull * height)) + 2.0)
    reached = np.cumsum(whole / np.hypot(pull, whole))
    rank = np.arange(int(np.searchsorted(reached, height)) + 1)

    def missing(part: float) -> float:
        return float(np.sum((rank + part) / np.hypot(pull, rank + part))) - height

    carried = rank + brentq(missing, 0.0, 1.0)
    size = np.hypot(pull, carried)
    return pull / size, carried / size


def _level(across: Array) -> tuple[Array, float]:
    """Return the horizontal direction (3,) of an offset and its length [m]; x if it is vertical."""
    span = float(np.hypot(across[0], across[1]))
    level = np.array([*across[:2], 0.0]) / span if span > 0.0 else np.array([1.0, 0.0, 0.0])
    return level, span


def thickness_allowance(task: Task, diameter: float, segment: float) -> Array:
    """Return (n,) [m]: the additional length with which thick cables take their bends.

    It concerns the simulation alone, not the flight. Where a cable goes around another, its centre
    line keeps one diameter from the other's, whose far side is half a diameter from the vertex: the
    bend takes length, without which ropes would be too short, and pull harder than planned. It is
    what ``bend_lengths`` says of both clasps of a cable and, of one that is wrapped around an
    object, half a diameter times the angle by which it turns there, seen from above.

    Parameters
    ----------
    task: the plan.
    diameter: of the simulated cables [m].
    segment: length of their segments [m].
    """
    layout = task.team.layout
    allowance = np.zeros(task.team.robots)
    longer = bend_lengths(task, diameter, segment)
    np.add.at(allowance, layout.ahead, longer)
    np.add.at(allowance, layout.behind, longer)
    if task.motion is not None and task.motion.contacts is not None:
        level = (unit(each * [1.0, 1.0, 0.0]) for each in _edge_ends(task))
        allowance += 0.5 * diameter * np.mean(_angles(*level), axis=0)
    return allowance


def bend_lengths(task: Task, diameter: float, segment: float) -> Array:
    """Return (clasps,) [m]: by how much each of a clasp's two cables is longer for its thickness.

    Where a cable turns by ``π - φ`` about another, φ the angle between the edges there, its centre
    line follows a circle of one diameter whose far side is half a diameter from the vertex. That is
    ``(π - φ - cos(φ/2))`` diameters longer than the plan's sharp bend. A chain of segments cannot
    follow the circle; it uses up ``COARSENESS · segment²/diameter · cos(φ/2)`` besides. The result
    is the mean over the time in which the plan has a hitch, or in which it carries what it grips,
    if it does: ropes that are too short then grip harder. It is zero where there is no hitch.
    Parameters are those of ``thickness_allowance``.
    """
    layout = task.team.layout
    if not task.formed.any():
        return np.zeros(len(layout.clasps))
    leaving, arriving = _edge_ends(task)
    turn = _angles(leaving[:, layout.ahead], arriving[:, layout.behind])
    half = np.cos(0.5 * turn)
    bends = diameter * (np.pi - turn - half) + COARSENESS * segment**2 / diameter * half
    longer: Array = np.mean(bends, axis=0)
    return longer


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


def _angles(first: Array, second: Array) -> Array:
    """Return the angles (…) [rad] between unit vectors (…, 3)."""
    return np.asarray(np.arccos(np.clip(np.sum(first * second, axis=-1), -1.0, 1.0)))


def linking_number(one: Array, other: Array) -> int:
    """Return Gauss's linking number of two closed polygons, with its sign.

    It is the sum over all pairs of edges of the solid angle that their directions span, over 4π
    (Banchoff 1976; Klenin and Langowski 2000).

    Parameters
    ----------
    one, other: (corners, 3) [m], the last joined to the first; apart from each other.
    """
    a, b = one[:, None], np.roll(one, -1, axis=0)[:, None]
    c, d = other[None], np.roll(other, -1, axis=0)[None]
    ac, ad, bc, bd = c - a, d - a, c - b, d - b
    normals = [np.cross(ac, ad), np.cross(ad, bd), np.cross(bd, bc), np.cross(bc, ac)]
    units = [n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), TINY) for n in normals]
    angles = sum(
        np.arcsin(np.clip(np.sum(units[i] * units[(i + 1) % 4], axis=-1), -1.0, 1.0))
        for i in range(4)
    )
    signs = np.sign(np.sum(np.cross(d - c, b - a) * ac, axis=-1))
    return round(float(np.sum(angles * signs)) / (4.0 * np.pi))


def linking_matrix(cables: list[Array]) -> NDArray[np.int64]:
    """Return (n, n), symmetric: the linking number of every pair of cables (nodes, 3) [m].

    Each cable is closed by the straight line between its drones. That is meaningful with the drones
    at the hitch or before it is formed, where these lines stay clear of the other cables; in
    between a line may pass through a cable, which changes the number although no cable passes
    another. Pairs whose boxes do not meet are not linked: the number of the others grows with n
    alone where cables reach their neighbours only.
    """
    n = len(cables)
    lower, upper = (np.array([end(cable, axis=0) for cable in cables]) for end in (np.min, np.max))
    meet = np.all((lower[:, None] <= upper[None]) & (lower[None] <= upper[:, None]), axis=-1)
    found = np.zeros((n, n), dtype=np.int64)
    for i, j in np.argwhere(np.triu(meet, 1)):
        found[i, j] = found[j, i] = linking_number(cables[i], cables[j])
    return found
