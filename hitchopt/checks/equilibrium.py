"""Check ``equilibrium``: the cables' forces at every clasp balance."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import bent_edges, concatenated, leg_vectors
from hitchopt.checks.bounds.clasp_weights import (
    clasp_weights,
    contact_bound,
    weight_at,
    weight_enclosure,
)
from hitchopt.checks.bounds.friction_range import beyond_friction
from hitchopt.checks.bounds.gripped_balance import unbalanced
from hitchopt.checks.bounds.leg_directions import clasp_directions, largest_along
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin, position_margin
from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.vectors import column_lengths, length
from hitchopt.motion.carried import object_loads, strut_shares
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.motion.tensions import chord_pulls, lowered
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import ABSOLUTE, Cells, Estimate, largest
from hitchopt.values import Array

LIMIT = 5e-3
"""Relative to the tension: the vertex then stands within millimetres of its place."""

NEAR = 0.02 * LIMIT
"""How close to an attained value the residual is bounded where time is short."""

SIGNS = np.array([1.0, 1.0, 1.0, -1.0])
"""Signs of q̂_k, u_k, r̂_{k-1} and u_{k-1} in the balance."""


def _find(motion: Motion, _: float, absolute: float = ABSOLUTE) -> Finding:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    The residual is ``P_q q̂_k + T_k u_k + P_r r̂_{k-1} - T_{k-1} u_{k-1} - W_k ẑ``; ``where`` names
    the vertex. Legs pull with their cable's tension, ``P = T``, or with what friction makes of it,
    and with what that grows by where cables have weight. What friction cannot make of it counts as
    unbalanced too: by how much a pull lies beyond ``e^{μ θ}`` times the tension, or short of
    ``e^{-μ θ}`` times, for the angle θ that the cable wraps. At a chain's ends it wraps none. The
    weight that a clasp carries is its load and what the drones do not carry of its cables, ``W_k =
    g · load + ½ ρ g (L_k - e_k + L_{k-1} - d_{k-1})``, to the share that they are taut; of objects
    it carries what ``hitchopt.motion.carried`` says, their inertia included, and rims take a share
    of what edges pull with. Where there is weight cables have to press on each other as well: a
    clasp that does not bear is infinitely far from balance.

    A tension that is not positive holds nothing: the ratio is infinite there. But a factor that all
    tensions share cancels, also where it rises from zero as a hitch is pulled tight: residual and
    tension are compared coefficient by coefficient, and where both vanish nothing is unbalanced.
    """
    blocks, layout = _blocks(motion), motion.team.layout
    noise = position_margin(motion)
    cells = Cells.over(motion.drones.breaks, blocks)
    shared = clasp_directions(motion) if motion.contacts is None else None  # of edges
    bound = partial(_bound, noise=noise)
    found = largest_along(cells, bound, shared, absolute=absolute)
    worst, time, point = found.worst, found.time, layout.clasps[found.item]
    if motion.leg_tensions is not None:
        beyond = beyond_friction(motion)
        if beyond.worst > worst:
            worst, time, point = beyond.worst, beyond.time, layout.anchors[beyond.item]
    if len(blocks) > 2:
        lifted = largest(cells, partial(contact_bound, noise=noise), within(0.0, "max"))
        if lifted.worst >= 0.0:
            worst, time, point = math.inf, lifted.time, layout.clasps[lifted.item]
    gripped = unbalanced(motion)
    if gripped.worst > worst:
        return gripped
    return Finding(worst, time, (f"p{point}",))


def _blocks(motion: Motion) -> list[Array]:
    """Return what meets at clasps, per piece and clasp: vectors, pulls, weights and loads."""
    legs, (leaving, arriving) = leg_vectors(motion), bent_edges(motion)
    layout = motion.team.layout
    ahead, behind = layout.ahead, layout.behind
    meeting = [
        legs[:, 2 * ahead],
        leaving[:, ahead],
        legs[:, 2 * behind + 1],
        arriving[:, behind],
    ]
    rows = concatenated(meeting, axis=2)
    blocks = [rows, _pulls(motion)]
    pressed = pressed_loads(motion)
    if motion.team.loaded or pressed is not None:
        blocks += clasp_weights(motion)
    if pressed is not None:
        blocks.append(pressed)
    return blocks


def spare_forces(motion: Motion) -> Array:
    """Return which loads may be added at clasps (pieces, clasps) [N] with all forces balanced.

    Half of what is added to a clasp enters the products of ``contact_bound``.
    """
    blocks = _blocks(motion)
    spare = LIMIT - _find(motion, LIMIT).worst
    if len(blocks) > 2:
        bound = partial(contact_bound, noise=position_margin(motion))
        pressing = -largest(Cells.over(motion.drones.breaks, blocks), bound).worst
        spare = min(spare, 2.0 * pressing)
    pulls = blocks[1]
    tension = pulls if pulls.shape[2] == 2 else pulls[:, :, 1::2]
    weakest: Array = np.min(tension, axis=(2, 3))
    return spare * weakest


