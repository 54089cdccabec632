"""Carry: a held object goes elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.steps.keys import OBJECT, YAW, Key, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step, numbers
from hitchopt.values import Array, finite


@dataclass(frozen=True, eq=False)
class Carry(Step):
    """The object goes on a straight line and turns, so gently that it stays on its supports.

    Parameters
    ----------
    object: its name.
    to: (3,) [m], where the origin of its base goes.
    yaw: by how much it turns, counter-clockwise [rad].
    duration: as of Enclose.
    """

    name: ClassVar[str] = "carry"
    summary: ClassVar[str] = "Carry what is held elsewhere"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.LIFTED, Stage.LIFTED)
    object: Annotated[str, OBJECT]
    to: Annotated[Array, Key("Point3", "Where its base goes, [x, y, z] [m]", ([0, 0, 1],))]
    yaw: Annotated[float, YAW] = 0.0
    duration: Seconds = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", numbers("to", self.to, (3,), "a point [x, y, z]"))
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))
        super().__post_init__()

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan along the line."""
        from hitchopt.steps.carried_moves import carried_move
        from hitchopt.steps.carrying import held_plan, lasting_moves, place_of

        start = place_of(task.requirements.objects[self.object])
        to = np.append(self.to, start[3] + self.yaw)
        moves = [carried_move(task, start, to, task.requirements.limits.speed)]
        return held_plan(task, task.holding, lasting_moves(moves, self.duration, task), self.name)
