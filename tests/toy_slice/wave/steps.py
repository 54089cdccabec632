"""The step of waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hitchopt.planners.along import transport_plan
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence
from hitchopt.steps.hitch_step import HitchStep
from hitchopt.values.fields import Key, documented
from hitchopt.values.units import LENGTH

__all__ = ["Wave"]


@documented
@dataclass(frozen=True)
class Wave(HitchStep):
    """Rise, and return."""

    height: Annotated[float, Key(LENGTH, "Height to rise", 0.2)]

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan that rises and returns."""
        hitch = task.hitch
        low = np.append(hitch.polygon.centroid, hitch.altitude)
        high = low + [0.0, 0.0, self.height]
        return plan_in_sequence(
            [lambda task: transport_plan(task, high), lambda task: transport_plan(task, low)], task
        )
