"""Tensions that a plan states, and what clasps carry of objects, as its polynomials tell it.

An object of mass m rests with its rim on all clasps of a hitch that moves with it. Clasp k carries
the share ``μ_k`` of its mass, with ``Σ μ_k = 1`` and ``Σ μ_k p_k`` its centre of mass seen from
above; of all such shares those with the least sum of squares, as equally stiff supports have. A
centre of mass h above the clasps moves the weight ``m h G_k·a`` to clasp k as it accelerates.

Clasps are inside of the rim, whose edge bends their legs: below it they run level, beyond it they
rise. The rim takes the share ``κ = 1 - sqrt(1 - (v / T)²)`` of what edges pull with, that of the
mean leg, ``v / T = W / (2 Σ T_k)``, W the weight of object and edges. Vertices, where straight legs
would meet, are below the rim by the mean leg's slope times its distance to the rim's edge.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.motion.motion import JOINT, HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL, in_frame
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

ROUNDING = 1e-9
"""Relative: a tension that is this close to the least stated one draws its cable taut."""


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

    Weight and level pull of a hanging cable, and every weight that clasps carry, pass to a taut one
    by this share (``forces.cable_forces``). It is ``T / T_stated``, T_stated the least that the
    phase states or the team's, coefficient by coefficient clipped to [0, 1], and 0 while there is
    no hitch: a polynomial, continuous wherever tensions are.

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
    """Return constants written in degree 0, anything else as it is: products get cheaper."""
    if np.all(coefficients == coefficients[..., :1]):
        return coefficients[..., :1]
    return coefficients


@dataclass(frozen=True, eq=False)
class Supports:
    """How the clasps below an object share its weight.

    Shares (…, clasps) of its mass, and gains (…, clasps, 2) [1/m], ``G_k``: by how much a clasp's
    grows as the point in which the force meets the clasps' plane moves, in the object's frame.
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


def object_loads(motion: Motion) -> Array | None:
    """Return the forces ``w_k`` of carried objects on clasps (pieces, clasps, 3, …) [N].

    None where clasps carry no objects.
    """
    return _total(
        np.where(on[:, None, None, None], _loads(motion, index, body), 0.0)
        for index, body, on, _ in _resting(motion)
    )


def saved_lengths(motion: Motion) -> Array | None:
    """Return what rims save cables of their legs (pieces, n, degree + 1) [m]; None if nothing.

    It grows with the square of the share that is borne, as ``strut_shares`` does.
    """
    found = []
    for index, body, on, borne in _resting(motion):
        if body.rim is None or not motion.team.layout.closed:
            continue
        poses = motion.object_poses.coefficients[on, index, :, 0]
        places = in_frame(poses[:, None], motion.vertices.coefficients[on, ..., 0])[..., :2]
        most = np.zeros((len(on), motion.team.robots))
        pulls = motion.tensions.coefficients[on, ..., 0]
        most[on] = np.sum(rim_savings(motion.team, body, places, pulls), axis=-1)
        found.append(most[..., None] * bernstein.multiply(borne, borne)[:, None])
    return _total(found)


def strut_shares(motion: Motion) -> Array | None:
    """Return what rims on clasps take of all edges' pulls (pieces, degree + 1); None if nothing.

    It grows with the square of the share that is borne, as ``1 - cos`` of the legs' slope does.
    """
    edges = length(motion.team.layout.edges(motion.vertices.coefficients[..., 0], axis=1))
    pulls, found = motion.tensions.coefficients[..., 0], []
    for _, body, on, borne in _resting(motion):
        most = np.ones(len(on))
        most[on] = strut_share(motion.team, body.mass, edges[on], pulls[on])
        found.append(most[:, None] * bernstein.multiply(borne, borne))
    return _total(found)


def held_pieces(motion: Motion, name: str, by: HoldBy) -> NDArray[np.bool_]:
    """Return (pieces,) whether an object is held so."""
    holds = [p.hold is not None and (p.hold.object, p.hold.by) == (name, by) for p in motion.phases]
    return np.array([*holds, False])[motion.phase_of_piece]


def _resting(motion: Motion) -> Iterator[tuple[int, SolidObject, NDArray[np.bool_], Array]]:
    """Yield objects on clasps: index, itself, (pieces,) where, and the share borne there."""
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        on = held_pieces(motion, name, HoldBy.REST)
        borne = np.where(on[:, None], motion.object_shares.coefficients[:, index], 0.0)
        if np.any(borne):
            yield index, body, on, borne


def _total(parts: Iterable[Array]) -> Array | None:
    """Return the sum of polynomials of any degrees; None of none."""
    found = [*parts]
    order = max((bernstein.degree(part) for part in found), default=0)
    raised = [bernstein.elevate(part, order) for part in found]
    return sum(raised[1:], raised[0]) if raised else None


def strut_share(team: Team, mass: float, edges: Array, tensions: Array) -> Array:
    """Return the share κ (…) of edges' pulls that the rim of an object of a mass [kg] takes.

    Of edges' lengths (…, n) [m] and tensions (…, n) [N].
    """
    slope = leg_slope(team, mass, edges, tensions)
    share: Array = 1.0 - np.sqrt(np.maximum(1.0 - slope**2, 0.0))
    return share