def _pulls(motion: Motion) -> Array:
    """Return, per piece and clasp, the tensions of the cables ahead and behind (…, 2, degree + 1).

    Or, where legs pull otherwise than their edges, the pulls along all four vectors (…, 4, …); of
    what edges pull with that is less what a rim takes.
    """
    layout = motion.team.layout
    tension = motion.tensions.coefficients
    carries = motion.team.loaded or motion.borne is not None
    if motion.leg_tensions is None and not carries:
        tension = lowered(tension)
        return np.stack([tension[:, layout.ahead], tension[:, layout.behind]], axis=2)
    pull = chord_pulls(motion)
    order = max(bernstein.degree(pull), bernstein.degree(tension))
    pull, tension = bernstein.elevate(pull, order), bernstein.elevate(tension, order)
    taken = strut_shares(motion)
    if taken is not None:
        left = bernstein.multiply(1.0 - taken[:, None], lowered(motion.tensions.coefficients))
        order = max(order, bernstein.degree(left))
        pull, tension = bernstein.elevate(pull, order), bernstein.elevate(left, order)
    each = [
        pull[:, 2 * layout.ahead],
        tension[:, layout.ahead],
        pull[:, 2 * layout.behind + 1],
        tension[:, layout.behind],
    ]
    return lowered(np.stack(each, axis=2))


def _bound(
    blocks: tuple[Array, ...], noise: float, along: enclosure.Enclosure | None = None
) -> Estimate:
    rows, pulls, weights, pressed = blocks[0], blocks[1], blocks[2:4], blocks[4:]
    vectors = rows.reshape(len(rows), 4, 3, -1)
    shared = 4 // pulls.shape[1]  # directions along which one pull acts
    tension = pulls if shared == 2 else pulls[:, 1::2]
    along = enclosure.direction(vectors, noise) if along is None else along
    signed = along.coefficients * SIGNS[:, None, None]
    grouped = np.sum(signed.reshape(len(rows), -1, shared, *signed.shape[2:]), axis=2)
    residual = np.sum(bernstein.multiply(pulls[:, :, None], grouped), axis=1)
    if weights:
        weight = weight_enclosure(weights[0], weights[1], noise)
        order = max(bernstein.degree(residual), bernstein.degree(weight.coefficients))
        residual = bernstein.elevate(residual, order)
        residual[:, 2] -= bernstein.elevate(weight.coefficients, order)
    for load in pressed:
        order = max(bernstein.degree(residual), bernstein.degree(load))
        residual = bernstein.elevate(residual, order) + bernstein.elevate(load[:, :3], order)
    norms = column_lengths(residual)
    radius = np.sum(along.radius.reshape(len(rows), -1, shared), axis=-1) + ROUNDING
    # An error of the directions weighs as much as the tension does there, so coefficientwise.
    sizes = bernstein.elevate(np.abs(pulls), bernstein.degree(norms))
    norms = norms + np.sum(sizes * radius[..., None], axis=1)
    if weights:
        norms = norms + bernstein.elevate(weight.radius, bernstein.degree(norms))
    for load in pressed:
        norms = norms + load[:, 3, :1]
    # {|S| <= θ T} is a convex cone in (S, T): coefficients within it keep the curve within it.
    least = np.min(bernstein.elevate(tension, bernstein.degree(norms)), axis=1)
    pulling = np.max(least, axis=-1, keepdims=True) > 0.0
    reach = np.where(pulling & (norms == 0.0) & (least == 0.0), 0.0, _over(norms, least))
    index, order = np.argmax(reach, axis=-1), bernstein.degree(norms)
    x = index / max(1, order)
    there = bernstein.evaluate_at(vectors, index[:, None, None], order)
    size = length(there)[..., None]
    known = size > NO_DIRECTION
    unit = np.divide(there, size, out=np.zeros_like(there), where=known)
    P = np.repeat(bernstein.evaluate_at(pulls, index[:, None], order), shared, axis=1)
    forces = unit * SIGNS[:, None] * P[..., None]
    unknown = np.sum(np.where(known[..., 0], 0.0, np.abs(P)), axis=1)
    total = np.sum(forces, axis=1)
    if weights:
        total[:, 2] -= weight_at(weights[0], weights[1], x)
    for load in pressed:
        total += bernstein.evaluate(load[:, :3], x[:, None])
    unbalanced = length(total) + unknown
    weakest = np.min(bernstein.evaluate_at(tension, index[:, None], order), axis=-1)
    nothing = pulling[:, 0] & (unbalanced == 0.0) & (weakest == 0.0)
    value = np.where(nothing, 0.0, _over(unbalanced, weakest))
    return Estimate(np.max(reach, axis=-1), value, x)


def _over(force: Array, tension: Array) -> Array:
    ratio: Array = np.divide(force, tension, out=np.full_like(force, np.inf), where=tension > 0.0)
    return ratio


RULE = CheckRule("equilibrium", "1", "max", LIMIT, (Finder(_find, HITCHED_STATE),))

QUICK = replace(RULE, finders=(Finder(partial(_find, absolute=NEAR), HITCHED_STATE),))
"""The same, bounded within NEAR."""


def pressed_loads(motion: Motion) -> Array | None:
    """Return forces on clasps and, in a fourth row, what these err by; None where there are none.

    Returns
    -------
    (pieces, clasps, 4, degree + 1) [N]
    """
    loads = object_loads(motion)
    if loads is None:
        return None
    mass = sum(each.mass for each in motion.requirements.objects.values() if not each.fixed)
    error = mass * derivative_margin(motion.vertices, 2)[:, motion.team.layout.clasps]
    error = np.where(np.any(loads != 0.0, axis=(2, 3)), error, 0.0)
    rows = np.broadcast_to(error[..., None, None], (*loads.shape[:2], 1, loads.shape[-1]))
    return np.concatenate([loads, rows], axis=2)
