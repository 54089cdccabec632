"""Curves of single drones that stay out of each other's downwash, by convex QPs."""

from hitchopt.planners.separation.separate import separate
from hitchopt.planners.separation.task import Separated, SeparationTask

__all__ = ["Separated", "SeparationTask", "separate"]
