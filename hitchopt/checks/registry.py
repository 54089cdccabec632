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
from hitchopt.checks.downwash import DOWNWASH
from hitchopt.checks.joining import interlacing, jumps, jumps_of_thrust
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
    DOWNWASH,
    cables.TENSION,
    CONTINUITY,
    INTERLACING,
    clearance.OBJECT_CLEARANCE,
    objects.GRIP,
    objects.SUPPORT,
    DURATION,
)
"""One rule per check; a new check needs one record and one line here."""

REPORTS = (tracking.TRACKING_RADIUS, stops.RULE)
"""Quantities that a certificate reports after its checks, usually without a limit."""

MERGEABLE_REPORTS = tuple(report for report in REPORTS if not report.whole)
"""Reports of a joined motion that follow from those of its parts."""

SEAM_CASES = {"continuity": jumps, "tension": jumps_of_thrust}
"""Worst cases at joints where a robot joins or leaves, by the names of checks."""

RULE_OF = {rule.name: rule for rule in RULES}
"""The rules by name."""

_CERTIFICATES: WeakKeyDictionary[Motion, Certificate] = WeakKeyDictionary()
"""Certificates that this process has computed, by motion."""


def certify(
    motion: Motion,
    progress: Callable[[str], None] | None = None,
    gamma: float = GAMMA,
    *,
    reports: Sequence[ReportRule] = REPORTS,
) -> Certificate:
    """Check a motion for all t.

    No quantity exceeds its ``worst`` at any t. Bounds are tight to ``1e-4``, relative, or ``2e-7``
    in the unit of the quantity; distances to hanging cables to millimetres. Margins cover rounding.
    A motion that is degenerate somewhere (two drones at one point, a cable without tension) fails
    the checks concerned.

    Parameters
    ----------
    motion: the plan.
    progress: called with the name of every check at its start, and the number of finished ones.
    gamma: ratio of vertex errors to drone errors, for ``tracking_radius``.
    reports: reports to evaluate, in addition to those with a limit. Pass MERGEABLE_REPORTS if
        ``merged`` computes the others.

    Raises
    ------
    InputError: a gamma that is negative or not finite.
    """
    check_instance("motion", motion, Motion)
    gamma = nonnegative("gamma", gamma)
    selected: tuple[ReportRule, ...] = sequence("reports", reports)
    selected = tuple(each for each in REPORTS if each in selected or each.limit(motion) is not None)
    if motion.has_ring_changes:
        return _stored(motion, list(_checks_of_chapters(motion, progress, gamma, selected)))
    if len(motion.all_groups) > 1:
        return _stored(motion, list(_checks_of_groups(motion, progress, gamma, selected)))
    rules = tuple(rule for rule in RULES if rule.limit_of(motion) is not None)
    evaluated: tuple[CheckRule | ReportRule, ...] = (*rules, *selected)
    results: dict[str, Sequence[SpanResult]] = dict.fromkeys(RULE_OF, ())
    checks: list[Check | None] = []
    with value_cache():
        for i, each in enumerate(evaluated):
            if progress is not None:
                progress(f"{each.name}, {i} of {len(evaluated)}")
            if isinstance(each, CheckRule):
                results[each.name] = each.span_results(motion)
                checks.append(worst_of(span.check for span in results[each.name]))
            else:
                checks.append(each.check(motion, results, gamma))
    return _stored(motion, checks)


def _checks_of_chapters(
    motion: Motion,
    progress: Callable[[str], None] | None,
    gamma: float,
    selected: tuple[ReportRule, ...],
) -> Iterator[Check | None]:
    """Yield the combined checks of all chapters and of the seams between them."""
    parts, by_name = chapters(motion), dict[str, list[Check]]()
    part_reports = tuple(each for each in selected if each is tracking.TRACKING_RADIUS)
    for part in parts:
        for check in certify(part, progress, gamma, reports=part_reports).checks:
            by_name.setdefault(check.name, []).append(check)
    with value_cache():
        for rule in RULES:
            if rule is DURATION:
                yield rule.check(motion)
            elif rule is INTERLACING:
                yield check_of(rule, motion)
            else:
                yield worst_of([*by_name.get(rule.name, ()), _at_seams(rule, motion)])
        for report in selected:
            checks = by_name.get(report.name, ())
            yield worst_of(checks) if report in part_reports else report.check(motion, {}, gamma)


def _at_seams(rule: CheckRule, motion: Motion) -> Check | None:
    """Return the check of a rule at the seams of chapters; None if it has none."""
    limit = rule.limit_of(motion)
    if rule.name not in SEAM_CASES or limit is None:
        return None
    return SEAM_CASES[rule.name](motion, chapters(motion)).check(rule, limit)


