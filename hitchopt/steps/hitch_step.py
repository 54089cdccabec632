"""Steps that a hitch does and is one afterwards: those that change its shape, and actions."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hitchopt.errors import HitchoptError, InputError, TimeLimitError
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.flying import ActionFlight, Flying
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import (
    Certified,
    check_at_rest,
    flying,
    resting,
    seems_to_rest,
)
from hitchopt.steps.edits import StepEdit, points_scaled
from hitchopt.steps.end_hitch import End, broken_on_the_way, end_of_action
from hitchopt.steps.friction_lean import against_friction
from hitchopt.steps.route_choice import (
    SHUT,
    OptimisedRoute,
    Route,
    fastest_certified,
    first_certified,
)
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.slack_split import SlackSplit
from hitchopt.steps.step import Step, convex_outline, numbers
from hitchopt.values import Array

IDLE = 0.01
"""Duration [s] of a step that moves nothing and was given none."""


class HitchStep(Step):
    """A step that begins and ends with a hitch."""

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the step, its legs leaning against friction."""
        return against_friction(self.fly(task), timed=self.given_duration is not None)

    @abstractmethod
    def fly(self, task: StepTask) -> StepPlan:
        """Return the plan as if cables had no friction."""

    def check_end(self, end: Hitch, task: StepTask) -> None:
        """Raise InfeasibleError where the hitch after the step breaks a limit at rest."""
        check_at_rest(end, task.requirements, f"at the end of step {task.index} ({self.name})")

    def motion(self, task: StepTask, flight: Flight | None, end: Hitch, remark: str = "") -> Motion:
        """Return the motion of a flight, or of a rest where nothing moves."""
        duration = 0.0 if flight is None else flight.duration
        phase = Phase(self.name, task.index, 0.0, duration, remark)
        if flight is None:
            return resting(end, task.requirements, self.given_duration or IDLE, phase)
        return flying(flight, end.team, task.requirements, [phase])


class ShapeStep(HitchStep):
    """A step that changes the shape by untimed vertices and legs."""

    blendable: ClassVar[bool] = True
    legs: SlackSplit | None

    @abstractmethod
    def end(self, task: StepTask) -> End:
        """Return the hitch after the step."""

    @abstractmethod
    def own_route(self, task: StepTask, end: End) -> Route[Any]:
        """Return the step's own route, straight and by its own law of the legs."""

    def fly(self, task: StepTask) -> StepPlan:
        """Return the step's own plan, or an optimised one where that is needed or asked for."""
        end = self.end(task)
        seems = seems_to_rest(end.hitch, task.requirements)
        if not seems:
            self.check_end(end.hitch, task)
        try:
            found, words = self._route(task, end)
        except TimeLimitError:
            raise
        except HitchoptError:
            if seems:
                self.check_end(end.hitch, task)
            raise
        motion = found.motion
        if words:
            (phase,) = motion.phases
            motion = replace(motion, phases=(replace(phase, remark=f"{phase.remark}: {words}"),))
        return task.ended(motion, end.hitch, found.certificate)

    def _route(self, task: StepTask, end: End) -> tuple[Certified, str]:
        """Return the step's own motion or an optimised one, and why the other one is not taken."""
        own = self.own_route(task, end)
        lead, tension = getattr(self, "optimize", False), getattr(self, "tension", None)
        phase = Phase(self.name, task.index, 0.0, 0.0, tension=tension)
        ends, duration = (task.hitch, end.hitch), self.given_duration
        other = OptimisedRoute(*ends, task.requirements, phase, duration, lead)
        what = "other route" if duration is None else "route that is fast enough either"
        note = f"the optimiser found no {what}"
        if task.optimiser and (lead or tension is not None):
            return fastest_certified(own, other, note)
        found, tried = first_certified([own, other] if task.optimiser else [own], note)
        return found, SHUT if tried else ""


class ActionStep(ShapeStep):
    """A step that is an action of the paper, which names the drones that move."""

    @abstractmethod
    def action(self, task: StepTask) -> Action:
        """Return the action."""

    def end(self, task: StepTask) -> End:
        """Return the hitch after the action."""
        return end_of_action(self.action(task), self.legs, task.requirements)

    def own_route(self, task: StepTask, end: End) -> Route[Flying]:
        """Return the route of the action to the hitch that it ends with."""
        action = self.action(task)

        def motion_of(found: Flying) -> Motion:
            remark = self._remark(action, end, found, task.requirements)
            return self.motion(task, found.flight, end.hitch, remark)

        asked = (action, end.hitch, task.requirements, self.given_duration)
        return Route(ActionFlight(*asked), motion_of)

    def _remark(self, action: Action, end: End, found: Flying, requirements: Requirements) -> str:
        """Return which drones move that the paper does not name, and why."""
        parts = []
        if found.turning:
            reason = "tensions differ, so legs turn with both edges at their vertex"
            if action.start.team.loaded and np.ptp(action.start.team.tension) == 0.0:
                reason = "clasps carry weight, so legs rise as it changes"
            parts.append(f"{_all_of(found.turning, 'turn')} as well: {reason}")
        if found.sliding:
            reasons = ["legs are to change"] if self.legs is not None else []
            reasons += [end.reason] if end.reason else []
            if found.worst is not None:
                path = action.path(end.hitch)
                altitude = action.start.altitude
                reasons.append(broken_on_the_way(path, found.worst, altitude, requirements))
            parts.append(f"{_all_of(found.sliding, 'slide')} as well: {', and '.join(reasons)}")
        return "; ".join(parts)


class MoveStep(ActionStep):
    """An action that takes something ``to`` a place or ``by`` an offset."""

    to: Array | None
    by: Array | None

    def check_to_or_by(self, shape: tuple[int, ...], words: str) -> None:
        """Raise InputError where not exactly one of ``to`` and ``by`` is given, or of wrong shape.

        Parameters
        ----------
        shape, words: of ``to``, and how to say it.
        """
        if (self.to is None) == (self.by is None):
            value = None if self.to is None else np.asarray(self.to).tolist()
            bound = "given where by is not, and only there"
            raise InputError("to", value, bound, "give either to or by")
        if self.to is not None:
            object.__setattr__(self, "to", numbers("to", self.to, shape, words))
        if self.by is not None:
            object.__setattr__(self, "by", numbers("by", self.by, (2,), "an offset [dx, dy]"))

    @abstractmethod
    def moved_points(self, team: Team, count: int) -> list[int]:
        """Return the indices of the points of an outline of ``count`` that go elsewhere."""

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline with what is moved at its new place."""
        points = outline.vertices.copy()
        moved = self.moved_points(team, len(points))
        points[moved] = points[moved] + np.asarray(self.by) if self.to is None else self.to
        return convex_outline(team, points, *self.moved_key)

    @property
    def moved_key(self) -> tuple[str, Array | None]:
        """The key that tells where to, and its value."""
        return ("by", self.by) if self.to is None else ("to", self.to)

    def scaled(self, factor: float, centre: Array) -> tuple[StepEdit | None, Array]:
        """Return the edit that scales the place about ``centre``, or the offset."""
        key, value = self.moved_key
        about = np.zeros(2) if key == "by" else centre
        points = points_scaled(np.asarray(value), factor, about)
        return StepEdit(key, points.tolist(), {key: points}), centre


def _all_of(names: tuple[str, ...], verb: str) -> str:
    """Return such as "r0 slides" or "q1, r0 slide"."""
    return f"{', '.join(names)} {verb}{'s' if len(names) == 1 else ''}"
