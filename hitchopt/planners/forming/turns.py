"""The ellipses at the clasps on which pairs of drones turn about each other, all on one clock.

At clasp k the drones ``q_k`` and ``r_{k-1}`` turn about the middle c of their chord, on

    q_k = c + a cos θ t + h sin θ w,      r_{k-1} = c - a cos θ t - h sin θ w,

t along the chord, w normal to it. The axis of turning is the outward normal of the chord, tilted
upward by an angle τ, so that the upper drone passes inside and the lower one outside: it would fly
into the loop of its neighbour's hanging cable else, where edges are nearly in line.

Out to the hitch drones fly on straight lines, all on one clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.planners.timing.profile import LIMIT_SHARE
from hitchopt.planners.timing.ramps import accelerations, fastest_clock, flown
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

APART = 1.05
"""Separation [1] of a pair while it turns."""

PIECE = 0.3
"""[rad] Largest angle on one polynomial of degree 7, which is within 1e-9 of the ellipse."""

SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Shares of the acceleration that turning takes at full speed; the rest is for speeding up."""

JERK_SHARE = 0.7
"""Share of the jerk that the angle's own rate takes."""

ANGLES = 25
"""Number of angles at which the drones' reserves are computed."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Ellipses, one per clasp.

    Attributes
    ----------
    team: whose drones.
    centres: (c, 3) [m]
    along: (c, 3), t: unit vectors, level, from ``r_{k-1}`` to ``q_k``.
    upward: (c, 3), w: unit vectors normal to t, upward and tilted inward.
    half: (c,) [m], a: half of the chord.
    rise: (c,) [m], h: the other semi-axis, positive; negative where q_k goes down first.
    ends: (k, 3) [m]: drones that do not turn, those at the ends of a chain.
    vertices: (points, 3) [m]: of the hitch that is to be formed.
    """

    team: Team
    centres: Array
    along: Array
    upward: Array
    half: Array
    rise: Array
    ends: Array
    vertices: Array

    def drones(self, angle: Array, derivative: int = 0) -> Array:
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

    @property
    def size(self) -> float:
        """The longest semi-axis [m]."""
        return float(max(np.max(self.half), np.max(np.abs(self.rise))))

    def raised(self, by: float) -> Turns:
        """Return the same ellipses higher up [m]."""
        up = np.array([0.0, 0.0, by])
        return replace(
            self, centres=self.centres + up, ends=self.ends + up, vertices=self.vertices + up
        )

    def with_senses(self, senses: Array) -> Turns:
        """Return the same ellipses, q_k going up first where ``senses`` (c,) are 1, down at -1."""
        return replace(self, rise=np.abs(self.rise) * senses)


def rise_that_clears(separation: Separation, tilt: float, least: float) -> float:
    """Return the smallest semi-axis [m] that clears the pair's ellipsoids at every angle.

    Scaled by ``Separation.scale``, chord and w stay orthogonal, so that the pair's ratio is
    ``|2a t cos θ| … |2h w sin θ|`` between its two axes: each has to clear by itself.

    Parameters
    ----------
    tilt: of the axis of turning [rad].
    least: no smaller than this [m].
    """
    w = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    return max(least, APART / float(np.linalg.norm(2.0 * separation.scale * w)))


def swap(turns: Turns, limits: Limits, first: int, seconds: float | None) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on half a turn, from rest to rest.

    As fast as the limits of every drone's speed, acceleration and jerk allow, whatever their
    number: pairs move at the same time.

    Parameters
    ----------
    turns: the ellipses.
    limits: of every drone.
    first: 0 for the turn from θ = 0, 1 for the one from θ = π.
    seconds: no faster than this [s], or None.
    """
    start = first * math.pi
    angles = np.linspace(start, start + math.pi, ANGLES)
    reserve = float(np.min(accelerations(turns.team, limits, turns.drones(angles))))
    candidates = (_half_turn(turns, limits, start, share, reserve) for share in SHARES)
    best = min(candidates, key=lambda drones: drones.duration)
    if seconds is not None and seconds > best.duration:
        best = best.stretched(seconds / best.duration)
    return best


def _half_turn(
    turns: Turns, limits: Limits, start: float, share: float, reserve: float
) -> PiecewisePolynomial:
    """Return a half turn whose angle is limited by the share, slowed to the drones' limits."""
    size = turns.size
    speed = min(limits.speed / size, math.sqrt(share * reserve / size))
    spare = math.sqrt(max(reserve * reserve - (speed * speed * size) ** 2, 1e-12)) / size
    clock = fastest_clock(math.pi, speed, spare, JERK_SHARE * limits.jerk / size)
    return flown(
        lambda angle, order: turns.drones(start + angle, order), clock, PIECE, limits, reserve
    )


STILL = 1e-9
"""[m] Shortest distance that is flown."""

PAUSE = 0.01
"""[s] Duration of a flight in which no drone moves."""

PROBES = 9
"""Number of places at which the drones' reserves are computed."""

CLOSEST_PROBES = 41
"""Number of places at which distances are measured; the certificate bounds all of the flight."""


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
    clock = fastest_clock(
        max(distance, least), LIMIT_SHARE * limits.speed, reserve, LIMIT_SHARE * limits.jerk
    )
    s = clock.coefficients[:, None, None, :] / clock.coefficients[-1, -1]
    s = np.clip(s, 0.0, 1.0)  # rounding must not lead through the floor
    curves = start[..., None] * (1.0 - s) + end[..., None] * s
    return PiecewisePolynomial(clock.breaks, curves)


def smallest_separation(start: Array, end: Array, separation: Separation) -> float:
    """Return the smallest separation of drones at probes on the lines between places (2n, 3)."""
    from scipy.spatial import cKDTree

    shares = np.linspace(0.0, 1.0, CLOSEST_PROBES)
    places = ((start + share * (end - start)) * separation.scale for share in shares)
    return min(float(np.min(cKDTree(there).query(there, k=[2])[0])) for there in places)