def leg_slope(team: Team, mass: float, edges: Array, tensions: Array) -> Array:
    """Return the mean leg's vertical pull over its tension (…), as ``strut_share``."""
    weight = GRAVITY * (mass + team.cable_density * np.sum(edges, axis=-1))
    slope: Array = weight / (2.0 * np.sum(tensions, axis=-1))
    return slope


def rim_drop(
    team: Team, body: SolidObject, places: Array, tensions: Array, borne: Array | float = 1.0
) -> Array:
    """Return how far vertices are below a rim that lies on their legs (…) [m].

    Legs run on along the edges of their vertex's two neighbours. Of vertices (…, n, 2) [m] in the
    object's frame, clockwise, tensions (…, n) [N] and the share (…) of the weight on the legs.
    """
    onward, back = _to_rim(body, places)
    rise = _mean_rise(team, body, places, tensions, borne)
    drop: Array = np.mean(onward + back, axis=-1) * 0.5 * np.tan(rise)
    return drop


def rim_savings(team: Team, body: SolidObject, places: Array, tensions: Array) -> Array:
    """Return by how much straight legs q and r are longer than those a rim bends (…, n, 2) [m].

    Cables run level up to the edge of a rim whose whole weight is on the legs, and only then rise.
    Parameters are those of ``rim_drop``.
    """
    onward, back = _to_rim(body, places)
    longer = 1.0 / np.cos(_mean_rise(team, body, places, tensions)) - 1.0
    level = np.stack([np.roll(onward, 1, axis=-1), np.roll(back, -1, axis=-1)], axis=-1)
    savings: Array = level * longer[..., None, None]
    return savings


def _to_rim(body: SolidObject, places: Array) -> tuple[Array, Array]:
    """Return how far edges run on to the rim's edge beyond their ends and starts (…, n) [m]."""
    assert body.rim is not None
    onward, reach = np.roll(places, -1, axis=-2), body.rim.section.reach
    along = unit(onward - places)
    return reach(onward, along), reach(places, -along)


def _mean_rise(
    team: Team, body: SolidObject, places: Array, tensions: Array, borne: Array | float = 1.0
) -> Array:
    """Return the angle (…) [rad] at which the mean leg rises, as of ``rim_drop``."""
    edges = length(np.roll(places, -1, axis=-2) - places)
    slope = borne * leg_slope(team, body.mass, edges, tensions)
    return np.asarray(np.arcsin(np.minimum(slope, 1.0)))


def _loads(motion: Motion, index: int, body: SolidObject) -> Array:
    """Return the forces of one object (pieces, clasps, 3, degree + 1) [N]."""
    pose = motion.object_poses.coefficients[:, index]
    supports = supports_of(motion, index, body)
    share = motion.object_shares.coefficients[:, index]
    lifted = np.any(np.ptp(pose, axis=-1) > STILL, axis=-1)[:, None, None, None]
    moved = motion.vertices.differentiated(2).coefficients[:, motion.team.layout.clasps]
    moved = np.where(lifted, moved, 0.0)  # what stands does not move
    order = max(bernstein.degree(moved), bernstein.degree(share))
    pulled = bernstein.elevate(moved, order).copy()
    pulled[:, :, 2] += GRAVITY * bernstein.elevate(share, order)[:, None]
    own = -body.mass * supports.shares[..., None, None] * pulled
    durations = motion.drones.durations[:, None, None]
    pushed = bernstein.differentiate(bernstein.differentiate(centre_path(pose, body)))
    level = np.where(lifted[..., 0], (pushed / durations**2)[:, :2], 0.0)
    height = body.centre_of_mass[2] - (0.0 if body.rim is None else body.rim.height)
    turned = turned_back(level, pose[:, 3:])
    upward = body.mass * height * np.einsum("pkd,pdi->pki", supports.gains, turned)
    tipped = np.stack([0.0 * upward, 0.0 * upward, upward], axis=2)
    found = _total([own, tipped])
    assert found is not None
    return found


def supports_of(motion: Motion, index: int, body: SolidObject) -> Supports:
    """Return how clasps share an object's weight where each piece begins (pieces, clasps)."""
    poses = motion.object_poses.coefficients[:, index, :, 0]
    points = motion.vertices.coefficients[..., 0][:, motion.team.layout.clasps]
    places = in_frame(poses[:, None], points)
    return Supports.at(places[..., :2], body.centre_of_mass[:2])


def centre_path(pose: Array, body: SolidObject) -> Array:
    """Return the path of the centre of mass (pieces, 3, …) [m], given its object's poses."""
    x, y, z = body.centre_of_mass
    c, s = pose[:, 3], pose[:, 4]
    centre: Array = pose[:, :3] + np.stack(
        [c * x - s * y, s * x + c * y, np.full_like(c, z)], axis=1
    )
    return centre


def turned_back(vectors: Array, heading: Array) -> Array:
    """Return level vectors (pieces, 2, …) as seen from bodies with headings (pieces, 2, …)."""
    heading = lowered(heading)
    c, s = heading[:, 0], heading[:, 1]
    x, y = vectors[:, 0], vectors[:, 1]
    along = bernstein.multiply(x, c) + bernstein.multiply(y, s)
    return np.stack([along, bernstein.multiply(y, c) - bernstein.multiply(x, s)], axis=1)
