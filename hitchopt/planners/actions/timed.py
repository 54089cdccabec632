"""A path that is flown by its own time: polynomials fine enough for the model, no timing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.planners.path.jets import polynomials_through
from hitchopt.planners.path.shape_path import ShapePath, path_jets
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import FINEST, MODEL_ERROR
from hitchopt.trajectory import PiecewisePolynomial, joined

Array = NDArray[np.float64]

PROBES = np.array([0.21, 0.5, 0.79])
"""Places in a piece where its polynomials are compared with the model."""


def fly_timed(path: ShapePath, seconds: float) -> Flight:
    """Return the flight on which the path's s is time over ``seconds`` [s].

    Pieces of the vertices' path stay apart, so that no polynomial smooths over a joint of them.
    """
    parts = [_on_piece(path, i) for i in range(path.vertices.pieces)]
    drones, vertices, legs = (joined(list(kind)) for kind in zip(*parts, strict=True))
    tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
    return Flight(drones, vertices, legs, tensions).lasting(seconds)


def _on_piece(path: ShapePath, piece: int) -> list[PiecewisePolynomial]:
    """Return drones, vertices and legs over s on one piece, halved until they fit the model."""
    track = path.vertices.taken(slice(piece, piece + 1))
    own = replace(path, vertices=track)
    count = 1
    while True:
        breaks = np.linspace(track.breaks[0], track.breaks[1], count + 1)
        parts = [polynomials_through(breaks, jets) for jets in path_jets(own, breaks)[:3]]
        probes = (breaks[:-1, None] + np.diff(breaks)[:, None] * PROBES).reshape(-1)
        drones, _, legs = (
            np.max(np.abs(part.at(probes) - jets[..., 0]))
            for part, jets in zip(parts, path_jets(own, probes), strict=False)
        )
        error = 2.0 * drones + legs
        if count >= FINEST or error <= MODEL_ERROR * np.min(path.team.cable_length):
            return parts
        count *= 2
