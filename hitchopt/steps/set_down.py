"""Set down: a held object goes straight down to what is below it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from hitchopt.errors import InputError
from hitchopt.objects.placing import footing, poses_of, surface_below
from hitchopt.steps.carried_moves import carried_move
from hitchopt.steps.carrying import (
    LIFT_SPEED,
    held_plan,
    lasting_moves,
    moved_to,
    place_of,
    transferred,
)
from hitchopt.steps.keys import OBJECT, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step
from hitchopt.values import Array

INSIDE = 0.02
"""[m] Centres of mass are set down this far within the edges of what is below: so far may an object
be from where it was planned to be."""


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
        """Return the plan straight down.

        Raises
        ------
        InputError: it would stand too close to the edge of what is below it.
        """
        objects, floor = task.requirements.objects, task.requirements.floor
        body = objects[self.object]
        surface, _ = surface_below(objects, poses_of(objects), self.object, floor)
        start = place_of(body)
        to = start.copy()
        to[2] = surface - body.lower
        self._check_footing(task, to)
        unloading = transferred(task, 1.0, 0.0)
        unloading = replace(unloading, start=to, end=to)
        moves = [carried_move(task, start, to, LIFT_SPEED), unloading]
        after = replace(task.holding, borne=False)
        return held_plan(task, after, lasting_moves(moves, self.duration, task), self.name)

    def _check_footing(self, task: StepTask, to: Array) -> None:
        """Raise InputError where an object whose base is at (4,) would stand at an edge."""
        objects = task.requirements.objects
        there = {**objects, self.object: moved_to(objects[self.object], to)}
        inside = footing(there, self.object)
        if inside < INSIDE:
            bound = (
                f"where the centre of mass of objects.{self.object} is {INSIDE:g} m within the "
                f"edges of what it stands on, not {max(inside, 0.0):.3g} m"
            )
            place = [round(float(x), 9) for x in to[:3]]
            remedy = "set it down farther in, or on something wider"
            raise InputError(f"mission[{task.index}]", place, bound, remedy)
