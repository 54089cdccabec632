"""Certified plans along given paths: straight, rigid, of an action, or of an earlier plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from hitchopt.checks.registry import distances_from, names_of
from hitchopt.errors import AT_END
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.ends import end_of_transport
from hitchopt.planners.morph.actions import Action, ActionMorph, FlownAction
from hitchopt.planners.morph.detours import Translatable, detours
from hitchopt.planners.morph.legs import largest_roll
from hitchopt.planners.morph.morph import check_loads, clear_straight_path, moves, straight_path
from hitchopt.planners.morph.retargeting import (
    EarlierRoute,
    motion_by_earlier_clock,
    straight_progress,
)
from hitchopt.planners.path import Path, RigidPath
from hitchopt.planners.rests import IDLE, check_at_rest, rest_motion
from hitchopt.planners.task import StepPlan, StepTask, require_certified
from hitchopt.planners.timing.timed_motion import motion_along
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

P = TypeVar("P", bound="Translatable")


def plan_along(
    task: StepTask, path: Path, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Time a path, and return the plan of its motion; reading its certificate certifies it.

    Parameters
    ----------
    path: route to the hitch ``end``.
    phase: with the step's name, index, remark and range of tensions.
    duration: prescribed duration [s]; None for the fastest one.
    """
    motion = motion_along(path, task.requirements, duration)
    return plan_of(task, path, motion, end, phase)


def plan_of(
    task: StepTask, path: Path | None, motion: Motion, end: Hitch, phase: Phase
) -> StepPlan:
    """Return the plan of a motion along a path, as one phase."""
    phases = (phase.retimed(0.0, motion.duration),)
    return replace(task.plan_ending(motion.replaced(phases=phases), end), path=path)


OBSTACLE_CHECKS = names_of(distances_from("objects"))
"""Checks of obstacles, over or around which hitches and objects fly."""

DETOUR_CHECKS = OBSTACLE_CHECKS | {"friction_shift"}  # Checks whose violations detours may repair
MAX_DETOURS = 6  # Maximum number of detours of one path that are tried


def past_obstacles(
    task: StepTask, direct: StepPlan, path: P | None, along: Callable[[P], StepPlan]
) -> StepPlan:
    """Return a plan once it is certified, or one on a detour if only obstacles are in its way.

    Raises InfeasibleError with what the plan breaks, or the best one of its detours.

    Parameters
    ----------
    direct: plan along ``path``, which is None if its motion has none.
    along: returns the plan along another path.
    """

    def on_detour(route: P, shift: PiecewisePolynomial) -> StepPlan:
        """Return the certified plan along a translated path."""
        plan = require_certified(along(route.translated(shift)))
        farthest = float(np.max(length(shift.at(np.linspace(0.0, 1.0, 201)))))
        return plan.with_remark(f"on a detour of up to {farthest:.2g} m around obstacles")

    def candidates() -> Iterator[Candidate[StepPlan]]:
        """Yield the plan itself, and those on detours."""
        yield Candidate("route", partial(require_certified, direct))
        violated = {check.name for check in direct.certificate.violated}
        if path is not None and violated <= DETOUR_CHECKS:
            for shift in detours(path, task.requirements)[:MAX_DETOURS]:
                yield Candidate("detour", partial(on_detour, path, shift))

    return first_certified(candidates(), task.effort)


