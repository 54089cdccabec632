"""Tensions that a plan states, and loads of objects on clasps, from its polynomials.

An object of mass m rests with its rim on all clasps of a hitch that moves with it. Clasp k carries
the share ``μ_k`` of its mass, with ``Σ μ_k = 1`` and ``Σ μ_k p_k`` its centre of mass seen from
above; of all such shares those with the least sum of squares, as equally stiff supports have. A
centre of mass h above the clasps moves the weight ``m h G_k·a`` to clasp k as it accelerates.

Clasps are inside of the rim, whose edge bends their legs: below it they run level, beyond it they
rise, the mean leg by an angle φ with ``sin φ = W / (2 Σ T_k)``, W the weight of object and edges.
The rim takes the share ``1 - cos φ`` of edges' pulls. Vertices, where straight legs would
meet, are below the rim by the mean leg's slope times its distance to the rim's edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.motion.motion import JOINT, HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL, in_frame
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

ROUNDING = 1e-9
"""Relative: a tension this close to the least stated one draws its cable taut."""


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
    index, teams = ranged_phases(motion), np.repeat(motion.team.tension[:, None], 2, axis=1)
    stated = np.tile(teams, (motion.drones.pieces, 1, 1))
    for i in np.unique(index[index >= 0]):
        stated[index == i] = motion.phases[i].tension
    return stated


def tautness(motion: Motion) -> Array:
    """Return how far every cable is drawn taut, from 0 (it hangs free) to 1 (all straight parts).

    Forces fade by this share from those of a hanging cable without load to those of a taut one
    (``forces.cable_forces``). It is ``T / T_stated``, T_stated the least tension that the phase
    states or the team's, each coefficient clipped to [0, 1], and 0 while there is no hitch: a
    polynomial, continuous wherever tensions are.

    Returns
    -------
    (pieces, n, degree + 1): Bernstein coefficients over the motion's pieces.
    """
    least = np.minimum(stated_tensions(motion)[..., :1], motion.team.tension[:, None])
    share = motion.tensions.coefficients / ((1.0 - ROUNDING) * least)
    return np.where(motion.formed[:, None, None], np.clip(share, 0.0, 1.0), 0.0)


def leg_tensions(motion: Motion) -> Array:
    """Return the tensions of legs (pieces, 2n, degree + 1) at their clasps [N]; 0 if not formed."""
    return np.where(motion.formed[:, None, None], motion.pulls.coefficients, 0.0)


def lowered(coefficients: Array) -> Array:
    """Return constants written in degree 0, other polynomials unchanged: products get cheaper."""
    constant = np.all(coefficients == coefficients[..., :1])
    return coefficients[..., :1] if constant else coefficients


@dataclass(frozen=True, eq=False)
class Supports:
    """Shares of an object's weight that the clasps below it carry.

    Shares (…, clasps) of its mass, and gains (…, clasps, 2) [1/m], ``G_k``: the derivative of a
    share by the point in which the force meets the clasps' plane, in the object's frame.
    """

    shares: Array
    gains: Array

    @classmethod
    def at(cls, places: Array, centre: Array) -> Supports:
        """Return the shares of clasps at places (…, clasps, 2) [m] below a centre (2,) [m]."""
        away = places - centre
        rows = np.concatenate([np.ones_like(away[..., :1]), away], axis=-1)
        gains = np.swapaxes(np.linalg.pinv(rows), -1, -2)  # (…, clasps, 3)
        return cls(gains[..., 0], gains[..., 1:])


def supports_of(motion: Motion, index: int, body: SolidObject) -> Supports:
    """Return the clasps' shares of an object's weight where each piece begins (pieces, clasps)."""
    places = _places(motion, index)[:, motion.team.layout.clasps]
    return Supports.at(places, body.centre_of_mass[:2])


def _places(motion: Motion, index: int) -> Array:
    """Return vertices (pieces, points, 2) [m] in an object's frame where each piece begins."""
    poses = motion.object_poses.coefficients[:, index, :, 0]
    return in_frame(poses[:, None], motion.vertices.coefficients[..., 0])[..., :2]


