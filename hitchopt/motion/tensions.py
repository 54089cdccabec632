"""Tensions that a plan states, and tautness: how far cables are drawn from hanging to taut."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

ROUNDING = 1e-9
"""Relative: a tension that is this close to the least stated one draws its cable taut."""

_KNOWN: WeakKeyDictionary[Motion, Array] = WeakKeyDictionary()
"""Pulls of legs along their chords, as long as the motions are in use."""


def ranged_phases(motion: Motion) -> NDArray[np.intp]:
    """Return (pieces,) the index of the phase whose own range of tensions applies, else -1.

    A range applies to the pieces that lie within its phase as a whole.
    """
    starts, ends = motion.drones.breaks[:-1], motion.drones.breaks[1:]
    index = np.full(motion.drones.pieces, -1, dtype=np.intp)
    for i, phase in enumerate(motion.phases):
        if phase.tension is not None:
            index[(starts >= phase.start - JOINT) & (ends <= phase.end + JOINT)] = i
    return index


def stated_tensions(motion: Motion) -> Array:
    """Return (pieces, n, 2) [N] the least and largest tension that each piece's phase states.

    Both are the team's tension where the phase states no range.
    """
    teams = np.repeat(motion.team.tension[:, None], 2, axis=1)
    stated = np.tile(teams, (motion.drones.pieces, 1, 1))
    if all(phase.tension is None for phase in motion.phases):
        return stated
    index = ranged_phases(motion)
    for i in np.unique(index[index >= 0]):
        stated[index == i] = motion.phases[i].tension
    return stated


def tautness(motion: Motion) -> Array:
    """Return how far every cable is drawn taut, from 0 (it hangs free) to 1 (all straight parts).

    Weight and level pull of a hanging cable pass to a taut one by this share, as its tension rises
    from 0 to the least that is stated, or falls from there; so does every weight that clasps carry,
    loads among them (``statics.cable_forces``). It is ``T / T_stated``, coefficient by
    coefficient clipped to [0, 1], and 0 while there is no hitch. So it is a polynomial, and
    continuous wherever tensions are. A morph whose tensions change within its own
    range has tautness 1.

    Returns
    -------
    (pieces, n, degree + 1): Bernstein coefficients over the motion's pieces.
    """
    least = np.minimum(stated_tensions(motion)[..., :1], motion.team.tension[:, None])
    share = motion.tensions.coefficients / ((1.0 - ROUNDING) * least)
    return np.where(motion.formed[:, None, None], np.clip(share, 0.0, 1.0), 0.0)


def chord_pulls(motion: Motion) -> Array:
    """Return what every leg pulls with along its chord, q0, r0, q1, … [N]; 0 without a hitch.

    That is its tension at the clasp and half of what that grows by up to the drone, ``½ ρ g
    (z - z_k)``, to the share that it is taut.

    Returns
    -------
    (pieces, 2n, degree + 1): Bernstein coefficients over the motion's pieces, read-only: several
    checks ask for them.
    """
    known = _KNOWN.get(motion)
    if known is None:
        known = _KNOWN[motion] = _chord_pulls(motion)
        known.setflags(write=False)
    return known


def _chord_pulls(motion: Motion) -> Array:
    pulls = np.where(motion.formed[:, None, None], motion.pulls.coefficients, 0.0)
    team = motion.team
    if team.cable_density == 0.0 or not np.any(motion.formed):
        return pulls
    order = max(motion.drones.degree, motion.vertices.degree)
    drones = motion.drones.elevated(order).coefficients[:, :, 2]
    vertices = motion.vertices.elevated(order).coefficients[:, team.layout.pulled_to, 2]
    half = 0.5 * GRAVITY * team.cable_density * np.repeat(lowered(tautness(motion)), 2, axis=1)
    grown = bernstein.multiply(half, lowered(drones - vertices))
    order = max(bernstein.degree(grown), bernstein.degree(pulls))
    return bernstein.elevate(pulls, order) + bernstein.elevate(grown, order)


def lowered(coefficients: Array) -> Array:
    """Return constants written in degree 0, anything else as it is: products get cheaper."""
    if np.all(coefficients == coefficients[..., :1]):
        return coefficients[..., :1]
    return coefficients
