"""The pre-hitch: where the swap begins, so that no cable comes taut and no drone meets a cable.

Every pair stands as it will in the hitch, its legs shortened by a common share, no nearer than a
smallest radius. The share is searched downward, then the polygon is made smaller, so that cables
reach, or larger, so that pairs on short edges keep off each other, there and on their way out to
the hitch. Where no such place suffices and chords of pairs are too oblique for cables to clasp,
pairs stand across their vertices, whatever their legs.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.planners.forming import SwapSettings
from hitchopt.values import Array

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the hitch's legs, in the order in which they are tried."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 1.15, 1.3, 1.5, 1.8)
"""Scales of the hitch's polygon, in the order in which they are tried if no share suffices."""

TILT = math.radians(45.0)
"""[rad] Tilt of the axis of turning where none is given: it keeps drones out of hanging cables for
any number of robots; level axes do so up to about seven."""

APART = 1.05
"""Separation [1] of a pair while it turns."""

SPAN = 0.97
"""Largest share of a cable that its drones may be apart while it hangs."""

CLEARANCE = 1.05
"""Clearance of drones to cables, over ``Separation.cable``."""

MIN_LINK = 0.05
"""[m] Least length of both cables beyond the point where their chords cross at a clasp, seen from
above, once its pair is exchanged: cables that do not cross there do not clasp."""

ANGLES = 73
"""Number of angles that are measured; the certificate bounds all of them."""

PLACES = np.linspace(0.0, 1.0, 41)
"""Shares of a hanging cable's length, and of straight flights, at which they are measured."""


@dataclass(frozen=True, eq=False)
class SwapEllipses:
    """Ellipses at the clasps on which pairs of drones turn about each other, all on one clock.

    At clasp k the drones ``q_k`` and ``r_{k-1}`` turn about the middle c of their chord, on

        q_k = c + a cos θ t + h sin θ w,      r_{k-1} = c - a cos θ t - h sin θ w,

    t along the chord, w normal to it. The axis of turning is the outward normal of the chord,
    tilted upward, so that the upper drone passes inside and the lower one outside: it would fly
    into the loop of its neighbour's hanging cable else, where edges are nearly in line.

    Attributes
    ----------
    team: whose drones.
    centres: (c, 3) [m]
    along: (c, 3), t: unit vectors, level, from ``r_{k-1}`` to ``q_k``.
    upward: (c, 3), w: unit vectors normal to t, upward and tilted inward.
    half: (c,) [m], a: half of the chord.
    rise: (c,) [m], h: the other semi-axis, positive; negative where q_k goes down first.
    ends: (k, 3) [m]: drones that do not turn, those at the ends of a chain.
    """

    team: Team
    centres: Array
    along: Array
    upward: Array
    half: Array
    rise: Array
    ends: Array

    def drones(self, angle: Array | float, derivative: int = 0) -> Array:
        """Return the drones (…, 2n, 3) [m] at angles θ (…), or a derivative by the angle."""
        theta = np.asarray(angle, dtype=np.float64)[..., None, None] + 0.5 * np.pi * derivative
        offset = (self.half[:, None] * self.along) * np.cos(theta)
        offset = offset + (self.rise[:, None] * self.upward) * np.sin(theta)
        middle = self.centres if derivative == 0 else np.zeros_like(self.centres)
        layout = self.team.layout
        places = np.zeros((*offset.shape[:-2], 2 * layout.robots, 3))
        places[..., 2 * layout.ahead, :] = middle + offset
        places[..., 2 * layout.behind + 1, :] = middle - offset
        if derivative == 0:
            places[..., ~layout.has_leg.ravel(), :] = self.ends
        return places

    def raised(self, by: float) -> SwapEllipses:
        """Return the same ellipses higher up [m]."""
        up = np.array([0.0, 0.0, by])
        return replace(self, centres=self.centres + up, ends=self.ends + up)

    def with_senses(self, senses: Array) -> SwapEllipses:
        """Return the same ellipses, q_k going up first where ``senses`` (c,) are 1, down at -1."""
        return replace(self, rise=np.abs(self.rise) * senses)


