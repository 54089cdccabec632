"""What a format loses of a plan, in words, and how much more slowly it would lose nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.exports.formats.format import Format, Task
from hitchopt.exports.verification import Verdict
from hitchopt.motion.cutting import stretched

FACTORS = (1.002, 1.005, 1.01, 1.02, 1.05, 1.1)
"""Stretches of time that are tried, in this order."""

SLOWER = "fly it slower with --stretch, plan below the limit, or choose another format"
"""Remedy for checks that a slower flight eases."""

CLEARER = "plan with more room there, or choose another format"
"""Remedy for the others."""

MOST_DRONES = 100
"""Largest team for which slower flights are tried: trials of larger ones take too long."""


def violations_of(
    kind: Format, verdict: Verdict, certificate: Certificate
) -> tuple[Violation, ...]:
    """Return what an export loses, each with what the plan itself keeps."""
    planned = {check.name: check for check in certificate.checks}
    found = [_violation(check, planned[check.name]) for check in verdict.lost]
    position = verdict.position
    if position.worst > kind.accuracy:
        found.append(
            Violation(
                "position_error",
                position.worst,
                kind.accuracy,
                "max",
                "m",
                (position.drone,),
                f"at t = {position.time:.4g} s",
                "choose another format, such as csv, or a higher --rate where it samples",
            )
        )
    return tuple(found)


def _violation(check: Check, planned: Check) -> Violation:
    lost = abs(check.bound - planned.bound)
    unit = "" if check.unit in {"1", "ratio"} else f" {check.unit}"
    return check.violation(
        f"at t = {check.time:.4g} s (the plan keeps {planned.bound:.6g}{unit}, "
        f"the export loses {lost:.3g}{unit})",
        SLOWER if RULE_OF[check.name].derivative else CLEARER,
    )


def with_slower(
    error: InfeasibleError,
    task: Task,
    trial: Callable[[Task], None],
    progress: Callable[[str], None] | None = None,
) -> InfeasibleError:
    """Return the same refusal, with the smallest stretch that has been tried and will do.

    Parameters
    ----------
    error: why the plan is not exported as it is.
    task: of the plan.
    trial: exports a task somewhere else, or raises InfeasibleError.
    progress: called with what is being done now.
    """
    mendable = any(v.remedy == SLOWER for v in error.violations)
    if not mendable or len(task.names) > MOST_DRONES:
        return error
    for factor in FACTORS:
        if progress is not None:
            progress(f"trying --stretch {factor:g}")
        try:
            trial(replace(task, motion=stretched(task.motion, factor)))
        except InfeasibleError:
            continue
        note = f"verified: --stretch {factor:g} ({100 * (factor - 1):.2g} % slower) loses nothing"
        return InfeasibleError(error.violations, f"{error.note}\n{note}" if error.note else note)
    return error
