"""Shapes of the cables at the start of a flight: interlaced at a hitch's vertices, or hanging free.

Every shape is a chain of segments of exactly their length, such that no constraint is violated.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq, root

from hitchopt.errors import HitchoptError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.layout import Layout
from hitchopt.simulation.ropes import Ropes
from hitchopt.values import Array

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


class ShapeError(HitchoptError):
    """Two drones that are farther apart than their cable is long."""


def clasped(ropes: Ropes, layout: Layout, drones: Array, vertices: Array) -> list[Array]:
    """Return the cables of a formed hitch, loosely interlaced; drones are placed slightly inward.

    At a clasp both cables bend toward each other and overlap like two links of a chain: cable k
    is level, cable k-1 upright within it, its leg below, or above where it rises more than the
    other one.

    Parameters
    ----------
    ropes: n of them.
    layout: defines which cables meet where.
    drones: (2n, 3) [m]
    vertices: (points, 3) [m]

    Returns
    -------
    n of (segments + 1, 3) [m].
    """
    lengths = ropes.segment_lengths
    gap = max(CLEARANCE * ropes.preset.diameter, CLEARANCE_SEGMENTS * float(np.max(lengths)))
    bends = _bends(layout, drones, vertices, gap)
    return [
        _chain_along(bend, int(count), float(length))
        for bend, count, length in zip(bends, ropes.segments, lengths, strict=True)
    ]


def _bends(layout: Layout, drones: Array, vertices: Array, gap: float) -> list[Array]:
    """Return each cable's corners (corners, 3) [m], from beyond q_k over both vertices to r_k."""
    q, r = drones[0::2], drones[1::2]
    u = unit(layout.edges(vertices))
    p, after, before = vertices[layout.clasps], layout.ahead, layout.behind
    q_hat, r_hat = unit(q[after] - p), unit(r[before] - p)
    q_level = unit(q_hat * [1.0, 1.0, 0.0])
    along = 0.5 * gap * unit(q_level + u[after])  # the direction in which cable k's bend opens
    aside = 0.5 * gap * unit(q_level - u[after])  # to the side of the legs
    side = np.where(r_hat[:, 2] > q_hat[:, 2] + SAME_RISE, -1.0, 1.0)  # of the leg of cable k-1
    lift = side[:, None] * np.array([0.0, 0.0, 0.5 * gap])
    leaving = p + REACH * gap * r_hat
    height = side * (leaving - p)[:, 2]
    leaving[:, 2] += side * np.minimum(-0.5 * gap - height, 0.0)  # past the other cable's bend
    n = layout.robots
    starts: list[list[Array]] = [[q[k]] for k in range(n)]
    ends: list[list[Array]] = [[r[k]] for k in range(n)]
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
    return [np.array([*a, *b]) for a, b in zip(starts, ends, strict=True)]


def _chain_along(corners: Array, count: int, length: float) -> Array:
    """Return a chain (count + 1, 3) along a line with corners, built from its middle outward."""
    middle = len(corners) // 2
    centre = 0.5 * (corners[middle - 1] + corners[middle])
    onward = _steps(np.vstack([centre, corners[middle:]]), count // 2, length)
    back = _steps(np.vstack([centre, corners[:middle][::-1]]), count // 2, length)
    return np.vstack([back[:0:-1], onward])


def _steps(corners: Array, count: int, length: float) -> Array:
    """Return points (count + 1, 3) on the line, each at ``length`` from the previous one."""
    points, here, leg = [corners[0]], corners[0], 0
    for _ in range(count):
        while leg < len(corners) - 2 and np.linalg.norm(corners[leg + 1] - here) < length:
            leg += 1
        start, along = corners[leg], corners[leg + 1] - corners[leg]
        along = along / np.linalg.norm(along)
        offset = start - here
        b, c = float(offset @ along), float(offset @ offset) - length**2
        here = start + (np.sqrt(max(b * b - c, 0.0)) - b) * along
        points.append(here)
    return np.array(points)


def hanging(ropes: Ropes, drones: Array, ground: float) -> list[Array]:
    """Return cables that hang between their drones, and lie on the ground where they reach it.

    Parameters
    ----------
    ropes: n of them.
    drones: (2n, 3) [m]
    ground: height of the ground [m].

    Returns
    -------
    n of (segments + 1, 3) [m].

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
        pull, tilt = np.exp(unknown[0]), unknown[1]  # in units of one link's weight
        steep = rank + tilt
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
    steps = x[:, None] * level + z[:, None] * np.array([0.0, 0.0, 1.0])
    return np.vstack([q, q + np.cumsum(steps, axis=0)])


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
        risen = ends(log_pull)
        used = sum(len(x) - float(np.sum(x)) for x, _ in risen)
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
    side = np.array([-level[1], level[0], 0.0])
    steps = x[:, None] * level + y[:, None] * side + z[:, None] * np.array([0.0, 0.0, 1.0])
    start = np.array([*q[:2], floor + length * heights[0]])
    return np.vstack([start, start + length * np.cumsum(steps, axis=0)])


def _meander(count: int, reach: float, length: float) -> tuple[Array, Array]:
    """Return the parts across and along (count,) of links that meander on the floor.

    Their direction swings like a sine along the cable, which bends it least: a cable in folds as
    narrow as its links would turn these so fast, when it is picked up, that they stretch.

    Parameters
    ----------
    count: number of links.
    reach: distance from their first to their last end, in links.
    length: of a link [m].
    """
    if count < 2:
        return np.zeros(count), np.ones(count)
    swing = _swing(np.linspace(0.0, 2.0 * np.pi, 65)[:-1], reach / count)
    periods = round(count * length / (2.0 * np.pi * LYING_RADIUS * max(swing, SMALL_SWING)))
    periods = min(max(periods, 1), max(count // 4, 1))
    phases = 2.0 * np.pi * periods * (np.arange(count) + 0.5) / count
    turned = _swing(phases, reach / count) * np.sin(phases)
    return np.sin(turned), np.cos(turned)


def _swing(phases: Array, share: float) -> float:
    """Return the largest angle with which meandering links advance by a share of their length."""

    def missing(angle: float) -> float:
        return float(np.mean(np.cos(angle * np.sin(phases)))) - share

    if missing(0.0) <= 0.0:
        return 0.0
    return brentq(missing, 0.0, MOST_SWING) if missing(MOST_SWING) < 0.0 else MOST_SWING


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
    count = int(np.searchsorted(reached, height)) + 1
    rank = np.arange(count)

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
