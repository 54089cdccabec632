"""Check ``jerk`` of the drones."""

from __future__ import annotations

from hitchopt.checks.bounds.rates import rate_rule

RULE = rate_rule("jerk", "m/s³", 3)
"""The largest jerk of any drone, which ``where`` names."""
