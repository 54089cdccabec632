"""From the pre-hitch out to the hitch: all drones at once, or one of every cable after the other.

Where legs are long for their edge, the two drones of a cable pass each other on their way out, and
straight ways at the same pace may bring them together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.hitch import Team
from hitchopt.planners.forming.straight import straight
from hitchopt.requirements import Limits, Separation
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

PROBES = 41
"""Of every way, where drones are looked at; the certificate looks at all of it."""

APART = 1.01
"""How many times touching drones are to be apart at these."""


def tightened(
    team: Team,
    limits: Limits,
    separation: Separation,
    start: Array,
    end: Array,
    least: float = 0.0,
) -> list[PiecewisePolynomial]:
    """Return the ways (2n, 3) [m] out, one after the other; all at once where that will do.

    Parameters
    ----------
    start, end: (2n, 3) [m]
    least: timed as if the farthest drone went at least this far [m].
    """
    at_once = [straight(team, limits, start, end, least)]
    closest = _closest(at_once[0], separation)
    if closest >= APART:
        return at_once
    middle = start.copy()
    first = _first_movers(start, end, separation)
    middle[first] = end[first]
    in_turn = [
        straight(team, limits, start, middle, least),
        straight(team, limits, middle, end, least),
    ]
    better = min(_closest(way, separation) for way in in_turn) > closest
    return in_turn if better else at_once


def _first_movers(start: Array, end: Array, separation: Separation) -> Indices:
    """Return for every cable the drone that had better go first, its other one waiting (n,)."""
    share = np.linspace(0.0, 1.0, PROBES)[:, None, None]
    ways = (start + share * (end - start)) * separation.scale
    waiting, there = start * separation.scale, end * separation.scale
    apart = []
    for mover in (0, 1):
        going, other = ways[:, mover::2], ways[:, 1 - mover :: 2]
        out = np.linalg.norm(going - waiting[1 - mover :: 2], axis=-1)
        after = np.linalg.norm(other - there[mover::2], axis=-1)
        apart.append(np.min(np.minimum(out, after), axis=0))
    second_is_better = apart[1] > apart[0]
    movers: Indices = 2 * np.arange(len(second_is_better)) + second_is_better
    return movers


def _closest(way: PiecewisePolynomial, separation: Separation) -> float:
    """Return the smallest ratio of any two drones at the probes."""
    smallest = np.inf
    for places in way.at(np.linspace(0.0, way.duration, PROBES)) * separation.scale:
        smallest = min(smallest, float(np.min(cKDTree(places).query(places, k=[2])[0])))
    return smallest
