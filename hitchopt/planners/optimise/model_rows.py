"""Rows of a way's program: drones tied to the flat outputs, bodies kept apart."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import ConvexPolygon
from hitchopt.model.robot import planar_function
from hitchopt.planners.optimise.between import between_rows, instants
from hitchopt.planners.optimise.draft import Draft
from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.pairs import pair_rows
from hitchopt.planners.optimise.variable_bounds import Bounds, Step
from hitchopt.planners.optimise.variables import Layout

Array = NDArray[np.float64]

FLATTEST = math.radians(3.0)
"""[rad] Vertices stay this sharp on the way, or half as sharp as at its ends if that is less."""

BETWEEN = 0.35
"""Of a step's reach, for pairs between the knots, which the knots keep apart as well."""

DEAR = 100.0
"""Per metre by which bodies stay too near: more than any way is worth that lets them."""


def tie_drones(draft: Draft, layout: Layout, knots: ca.MX, way: Way) -> None:
    """Tie drones and r-legs to the flat outputs, and keep every vertex a corner."""
    n, inner = layout.robots, knots.size2()
    columns = n * inner

    def gathered(places: NDArray[np.intp]) -> ca.MX:
        """Return (width, n · inner) of places (n, width)."""
        return ca.reshape(knots[places.ravel().tolist(), :], places.shape[1], columns)

    around = [np.roll(layout.vertices, shift, axis=0) for shift in (1, 0, -1, -2)]
    pulls = [np.roll(layout.tensions, shift) for shift in (1, 0, -1)]
    free = not bool(np.all(way.team.tension == way.team.tension[0]))
    place, turn = planar_function(not free).map(columns)(
        gathered(np.concatenate(around, axis=1)),
        gathered(layout.q_legs[:, None]),
        gathered(np.stack(pulls, axis=1)),
        np.tile(way.team.cable_length, inner)[None],
    )
    drones = layout.drones.reshape(n, 4)
    lifted = gathered(np.column_stack([drones, layout.r_legs]))
    draft.keep(ca.vec(place - lifted), 0.0, 0.0)
    sharpest = [np.min(ConvexPolygon(way.polygons[end]).exterior_angles) for end in (0, -1)]
    draft.keep(ca.vec(turn), math.sin(min(FLATTEST, 0.5 * float(min(sharpest)))), np.inf)


def keep_apart(draft: Draft, x: ca.MX, way: Way, bounds: Bounds, step: Step) -> None:
    """Keep all near pairs apart, at the knots and between them.

    Those that are too near now, as in a first guess, are parted as far as a step can.
    """
    layout, count = Layout(way.team.robots), len(way.polygons) - 1
    table = layout.table(way)
    now = table[1:-1].ravel()
    margins = bounds.margins(count, np.arange(1.0, count))
    pairs = pair_rows(layout, table, bounds.requirements.separation, margins, step.reach)
    if len(pairs.first):
        across = x[pairs.first[:, 0].tolist()] - x[pairs.second[:, 0].tolist()]
        along = x[pairs.first[:, 1].tolist()] - x[pairs.second[:, 1].tolist()]
        squared = np.sum((now[pairs.first] - now[pairs.second]) ** 2, axis=1)
        scale = 1.0 / (2.0 * pairs.apart)  # of squares to about metres
        value = (across**2 + along**2) * scale
        draft.urge(value, scale * pairs.apart**2, scale * squared, DEAR)
    linear = [(pairs.rows, pairs.least)]
    if step.parts > 1:
        places = instants(count, step.parts)
        between = between_rows(way, bounds, places, BETWEEN * step.reach)
        linear.append((between.rows, between.least))
    for matrix, least in linear:
        if len(least):
            draft.urge(ca.DM(matrix) @ x, least, matrix @ now, DEAR)
