"""All checks of a plan, from its polynomials only."""

from __future__ import annotations

from collections.abc import Callable

from hitchopt.certificate import (
    acceleration,
    arena,
    cable_clearance,
    cable_length,
    continuity,
    convexity,
    crossing,
    duration,
    equilibrium,
    jerk,
    keep_out,
    legs,
    separation,
    speed,
    thrust,
    tilt,
    vertex_speed,
)
from hitchopt.certificate.report import Certificate, Check, most_pressing
from hitchopt.model.motion import Flying, Motion, SwarmMotion

DRONES: dict[str, Callable[[Flying], Check | None]] = {
    "separation": separation.check,
    "speed": speed.check,
    "acceleration": acceleration.check,
    "jerk": jerk.check,
    "thrust": thrust.check,
    "tilt": tilt.check,
    "arena": arena.check,
    "continuity": continuity.check,
    "duration": duration.check,
}
"""Checks of whatever flies, for all of its time."""

SWARM: dict[str, Callable[[SwarmMotion], Check | None]] = {"keep_out": keep_out.check}
"""Checks of single drones."""

HITCH: dict[str, Callable[[Motion], Check | None]] = {
    "cable_clearance": cable_clearance.check,
    "crossing": crossing.check,
    "vertex_speed": vertex_speed.check,
    "legs": legs.check,
    "cable_length": cable_length.check,
    "equilibrium": equilibrium.check,
    "convexity": convexity.check,
}
"""Checks of a hitch, for as long as it exists."""

CHECKS = (
    "separation",
    "cable_clearance",
    "crossing",
    "speed",
    "acceleration",
    "jerk",
    "vertex_speed",
    "thrust",
    "tilt",
    "legs",
    "cable_length",
    "equilibrium",
    "convexity",
    "arena",
    "keep_out",
    "continuity",
    "duration",
)
"""In the order of the certificate."""


def certify(motion: Flying, progress: Callable[[str], None] | None = None) -> Certificate:
    """Check what flies for all of its time.

    Every ``worst`` is a bound from Bernstein coefficients with subdivision: the quantity does not
    pass it at any t, and comes within ``1e-4`` of it, relative, or ``2e-7`` in its unit. Rounding
    is covered by a margin, already taken into ``worst``: ``2**-40`` of the largest numbers that
    enter the quantity (positions; positions over a leg for directions), and for a k-th derivative
    of degree N on a piece of h seconds ``2**-50 · 2^k · N!/(N-k)! / h^k`` of the largest difference
    of neighbouring coefficients besides. ``continuity`` and ``duration`` are computed outright.

    A motion that is degenerate somewhere (a drone on its vertex, two drones at one place, a cable
    without tension) fails the checks concerned.

    Parameters
    ----------
    motion: the plan.
    progress: called with the name of every check as it starts.
    """
    checks = []
    for name in CHECKS:
        if name in (SWARM if isinstance(motion, Motion) else HITCH):
            continue
        if progress is not None:
            progress(name)
        result = _result(name, motion)
        if result is not None:
            checks.append(result)
    return Certificate(motion.duration, tuple(checks))


def _result(name: str, motion: Flying) -> Check | None:
    if name in DRONES:
        return DRONES[name](motion)
    if isinstance(motion, SwarmMotion):
        return SWARM[name](motion)
    results = [HITCH[name](span) for span in motion.spans(formed=True)]
    return most_pressing([result for result in results if result is not None])
