"""Floor 5: planners; each takes a hitch and limits and gives trajectories.

A planner is a frozen record of what it is asked. ``problem`` is that as data, to look at; it raises
InfeasibleError where it cannot be solved in itself. ``solve()`` returns the solution.
"""
