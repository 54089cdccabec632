"""The certificate of motions in a row from those of its parts, without looking at them again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hitchopt.checks import continuity, interlacing, tension
from hitchopt.checks.certificate import Certificate, Check
from hitchopt.checks.certify import CHECKS
from hitchopt.checks.duration import check as duration_check
from hitchopt.motion.motion import Motion

WHOLE = ("tension", "continuity", "interlacing", "duration")
"""Checks of the whole, which say more than those of its parts."""


def merged(motion: Motion, parts: Sequence[Certificate]) -> Certificate:
    """Return what ``certify`` says of a joined motion, given what it has said of its parts.

    A bound for all of the time is the worst of the bounds for its spans. Joining moves times and
    raises degrees, which changes coefficients by units in the last place; the margins of rounding,
    a thousand times these, are already in every ``worst``. Continuity and
    tensions are looked at anew, joints included, and so are the duration and what cables have
    become interlaced to.

    Parameters
    ----------
    motion: of the parts one after the other, each from where the last one ends.
    parts: their certificates, whatever they say of the duration.
    """
    begins = [float(motion.drones.breaks[0])]
    for part in parts:
        begins.append(begins[-1] + part.duration)
    found: dict[str, Check] = {}
    for begin, part in zip(begins, parts, strict=False):
        for check in part.checks:
            if check.name in WHOLE:
                continue
            known = found.get(check.name)
            if known is None or _pressure(check) > _pressure(known):
                found[check.name] = replace(check, time=begin + check.time)
    for name, whole in (
        ("tension", tension.check(motion)),
        ("continuity", continuity.check(motion)),
        ("interlacing", interlacing.check(motion)),
        ("duration", duration_check(motion)),
    ):
        found.pop(name, None)
        if whole is not None:
            found[name] = whole
    return Certificate(motion.duration, tuple(found[name] for name in CHECKS if name in found))


def _pressure(check: Check) -> float:
    """Return how near a quantity comes to its limit; drones may have different ones."""
    if check.sense == "min":
        return check.limit - check.worst
    return check.worst / check.limit if check.limit > 0.0 else check.worst - check.limit
