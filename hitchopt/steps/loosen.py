"""Loosen: the hitch leaves an object's rim, or its grip, and opens around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

from hitchopt.motion.motion import joined_motions
from hitchopt.motion.phases import Hold, HoldBy
from hitchopt.planners.carrying.gripped_hitch import GrippedHitch
from hitchopt.planners.carrying.moves import held_flight
from hitchopt.steps.carrying import (
    ended_holding,
    gap_below,
    held_motion,
    object_of,
    one_phase,
    place_of,
    polygon_at,
    rim_move,
    rolling_morph,
    tension_moves,
)
from hitchopt.steps.enclose import slowly
from hitchopt.steps.grasp import without
from hitchopt.steps.gripping import grip_opened
from hitchopt.steps.keys import OBJECT, Seconds
from hitchopt.steps.morph import Morph
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Stage, Step


@dataclass(frozen=True)
class Loosen(Step):
    """The hitch opens around the object, having sunk below its rim, and pulls as the team does.

    Parameters
    ----------
    object: its name.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "loosen"
    summary: ClassVar[str] = "Open around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.GRASPED, Stage.AROUND)
    object: Annotated[str, OBJECT]
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from clasps below the rim to a hitch around the object."""
        body, team, holding = object_of(task, self.object), task.before.team, task.holding
        held = holding.held
        if isinstance(held, GrippedHitch):
            return grip_opened(task, self.object, self.duration, self.name)
        assert held is not None
        gap = gap_below(task.requirements)
        lower = tension_moves(task, holding.tension, team.tension, gap)
        moves = [rim_move(task, 0.0, gap), *lower]
        sinking = held_motion(task, [held_flight(held, move) for move in moves], self.name)
        freed = replace(holding, tension=team.tension)
        low = ended_holding(task, freed, sinking, place_of(body), gap).after
        around = polygon_at(body, holding.polygons.around)
        slow = slowly(without(task, self.object))
        opening = rolling_morph(self, Morph(around), task.within(slow, low))
        hold = Hold(self.object, HoldBy.REST, tuple(range(team.robots)))
        opened = one_phase(opening.motion, task, self.name, hold)
        motion = one_phase(joined_motions([sinking, opened]), task, self.name, hold)
        motion = self.lasting(task, motion)
        after = replace(opening.after, holding=replace(freed, held=None))
        return StepPlan(motion, after)
