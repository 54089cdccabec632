"""Motions of single steps, with their certificates: at rest, on routes, on free cables, tied."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.errors import HitchoptError, InfeasibleError, InputError, TimeLimitError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.morph.legs import SLIDES, legs_clear
from hitchopt.planners.morph.morph import SAME, BlendedMorph
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.timing.flight import check_duration, fly, in_duration, needed_stretch
from hitchopt.steps.step import IDLE, RestState, RolledLegs, SlackSplit, StepPlan, StepTask
from hitchopt.trajectory import PiecewisePolynomial

if TYPE_CHECKING:
    from hitchopt.planners.morph.actions import Action

LEVEL = 1e-3
"""[m] Difference of heights up to which drones are level: it adds less than 1e-5 m to a distance of
0.24 m, and is less than what the ratio's digits show."""


@dataclass(frozen=True, eq=False)
class Certified:
    """The motion of a whole plan and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


def checked(planned: StepPlan, when: str = "") -> StepPlan:
    """Return a certified plan; else raise InfeasibleError, ``when`` naming the time."""
    if not planned.certificate.certified:
        raise infeasible(planned.certificate, planned.motion, when)
    return planned


def attempt(planned: Callable[[], StepPlan]) -> StepPlan | HitchoptError:
    """Return a plan or the error that refuses it; raise TimeLimitError."""
    try:
        return planned()
    except TimeLimitError:
        raise
    except HitchoptError as error:
        return error


def first_planned(ways: Iterable[Callable[[], StepPlan]]) -> StepPlan:
    """Return the first plan of those in turn that is not refused; else raise the first error."""
    refused = list[HitchoptError]()
    for way in ways:
        found = attempt(way)
        if isinstance(found, StepPlan):
            return found
        refused.append(found)
    raise refused[0]


def resting(hitch: Hitch, requirements: Requirements, seconds: float, phase: Phase) -> Motion:
    """Return the motion in which the hitch stays for ``seconds`` [s]; the phase's end is set."""
    values = (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    drones, vertices, legs, tensions = (
        PiecewisePolynomial.constant([0.0, seconds], value) for value in values
    )
    phases = (phase.retimed(0.0, seconds),)
    return Motion(hitch.team, requirements, drones, vertices, legs, tensions, phases)


def at_rest(hitch: Hitch, requirements: Requirements) -> StepPlan:
    """Return the plan in which a hitch stays, for as long as limits do not matter."""
    motion = resting(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))
    return StepPlan(motion, RestState.formed(hitch))


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    checked(at_rest(hitch, requirements), when)


def infeasible(certificate: Certificate, motion: Motion, when: str = "") -> InfeasibleError:
    """Return the violations of a certificate; ``when`` names the time and step."""
    violations = []
    for check in certificate.violated:
        phases = [p for p in motion.phases if p.start <= check.time <= p.end]
        words = when
        if not when and check.name != "duration":
            step = f", in step {phases[0].step} ({phases[0].name})" if phases else ""
            words = f"at t = {check.time:.4g} s{step}"
        remedy = _metres(check, motion) + _remedy(check, phases)
        violations.append(check.violation(words, remedy))
    return InfeasibleError(violations)


def _remedy(check: Check, phases: Sequence[Phase]) -> str:
    """Return the remedy, with a hitch or without."""
    rule = RULE_OF.get(check.name, TRACKING_RADIUS)
    free = phases and not any(phase.formed for phase in phases)
    return (free and rule.free_remedy) or rule.remedy


def _metres(check: Check, motion: Motion) -> str:
    """Return how far apart drones are and should be, where they are at one height."""
    if check.name != "separation":
        return ""
    heights = []
    for each in motion.flying:
        drones = each.motion.drones
        places = drones.at(float(np.clip(check.time, *drones.breaks[[0, -1]])))
        names = map(each.label, each.motion.team.drone_names)
        heights += [
            place[2] for name, place in zip(names, places, strict=True) if name in check.where
        ]
    if np.ptp(heights) > LEVEL:
        return ""
    wide = 2.0 * motion.requirements.separation.radius
    needed, apart = wide * check.number, wide * check.bound
    return f"{apart:.3g} m apart, {needed - apart:.3g} m too close: "


# The hitch that a step ends with, and its routes there.


