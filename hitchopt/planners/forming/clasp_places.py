"""Where the clasps may lie while drones draw their cables out to the hitch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hitchopt.hitch import Hitch, Team
from hitchopt.planners.forming.turns import Turns
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the line from pre-hitch to hitch that are tried as places of the clasps."""


def clasps_drawn_out(
    turns: Turns, scale: float, hitch: Hitch, flights: Sequence[PiecewisePolynomial]
) -> list[PiecewisePolynomial]:
    """Return where the clasps may lie (points, 3) [m] while the drones fly out.

    They move along with the drones, between places that all cables reach around at the ends of
    every flight. Lengths are convex: cables that reach at both ends of a straight flight reach in
    between.
    """
    here, found = clasp_places(turns, scale, hitch, turns.drones(np.asarray(0.0))), []
    for i, flight in enumerate(flights):
        start, end = flight.coefficients[0, ..., 0], flight.coefficients[-1, ..., -1]
        last = i == len(flights) - 1
        there = hitch.vertices if last else clasp_places(turns, scale, hitch, end)
        gone = flight.coefficients - start[..., None]
        farthest = int(np.argmax(np.linalg.norm(end - start, axis=1)))
        whole = (end - start)[farthest]
        size = float(whole @ whole)
        s = np.einsum("d,pdm->pm", whole, gone[:, farthest]) / size if size > 0.0 else np.ones(1)
        s = np.clip(s, 0.0, 1.0)[..., None, None, :]
        points = here[..., None] * (1.0 - s) + there[..., None] * s
        shape = (flight.pieces, *points.shape[-3:])
        found.append(PiecewisePolynomial(flight.breaks, np.broadcast_to(points, shape)))
        here = there
    return found


def clasp_places(turns: Turns, scale: float, hitch: Hitch, drones: Array) -> Array:
    """Return the places (points, 3) [m] of the clasps that cables reach around most easily.

    Candidates are the middles of the pairs, the pre-hitch's vertices, and places between them and
    the hitch's; the ends of chains are where their drones are.
    """
    layout = hitch.team.layout
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    middles = hitch.vertices.copy()
    middles[layout.clasps] = turns.centres
    alone = np.flatnonzero(~layout.has_leg.ravel())
    best, least = hitch.vertices, np.inf
    for first in (centre + scale * (hitch.vertices - centre), middles):
        for share in SHARES:
            points = first + share * (hitch.vertices - first)
            points[layout.anchors[alone]] = drones[alone]
            reach = largest_reach(hitch.team, drones, points)
            if reach < least:
                best, least = points, reach
    return best


def largest_reach(team: Team, drones: Array, points: Array) -> float:
    """Return the largest share of a cable that its route around the points takes."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return float(np.max((np.sum(legs, axis=1) + edges) / team.cable_length))
