"""Changes that make an infeasible problem feasible, verified by planning it."""
