"""Floor 1: convex polygons, segments, boxes. Knows no cable."""

from hitchopt.geometry.nearby import nearby_boxes
from hitchopt.geometry.polygon import ConvexPolygon, regular_polygon
from hitchopt.geometry.random_polygon import random_convex_polygon
from hitchopt.geometry.segments import closest_offsets

__all__ = [
    "ConvexPolygon",
    "closest_offsets",
    "nearby_boxes",
    "random_convex_polygon",
    "regular_polygon",
]
