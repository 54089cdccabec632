"""Floor 1: convex polygons and arcs, segments, boxes. Knows no cable."""

from hitchopt.geometry.arc import ConvexArc
from hitchopt.geometry.outline import Outline
from hitchopt.geometry.polygon import ConvexPolygon, regular_polygon
from hitchopt.geometry.random_polygon import random_convex_polygon
from hitchopt.geometry.segments import differences, shortest_offset

__all__ = [
    "ConvexArc",
    "ConvexPolygon",
    "Outline",
    "differences",
    "random_convex_polygon",
    "regular_polygon",
    "shortest_offset",
]
