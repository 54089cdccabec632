"""Errors of certificates: what is violated, where and when, and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.checks.custom import Rule
from hitchopt.checks.registry import RULE_OF, TEAM_REPORTS
from hitchopt.checks.rule import REPORT_IT, CheckRule, ReportRule
from hitchopt.errors import InfeasibleError, StepPlace, Violation
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase

LEVEL_TOLERANCE = 1e-3
"""Difference of heights up to which drones count as being at one height [m]: it changes a distance
of 0.24 m by less than 1e-5 m."""


def infeasible_error(
    certificate: Certificate,
    flown: Motion | Flight,
    when: str = "",
    rules: Sequence[Rule[Any]] = (),
    step: StepPlace | None = None,
) -> InfeasibleError:
    """Return the error of a certificate's violations.

    ``when`` describes the time, at which the motion is at rest, and ``step`` is its step; without,
    both are those of each check. ``rules`` are the custom rules in the certificate.
    """
    flight = Flight.of(flown)
    violations = list[Violation]()
    for check in named_checks(certificate, flight, rules):
        time = when
        steps: tuple[StepPlace, ...] = () if step is None else (step,)
        if not when and check.name != "duration":
            time = f"at t = {check.time:.4g} s"
            steps = tuple(phase.place for phase in _phases_at(check, flight)[:1])
        own_remedy = _remedy(check, flight, rules, at_start=bool(when))
        remedy = _separation_shortfall(check, flight) + own_remedy
        violations.append(check.violation(time, remedy, steps=steps))
    return InfeasibleError(violations)


def named_checks(
    certificate: Certificate, flight: Flight, rules: Sequence[Rule[Any]] = ()
) -> list[Check]:
    """Return the violated checks that a refusal names: those that a user can change, if any.

    What only a fault can break otherwise, such as the balance of an object that slips, follows from
    them.
    """
    violated = certificate.violated
    named = [check for check in violated if _remedy(check, flight, rules) != REPORT_IT]
    return named or list(violated)


def _phases_at(check: Check, flight: Flight) -> list[Phase]:
    """Return the phases in which a check is worst."""
    return [phase for phase in flight.phases if phase.start <= check.time <= phase.end]


def _remedy(
    check: Check, flight: Flight, rules: Sequence[Rule[Any]], *, at_start: bool = False
) -> str:
    """Return the suggested change for a violated check, and for the check that determines it.

    Drones without a hitch ``at_start`` are where the user placed them.
    """
    rule_of: dict[str, CheckRule | ReportRule] = {
        **RULE_OF,
        **{report.name: report for report in TEAM_REPORTS},
        **{rule.name: rule.check_rule for rule in rules},
    }
    rule = rule_of[check.name]
    if check.binding in rule_of:
        binding = replace(check, name=check.binding, binding="")
        return f"{_remedy(binding, flight, rules, at_start=at_start)}, or {rule.remedy}"
    phases = _phases_at(check, flight)
    is_free = bool(phases) and not any(phase.state.hitched for phase in phases)
    remedy = rule.free_remedy if is_free else ""
    if at_start and is_free and isinstance(rule, CheckRule):
        remedy = rule.start_remedy or remedy
    if not remedy and isinstance(rule, CheckRule) and len(flight.teams) == 1:
        remedy = rule.remedy_at(flight.teams[0].motion, check)
    return remedy or rule.remedy


def _separation_shortfall(check: Check, flight: Flight) -> str:
    """Describe the distance of two drones at one height and its shortfall, or return nothing."""
    if check.name != "separation":
        return ""
    heights = list[float]()
    for flown in flight.all_teams:
        drones = flown.motion.drones
        first, last = drones.breaks[[0, -1]]
        places = drones.at(float(np.clip(check.time, first, last)))
        names = map(flown.label, flown.motion.team.drone_names)
        for name, place in zip(names, places, strict=True):
            if name in check.where:
                heights.append(place[2])
    if np.ptp(heights) > LEVEL_TOLERANCE:
        return ""
    diameter = 2.0 * flight.requirements.separation.radius
    required = diameter * check.number
    distance = diameter * check.worst
    return f"{distance:.3g} m apart, {required - distance:.3g} m too close: "
