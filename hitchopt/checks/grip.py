"""Check ``grip``: friction holds what cables are wrapped around, also with the worst clasps."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import bent_edges, concatenated, leg_vectors
from hitchopt.checks.bounds.edge_contacts import bent, misplaced
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin, position_margin
from hitchopt.checks.bounds.wrapped_arcs import gripping
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import centre_path
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE, HoldBy
from hitchopt.objects import SolidObject
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, smallest
from hitchopt.values import Array, Indices

LIMIT = 1.5
"""Slip load over load."""


def _find(motion: Motion, limit: float) -> Finding:
    """Return the smallest ratio of slip load to load, while the load is borne.

    The slip load is ``μ Σ T_k θ_k``: μ the object's friction, ``θ_k`` the angle by which edge k
    turns around it, seen from above, and ``T_k`` the smaller pull of cable k's legs, less what
    friction takes off at most where it turns at its clasps. The load is the borne share of ``m (g +
    a_z)`` and what turns the object about the vertical, over the distance of contacts. Level forces
    are not held by friction but by where edges bend (check ``equilibrium``). What contradicts the
    phases counts as minus infinity: an edge that bends where nothing is gripped, or that is not on
    the section of what is.
    """
    best = Finding(math.inf, 0.0)
    lost = bent(motion)
    held = gripping(motion)
    for index, name, body, pieces in held:
        lost[pieces] = misplaced(motion, index, body, pieces)
        borne = np.any(motion.object_shares.coefficients[pieces, index] > 0.0, axis=-1)
        if np.any(borne):
            found = _ratio(motion, index, body, pieces[borne], limit)
            if found.worst < best.worst:
                best = Finding(found.worst, found.time, (name,))
    if np.any(lost):
        time = float(motion.drones.breaks[int(np.argmax(lost))])
        return Finding(-math.inf, time, tuple(name for _, name, _, _ in held))
    return best


def _ratio(motion: Motion, index: int, body: SolidObject, pieces: Indices, limit: float) -> Finding:
    """Return the smallest ratio for an object on some pieces."""
    legs, (leaving, arriving) = leg_vectors(motion), bent_edges(motion)
    parts = [each[pieces] for each in (legs[:, 0::2], leaving, legs[:, 1::2], arriving)]
    rows = concatenated(parts, axis=2)
    rows = rows.reshape(len(rows), 1, -1, rows.shape[-1])
    pulls = np.minimum(*np.moveaxis(_pulls(motion)[pieces], 2, 0))[:, None, :, None]
    loads = gripped_loads(motion, index, body, pieces)[:, None, None, None]
    blocks = [rows, pulls, loads]
    cells = Cells.over(motion.drones.breaks, blocks, pieces=pieces)
    bound = partial(
        _bound,
        friction=body.friction,
        clasps=motion.team.cable_friction,
        noise=position_margin(motion),
    )
    found = smallest(cells, bound, within(limit, "min"))
    return Finding(found.worst, found.time)


def _pulls(motion: Motion) -> Array:
    """Return the least pull (pieces, n, 2) [N] of every leg."""
    least: Array = np.min(motion.pulls.coefficients, axis=-1)
    return least.reshape(len(least), -1, 2)


def gripped_loads(motion: Motion, index: int, body: SolidObject, pieces: Indices) -> Array:
    """Return the largest load on every piece (pieces,) [N]."""
    pose = motion.object_poses
    durations = motion.drones.durations[pieces]
    pushed = bernstein.differentiate(
        bernstein.differentiate(centre_path(pose.coefficients[pieces, index], body))
    )
    upward = np.max(pushed[:, 2], axis=-1) / durations**2
    upward += derivative_margin(motion.vertices, 2)[pieces].max(axis=1)
    share = np.max(motion.object_shares.coefficients[pieces, index], axis=-1)
    heading = bernstein.differentiate(bernstein.differentiate(pose.coefficients[pieces, index, 3:]))
    turned = np.max(np.linalg.norm(heading, axis=1), axis=-1) / durations**2
    load: Array = body.mass * (share * (GRAVITY + upward) + turned * turning_reach(body))
    return load


def turning_reach(body: SolidObject) -> float:
    """Return the load over mass and angular acceleration of an object that is turned [m]."""
    section = body.section
    away = np.linalg.norm(section.core - section.centroid, axis=-1)
    arm = section.rounding or float(np.min(away))
    reach = float(np.max(away)) + section.rounding
    return reach**2 / arm


def _bound(blocks: tuple[Array, ...], friction: float, clasps: float, noise: float) -> Estimate:
    """Bound slip load over load from below."""
    rows, pulls, loads = blocks
    n = pulls.shape[1]
    vectors = rows.reshape(len(rows), n, 4, 3, -1)
    q, leaving, r, arriving = (vectors[:, :, i] for i in range(4))
    flat = np.array([1.0, 1.0, 0.0])[:, None]
    wrapped = angle_range(flat * leaving, flat * arriving, noise)[0]
    most = np.maximum(angle_range(-q, leaving, noise)[1], angle_range(-r, -arriving, noise)[1])
    load = loads[:, 0, 0] * (1.0 + ROUNDING)
    half = np.full(len(rows), 0.5)
    here = [
        bernstein.evaluate(part, half[:, None, None])[..., None]
        for part in (q, leaving, r, arriving)
    ]
    q, leaving, r, arriving = here
    turned = angle_range(flat * leaving, flat * arriving, 0.0)[0]
    clasped = np.maximum(angle_range(-q, leaving, 0.0)[1], angle_range(-r, -arriving, 0.0)[1])
    found = []
    for theta, beta in ((wrapped, most), (turned, clasped)):
        slip = friction * np.sum(pulls[:, :, 0] * np.exp(-clasps * beta) * theta, axis=1)
        found.append(np.divide(slip, load, out=np.full_like(slip, math.inf), where=load > 0.0))
    return Estimate(found[0], found[1], half)


def angle_range(a: Array, b: Array, noise: float) -> tuple[Array, Array]:
    """Return the least and the largest angle (…) [rad] between vectors (…, 3, degree + 1).

    Parameters
    ----------
    noise: of the vectors' ends [m].
    """
    along = bernstein.dot(a, b)
    sizes = []
    for each in (a, b):
        size = enclosure.norm(each)
        spread = size.radius + 2.0 * noise
        low = np.maximum(np.min(size.coefficients, axis=-1) - spread, 0.0)
        sizes.append((low, np.max(size.coefficients, axis=-1) + spread))
    least, most = (one * other for one, other in zip(*sizes, strict=True))
    slop = 2.0 * noise * (sizes[0][1] + sizes[1][1])
    low, high = np.min(along, axis=-1) - slop, np.max(along, axis=-1) + slop
    with np.errstate(all="ignore"):
        low, high = low / np.where(low > 0.0, most, least), high / np.where(high > 0.0, least, most)
    high, low = (np.clip(np.nan_to_num(x, nan=y), -1.0, 1.0) for x, y in ((high, 1.0), (low, -1.0)))
    return np.arccos(np.minimum(high + ROUNDING, 1.0)), np.arccos(np.maximum(low - ROUNDING, -1.0))


def _limit(motion: Motion) -> float | None:
    by_grip = any(p.hold is not None and p.hold.by is HoldBy.GRIP for p in motion.phases)
    return LIMIT if by_grip or motion.contacts is not None else None


RULE = CheckRule(
    "grip",
    "1",
    "min",
    _limit,
    (Finder(_find, HITCHED_STATE | FREE_STATES),),
    "lower the object's mass, raise the tension, or use rougher cables",
    ease=Ease.NOTHING,
)
