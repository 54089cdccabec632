"""Routes for teams of single drones that keep out of each other's downwash: convex QPs by OSQP."""

from hitchopt.planners.separation.separate import separate
from hitchopt.planners.separation.task import Separated, SeparationTask, Tether

__all__ = ["Separated", "SeparationTask", "Tether", "separate"]
