"""Grasp: the hitch closes below an object's rim and touches it, or around it and grips it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.motion.motion import joined_motions
from hitchopt.motion.phases import Hold, HoldBy
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.planners.carrying.moves import held_flight
from hitchopt.requirements import Requirements
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
from hitchopt.steps.gripping import grip_closed
from hitchopt.steps.keys import OBJECT, Key, Seconds
from hitchopt.steps.morph import Morph
from hitchopt.steps.resting_hold import SPARE, advised, check_hold, farther_legs, spaced
from hitchopt.steps.situation import Holding, StepPlan, StepTask
from hitchopt.steps.slack_split import RolledLegs
from hitchopt.steps.step import Stage, Step
from hitchopt.values import Array, choice, positive

By = Literal["rest", "grip"]
"""How an object is held."""


@dataclass(frozen=True)
class Grasp(Step):
    """The hitch closes below the object's rim and rises to it, or closes around it and grips it.

    Parameters
    ----------
    object: its name.
    by: ``rest``: its rim lies on the clasps; ``grip``: cables are wrapped around it.
    tension: of all cables from here on [N]; None for the team's.
    duration: as of Enclose.
    """

    name: ClassVar[str] = "grasp"
    summary: ClassVar[str] = "Close around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.AROUND, Stage.GRASPED)
    object: Annotated[str, OBJECT]
    by: Annotated[
        By, Key(("rest", "grip"), "rest: its rim lies on the clasps; grip: cables around it")
    ] = "rest"
    tension: Annotated[
        float | None, Key("Positive", "Of all cables from here on [N]; without it the team's")
    ] = None
    duration: Seconds = None

    def __post_init__(self) -> None:
        choice("by", self.by, get_args(By))
        if self.tension is not None:
            object.__setattr__(self, "tension", positive("tension", self.tension))
        super().__post_init__()

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from around the object to clasps below its rim, or edges that grip."""
        if self.by == "grip":
            return grip_closed(task, self.object, self.tension, self.duration, self.name)
        body, team, requirements = object_of(task, self.object), task.before.team, task.requirements
        if body.rim is None:
            key, bound = f"objects.{self.object}.rim", "given where it is held by rest"
            raise InputError(key, None, bound, "give it a rim, or grasp it by: grip")
        asked = team.tension if self.tension is None else np.full(team.robots, self.tension)
        closing, here = self._closing(task, body, asked)
        held = here.holding.held
        assert isinstance(held, HeldHitch)
        gap = gap_below(requirements)
        moves = [*tension_moves(here, team.tension, asked, gap), rim_move(here, gap, 0.0)]
        touching = held_motion(here, [held_flight(held, move) for move in moves], self.name)
        hold = Hold(self.object, HoldBy.REST, tuple(range(team.robots)))
        closed = one_phase(closing.motion, task, self.name, hold)
        motion = one_phase(joined_motions([closed, touching]), task, self.name, hold)
        motion = self.lasting(task, motion)
        return ended_holding(task, here.holding, motion, place_of(body))

    def _closing(
        self, task: StepTask, body: SolidObject, asked: Array
    ) -> tuple[StepPlan, StepTask]:
        """Return the plan of closing below the rim, and the task of holding the object after it.

        Legs end as near to the current fractions as limits allow, rolled as little; where the
        hitch with its load hardly keeps a distance then, they are rolled more, or moved on. Where
        it cannot hold the object so, they end balanced; or either way with as little room as is.

        Parameters
        ----------
        body: to be held.
        asked: (n,) [N], tensions with which it is held.
        """
        balanced = RolledLegs("balanced")
        told: InfeasibleError | None = None
        for legs, roomy in ((None, True), (balanced, True), (None, False), (balanced, False)):
            try:
                return self._closed(task, body, asked, legs, roomy=roomy)
            except InfeasibleError as error:
                if legs is None:
                    told = error  # what binds with legs as they are
        assert told is not None
        raise advised(told)

    def _closed(
        self,
        task: StepTask,
        body: SolidObject,
        asked: Array,
        legs: RolledLegs | None = None,
        *,
        roomy: bool = False,
    ) -> tuple[StepPlan, StepTask]:
        """Return what ``_closing`` does, with these legs at the end, or those nearest to now.

        Parameters
        ----------
        roomy: whether legs that hardly keep a distance are rolled more, or moved on.
        """
        team, polygons = task.before.team, task.holding.polygons
        below = polygon_at(body, polygons.closed)
        free = task.within(slowly(without(task, self.object)), task.before)
        closing = rolling_morph(self, Morph(below, legs), free)
        hitch = closing.after.hitch
        assert body.rim is not None
        assert hitch is not None
        places = np.column_stack([polygons.closed, np.full(team.robots, body.rim.height)])
        held = HeldHitch(team, body, places, hitch.fractions, hitch.roll)
        holding = Holding(self.object, polygons, asked, held)
        here = replace(task, before=replace(closing.after, holding=holding))
        if roomy:
            try:
                check_hold(here.within(spaced(task.requirements, SPARE), here.before), taken=False)
            except InfeasibleError:
                more = farther_legs(task.hitch, hitch, task.requirements)
                return self._closed(task, body, asked, more)
        check_hold(here, taken=True)
        return closing, here


def without(task: StepTask, name: str) -> Requirements:
    """Return the requirements without an object that cables may touch."""
    others = {key: each for key, each in task.requirements.objects.items() if key != name}
    return replace(task.requirements, objects=others)
