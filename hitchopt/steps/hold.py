"""Hold: nothing moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

from hitchopt.steps.edits import Tunable, lasting_for
from hitchopt.steps.free_cables import hovering
from hitchopt.steps.hitch_step import HitchStep
from hitchopt.steps.keys import Key
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage
from hitchopt.units import DURATION, check_unit
from hitchopt.values import positive


@dataclass(frozen=True)
class Hold(HitchStep):
    """Nothing moves.

    Parameters
    ----------
    seconds: how long [s].
    """

    name: ClassVar[str] = "hold"
    summary: ClassVar[str] = "Stay"
    needs_hitch: ClassVar[bool | None] = None
    stages: ClassVar[tuple[Stage, Stage] | None] = None
    seconds: Annotated[float, Key("Positive", "How long [s]", (1.0,))]

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", positive("seconds", self.seconds))
        check_unit("seconds", self.seconds, DURATION)

    @property
    def given_duration(self) -> float:
        """How long it takes [s]."""
        return self.seconds

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan in which a hitch, or drones on free cables, stay."""
        if task.before.holding is not None and task.before.holding.held is not None:
            from hitchopt.steps.carrying import held_plan, resting_move

            return held_plan(task, task.holding, [resting_move(task, self.seconds)], self.name)
        if task.before.hitch is not None:
            return super().plan(task)
        return StepPlan(hovering(task, self.seconds), task.before)

    def fly(self, task: StepTask) -> StepPlan:
        """Return the plan in which a hitch stays."""
        return task.ended(self.motion(task, None, task.hitch), task.hitch)

    def tunables(self) -> Iterator[Tunable]:
        """Yield the seconds."""
        yield lasting_for("seconds", self.seconds)
