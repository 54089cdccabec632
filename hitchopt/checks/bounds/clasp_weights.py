"""The weight that every clasp carries, enclosed, and whether its two cables press on each other.

Cable k is borne by its drones with half of its legs, by clasp k with half of its q-leg and edge, by
clasp k+1 with half of its edge and r-leg. With all of its length used up (check ``cable_length``)
``d_k + l_k = L_k - e_k``, so that norms of legs alone tell the weights.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.bodies import leg_vectors
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.tensions import lowered, tautness
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Estimate
from hitchopt.values import Array

CONTACT_SIGNS = np.array([1.0, 1.0, -1.0, 1.0])
"""Signs that make the contact force's products with q̂_k, u_k, r̂_{k-1}, u_{k-1} negative where the
clasp bears."""


def clasp_weights(motion: Motion) -> list[Array]:
    """Return what the weights at clasps are computed of, per piece and clasp.

    The other legs of its two cables, ``r_k``'s and ``q_{k-1}``'s (…, 6, degree + 1) [m]; then, of
    the cable ahead and of that behind, three rows each (…, 6, degree + 1): its share of the load
    and half of its cable's weight [N], and half of the weight per length [N/m], all to the share
    that the cable is taut.
    """
    team, layout = motion.team, motion.team.layout
    # A drone at a chain's end has no leg, wherever a plan has it.
    legs = leg_vectors(motion) * layout.has_leg.reshape(-1, 1, 1)
    others = np.concatenate([legs[:, 2 * layout.ahead + 1], legs[:, 2 * layout.behind]], axis=2)
    taut = lowered(tautness(motion))
    half = 0.5 * GRAVITY * team.cable_density
    rows = []
    for cable in (layout.ahead, layout.behind):
        share = taut[:, cable]
        load = 0.5 * GRAVITY * team.load[:, None] * share
        rows += [load, half * team.cable_length[cable, None] * share, half * share]
    return [others, np.stack(rows, axis=2)]


def weight_enclosure(others: Array, rows: Array, noise: float) -> enclosure.Enclosure:
    """Enclose the weights W_k (cells,) [N] at clasps, with an error for every coefficient.

    Parameters
    ----------
    others, rows: of ``clasp_weights``.
    noise: of positions [m].
    """
    ahead, behind = _halves(others, rows, noise)
    return enclosure.Enclosure(
        ahead.coefficients + behind.coefficients, ahead.radius + behind.radius
    )


def _halves(others: Array, rows: Array, noise: float) -> list[enclosure.Enclosure]:
    """Enclose what the clasps carry of the cables ahead and behind, (cells,) [N] each."""
    sizes = enclosure.norm(others.reshape(len(others), 2, 3, -1))
    found = []
    for i in range(2):
        load, whole, half = np.moveaxis(rows[:, 3 * i : 3 * i + 3], 1, 0)
        product = bernstein.multiply(half, sizes.coefficients[:, i])
        order = bernstein.degree(product)
        weight = bernstein.elevate(load + whole, order) - product
        radius = bernstein.elevate(half, order) * (sizes.radius[:, i] + 2.0 * noise)[:, None]
        found.append(enclosure.Enclosure(weight, radius))
    return found


def weight_at(others: Array, rows: Array, x: Array) -> Array:
    """Return the weights (cells,) [N] at x (cells,)."""
    weights: Array = np.sum(_halves_at(others, rows, x), axis=1)
    return weights


def _halves_at(others: Array, rows: Array, x: Array) -> Array:
    """Return what the clasps carry of the cables ahead and behind (cells, 2) [N] at x (cells,)."""
    there = bernstein.evaluate(others, x[:, None]).reshape(-1, 2, 3)
    load, whole, half = np.moveaxis(bernstein.evaluate(rows, x[:, None]).reshape(-1, 2, 3), 2, 0)
    halves: Array = load + whole - half * np.linalg.norm(there, axis=-1)
    return halves


def contact_bound(blocks: tuple[Array, ...], noise: float) -> Estimate:
    """Bound the largest product that should be negative where a clasp bears, over its tension.

    Every vector is bounded by a cone that it stays in, which says enough where clasps bear by far,
    and is halved with its cell elsewhere. Cable k presses with ``C = W^k ẑ - (P_q q̂_k + T_k u_k)``,
    ``W^k`` the weight on itself and half of the clasp's load. The clasp bears where ``C·q̂_k < 0``,
    ``C·u_k < 0``, ``C·r̂_{k-1} > 0`` and ``C·u_{k-1} < 0``.

    Parameters
    ----------
    blocks: the four vectors that meet at each clasp (cells, 12, degree + 1), what the cables pull
        with along each (cells, 4, …), what ``clasp_weights`` returns, and what objects press with
        on the clasp (cells, 4, …), if any does: half of that is on each cable.
    noise: of positions [m].
    """
    rows, pulls, others, shares, *pressed = blocks
    axes, turn = _cones(rows.reshape(len(rows), 4, 3, -1), noise)
    pressing = -np.einsum("cij,cid->cdj", pulls[:, :2], axes[:, :2])
    slop = np.einsum("cij,ci->cj", np.abs(pulls[:, :2]), turn[:, :2])
    load, whole, half = np.moveaxis(shares[:, :3], 1, 0)
    other = others[:, :3]
    along, longest = _cones(other, noise)[0], np.max(np.linalg.norm(other, axis=1), axis=-1)
    shortest = np.maximum(np.min(np.einsum("cdj,cd->cj", other, along), axis=-1), 0.0)
    middle, spread = 0.5 * (longest + shortest), 0.5 * (longest - shortest) + 2.0 * noise
    weight = load + whole - half * middle[:, None]
    order = max(bernstein.degree(part) for part in (pressing, weight, *pressed))
    pressing = bernstein.elevate(pressing, order)
    pressing[:, 2] += bernstein.elevate(weight, order)
    slop = bernstein.elevate(slop, order) + bernstein.elevate(half * spread[:, None], order)
    for block in pressed:
        pressing = pressing - 0.5 * bernstein.elevate(block[:, :3], order)
        slop = slop + block[:, 3, :1]
    products = np.einsum("cdj,cid->cij", pressing, axes) * CONTACT_SIGNS[:, None]
    # |C·y - c·y'| <= |C - c| |y| + |c| |y - y'|, for unit vectors y.
    size = np.linalg.norm(pressing, axis=1) + slop
    error = slop[:, None] + size[:, None] * turn[..., None]
    tension = np.min(bernstein.elevate(pulls[:, 1::2], order), axis=1)
    upper = np.max(products + error, axis=1)
    # Where the tension rises from zero, everything is proportional to it.
    pulling = np.max(tension, axis=-1, keepdims=True) > 0.0
    nothing = pulling & (tension == 0.0) & (upper == 0.0)
    over = np.divide(upper, tension, out=np.full_like(upper, np.inf), where=tension > 0.0)
    reach = np.where(nothing, -np.inf, over)
    x = np.argmax(reach, axis=-1) / max(1, order)
    return Estimate(np.max(reach, axis=-1), _products_at(blocks, x), x)


def _cones(vectors: Array, noise: float) -> tuple[Array, Array]:
    """Return unit vectors (…, 3), and by how much directions within a cell differ from them (…).

    All coefficients that are within an angle of less than 90° of an axis span a cone that holds the
    vector too; else any direction is possible, at a distance of up to 2.

    Parameters
    ----------
    vectors: (…, 3, degree + 1) [m]
    noise: by how much they may be off [m].
    """
    axes = unit(np.sum(vectors, axis=-1))
    least = np.min(np.einsum("...dj,...d->...j", vectors, axes), axis=-1)
    known = least > NO_DIRECTION
    sizes = np.linalg.norm(vectors, axis=-2, keepdims=True)
    directions = np.divide(vectors, sizes, out=np.zeros_like(vectors), where=sizes > 0.0)
    apart = np.max(np.linalg.norm(directions - axes[..., None], axis=-2), axis=-1)
    return axes, np.where(known, apart + 2.0 * noise / np.where(known, least, 1.0) + ROUNDING, 2.0)


def _products_at(blocks: tuple[Array, ...], x: Array) -> Array:
    """Return the largest product of ``contact_bound`` over its tension at x (cells,)."""
    rows, pulls, others, shares, *pressed = blocks
    y = unit(bernstein.evaluate(rows, x[:, None]).reshape(-1, 4, 3))
    P = bernstein.evaluate(pulls, x[:, None])
    C = -np.sum(P[:, :2, None] * y[:, :2], axis=1)
    C[:, 2] += _halves_at(others, shares, x)[:, 0]
    for load in pressed:
        C -= 0.5 * bernstein.evaluate(load[:, :3], x[:, None])
    largest = np.max(np.einsum("cd,cid->ci", C, y) * CONTACT_SIGNS, axis=1)
    tension = np.min(P[:, 1::2], axis=1)
    known = tension > 0.0
    over: Array = np.divide(largest, tension, out=np.full_like(largest, -np.inf), where=known)
    return over
