"""The step that removes what friction leaves of earlier ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Self

from hitchopt.errors import InputError
from hitchopt.friction.settling import settling_plan
from hitchopt.hitch import Team
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.keys import AUTO, AUTO_SECONDS
from hitchopt.steps.step import Step
from hitchopt.values.fields import Key, documented

__all__ = ["Settle"]


@documented
@dataclass(frozen=True)
class Settle(Step):
    """Remove friction hysteresis at the clasps.

    Vertices over-travel inward and outward, each time less far, and return to where they were.
    """

    time_key: ClassVar[str] = "seconds"
    seconds: Annotated[
        float | Literal["auto"],
        Key(AUTO_SECONDS, "Duration; auto: as far as limits allow", 15),
    ] = AUTO

    def resolved_for(self, team: Team) -> Self:
        """Return the step, or raise InputError for a team whose cables have no friction."""
        if team.friction == 0.0:
            bound = "used with a team whose cables have friction"
            remedy = "set team.cable_friction, or omit the step"
            raise InputError("", "no friction", bound, remedy)
        return super().resolved_for(team)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of vertices that over-travel about their places."""
        return settling_plan(task, self.prescribed_duration, self.phase(task), requested=True)
