"""Curves of the cables over time: hanging freely, or hooked into each other at the clasps.

A free cable is the catenary of its length. A hooked one consists of leg, bend, edge, bend and leg;
what its length exceeds the chords by hangs in the spans as equal tension would have it, in
proportion to their cubed lengths. At a clasp both cables turn on half circles about the vertex, in
planes at right angles, each open to its own side, like links of a chain. Which strand passes over
the other follows from how drones turned when the hitch was tied (``turned_senses``). Where a pair
rolls open, bends fade until both cables run straight, one just over the other.

While neighbours turn about each other the contact of their cables is not known: there the drawn
curve passes gradually from the one shape to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.team import Layout
from hitchopt.motion.chapters import parts_at, parts_of
from hitchopt.motion.motion import HITCHED_STATE, CableState, Motion
from hitchopt.motion.states import States
from hitchopt.values import Array

LEG, BEND, EDGE = 6, 9, 9  # Number of points of a leg, a bend and an edge
POINTS = 2 * LEG + 2 * BEND + EDGE  # Number of points of a cable, from q to r
# The two points of a cable in the middles of its bends, nearest to the vertices
CLASPS = (LEG + BEND // 2, LEG + BEND + EDGE + BEND // 2)
# Radius of a drawn cable as a share of the scene's extent, and its bounds [m]
THICKNESS, THINNEST, THICKEST = 0.0035, 0.004, 0.03
# Radius of a bend in radii of the drawn cable: neighbours then clear each other; distance from a
# vertex, in bends' radii, from which on a cable is straight; and largest radius of a bend as a
# share of the shortest leg or edge
BEND_RADIUS, REACH, LEG_SHARE = 2.2, 3.0, 0.2
# Share of its length by which a weightless cable may exceed its parts and still be straight
NO_SLACK = 1e-4
UP = np.array([0.0, 0.0, 1.0])
SHORTEST = 1e-9  # Least length of a span [m], as a chain's ends have legs of none
HOOKED = HITCHED_STATE | {CableState.TIGHTENING}
OPENING = HITCHED_STATE - {CableState.HITCHED}  # States in which clasps may be open
# Share of a clasp's contact from which on its bends are drawn whole, and reach, in their radii, of
# what replaces them without any; least change of heights where a pair rolls [m], and times probed
WHOLE, LONGER, ROLLED, PROBES = 0.5, 2.0, 0.01, 17

Senses = dict[tuple[int, int], float]  # 1 where the edge ahead is on top, else -1


def cable_curves(
    motion: Motion, states: States, thickness: float = THICKNESS
) -> tuple[Array, float]:
    """Return the cables of a plan (times, n, POINTS, 3) [m], from q to r, and their drawn radius.

    ``thickness`` is that radius as a share of the scene's extent: it is chosen to be visible.
    """
    n, extent = motion.team.robots, float(np.max(np.ptp(states.positions, axis=(0, 1)), initial=0))
    radius = float(np.clip(thickness * extent, THINNEST, THICKEST))
    points = np.zeros((len(states.t), n, POINTS, 3))
    if n == 0:
        return points, radius
    pairs = states.positions.reshape(-1, n, 2, 3)
    known: Senses = {}
    for each in parts_of(motion):
        known |= turned_senses(each.motion)
    for part, here, robots in parts_at(motion, states.t):
        drones = pairs[np.ix_(here, robots)].reshape(len(here), -1, 3)
        at = motion.drones.breaks[0] + states.t[here]
        points[np.ix_(here, robots)], radius = _curves(part, at, drones, radius, known)
    floor = motion.requirements.floor + radius
    points[..., 2] = np.maximum(points[..., 2], np.minimum(floor, np.min(states.positions[..., 2])))
    return points, radius


@dataclass(frozen=True, eq=False)
class _Bending:
    """How cables bend at clasps: over one another, on circles."""

    radius: float  # [m]
    senses: Array  # (clasps,) 1 where the edge ahead is on top, else -1
    rolls: NDArray[np.bool_]  # (times,) whether clasps may be open, and cables straight there


def _curves(
    motion: Motion, t: Array, drones: Array, radius: float, known: Senses
) -> tuple[Array, float]:
    """Return the cables of a part of a plan at times on its clock, and their drawn radius.

    That is at most the given one; ``known`` are the senses of clasps that do not turn in it.
    """
    times, hooked = _hooked_times(motion, t)
    points = _hanging(motion, drones, np.linspace(0.0, 1.0, POINTS))
    some = np.flatnonzero(hooked > 0.0)
    if len(some):
        at = times[some]
        drones, vertices = drones[some], motion.vertices.at(at)
        contacts = None if motion.contacts is None else motion.contacts.at(at)
        radius = min(radius, _largest_radius(motion.team.layout, drones, vertices))
        piece = np.searchsorted(motion.drones.breaks[1:-1], at, side="right")
        own = known | turned_senses(motion)
        senses = np.array([own.get(pair, 1.0) for pair in _clasped(motion)])
        bending = _Bending(BEND_RADIUS * radius, senses, motion.in_states(OPENING)[piece])
        bent = _bent(motion, drones, vertices, bending, contacts)
        along = np.cumsum(np.linalg.norm(np.diff(bent, axis=-2), axis=-1), axis=-1)
        along = np.concatenate([np.zeros_like(along[..., :1]), along], axis=-1)
        free = _hanging(motion, drones, along / along[..., -1:])
        share = hooked[some, None, None, None]
        points[some] = share * bent + (1.0 - share) * free
    return points, radius


def turned_senses(motion: Motion) -> Senses:
    """Return 1 where the edge ahead of a clasp is on top, else -1, by the robots of its r and q.

    It is where q goes up over r as they clasp, or down under it as they roll, be it back; clasps
    that do not turn are left out.
    """
    layout, ends = motion.team.layout, motion.drones.breaks[[0, -1]]
    senses = np.zeros(len(layout.clasps))

    def rises(times: Array) -> Array:
        heights = motion.drones.at(np.clip(times, *ends))[..., 2]
        return np.asarray(heights[:, 2 * layout.ahead] - heights[:, 2 * layout.behind + 1])

    for (before, start, end), (after, _, _) in pairwise(_runs(motion)):
        if (before, after) == (CableState.CLASPING, CableState.HITCHED):
            first, later = rises(np.array([start, start + 0.25 * (end - start)]))
            senses = np.where(later >= first, 1.0, -1.0)
            break
    for phase in motion.phases:
        if phase.state is CableState.ROLLING:
            rise = rises(np.linspace(phase.start, phase.end, PROBES))
            most = np.take_along_axis(rise, np.argmax(np.abs(rise), axis=0)[None], axis=0)[0]
            senses = np.where(np.ptp(rise, axis=0) > ROLLED, -np.sign(most), senses)
    return {pair: x for pair, x in zip(_clasped(motion), senses.tolist(), strict=True) if x}


def _clasped(motion: Motion) -> list[tuple[int, int]]:
    """Return the robots of r and q at every clasp."""
    layout, labels = motion.team.layout, np.array(motion.team.labels)
    both = labels[layout.behind].tolist(), labels[layout.ahead].tolist()
    return list(zip(*both, strict=True))


def _runs(motion: Motion) -> list[tuple[CableState, float, float]]:
    """Return the states of the cables one after the other, with their starts and ends [s].

    Whatever is hooked is HITCHED here.
    """
    runs = groupby(motion.phases, lambda p: CableState.HITCHED if p.state in HOOKED else p.state)
    listed = [(state, list(run)) for state, run in runs]
    return [(state, run[0].start, run[-1].end) for state, run in listed]


def wrapped_edges(first: Array, last: Array, contacts: Array) -> tuple[Array, Array]:
    """Return lengths (…) [m] of edges around an object, and points on them (…, EDGE, 3) [m].

    An edge between ends (…, 3) is a tangent, an arc of a circle and a tangent; the points are its
    ends and on its arc. At contacts (…, 2, 3) [m] it meets and leaves the object.
    """
    start, end = contacts[..., 0, :], contacts[..., 1, :]
    ahead, chord = unit(start - first), end - start
    half = 0.5 * np.arccos(np.clip(dot(ahead, unit(last - end)), -1.0, 1.0))
    # A circle's arc is a rational curve; its middle control point, where the ends' tangents meet,
    # has the weight cos(half).
    s, weight = np.linspace(0.0, 1.0, EDGE - 2)[:, None], np.cos(half)[..., None]
    meeting = weight * start + 0.5 * length(chord)[..., None] * ahead
    ends = (1.0 - s) ** 2 * start[..., None, :] + s**2 * end[..., None, :]
    rest = 2.0 * s * (1.0 - s)
    shares = (1.0 - s) ** 2 + s**2 + rest * weight[..., None]
    arc = (ends + rest * meeting[..., None, :]) / shares
    bow = length(chord) / np.sinc(half / np.pi)
    total = length(start - first) + bow + length(last - end)
    return total, np.concatenate([first[..., None, :], arc, last[..., None, :]], axis=-2)


def _hooked_times(motion: Motion, t: Array) -> tuple[Array, Array]:
    """Return the times of the vertices, and how far cables are hooked (times,).

    That is from 0, hanging free, to 1. It rises in the second half of the clasping that leads to a
    hitch, and falls in the first half of the one that undoes it.
    """
    times, hooked = t.copy(), np.zeros(len(t))
    nothing = (CableState.NONE, 0.0, 0.0)
    runs = [nothing, *_runs(motion), nothing]
    for before, (state, start, end), after in zip(runs, runs[1:], runs[2:], strict=False):
        if state is CableState.HITCHED:
            rise, fall = (
                max(0.5 * (b - a), SHORTEST) if other is CableState.CLASPING else SHORTEST
                for other, a, b in (before, after)
            )
            share = np.interp(t, [start - rise, start, end, end + fall], [0.0, 1.0, 1.0, 0.0])
            more = share > hooked
            hooked[more], times[more] = share[more], np.clip(t, start, end)[more]
    return times, _smooth(hooked)


def _smooth(share: Array) -> Array:
    """Return shares that rise from 0 to 1 as they do, at rest at both ends."""
    x = np.minimum(share, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _hanging(motion: Motion, drones: Array, share: Array) -> Array:
    """Return free cables (times, n, POINTS, 3) between drones (times, 2n, 3) [m].

    Their points are at shares of each cable, from 0 to 1, (POINTS,) or (times, n, POINTS).
    """
    q, r = drones[:, 0::2], drones[:, 1::2]
    return _sagging(q, r, motion.team.cable_length, share, of_chord=False)


def _sagging(first: Array, second: Array, size: Array, share: Array, *, of_chord: bool) -> Array:
    """Return points (…, points, 3) of cables of sizes (…) [m], at shares of chord or length."""
    hung = Catenary.between(first, second, np.maximum(size, SHORTEST))
    hung = Catenary(*(np.asarray(part)[..., None] for part in vars(hung).values()))
    mu = np.clip(2.0 * share - 1.0, -1.0, 1.0) if of_chord else hung.place(share)
    along = 0.5 * (1.0 + mu)[..., None]
    points = (1.0 - along) * first[..., None, :] + along * second[..., None, :]
    points[..., 2] -= hung.depth(mu)
    return np.asarray(points)


def _bent(
    motion: Motion, drones: Array, vertices: Array, bending: _Bending, contacts: Array | None
) -> Array:
    """Return hooked cables (times, n, POINTS, 3).

    Contacts (times, n, 2, 3) [m] are where edges are wrapped around something.
    """
    team, layout, radius = motion.team, motion.team.layout, bending.radius
    a, b = vertices[:, layout.starts], vertices[:, layout.ends]
    corners = np.stack([drones[:, 0::2], a, b, drones[:, 1::2]], axis=2)
    chords = length(np.diff(corners, axis=2))
    if contacts is not None:
        chords[..., 1] = wrapped_edges(a, b, contacts)[0]
    extra = team.cable_length - np.sum(chords, axis=-1)
    straight = NO_SLACK * team.cable_length if team.cable_density == 0.0 else 0.0
    extra = np.where(extra <= straight, 0.0, extra)
    cubes = chords**3
    lengths = chords + extra[..., None] * cubes / np.sum(cubes, axis=-1, keepdims=True)
    trim, zero = REACH * radius / np.maximum(chords, SHORTEST), np.zeros(a.shape[:2])
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
        first, last = (p + REACH * radius * unit(c - p) for p, c in ((a, start), (b, end)))
        around = wrapped_edges(first, last, contacts)[1]
        wrapped = np.any(start != 0.5 * (a + b), axis=-1)
        parts[1] = np.where(wrapped[..., None, None], around, parts[1])
    q_side, r_side = _bends(motion, drones, vertices, bending)
    return np.concatenate([parts[0], q_side, parts[1], r_side, parts[2]], axis=2)


def _bends(
    motion: Motion, drones: Array, vertices: Array, bending: _Bending
) -> tuple[Array, Array]:
    """Return the bends of every cable at its edge's start and end, (times, n, BEND, 3) each.

    At a chain's ends there is none, and all of its points are the vertex.
    """
    layout, radius = motion.team.layout, bending.radius
    edges = unit(layout.edges(vertices))
    p, k, j = vertices[:, layout.clasps], layout.ahead, layout.behind
    q_leg = unit(drones[:, 2 * k] - p)
    r_leg = unit(drones[:, 2 * j + 1] - p)
    sense, full = bending.senses[:, None], length(edges[:, k] + edges[:, j])
    turn = np.linspace(0.5 * np.pi, -0.5 * np.pi, BEND)
    q_side = np.repeat(vertices[:, layout.starts, None], BEND, axis=2)
    r_side = np.repeat(vertices[:, layout.ends, None], BEND, axis=2)
    # Seen from above, the cable that is over at its edge is under at its leg.
    for legs, along, under, where, bends, order in (
        (q_leg, edges[:, k], -sense, k, q_side, turn),
        (r_leg, -edges[:, j], sense, j, r_side, turn[::-1]),
    ):
        opening, aside = unit(legs + along), unit(legs - along)
        across = unit(np.cross(opening, aside))
        across = across * np.where(across[..., 2:] < 0.0, -1.0, 1.0)
        leg_side = unit(aside + under * across)
        side, out = np.sin(order)[:, None], np.cos(order)[:, None]
        arc = side * leg_side[..., None, :] - out * opening[..., None, :]
        contact = length(legs + along) / np.maximum(WHOLE * full, SHORTEST)
        bent = _smooth(np.where(bending.rolls[:, None], contact, 1.0))[..., None, None]
        line = np.where(side > 0.0, side * legs[..., None, :], -side * along[..., None, :])
        line = LONGER * line - (under / BEND_RADIUS * UP)[:, None] * out**4
        bends[:, where] = p[..., None, :] + radius * (bent * arc + (1.0 - bent) * line)
    return q_side, r_side


def _largest_radius(layout: Layout, drones: Array, vertices: Array) -> float:
    """Return the largest radius [m] of a drawn cable whose bends fit the shortest leg or edge."""
    legs = length(drones - vertices[:, layout.anchors])[:, layout.has_leg.ravel()]
    shortest = min(np.min(legs, initial=np.inf), np.min(length(layout.edges(vertices))))
    return LEG_SHARE * float(shortest) / BEND_RADIUS
