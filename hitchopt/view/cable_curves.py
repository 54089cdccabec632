"""Curves of the cables over time: hanging freely, or hooked into each other at the clasps.

A free cable is the catenary of its length. A hooked one consists of leg, bend, edge, bend and leg;
what its length exceeds the chords by hangs in the spans as equal tension would have it, in
proportion to their cubed lengths. At a clasp both cables turn on half circles about the vertex, in
planes at right angles, each open to its own side, like links of a chain. Which strand passes over
the other follows from the drones' turning when the hitch was tied (``clasp_senses``).

While neighbours turn about each other the contact of their cables is not known: there the drawn
curve passes gradually from the one shape to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import States
from hitchopt.values import Array
from hitchopt.view.wrapped_edges import wrapped_lengths, wrapped_points

LEG, BEND, EDGE = 6, 9, 9
"""Number of points of a leg, a bend and an edge."""

POINTS = 2 * LEG + 2 * BEND + EDGE
"""Number of points of a cable, from q to r."""

CLASPS = (LEG + BEND // 2, LEG + BEND + EDGE + BEND // 2)
"""The two points of a cable in the middles of its bends, nearest to the vertices."""

REACH = 3.0
"""Distance from a vertex, in bends' radii, from which on a cable is straight."""

THICKNESS, THINNEST, THICKEST = 0.0035, 0.004, 0.03
"""Radius of a drawn cable as a share of the scene's extent, and its bounds [m]."""

BEND_RADIUS = 2.2
"""Radius of a bend in radii of the drawn cable: neighbours then clear each other."""

LEG_SHARE = 0.2
"""Largest radius of a bend as a share of the shortest leg or edge."""

NO_SLACK = 1e-4
"""Share of its length by which a weightless cable may exceed its parts and still be straight."""

SHORTEST = 1e-9
"""Least length of a span [m]: a chain's ends have legs of none."""

HOOKED = frozenset({CableState.TIGHTENING, CableState.HITCHED})


@dataclass(frozen=True, eq=False)
class CableCurves:
    """Drawn cables over time.

    Attributes
    ----------
    points: (times, n, POINTS, 3) [m], from q to r.
    radius: of a drawn cable [m]; chosen to be visible, not the real one.
    """

    points: Array
    radius: float


def cable_curves(motion: Motion, states: States, thickness: float = THICKNESS) -> CableCurves:
    """Return the cables of a plan at the times of its states (times,).

    Parameters
    ----------
    motion, states: the plan.
    thickness: radius of a drawn cable as a share of the scene's extent.
    """
    n, extent = motion.team.robots, float(np.max(np.ptp(states.positions, axis=(0, 1)), initial=0))
    radius = float(np.clip(thickness * extent, THINNEST, THICKEST))
    if n == 0:
        return CableCurves(np.zeros((len(states.t), 0, POINTS, 3)), radius)
    times, hooked = _hooked_times(motion, states.t)
    points = _hanging(motion, states.positions, np.linspace(0.0, 1.0, POINTS))
    if np.any(hooked > 0.0):
        some = np.flatnonzero(hooked > 0.0)
        vertices = motion.vertices.at(motion.vertices.breaks[0] + times[some])
        radius = min(radius, _largest_radius(motion.team.layout, states.positions[some], vertices))
        contacts = None
        if motion.contacts is not None:
            contacts = motion.contacts.at(motion.contacts.breaks[0] + times[some])
        bent = _bent(motion, states.positions[some], vertices, BEND_RADIUS * radius, contacts)
        free = _hanging(motion, states.positions[some], _shares(bent))
        share = hooked[some, None, None, None]
        points[some] = share * bent + (1.0 - share) * free
    floor = motion.requirements.floor + radius
    lowest = np.minimum(floor, np.min(states.positions[..., 2]))
    points[..., 2] = np.maximum(points[..., 2], lowest)
    return CableCurves(points, radius)


