"""Land: drones on free cables go straight down to the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from hitchopt.motion.phases import CableState
from hitchopt.planners.forming.straight import straight
from hitchopt.planners.forming.tying_stages import Stage
from hitchopt.steps.free_cables import free_motion
from hitchopt.steps.keys import Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Step


@dataclass(frozen=True)
class Land(Step):
    """All drones go straight down to the ground.

    Parameters
    ----------
    duration: as of Form.
    """

    name: ClassVar[str] = "land"
    summary: ClassVar[str] = "Land all drones"
    needs_hitch: ClassVar[bool | None] = False
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down."""
        before, requirements = task.before, task.requirements
        down = before.drones.copy()
        down[:, 2] = requirements.floor
        flight = straight(before.team, requirements.limits, before.drones, down)
        motion = free_motion(Stage("land", flight, CableState.GROUND), task)
        after = replace(before, drones=down)
        return StepPlan(self.lasting(task, motion), after)