def object_loads(motion: Motion) -> Array | None:
    """Return the forces ``w_k`` of carried objects on clasps (pieces, clasps, 3, …) [N].

    None where clasps carry no objects.
    """
    loads: list[Array] = []
    for index, body, on, share in _resting(motion):
        pose = motion.object_poses.coefficients[:, index]
        supports = supports_of(motion, index, body)
        lifted = np.any(np.ptp(pose, axis=-1) > STILL, axis=-1)[:, None, None, None]
        moved = motion.vertices.differentiated(2).coefficients[:, motion.team.layout.clasps]
        moved = np.where(lifted, moved, 0.0)  # a standing object does not move
        order = max(bernstein.degree(moved), bernstein.degree(share))
        pulled = bernstein.elevate(moved, order).copy()
        pulled[:, :, 2] += GRAVITY * bernstein.elevate(share, order)[:, None]
        own = -body.mass * supports.shares[..., None, None] * pulled
        pushed = bernstein.differentiate(bernstein.differentiate(centre_path(pose, body)))
        level = pushed[:, :2] / motion.drones.durations[:, None, None] ** 2
        turned = _turned_back(np.where(lifted[..., 0], level, 0.0), pose[:, 3:])
        height = body.centre_of_mass[2] - (0.0 if body.rim is None else body.rim.height)
        upward = body.mass * height * np.einsum("pkd,pdi->pki", supports.gains, turned)
        tipped = np.stack([0.0 * upward, 0.0 * upward, upward], axis=2)
        loads += [np.where(on[:, None, None, None], part, 0.0) for part in (own, tipped)]
    return _total(loads)


def saved_lengths(motion: Motion) -> Array | None:
    """Return the leg lengths that rims save (pieces, n, degree + 1) [m]; None if nothing.

    It grows with the square of the share that is borne, as ``strut_shares`` does.
    """
    savings = []
    for index, body, on, load_share in _resting(motion):
        if body.rim is None or not motion.team.layout.closed:
            continue
        most, places = np.zeros((len(on), motion.team.robots)), _places(motion, index)[on]
        pulls = motion.tensions.coefficients[on, ..., 0]
        most[on] = np.sum(rim_savings(motion.team, body, places, pulls), axis=-1)
        savings.append(most[..., None] * bernstein.multiply(load_share, load_share)[:, None])
    return _total(savings)


def strut_shares(motion: Motion) -> Array | None:
    """Return the share of edges' pulls that rims take (pieces, degree + 1); None if nothing.

    It grows with the square of the share that is borne, as ``1 - cos`` of the legs' slope does.
    """
    edges = length(motion.team.layout.edges(motion.vertices.coefficients[..., 0], axis=1))
    pulls, shares = motion.tensions.coefficients[..., 0], []
    for _, body, on, load_share in _resting(motion):
        most = np.ones(len(on))
        most[on] = strut_share(motion.team, body.mass, edges[on], pulls[on])
        shares.append(most[:, None] * bernstein.multiply(load_share, load_share))
    return _total(shares)


def held_pieces(motion: Motion, name: str, by: HoldBy) -> NDArray[np.bool_]:
    """Return (pieces,) whether an object is held by rest, or by grip."""
    holds = [p.hold is not None and (p.hold.object, p.hold.by) == (name, by) for p in motion.phases]
    return np.array([*holds, False])[motion.phase_of_piece]


def _resting(motion: Motion) -> Iterator[tuple[int, SolidObject, NDArray[np.bool_], Array]]:
    """Yield objects on clasps: index, object, (pieces,) whether it rests there, its load share."""
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        on = held_pieces(motion, name, HoldBy.REST)
        load_share = np.where(on[:, None], motion.object_shares.coefficients[:, index], 0.0)
        if np.any(load_share):
            yield index, body, on, load_share


