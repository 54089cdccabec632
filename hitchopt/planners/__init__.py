"""Planners: each takes hitches and requirements, and returns trajectories or says what binds.

A planner is a frozen record of what it is given, with ``problem``, what is to be solved, to look
at, and ``solve()``: ``StraightMorph``, ``BlendedMorph``, ``ActionMorph``, ``OptimisedMorph``,
``DirectApproach``, ``GatheredApproach``, ``CarriedMove`` and ``SeparatedFlight``.
"""
