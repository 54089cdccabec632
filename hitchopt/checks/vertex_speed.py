"""Check ``vertex_speed``: the hitch changes slowly enough to stay quasi-static."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import rate_rule

RULE = rate_rule("vertex_speed", "m/s", 1, vertices=True)
"""The largest speed of any vertex while the hitch exists; ``where`` names it (such as ``p1``)."""
