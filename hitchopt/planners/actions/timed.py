"""A path that is flown by its own time: polynomials fine enough for the model, no timing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.model.evaluation import drone_jets
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight import FINEST, MODEL_ERROR
from hitchopt.planners.timing.flown import TimedFlight
from hitchopt.trajectory import PiecewisePolynomial, joined

Array = NDArray[np.float64]

PROBES = np.array([0.21, 0.5, 0.79])
"""Of a piece, where its polynomials are held against the model."""


def fly_timed(path: ShapePath, seconds: float) -> TimedFlight:
    """Return the flight on which the path's s is time over ``seconds`` [s].

    Pieces of the vertices' path stay apart, so that no polynomial smooths over a joint of them.
    """
    parts = [_on_piece(path, i) for i in range(path.vertices.pieces)]
    drones, vertices, legs = (
        _timed(joined(list(kind)), seconds) for kind in zip(*parts, strict=True)
    )
    tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
    return TimedFlight(drones, vertices, legs, tensions)


def _on_piece(path: ShapePath, piece: int) -> tuple[PiecewisePolynomial, ...]:
    """Return drones, vertices and legs over s on one piece, halved until they fit the model."""
    span = slice(piece, piece + 2)
    track = PiecewisePolynomial(
        path.vertices.breaks[span], path.vertices.coefficients[piece : piece + 1]
    )
    own = ShapePath(path.team, track, path.legs)
    first, last = track.breaks
    count = 1
    while True:
        breaks = np.linspace(first, last, count + 1)
        parts = [
            PiecewisePolynomial.hermite(breaks, data[:, :-1], data[:, 1:])
            for data in (np.moveaxis(jets, -1, 0) for jets in _jets(own, breaks))
        ]
        probes = (breaks[:-1, None] + np.diff(breaks)[:, None] * PROBES).reshape(-1)
        drones, _, legs = (part.at(probes) for part in parts)
        exact_drones, _, exact_legs = (jets[..., 0] for jets in _jets(own, probes))
        error = 2.0 * np.max(np.abs(drones - exact_drones)) + np.max(np.abs(legs - exact_legs))
        if count >= FINEST or error <= MODEL_ERROR * np.min(path.team.cable_length):
            return tuple(parts)
        count *= 2


def _jets(path: ShapePath, s: Array) -> tuple[Array, Array, Array]:
    """Return the jets by s of drones, vertices and legs."""
    flat = path.flat(s)
    drones = drone_jets(path.team, flat)
    legs = np.stack([flat.q_legs, drones.r_legs], axis=2)
    legs *= path.team.layout.has_leg[..., None]  # exactly zero, not nearly
    return drones.positions, flat.vertices, legs


def _timed(part: PiecewisePolynomial, seconds: float) -> PiecewisePolynomial:
    breaks = seconds * part.breaks
    breaks[-1] = seconds
    return PiecewisePolynomial(breaks, part.coefficients)
