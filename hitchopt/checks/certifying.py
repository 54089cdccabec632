"""The certificate of a flight: its checks, of every team and between teams, and its reports."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from hitchopt.checks import tracking
from hitchopt.checks.certificate import Certificate, Check, worst_of
from hitchopt.checks.custom import Rule, checked_rules
from hitchopt.checks.distances import GROUND
from hitchopt.checks.linking import CONTINUITY, DURATION
from hitchopt.checks.registry import (
    NAMES,
    PART_REPORTS,
    REPORTS,
    RULES,
    TEAM_REPORTS,
    Report,
)
from hitchopt.checks.rule import CheckRule, FlightReport, ReportRule, SpanResult
from hitchopt.checks.spans import value_cache
from hitchopt.checks.tracking import GAMMA, TRACKING_RADIUS
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import flight_digest
from hitchopt.motion.retiming import padded
from hitchopt.motion.stated_rules import StatedRule
from hitchopt.slices import provided
from hitchopt.values import check_instance, nonnegative, sequence
from hitchopt.values.fields import suggest_keywords

TeamResults = dict[CheckRule, tuple[SpanResult, ...]]  # Results of one team's checks

_CERTIFICATES: WeakKeyDictionary[Motion | Flight, Certificate] = WeakKeyDictionary()
"""Certificates that this process has computed; those of a team that flies alone by its motion.