def _total(parts: list[Array]) -> Array | None:
    """Return the sum of polynomials of any degrees; None if there are none."""
    order = max((bernstein.degree(part) for part in parts), default=0)
    raised = [bernstein.elevate(part, order) for part in parts]
    return sum(raised[1:], raised[0]) if raised else None


def _rise(
    team: Team, mass: float, edges: Array, tensions: Array, load_share: Array | float = 1.0
) -> Array:
    """Return the angle φ (…) [rad] at which the mean leg rises, given edges' lengths (…, n) [m]."""
    weight = GRAVITY * (mass + team.cable_density * np.sum(edges, axis=-1))
    slope = load_share * weight / (2.0 * np.sum(tensions, axis=-1))
    return np.asarray(np.arcsin(np.minimum(slope, 1.0)))


def strut_share(team: Team, mass: float, edges: Array, tensions: Array) -> Array:
    """Return the share (…) of edges' pulls that the rim of an object takes.

    Parameters
    ----------
    mass: of the object [kg].
    edges: lengths (…, n) [m].
    tensions: (…, n) [N].
    """
    share: Array = 1.0 - np.cos(_rise(team, mass, edges, tensions))
    return share


def rim_drop(
    team: Team, body: SolidObject, places: Array, tensions: Array, load_share: Array | float = 1.0
) -> Array:
    """Return how far vertices are below a rim that lies on their legs (…) [m].

    Legs run on along the edges of their vertex's two neighbours.

    Parameters
    ----------
    places: vertices (…, n, 2) [m] in the object's frame, clockwise.
    tensions: (…, n) [N].
    load_share: share (…) of the weight on the legs.
    """
    onward, back, edges = _to_rim(body, places)
    rise = _rise(team, body.mass, edges, tensions, load_share)
    drop: Array = np.mean(onward + back, axis=-1) * 0.5 * np.tan(rise)
    return drop


def rim_savings(team: Team, body: SolidObject, places: Array, tensions: Array) -> Array:
    """Return how much longer straight legs q and r are than legs bent by a rim (…, n, 2) [m].

    Cables run level up to the edge of a rim whose whole weight is on the legs, and only then rise.
    Parameters are those of ``rim_drop``.
    """
    onward, back, edges = _to_rim(body, places)
    longer = 1.0 / np.cos(_rise(team, body.mass, edges, tensions)) - 1.0
    level = np.stack([np.roll(onward, 1, axis=-1), np.roll(back, -1, axis=-1)], axis=-1)
    savings: Array = level * longer[..., None, None]
    return savings


def _to_rim(body: SolidObject, places: Array) -> tuple[Array, Array, Array]:
    """Return how far edges run on to the rim beyond ends and starts, and their lengths (…, n)."""
    if body.rim is None:
        raise InputError("rim", None, "given", "rest objects with a rim on clasps")
    onward, reach = np.roll(places, -1, axis=-2), body.rim.section.reach
    along = unit(onward - places)
    return reach(onward, along), reach(places, -along), length(onward - places)


def centre_path(pose: Array, body: SolidObject) -> Array:
    """Return the path of the centre of mass (pieces, 3, …) [m], given its object's poses."""
    x, y, z = body.centre_of_mass
    c, s = pose[:, 3], pose[:, 4]
    away = np.stack([c * x - s * y, s * x + c * y, np.full_like(c, z)], axis=1)
    centre: Array = pose[:, :3] + away
    return centre


def _turned_back(vectors: Array, heading: Array) -> Array:
    """Return level vectors (pieces, 2, …) as seen from bodies with headings (pieces, 2, …)."""
    (x, y), (c, s) = np.moveaxis(vectors, 1, 0), np.moveaxis(lowered(heading), 1, 0)
    along = bernstein.multiply(x, c) + bernstein.multiply(y, s)
    return np.stack([along, bernstein.multiply(y, c) - bernstein.multiply(x, s)], axis=1)
