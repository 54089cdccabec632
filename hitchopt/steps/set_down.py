"""Set down: a held object goes straight down to what is below it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from hitchopt.objects.placing import poses_of, surface_below
from hitchopt.steps.carried_moves import carried_move
from hitchopt.steps.carrying import (
    LIFT_SPEED,
    held_plan,
    lasting_moves,
    place_of,
    transferred,
)
from hitchopt.steps.keys import OBJECT, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step


@dataclass(frozen=True)
class SetDown(Step):
    """The object goes straight down until it stands, and its weight passes to what it stands on.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "set_down"
    summary: ClassVar[str] = "Set down what is held"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.GRASPED)
    object: Annotated[str, OBJECT]
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down."""
        objects, floor = task.requirements.objects, task.requirements.floor
        body = objects[self.object]
        surface, _ = surface_below(objects, poses_of(objects), self.object, floor)
        start = place_of(body)
        to = start.copy()
        to[2] = surface - body.lower
        unloading = transferred(task, 1.0, 0.0)
        unloading = replace(unloading, start=to, end=to)
        moves = [carried_move(task, start, to, LIFT_SPEED), unloading]
        after = replace(task.holding, borne=False)
        return held_plan(task, after, lasting_moves(moves, self.duration, task), self.name)
