"""Whether edges that are wrapped around an object put the forces on it with which it moves."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import bent_edges, concatenated
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin, position_margin
from hitchopt.checks.bounds.wrapped_arcs import gripping
from hitchopt.checks.rule import Finding
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import centre_path
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest
from hitchopt.values import Array, Indices


def unbalanced(motion: Motion) -> Finding:
    """Return the largest force, or moment over its size, that an object lacks, over the tension.

    Cable k pulls with ``T_k (b̂_k - â_k)`` on what it is wrapped around, where it leaves and where
    it meets that. Of an object off its support all of it counts, moments about the vertical too;
    the moment that accelerates its turning there is left to friction (check ``grip``). Of one that
    stands, in part at least, the share of its weight that is borne counts, and level forces beyond
    what friction with its support takes.
    """
    worst = Finding(0.0, 0.0)
    for index, name, body, pieces in gripping(motion):
        share = motion.object_shares.coefficients[pieces, index]
        lifted = np.all(share == 1.0, axis=-1)
        for stands, chosen in ((True, pieces[~lifted]), (False, pieces[lifted])):
            if len(chosen) == 0:
                continue
            found = _of_pieces(motion, index, body, chosen, stands=stands)
            if found.worst > worst.worst:
                worst = Finding(found.worst, found.time, (name,))
    return worst


def _of_pieces(
    motion: Motion, index: int, body: SolidObject, pieces: Indices, *, stands: bool
) -> Finding:
    """Return what is found on some pieces, on which the object stands or does not."""
    edges = [part[pieces] for part in bent_edges(motion)]
    pose = motion.object_poses.coefficients[pieces, index]
    centre = centre_path(pose, body)[:, None]
    contacts = motion.edge_contacts.coefficients[pieces]
    order = max(bernstein.degree(centre), bernstein.degree(contacts))
    centre = bernstein.elevate(centre, order)
    arms = [bernstein.elevate(contacts[:, :, i], order) - centre for i in (0, 1)]
    rows = concatenated([*edges, *arms], axis=2)  # (pieces, n, 12, degree + 1)
    rows = rows.reshape(len(rows), 1, -1, rows.shape[-1])
    tension = motion.tensions.coefficients[pieces][:, None]
    durations = motion.drones.durations[pieces]
    share = motion.object_shares.coefficients[pieces, index][:, None, None]
    pushed = bernstein.differentiate(bernstein.differentiate(centre[:, 0]))
    pushed = 0.0 * pushed if stands else pushed / durations[:, None, None] ** 2
    order = max(bernstein.degree(pushed), bernstein.degree(share))
    load = bernstein.elevate(pushed, order).copy()
    load[:, 2] += GRAVITY * bernstein.elevate(share[:, 0, 0], order)
    load = body.mass * load[:, None]
    error = body.mass * derivative_margin(motion.vertices, 2)[pieces].max(axis=1)
    blocks = [rows, tension, load, share, error[:, None, None, None]]
    cells = Cells.over(motion.drones.breaks, blocks, pieces=pieces)
    held = body.friction * body.mass * GRAVITY if stands else -1.0
    bound = partial(
        _bound, size=body.section.circumradius, held=held, noise=position_margin(motion)
    )
    found = largest(cells, bound)
    return Finding(found.worst, found.time)


def _bound(blocks: tuple[Array, ...], size: float, held: float, noise: float) -> Estimate:
    """Bound the ratio on cells.

    Parameters
    ----------
    size: over which moments are forces [m].
    held: level force that friction takes of what stands [N]; negative where nothing stands.
    """
    rows, tension, load, share, error = blocks
    n = tension.shape[1]
    parts = rows.reshape(len(rows), n, 4, 3, -1)
    along = enclosure.direction(parts[:, :, :2], noise)
    pulls = bernstein.multiply(tension[:, :, None, None], along.coefficients)
    slop = np.max(np.abs(tension), axis=-1)[..., None] * (along.radius + ROUNDING)
    pulls = pulls * np.array([-1.0, 1.0])[:, None, None]
    force = np.sum(pulls, axis=(1, 2))
    order = max(bernstein.degree(force), bernstein.degree(load))
    lacking = bernstein.elevate(force, order) - bernstein.elevate(load, order)
    spread = np.sum(slop, axis=(1, 2)) + error[:, 0, 0]
    x = np.full(len(rows), 0.5)
    weakest = np.min(tension, axis=(1, 2))
    here = np.min(bernstein.evaluate(tension, x[:, None]), axis=-1)
    middle = bernstein.evaluate(lacking, x[:, None])
    level = np.max(np.linalg.norm(lacking[:, :2], axis=1), axis=-1)
    there = np.linalg.norm(middle[:, :2], axis=-1)
    upright, upright_there = np.max(np.abs(lacking[:, 2]), axis=-1), np.abs(middle[:, 2])
    if held >= 0.0:
        level = np.maximum(level - held * (1.0 - np.max(share, axis=(1, 2))), 0.0)
        there = np.maximum(there - held * (1.0 - bernstein.evaluate(share[:, 0], x)), 0.0)
        bound, value = np.maximum(level, upright) + spread, np.maximum(there, upright_there)
    else:
        moments, arm = _moments(parts[:, :, 2:], pulls)
        turning = np.max(np.linalg.norm(moments, axis=1), axis=-1)
        turning = (turning + np.max(arm, axis=1) * np.sum(slop, axis=(1, 2))) / size
        bound = np.maximum(np.hypot(level, upright) + spread, turning)
        turned = np.linalg.norm(bernstein.evaluate(moments, x[:, None]), axis=-1) / size
        value = np.maximum(np.hypot(there, upright_there), turned)
    return Estimate(_over(bound, weakest), _over(value, here), x)


def _moments(arms: Array, pulls: Array) -> tuple[Array, Array]:
    """Return moments (cells, 3, …) [N m] of forces (cells, n, 2, 3, …), and arms' lengths."""
    found = []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        each = bernstein.multiply(arms[..., i, :], pulls[..., j, :])
        each = each - bernstein.multiply(arms[..., j, :], pulls[..., i, :])
        found.append(np.sum(each, axis=(1, 2)))
    sizes = np.max(np.linalg.norm(arms, axis=3), axis=(2, 3))
    return np.stack(found, axis=1), sizes


def _over(force: Array, tension: Array) -> Array:
    ratio: Array = np.divide(force, tension, out=np.full_like(force, math.inf), where=tension > 0.0)
    return ratio
