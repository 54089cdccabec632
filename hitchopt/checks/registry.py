"""All checks, in the order in which a certificate lists them."""

from __future__ import annotations

from hitchopt.checks import (
    cables,
    clasps,
    clearance,
    distances,
    drones,
    objects,
    stops,
    tracking,
)
from hitchopt.checks.story import CONTINUITY, DURATION, INTERLACING

RULES = (
    distances.SEPARATION,
    clearance.CABLE_CLEARANCE,
    distances.CROSSING,
    drones.SPEED,
    drones.ACCELERATION,
    drones.JERK,
    drones.VERTEX_SPEED,
    drones.THRUST,
    drones.TILT,
    drones.BODY_RATE,
    drones.LEGS,
    cables.CABLE_LENGTH,
    cables.SPAN,
    clasps.EQUILIBRIUM,
    clasps.CONVEXITY,
    drones.ARENA,
    clearance.KEEP_OUT,
    cables.TENSION,
    CONTINUITY,
    INTERLACING,
    clearance.OBJECT_CLEARANCE,
    objects.GRIP,
    objects.SUPPORT,
    DURATION,
)
"""One rule per check; a new check is one record and one line here."""

REPORTS = (tracking.TRACKING_RADIUS, stops.RULE)
"""What a certificate reports after its checks, without a limit."""

RULE_OF = {rule.name: rule for rule in RULES}
"""The rules by name."""
