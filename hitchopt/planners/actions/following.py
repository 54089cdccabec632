"""``follow_vertex``: a vertex meets timed points at their times, smoothly, from rest to rest."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import make_interp_spline

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import vertex_law
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SAME_PLACE = 1e-6
"""[m] Largest distance of a point at t = 0 from the vertex."""

STILL = 1e-9
"""[m] Distance of consecutive points below which the vertex stands still."""


def follow_vertex(start: Hitch, polygon: Outline, vertex: int, points: Array) -> Action:
    """Return the action that leads ``vertex`` along timed points, legs kept as by move_vertex.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    vertex: which.
    points: (J, 3), rows ``t, x, y`` [s, m, m]; t increases from 0 or later.

    Raises
    ------
    InfeasibleError: a point at t = 0 that is not where the vertex is.
    """
    here = start.vertices[vertex, :2]
    if points[0, 0] == 0.0:
        _check_begin(here, points[0, 1:], vertex)
        points = points[1:]
    times = np.append(0.0, points[:, 0])
    track = vertex_track(times, np.vstack([here, points[:, 1:]]))
    still = np.repeat(start.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(still, track.degree + 1, axis=-1)
    coefficients[:, vertex, :2] = track.coefficients
    seconds = float(times[-1])
    path = PiecewisePolynomial(times / seconds, coefficients)
    return Action(start, polygon, *vertex_law(start, vertex), path, seconds)


def vertex_track(times: Array, places: Array) -> PiecewisePolynomial:
    """Return the path through ``places`` (J, d) [m] at ``times`` (J,) [s], one piece each.

    Each moving stretch is a quintic spline with four continuous derivatives, which is the smoothest
    one in the sense of least jerk; it is at rest at both ends.
    """
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    resting = gaps < STILL
    # A stretch ends where the vertex stops or starts.
    changes = np.flatnonzero(resting[1:] | resting[:-1]) + 1
    bounds = [0, *changes.tolist(), len(gaps)]
    coefficients = np.empty((len(gaps), places.shape[1], 6))
    still = np.zeros(places.shape[1])
    rest = [(1, still), (2, still)]  # the stubs know of one condition an end, scipy of any
    for first, last in pairwise(bounds):
        span = slice(first, last)
        if resting[first]:
            coefficients[span] = places[span, :, None]
            continue
        knots = times[first : last + 1]
        met = places[first : last + 1]
        spline = make_interp_spline(knots - knots[0], met, k=5, bc_type=(rest, rest))  # type: ignore[arg-type]
        coefficients[span] = PiecewisePolynomial.from_spline(spline).coefficients
        coefficients[span, :, 0] = places[first:last]
        coefficients[span, :, -1] = places[first + 1 : last + 1]
    return PiecewisePolynomial(times, coefficients)


def _check_begin(here: Array, first: Array, vertex: int) -> None:
    away = float(np.linalg.norm(first - here))
    if away > SAME_PLACE:
        where = (f"p{vertex}",)
        remedy = (
            f"the path begins at t = 0 at {first.tolist()}, the vertex is at "
            f"{here.round(9).tolist()}: begin there, or later"
        )
        raise InfeasibleError(
            [Violation("continuity", away, SAME_PLACE, "max", "m", where, "at t = 0", remedy)]
        )
