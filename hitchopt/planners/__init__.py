"""Planners: each takes hitches and requirements, and returns motions or the binding limits.

A planner is a frozen record of its inputs with a ``problem``, the mathematical problem, and
``solve()``: ``BlendedMorph``, ``ActionMorph``, ``OptimisedMorph``, ``DirectApproach``,
``GatheredApproach``, ``CarriedMove`` and ``SeparatedCurves``. The route without a search is a
function, ``straight_path``; ``motion_along`` times every path.

Steps plan from a ``StepTask`` to a ``StepPlan`` (``task``): at rest (``rests``), to the hitch at
their end (``ends``) along certified ``routes``, with ``compensation`` of friction.
"""
