"""All drones on straight lines: on one clock, or one of every cable after the other.

Where legs are long for their edge, the two drones of a cable pass each other on the line out to the
hitch, and may come too close at the same pace.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.hitch import Team
from hitchopt.planners.forming.clock import SHARE, accelerations
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.requirements import Limits, Separation
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

STILL = 1e-9
"""[m] Shortest distance that is flown."""

PAUSE = 0.01
"""[s] Duration of a flight in which no drone moves."""

PROBES = 9
"""Number of places at which the drones' reserves are computed."""

CLOSEST_PROBES = 41
"""Number of places at which distances are measured; the certificate bounds all of the flight."""

APART = 1.01
"""Smallest separation [1] at these places."""


def straight(
    team: Team, limits: Limits, start: Array, end: Array, least: float = 0.0
) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on straight lines, from rest to rest at the same times.

    Parameters
    ----------
    start, end: (2n, 3) [m]
    least: smallest distance of the farthest drone that the clock is computed for [m].
    """
    distance = float(np.max(np.linalg.norm(end - start, axis=1)))
    if distance < STILL:
        return PiecewisePolynomial.constant([0.0, PAUSE], end)
    share = np.linspace(0.0, 1.0, PROBES)[:, None, None]
    reserve = float(np.min(accelerations(team, limits, start + share * (end - start))))
    clock = fastest_clock(max(distance, least), SHARE * limits.speed, reserve, SHARE * limits.jerk)
    s = clock.coefficients[:, None, None, :] / clock.coefficients[-1, -1]
    s = np.clip(s, 0.0, 1.0)  # rounding must not lead through the floor
    curves = start[..., None] * (1.0 - s) + end[..., None] * s
    return PiecewisePolynomial(clock.breaks, curves)


def tightened(
    team: Team, limits: Limits, separation: Separation, start: Array, end: Array, least: float = 0.0
) -> list[PiecewisePolynomial]:
    """Return the flights (2n, 3) [m] out to the hitch: one if drones keep apart on it, else two.

    Parameters
    ----------
    start, end: (2n, 3) [m]
    least: see ``straight``.
    """
    return [straight(team, limits, a, b, least) for a, b in pairwise(stops(start, end, separation))]


def stops(start: Array, end: Array, separation: Separation) -> list[Array]:
    """Return the places (2n, 3) [m] where drones rest on their way to the hitch, ends included."""
    closest = smallest_separation([start, end], separation)
    if closest < APART:
        first = _first_movers(start, end, separation)
        middle = start.copy()
        middle[first] = end[first]
        if smallest_separation([start, middle, end], separation) > closest:
            return [start, middle, end]
    return [start, end]


def _first_movers(start: Array, end: Array, separation: Separation) -> Indices:
    """Return for every cable the drone that goes first while the other waits, (n,)."""
    share = np.linspace(0.0, 1.0, CLOSEST_PROBES)[:, None, None]
    paths = (start + share * (end - start)) * separation.scale
    waiting, there = start * separation.scale, end * separation.scale
    apart = []
    for mover in (0, 1):
        going, other = paths[:, mover::2], paths[:, 1 - mover :: 2]
        out = np.linalg.norm(going - waiting[1 - mover :: 2], axis=-1)
        after = np.linalg.norm(other - there[mover::2], axis=-1)
        apart.append(np.min(np.minimum(out, after), axis=0))
    second_is_better = apart[1] > apart[0]
    movers: Indices = 2 * np.arange(len(second_is_better)) + second_is_better
    return movers


def smallest_separation(places: Sequence[Array], separation: Separation) -> float:
    """Return the smallest separation of drones at probes on the lines between places (2n, 3)."""
    smallest = np.inf
    for start, end in pairwise(places):
        for share in np.linspace(0.0, 1.0, CLOSEST_PROBES):
            there = (start + share * (end - start)) * separation.scale
            smallest = min(smallest, float(np.min(cKDTree(there).query(there, k=[2])[0])))
    return smallest
