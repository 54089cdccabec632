"""All checks of a plan, from its polynomials only."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from hitchopt.checks import (
    acceleration,
    arena,
    cable_clearance,
    cable_length,
    continuity,
    convexity,
    crossing,
    duration,
    equilibrium,
    interlacing,
    jerk,
    keep_out,
    legs,
    separation,
    span,
    speed,
    tension,
    thrust,
    tilt,
    vertex_speed,
)
from hitchopt.checks.bounds import drawn_length, hanging_clearance, hanging_crossing
from hitchopt.checks.certificate import Certificate, Check, most_pressing
from hitchopt.motion.motion import Motion

DRONES: dict[str, Callable[[Motion], Check | None]] = {
    "separation": separation.check,
    "speed": speed.check,
    "acceleration": acceleration.check,
    "jerk": jerk.check,
    "thrust": thrust.check,
    "tilt": tilt.check,
    "arena": arena.check,
    "keep_out": keep_out.check,
    "continuity": continuity.check,
    "duration": duration.check,
}
"""Checks of whatever flies, for all of its time."""

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

FREE: dict[str, Callable[[Motion], Check | None]] = {
    "cable_clearance": hanging_clearance.check,
    "crossing": hanging_crossing.check,
    "span": span.check,
    "cable_length": drawn_length.check,
}
"""Checks of free cables, for as long as there is no hitch."""

CABLES: dict[str, Callable[[Motion], Check | None]] = {"tension": tension.check}
"""Checks of drones on cables, for all of the time, with a hitch or without."""

WHOLE: dict[str, Callable[[Motion], Check | None]] = {"interlacing": interlacing.check}
"""Checks of how free cables become a hitch, and the other way around."""

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
    "span",
    "equilibrium",
    "convexity",
    "arena",
    "keep_out",
    "tension",
    "continuity",
    "interlacing",
    "duration",
)
"""In the order of the certificate."""


def certify(motion: Motion, progress: Callable[[str], None] | None = None) -> Certificate:
    """Check what flies for all of its time.

    Every ``worst`` is a bound from Bernstein coefficients with subdivision: the quantity does not
    pass it at any t, and comes within ``1e-4`` of it, relative, or ``2e-7`` in its unit. Rounding
    is covered by a margin, already taken into ``worst``: ``2**-40`` of the largest numbers that
    enter the quantity (positions; positions over a leg for directions), and for a k-th derivative
    of degree N on a piece of h seconds ``2**-50 · 2^k · N!/(N-k)! / h^k`` of the largest difference
    of neighbouring coefficients besides. ``continuity`` and ``duration`` are computed outright.
    Hanging cables are no polynomials: distances to them are bounded to within a few millimetres.

    A motion that is degenerate somewhere (a drone on its vertex, two drones at one place, a cable
    without tension) fails the checks concerned.

    Parameters
    ----------
    motion: the plan.
    progress: called with the name of every check as it starts.
    """
    checks = []
    for name in _applying(motion):
        if progress is not None:
            progress(name)
        result = _result(name, motion)
        if result is not None:
            checks.append(result)
    return Certificate(motion.duration, tuple(checks))


def _applying(motion: Motion) -> Iterator[str]:
    """Yield the names of the checks that the motion has something for."""
    here = set(DRONES) if motion.requirements.keep_out else set(DRONES) - {"keep_out"}
    if motion.team.has_cables:
        formed = motion.formed
        here |= set(CABLES)
        here |= set(HITCH) if np.any(formed) else set()
        here |= set() if np.all(formed) else {*FREE, *WHOLE}
    yield from (name for name in CHECKS if name in here)


def _result(name: str, motion: Motion) -> Check | None:
    if name in DRONES:
        return DRONES[name](motion)
    whole = CABLES | WHOLE
    if name in whole:
        return whole[name](motion)
    results = []
    for checks, formed in ((HITCH, True), (FREE, False)):
        if name in checks:
            results += [checks[name](run) for run in motion.spans(formed=formed)]
    return most_pressing([result for result in results if result is not None])
