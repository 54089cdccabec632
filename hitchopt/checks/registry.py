"""All checks in the order of a certificate, and the functions that certify a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from weakref import WeakKeyDictionary

from hitchopt.checks import cables, clasps, clearance, distances, drones, objects, stops, tracking
from hitchopt.checks.across import check_across, radius_across
from hitchopt.checks.certificate import Certificate, Check, worst_of
from hitchopt.checks.distances import GROUND
from hitchopt.checks.joining import interlaced, jumps, jumps_of_thrust
from hitchopt.checks.linking import CONTINUITY, DURATION, INTERLACING
from hitchopt.checks.rule import CheckRule, ReportRule, SpanResult
from hitchopt.checks.spans import value_cache
from hitchopt.checks.tracking import GAMMA
from hitchopt.motion.chapters import chapters
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.retiming import padded
from hitchopt.values import check_instance, nonnegative, sequence

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
"""Quantities that a certificate reports after its checks, without a limit."""

MERGEABLE_REPORTS = tuple(report for report in REPORTS if not report.whole)
"""Reports of a joined motion that follow from those of its parts."""

SEAMS = {"continuity": jumps, "tension": jumps_of_thrust}
"""Worst cases where a robot joins or leaves, by the checks that they belong to."""

RULE_OF = {rule.name: rule for rule in RULES}
"""The rules by name."""

_CERTIFICATES: WeakKeyDictionary[Motion, Certificate] = WeakKeyDictionary()
"""Certificates that this process has computed, by the very motions that they are of."""


def certify(
    motion: Motion,
    progress: Callable[[str], None] | None = None,
    gamma: float = GAMMA,
    *,
    reports: Sequence[ReportRule] = REPORTS,
) -> Certificate:
    """Check a motion for all t.

    No quantity passes its ``worst`` at any t; it comes within ``1e-4`` of it, relative, or ``2e-7``
    in its unit, distances to hanging cables within millimetres. Rounding is covered by a margin. A
    motion that is degenerate somewhere (two drones at one place, a cable without tension) fails the
    checks concerned.

    Parameters
    ----------
    motion: the plan.
    progress: called with the name of every check as it starts, and how many are done.
    gamma: ratio of vertex errors to drone errors, for ``tracking_radius``.
    reports: evaluated after the checks, in addition to those with a limit. Pass MERGEABLE_REPORTS
        if ``merged`` computes the others.

    Raises
    ------
    InputError: a gamma that is negative or not finite.
    """
    check_instance("motion", motion, Motion)
    gamma = nonnegative("gamma", gamma)
    chosen: tuple[ReportRule, ...] = sequence("reports", reports)
    chosen = tuple(each for each in REPORTS if each in chosen or each.limit(motion) is not None)
    if motion.changes:
        return _remembered(motion, list(_checks_of_chapters(motion, progress, gamma, chosen)))
    if len(motion.flying) > 1:
        return _remembered(motion, list(_checks_of_groups(motion, progress, gamma, chosen)))
    rules = tuple(rule for rule in RULES if rule.limit_of(motion) is not None)
    every: tuple[CheckRule | ReportRule, ...] = (*rules, *chosen)
    results: dict[str, Sequence[SpanResult]] = dict.fromkeys(RULE_OF, ())
    checks: list[Check | None] = []
    with value_cache():
        for i, each in enumerate(every):
            if progress is not None:
                progress(f"{each.name}, {i} of {len(every)}")
            if isinstance(each, CheckRule):
                results[each.name] = each.span_results(motion)
                checks.append(worst_of(span.check for span in results[each.name]))
            else:
                checks.append(each.check(motion, results, gamma))
    return _remembered(motion, checks)


def _checks_of_chapters(
    motion: Motion,
    progress: Callable[[str], None] | None,
    gamma: float,
    chosen: tuple[ReportRule, ...],
) -> Iterator[Check | None]:
    """Yield the checks of all chapters together, and of the seams between them."""
    parts, own = chapters(motion), dict[str, list[Check]]()
    radius = tuple(each for each in chosen if each is tracking.TRACKING_RADIUS)
    for part in parts:
        for check in certify(part, progress, gamma, reports=radius).checks:
            own.setdefault(check.name, []).append(check)
    with value_cache():
        for rule in RULES:
            if rule is DURATION:
                yield rule.check(motion)
            elif rule is INTERLACING:
                yield check_of(rule, motion)
            else:
                yield worst_of([*own.get(rule.name, ()), _at_seams(rule, motion)])
        for report in chosen:
            known = own.get(report.name, ())
            yield worst_of(known) if report in radius else report.check(motion, {}, gamma)


def _at_seams(rule: CheckRule, motion: Motion) -> Check | None:
    """Return the check of a rule at the seams of chapters; None if it is not of them."""
    limit = rule.limit_of(motion)
    if rule.name not in SEAMS or limit is None:
        return None
    return SEAMS[rule.name](motion, chapters(motion)).check(rule, limit)


def _checks_of_groups(
    motion: Motion,
    progress: Callable[[str], None] | None,
    gamma: float,
    chosen: tuple[ReportRule, ...],
) -> Iterator[Check | None]:
    """Yield the checks of all groups together: the worst of each group alone, and across."""
    radius, own = tracking.TRACKING_RADIUS, dict[str, list[Check]]()
    for group in motion.groups:
        alone = group.motion.replaced(others=())
        tell = None if progress is None else partial(_tell, progress, group.name)
        reports = tuple(each for each in chosen if each is radius)
        for check in certify(alone, tell, gamma, reports=reports).checks:
            own.setdefault(check.name, []).append(_labelled(check, group))
    across: dict[str, Check | None] = {}
    with value_cache():
        for rule in RULES:
            across[rule.name] = _across(rule, motion)
            yield worst_of([*own.get(rule.name, ()), across[rule.name]])
        for report in chosen:
            if report is radius:
                apart = radius_across(motion, across.values(), gamma)
                checked = apart.check(report, report.limit(motion), gamma)
                yield worst_of([*own.get(report.name, ()), checked])
            else:
                yield report.check(motion, {}, gamma)


def check_of(rule: CheckRule, motion: Motion, *, exported: bool = False) -> Check | None:
    """Return the check of one rule of all groups together: of each alone, and across."""
    if motion.changes and rule is INTERLACING:
        return interlaced(chapters(motion)).check(rule, 0.0)
    if motion.changes:
        parts = [check_of(rule, part, exported=exported) for part in chapters(motion)]
        return worst_of([*parts, _at_seams(rule, motion)])
    if len(motion.flying) == 1:
        return rule.check(motion, exported=exported)
    own = [(rule.check(each.motion, exported=exported), each) for each in motion.groups]
    alone = [None if check is None else _labelled(check, each) for check, each in own]
    return worst_of([*alone, _across(rule, motion)])


def _across(rule: CheckRule, motion: Motion) -> Check | None:
    """Return the check of a rule between groups, or of how they come to rest at their ends."""
    return check_across(rule, motion) if rule is not CONTINUITY else rests(motion.flying)


def rests(groups: Iterable[Group]) -> Check | None:
    """Return the continuity of groups that stand still before and after their motions."""
    checks = list[Check | None]()
    for group in groups:
        begin, end = group.motion.drones.breaks[[0, -1]].tolist()
        whole = padded(group.motion.replaced(others=()), begin - 1.0, end + 1.0)
        found = CONTINUITY.check(whole)
        checks.append(None if found is None else _labelled(found, group))
    return worst_of(checks)


def _tell(progress: Callable[[str], None], name: str, words: str) -> None:
    progress(f"{name}: {words}" if name else words)


def _labelled(check: Check, group: Group) -> Check:
    """Return a group's check with its places named among those of all groups."""
    same = {GROUND, *group.motion.requirements.objects}
    where = tuple(place if place in same else group.label(place) for place in check.where)
    return replace(check, where=where)