@dataclass(frozen=True, eq=False)
class PreHitch:
    """A pre-hitch: drones and cables before and after the swap.

    Attributes
    ----------
    ellipses: of all pairs, at the altitude of the swap.
    share: of the hitch's legs.
    lowest: largest depth of a cable below the drones' plane during the swaps [m].
    linked: whether cables cross at all clasps once pairs are exchanged.
    violation: relative violation of the requirements; none if at most zero.
    """

    ellipses: SwapEllipses
    share: float
    lowest: float
    linked: bool
    violation: float

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: places of the drones before and after the swaps."""
        return self.ellipses.drones(0.0)


def find_prehitch(hitch: Hitch, requirements: Requirements, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch that keeps spans and distances, else the one that comes nearest.

    At the hitch's own altitude. The certificate bounds it at every time. Pairs stand as in the
    hitch; if cables of some would not link, across clasps too.
    """
    candidates: list[PreHitch] = []
    for across, scale, share in itertools.product((False, True), SCALES, LEG_SHARES):
        if across and all(candidate.linked for candidate in candidates):
            break
        check_time()
        ellipses = _ellipses(hitch, requirements.separation, settings, share, scale, across)
        candidate = _evaluate(ellipses, hitch, requirements, share)
        if candidate.violation <= 0.0:
            return candidate
        candidates.append(candidate)
    return min(candidates, key=lambda candidate: candidate.violation)


def _ellipses(
    hitch: Hitch,
    separation: Separation,
    settings: SwapSettings,
    share: float,
    scale: float,
    across: bool,
) -> SwapEllipses:
    """Return the ellipses for a share of the legs and a scale of the polygon.

    Where legs at a vertex differ much, or tensions, the chord of its drones may be so oblique that
    their cables would not cross when they are exchanged; ``across`` lays chords along the vertex's
    bisector instead.
    """
    layout, drones = hitch.team.layout, hitch.drones
    tilt = TILT if settings.tilt is None else settings.tilt
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    vertices = hitch.vertices[layout.clasps]
    q, r = drones[2 * layout.ahead], drones[2 * layout.behind + 1]
    chord = (q - r) * [1.0, 1.0, 0.0]  # pairs swap at one height, however legs rise in the hitch
    lengths, along = np.linalg.norm(chord, axis=1), unit(chord)
    beyond = 0.5 * (q + r) - vertices
    if across:
        edges = unit(layout.edges(hitch.vertices))
        along = unit(edges[layout.behind] + edges[layout.ahead])
        beyond -= np.sum(beyond * along, axis=1, keepdims=True) * along
    outward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
    upward = math.cos(tilt) * np.array([0.0, 0.0, 1.0]) - math.sin(tilt) * outward
    # Scaled, chord and w stay orthogonal: each axis of the ellipse has to clear by itself.
    w = separation.scale * [0.0, math.sin(tilt), math.cos(tilt)]
    rise = max(settings.radius, 0.5 * APART / float(np.linalg.norm(w)))
    alone = drones[~layout.has_leg.ravel()]
    return SwapEllipses(
        hitch.team,
        vertices + share * beyond + (scale - 1.0) * (vertices - centre),
        along,
        upward,
        np.maximum(0.5 * share * lengths, max(settings.radius, APART * separation.radius)),
        (settings.sense or 1) * np.full(len(along), rise),
        alone + (scale - 1.0) * (alone - centre),
    )