def straight_plan(
    task: StepTask, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the plan along the straight path to a hitch; of one at rest without a path."""
    if not moves(task.hitch, end):
        rest = rest_motion(end, task.requirements, duration or IDLE, phase)
        return task.plan_ending(rest, end)
    path = straight_path(task.hitch, end, task.requirements)
    return plan_along(task, path, end, phase, duration)


def rigid_plan(
    task: StepTask, to: Array, yaw: float, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the plan of a hitch that moves and turns without a change of its shape.

    Where prisms or objects may be in its way, it is certified. Raises InfeasibleError if the hitch
    breaks a limit at rest in the goal.

    Parameters
    ----------
    to: goal (3,) of its centroid [m].
    yaw: angle [rad] by which it turns about it.
    phase: with the step's name and index.
    duration: prescribed duration [s]; None for the fastest one.
    """
    requirements = task.requirements
    end = end_of_transport(task.hitch, to, yaw)
    check_at_rest(end, requirements, AT_END, phase.place)
    path = RigidPath(task.hitch, to, yaw)
    if path.is_constant:
        return task.plan_ending(rest_motion(end, requirements, duration or IDLE, phase), end)
    check_loads(path, requirements.limits)

    def along(path: RigidPath) -> StepPlan:
        """Return the plan along a path."""
        motion = motion_along(path, requirements, duration)
        timed = motion.replaced(phases=(phase.retimed(0.0, motion.duration),))
        return task.plan_ending(timed, end)

    direct = along(path)
    if not requirements.keep_out and not requirements.objects:
        return direct
    return past_obstacles(task, direct, path, along)


def plan_like(
    task: StepTask, earlier: Motion, end: Hitch, phase: Phase, duration: float | None = None
) -> StepPlan:
    """Return the certified plan like an earlier one between nearly the same hitches.

    It is on the same route, moved to its own ends: of straight lines by the same clock as well,
    stretched or shortened to the limits. Parameters are those of ``plan_along``.
    """
    progress = straight_progress(earlier)
    if progress is None:
        phase = replace(phase, remark="on the route of an earlier plan")
        path = EarlierRoute.of(earlier).path(task.hitch, end)
        return require_certified(plan_along(task, path, end, phase, duration))
    path = clear_straight_path(task.hitch, end, task.requirements)
    motion = motion_by_earlier_clock(path, progress, task.requirements)
    if motion is None or duration is not None:
        check_loads(path, task.requirements.limits)
        return require_certified(plan_along(task, path, end, phase, duration))
    phase = replace(phase, remark="by the clock of an earlier plan")
    return require_certified(plan_of(task, path, motion, end, phase))


def transport_plan(task: StepTask, to: Array) -> StepPlan:
    """Return the plan of the step ``transport`` to a goal (3,) [m], with its defaults."""
    return rigid_plan(task, to, 0.0, Phase("transport", task.index, 0.0, 0.0))


MAX_ROLLING = 4  # Maximum number of paths with legs that roll that are certified for one flight


def action_plan(
    task: StepTask,
    action: Action,
    end: Hitch,
    phase: Phase,
    duration: float | None,
    reason: str,
) -> StepPlan:
    """Return the plan of an action of the paper, whose remark names the further drones that move.

    Parameters
    ----------
    end: hitch after the action; its legs may differ from those of the action's law.
    phase: with the step's name and index.
    duration: prescribed duration [s]; None for the fastest one.
    reason: why its legs differ; empty if they do not.
    """
    flown = ActionMorph(action, end, task.requirements, duration).solve()
    if flown is None:
        rest = rest_motion(end, task.requirements, duration or IDLE, phase)
        return task.plan_ending(rest, end)
    phase = replace(phase, remark="; ".join(_remarks_on_drones(flown, action, reason)))
    return plan_of(task, flown.path, flown.motion, end, phase)


def rolling_action_plan(
    task: StepTask, action: Action, end: Hitch, phase: Phase, duration: float | None
) -> StepPlan:
    """Return the certified plan of an action whose legs roll between its ends.

    Parameters are those of ``action_plan``. Raises InfeasibleError if legs come too close with any
    roll.
    """
    morph = ActionMorph(action, end, task.requirements, duration)

    def along(path: Path) -> StepPlan:
        """Return the certified plan along one of the paths."""
        flown = morph.flown(path)
        remark = f"legs roll by up to {math.degrees(largest_roll(path)):.0f}° on the way"
        if flown.worst is not None:
            remark += f": limits bind at {flown.worst:.0%} of the path"
        return require_certified(
            plan_of(task, path, flown.motion, end, replace(phase, remark=remark))
        )

    paths = morph.rolling[:MAX_ROLLING] or [morph.path_by_law]
    rolling = [Candidate("rolling path", partial(along, path)) for path in paths]
    return first_certified(rolling, task.effort, task.progress)


def _remarks_on_drones(flown: FlownAction, action: Action, reason: str) -> list[str]:
    """Describe the drones that move in addition to those of an action, and why."""
    team = action.start.team
    remarks = list[str]()
    if flown.worst is not None:
        reason = ", and ".join(
            filter(None, [reason, f"limits bind at {flown.worst:.0%} of the path"])
        )
    if flown.turning:
        cause = "tensions differ, so legs turn with both edges at their vertex"
        if np.any(action.start.roll):
            cause = "legs are rolled, so they turn with both edges at their vertex"
        elif team.loaded and np.ptp(team.tension) == 0.0:
            cause = "clasps carry weight, so legs rise as it changes"
        remarks.append(_further_drones(flown.turning, "turn", cause))
    if flown.sliding:
        remarks.append(_further_drones(flown.sliding, "slide", reason))
    return remarks


def _further_drones(names: Sequence[str], verb: str, reason: str) -> str:
    """Describe drones that move in addition to those of an action."""
    ending = "s" if len(names) == 1 else ""
    return f"{', '.join(names)} {verb}{ending} as well: {reason}"


def vertical_motion(
    hitch: Hitch, altitude: float, requirements: Requirements, phase: Phase
) -> Motion:
    """Return the motion of a hitch straight up or down; it sets the end of ``phase``."""
    path = RigidPath(hitch, np.append(hitch.polygon.centroid, altitude), 0.0)
    motion = motion_along(path, requirements)
    return motion.replaced(phases=(replace(phase, end=motion.duration),))
