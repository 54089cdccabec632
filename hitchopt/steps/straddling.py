"""Steps of two robots: tie their cables around an object, and untie them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from hitchopt.checks.arena import CEILING, FLOOR
from hitchopt.errors import RequestError
from hitchopt.hitch import Team
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.hinge import EDGE, clasp_height
from hitchopt.planners.carrying.planner import check_pull, tying_tension
from hitchopt.planners.straddling import tied_around, untied
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.keys import ObjectOf, Seconds
from hitchopt.steps.knob import ALTITUDE_CHECKS, Knob
from hitchopt.steps.step import Stage, Step
from hitchopt.steps.tying import check_rollable
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array
from hitchopt.values.fields import Key, documented
from hitchopt.values.units import LENGTH, TENSION

__all__ = [
    "Tie",
    "Untie",
]


def _check_two(team: Team, remedy: str) -> None:
    """Raise InputError with a remedy unless the team has two robots."""
    if team.robots != 2:
        bound = "2 where cables are tied around an object"
        raise RequestError("robots", team.robots, bound, remedy)
    if not team.layout.closed:
        feature, neighbour = Feature.TWO_CABLES, Neighbour.CHAINS
        raise refused_value(feature, neighbour, team.topology, RequestError)


@documented
@dataclass(frozen=True)
class Tie(Step):
    """Lay two cables past both sides of an object, tie them beyond it, and draw them taut.

    The cables are lowered next to the object and bent around it, and each pair of drones makes a
    full turn. They then grip the object with the team's tension.
    """

    needs_hitch: ClassVar[bool | None] = False
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.GRASPED)
    object_key: ClassVar[str] = "around"
    of_two_robots: ClassVar[bool] = True
    around: ObjectOf
    at: Annotated[
        float | None,
        Key(
            LENGTH,
            "Height of the clasps above its base; null: as high as is safe, but below its rim",
            0.3,
        ),
    ] = None
    tension: Annotated[
        float | None,
        Key(
            TENSION,
            "Tension of all cables while they are tied; null: as low as their weight permits",
            0.3,
        ),
    ] = None
    duration: Seconds = None

    @property
    def object(self) -> str:
        """Name of the object."""
        return self.around

    def resolved_for(self, team: Team) -> Self:
        """Return the step, or raise InputError unless the team has two robots."""
        _check_two(team, "form a hitch, and enclose and grasp the object")
        return super().resolved_for(team)

    def tension_for(self, team: Team) -> Array:
        """Return the tensions (n,) [N] with which cables are tied."""
        return np.full(team.robots, tying_tension(team) if self.tension is None else self.tension)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to tie the cables around the object."""
        return self.plan_to_grip(task, task.before.team.tension, lifts=False)

    def plan_to_grip(self, task: StepTask, tension: Array, *, lifts: bool) -> StepPlan:
        """Plan how cables grip the object with tensions (n,) [N], and whether to lift it then."""
        team = task.before.team
        body = task.requirements.objects[self.around]
        check_rollable(f"step {task.index} ({self.name})", team)
        self._check_friction(body)
        height = self._checked_height(task, body)
        check_pull(float(np.max(tension)), team, task.requirements)
        plan = tied_around(task, self.around, height, self.tension_for(team), tension, lifts=lifts)
        return plan.replaced(self.with_duration(task, plan.motion), plan.after)

    def _check_friction(self, body: SolidObject) -> None:
        """Raise InputError for an object that cables cannot hold."""
        if body.friction == 0.0:
            key = f"objects.{self.around}.friction"
            raise RequestError(key, 0.0, "above 0 if it is held", "cables hold it by friction")

    def _checked_height(self, task: StepTask, body: SolidObject) -> float:
        """Return the height of the clasps above the base [m]; raise InputError if it is off it."""
        height = clasp_height(body, task.requirements) if self.at is None else self.at
        lowest = body.lower + EDGE
        highest = body.upper - EDGE
        if not lowest <= height <= highest:
            key = f"mission[{task.index}].{self.name}.at"
            bound = f"from {lowest:g} to {highest:g} m, on objects.{self.around}"
            raise RequestError(key, height, bound, "tie it there")
        return height

    def advice(self, check: str, key: str) -> str:
        """Return the advice for keeping below a ceiling, or above the floor."""
        if check == CEILING:
            return f"tie it lower ({key}.at), or use shorter cables"
        return f"tie it higher ({key}.at)" if check == FLOOR else ""

    def knobs(self) -> Iterator[Knob]:
        """Yield the height, and the knobs of all steps."""
        yield from super().knobs()
        if self.at is not None:
            knob = Knob("at", self.at, "m", covers=ALTITUDE_CHECKS | {"hinge"})
            yield knob
            yield replace(knob, sign=-1, covers=ALTITUDE_CHECKS)


@documented
@dataclass(frozen=True)
class Untie(Step):
    """Untie the cables in the reverse order of tying, until they hang next to the object."""

    needs_hitch: ClassVar[bool | None] = None
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.FREE)
    of_two_robots: ClassVar[bool] = True
    duration: Seconds = None

    def resolved_for(self, team: Team) -> Self:
        """Return the step, or raise InputError unless the team has two robots."""
        _check_two(team, "loosen and leave the object, and release the hitch")
        return super().resolved_for(team)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to untie the cables until they hang."""
        plan = untied(task)
        return plan.replaced(self.with_duration(task, plan.motion), plan.after)
