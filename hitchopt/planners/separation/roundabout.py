"""Initial guess for crowds: drones that meet in one place go around it, all on the same side.

Pushes between pairs (``guess.py``) amplify rounding a million times where tens of drones meet at
once. A roundabout is closed form: a smooth function of the nominal curves.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from hitchopt.planners.separation.guess import WANTED, rightward
from hitchopt.planners.separation.setting import SAMPLES, Setting, inside
from hitchopt.values import Array

CROWD = 32.0
"""Number of drones that meet at once from which on a roundabout is tried."""

LAYERS = 2
"""Number of altitudes at which drones pass, in the order of their numbers: rings are as much
smaller."""

RING = 1.06
"""Radius of a ring over that at which the drones of one layer have the separation WANTED."""

WIDTH = 1.3
"""Distance from the centre at which drones leave their straight routes, over the radius of a ring
of all drones. With 1.0 and 1.2 for RING and WIDTH
circles of 64 drones take 1.7 % longer."""

CLIMB = 6
"""Power of the distance in the offset upward: layers are apart before drones are within a ring of
all of them."""


def roundabout(setting: Setting) -> Array | None:
    """Return the coefficients (N, count, 3) [m] of curves around crowds; None where there are none.

    With ``x`` the distance from the centre of a crowd over WIDTH radii of a ring of all drones, the
    offset to the right is ``(1 - x²)²`` times the radius of a layer's ring, and that upward
    ``(1 - x⁶)²`` times the layer's altitude. Takes O(M log M) for M samples of drones, and what
    pairs are close.
    """
    task, grid = setting.task, setting.grid
    s = (np.arange(SAMPLES * grid.pieces) + 0.5) / (SAMPLES * grid.pieces)
    basis = grid.sampled(s)
    points = np.einsum("sc,ncd->snd", basis, setting.nominal)
    steps = np.einsum("sc,ncd->snd", grid.sampled(s, 1), setting.nominal) / len(s)
    crowd, centre = _crowds(points, steps, setting.scale)
    if np.max(crowd, initial=0.0) < CROWD:
        return None
    spacing = 2.0 * WANTED * task.requirements.separation.radius
    ring = np.where(crowd < CROWD, 0.0, RING * spacing * crowd / (2.0 * math.pi))
    distance = np.linalg.norm((points - centre)[..., :2], axis=-1)
    x = np.divide(distance, WIDTH * ring, out=np.ones_like(distance), where=ring > 0.0)
    aside, upward = (np.maximum(1.0 - x**power, 0.0) ** 2 for power in (2, CLIMB))
    right = rightward(steps.reshape(-1, 3), 0.0).reshape(steps.shape)
    offset = (ring / LAYERS * aside)[..., None] * right
    layer = np.arange(task.drones) % LAYERS - 0.5 * (LAYERS - 1)
    offset[..., 2] += 2.0 * WANTED * task.requirements.separation.height * layer * upward
    free = basis[:, grid.free]
    fitting = np.linalg.solve(free.T @ free, free.T)  # well conditioned: B-splines
    coefficients = setting.nominal.copy()
    coefficients[:, grid.free] += np.einsum("fs,snd->nfd", fitting, offset)
    if task.requirements.arena is not None:
        coefficients[:, grid.free] = inside(task.requirements.arena, coefficients[:, grid.free])
    return coefficients


def _crowds(points: Array, steps: Array, scale: Array) -> tuple[Array, Array]:
    """Return how many drones each drone meets at once, itself included (N,), and where (N, 3) [m].

    Parameters
    ----------
    points, steps: (samples, N, 3) [m], positions and their changes from sample to sample.
    """
    samples, drones, _ = points.shape
    scaled, moves = ((part * scale).reshape(-1, 3) for part in (points, steps))
    # Between samples drones approach each other by at most two of their moves.
    reach = WANTED + 2.0 * float(np.max(np.linalg.norm(moves, axis=1)))
    sample = np.repeat(2.0 * reach * np.arange(samples), drones)  # pairs of one sample only
    tree = cKDTree(np.column_stack([scaled, sample]))
    first, second = tree.query_pairs(reach, output_type="ndarray").T
    offset, rate = scaled[first] - scaled[second], moves[first] - moves[second]
    squared = np.sum(rate * rate, axis=1)
    when = np.divide(
        -np.sum(offset * rate, axis=1), squared, out=np.zeros_like(squared), where=squared > 0.0
    )
    missed = np.linalg.norm(offset + when[:, None] * rate, axis=1)
    # Hat functions of time add up to one over the samples.
    weight = np.maximum(1.0 - np.abs(when), 0.0) * np.maximum(1.0 - missed / WANTED, 0.0)
    met = np.zeros((samples * drones, 4))
    flat, along = points.reshape(-1, 3), steps.reshape(-1, 3)
    for one in (first, second):
        places = np.column_stack([np.ones_like(weight), flat[one] + when[:, None] * along[one]])
        for axis in range(4):
            met[:, axis] += np.bincount(one, weight * places[:, axis], len(met))
    by_sample = met.reshape(samples, drones, 4)
    at_once = by_sample[:-1] + by_sample[1:]
    most = np.argmax(at_once[..., 0], axis=0)
    found = at_once[most, np.arange(drones)]
    return found[:, 0] + 1.0, found[:, 1:] / np.maximum(found[:, :1], 1e-9)
