"""Base classes of the steps that begin and end with a hitch."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from functools import partial
from typing import ClassVar

from hitchopt.errors import AT_END
from hitchopt.hitch import Hitch
from hitchopt.planners.along import action_plan, rolling_action_plan
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.ends import End, end_of_action
from hitchopt.planners.morph import actions
from hitchopt.planners.morph.actions import Action
from hitchopt.planners.rests import check_at_rest
from hitchopt.planners.routes import RouteSearch, leg_candidates
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.keys import Legs
from hitchopt.steps.step import Step
from hitchopt.values.fields import with_fields


class HitchStep(Step):
    """A step that begins and ends with a hitch."""

    def check_end(self, end: Hitch, task: StepTask) -> None:
        """Raise InfeasibleError if the hitch after the step breaks a limit at rest."""
        check_at_rest(end, task.requirements, AT_END, self.phase(task).place)


class NonstopStep(HitchStep):
    """A step that may precede or follow another one without a stop."""

    blendable: ClassVar[bool] = True

    @abstractmethod
    def end(self, task: StepTask) -> End:
        """Return the hitch after the step."""

    def on_way(self, task: StepTask, count: int) -> list[Hitch]:  # noqa: ARG002
        """Return about ``count`` hitches that a flight without a stop passes before the end."""
        return []


class ShapeStep(NonstopStep):
    """A step that changes vertices and legs without prescribed times on the path."""

    legs: Legs | None

    @abstractmethod
    def direct_plan(self, task: StepTask, end: End) -> StepPlan:
        """Return the plan along the direct route, with the step's own leg lengths."""

    def plan(self, task: StepTask) -> StepPlan:
        """Return the first certified plan of those that differ in the legs at the end."""
        return first_certified(self.candidates(task), task.effort, task.progress)

    def candidates(self, task: StepTask) -> Iterator[Candidate[StepPlan]]:
        """Yield the plans to the nearest legs, and to spread ones where these are infeasible."""

        def plan_with(legs: Legs | None) -> StepPlan:
            """Return the plan to legs."""
            return with_fields(self, legs=legs).plan_route(task)

        return leg_candidates(task, self.phase(task), self.legs, plan_with)

    def plan_route(self, task: StepTask) -> StepPlan:
        """Return the direct plan, or an optimised one if it is needed or requested."""
        return self.search(task, self.end(task)).plan()

    def search(self, task: StepTask, end: End) -> RouteSearch:
        """Return the search of a route to the end, with the options that the step states."""
        direct = partial(self.direct_plan, task, end)
        return RouteSearch(task, end.hitch, self.phase(task), direct, self.prescribed_duration)


class ActionStep(ShapeStep):
    """A step that is an action of the paper, which specifies the drones that move."""

    #: Names of the fields that the action takes after the start and the polygon
    action_fields: ClassVar[tuple[str, ...]] = ("vertex",)

    def action(self, task: StepTask) -> Action:
        """Return the action of the same name."""
        start = task.hitch
        polygon = self.polygon_after(start.team, start.polygon)
        values = [getattr(self, name) for name in self.action_fields]
        action: Action = getattr(actions, self.name)(start, polygon, *values)
        return action

    def end(self, task: StepTask) -> End:
        """Return the hitch after the action."""
        return end_of_action(self.action(task), self.split, task.requirements)

    def direct_plan(self, task: StepTask, end: End) -> StepPlan:
        """Return the plan of the action to its end hitch."""
        reason = "legs are to change" if self.legs is not None else end.reason
        return action_plan(
            task,
            self.action(task),
            end.hitch,
            self.phase(task),
            self.prescribed_duration,
            reason,
        )

    def rolling_plan(self, task: StepTask, end: End) -> StepPlan:
        """Return the plan of the action with legs that roll on the way."""
        duration = self.prescribed_duration
        return rolling_action_plan(task, self.action(task), end.hitch, self.phase(task), duration)
