"""Convex polygons and arcs, segments and boxes, without any cable."""

from hitchopt.geometry.arc import ConvexArc
from hitchopt.geometry.outline import Outline
from hitchopt.geometry.polygon import ConvexPolygon, regular_polygon
from hitchopt.geometry.segments import differences, shortest_offset

__all__ = [
    "ConvexArc",
    "ConvexPolygon",
    "Outline",
    "differences",
    "regular_polygon",
    "shortest_offset",
]
