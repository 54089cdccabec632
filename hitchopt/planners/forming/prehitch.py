"""The pre-hitch: where the swap begins, so that no cable comes taut and no drone meets a cable.

Shortened legs: every pair stands as it will in the hitch, its legs shortened by a common share, no
nearer than a smallest radius. The share is searched downward, then the polygon is made smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Separation
from hitchopt.hitch.catenary import Catenary
from hitchopt.planners.forming.settings import SwapSettings
from hitchopt.planners.forming.turns import Turns, half_that_clears, rise_that_clears

Array = NDArray[np.float64]

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Of the hitch's legs, tried in turn."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6)
"""Of the hitch's polygon, tried in turn where no share of the legs will do."""

TILTS = (45.0, 60.0, 30.0, 0.0)
"""[deg] Of the axis of turning, tried in turn where none is given. The first one keeps drones out
of hanging cables for any number of robots; level axes do so up to about seven."""

SPAN = 0.97
"""Largest share of a cable that its drones may be apart while it hangs."""

ANGLES = 73
"""At which the way is looked at; the certificate looks at all of them."""

CLEARANCE = 1.05
"""How many times ``Separation.cable`` drones are to keep at those angles."""

PLACES = np.linspace(0.0, 1.0, 41)
"""Of the length of a hanging cable, where it is looked at."""


@dataclass(frozen=True, eq=False)
class PreHitch:
    """Where the swap begins and ends.

    Attributes
    ----------
    turns: the ellipses, at the altitude of the swap.
    share: of the hitch's legs.
    scale: of the hitch's polygon.
    span: largest share of a cable between its drones.
    clearance: smallest distance of a drone to its partner's cable [m].
    lowest: how far below the drones' plane a cable hangs [m], at all of the angles looked at.
    """

    turns: Turns
    share: float
    scale: float
    span: float
    clearance: float
    lowest: float

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: before and after the swaps."""
        return self.turns.drones(np.asarray(0.0))


def find_prehitch(hitch: Hitch, separation: Separation, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch that keeps spans and clearances, else the one that comes nearest.

    At the hitch's own altitude. Whether it holds for all t is for the certificate to say.
    """
    tilts = TILTS if settings.tilt is None else (math.degrees(settings.tilt),)
    best: PreHitch | None = None
    for scale in SCALES:
        for share in LEG_SHARES:
            for tilt in tilts:
                found = _looked_at(
                    _turns(hitch, separation, settings, math.radians(tilt), share, scale),
                    settings,
                    share,
                    scale,
                )
                if _shortfall(found, separation) <= 0.0:
                    return found
                if best is None or _shortfall(found, separation) < _shortfall(best, separation):
                    best = found
                if found.span > SPAN:
                    break  # tilts do not change it
    if best is None:
        raise RuntimeError("no pre-hitch was looked at")
    return best


def _shortfall(found: PreHitch, separation: Separation) -> float:
    """Return by how much a pre-hitch misses what is asked, relative; none if at most zero."""
    wanted = CLEARANCE * separation.cable
    close = (wanted - found.clearance) / wanted if wanted > 0.0 else 0.0
    return max(found.span / SPAN - 1.0, 0.1 * close)


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
    vertices = hitch.vertices[layout.clasps]
    q, r = drones[2 * layout.ahead], drones[2 * layout.behind + 1]
    chord = q - r
    lengths = np.linalg.norm(chord, axis=1)
    along = chord / lengths[:, None]
    outward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    shrink = (scale - 1.0) * (vertices - centre)
    middles = vertices + share * (0.5 * (q + r) - vertices) + shrink
    up = np.array([0.0, 0.0, 1.0])
    least = half_that_clears(separation, settings.radius)
    alone = drones[~layout.has_leg.ravel()]
    return Turns(
        hitch.team,
        middles,
        along,
        math.cos(tilt) * up - math.sin(tilt) * outward,
        np.maximum(0.5 * share * lengths, least),
        np.full(len(along), rise_that_clears(separation, tilt, settings.radius)),
        alone + (scale - 1.0) * (alone - centre),
    )


def _looked_at(turns: Turns, settings: SwapSettings, share: float, scale: float) -> PreHitch:
    """Return the pre-hitch of these ellipses, senses chosen where they are free."""
    senses = np.ones(len(turns.half))
    if settings.sense:
        return _measured(turns.with_senses(settings.sense * senses), share, scale)[0]
    up, clear_up = _measured(turns.with_senses(senses), share, scale)
    _, clear_down = _measured(turns.with_senses(-senses), share, scale)
    down = clear_down > clear_up + 1e-3
    if not np.any(down):
        return up
    return _measured(turns.with_senses(np.where(down, -senses, senses)), share, scale)[0]


def _measured(turns: Turns, share: float, scale: float) -> tuple[PreHitch, Array]:
    """Return what the swaps of these ellipses keep, and the clearance (c,) [m] at every clasp."""
    drones = turns.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))
    q, r = drones[:, 0::2], drones[:, 1::2]
    layout, length = turns.team.layout, turns.team.cable_length
    cables = Catenary.between(q, r, length)
    spans = np.linalg.norm(r - q, axis=-1) / length
    mu = cables.place(PLACES[:, None, None])
    way = 0.5 * (1.0 + mu)[..., None]
    points = q + way * (r - q)  # (places, angles, n, 3)
    points[..., 2] -= cables.depth(mu)
    clear = np.full(len(turns.half), np.inf)
    for drone, cable in (
        (q[:, layout.ahead], layout.behind),
        (r[:, layout.behind], layout.ahead),
    ):
        apart = np.linalg.norm(points[:, :, cable] - drone, axis=-1)
        clear = np.minimum(clear, np.min(apart, axis=(0, 1)))
    plane = float(turns.centres[0, 2])
    lowest = plane - float(np.min(points[..., 2]))
    found = PreHitch(turns, share, scale, float(np.max(spans)), float(np.min(clear)), lowest)
    return found, clear
