"""Planners: each takes hitches and requirements, and returns motions or the limits that bind.

A planner is a frozen record of its inputs, with ``problem``, the mathematical problem to look
at, and ``solve()``: ``StraightMorph``, ``BlendedMorph``, ``ActionMorph``, ``OptimisedMorph``,
``DirectApproach``, ``GatheredApproach``, ``CarriedMove`` and ``SeparatedFlight``.
"""
