"""What a certificate that does not hold says: what binds, where and when, and what to change."""

from __future__ import annotations

from hitchopt.checks import Certificate, Check
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.motion.motion import Phase
from hitchopt.requirements import Separation

REMEDIES = {
    "separation": "give the drones longer legs (a longer cable or a smaller polygon), "
    "another slack split, or a smaller separation.radius",
    "cable_clearance": "give the drones longer legs (a longer cable or a smaller polygon), "
    "another slack split, or a smaller separation.cable",
    "crossing": "shorten the legs that meet (a shorter cable or a larger polygon), "
    "split their slack otherwise, or lower separation.crossing",
    "speed": "raise limits.speed",
    "acceleration": "raise limits.acceleration",
    "jerk": "raise limits.jerk",
    "vertex_speed": "raise limits.vertex_speed",
    "thrust": "give the drone more thrust, or lower team.tension",
    "tilt": "raise limits.tilt_deg, or lower team.tension",
    "legs": "use a longer cable, a smaller polygon, or a smaller limits.leg",
    "span": "use a longer cable, a smaller polygon, or place the drones closer together",
    "interlacing": "place the drones so that cables need not pass each other",
    "convexity": "go by a polygon in between, in two morphs",
    "arena": "enlarge the arena, or keep the hitch farther from its walls",
    "duration": "raise limits.duration, or the limits of motion",
}
"""What a user can change, by check. Which change is enough is computed in ``repair``."""

FREE_REMEDIES = {
    "separation": "place the drones farther apart, use longer cables or a larger polygon, "
    "or allow a smaller separation.radius",
    "cable_clearance": "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    "crossing": "place the robots farther apart, or lower separation.crossing",
    "thrust": "give the drone more thrust, or lower team.cable_density",
    "tilt": "raise limits.tilt_deg, or lower team.cable_density",
    "cable_length": "use a longer cable, or a smaller polygon",
}
"""The same while cables are free."""

SLOWER_HOLDS = ("speed", "acceleration", "jerk", "vertex_speed", "thrust", "tilt")
"""Checks that hold more easily where everything goes slower."""


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
            Violation(
                check.name,
                check.worst,
                check.limit,
                check.sense,
                check.unit,
                check.where,
                _metres(check, separation) + (when or _moment(check, phases)),
                _remedy(check, phases),
            )
            for check in certificate.violated
        ]
    )


def _remedy(check: Check, phases: tuple[Phase, ...]) -> str:
    formed = [phase.formed for phase in phases if phase.start <= check.time <= phase.end]
    if formed and not any(formed) and check.name in FREE_REMEDIES:
        return FREE_REMEDIES[check.name]
    return REMEDIES.get(check.name, "this plan must not be flown; please report it")


def _metres(check: Check, separation: Separation) -> str:
    """Return how far apart drones are and should be; a hitch's drones fly at one height."""
    if check.name != "separation":
        return ""
    needed = 2.0 * separation.radius * check.limit
    apart = check.worst * 2.0 * separation.radius
    return f"({apart:.3g} m apart, {needed - apart:.3g} m too close) "


def _moment(check: Check, phases: tuple[Phase, ...]) -> str:
    if check.name == "duration":
        return ""
    for phase in phases:
        if phase.start <= check.time <= phase.end:
            return f"at t = {check.time:.4g} s, in step {phase.step} ({phase.name})"
    return f"at t = {check.time:.4g} s"
