"""All checks in the order of a certificate, and the functions that certify a motion."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

from hitchopt.checks import cables, clasps, clearance, distances, drones, objects, stops, tracking
from hitchopt.checks.across import check_across, radius_across
from hitchopt.checks.certificate import Certificate, Check, worst_of
from hitchopt.checks.distances import GROUND
from hitchopt.checks.downwash import DOWNWASH
from hitchopt.checks.linking import CONTINUITY, DURATION, INTERLACING
from hitchopt.checks.rule import CheckRule, ReportRule, SpanResult
from hitchopt.checks.spans import value_cache
from hitchopt.checks.tracking import GAMMA
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
    objects.HINGE,
    objects.SUPPORT,
    DURATION,
)
"""One rule per check; a new check needs one record and one line here."""

REPORTS = (tracking.TRACKING_RADIUS, stops.RULE)
"""Quantities that a certificate reports after its checks, usually without a limit."""

MERGEABLE_REPORTS = tuple(report for report in REPORTS if not report.whole)
"""Reports of a joined motion that follow from those of its parts."""

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
        With it, reports are evaluated at once, otherwise when they are first read.
    gamma: ratio of vertex errors to drone errors, for ``tracking_radius``.
    reports: reports of the certificate, in addition to those with a limit. Pass MERGEABLE_REPORTS
        if ``merged`` computes the others.

    Raises
    ------
    InputError: a gamma that is negative or not finite.
    """
    check_instance("motion", motion, Motion)
    gamma = nonnegative("gamma", gamma)
    requested: tuple[ReportRule, ...] = sequence("reports", reports)
    limited = [each for each in REPORTS if each.limit(motion) is not None]
    unlimited = [each for each in REPORTS if each in requested and each not in limited]
    mergeable = [each for each in (*limited, *unlimited) if not each.whole]
    parts = _parts(motion)

    def tell(part: Motion, each: CheckRule | ReportRule) -> None:
        if progress is not None:
            rules = [rule for rule in RULES if rule.limit_of(part) is not None]
            names = [rule.name for rule in rules] + [report.name for report in mergeable]
            if each.name in names:
                label = f"{parts[part].name}: " if parts[part].name else ""
                progress(f"{label}{each.name}, {names.index(each.name)} of {len(names)}")

    results = dict[Motion, dict[str, tuple[SpanResult, ...]]]()
    for part in parts:
        own = results[part] = {}
        with value_cache():
            for rule in RULES:
                tell(part, rule)
                own[rule.name] = rule.span_results(part)
    with value_cache():
        several = len(motion.all_groups) > 1
        across = {rule.name: _across(rule, motion) for rule in RULES} if several else {}
        checks = list[Check | None]()
        for rule in RULES:
            alone = [
                _label(worst_of(span.check for span in results[part][rule.name]), group)
                for part, group in parts.items()
            ]
            checks.append(worst_of([*alone, across.get(rule.name)]))

    def reported(report: ReportRule) -> Check | None:
        """Return the check of a report."""
        if report.whole:
            if progress is not None:
                progress(f"{report.name}, of the whole motion")
            return report.check(motion, {}, gamma)
        values = list[Check | None]()
        with value_cache():
            for part, group in parts.items():
                tell(part, report)
                values.append(_label(report.check(part, results[part], gamma), group))
            if across:
                flat = tracking.flattened(motion)
                same = flat is motion
                between = across if same else {x: _across(RULE_OF[x], flat) for x in across}
                radius = radius_across(flat, between.values(), gamma)
                values.append(radius.check(report, report.limit(motion), gamma))
        return worst_of(values)

    checks += map(reported, limited)
    certificate = _stored(motion, checks, lambda: map(reported, unlimited))
    if progress is not None:
        _ = certificate.checks
    return certificate


def _parts(motion: Motion) -> dict[Motion, Group]:
    """Return the motions that are checked alone, with their groups."""
    several = len(motion.all_groups) > 1
    return {
        each.motion.replaced(others=()) if several else each.motion: each for each in motion.groups
    }


def check_of(rule: CheckRule, motion: Motion, *, exported: bool = False) -> Check | None:
    """Return the check of one rule for all parts of a motion, and between them."""
    checks = [
        _label(rule.check(part, exported=exported), group) for part, group in _parts(motion).items()
    ]
    return worst_of([*checks, _across(rule, motion) if len(motion.all_groups) > 1 else None])


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
    if check is None or not group.name:
        return check
    same = {GROUND, *group.motion.requirements.objects}
    where = tuple(place if place in same else group.label(place) for place in check.where)
    return replace(check, where=where)


def certificate_of(motion: Motion, progress: Callable[[str], None] | None = None) -> Certificate:
    """Return the certificate of a motion, computed only once in this process.

    Reports may be missing from it. ``progress`` is that of ``certify``.
    """
    return _CERTIFICATES.get(motion) or certify(motion, progress, reports=())


def _stored(
    motion: Motion, checks: Sequence[Check | None], reports: Callable[[], Iterable[Check | None]]
) -> Certificate:
    """Return the certificate, which is stored without reports: these refer to the motion."""
    stored = Certificate(motion.duration, tuple(filter(None, checks)))
    _CERTIFICATES[motion] = stored
    return replace(stored, reports=lambda: filter(None, reports()))


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
    if motion.others or limit is not None:
        return certify(motion)  # parts are certified against wider distances
    by_name = _by_name(motion, parts, [part.limited for part in parts])
    joints, checks = len(parts) > 1, list[Check | None]()
    for rule in RULES:
        evaluated = rule.whole and (joints or rule is DURATION)
        checks.append(rule.check(motion) if evaluated else worst_of(by_name[rule.name]))

    def reported() -> Iterator[Check | None]:
        """Yield the checks of all reports."""
        by_name = _by_name(motion, parts, [part.checks for part in parts])
        for report in REPORTS:
            worst = worst_of(by_name[report.name])
            yield report.check(motion, {}, GAMMA) if report.whole else worst

    return _stored(motion, checks, reported)


def _by_name(
    motion: Motion, parts: Sequence[Certificate], checks: Sequence[Sequence[Check]]
) -> dict[str, list[Check]]:
    """Return checks of the parts of a joined motion by name, with times of that motion."""
    begin, by_name = float(motion.drones.breaks[0]), defaultdict[str, list[Check]](list)
    for part, own in zip(parts, checks, strict=True):
        for check in own:
            by_name[check.name].append(replace(check, time=begin + check.time))
        begin += part.duration
    return by_name
