"""Leave: the hitch goes up and away from an object that it is around."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.steps.carrying import one_phase
from hitchopt.steps.enclose import altitude_over, slowly
from hitchopt.steps.keys import OBJECT, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step
from hitchopt.steps.transport import Transport


@dataclass(frozen=True)
class Leave(Step):
    """The hitch goes straight up until it is above all objects.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "leave"
    summary: ClassVar[str] = "Go up from around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.FREE)
    object: Annotated[str, OBJECT]
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        over = np.append(task.hitch.polygon.centroid, altitude_over(task))
        slow = task.within(slowly(task.requirements), task.before)
        planned = self.part(Transport(over), slow)
        motion = one_phase(planned.motion, task, self.name)
        after = replace(planned.after, holding=None)
        return StepPlan(self.lasting(task, motion), after)
