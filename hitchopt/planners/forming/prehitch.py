"""The pre-hitch: where the swap begins, so that no cable comes taut and no drone meets a cable.

Shortened legs: every pair stands as it will in the hitch, its legs shortened by a common share, no
nearer than a smallest radius. The share is searched downward, then the polygon is made smaller, so
that cables reach, or larger, so that pairs on short edges keep off each other, there and on their
way out to the hitch. Where no such place suffices and chords of pairs are too oblique for cables to
clasp, pairs stand across their vertices, whatever their legs.
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
from hitchopt.hitch.requirements import Separation
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.turns import (
    APART,
    Turns,
    rise_that_clears,
    smallest_separation,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the hitch's legs, in the order in which they are tried."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 1.15, 1.3, 1.5, 1.8)
"""Scales of the hitch's polygon, in the order in which they are tried if no share suffices."""

TILT = math.radians(45.0)
"""[rad] Tilt of the axis of turning where none is given: it keeps drones out of hanging cables for
any number of robots; level axes do so up to about seven."""

SPAN = 0.97
"""Largest share of a cable that its drones may be apart while it hangs."""

CLEARANCE = 1.05
"""Clearance of drones to cables, over ``Separation.cable``."""

LINKED = 0.05
"""[m] Least length of both cables beyond the point where their chords cross at a clasp, seen from
above, once its pair is exchanged: cables that do not cross there do not clasp."""

ANGLES = 73
"""Number of angles that are measured; the certificate bounds all of them."""

PLACES = np.linspace(0.0, 1.0, 41)
"""Shares of a hanging cable's length at which it is measured."""


@dataclass(frozen=True, eq=False)
class PreHitch:
    """Where the swap begins and ends.

    Attributes
    ----------
    turns: the ellipses, at the altitude of the swap.
    share: of the hitch's legs.
    scale: of the hitch's polygon.
    measures: spans and distances of the swaps, angle by angle.
    shortfall: relative violation of the requirements; none if at most zero.
    """

    turns: Turns
    share: float
    scale: float
    measures: Measures
    shortfall: float

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: places of the drones before and after the swaps."""
        return self.turns.drones(np.asarray(0.0))


def find_prehitch(hitch: Hitch, separation: Separation, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch that keeps spans and distances, else the one that comes nearest.

    At the hitch's own altitude. The certificate bounds it at every time. Pairs stand as in the
    hitch; if cables of some would not link, across clasps too.
    """
    looked_at: list[PreHitch] = []
    for across, scale, share in itertools.product((False, True), SCALES, LEG_SHARES):
        if across and all(found.measures.linked >= LINKED for found in looked_at):
            break
        check_time()
        turns = _turns(hitch, separation, settings, share, scale, across)
        measures = measured(turns, separation)
        found = PreHitch(turns, share, scale, measures, _shortfall(measures, separation))
        if found.shortfall <= 0.0:
            drawn = _drawing_shortfall(found, hitch, separation)
            found = replace(found, shortfall=max(found.shortfall, drawn))
        if found.shortfall <= 0.0:
            return found
        looked_at.append(found)
    return min(looked_at, key=lambda found: found.shortfall)


def _shortfall(measures: Measures, separation: Separation) -> float:
    """Return the relative violation of the worst quantity."""
    radius = separation.radius
    needed = [
        (measures.span, SPAN),
        (2.0 * APART * radius - measures.opening + radius, radius),
        (LINKED - measures.linked + radius, radius),
        (1.0, measures.apart / (0.99 * APART)),
    ]
    if separation.cable > 0.0:
        needed.append((CLEARANCE, max(measures.clearance, 1e-9) / separation.cable))
    return max(value / limit - 1.0 for value, limit in needed)


def _drawing_shortfall(pre: PreHitch, hitch: Hitch, separation: Separation) -> float:
    """Return the relative violation on the way out to the hitch."""
    worst = 1.0 / smallest_separation(pre.drones, hitch.drones, separation)
    points = clasp_places(pre.turns, pre.scale, hitch, pre.drones)
    return max(worst, largest_reach(hitch.team, pre.drones, points)) - 1.0


def _turns(
    hitch: Hitch,
    separation: Separation,
    settings: SwapSettings,
    share: float,
    scale: float,
    across: bool,
) -> Turns:
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
    middles = vertices + share * beyond + (scale - 1.0) * (vertices - centre)
    rise = rise_that_clears(separation, tilt, settings.radius)
    alone = drones[~layout.has_leg.ravel()]
    up = np.array([0.0, 0.0, 1.0])
    return Turns(
        hitch.team,
        middles,
        along,
        math.cos(tilt) * up - math.sin(tilt) * outward,
        np.maximum(0.5 * share * lengths, max(settings.radius, APART * separation.radius)),
        (settings.sense or 1) * np.full(len(along), rise),
        alone + (scale - 1.0) * (alone - centre),
        hitch.vertices,
    )


@dataclass(frozen=True, eq=False)
class Measures:
    """Extremes over two swaps.

    Attributes
    ----------
    span: largest share of a cable between its drones.
    opening: smallest distance, along the edge, from q to r before the swaps [m]: at a smaller one
        pairs would be on the wrong side of each other's cables.
    linked: smallest length of two cables beyond the point where their chords cross at a clasp, seen
        from above, when its pair is exchanged [m]; negative where they do not cross.
    clearance: smallest distance of a drone to its partner's cable [m].
    apart: smallest ratio of drones of pairs next to each other.
    lowest: largest depth of a cable below the drones' plane [m].
    """

    span: float
    opening: float
    linked: float
    clearance: float
    apart: float
    lowest: float