def split_hitch(
    team: Team,
    polygon: Outline | ArrayLike,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch whose slack is split as ``legs`` says."""
    sharing, roll = (legs.sharing, legs.roll) if isinstance(legs, RolledLegs) else (legs, None)
    if isinstance(sharing, str) and sharing == "spread":
        requested = {name: getattr(requirements, name) for name in ("limits", "separation")}
        return Hitch.spread(team, polygon, altitude, roll=roll, **requested)
    given = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, given)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, given)
    auto = isinstance(legs, RolledLegs) and roll is None
    return hitch.least_rolled(requirements) if auto else hitch


class End(NamedTuple):
    """The hitch after a step, at rest, and what the action's own legs would break, in words."""

    hitch: Hitch
    reason: str = ""


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; without ``legs`` with fractions nearest to those before."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; without ``legs`` with those nearest to its law's."""
    start, polygon = action.start, action.polygon
    if legs is not None:
        return end_of_morph(start, polygon, legs, requirements)
    wanted = action.kept_legs
    try:
        hitch = Hitch(start.team, polygon, start.altitude, wanted, start.roll)
        check_at_rest(hitch, requirements, "at the end")
        return End(hitch)
    except InfeasibleError as error:
        broken = error.violations[0]
    nearest = _nearest(start, polygon, wanted / cable_slack(start.team, polygon), requirements)
    # A cable that need not slide keeps its legs to the last bit, so that its drones stay.
    q_legs = np.where(np.abs(nearest.q_legs - wanted) < SLIDES, wanted, nearest.q_legs)
    end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
    return End(end, str(replace(broken, when="at the end", remedy="with the action's own legs")))


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
    """Return the hitch within all limits whose fractions are nearest to those given."""
    requested = {name: getattr(requirements, name) for name in ("limits", "separation", "arena")}
    return Hitch.nearest(
        start.team, polygon, start.altitude, fractions, roll=start.roll, **requested
    )


DIRECT_INFEASIBLE = "the step's own route is infeasible"
SLOWER = "the step's own route takes longer"


def optimised(
    task: StepTask, end: Hitch, phase: Phase, duration: float | None = None, *, lead: bool = False
) -> StepPlan:
    """Return the fastest plan that the optimiser finds to a hitch at the same altitude.

    ``phase`` has the step's name and index, and within what tensions may change; ``lead``: also try
    legs that lead and lag. Raises InfeasibleError where it takes longer than ``duration`` [s].
    """
    from hitchopt.planners.morph.legs import leading
    from hitchopt.planners.optimise.search import OptimisedMorph

    start, requirements = task.hitch, task.requirements
    accepted: dict[Motion, StepPlan] = {}

    def planned(motion: Motion) -> StepPlan:
        flown = replace(phase, end=motion.duration)
        return task.ended(motion.replaced(phases=(flown,)), end)

    def certified_motion(path: ShapePath) -> Motion | None:
        """Return the motion along a path, or one on which legs lead and lag, if it is certified."""
        led = leading(path, requirements.limits) if lead else ()
        for each in (*(p for p in led if legs_clear(p, requirements)), path):
            try:
                motion = fly(each, requirements)
            except HitchoptError:
                if each is path:
                    raise
                continue
            plan = planned(motion)
            if plan.certificate.certified:
                accepted[motion] = plan
                return motion
        return None

    candidates = OptimisedMorph(start, end, requirements, certified_motion, phase.tension).solve()
    if not candidates:
        raise HitchoptError("no route was found")
    best, words = candidates[0].motion, f"on an optimised route, first guess {candidates[0].name}"
    if duration is None:
        return accepted[best].remarked(words)
    check_duration(duration, best.duration)
    return checked(planned(in_duration(best, duration)).remarked(words))


def combined_failure(own: HitchoptError, other: HitchoptError, note: str) -> HitchoptError:
    """Return one error for two refused routes, that of a route that is only too slow if any."""

    def late(refusal: InfeasibleError) -> float:
        """Return the time that a route takes at least [s], if that alone is why it is refused."""
        timed = all((v.constraint, v.sense) == ("duration", "min") for v in refusal.violations)
        return max((v.limit for v in refusal.violations if timed), default=math.inf)

    infeasible_routes = [each for each in (own, other) if isinstance(each, InfeasibleError)]
    if not infeasible_routes:
        return own
    first = min(infeasible_routes, key=late)  # the own one where none has a time
    if first is not own and isinstance(own, InfeasibleError):
        note = DIRECT_INFEASIBLE if late(own) == math.inf else SLOWER
    return InfeasibleError(first.violations, first.note or note)


SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.25)
"""Shares of the friction to lean against; the first of them that is certified is used."""

WHOLE, LONGER = 0.99, 1.5
"""Share of the friction from which on all of it counts as used, and most times as long as without
friction that a step may last for legs to lean so far."""

NOT_COMPENSATED = "clasp friction is not compensated: limits bind"


def against_friction(planned: StepPlan, *, timed: bool) -> StepPlan:
    """Return the plan with legs that lean against friction as far as limits allow, if they do.

    It may take up to LONGER times as long, unless its time is given (``timed``) or limited.
    """
    motion, limits = planned.motion, planned.motion.requirements.limits
    if motion.team.cable_friction == 0.0:
        return planned
    from hitchopt.planners.morph.friction import feedforward_matters, friction_feedforward

    if not feedforward_matters(motion):
        return planned
    slower = not timed and limits.duration is None
    for share in SHARES:
        feedforward = friction_feedforward(motion, share, slower=slower)
        if feedforward is None or feedforward.motion.duration > LONGER * motion.duration:
            continue
        words = f"legs lean against friction, by up to {math.degrees(feedforward.turned):.2g}°"
        if share < 1.0:
            words += f" ({share:.0%} of the friction: limits bind)"
        leant = replace(planned, motion=feedforward.motion).remarked(words)
        if leant.certificate.certified:
            return leant
    return planned.remarked(NOT_COMPENSATED)