They have no custom rules."""


@runtime_checkable
class Planned(Protocol):
    """A plan, or what its file contains: a flight, and the custom rules that it states."""

    @property
    def flight(self) -> Flight:
        """The flight."""
        ...

    @property
    def stated_rules(self) -> tuple[StatedRule, ...]:
        """The custom rules that were certified."""
        ...


@suggest_keywords
def certify(
    flight: Flight | Motion | Planned,
    progress: Callable[[str], None] | None = None,
    gamma: float = GAMMA,
    *,
    reports: Sequence[Report] = REPORTS,
    rules: Iterable[Rule[Any]] = (),
) -> Certificate:
    """Check a flight for all t.

    No quantity exceeds its ``worst`` at any t. Bounds are tight to ``1e-4``, relative, or ``2e-7``
    in the unit of the quantity; distances to hanging cables to millimetres. Margins cover rounding.
    A motion that is degenerate somewhere (two drones at one point, a cable without tension) fails
    the checks concerned.

    Parameters
    ----------
    flight: a plan, its flight, or the motion of a team that flies alone.
    progress: called with the name of every check at its start, and the number of finished ones.
        With it, reports are evaluated immediately, otherwise when they are first read.
    gamma: ratio of vertex errors to drone errors, for ``tracking_radius``.
    reports: reports of the certificate, in addition to those with a limit.
    rules: custom limits, which are checked in addition. Those that a plan states with another
        name, unit, sense or limit are listed as not recomputed; one whose stated worst value
        breaks its limit is violated.

    Raises
    ------
    InputError: a gamma that is negative or not finite; a rule with the name of another check, or
        whose formula does not return one number per item.
    """
    stated: tuple[StatedRule, ...] = ()
    if not isinstance(flight, Flight | Motion) and isinstance(flight, Planned):
        stated = flight.stated_rules
        flight = flight.flight
    check_instance("flight", flight, Flight, Motion)
    flight = Flight.of(flight)
    gamma = nonnegative("gamma", gamma)
    requested: tuple[Report, ...] = sequence("reports", reports)
    custom_rules = checked_rules(rules, NAMES)
    certificate = FlightChecks(flight, gamma, requested, progress).certificate
    certificate = with_rules(certificate, flight, custom_rules, progress)
    recomputed = {(rule.name, rule.unit, rule.sense, rule.limit) for rule in custom_rules}
    certificate = certificate.stating(
        rule for rule in stated if (rule.name, rule.unit, rule.sense, rule.limit) not in recomputed
    )
    if progress is not None:
        _ = certificate.checks
    return certificate


def certify_part(motion: Motion) -> Certificate:
    """Return the certificate of a part of a plan, for ``merged``.

    It lacks the limit of duration, and what depends on what flies before and after the part.
    """
    flight = Flight.of(motion.untimed)
    return FlightChecks(flight, GAMMA, PART_REPORTS, None, is_part=True).certificate


@dataclass(frozen=True, eq=False)
class FlightChecks:
    """The checks of a flight, of every team and between teams, each evaluated once."""

    flight: Flight  # The flight
    gamma: float  # Ratio of vertex errors to drone errors
    requested: Sequence[Report]  # Reports, in addition to those with a limit
    progress: Callable[[str], None] | None  # Called with the name of every check at its start
    is_part: bool = False  # Whether the flight is a part of a plan, as in ``certify_part``

    @property
    def certificate(self) -> Certificate:
        """The certificate; requested reports are evaluated when they are first read."""
        checks = [*map(self._checked, RULES), *map(self._reported, self._limited_reports)]
        unlimited = self._unlimited_reports

        def reports() -> Iterator[Check | None]:
            return map(self._reported, unlimited)

        store = self.gamma == GAMMA and not self.is_part
        return _certificate(self.flight, checks, reports, store=store)

    @cached_property
    def _limited_reports(self) -> list[ReportRule]:
        """Reports with a limit in this flight."""
        requirements = self.flight.requirements
        possible = (report for report in TEAM_REPORTS if not (self.is_part and report.of_whole))
        return [report for report in possible if report.limit(requirements) is not None]

    @property
    def _unlimited_reports(self) -> list[Report]:
        """Requested reports without a limit."""
        return [
            report
            for report in REPORTS
            if report in self.requested and report not in self._limited_reports
        ]

    @cached_property
    def _of_teams(self) -> list[tuple[TeamMotion, TeamResults]]:
        """The teams with the results of their checks."""
        return [(flown, self._results_of(flown)) for flown in self.flight.teams]

    def _results_of(self, flown: TeamMotion) -> TeamResults:
        """Return the results of all checks of one team."""
        results = TeamResults()
        with value_cache():
            for rule in RULES:
                self._announce(flown, rule)
                results[rule] = rule.span_results(flown.motion)
        return results

    @cached_property
    def _between(self) -> dict[CheckRule, Check | None]:
        """The checks between teams; none of a team that flies alone."""
        if len(self.flight.all_teams) == 1:
            return {}
        with value_cache():
            return {rule: _between_teams(rule, self.flight) for rule in RULES}

    def _checked(self, rule: CheckRule) -> Check | None:
        """Return the check of a rule, in all teams and between them."""
        checks = list[Check | None]()
        for flown, results in self._of_teams:
            worst = worst_of(span.check for span in results[rule])
            checks.append(_label(worst, flown))
        return worst_of([*checks, self._between.get(rule)])

    def _reported(self, report: Report) -> Check | None:
        """Return the check of a report."""
        if isinstance(report, FlightReport):
            if self.progress is not None:
                self.progress(f"{report.name}, of the whole motion")
            return report.check(self.flight)
        checks = list[Check | None]()
        with value_cache():
            for flown, results in self._of_teams:
                self._announce(flown, report)
                checks.append(_label(report.check(flown.motion, results, self.gamma), flown))
            if self._between and report is TRACKING_RADIUS:
                radius = _radius_between_teams(report, self.flight, self._between, self.gamma)
                checks.append(radius)
        return worst_of(checks)

    def _announce(self, flown: TeamMotion, evaluated: CheckRule | ReportRule) -> None:
        """Report that a check of a team is evaluated next."""
        if self.progress is None:
            return
        reports = [*self._limited_reports, *self._unlimited_reports]
        names = [rule.name for rule in RULES if rule.limit_of(flown.motion) is not None]
        names += [
            report.name
            for report in reports
            if isinstance(report, ReportRule) and report.applies(flown.motion)
        ]
        if evaluated.name in names:
            label = f"{flown.name}: " if flown.name else ""
            self.progress(f"{label}{evaluated.name}, {names.index(evaluated.name)} of {len(names)}")


def with_rules(
    certificate: Certificate,
    flight: Flight,
    rules: Sequence[Rule[Any]],
    progress: Callable[[str], None] | None = None,
) -> Certificate:
    """Return the certificate of a flight with the checks of custom rules, of every team."""
    checks = list[Check]()
    for rule in rules:
        if progress is not None:
            progress(f"{rule.name}, a custom rule")
        of_teams = [_label(rule.check(flown.motion), flown) for flown in flight.teams]
        checks += filter(None, [worst_of(of_teams)])
    return replace(certificate, limited=(*certificate.limited, *checks)) if checks else certificate


def check_of(rule: CheckRule, flight: Flight, *, exported: bool = False) -> Check | None:
    """Return the check of one rule for all teams of a flight, and between them."""
    checks = [_label(rule.check(flown.motion, exported=exported), flown) for flown in flight.teams]
    several = len(flight.all_teams) > 1
    return worst_of([*checks, _between_teams(rule, flight) if several else None])


def _between_teams(rule: CheckRule, flight: Flight) -> Check | None:
    """Return the check of a rule between teams; for continuity, that of rests at their ends.

    A flight's own teams may begin it in motion, as after a loss.
    """
    if rule is not CONTINUITY:
        across: Check | None = provided("check_across")(rule, flight)
        return across
    ends = [flown.motion.drones.breaks[[0, -1]].tolist() for flown in flight.all_teams]
    first = min(begin for begin, _ in ends)
    last = max(end for _, end in ends) + 1.0
    own = rest_continuity(flight.teams, first, last)
    return worst_of([own, rest_continuity(flight.others, first - 1.0, last)])


def _radius_between_teams(
    report: ReportRule, flight: Flight, between: Mapping[CheckRule, Check | None], gamma: float
) -> Check:
    """Return the check of the tracking error with which teams keep their distances.

    ``between`` are the checks between them with the flight's own ``height_ratio``; the radius is
    that with the ratio of the tracking errors.
    """
    requirements = tracking.flattened(flight.requirements)
    if requirements is not flight.requirements:
        check_across = provided("check_across")
        between = {rule: check_across(rule, flight, requirements) for rule in RULES}
    radius = provided("radius_across")(flight, requirements, between, gamma)
    check: Check = radius.check(report, report.limit(requirements), gamma)
    return check


def rest_continuity(teams: Iterable[TeamMotion], first: float, last: float) -> Check | None:
    """Return the continuity of teams that rest before and after their motions.

    The times from the ``first`` to the ``last`` one [s] count.
    """
    checks = list[Check | None]()
    for flown in teams:
        motion = padded(flown.motion, first, last)
        checks.append(_label(CONTINUITY.check(motion), flown))
    return worst_of(checks)


def _label(check: Check | None, flown: TeamMotion) -> Check | None:
    """Return a team's check with names of drones, cables and vertices labelled by team."""
    if check is None or not flown.name:
        return check
    same = {GROUND, *flown.motion.requirements.objects}
    where = tuple(place if place in same else flown.label(place) for place in check.where)
    return replace(check, where=where)