def clasp_senses(motion: Motion) -> Array:
    """Return (clasps,) 1 where q went up over r when the clasp was tied, else -1.

    A hitch that is there at first is taken to have been tied with every q going up first, as the
    check ``interlacing`` takes it.
    """
    layout = motion.team.layout
    runs = [list(run) for _, run in groupby(motion.phases, lambda phase: phase.state)]
    tied = [
        before
        for before, after in pairwise(runs)
        if before[0].state is CableState.CLASPING and after[0].state in HOOKED
    ]
    if not tied:
        return np.ones(len(layout.clasps))
    start, end = tied[0][0].start, tied[0][-1].end
    heights = motion.drones.at([start, start + 0.25 * (end - start)])[..., 2]
    apart = heights[:, 2 * layout.ahead] - heights[:, 2 * layout.behind + 1]
    return np.where(apart[1] >= apart[0], 1.0, -1.0)


def _hooked_times(motion: Motion, t: Array) -> tuple[Array, Array]:
    """Return at which times vertices are to be taken, and how far cables are hooked (times,).

    That is from 0, hanging free, to 1. It rises in the second half of the clasping that leads to a
    hitch, and falls in the first half of the one that undoes it.
    """
    times, hooked = t.copy(), np.zeros(len(t))
    runs = [list(run) for _, run in groupby(motion.phases, lambda phase: phase.state)]
    for i, run in enumerate(runs):
        start, end, state = run[0].start, run[-1].end, run[0].state
        here = (t >= start) & (t <= end)
        if state in HOOKED:
            hooked[here], times[here] = 1.0, t[here]
        if state is not CableState.CLASPING:
            continue
        along = (t - start) / (end - start)
        here &= hooked < 1.0
        for j, share, vertices in (
            (i + 1, 2.0 * along - 1.0, end),
            (i - 1, 1.0 - 2.0 * along, start),
        ):
            if 0 <= j < len(runs) and runs[j][0].state in HOOKED:
                x = np.clip(share[here], 0.0, 1.0)
                hooked[here], times[here] = x * x * (3.0 - 2.0 * x), vertices
    return times, hooked


def _hanging(motion: Motion, drones: Array, share: Array) -> Array:
    """Return free cables (times, n, POINTS, 3) between drones (times, 2n, 3) [m].

    Parameters
    ----------
    motion: the plan.
    drones: (times, 2n, 3) [m]
    share: where on each cable its points are, from 0 to 1, (POINTS,) or (times, n, POINTS).
    """
    q, r = drones[:, 0::2], drones[:, 1::2]
    hung = _spread(Catenary.between(q, r, motion.team.cable_length))
    return _sagging(q, r, hung, hung.place(share))


def _shares(curves: Array) -> Array:
    """Return how far along curves (…, points, 3) their points are, from 0 to 1, (…, points)."""
    along = np.cumsum(np.linalg.norm(np.diff(curves, axis=-2), axis=-1), axis=-1)
    along = np.concatenate([np.zeros_like(along[..., :1]), along], axis=-1)
    return np.asarray(along / along[..., -1:])


def _spread(hung: Catenary) -> Catenary:
    """Return cables (…) as (…, 1), for several places on each."""
    return Catenary(*(np.asarray(part)[..., None] for part in vars(hung).values()))


def _sagging(first: Array, second: Array, hung: Catenary, mu: Array) -> Array:
    """Return the points (…, points, 3) at places μ (…, points) of cables between their ends."""
    along = 0.5 * (1.0 + mu)[..., None]
    points = (1.0 - along) * first[..., None, :] + along * second[..., None, :]
    points[..., 2] -= hung.depth(mu)
    return np.asarray(points)