def measured(turns: Turns, separation: Separation) -> Measures:
    """Return the extremes over two swaps on these ellipses; linear in the number of pairs."""
    drones = turns.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))
    q, r = drones[:, 0::2], drones[:, 1::2]
    layout, length = turns.team.layout, turns.team.cable_length
    cables = Catenary.between(q, r, length)
    mu = cables.place(PLACES[:, None, None])
    points = q + (0.5 * (1.0 + mu))[..., None] * (r - q)  # (places, angles, n, 3)
    points[..., 2] -= cables.depth(mu)
    clear = np.inf
    for drone, cable in ((q[:, layout.ahead], layout.behind), (r[:, layout.behind], layout.ahead)):
        distance = np.linalg.norm(points[:, :, cable] - drone, axis=-1)
        clear = min(clear, float(np.min(distance)))
    along = unit(layout.edges(turns.vertices))
    return Measures(
        float(np.max(np.linalg.norm(r - q, axis=-1) / length)),
        float(np.min(np.sum((r[0] - q[0]) * along, axis=-1))),
        _linked(turns),
        clear,
        _apart(turns, drones, separation),
        float(turns.centres[0, 2]) - float(np.min(points[..., 2])),
    )


def _linked(turns: Turns) -> float:
    """Return ``Measures.linked``, half a turn from the beginning, when pairs are exchanged."""
    layout = turns.team.layout
    drones = turns.drones(np.asarray(math.pi))[:, :2]
    r, q = drones[2 * layout.behind + 1], drones[2 * layout.ahead]
    back, onward = unit(drones[2 * layout.behind] - r), unit(drones[2 * layout.ahead + 1] - q)
    turn = back[:, 0] * onward[:, 1] - back[:, 1] * onward[:, 0]
    apart = q - r  # = s back - t onward, at the lengths s and t beyond the point
    s = apart[:, 0] * onward[:, 1] - apart[:, 1] * onward[:, 0]
    t = apart[:, 0] * back[:, 1] - apart[:, 1] * back[:, 0]
    never = np.full((2, len(turn)), -np.inf)  # chords that are parallel
    beyond = np.divide(np.stack([s, t]), turn, out=never, where=turn != 0.0)
    return float(np.min(beyond, initial=np.inf))


def _apart(turns: Turns, drones: Array, separation: Separation) -> float:
    """Return the smallest ratio of drones at neighbouring clasps, and at the next but one."""
    layout = turns.team.layout
    pairs = np.stack([drones[:, 2 * layout.ahead], drones[:, 2 * layout.behind + 1]], axis=2)
    closest = np.inf
    count = pairs.shape[1]
    for step in range(1, 1 + min(2, count // 2 if layout.closed else count - 1)):
        others = np.roll(pairs, -step, axis=1)
        offset = pairs[:, :, :, None] - others[:, :, None]
        if not layout.closed:
            offset = offset[:, : count - step]
        ratios = np.linalg.norm(offset * separation.scale, axis=-1)
        closest = min(closest, float(np.min(ratios, initial=np.inf)))
    return closest


SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the line from pre-hitch to hitch that are tried as places of the clasps."""


def clasps_drawn_out(
    turns: Turns, scale: float, hitch: Hitch, flight: PiecewisePolynomial
) -> PiecewisePolynomial:
    """Return where the clasps may lie (points, 3) [m] while the drones fly out.

    They move along with the drones, between places that all cables reach around at both ends of
    the flight. Lengths are convex: cables that reach at both ends of a straight flight reach in
    between.
    """
    here = clasp_places(turns, scale, hitch, turns.drones(np.asarray(0.0)))
    start, end = flight.coefficients[0, ..., 0], flight.coefficients[-1, ..., -1]
    gone = flight.coefficients - start[..., None]
    farthest = int(np.argmax(np.linalg.norm(end - start, axis=1)))
    whole = (end - start)[farthest]
    size = float(whole @ whole)
    s = np.einsum("d,pdm->pm", whole, gone[:, farthest]) / size if size > 0.0 else np.ones(1)
    s = np.clip(s, 0.0, 1.0)[..., None, None, :]
    points = here[..., None] * (1.0 - s) + hitch.vertices[..., None] * s
    shape = (flight.pieces, *points.shape[-3:])
    return PiecewisePolynomial(flight.breaks, np.broadcast_to(points, shape))


def clasp_places(turns: Turns, scale: float, hitch: Hitch, drones: Array) -> Array:
    """Return the places (points, 3) [m] of the clasps that cables reach around most easily.

    Candidates are the middles of the pairs, the pre-hitch's vertices, and places between them and
    the hitch's; the ends of chains are where their drones are.
    """
    layout = hitch.team.layout
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    middles = hitch.vertices.copy()
    middles[layout.clasps] = turns.centres
    alone = np.flatnonzero(~layout.has_leg.ravel())
    best, least = hitch.vertices, np.inf
    for first in (centre + scale * (hitch.vertices - centre), middles):
        for share in SHARES:
            points = first + share * (hitch.vertices - first)
            points[layout.anchors[alone]] = drones[alone]
            reach = largest_reach(hitch.team, drones, points)
            if reach < least:
                best, least = points, reach
    return best


def largest_reach(team: Team, drones: Array, points: Array) -> float:
    """Return the largest share of a cable that its route around the points takes."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return float(np.max((np.sum(legs, axis=1) + edges) / team.cable_length))
