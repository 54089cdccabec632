"""Changes that make an infeasible problem feasible, verified by planning it."""

from hitchopt.mission.repair.change import Change, Edit, Suggestion
from hitchopt.mission.repair.suggest import BUDGET, NO_CHANGE, find_suggestions

__all__ = ["BUDGET", "NO_CHANGE", "Change", "Edit", "Suggestion", "find_suggestions"]
