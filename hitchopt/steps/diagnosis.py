"""What a certificate that does not hold says: what binds, where and when, and what to change."""

from __future__ import annotations

from hitchopt.checks import Certificate, Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError
from hitchopt.motion.motion import Phase
from hitchopt.requirements import Separation


def infeasible(
    certificate: Certificate,
    separation: Separation,
    phases: tuple[Phase, ...] = (),
    when: str = "",
) -> InfeasibleError:
    """Return the error that tells what a certificate's broken checks say.

    Parameters
    ----------
    certificate: one that does not hold.
    separation: the distances required, to tell in metres by how much drones are too close.
    phases: the plan's, to name the step in which it happens.
    when: said instead, for a certificate of something at rest.
    """
    return InfeasibleError(
        [
            check.violation(
                _metres(check, separation) + (when or _moment(check, phases)),
                _remedy(check, phases),
            )
            for check in certificate.violated
        ]
    )


def _remedy(check: Check, phases: tuple[Phase, ...]) -> str:
    formed = [phase.formed for phase in phases if phase.start <= check.time <= phase.end]
    rule = RULE_OF[check.name]
    return (rule.free_remedy if formed and not any(formed) else "") or rule.remedy


def _metres(check: Check, separation: Separation) -> str:
    """Return how far apart drones are and should be; a hitch's drones fly at one height."""
    if check.name != "separation":
        return ""
    needed = 2.0 * separation.radius * check.number
    apart = check.bound * 2.0 * separation.radius
    return f"({apart:.3g} m apart, {needed - apart:.3g} m too close) "


def _moment(check: Check, phases: tuple[Phase, ...]) -> str:
    if check.name == "duration":
        return ""
    for phase in phases:
        if phase.start <= check.time <= phase.end:
            return f"at t = {check.time:.4g} s, in step {phase.step} ({phase.name})"
    return f"at t = {check.time:.4g} s"