def _evaluate(
    ellipses: SwapEllipses, hitch: Hitch, requirements: Requirements, share: float
) -> PreHitch:
    """Return the pre-hitch with these ellipses, measured over two swaps and on the way out."""
    drones = ellipses.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))
    q, r = drones[:, 0::2], drones[:, 1::2]
    layout, length = ellipses.team.layout, ellipses.team.cable_length
    cables = Catenary.between(q, r, length)
    mu = cables.parameter(PLACES[:, None, None])
    points = q + (0.5 * (1.0 + mu))[..., None] * (r - q)  # (places, angles, n, 3)
    points[..., 2] -= cables.depth(mu)
    separation = requirements.separation
    sagging = float(np.max(cables.extra_displacement(requirements.off)))
    lowest = float(ellipses.centres[0, 2]) - float(np.min(points[..., 2])) + sagging
    # From q to r along the edge: pairs would be on the wrong side of each other's cables else.
    opening = float(np.min(np.sum((r[0] - q[0]) * unit(layout.edges(hitch.vertices)), axis=-1)))
    linked, radius = _link_length(ellipses), separation.radius
    ratios = [
        float(np.max(np.linalg.norm(r - q, axis=-1) / length)) / SPAN,
        (2.0 * APART * radius - opening + radius) / radius,
        (MIN_LINK - linked + radius) / radius,
        0.99 * APART / smallest_separation(drones, separation),
    ]
    if separation.cable > 0.0:
        pairs = (q[:, layout.ahead], layout.behind), (r[:, layout.behind], layout.ahead)
        offsets = [points[:, :, cable] - drone for drone, cable in pairs]
        clear = float(np.min(np.linalg.norm(offsets, axis=-1), initial=np.inf))
        ratios.append(CLEARANCE * (separation.cable + sagging) / max(clear, 1e-9))
    if max(ratios) <= 1.0:
        here, out = drones[0], hitch.drones - drones[0]
        ratios.append(1.0 / smallest_separation(here + PLACES[:, None, None] * out, separation))
        ratios.append(_reach(hitch.team, here, clasp_places(ellipses, hitch)))
    return PreHitch(ellipses, share, lowest, linked >= MIN_LINK, max(ratios) - 1.0)


def _link_length(ellipses: SwapEllipses) -> float:
    """Return the least length of two cables beyond where their chords cross at a clasp [m].

    Seen from above, half a turn from the beginning; negative where they do not cross.
    """
    layout = ellipses.team.layout
    drones = ellipses.drones(math.pi)[:, :2]
    r, q = drones[2 * layout.behind + 1], drones[2 * layout.ahead]
    back, onward = unit(drones[2 * layout.behind] - r), unit(drones[2 * layout.ahead + 1] - q)
    turn = back[:, 0] * onward[:, 1] - back[:, 1] * onward[:, 0]
    apart = q - r  # = s back - t onward, at the lengths s and t beyond the point
    s = apart[:, 0] * onward[:, 1] - apart[:, 1] * onward[:, 0]
    t = apart[:, 0] * back[:, 1] - apart[:, 1] * back[:, 0]
    never = np.full((2, len(turn)), -np.inf)  # chords that are parallel
    beyond = np.divide(np.stack([s, t]), turn, out=never, where=turn != 0.0)
    return float(np.min(beyond, initial=np.inf))


def smallest_separation(places: Array, separation: Separation) -> float:
    """Return the smallest separation [1] of drones, at any of the times of places (J, m, 3) [m]."""
    from scipy.spatial import cKDTree

    scaled = places * separation.scale
    return min(float(np.min(cKDTree(there).query(there, k=[2])[0])) for there in scaled)


SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the line from pre-hitch to hitch that are tried as places of the clasps."""


def clasp_places(ellipses: SwapEllipses, hitch: Hitch) -> Array:
    """Return the places (points, 3) [m] of the clasps that cables reach around most easily.

    They are on the lines from the pairs' middles to the hitch's vertices; the ends of chains are
    where their drones are.
    """
    layout, drones = hitch.team.layout, ellipses.drones(0.0)
    middles = hitch.vertices.copy()
    middles[layout.clasps] = ellipses.centres
    polygons = [middles + share * (hitch.vertices - middles) for share in SHARES]
    alone = np.flatnonzero(~layout.has_leg.ravel())
    for points in polygons:
        points[layout.anchors[alone]] = drones[alone]
    return min(polygons, key=lambda points: _reach(hitch.team, drones, points))


def _reach(team: Team, drones: Array, points: Array) -> float:
    """Return the largest share of a cable that its route around the points takes."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return float(np.max((np.sum(legs, axis=1) + edges) / team.cable_length))
