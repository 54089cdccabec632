"""Grasp: the hitch closes below an object's rim and touches it, or around it and grips it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import joined_motions
from hitchopt.motion.phases import Hold, HoldBy
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.planners.carrying.moves import held_flight
from hitchopt.requirements import Requirements
from hitchopt.steps.carrying import (
    check_hold,
    ended_holding,
    gap_below,
    held_motion,
    object_of,
    one_phase,
    place_of,
    polygon_at,
    rim_move,
    tension_moves,
)
from hitchopt.steps.enclose import slowly
from hitchopt.steps.end_hitch import end_of_morph
from hitchopt.steps.gripping import grip_closed
from hitchopt.steps.keys import OBJECT, Key, Seconds
from hitchopt.steps.morph import Morph
from hitchopt.steps.situation import Holding, StepPlan, StepTask
from hitchopt.steps.slack_split import RolledLegs
from hitchopt.steps.step import Stage, Step
from hitchopt.values import Array, choice, positive

MORE_ROLL = 1.3
"""Factor of the least roll with which legs without a load keep off each other, where a load brings
them nearer."""

SPARE, SPREAD = 1.01, 1.03
"""Distances of the hitch at rest, over those to be kept: those with which legs stay as they are,
since the way takes some of them, and those to which they are moved otherwise."""

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
        self, task: StepTask, body: SolidObject, asked: Array, legs: RolledLegs | None = None
    ) -> tuple[StepPlan, StepTask]:
        """Return the plan of closing below the rim, and the task of holding the object after it.

        Legs end as near to the current fractions as limits allow, rolled as little; where the
        hitch with its load hardly keeps a distance then, they are rolled more, or moved on.

        Parameters
        ----------
        body: to be held.
        asked: (n,) [N], tensions with which it is held.
        legs: at the end; None for those.
        """
        team, polygons = task.before.team, task.holding.polygons
        below = polygon_at(body, polygons.closed)
        free = task.within(slowly(without(task, self.object)), task.before)
        closing = self.part(Morph(below, legs), free)
        hitch = closing.after.hitch
        assert body.rim is not None
        assert hitch is not None
        places = np.column_stack([polygons.closed, np.full(team.robots, body.rim.height)])
        held = HeldHitch(team, body, places, hitch.fractions, hitch.roll)
        holding = Holding(self.object, polygons, asked, held)
        here = replace(task, before=replace(closing.after, holding=holding))
        if legs is None:
            try:
                check_hold(here.within(_spaced(task.requirements, SPARE), here.before), holding)
            except InfeasibleError:
                try:
                    more = self._farther(task, hitch)
                    return self._closing(task, body, asked, more)
                except InfeasibleError:
                    pass  # what binds without more room is told
        check_hold(here, holding)
        return closing, here

    def _farther(self, task: StepTask, hitch: Hitch) -> RolledLegs:
        """Return legs that keep larger distances: rolled more, if they are rolled, or moved on."""
        if np.any(hitch.roll):
            return RolledLegs(hitch.q_legs, MORE_ROLL * hitch.roll)
        wide = _spaced(task.requirements, SPREAD)
        moved = end_of_morph(task.hitch, hitch.polygon, None, wide).hitch
        return RolledLegs(moved.q_legs, moved.roll)


def _spaced(requirements: Requirements, factor: float) -> Requirements:
    """Return requirements with larger distances between drones and cables."""
    far = {key: factor * value for key, value in vars(requirements.separation).items()}
    return replace(requirements, separation=replace(requirements.separation, **far))


def without(task: StepTask, name: str) -> Requirements:
    """Return the requirements without an object that cables may touch."""
    others = {key: each for key, each in task.requirements.objects.items() if key != name}
    return replace(task.requirements, objects=others)
