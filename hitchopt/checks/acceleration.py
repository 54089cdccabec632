"""Check ``acceleration`` of the drones."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import rate_rule

RULE = rate_rule("acceleration", "m/s²", 2)
"""The largest acceleration of any drone, which ``where`` names."""
