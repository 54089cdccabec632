"""Check ``speed`` of the drones."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import rate_rule

RULE = rate_rule("speed", "m/s", 1, exported=True)
"""The largest speed of any drone, which ``where`` names."""
