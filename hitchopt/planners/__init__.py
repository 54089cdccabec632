"""Planners: each takes hitches and requirements, and returns motions or the binding limits.

A planner is a frozen record of its inputs with ``solve()``: ``ActionMorph``, ``OptimisedMorph``,
``DirectApproach``, ``GatheredApproach``, ``CarriedMove`` and ``SeparatedCurves``. The route without
a search is a function, ``straight_path``; ``motion_along`` times every path.

Packages plan geometry and timing; the modules beside them decide what a step tries. A step gives
them a ``StepTask`` and takes a ``StepPlan`` (``task``): at rest (``rests``), to the hitch at its
end (``ends``) ``along`` a given path or the first certified one of ``routes``, which may be an
``optimised_route``; ``blending`` steps.
"""
