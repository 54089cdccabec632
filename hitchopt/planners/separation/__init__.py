"""Curves of single drones outside of each other's downwash, by convex QPs."""

from hitchopt.planners.separation.separate import SeparatedCurves
from hitchopt.planners.separation.task import SeparationResult, SeparationTask

__all__ = ["SeparatedCurves", "SeparationResult", "SeparationTask"]
