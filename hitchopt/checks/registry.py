"""All checks, in the order in which a certificate lists them, and certificates made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from hitchopt.checks import cables, clasps, clearance, distances, drones, objects, stops, tracking
from hitchopt.checks.certificate import Certificate, Check, most_pressing
from hitchopt.checks.rule import CheckRule, Found, ReportRule
from hitchopt.checks.spans import shared_values
from hitchopt.checks.story import CONTINUITY, DURATION, INTERLACING
from hitchopt.checks.tracking import GAMMA
from hitchopt.motion.motion import Motion
from hitchopt.values import instance, not_negative, sequence

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
    clearance.ARENA,
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

OF_PARTS = tuple(report for report in REPORTS if not report.whole)
"""What is known of a joined motion if it is known of its parts."""

RULE_OF = {rule.name: rule for rule in RULES}
"""The rules by name."""


def certify(
    motion: Motion,
    progress: Callable[[str], None] | None = None,
    gamma: float = GAMMA,
    *,
    reports: Sequence[ReportRule] = REPORTS,
) -> Certificate:
    """Check what flies for all of its time.

    No quantity passes its ``worst`` at any t; it comes within ``1e-4`` of it, relative, or ``2e-7``
    in its unit, distances to hanging cables within millimetres. Rounding is covered by a margin. A
    motion that is degenerate somewhere (two drones at one place, a cable without tension) fails the
    checks concerned.

    Parameters
    ----------
    motion: the plan.
    progress: called with the name of every check as it starts, and how many are done.
    gamma: how many times farther than drones vertices may be off, for ``tracking_radius``.
    reports: that are made after the checks, besides those with a limit; OF_PARTS where ``merged``
        computes the others, none where time is short.

    Raises
    ------
    InputError: a gamma that is negative or not finite.
    """
    instance("motion", motion, Motion)
    gamma = not_negative("gamma", gamma)
    told: tuple[ReportRule, ...] = sequence("reports", reports)
    told = tuple(each for each in REPORTS if each in told or each.limit(motion) is not None)
    rules = tuple(rule for rule in RULES if rule.limit_of(motion) is not None)
    every: tuple[CheckRule | ReportRule, ...] = (*rules, *told)
    found: dict[str, Sequence[Found]] = dict.fromkeys(RULE_OF, ())
    checks: list[Check | None] = []
    with shared_values():
        for i, each in enumerate(every):
            if progress is not None:
                progress(f"{each.name}, {i} of {len(every)}")
            if isinstance(each, CheckRule):
                found[each.name] = each.findings(motion)
                checks.append(most_pressing(span.check for span in found[each.name]))
            else:
                checks.append(each.check(motion, found, gamma))
    return Certificate(motion.duration, tuple(filter(None, checks)))


def merged(motion: Motion, parts: Sequence[Certificate]) -> Certificate:
    """Return what ``certify`` says of a joined motion, given what it has said of its parts.

    A bound for all of the time is the worst of the bounds for its spans: joining changes
    coefficients by units in the last place, far less than the margins in every ``worst``. Rules of
    the ``whole`` are applied anew; where a single part has no joints, only duration and stops.

    Parameters
    ----------
    motion: of the parts one after the other, each from where the last one ends.
    parts: their certificates, whatever they say of the duration.
    """
    if tracking.TRACKING_RADIUS.limit(motion) is not None:
        return certify(motion)  # parts keep wider distances, of which their certificates tell
    begin = float(motion.drones.breaks[0])
    found: dict[str, list[Check]] = {rule.name: [] for rule in (*RULES, *REPORTS)}
    for part in parts:
        for check in part.checks:
            found[check.name].append(replace(check, time=begin + check.time))
        begin += part.duration
    joints, checks = len(parts) > 1, list[Check | None]()
    for rule in RULES:
        anew = rule.whole and (joints or rule is DURATION)
        checks.append(rule.check(motion) if anew else most_pressing(found[rule.name]))
    for report in REPORTS:
        known = most_pressing(found[report.name])
        checks.append(report.check(motion, {}, GAMMA) if report.whole else known)
    return Certificate(motion.duration, tuple(filter(None, checks)))
