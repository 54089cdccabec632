"""Straight parts of edges around an object, and where clasps are for them to carry what they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import length, unit
from hitchopt.holding.wraps import Wraps
from hitchopt.values import Array

SOFT = 1e-2
"""Damping over stiffness: clasps do not turn about objects that are nearly round."""

FARTHEST = 0.5
"""Longest step of a clasp over the shorter of its straight parts, at most as far as which edges
pull nearly as their derivatives say."""


def contacts_of(polygon: Array, wraps: Wraps, core: Array) -> Array:
    """Return where edges meet and leave the section (…, n, 2, 2) [m].

    Of straight edges that is the point which comes to touch the section first.
    """
    chord = np.roll(polygon, -1, axis=-2) - polygon
    along = unit(chord)
    corner = core[wraps.bends.corners[..., 0]]
    ahead = np.sum((corner - polygon) * along, axis=-1, keepdims=True)
    nearest = polygon + np.clip(ahead, 0.0, length(chord)[..., None]) * along
    touching = wraps.bends.touching[..., None, None]
    return np.where(touching, wraps.contacts, nearest[..., None, :])


def straight_parts(polygon: Array, contacts: Array, z: Array) -> tuple[Array, Array]:
    """Return the straight parts (…, n, 3) [m] of edges at ``p_k``, and at ``p_{k+1}``."""
    leaving = np.concatenate([contacts[..., 0, :] - polygon, -z[..., None]], axis=-1)
    onward = np.roll(polygon, -1, axis=-2) - contacts[..., 1, :]
    return leaving, np.concatenate([onward, np.roll(z, -1, axis=-1)[..., None]], axis=-1)


def balanced(
    clasps: Array, T: Array, arms: Array, load: Array, back: tuple[Array, Array] | None = None
) -> Array:
    """Return clasps (…, n, 3) [m], moved and turned together and raised, whose edges bear a load.

    One damped step of Newton's, shortened where it is long, for places and heights together: moved
    across itself a straight part of length t turns, and pulls with ``T / t`` more per metre. No
    edge turns a disc. Clasp k lifts with ``f_k``, what both of its edges do. Of all ``f`` that bear
    the weight without a moment about level axes the nearest to equal ones is taken.

    Parameters
    ----------
    clasps: (…, n, 3) [m], from the centre of mass, and above the plane of contact.
    arms: (…, n, 2, 2) [m], contacts, from the centre of mass.
    load: (…, 3) [N], level force on the object there, and weight.
    back: (…, n, 2) [m], clasps as planned, and (…) the share by which they are moved from there;
        None for all.
    """
    polygon = clasps[..., :2]
    parts = np.concatenate(straight_parts(polygon, arms, clasps[..., 2]), axis=-2)
    ends = _of_ends(polygon)
    arms = np.concatenate([arms[..., 0, :], arms[..., 1, :]], axis=-2)
    size = np.mean(length(arms), axis=-1)[..., None, None]
    along = unit(parts) * np.repeat([-1.0, 1.0], T.shape[-1])[:, None]
    T = np.concatenate([T, T], axis=-1)
    rates, pulls = T / length(parts), T[..., None] * along
    stiff = rates[..., None, None] * (np.eye(3) - along[..., :, None] * along[..., None, :])
    raised = _Raised.of(rates, stiff[..., 2, 2], arms, pulls[..., 2], load[..., 2])
    rows, moved = _with_moments(arms / size), _with_moments(ends / size)
    turned = np.einsum("...mai,...mij->...maj", stiff[..., :2], moved)
    sideways = _at_clasps(np.einsum("...mij,...mi->...mj", rows, stiff[..., :2, 2]))
    lacking = np.append(load[..., :2], np.zeros((*load.shape[:-1], 1)), axis=-1)
    lacking = lacking - np.einsum("...mij,...mi->...j", rows, pulls[..., :2])
    lacking = lacking - np.einsum("...nj,...n->...j", sideways, raised.first)
    stiffness = np.einsum("...mij,...mik->...jk", rows, turned[..., :2, :])
    lifted = raised.by(turned[..., 2, :])
    stiffness = stiffness + np.einsum("...nj,...nk->...jk", sideways, lifted)
    soft = (SOFT * np.linalg.norm(stiffness, axis=(-2, -1)))[..., None, None] ** 2 * np.eye(3)
    transposed = np.swapaxes(stiffness, -2, -1)
    right = transposed @ lacking[..., None]
    found = np.linalg.solve(transposed @ stiffness + soft, right)[..., 0]
    step = np.einsum("...nij,...j->...ni", _with_moments(polygon / size), found)
    if back is not None:
        planned, share = back
        step = planned - polygon + share[..., None, None] * (polygon + step - planned)
    rise = np.einsum("...mi,...mi->...m", stiff[..., 2, :2], _of_ends(step))[..., None]
    step = np.concatenate([step, raised.first[..., None] + raised.by(rise)], axis=-1)
    ahead, behind = np.split(length(parts), 2, axis=-1)
    reach = FARTHEST * np.minimum(ahead, np.roll(behind, 1, axis=-1))
    part = np.min(reach / np.maximum(length(step), reach), axis=-1)
    stepped: Array = clasps + part[..., None, None] * step
    return stepped


@dataclass(frozen=True, eq=False)
class _Raised:
    """Rises of clasps in a step of Newton's, by how they are moved.

    Attributes
    ----------
    first: (…, n) [m], where they are not moved.
    stiff: (…, n, 1) [N/m], by which they lift more where they rise.
    lifts: (…, 2n, 3), what lifts at contacts are of vertical force and level moments.
    bent, spread: (…, n, 3), the same of clasps that rise, and clasps' lifts by these three.
    """

    first: Array
    stiff: Array
    lifts: Array
    bent: Array
    spread: Array

    @classmethod
    def of(cls, rates: Array, stiff: Array, arms: Array, pulls: Array, weight: Array) -> _Raised:
        """Return it for parts (…, 2n).

        Parameters
        ----------
        rates: tension over length [N/m].
        stiff: [N/m], change of upward pulls ``pulls`` [N] where their ends rise.
        arms: (…, 2n, 2) [m]
        weight: (…) [N]
        """
        lifts = np.concatenate([np.ones_like(arms[..., :1]), arms], axis=-1)
        n = pulls.shape[-1] // 2
        rates, stiff = rates[..., None], stiff[..., None]
        each, stiffness = _at_clasps(rates * lifts) / _at_clasps(rates), _at_clasps(stiff)
        bent = _at_clasps(stiff * lifts) / stiffness
        spread = each @ np.linalg.inv(np.swapaxes(bent, -1, -2) @ each)
        beyond = weight[..., None] / n - _at_clasps(pulls[..., None])[..., 0]
        lacking = weight[..., None] * [1.0, 0.0, 0.0] - np.einsum("...mj,...m->...j", lifts, pulls)
        lacking = lacking - np.einsum("...nj,...n->...j", bent, beyond)
        first = (beyond + np.einsum("...nj,...j->...n", spread, lacking)) / stiffness[..., 0]
        return cls(first, stiffness, lifts, bent, spread)

    def by(self, pulls: Array) -> Array:
        """Return (…, n, k) [m], by upward pulls (…, 2n, k) [N] that moves add."""
        more = _at_clasps(pulls)
        whole = np.einsum("...mj,...mk->...jk", self.lifts, pulls)
        whole = whole - np.einsum("...nj,...nk->...jk", self.bent, more)
        up: Array = -(more + self.spread @ whole) / self.stiff
        return up


def _of_ends(clasps: Array) -> Array:
    """Return what is at clasps (…, n, 2) at ends of parts (…, 2n, 2): leaving, then arriving."""
    return np.concatenate([clasps, np.roll(clasps, -1, axis=-2)], axis=-2)


def _at_clasps(parts: Array) -> Array:
    """Return what parts (…, 2n, k) have at clasps (…, n, k), leaving and arriving ones summed."""
    n = parts.shape[-2] // 2
    at: Array = parts[..., :n, :] + np.roll(parts[..., n:, :], 1, axis=-2)
    return at


def _with_moments(arms: Array) -> Array:
    """Return rows (…, n, 2, 3): level forces at arms (…, n, 2) times them are force and moment.

    Times a small displacement and turn they are how far the arms' ends move.
    """
    rows = np.zeros((*arms.shape, 3))
    rows[..., :2] = np.eye(2)
    rows[..., 0, 2], rows[..., 1, 2] = -arms[..., 1], arms[..., 0]
    return rows