def _bent(
    motion: Motion, drones: Array, vertices: Array, radius: float, contacts: Array | None
) -> Array:
    """Return hooked cables (times, n, POINTS, 3); bends have a radius [m].

    Contacts (times, n, 2, 3) [m] are where edges are wrapped around something.
    """
    team, layout = motion.team, motion.team.layout
    q, r = drones[:, 0::2], drones[:, 1::2]
    a, b = vertices[:, layout.starts], vertices[:, layout.ends]
    ends = ((q, a), (a, b), (b, r))
    chords = np.stack([np.linalg.norm(y - x, axis=-1) for x, y in ends], axis=-1)
    if contacts is not None:
        chords[..., 1] = wrapped_lengths(a, b, contacts)
    extra = team.cable_length - np.sum(chords, axis=-1)
    straight = NO_SLACK * team.cable_length if team.cable_density == 0.0 else 0.0
    extra = np.where(extra <= straight, 0.0, extra)
    cubes = chords**3
    lengths = chords + extra[..., None] * cubes / np.sum(cubes, axis=-1, keepdims=True)
    trim = REACH * radius / np.maximum(chords, SHORTEST)
    q_side, r_side = _bends(motion, drones, vertices, radius)
    with_q, with_r = layout.has_leg[:, 0], layout.has_leg[:, 1]
    zero = np.zeros_like(trim[..., 0])
    edge_trims = (np.where(with_q, trim[..., 1], 0.0), np.where(with_r, trim[..., 1], 0.0))
    cuts = ((zero, trim[..., 0]), edge_trims, (trim[..., 2], zero))
    parts = [
        _cut_span(x, y, lengths[..., i], cuts[i], count)
        for i, ((x, y), count) in enumerate(zip(ends, (LEG, EDGE, LEG), strict=True))
    ]
    if contacts is not None:
        wrapped = np.any(contacts[..., 0, :] != 0.5 * (a + b), axis=-1)
        before, after = (edge_trims[0][..., None], edge_trims[1][..., None])
        shares = before + (1.0 - before - after) * np.linspace(0.0, 1.0, EDGE)
        around = wrapped_points(a, b, contacts, shares)
        parts[1] = np.where(wrapped[..., None, None], around, parts[1])
    return np.concatenate([parts[0], q_side, parts[1], r_side, parts[2]], axis=2)


def _cut_span(
    first: Array, second: Array, length: Array, cuts: tuple[Array, Array], count: int
) -> Array:
    """Return ``count`` points of hanging spans without shares of them, ``cuts``, at both ends."""
    before, after = cuts
    grid = np.linspace(0.0, 1.0, count)
    share = before[..., None] + (1.0 - before - after)[..., None] * grid
    hung = _spread(Catenary.between(first, second, np.maximum(length, SHORTEST)))
    return _sagging(first, second, hung, np.clip(2.0 * share - 1.0, -1.0, 1.0))


def _bends(motion: Motion, drones: Array, vertices: Array, radius: float) -> tuple[Array, Array]:
    """Return the bends of every cable at its edge's start and end, (times, n, BEND, 3) each.

    At a chain's ends there is none, and all of its points are the vertex.
    """
    layout = motion.team.layout
    edges = unit(layout.edges(vertices))
    p, k, j = vertices[:, layout.clasps], layout.ahead, layout.behind
    q_leg = unit(drones[:, 2 * k] - p)
    r_leg = unit(drones[:, 2 * j + 1] - p)
    sense = clasp_senses(motion)[:, None]
    turn = np.linspace(0.5 * np.pi, -0.5 * np.pi, BEND)
    q_side = np.repeat(vertices[:, layout.starts, None], BEND, axis=2)
    r_side = np.repeat(vertices[:, layout.ends, None], BEND, axis=2)
    # Seen from above, the cable that goes up first is over at its edge and under at its leg.
    for legs, along, under, where, bends, order in (
        (q_leg, edges[:, k], -sense, k, q_side, turn),
        (r_leg, -edges[:, j], sense, j, r_side, turn[::-1]),
    ):
        opening, aside = unit(legs + along), unit(legs - along)
        across = unit(np.cross(opening, aside))
        across = across * np.where(across[..., 2:] < 0.0, -1.0, 1.0)
        leg_side = unit(aside + under * across)
        arc = np.sin(order)[:, None] * leg_side[..., None, :]
        arc = arc - np.cos(order)[:, None] * opening[..., None, :]
        bends[:, where] = p[..., None, :] + radius * arc
    return q_side, r_side


def _largest_radius(layout: Layout, drones: Array, vertices: Array) -> float:
    """Return the largest radius [m] of a drawn cable whose bends fit the shortest leg or edge."""
    legs = np.linalg.norm(drones - vertices[:, layout.anchors], axis=-1)
    mask: NDArray[np.bool_] = layout.has_leg.ravel()
    edges = np.linalg.norm(layout.edges(vertices), axis=-1)
    shortest = min(float(np.min(legs[:, mask], initial=np.inf)), float(np.min(edges)))
    return LEG_SHARE * shortest / BEND_RADIUS
