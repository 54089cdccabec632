"""The ellipses at the clasps on which pairs of drones turn about each other.

At clasp k the drones ``q_k`` and ``r_{k-1}`` turn about the middle c of their chord, on

    q_k = c + a cos θ t + h sin θ w,      r_{k-1} = c - a cos θ t - h sin θ w,

t along the chord, w normal to it. The axis of turning is the outward normal of the chord, tilted
upward by an angle τ, so that the upper drone passes inside and the lower one outside: it would fly
into the loop of its neighbour's hanging cable else, where edges are nearly in line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.hitch import Team
from hitchopt.requirements import Separation
from hitchopt.values import Array

APART = 1.05
"""Separation [1] of a pair while it turns."""


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
            self,
            centres=self.centres + up,
            ends=self.ends + up,
            vertices=self.vertices + up,
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


def half_that_clears(separation: Separation, least: float) -> float:
    """Return the smallest half chord [m] that clears the pair's ellipsoids side by side."""
    return max(least, APART * separation.radius)
