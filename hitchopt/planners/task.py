"""Tasks of planning and their plans, each from one state at rest to the next."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.certifying import certify_part
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import Progress, RequestError, StepPlace
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase, concatenated
from hitchopt.objects import SolidObject
from hitchopt.planners.candidates import Effort
from hitchopt.planners.path import Path
from hitchopt.planners.timing.swing import after_swing
from hitchopt.planners.timing.timed_motion import check_duration
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class RestState:
    """State at rest between two steps: a hitch, or drones on free cables."""

    team: Team  # Robots of the hitch, or of the hitch to be formed
    drones: Array  # (2n, 3) [m], in the order q0, r0, q1, r1, …
    hitch: Hitch | None = None  # The hitch; None for free cables
    # (clasps,): turning senses of the pairs, 1 if q went up first; None for an initial hitch
    senses: Array | None = None
    # Objects at their current poses; None for those of the problem
    objects: Mapping[str, SolidObject] | None = None
    # What slices leave to later steps, by names of theirs; ``hitch`` is without held weights
    kept: Mapping[str, Any] = field(default_factory=dict)

    @property
    def tied(self) -> Hitch:
        """The hitch; raises InputError on free cables, which problems do not have here."""
        if self.hitch is None:
            raise RequestError("start", "free cables", "a hitch", "form one first")
        return self.hitch

    @property
    def assumed_senses(self) -> Array:
        """Turning senses (clasps,) of the pairs; ones for an initial hitch."""
        return np.ones(len(self.team.layout.clasps)) if self.senses is None else self.senses

    def keeping(self, name: str, value: Any) -> RestState:
        """Return the state with what a slice leaves to later steps under a name."""
        return replace(self, kept={**self.kept, name: value})

    def with_objects(self, requirements: Requirements) -> Requirements:
        """Return requirements with the objects of this state."""
        return requirements if self.objects is None else replace(requirements, objects=self.objects)


@dataclass(frozen=True, eq=False)
class StepPlan:
    """The motion of a step from rest to rest, and the state after it."""

    motion: Motion  # The motion, from rest to rest
    after: RestState  # The state at its end
    path: Path | None = None  # Path along which the motion was timed; None for other motions

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the motion as a part of a plan."""
        return certify_part(self.motion)

    def replaced(self, motion: Motion, after: RestState) -> StepPlan:
        """Return the plan with another motion and state; the same motion keeps its certificate."""
        plan = StepPlan(motion, after)
        if motion is self.motion:
            self._share_certificate(plan)
        return plan

    def with_remark(self, remark: str, *, at_end: bool = False) -> StepPlan:
        """Return the plan with a remark appended to those of its phases, or of its last one."""
        phases = list(self.motion.phases)
        for k in range(len(phases) - 1 if at_end else 0, len(phases)):
            remarks = filter(None, [phases[k].remark, remark])
            phases[k] = replace(phases[k], remark="; ".join(remarks))
        plan = StepPlan(self.motion.replaced(phases=tuple(phases)), self.after, self.path)
        self._share_certificate(plan)
        return plan

    def _share_certificate(self, plan: StepPlan) -> None:
        """Give the certificate, if it is computed, to a plan whose motion passes the same checks.

        Certificates do not depend on states and remarks.
        """
        if "certificate" in vars(self):
            vars(plan)["certificate"] = self.certificate


@dataclass(frozen=True, eq=False)
class StepTask:
    """The task of planning a step."""

    before: RestState  # State at the start
    index: int  # Index of the step in its mission
    requirements: Requirements  # Requirements of the plan
    optimiser: bool = True  # True if the optimiser may be used
    stated: Requirements | None = None
    """Requirements of the problem, of which planners' distances include the tracking errors; None
    if the plan's are those of the problem."""

    effort: Effort = field(default_factory=Effort)  # Effort of planning, and its limit
    progress: Progress | None = None  # Status callback

    @property
    def hitch(self) -> Hitch:
        """The hitch at the start; raises InputError on free cables."""
        return self.before.tied

    def within(self, requirements: Requirements, state: RestState) -> StepTask:
        """Return the task with other requirements and another start."""
        return replace(self, before=state, requirements=requirements)

    def plan_ending(self, motion: Motion, hitch: Hitch) -> StepPlan:
        """Return the plan of a motion to a hitch."""
        return StepPlan(motion, replace(self.before, hitch=hitch, drones=hitch.drones))


def slowed_to_duration(motion: Motion, duration: float | None, phase: Phase) -> Motion:
    """Return a motion slowed down to the prescribed duration of a phase's step [s], if any."""
    if duration is None:
        return motion
    check_duration(duration, motion.duration, phase.place)
    return motion.slowed(duration / motion.duration)


def plan_in_sequence(
    planners: Iterable[Callable[[StepTask], StepPlan]], task: StepTask
) -> StepPlan:
    """Return the plan of consecutive motions as one step; each starts where the last one ends."""
    state = task.before
    motions = list[Motion]()
    for planner in planners:
        requirements = state.with_objects(task.requirements)
        if motions:
            requirements = after_swing(requirements, concatenated(motions))
        plan = planner(task.within(requirements, state))
        motions.append(plan.motion)
        state = plan.after
    return StepPlan(concatenated(motions), state)


def require_certified(plan: StepPlan, when: str = "", step: StepPlace | None = None) -> StepPlan:
    """Return a certified plan, or raise InfeasibleError; of a plan at rest, with time and step."""
    if not plan.certificate.certified:
        raise infeasible_error(plan.certificate, plan.motion, when, step=step)
    return plan


def require_tracking(motion: Motion, stated: Requirements | None) -> None:
    """Raise InfeasibleError if the tracking errors that a problem states, if any, break a distance.

    Planners' distances include them, but hanging cables are displaced farther; see
    ``tracking_radius``.
    """
    if stated is None or not stated.limits.tube.level:
        return
    flown = motion.replaced(requirements=stated.untimed)
    certificate = certify(flown, reports=())
    radius = certificate[TRACKING_RADIUS.name]
    if not radius.holds:
        raise infeasible_error(replace(certificate, limited=(radius,)), flown)
