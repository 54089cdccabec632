"""Paths of what is carried, and how far checks let accelerations along them differ from the plan's.

Legs and edges put forces on what they carry with which it moves at the plan's own rate. Where a
point accelerates by more, its mass times that is left unbalanced: checks ``equilibrium``,
``support`` and ``grip`` leave a slack for it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hitchopt.checks import equilibrium, grip, support
from hitchopt.checks.bounds.object_frames import heading_error
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import centre_path, supports_of
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

ROWS = 5
"""Number of coordinates of a carried path; those that it does not have are zero."""

TIGHT = 1e9
"""A ratio of slip load to load that none reaches: the search finds the smallest one closely."""

EVEN = 0.01
"""Least share of a sum of two numbers that one of them is taken for."""


def carried_paths(motion: Motion) -> Iterator[tuple[slice, Array, Array]]:
    """Yield runs of pieces on which an object is carried, paths, and their slack.

    Paths are places times masses (pieces, items, coordinates, degree + 1) [kg m], or places [m].
    """
    breaks, phases = motion.drones.breaks, motion.phases
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        poses = motion.object_poses.coefficients[:, index]
        moving = np.any(np.ptp(poses, axis=-1) > STILL, axis=-1)
        for by, parts in ((HoldBy.REST, _resting), (HoldBy.GRIP, _gripped)):
            own = [p.hold is not None and (p.hold.object, p.hold.by) == (name, by) for p in phases]
            on = moving & np.array(own)[motion.phase_of_piece]
            edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
            for first, last in edges.reshape(-1, 2).tolist():
                run = slice(first, last)
                if by is HoldBy.REST and body.rim is None:  # which check support refuses
                    continue
                span = motion.taken(run, motion.overlapping(breaks[first], breaks[last]))
                yield run, *parts(span, index, body)


def _resting(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that rests on clasps all the time.

    Clasps carry shares of its mass; they take what its centre of mass, being higher, moves from
    clasp to clasp; friction carries the rim along with clasps; and the line of weight and inertia
    meets their plane within their polygon.
    """
    pose = motion.object_poses.coefficients[:, index]
    places = motion.vertices.coefficients[:, motion.team.layout.clasps]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(centre), bernstein.degree(places))
    places, centre = bernstein.elevate(places, order), bernstein.elevate(centre, order)
    assert body.rim is not None
    height = abs(body.centre_of_mass[2] - body.rim.height)
    supports = supports_of(motion, index, body)
    mass = body.mass * supports.shares
    moving = body.mass * height * np.linalg.norm(supports.gains, axis=-1)
    moving *= 1.0 + heading_error(pose[:, 3:])
    # Both add up in z: |a + b|² <= a² / f + b² / (1 - f).
    speeds = [np.abs(bernstein.differentiate(part)) for part in (places[:, :, 2], centre[:, :2])]
    upward = mass * np.max(speeds[0], axis=-1)
    moved = moving * np.max(speeds[1], axis=(1, 2))[:, None]
    total = upward + moved
    share = np.divide(upward, total, out=np.full_like(total, 0.5), where=total > 0.0)
    share = np.clip(share, EVEN, 1.0 - EVEN)
    loads = np.zeros((*mass.shape, ROWS, order + 1))
    loads[:, :, :2] = mass[..., None, None] * places[:, :, :2]
    loads[:, :, 2] = (mass / np.sqrt(share))[..., None] * places[:, :, 2]
    factor = moving / np.sqrt(1.0 - share)
    loads[:, :, 3:] = factor[..., None, None] * centre[:, None, :2]
    points = np.zeros((len(mass), mass.shape[1] + 1, ROWS, order + 1))
    points[:, :-1, :3], points[:, -1, :3] = places, centre
    durations = motion.drones.durations
    level, pressing = _accelerations(points[:, :, :3], durations)
    sliding = (body.friction * pressing - level)[:, :-1] / (1.0 + body.friction)
    inside = support.RULE.finders[0].find(motion, 0.0).worst
    lean = height * (1.0 + level[:, -1:] / pressing[:, -1:])
    tipping = inside * pressing[:, -1:] / (lean + inside)
    slack = [equilibrium.spare_forces(motion), sliding, tipping]
    return np.concatenate([loads, points], axis=1), np.concatenate(slack, axis=1)


def _accelerations(points: Array, durations: Array) -> tuple[Array, Array]:
    """Return the largest level acceleration of points, and the least g + a_z (pieces, items)."""
    pushed = bernstein.differentiate(bernstein.differentiate(points))
    pushed = pushed / durations[:, None, None, None] ** 2
    level = np.max(np.linalg.norm(pushed[:, :, :2], axis=2), axis=-1)
    pressing: Array = GRAVITY + np.min(pushed[:, :, 2], axis=-1)
    return level, pressing


def _gripped(motion: Motion, index: int, body: SolidObject) -> tuple[Array, Array]:
    """Return paths and slack of an object that edges grip all the time.

    They push it as a whole; friction bears it and turns it with them.
    """
    pose = motion.object_poses.coefficients[:, index]
    centre = centre_path(pose, body)
    order = max(bernstein.degree(pose), bernstein.degree(centre))
    paths = np.zeros((len(pose), 2, ROWS, order + 1))
    paths[:, 0, :3] = body.mass * bernstein.elevate(centre, order)
    # |a| + |b| is at most the root of 2 (a² + b²).
    paths[:, 1, 0] = np.sqrt(2.0) * paths[:, 0, 2]
    turning = np.sqrt(2.0) * body.mass * grip.turning_reach(body)
    paths[:, 1, 1:3] = turning * bernstein.elevate(pose[:, 3:], order)
    ratio = grip.RULE.finders[0].find(motion, TIGHT).worst / grip.LIMIT
    loads = grip.gripped_loads(motion, index, body, np.arange(len(pose)))
    forces = np.min(equilibrium.spare_forces(motion), axis=1)
    return paths, np.stack([forces, (ratio - 1.0) * loads], axis=1)
