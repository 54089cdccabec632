"""Check ``equilibrium``: the cables' forces at every clasp balance."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import edge_vectors, leg_vectors
from hitchopt.checks.bounds.friction_range import beyond_friction
from hitchopt.checks.bounds.rounding_margins import ROUNDING, position_margin
from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION, lowered
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest

Array = NDArray[np.float64]

LIMIT = 5e-3
"""Relative to the tension: the vertex then stands within millimetres of its place."""

SIGNS = np.array([1.0, 1.0, 1.0, -1.0])
"""Signs of q̂_k, u_k, r̂_{k-1} and u_{k-1} in the balance."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    The residual is ``P_q q̂_k + T_k u_k + P_r r̂_{k-1} - T_{k-1} u_{k-1}``; ``where`` names the
    vertex. Legs pull with their cable's tension, ``P = T``, or with what friction makes of it. What
    friction cannot make of it counts as unbalanced too: by how much a pull lies beyond ``e^{μ θ}``
    times the tension, or short of ``e^{-μ θ}`` times, for the angle θ that the cable wraps. At a
    chain's ends it wraps none.

    A tension that is not positive holds nothing: the ratio is infinite there. But a factor that all
    tensions share cancels, also where it rises from zero as a hitch is pulled tight: residual and
    tension are compared coefficient by coefficient, and where both vanish nothing is unbalanced.
    """
    legs, edges = leg_vectors(motion), edge_vectors(motion)
    layout = motion.team.layout
    ahead, behind = layout.ahead, layout.behind
    meeting = [legs[:, 2 * ahead], edges[:, ahead], legs[:, 2 * behind + 1], edges[:, behind]]
    vectors = np.stack(meeting, axis=2)
    rows = vectors.reshape(*vectors.shape[:2], 12, -1)
    bound = partial(_bound, noise=position_margin(motion))
    found = largest(Cells.over(motion.drones.breaks, [rows, _pulls(motion)]), bound)
    worst, time, point = found.worst, found.time, layout.clasps[found.item]
    if motion.leg_tensions is not None:
        beyond = beyond_friction(motion)
        if beyond.worst > worst:
            worst, time, point = beyond.worst, beyond.time, layout.anchors[beyond.item]
    return Finding(worst, time, (f"p{point}",))


def _pulls(motion: Motion) -> Array:
    """Return, per piece and clasp, the tensions of the cables ahead and behind (…, 2, degree + 1).

    Or, where legs pull otherwise than their edges, the pulls along all four vectors (…, 4, …).
    """
    layout = motion.team.layout
    tension = motion.tensions.coefficients
    if motion.leg_tensions is None:
        tension = lowered(tension)
        return np.stack([tension[:, layout.ahead], tension[:, layout.behind]], axis=2)
    pull = motion.leg_tensions.coefficients
    order = max(bernstein.degree(pull), bernstein.degree(tension))
    pull, tension = bernstein.elevate(pull, order), bernstein.elevate(tension, order)
    each = [
        pull[:, layout.ahead, 0],
        tension[:, layout.ahead],
        pull[:, layout.behind, 1],
        tension[:, layout.behind],
    ]
    return np.stack(each, axis=2)


def _bound(blocks: tuple[Array, ...], noise: float) -> Estimate:
    rows, pulls = blocks
    vectors = rows.reshape(len(rows), 4, 3, -1)
    shared = 4 // pulls.shape[1]  # directions along which one pull acts
    tension = pulls if shared == 2 else pulls[:, 1::2]
    along = enclosure.direction(vectors, noise)
    signed = along.coefficients * SIGNS[:, None, None]
    grouped = np.sum(signed.reshape(len(rows), -1, shared, *signed.shape[2:]), axis=2)
    residual = np.sum(bernstein.multiply(pulls[:, :, None], grouped), axis=1)
    norms = np.linalg.norm(residual, axis=1)
    radius = np.sum(along.radius.reshape(len(rows), -1, shared), axis=-1) + ROUNDING
    # An error of the directions weighs as much as the tension does there, so coefficientwise.
    sizes = bernstein.elevate(np.abs(pulls), bernstein.degree(norms))
    norms = norms + np.sum(sizes * radius[..., None], axis=1)
    # {|S| <= θ T} is a convex cone in (S, T): coefficients within it keep the curve within it.
    least = np.min(bernstein.elevate(tension, bernstein.degree(norms)), axis=1)
    pulling = np.max(least, axis=-1, keepdims=True) > 0.0
    reach = np.where(pulling & (norms == 0.0) & (least == 0.0), 0.0, _over(norms, least))
    x = np.argmax(reach, axis=-1) / max(1, bernstein.degree(norms))
    there = bernstein.evaluate(vectors, x[:, None, None])
    length = np.linalg.norm(there, axis=-1, keepdims=True)
    known = length > NO_DIRECTION
    unit = np.divide(there, length, out=np.zeros_like(there), where=known)
    P = np.repeat(bernstein.evaluate(pulls, x[:, None]), shared, axis=1)
    forces = unit * SIGNS[:, None] * P[..., None]
    unknown = np.sum(np.where(known[..., 0], 0.0, np.abs(P)), axis=1)
    unbalanced = np.linalg.norm(np.sum(forces, axis=1), axis=-1) + unknown
    weakest = np.min(bernstein.evaluate(tension, x[:, None]), axis=-1)
    nothing = pulling[:, 0] & (unbalanced == 0.0) & (weakest == 0.0)
    value = np.where(nothing, 0.0, _over(unbalanced, weakest))
    return Estimate(np.max(reach, axis=-1), value, x)


def _over(force: Array, tension: Array) -> Array:
    ratio: Array = np.divide(force, tension, out=np.full_like(force, np.inf), where=tension > 0.0)
    return ratio


RULE = CheckRule("equilibrium", "1", "max", LIMIT, (Finder(_find, HITCHED_STATE),))
