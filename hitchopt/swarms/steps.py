"""The step of single drones: to fly to goals out of each other's downwash."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.keys import SWARM_PLACES, check_count
from hitchopt.steps.step import Stage, Step
from hitchopt.values import Points
from hitchopt.values.fields import Key, documented
from hitchopt.values.units import DURATION


@documented
@dataclass(frozen=True, eq=False)
class Fly(Step):
    """A flight of single drones next to teams with cables."""

    of_single_drones: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = False
    stages: ClassVar[tuple[Stage, Stage] | None] = None

    goal: Annotated[
        Points,
        Key(
            SWARM_PLACES,
            "Goals (N, 3) [m], [x, y, z] per drone",
            [[1, 0, 1], [-1, 0, 1]],
        ),
    ]
    duration: Annotated[
        float | None, Key(DURATION, "Exact duration; default: as fast as possible")
    ] = None

    def resolved_for(self, team: Team) -> Self:
        """Return the step; raise InputError unless there is one goal per drone."""
        check_count("goal", np.asarray(self.goal), team)
        return self

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the flight.

        Raises InfeasibleError with the violated limits, locations and times.
        """
        from hitchopt.swarms.flights import separated_flight

        _check_duration(self.duration, task.requirements.limits)
        return separated_flight(task, np.asarray(self.goal), self.duration, self.name)


def _check_duration(duration: float | None, limits: Limits) -> None:
    """Raise InfeasibleError for a prescribed duration [s] above its limit."""
    limit = limits.duration
    if limit is not None and duration is not None and duration > limit:
        remedy = "lower duration, or raise limits.duration"
        violation = Violation("duration", duration, limit, "max", "s", (), "as requested", remedy)
        raise InfeasibleError([violation])
