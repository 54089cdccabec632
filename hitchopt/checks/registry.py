"""All checks, in the order in which a certificate lists them."""

from __future__ import annotations

from hitchopt.checks import (
    acceleration,
    arena,
    body_rate,
    cable_clearance,
    cable_length,
    continuity,
    convexity,
    crossing,
    duration,
    equilibrium,
    grip,
    interlacing,
    jerk,
    keep_out,
    legs,
    object_clearance,
    separation,
    span,
    speed,
    stops,
    support,
    tension,
    thrust,
    tilt,
    tracking_radius,
    vertex_speed,
)

RULES = (
    separation.RULE,
    cable_clearance.RULE,
    crossing.RULE,
    speed.RULE,
    acceleration.RULE,
    jerk.RULE,
    vertex_speed.RULE,
    thrust.RULE,
    tilt.RULE,
    body_rate.RULE,
    legs.RULE,
    cable_length.RULE,
    span.RULE,
    equilibrium.RULE,
    convexity.RULE,
    arena.RULE,
    keep_out.RULE,
    tension.RULE,
    continuity.RULE,
    interlacing.RULE,
    object_clearance.RULE,
    grip.RULE,
    support.RULE,
    duration.RULE,
)
"""One rule per check; a new check is one file and one line here."""

REPORTS = (tracking_radius.RULE, stops.RULE)
"""What a certificate reports after its checks, without a limit."""

RULE_OF = {rule.name: rule for rule in RULES}
"""The rules by name."""
