"""Lift: clasps take an object's weight, and it goes straight up."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.steps.carried_moves import carried_move
from hitchopt.steps.carrying import (
    LIFT_SPEED,
    held_plan,
    lasting_moves,
    place_of,
    transferred,
)
from hitchopt.steps.keys import Key, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step
from hitchopt.values import positive


@dataclass(frozen=True)
class Lift(Step):
    """The object's weight passes to the clasps, and it is lifted.

    Parameters
    ----------
    by: how far [m].
    duration: as of Enclose.
    """

    name: ClassVar[str] = "lift"
    summary: ClassVar[str] = "Lift what is held"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.LIFTED)
    by: Annotated[float, Key("Positive", "How far up [m]", (0.5,))]
    duration: Seconds = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "by", positive("by", self.by))
        super().__post_init__()

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight up."""
        start = place_of(task.requirements.objects[task.holding.name])
        to = start + np.array([0.0, 0.0, self.by, 0.0])
        moves = [transferred(task, 0.0, 1.0), carried_move(task, start, to, LIFT_SPEED)]
        after = replace(task.holding, borne=True)
        return held_plan(task, after, lasting_moves(moves, self.duration, task), self.name)
