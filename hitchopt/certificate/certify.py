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
    legs,
    separation,
    speed,
    thrust,
    tilt,
    vertex_speed,
)
from hitchopt.certificate.report import Certificate, Check
from hitchopt.model.motion import Motion

CHECKS: dict[str, Callable[[Motion], Check | None]] = {
    "separation": separation.check,
    "cable_clearance": cable_clearance.check,
    "crossing": crossing.check,
    "speed": speed.check,
    "acceleration": acceleration.check,
    "jerk": jerk.check,
    "vertex_speed": vertex_speed.check,
    "thrust": thrust.check,
    "tilt": tilt.check,
    "legs": legs.check,
    "cable_length": cable_length.check,
    "equilibrium": equilibrium.check,
    "convexity": convexity.check,
    "arena": arena.check,
    "continuity": continuity.check,
    "duration": duration.check,
}
"""In the order of the certificate. ``span`` and ``interlacing`` are of no use to a hitch that
starts formed: they come with the motions that form one."""


def certify(motion: Motion, progress: Callable[[str], None] | None = None) -> Certificate:
    """Check a hitch in motion for all of its time.

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
    for name, check in CHECKS.items():
        if progress is not None:
            progress(name)
        result = check(motion)
        if result is not None:
            checks.append(result)
    return Certificate(motion.duration, tuple(checks))
