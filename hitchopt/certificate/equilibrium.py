"""Check ``equilibrium``: the cables' forces at every clasp balance."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate.bodies import edge_vectors, leg_vectors
from hitchopt.certificate.pull import NO_DIRECTION, lowered
from hitchopt.certificate.report import Check
from hitchopt.certificate.rounding import ROUNDING, position_margin
from hitchopt.model.motion import Motion
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest

Array = NDArray[np.float64]

LIMIT = 5e-3
"""Relative to the tension: the vertex then stands within millimetres of its place."""

SIGNS = np.array([1.0, 1.0, 1.0, -1.0])
"""Of q̂_k, u_k, r̂_{k-1} and u_{k-1} in the balance."""


def check(motion: Motion) -> Check:
    """Return the largest force residual at a clasp over the smaller of its cables' tensions.

    The residual is ``T_k (q̂_k + u_k) + T_{k-1} (r̂_{k-1} - u_{k-1})``; ``where`` names the vertex.
    A tension that is not positive holds nothing: the ratio is infinite there. But a factor that all
    tensions share cancels, also where it rises from zero as a hitch is pulled tight: residual and
    tension are compared coefficient by coefficient, and where both vanish nothing is unbalanced.
    """
    legs, edges = leg_vectors(motion), edge_vectors(motion)
    layout = motion.team.layout
    ahead, behind = layout.ahead, layout.behind
    meeting = [legs[:, 2 * ahead], edges[:, ahead], legs[:, 2 * behind + 1], edges[:, behind]]
    vectors = np.stack(meeting, axis=2)
    tension = lowered(motion.tensions.coefficients)
    both = np.stack([tension[:, ahead], tension[:, behind]], axis=2)
    rows = vectors.reshape(*vectors.shape[:2], 12, -1)
    bound = partial(_bound, noise=position_margin(motion))
    found = largest(Cells.over(motion.drones.breaks, [rows, both]), bound)
    where = (f"p{layout.clasps[found.item]}",)
    return Check.of("equilibrium", found.worst, LIMIT, "max", "1", found.time, where)


def _bound(blocks: tuple[Array, ...], noise: float) -> Estimate:
    rows, tension = blocks
    vectors = rows.reshape(len(rows), 4, 3, -1)
    along = enclosure.direction(vectors, noise)
    signed = along.coefficients * SIGNS[:, None, None]
    pulls = np.stack([signed[:, 0] + signed[:, 1], signed[:, 2] + signed[:, 3]], axis=1)
    residual = np.sum(bernstein.multiply(tension[:, :, None], pulls), axis=1)
    norms = np.linalg.norm(residual, axis=1)
    radius = along.radius[:, 0::2] + along.radius[:, 1::2] + ROUNDING
    # An error of the directions weighs as much as the tension does there, so coefficientwise.
    sizes = bernstein.elevate(np.abs(tension), bernstein.degree(norms))
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
    T = bernstein.evaluate(tension, x[:, None])
    forces = unit * SIGNS[:, None] * np.repeat(T, 2, axis=1)[..., None]
    unknown = np.sum(np.where(known[..., 0], 0.0, np.repeat(np.abs(T), 2, axis=1)), axis=1)
    unbalanced = np.linalg.norm(np.sum(forces, axis=1), axis=-1) + unknown
    weakest = np.min(T, axis=-1)
    nothing = pulling[:, 0] & (unbalanced == 0.0) & (weakest == 0.0)
    value = np.where(nothing, 0.0, _over(unbalanced, weakest))
    return Estimate(np.max(reach, axis=-1), value, x)


def _over(force: Array, tension: Array) -> Array:
    ratio: Array = np.divide(force, tension, out=np.full_like(force, np.inf), where=tension > 0.0)
    return ratio