def certificate_of(motion: Motion, progress: Callable[[str], None] | None = None) -> Certificate:
    """Return the certificate of this very motion if the process has computed it, else compute it.

    Reports may be missing from it. ``progress`` is that of ``certify``.
    """
    return _CERTIFICATES.get(motion) or certify(motion, progress, reports=())


def _remembered(motion: Motion, checks: Sequence[Check | None]) -> Certificate:
    certificate = Certificate(motion.duration, tuple(filter(None, checks)))
    _CERTIFICATES[motion] = certificate
    return certificate


def merged(motion: Motion, parts: Sequence[Certificate]) -> Certificate:
    """Return the certificate of a joined motion from the certificates of its parts.

    A bound for all of the time is the worst of the bounds for its spans: joining changes
    coefficients by units in the last place, far less than the margins in every ``worst``. Rules
    with ``whole`` are evaluated again; for a single part, which has no joints, only duration and
    stops.

    Parameters
    ----------
    motion: of the parts one after the other, each from where the last one ends.
    parts: their certificates; any check of duration in them is not used.
    """
    if motion.changes or motion.others or tracking.TRACKING_RADIUS.limit(motion) is not None:
        return certify(motion)  # parts are certified against wider distances
    begin = float(motion.drones.breaks[0])
    of_parts: dict[str, list[Check]] = {rule.name: [] for rule in (*RULES, *REPORTS)}
    for part in parts:
        for check in part.checks:
            of_parts[check.name].append(replace(check, time=begin + check.time))
        begin += part.duration
    joints, checks = len(parts) > 1, list[Check | None]()
    for rule in RULES:
        again = rule.whole and (joints or rule is DURATION)
        checks.append(rule.check(motion) if again else worst_of(of_parts[rule.name]))
    for report in REPORTS:
        known = worst_of(of_parts[report.name])
        checks.append(report.check(motion, {}, GAMMA) if report.whole else known)
    return _remembered(motion, checks)
