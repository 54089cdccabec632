"""Sag of a hitch: its vertices hang below those of the plan, which neglects the cables' weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from hitchopt.hitch import GRAVITY, Team

Array = NDArray[np.float64]

ROUNDS = 8
"""Number of iterations between sag and tension; each reduces the error to about a tenth."""


def predicted_sag(
    team: Team,
    density: float,
    drones: Array,
    vertices: Array,
    tensions: Array,
    stiffness: ArrayLike = 0.0,
) -> Array:
    """Return (points,) [m]: the depth of the vertices below the plan.

    It solves the vertical force balance, linear in the heights: every part of a cable pulls along
    its chord and puts half of its weight on each of its ends. Sagging takes length; both drones of
    a cable yield to it, and pull harder in proportion to their ``stiffness``.

    Parameters
    ----------
    team: drones and cables.
    density: of the cables [kg/m].
    drones, vertices: planned positions (2n, 3), (points, 3) [m].
    tensions: planned tensions (n,) [N].
    stiffness: of the drones' position loops [N/m], (n,) or one; 0: they pull as hard as planned.
    """
    layout = team.layout
    edges = np.linalg.norm(layout.edges(vertices), axis=-1)
    legs = np.linalg.norm(drones - vertices[layout.anchors], axis=-1)
    legs = np.where(layout.has_leg.ravel(), legs, 0.0)
    lengths = np.column_stack([legs[0::2], edges, legs[1::2]])
    pull, sag = tensions, np.zeros(layout.points)
    for _ in range(ROUNDS):
        sag = _balance(team, density, edges, legs, pull)
        drops = np.column_stack(
            [sag[layout.starts], sag[layout.ends] - sag[layout.starts], sag[layout.ends]]
        )
        slanted = np.divide(drops**2, 2.0 * lengths, out=np.zeros_like(drops), where=lengths > 0.0)
        bent = (GRAVITY * density / pull[:, None]) ** 2 * lengths**3 / 24.0
        pull = tensions + 0.5 * np.asarray(stiffness) * np.sum(slanted + bent, axis=-1)
    return sag


def _balance(team: Team, density: float, edges: Array, legs: Array, tensions: Array) -> Array:
    """Return the sag (points,) [m] under given tensions."""
    layout = team.layout
    points, clasps = layout.points, layout.clasps
    pull = np.repeat(tensions, 2)
    stiffness = np.divide(pull, legs, out=np.zeros_like(legs), where=legs > 0.0)
    diagonal, load = np.zeros(points), np.zeros(points)
    np.add.at(diagonal, layout.anchors, stiffness)
    np.add.at(load, layout.anchors, 0.5 * GRAVITY * density * legs)
    for end in (layout.starts, layout.ends):
        np.add.at(diagonal, end, tensions / edges)
        np.add.at(load, end, 0.5 * GRAVITY * density * edges)
    rows = np.concatenate([np.arange(points), layout.starts, layout.ends])
    columns = np.concatenate([np.arange(points), layout.ends, layout.starts])
    values = np.concatenate([diagonal, -tensions / edges, -tensions / edges])
    matrix = coo_array((values, (rows, columns)), shape=(points, points)).tocsc()
    sag = np.zeros(points)  # drones hold a chain's ends
    sag[clasps] = spsolve(matrix[clasps][:, clasps], load[clasps])
    return sag