def plan_blended(steps: Sequence[Any], task: StepTask) -> StepPlan:
    """Return the plan of shape steps without a stop in between; ``task`` is that of the first.

    One path through all hitches that they would have ended with, timed as a whole; each phase ends
    when its step's hitch is passed. Raises InputError for a step that moves nothing.
    """
    requirements, hitches = task.requirements, [task.hitch]
    for i, step in enumerate(steps, task.index):
        here = StepTask(RestState.formed(hitches[-1]), i, requirements)
        end = step.end(here).hitch
        step.check_end(end, here)
        if np.max(np.abs(end.drones - hitches[-1].drones)) < SAME:
            bound = "a step that moves something where steps are blended"
            remedy = "leave it out, or leave out blend"
            raise InputError(f"mission[{i}].{step.name}", "no motion", bound, remedy)
        hitches.append(end)
    motion, passed = BlendedMorph(hitches, requirements).solve()
    times = [0.0, *passed.tolist(), motion.duration]
    remarks = ["goes on without a stop"] * (len(steps) - 1) + [""]
    phases = tuple(
        Phase(step.name, task.index + j, times[j], times[j + 1], remarks[j])
        for j, step in enumerate(steps)
    )
    plan = task.ended(motion.replaced(phases=phases), hitches[-1])
    return against_friction(plan, timed=False)


def settling_plan(
    task: StepTask, seconds: float | None, phase: Phase, *, needed: bool = True
) -> StepPlan:
    """Return the plan in which drones swing to remove friction hysteresis at the clasps.

    They swing as far as limits allow for ``seconds`` [s], or SWINGS of SWING and longer if need be.
    Raises InfeasibleError if limits bind and the swing is ``needed``.
    """
    from hitchopt.planners.morph.friction import SWING, SWINGS, settling_swings

    lasts = SWING * (SWINGS + 0.5) if seconds is None else seconds
    hitch, requirements, settled = task.hitch, task.requirements, None
    rest = resting(hitch, requirements, lasts, phase)
    for share in SHARES:
        settling = settling_swings(rest, share)
        if settling is None:
            break
        swings, used = settling
        motion = swings.motion
        words = f"drones swing by up to {math.degrees(swings.turned):.2g}°"
        factor = needed_stretch(motion)
        if factor > 1.0 and seconds is None and factor <= LONGER:
            motion = motion.slowed(factor)
        if used < WHOLE:
            words += f" (at least {used:.0%} of the swing that suffices: legs bind)"
        settled = task.ended(motion, hitch).remarked(words)
        if settled.certificate.certified:
            return settled
    if settled is None:
        return task.ended(rest, hitch).remarked("no leg can lean against friction")
    if needed:
        raise infeasible(settled.certificate, settled.motion)
    unsettled = task.ended(resting(hitch, requirements, IDLE, phase), hitch)
    return unsettled.remarked("friction hysteresis is not removed: limits bind")


# Motions on free cables, and of hitches that are tied or untied.

SAME_ALTITUDE = 1e-9
"""Altitudes that differ by less are the same [m]."""


def hovering(task: StepTask, seconds: float) -> Motion:
    """Return the motion in which drones on free cables stay: parked, or hovering."""
    from hitchopt.planners.forming.stages import stage

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
        violations = [
            _span(v, task.before) if v.constraint == "span" else v for v in error.violations
        ]
        violations.sort(key=lambda v: v.constraint != "span")  # what else is broken follows from it
        raise InfeasibleError(violations, error.note) from None


def _span(violation: Violation, before: RestState) -> Violation:
    """Return the violation with the drones named that are too far apart, and by how much."""
    k = int(violation.where[0].removeprefix("cable "))
    apart = float(np.linalg.norm(before.drones[2 * k + 1] - before.drones[2 * k]))
    length = float(before.team.cable_length[k])
    return replace(
        violation,
        where=(f"robot {k}", f"q{k}", f"r{k}"),
        remedy=f"{apart:.6g} m apart on a cable of {length:.6g} m: move q{k} and r{k} of "
        "start.drones closer together, or use a longer cable",
    )


def check_above_ground(motion: Motion) -> None:
    """Raise InfeasibleError where drones go below the ground, z = 0, where no arena has a floor."""
    heights = motion.drones.coefficients[:, :, 2]
    if motion.requirements.arena is not None or np.min(heights) >= -SAME_ALTITUDE:
        return
    piece, drone, _ = np.unravel_index(int(np.argmin(heights)), heights.shape)
    lowest, name = float(np.min(heights)), motion.team.drone_names[drone]
    when = f"over the ground at about t = {motion.drones.breaks[piece]:.4g} s"
    remedy = "keep altitudes above 0, or give an arena with a lower floor"
    raise InfeasibleError([Violation("arena", lowest, 0.0, "min", "m", (name,), when, remedy)])
