"""Curves of the cables over time: hanging freely, bent around an object, or hooked at the clasps.

A free cable is a catenary. A hooked cable consists of leg, bend, edge, bend and leg; its slack is
split among the spans in proportion to their cubed lengths, as under equal tension. At a clasp both
cables turn on half circles about the vertex in perpendicular planes, like links of a chain. The
turning senses of the drones determine the upper strand (``clasp_senses``).

While neighbours turn about each other, the contact of their cables is unknown: the drawn curve is a
blend of both shapes.
"""

from __future__ import annotations

from itertools import groupby, pairwise

import numpy as np

from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.values import Array

LEG = 6  # Number of points of a leg
BEND = 9  # Number of points of a bend
EDGE = 9  # Number of points of an edge
POINTS = 2 * LEG + 2 * BEND + EDGE  # Number of points of a cable, from q to r
# Indices of a cable's points in the middles of its bends, nearest to the vertices
CLASPS = (LEG + BEND // 2, LEG + BEND + EDGE + BEND // 2)
THICKNESS = 0.0035  # Radius of a drawn cable as a fraction of the scene's extent
MIN_RADIUS = 0.004  # Minimum radius of a drawn cable [m]
MAX_RADIUS = 0.03  # Maximum radius of a drawn cable [m]
# Radius of a bend in radii of the drawn cable, so that neighbours clear each other
BEND_RADIUS = 2.2
STRAIGHT_AT = 3.0  # Distance from a vertex beyond which a cable is straight, in bend radii
MAX_BEND_SHARE = 0.2  # Maximum radius of a bend, as a fraction of the shortest leg or edge
# Relative slack up to which a weightless cable is straight
SLACK_TOLERANCE = 1e-4
UP = np.array([0.0, 0.0, 1.0])
MIN_LENGTH = 1e-9  # Minimum length of a span [m], since a chain's ends have no legs


def cable_curves(
    motion: Motion, states: States, thickness: float = THICKNESS
) -> tuple[Array, float]:
    """Return the cables of a plan (times, n, POINTS, 3) [m], from q to r, and their drawn radius.

    ``thickness`` is the radius as a fraction of the scene's extent.
    """
    drones = states.positions
    extent = float(np.max(np.ptp(drones, axis=(0, 1)), initial=0))
    radius = float(np.clip(thickness * extent, MIN_RADIUS, MAX_RADIUS))
    if not motion.team.has_cables:
        return np.zeros((len(states.t), 0, POINTS, 3)), radius
    points, radius = _above_and_below_ground(motion, states, radius)
    floor = motion.requirements.ground_or(-np.inf) + radius
    points[..., 2] = np.maximum(points[..., 2], np.minimum(floor, np.min(drones[..., 2])))
    return points, radius


def _above_and_below_ground(
    motion: Motion, states: States, max_radius: float
) -> tuple[Array, float]:
    """Return the cables, which may sag below the ground, and their drawn radius."""
    t = motion.drones.breaks[0] + states.t
    drones = states.positions
    radius = max_radius
    times, shares = _hooked_shares(motion, t)
    points = _free_cables(motion, drones, np.linspace(0.0, 1.0, POINTS))
    samples = np.flatnonzero(shares > 0.0)
    if len(samples):
        times = times[samples]
        drones = drones[samples]
        vertices = motion.vertices.at(times)
        contacts = motion.contacts.at(times) if motion.has_wraps else None
        layout = motion.team.layout  # bends fit the shortest leg or edge
        legs = length(drones - vertices[:, layout.anchors])[:, layout.has_leg.ravel()]
        shortest = min(np.min(legs, initial=np.inf), np.min(length(layout.edges(vertices))))
        radius = min(radius, MAX_BEND_SHARE * float(shortest) / BEND_RADIUS)
        hooked = _hooked_cables(motion, drones, vertices, BEND_RADIUS * radius, contacts)
        along = np.cumsum(np.linalg.norm(np.diff(hooked, axis=-2), axis=-1), axis=-1)
        along = np.concatenate([np.zeros_like(along[..., :1]), along], axis=-1)
        free = _free_cables(motion, drones, along / along[..., -1:])
        share = shares[samples, None, None, None]
        points[samples] = share * hooked + (1.0 - share) * free
    return points, radius


def clasp_senses(motion: Motion) -> Array:
    """Return 1 for clasps (clasps,) whose edge ahead is on top, else -1.

    It is on top if q passes over r during clasping, and where the clasp does not turn.
    """
    layout = motion.team.layout
    ends = motion.drones.breaks[[0, -1]]
    senses = np.ones(len(layout.clasps))

    def rises(times: Array) -> Array:
        heights = motion.drones.at(np.clip(times, *ends))[..., 2]
        return np.asarray(heights[:, 2 * layout.ahead] - heights[:, 2 * layout.behind + 1])

    for (before, start, end), (after, _, _) in pairwise(_state_runs(motion)):
        if before.clasping and after.tied:
            first, later = rises(np.array([start, start + 0.25 * (end - start)]))
            senses = np.where(later >= first, 1.0, -1.0)
            break
    return senses


def _state_runs(motion: Motion) -> list[tuple[CableState, float, float]]:
    """Return the cable states in order, with starts and ends [s]; all tied ones are HITCHED."""
    each = (CableState.HITCHED if p.state.tied else p.state for p in motion.phases)
    pairs = groupby(zip(each, motion.phases, strict=True), lambda pair: pair[0])
    runs = [(state, [phase for _, phase in run]) for state, run in pairs]
    return [(state, phases[0].start, phases[-1].end) for state, phases in runs]


def wrapped_edges(first: Array, last: Array, contacts: Array) -> tuple[Array, Array]:
    """Return lengths (…) [m] of edges around an object, and points on them (…, EDGE, 3) [m].

    An edge between ends (…, 3) consists of a tangent, a circular arc between contacts (…, 2, 3) [m]
    and a tangent; the points are its ends and points on the arc.
    """
    start, end = contacts[..., 0, :], contacts[..., 1, :]
    ahead = unit(start - first)
    chord = end - start
    half = 0.5 * np.arccos(np.clip(dot(ahead, unit(last - end)), -1.0, 1.0))
    # The arc is a rational curve, whose middle control point has the weight cos(half).
    s = np.linspace(0.0, 1.0, EDGE - 2)[:, None]
    weight = np.cos(half)[..., None]
    control = weight * start + 0.5 * length(chord)[..., None] * ahead
    ends = (1.0 - s) ** 2 * start[..., None, :] + s**2 * end[..., None, :]
    basis = 2.0 * s * (1.0 - s)
    weights = (1.0 - s) ** 2 + s**2 + basis * weight[..., None]
    arc = (ends + basis * control[..., None, :]) / weights
    arc_length = length(chord) / np.sinc(half / np.pi)
    total = length(start - first) + arc_length + length(last - end)
    return total, np.concatenate([first[..., None, :], arc, last[..., None, :]], axis=-2)


def _hooked_shares(motion: Motion, t: Array) -> tuple[Array, Array]:
    """Return times of the vertices, and fractions of the hooked shape, from 0 to 1 (times,).

    The share rises in the second half of the clasping before a hitch, and falls in the first half
    of the clasping after it.
    """
    times = t.copy()
    shares = np.zeros(len(t))
    no_run = (CableState.NONE, 0.0, 0.0)
    runs = [no_run, *_state_runs(motion), no_run]
    for before, (state, start, end), after in zip(runs, runs[1:], runs[2:], strict=False):
        if state.tied:
            rise, fall = (
                max(0.5 * (b - a), MIN_LENGTH) if other.clasping else MIN_LENGTH
                for other, a, b in (before, after)
            )
            share = np.interp(t, [start - rise, start, end, end + fall], [0.0, 1.0, 1.0, 0.0])
            larger = share > shares
            shares[larger] = share[larger]
            times[larger] = np.clip(t, start, end)[larger]
    return times, _smooth(shares)


def _smooth(share: Array) -> Array:
    """Return smoothed shares, whose slope vanishes at 0 and 1."""
    x = np.minimum(share, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _free_cables(motion: Motion, drones: Array, share: Array) -> Array:
    """Return free cables (times, n, POINTS, 3) between drones (times, 2n, 3) [m].

    Their points are at fractions of each cable, from 0 to 1, (POINTS,) or (times, n, POINTS).
    """
    q, r = drones[:, 0::2], drones[:, 1::2]
    return _sagging(q, r, motion.team.cable_length, share, of_chord=False)


def _sagging(first: Array, second: Array, size: Array, share: Array, *, of_chord: bool) -> Array:
    """Return points (…, points, 3) of cables of lengths (…) [m], at shares of chord or length."""
    catenary = Catenary.between(first, second, np.maximum(size, MIN_LENGTH))
    catenary = Catenary(*(np.asarray(part)[..., None] for part in vars(catenary).values()))
    mu = np.clip(2.0 * share - 1.0, -1.0, 1.0) if of_chord else catenary.parameter(share)
    along = 0.5 * (1.0 + mu)[..., None]
    points = (1.0 - along) * first[..., None, :] + along * second[..., None, :]
    points[..., 2] -= catenary.depth(mu)
    return np.asarray(points)


def _with_slack(motion: Motion, chords: Array, slack: Array) -> Array:
    """Return lengths of cable (…, n, spans) [m] along chords, with shares of slack (…, n) [m]."""
    team = motion.team
    tolerance = SLACK_TOLERANCE * team.cable_length if team.cable_density == 0.0 else 0.0
    slack = np.where(slack <= tolerance, 0.0, slack)[..., None]
    cubes = chords**3
    return np.asarray(chords + slack * cubes / np.sum(cubes, axis=-1, keepdims=True))


def _hooked_cables(
    motion: Motion, drones: Array, vertices: Array, radius: float, contacts: Array | None
) -> Array:
    """Return hooked cables (times, n, POINTS, 3) [m]; edges are wrapped between their contacts.

    ``radius`` is that of bends at clasps [m].
    """
    layout = motion.team.layout
    a, b = vertices[:, layout.starts], vertices[:, layout.ends]
    corners = np.stack([drones[:, 0::2], a, b, drones[:, 1::2]], axis=2)
    chords = length(np.diff(corners, axis=2))
    if contacts is not None:
        chords[..., 1] = wrapped_edges(a, b, contacts)[0]
    lengths = _with_slack(motion, chords, motion.team.cable_length - np.sum(chords, axis=-1))
    trim = STRAIGHT_AT * radius / np.maximum(chords, MIN_LENGTH)
    zero = np.zeros(a.shape[:2])
    before, after = np.moveaxis(np.where(layout.has_leg, trim[..., 1:2], 0.0), -1, 0)
    cuts = ((zero, trim[..., 0]), (before, after), (trim[..., 2], zero))
    parts = []
    for i, count in enumerate((LEG, EDGE, LEG)):
        first, last = cuts[i]
        share = first[..., None] + (1.0 - first - last)[..., None] * np.linspace(0.0, 1.0, count)
        ends = corners[:, :, i], corners[:, :, i + 1]
        parts.append(_sagging(*ends, lengths[..., i], share, of_chord=True))
    if contacts is not None:
        start, end = contacts[..., 0, :], contacts[..., 1, :]
        first, last = (p + STRAIGHT_AT * radius * unit(c - p) for p, c in ((a, start), (b, end)))
        wrapped = wrapped_edges(first, last, contacts)[1]
        is_wrapped = np.any(start != 0.5 * (a + b), axis=-1)
        parts[1] = np.where(is_wrapped[..., None, None], wrapped, parts[1])
    q_side, r_side = _bends(motion, drones, vertices, radius)
    return np.concatenate([parts[0], q_side, parts[1], r_side, parts[2]], axis=2)


def _bends(motion: Motion, drones: Array, vertices: Array, radius: float) -> tuple[Array, Array]:
    """Return the bends of each cable at its edge's start and end, (times, n, BEND, 3) [m] each.

    At a chain's ends all points of the bend are the vertex.
    """
    layout = motion.team.layout
    edges = unit(layout.edges(vertices))
    p = vertices[:, layout.clasps]
    k = layout.ahead
    j = layout.behind
    q_leg = unit(drones[:, 2 * k] - p)
    r_leg = unit(drones[:, 2 * j + 1] - p)
    sense = clasp_senses(motion)[:, None]
    turn = np.linspace(0.5 * np.pi, -0.5 * np.pi, BEND)
    q_side = np.repeat(vertices[:, layout.starts, None], BEND, axis=2)
    r_side = np.repeat(vertices[:, layout.ends, None], BEND, axis=2)
    # A cable that is on top at its edge is below at its leg.
    for legs, along, under, cables, bends, angles in (
        (q_leg, edges[:, k], -sense, k, q_side, turn),
        (r_leg, -edges[:, j], sense, j, r_side, turn[::-1]),
    ):
        opening = unit(legs + along)
        aside = unit(legs - along)
        across = unit(np.cross(opening, aside))
        across = across * np.where(across[..., 2:] < 0.0, -1.0, 1.0)
        leg_side = unit(aside + under * across)
        side, out = np.sin(angles)[:, None], np.cos(angles)[:, None]
        arc = side * leg_side[..., None, :] - out * opening[..., None, :]
        bends[:, cables] = p[..., None, :] + radius * arc
    return q_side, r_side