def certificate_of(flight: Flight, progress: Callable[[str], None] | None = None) -> Certificate:
    """Return the certificate of a flight, computed only once in this process.

    Reports may be missing from it. ``progress`` is that of ``certify``.
    """
    known = _CERTIFICATES.get(flight.alone or flight)
    return known or certify(flight, progress, reports=())


def _certificate(
    flight: Flight,
    checks: Iterable[Check | None],
    reports: Callable[[], Iterable[Check | None]],
    *,
    store: bool = True,
) -> Certificate:
    """Return the certificate; it is stored without reports, which refer to the flight."""
    limited = tuple(filter(None, checks))
    certificate = Certificate(flight.duration, limited, flight_digest=flight_digest(flight))
    if store:
        _CERTIFICATES[flight.alone or flight] = certificate
    return replace(certificate, reports=lambda: filter(None, reports()))


def merged(motion: Motion, parts: Sequence[Certificate]) -> Certificate:
    """Return the certificate of a joined motion from the certificates of its parts.

    The worst of the parts' bounds is a bound of the whole: joining changes coefficients by units in
    the last place, far less than the margins in every ``worst``. Rules with ``whole`` are evaluated
    again; for a single part, which has no joints, only duration and stops. If the motion states
    tracking errors, its parts keep wider distances: all but limits of single bodies are evaluated
    again.

    Parameters
    ----------
    motion: the parts in sequence, each starting where the previous one ends.
    parts: their certificates; checks of duration in them are not used.
    """
    flight = Flight.of(motion)
    requirements = motion.requirements
    limited = [report for report in TEAM_REPORTS if report.limit(requirements) is not None]
    has_errors = TRACKING_RADIUS in limited
    has_joints = len(parts) > 1
    by_name = _by_name(motion, parts, [part.limited for part in parts])

    def is_of_parts(rule: CheckRule) -> bool:
        """Return whether the check of a rule is that of the parts."""
        if rule is DURATION or (rule.whole and has_joints):
            return False
        limit = rule.limit_of(motion)
        is_same = all(check.limit == limit for check in by_name[rule.name])
        return not has_errors or (rule.limits_single_bodies and is_same)

    results = TeamResults()

    def reported(report: Report) -> Check | None:
        """Return the check of a report."""
        if isinstance(report, FlightReport):
            return report.check(flight)
        if report in PART_REPORTS and not has_errors:
            of_parts = _by_name(motion, parts, [part.checks for part in parts])
            return worst_of(of_parts[report.name])
        return report.check(motion, results, GAMMA)

    checks = list[Check | None]()
    with value_cache():
        for rule in RULES:
            if is_of_parts(rule):
                checks.append(worst_of(by_name[rule.name]))
            else:
                results[rule] = rule.span_results(motion)
                checks.append(worst_of(result.check for result in results[rule]))
        checks += map(reported, limited)
    others = [report for report in REPORTS if report not in limited]
    return _certificate(flight, checks, lambda: map(reported, others))


def _by_name(
    motion: Motion, parts: Sequence[Certificate], checks: Sequence[Sequence[Check]]
) -> dict[str, list[Check]]:
    """Return checks of the parts of a joined motion by name, with times of that motion."""
    begin = float(motion.drones.breaks[0])
    by_name = defaultdict[str, list[Check]](list)
    for part, checks_of_part in zip(parts, checks, strict=True):
        for check in checks_of_part:
            by_name[check.name].append(replace(check, time=begin + check.time))
        begin += part.duration
    return by_name
