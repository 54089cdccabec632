"""Motions of single steps, at rest or flying, on free cables or tied, with their certificates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks import Certificate, Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import HitchoptError, InfeasibleError, TimeLimitError, Violation
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.approach import CLEARANCE, hover_altitude
from hitchopt.planners.forming.prehitch import PreHitch, find_prehitch
from hitchopt.planners.forming.stages import stage
from hitchopt.planners.morph.path import RigidPath
from hitchopt.planners.timing.flight import Flight, fly
from hitchopt.steps.step import Situation, StepPlan, StepTask
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEVEL = 1e-3
"""[m] Difference of heights up to which drones are level: it adds less than 1e-5 m to a distance of
0.24 m, and is less than what the ratio's digits show."""


@dataclass(frozen=True, eq=False)
class Certified:
    """The motion of a whole plan and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


def checked(planned: StepPlan, when: str = "") -> StepPlan:
    """Return a plan; raise InfeasibleError for what it breaks, ``when`` being said for the time."""
    if not planned.certificate.certified:
        raise infeasible(planned.certificate, planned.motion, when)
    return planned


def tried(planned: Callable[[], StepPlan]) -> StepPlan | HitchoptError:
    """Return a plan that breaks no limit, or why there is none; that time is up is raised."""
    try:
        return checked(planned())
    except TimeLimitError:
        raise
    except HitchoptError as error:
        return error


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


def at_rest(hitch: Hitch, requirements: Requirements) -> StepPlan:
    """Return the plan in which a hitch stays, for as long as limits do not matter."""
    motion = resting(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))
    return StepPlan(motion, Situation.formed(hitch))


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    checked(at_rest(hitch, requirements), when)


def infeasible(certificate: Certificate, motion: Motion, when: str = "") -> InfeasibleError:
    """Return the error that tells what a certificate's broken checks say.

    Parameters
    ----------
    certificate: one that does not hold.
    motion: whose it is.
    when: said in place of time and step, for a certificate of something at rest.
    """
    found = []
    for check in certificate.violated:
        phases = [p for p in motion.phases if p.start <= check.time <= p.end]
        words = when
        if not when and check.name != "duration":
            step = f", in step {phases[0].step} ({phases[0].name})" if phases else ""
            words = f"at t = {check.time:.4g} s{step}"
        found.append(
            check.violation(_metres(check, motion) + words, _remedy(check, motion, phases))
        )
    return InfeasibleError(found)


def _remedy(check: Check, motion: Motion, phases: Sequence[Phase]) -> str:
    """Return what to change, of the remedies that a check has for different bodies."""
    rule = RULE_OF[check.name]
    if phases and not any(phase.formed for phase in phases):
        return rule.free_remedy or rule.remedy
    if rule.far_remedy and not _share_clasp(check.where, motion.team):
        return rule.far_remedy
    return rule.remedy


def _share_clasp(where: tuple[str, ...], team: Team) -> bool:
    """Return whether a drone stands at a clasp of another drone, or of a cable."""
    layout, names = team.layout, team.drone_names
    cables = {f"cable {k}": {layout.starts[k], layout.ends[k]} for k in range(team.robots)}
    drones = {name: {layout.anchors[i]} for i, name in enumerate(names)}
    points = [(drones | cables)[name] for name in where if name in drones or name in cables]
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


# Motions on free cables, and of hitches that are tied or untied.

SAME_ALTITUDE = 1e-9
"""Altitudes that differ by less are the same [m]."""

TIGHTENING = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the move from the pre-hitch to the hitch at which the cables' heights are sampled."""


def hovering(task: StepTask, seconds: float) -> Motion:
    """Return the motion in which drones on free cables stay: parked, or hovering."""
    team, rest = task.before.team, PiecewisePolynomial.constant([0.0, seconds], task.before.drones)
    motion = stage("parked", rest, team, task.requirements, task.index, CableState.GROUND)
    (phase,) = motion.phases
    hanging = phase.state is CableState.FREE
    return replace(motion, phases=(replace(phase, name="hold"),)) if hanging else motion


def check_start(task: StepTask) -> None:
    """Raise InfeasibleError where drones on free cables break a limit before anything moves."""
    try:
        checked(StepPlan(hovering(task, 1.0), task.before), "at the start (t = 0)")
    except InfeasibleError as error:
        found = [_span(v, task.before) if v.constraint == "span" else v for v in error.violations]
        found.sort(key=lambda v: v.constraint != "span")  # what else is broken follows from it
        raise InfeasibleError(found, error.note) from None


def _span(violation: Violation, before: Situation) -> Violation:
    """Return the violation with the drones named that are too far apart, and by how much."""
    k = int(violation.where[0].removeprefix("cable "))
    apart = float(np.linalg.norm(before.drones[2 * k + 1] - before.drones[2 * k]))
    length = float(before.team.cable_length[k])
    return replace(
        violation,
        where=(f"robot {k}", f"q{k}", f"r{k}"),
        when=f"({apart:.6g} m apart on a cable of {length:.6g} m) {violation.when}",
        remedy=f"move q{k} and r{k} of start.drones closer together, or use a longer cable",
    )


def check_above_ground(motion: Motion) -> None:
    """Raise InfeasibleError where a drone goes below the ground, z = 0, that it takes off from.

    An arena's floor has a check of its own.
    """
    heights = motion.drones.coefficients[:, :, 2]
    if motion.requirements.arena is not None or np.min(heights) >= -SAME_ALTITUDE:
        return
    piece, drone, _ = np.unravel_index(int(np.argmin(heights)), heights.shape)
    lowest, name = float(np.min(heights)), motion.team.drone_names[drone]
    when = f"over the ground at about t = {motion.drones.breaks[piece]:.4g} s"
    remedy = "keep altitudes above 0, or give an arena with a lower floor"
    raise InfeasibleError([Violation("arena", lowest, 0.0, "min", "m", (name,), when, remedy)])


def tying_site(
    hitch: Hitch, swap: SwapSettings, senses: Array | None, requirements: Requirements
) -> tuple[Hitch, PreHitch]:
    """Return the hitch where it is tied or untied, as much higher as that takes, and its pre-hitch.

    ``senses`` (clasps,) are those with which it was formed, to be reversed; None to choose them.
    """
    pre = find_prehitch(hitch, requirements.separation, swap)
    if senses is not None:
        pre = replace(pre, turns=pre.turns.with_senses(senses))
    floor, clearance = requirements.floor, CLEARANCE * requirements.separation.cable
    drawn = (pre.drones + share * (hitch.drones - pre.drones) for share in TIGHTENING)
    hanging = (hover_altitude(hitch.team, drones, floor, clearance) for drones in drawn)
    altitude = max(hitch.altitude, floor + clearance + pre.measures.lowest, *hanging)
    by = altitude - hitch.altitude
    if by <= SAME_ALTITUDE:
        return hitch, pre
    high = Hitch(hitch.team, hitch.polygon, altitude, hitch.q_legs, hitch.roll)
    return high, replace(pre, turns=pre.turns.raised(by))


def lifted(hitch: Hitch, altitude: float, name: str, task: StepTask) -> Motion:
    """Return the motion of the hitch straight up or down, as one phase of a step."""
    to = np.append(hitch.polygon.centroid, altitude)
    flight = fly(RigidPath(hitch, to, 0.0), task.requirements.limits)
    remark = "cables that hang need more room over the ground than the hitch"
    phase = Phase(name, task.index, 0.0, flight.duration, remark)
    return flying(flight, hitch.team, task.requirements, [phase])
