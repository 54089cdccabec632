"""Convex polygons and arcs, segments and boxes: plain geometry, independent of cables."""

from hitchopt.geometry.outline import ConvexArc as ConvexArc
from hitchopt.geometry.outline import ConvexPolygon as ConvexPolygon
from hitchopt.geometry.outline import Outline as Outline
from hitchopt.geometry.outline import regular_polygon as regular_polygon
from hitchopt.geometry.vectors import differences as differences
from hitchopt.geometry.vectors import hull_distance as hull_distance
from hitchopt.geometry.vectors import hull_offset as hull_offset
from hitchopt.geometry.vectors import shortest_offset as shortest_offset
