"""Curves of single drones that stay out of each other's downwash, by convex QPs."""

from hitchopt.planners.separation.separate import SeparatedFlight
from hitchopt.planners.separation.task import Separated, SeparationTask

__all__ = ["Separated", "SeparatedFlight", "SeparationTask"]
