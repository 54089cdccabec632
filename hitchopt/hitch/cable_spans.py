"""Weight of cables and of what hangs at their clasps, and the sag of the spans between.

A span of chord s whose cable of weight ``ρ g`` per length pulls with T is longer than its chord by
``(ρ g / T)² s³ cos²α / 24`` (the arc of a parabola, α its slope), and puts half of its weight on
each of its ends. Lengths of legs in plans' inputs, ``d_k``, are those of the cable; the distances
from vertex to drone are their chords.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry.vectors import length
from hitchopt.hitch.team import GRAVITY, Team
from hitchopt.values import Array

Expression = TypeVar("Expression", bound=Any)
"""Type of arrays, and of casadi's expressions."""


@dataclass(frozen=True, eq=False)
class ClaspLoads:
    """What the clasps of a hitch carry, and how far their legs are rolled out of their plane.

    Attributes
    ----------
    forces: (…, clasps, 3) [N], outside forces ``w_k``; a weight points down.
    halves: (…, clasps, 2) [N], half of the weights of ``r_{k-1}``'s leg and of ``q_k``'s, by which
        their pull grows with height.
    roll: (…, clasps) [rad], ``ψ_k``; positive raises ``q_k`` and lowers ``r_{k-1}``.
    """

    forces: Array
    halves: Array
    roll: Array


def sag_factors(team: Team, tensions: ArrayLike) -> Array:
    """Return ``(ρ g / T)² / 24`` of every cable (…, n) [1/m²]: its length over its chord, cubed."""
    ratio = GRAVITY * team.cable_density / np.asarray(tensions, dtype=np.float64)
    factors: Array = ratio * ratio / 24.0
    return factors


def cable_of(chords: Array, factors: Array) -> Array:
    """Return the length of cable (…) [m] in spans with chords (…, 3 or 2) [m], level if planar."""
    level = chords[..., 0] ** 2 + chords[..., 1] ** 2
    return length(chords) * (1.0 + factors * level)


def shortening(x: Expression) -> Expression:
    """Return the chord of a span over the length of its cable, for ``x = c a² cos²α``.

    With ``s (1 + c s² cos²α) = a`` it is a power series of x, below 1e-2 for cables in use; casadi
    expressions may take the place of arrays.
    """
    ratio: Expression = 1.0 - x * (1.0 - x * (3.0 - x * (12.0 - 55.0 * x)))
    return ratio


def leg_vectors(cables: Array, directions: Array, factors: Array) -> Array:
    """Return the chords (…, 2 or 3) [m] of legs of cable (…) [m] along unit vectors; level if 2.

    Parameters
    ----------
    factors: (…) of ``sag_factors``.
    """
    level = directions[..., 0] ** 2 + directions[..., 1] ** 2
    chords: Array = (cables * shortening(factors * cables**2 * level))[..., None] * directions
    return chords


def cable_slack_of(team: Team, edges: Array, tensions: ArrayLike | None = None) -> Array:
    """Return what cables have left for their legs (…, n) [m], around edges (…, n, 2 or 3) [m].

    Parameters
    ----------
    tensions: (…, n) [N]; the team's where they are None.
    """
    if team.cable_density == 0.0:
        plain: Array = team.cable_length - np.linalg.norm(edges, axis=-1)
        return plain
    slack: Array = team.cable_length - cable_of(
        edges, sag_factors(team, team.tension if tensions is None else tensions)
    )
    return slack


def clasp_loads(
    team: Team, q_legs: Array, slack: Array, roll: ArrayLike | None = None
) -> ClaspLoads | None:
    """Return what the clasps carry in a hitch at its full tension; None where that is nothing.

    A clasp carries half of its legs and of its edges, ``W_k = ½ ρ g (d_k + l_k + e_{k-1} +
    l_{k-1}) + g · load``, in lengths of cable: ``d_k + l_k`` is ``L_k - e_k``.

    Parameters
    ----------
    q_legs, slack: (…, n) [m], lengths of cable.
    roll: (…, clasps) [rad], or None for none.
    """
    if not team.loaded and (roll is None or not np.any(roll)):
        return None
    layout = team.layout
    half = 0.5 * GRAVITY * team.cable_density
    r_legs = np.where(layout.has_leg[:, 1], slack - q_legs, 0.0)
    q = half * (team.cable_length - r_legs)[..., layout.ahead]
    r = half * (team.cable_length - q_legs)[..., layout.behind]
    forces = np.zeros((*q.shape, 3))
    forces[..., 2] = -(q + r + GRAVITY * team.load)
    halves = half * np.stack([r_legs[..., layout.behind], q_legs[..., layout.ahead]], axis=-1)
    turned = np.zeros(q.shape) if roll is None else np.broadcast_to(roll, q.shape)
    return ClaspLoads(forces, halves, np.asarray(turned, dtype=np.float64))
