"""Motions of single steps, at rest or flying, with their certificates and what these say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks import Certificate, Check, certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_lengths import reference_margin
from hitchopt.hitch.leg_task import LegTask
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.timing.demands import loads_at_rest
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial

LEVEL = 1e-3
"""[m] Difference of heights up to which drones are level: it adds less than 1e-5 m to a distance of
0.24 m, and is less than what the ratio's digits show."""


@dataclass(frozen=True, eq=False)
class Certified:
    """A motion and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


def certified(motion: Motion) -> Certified:
    """Return the motion of one step with its certificate, the whole plan's duration left open."""
    return Certified(motion, certify(motion.untimed, part=True))


def checked(motion: Motion, when: str = "") -> Certified:
    """Return the motion with its certificate, or raise InfeasibleError for what it breaks.

    Parameters
    ----------
    motion: of one step or a part of it.
    when: said in place of the time, for a motion at rest.
    """
    found = certified(motion)
    if not found.certificate.certified:
        raise infeasible(found.certificate, motion, when)
    return found


def resting(hitch: Hitch, requirements: Requirements, seconds: float, phase: Phase) -> Motion:
    """Return the motion in which the hitch stays for ``seconds`` [s]; the phase's end is set."""
    values = (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    flight = Flight(*(PiecewisePolynomial.constant([0.0, seconds], value) for value in values))
    return flying(flight, hitch.team, requirements, [replace(phase, start=0.0, end=seconds)])


def flying(
    flight: Flight, team: Team, requirements: Requirements, phases: Sequence[Phase]
) -> Motion:
    """Return the motion of a flight, its phases from t = 0."""
    return Motion(team, requirements, **vars(flight), phases=tuple(phases))


def at_rest(hitch: Hitch, requirements: Requirements) -> Motion:
    """Return the motion of the hitch without any motion, as long as limits do not matter."""
    return resting(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))


def certificate_at_rest(hitch: Hitch, requirements: Requirements) -> Certificate:
    """Return the certificate of the hitch without any motion."""
    return certified(at_rest(hitch, requirements)).certificate


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    checked(at_rest(hitch, requirements), when)


def seems_to_rest(hitch: Hitch, requirements: Requirements) -> bool:
    """Return whether a hitch at rest seems to satisfy all limits, without a certificate.

    The certificate of a motion from or to it proves it: where that is refused, ``check_at_rest``
    tells whether rest itself breaks a limit. With keep-outs or objects this says no.
    """
    team, limits, arena = hitch.team, requirements.limits, requirements.arena
    if requirements.keep_out or requirements.objects:
        return False
    thrust, drones = loads_at_rest(team, hitch.cable_forces), hitch.drones
    level = np.hypot(thrust[:, 0], thrust[:, 1])
    fits = (
        np.all(hitch.legs[team.layout.has_leg] >= limits.leg)
        and np.all(length(thrust) <= team.max_thrust)
        and np.all(np.arctan2(level, thrust[:, 2]) <= limits.tilt)
        and (arena is None or np.all((drones >= arena.lower) & (drones <= arena.upper)))
    )
    shape = (hitch.polygon.vertices[None], hitch.q_legs[None], limits.leg, 1.0)
    task = LegTask(team, requirements, *shape, roll=hitch.roll[None])
    return bool(fits) and reference_margin(task) >= 1.0


def infeasible(certificate: Certificate, motion: Motion, when: str = "") -> InfeasibleError:
    """Return the error that tells what a certificate's broken checks say.

    Parameters
    ----------
    certificate: one that does not hold.
    motion: whose it is: its distances tell in metres by how much level drones are too close, its
        phases in which step it happens.
    when: said instead, for a certificate of something at rest.
    """
    return InfeasibleError(
        [
            check.violation(
                _metres(check, motion) + (when or _moment(check, motion.phases)),
                _remedy(check, motion),
            )
            for check in certificate.violated
        ]
    )


def _remedy(check: Check, motion: Motion) -> str:
    during = (phase for phase in motion.phases if phase.start <= check.time <= phase.end)
    formed = [phase.formed for phase in during]
    rule = RULE_OF[check.name]
    if formed and not any(formed):
        return rule.free_remedy or rule.remedy
    far = rule.far_remedy and not _share_clasp(check.where, motion.team)
    return rule.far_remedy if far else rule.remedy


def _share_clasp(where: tuple[str, ...], team: Team) -> bool:
    """Return whether a drone stands at a clasp of another drone, or of a cable."""
    layout, points = team.layout, []
    for name in where:
        if name in team.drone_names:
            points.append({layout.anchors[team.drone_names.index(name)]})
        elif name.startswith("cable "):
            k = int(name.removeprefix("cable "))
            points.append({layout.starts[k], layout.ends[k]})
    return len(points) == 2 and bool(set.intersection(*points))


def _metres(check: Check, motion: Motion) -> str:
    """Return how far apart drones are and should be, where they are at one height."""
    if check.name != "separation":
        return ""
    drones = [motion.team.drone_names.index(name) for name in check.where]
    if np.ptp(motion.drones.at([check.time])[0, drones, 2]) > LEVEL:
        return ""
    wide = 2.0 * motion.requirements.separation.radius
    needed, apart = wide * check.number, wide * check.bound
    return f"({apart:.3g} m apart, {needed - apart:.3g} m too close) "


def _moment(check: Check, phases: tuple[Phase, ...]) -> str:
    if check.name == "duration":
        return ""
    for phase in phases:
        if phase.start <= check.time <= phase.end:
            return f"at t = {check.time:.4g} s, in step {phase.step} ({phase.name})"
    return f"at t = {check.time:.4g} s"
