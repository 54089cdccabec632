"""All checks in the order of a certificate, and the functions that certify a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

from hitchopt.checks import cables, clasps, clearance, distances, drones, objects, stops, tracking
from hitchopt.checks.across import check_across, radius_across
from hitchopt.checks.certificate import Certificate, Check, worst_of
from hitchopt.checks.distances import GROUND
from hitchopt.checks.downwash import DOWNWASH
from hitchopt.checks.linking import CONTINUITY, DURATION, INTERLACING
from hitchopt.checks.ring_change import interlacing, jumps, jumps_of_thrust
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
    requested: tuple[ReportRule, ...] = sequence("reports", reports)
    parts = _parts(motion)
    reported = [each for each in REPORTS if each in requested or each.limit(motion) is not None]
    alone = {
        part: _checks_alone(part, group, reported, progress, gamma) for part, group in parts.items()
    }
    with value_cache():
        across = {
            chapter: {rule.name: _across(rule, chapter) for rule in RULES}
            for chapter in _chapters(motion)
            if len(chapter.all_groups) > 1
        }
        checks = list[Check | None]()
        for rule in RULES:
            own = [_label(alone[part].get(rule.name), group) for part, group in parts.items()]
            checks.append(_of_parts(rule, motion, [*own, *(x[rule.name] for x in across.values())]))
        for report in reported:
            if report.whole:
                if progress is not None:
                    progress(f"{report.name}, of the whole motion")
                checks.append(report.check(motion, {}, gamma))
                continue
            values = [_label(own[report.name], parts[part]) for part, own in alone.items()]
            for chapter, found in across.items():
                flat = tracking.flattened(chapter)
                between = (
                    found if flat is chapter else {x: _across(RULE_OF[x], flat) for x in found}
                )
                radius = radius_across(flat, between.values(), gamma)
                values.append(radius.check(report, report.limit(chapter), gamma))
            checks.append(worst_of(values))
    return _stored(motion, checks)


def _chapters(motion: Motion) -> tuple[Motion, ...]:
    """Return the time spans in which the same robots form the ring: usually the whole motion."""
    return chapters(motion) if motion.has_ring_changes else (motion,)


def _parts(motion: Motion) -> dict[Motion, Group]:
    """Return the motions that are checked alone, one per chapter and group, with their groups."""
    parts = dict[Motion, Group]()
    for chapter in _chapters(motion):
        several = len(chapter.all_groups) > 1
        for each in chapter.groups:
            parts[each.motion.replaced(others=()) if several else each.motion] = each
    return parts


def _checks_alone(
    part: Motion,
    group: Group,
    reports: Sequence[ReportRule],
    progress: Callable[[str], None] | None,
    gamma: float,
) -> dict[str, Check | None]:
    """Return the checks of one part by name, and those reports that parts have."""
    rules = [rule for rule in RULES if rule.limit_of(part) is not None]
    evaluated: tuple[CheckRule | ReportRule, ...] = (*rules, *(x for x in reports if not x.whole))
    results: dict[str, Sequence[SpanResult]] = dict.fromkeys(RULE_OF, ())
    checks = dict[str, Check | None]()
    with value_cache():
        for i, each in enumerate(evaluated):
            if progress is not None:
                label = f"{group.name}: " if group.name else ""
                progress(f"{label}{each.name}, {i} of {len(evaluated)}")
            if isinstance(each, CheckRule):
                results[each.name] = each.span_results(part)
                checks[each.name] = worst_of(span.check for span in results[each.name])
            else:
                checks[each.name] = each.check(part, results, gamma)
    return checks


def _of_parts(rule: CheckRule, motion: Motion, checks: Sequence[Check | None]) -> Check | None:
    """Return the check of a rule from those of all parts, and between the groups of chapters."""
    if not motion.has_ring_changes:
        return worst_of(checks)
    if rule is DURATION:
        return rule.check(motion)
    if rule is INTERLACING:
        return interlacing(chapters(motion)).check(rule, 0.0)
    limit = rule.limit_of(motion)
    if rule.name not in SEAM_CASES or limit is None:
        return worst_of(checks)
    at_seams = SEAM_CASES[rule.name](motion, chapters(motion)).check(rule, limit)
    return worst_of([*checks, at_seams])


def check_of(rule: CheckRule, motion: Motion, *, exported: bool = False) -> Check | None:
    """Return the check of one rule for all parts of a motion, and between them."""
    checks = [
        _label(rule.check(part, exported=exported), group) for part, group in _parts(motion).items()
    ]
    across = [_across(rule, each) for each in _chapters(motion) if len(each.all_groups) > 1]
    return _of_parts(rule, motion, [*checks, *across])


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
        checks.append(_label(CONTINUITY.check(motion), group))
    return worst_of(checks)


def _label(check: Check | None, group: Group) -> Check | None:
    """Return a group's check with names of drones, cables and vertices labelled by group."""
    if check is None:
        return None
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
