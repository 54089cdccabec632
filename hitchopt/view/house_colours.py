"""Colours of cables, drones and marks in all pictures and scenes, and the words above them."""

from __future__ import annotations

from hitchopt.checks.certificate import Certificate
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion

COLOURS = ("#0b3c5d", "#2a8c82", "#e0a526", "#c8414f")
"""Colours of cables and drones. The first three differ in grey as well (luminance 20, 45 and 70 per
cent); the last one, of 45 per cent, stands only between the first and the third."""

TABLE_COLOUR, OBJECT_COLOUR = "#d3d8dd", "#e8d3a8"
"""Colours of objects that never move, and of those that can be carried."""

MARK_COLOUR = (232, 89, 12)
"""Colour of what a check concerns, as red, green and blue."""


def cable_colours(n: int) -> tuple[str, ...]:
    """Return a colour for each of n cables that differs from both neighbours'."""
    index = [k % 3 for k in range(n)]
    if n % 3 == 1 and n > 1:
        index[-1] = 3
    return tuple(COLOURS[i] for i in index)


def drone_colours(team: Team) -> tuple[str, ...]:
    """Return a colour for each drone: that of its cable, if there are any."""
    if team.has_cables:
        return tuple(colour for colour in cable_colours(team.robots) for _ in range(2))
    return tuple(COLOURS[i % len(COLOURS)] for i in range(len(team.drone_names)))


def object_colours(motion: Motion) -> tuple[str, ...]:
    """Return a colour for each object."""
    bodies = motion.requirements.objects.values()
    return tuple(TABLE_COLOUR if body.fixed else OBJECT_COLOUR for body in bodies)


def facts(motion: Motion) -> str:
    """Return who flies for how long."""
    drones = f"{len(motion.team.drone_names)} drones"
    who = f"{motion.team.robots} robots, {drones}" if motion.team.has_cables else drones
    return f"{who}, {motion.duration:.4g} s"


def verdict(certificate: Certificate) -> str:
    """Return in words whether a plan is certified."""
    total = len(certificate.checks)
    if certificate.certified:
        return f"certified for all t: {total} of {total} limits hold"
    return "NOT CERTIFIED: " + ", ".join(check.name for check in certificate.violated)
