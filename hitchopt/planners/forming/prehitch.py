"""The pre-hitch: where the swap begins, so that no cable comes taut and no drone meets a cable.

Shortened legs: every pair stands as it will in the hitch, its legs shortened by a common share, no
nearer than a smallest radius. The share is searched downward, then the polygon is made smaller, so
that cables reach, or larger, so that pairs on short edges keep off each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch
from hitchopt.hitch.catenary import Catenary
from hitchopt.planners.forming.turns import APART, SwapSettings, Turns, rise_that_clears
from hitchopt.requirements import Separation
from hitchopt.time_limit import check_time
from hitchopt.values import Array

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the hitch's legs, in the order in which they are tried."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 1.15, 1.3, 1.5, 1.8)
"""Scales of the hitch's polygon, in the order in which they are tried if no share suffices."""

TILTS = (45.0, 60.0, 30.0, 0.0)
"""[deg] Tilts of the axis of turning, in the order in which they are tried where none is given.
The first one keeps drones out of hanging cables for any number of robots; level axes do so up to
about seven."""

SPAN = 0.97
"""Largest share of a cable that its drones may be apart while it hangs."""

CLEARANCE = 1.05
"""Clearance of drones to cables, over ``Separation.cable``."""

EVEN = 1e-3
"""[m] Smallest gain in clearance that counts: rounding does not decide between mirror images."""

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
    separation: required distances.
    """

    turns: Turns
    share: float
    scale: float
    measures: Measures
    shortfall: float
    separation: Separation

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: places of the drones before and after the swaps."""
        return self.turns.drones(np.asarray(0.0))


def find_prehitch(hitch: Hitch, separation: Separation, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch that keeps spans and distances, else the one that comes nearest.

    At the hitch's own altitude. The certificate bounds it at every time.
    """
    looked_at = []
    for found in _candidates(hitch, separation, settings):
        if found.shortfall <= 0.0:
            return found
        looked_at.append(found)
    return min(looked_at, key=lambda found: found.shortfall)


def _candidates(hitch: Hitch, separation: Separation, settings: SwapSettings) -> Iterator[PreHitch]:
    tilts = TILTS if settings.tilt is None else (math.degrees(settings.tilt),)
    for scale in SCALES:
        for share in LEG_SHARES:
            for tilt in tilts:
                check_time()
                turns = _turns(hitch, separation, settings, math.radians(tilt), share, scale)
                found = _turning(turns, separation, settings, share, scale)
                yield found
                if found.measures.span > SPAN or found.measures.opening < _opening(separation):
                    break  # tilts do not change it


def _turning(
    turns: Turns, separation: Separation, settings: SwapSettings, share: float, scale: float
) -> PreHitch:
    """Return the pre-hitch with the given senses; where none is given, q goes up first if possible.

    It goes down first at clasps where drones would come too close to their partners' cables.
    """
    senses = np.full(len(turns.half), float(settings.sense or 1))
    turns = turns.with_senses(senses)
    measures = measured(turns, separation)
    short = measures.clearances < CLEARANCE * separation.cable
    if not settings.sense and np.any(short):
        down = measured(turns.with_senses(-senses), separation).clearances
        better = short & (down > measures.clearances + EVEN)
        if np.any(better):
            turns = turns.with_senses(np.where(better, -senses, senses))
            measures = measured(turns, separation)
    return PreHitch(turns, share, scale, measures, _shortfall(measures, separation), separation)


def _opening(separation: Separation) -> float:
    """Return the least distance of q and r of a cable along its edge before the swaps [m]."""
    return 2.0 * APART * separation.radius


def _shortfall(measures: Measures, separation: Separation) -> float:
    """Return the relative violation of the worst quantity."""
    needed = [
        (measures.span, SPAN),
        (_opening(separation) - measures.opening + separation.radius, separation.radius),
        (1.0, measures.apart / (0.99 * APART)),
    ]
    if separation.cable > 0.0:
        clearance = float(np.min(measures.clearances))
        needed.append((CLEARANCE, max(clearance, 1e-9) / separation.cable))
    return max(value / limit - 1.0 for value, limit in needed)


def _turns(
    hitch: Hitch,
    separation: Separation,
    settings: SwapSettings,
    tilt: float,
    share: float,
    scale: float,
) -> Turns:
    """Return the ellipses for a share of the legs and a scale of the polygon."""
    layout, drones = hitch.team.layout, hitch.drones
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    vertices = hitch.vertices[layout.clasps]
    q, r = drones[2 * layout.ahead], drones[2 * layout.behind + 1]
    chord = (q - r) * [1.0, 1.0, 0.0]  # pairs swap at one height, however legs rise in the hitch
    lengths, along = np.linalg.norm(chord, axis=1), unit(chord)
    outward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
    middles = vertices + share * (0.5 * (q + r) - vertices) + (scale - 1.0) * (vertices - centre)
    alone = drones[~layout.has_leg.ravel()]
    up = np.array([0.0, 0.0, 1.0])
    return Turns(
        hitch.team,
        middles,
        along,
        math.cos(tilt) * up - math.sin(tilt) * outward,
        np.maximum(0.5 * share * lengths, max(settings.radius, APART * separation.radius)),
        np.full(len(along), rise_that_clears(separation, tilt, settings.radius)),
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
    clearances: (clasps,) smallest distance of a drone to its partner's cable [m].
    apart: smallest ratio of drones of pairs next to each other.
    lowest: largest depth of a cable below the drones' plane [m].
    """

    span: float
    opening: float
    clearances: Array
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
    clear = np.full(len(turns.half), np.inf)
    for drone, cable in ((q[:, layout.ahead], layout.behind), (r[:, layout.behind], layout.ahead)):
        distance = np.linalg.norm(points[:, :, cable] - drone, axis=-1)
        clear = np.minimum(clear, np.min(distance, axis=(0, 1)))
    along = unit(layout.edges(turns.vertices))
    return Measures(
        float(np.max(np.linalg.norm(r - q, axis=-1) / length)),
        float(np.min(np.sum((r[0] - q[0]) * along, axis=-1))),
        clear,
        _apart(turns, drones, separation),
        float(turns.centres[0, 2]) - float(np.min(points[..., 2])),
    )


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
