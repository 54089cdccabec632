"""Hitches and polygons that the optimiser's tests share."""

import numpy as np

import hitchopt as ho
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements

FREE = Requirements(ho.Limits(), ho.Separation(), None)
SQUARE = regular_polygon(4, 1.2, np.pi / 4)
PENTAGON = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])
OCTAGON = regular_polygon(8, 1.3)


def ends(
    team: Team, first: ConvexPolygon, last: ConvexPolygon, requirements: Requirements = FREE
) -> tuple[Hitch, Hitch]:
    start = Hitch.spread(
        team, first, limits=requirements.limits, separation=requirements.separation
    )
    end = Hitch.nearest(
        team,
        last,
        1.0,
        start.fractions,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
    )
    return start, end