def _checks_of_groups(
    motion: Motion,
    progress: Callable[[str], None] | None,
    gamma: float,
    selected: tuple[ReportRule, ...],
) -> Iterator[Check | None]:
    """Yield the combined checks of all groups: the worst of each group, and between groups."""
    radius, by_name = tracking.TRACKING_RADIUS, dict[str, list[Check]]()
    for group in motion.groups:
        alone = group.motion.replaced(others=())
        own = None if progress is None else partial(_prefixed, progress, group.name)
        reports = tuple(each for each in selected if each is radius)
        for check in certify(alone, own, gamma, reports=reports).checks:
            by_name.setdefault(check.name, []).append(_label(check, group))
    across: dict[str, Check | None] = {}
    with value_cache():
        for rule in RULES:
            across[rule.name] = _across(rule, motion)
            yield worst_of([*by_name.get(rule.name, ()), across[rule.name]])
        for report in selected:
            if report is radius:
                worst = radius_across(motion, across.values(), gamma)
                check = worst.check(report, report.limit(motion), gamma)
                yield worst_of([*by_name.get(report.name, ()), check])
            else:
                yield report.check(motion, {}, gamma)


def check_of(rule: CheckRule, motion: Motion, *, exported: bool = False) -> Check | None:
    """Return the check of one rule for all chapters or groups, and between them."""
    if motion.has_ring_changes and rule is INTERLACING:
        return interlacing(chapters(motion)).check(rule, 0.0)
    if motion.has_ring_changes:
        parts = [check_of(rule, part, exported=exported) for part in chapters(motion)]
        return worst_of([*parts, _at_seams(rule, motion)])
    if len(motion.all_groups) == 1:
        return rule.check(motion, exported=exported)
    checks = [(rule.check(each.motion, exported=exported), each) for each in motion.groups]
    labelled = [None if check is None else _label(check, each) for check, each in checks]
    return worst_of([*labelled, _across(rule, motion)])


def _across(rule: CheckRule, motion: Motion) -> Check | None:
    """Return the check of a rule between groups; for continuity, that of rests at their ends."""
    if rule is CONTINUITY:
        return rest_continuity(motion.all_groups)
    return check_across(rule, motion)


def rest_continuity(groups: Iterable[Group]) -> Check | None:
    """Return the continuity of groups with rests before and after their motions."""
    checks = list[Check | None]()
    for group in groups:
        begin, end = group.motion.drones.breaks[[0, -1]].tolist()
        motion = padded(group.motion.replaced(others=()), begin - 1.0, end + 1.0)
        check = CONTINUITY.check(motion)
        checks.append(None if check is None else _label(check, group))
    return worst_of(checks)


def _prefixed(progress: Callable[[str], None], name: str, message: str) -> None:
    progress(f"{name}: {message}" if name else message)


def _label(check: Check, group: Group) -> Check:
    """Return a group's check with names of drones, cables and vertices labelled by group."""
    same = {GROUND, *group.motion.requirements.objects}
    where = tuple(place if place in same else group.label(place) for place in check.where)
    return replace(check, where=where)


def certificate_of(motion: Motion, progress: Callable[[str], None] | None = None) -> Certificate:
    """Return the certificate of a motion, computed only once in this process.

    Reports may be missing from it. ``progress`` is that of ``certify``.
    """
    return _CERTIFICATES.get(motion) or certify(motion, progress, reports=())


def _stored(motion: Motion, checks: Sequence[Check | None]) -> Certificate:
    certificate = Certificate(motion.duration, tuple(filter(None, checks)))
    _CERTIFICATES[motion] = certificate
    return certificate


def merged(motion: Motion, parts: Sequence[Certificate]) -> Certificate:
    """Return the certificate of a joined motion from the certificates of its parts.

    The worst of the parts' bounds is a bound of the whole: joining changes coefficients by units in
    the last place, far less than the margins in every ``worst``. Rules with ``whole`` are evaluated
    again; for a single part, which has no joints, only duration and stops.

    Parameters
    ----------
    motion: the parts in sequence, each starting where the previous one ends.
    parts: their certificates; checks of duration in them are not used.
    """
    limit = tracking.TRACKING_RADIUS.limit(motion)
    if motion.has_ring_changes or motion.others or limit is not None:
        return certify(motion)  # parts are certified against wider distances
    begin = float(motion.drones.breaks[0])
    by_name: dict[str, list[Check]] = {rule.name: [] for rule in (*RULES, *REPORTS)}
    for part in parts:
        for check in part.checks:
            by_name[check.name].append(replace(check, time=begin + check.time))
        begin += part.duration
    joints, checks = len(parts) > 1, list[Check | None]()
    for rule in RULES:
        evaluated = rule.whole and (joints or rule is DURATION)
        checks.append(rule.check(motion) if evaluated else worst_of(by_name[rule.name]))
    for report in REPORTS:
        worst = worst_of(by_name[report.name])
        checks.append(report.check(motion, {}, GAMMA) if report.whole else worst)
    return _stored(motion, checks)
