"""Forming, releasing and landing: steps that tie and untie hitches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np

from hitchopt.errors import AT_END, InputError
from hitchopt.forming.approach import assign_robots
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.forming.tying import (
    SWAP,
    descent,
    end_of_form,
    flight_over,
    holding_assignment,
    tyings,
    untyings,
)
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import MAX_ROBOTS, Assignment
from hitchopt.planners.candidates import first_certified
from hitchopt.planners.rests import check_at_rest
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence
from hitchopt.steps.keys import (
    AUTO,
    LEGS,
    LEGS_TEXT,
    Legs,
    Polygon,
    Seconds,
    SettleAtEnd,
)
from hitchopt.steps.knob import Edits, Knob, altitude_knobs, checks_relaxed_by, scaled_outline_edit
from hitchopt.steps.step import Step
from hitchopt.values import Array, Points, known
from hitchopt.values.fields import Key, documented, mapping_of, points, words
from hitchopt.values.units import ALTITUDE

__all__ = [  # noqa: RUF022, in the order of the keys of problem files
    "Form",
    "Release",
    "Land",
]

Assign = Literal["auto", "fixed"]
"""``auto`` chooses the assignment of robots to edges; with ``fixed`` robot k takes edge k."""

ASSIGN_TEXT = "auto: choose which robot takes which edge, and which end is its q; fixed: in order"


@documented
@dataclass(frozen=True, eq=False)
class Form(Step):
    """Tie a hitch from hanging cables, then raise the tension to the team's.

    Without ``legs`` they are spread, with a margin to the cables where drones are close to them.
    """

    needs_hitch: ClassVar[bool | None] = False
    effort_per_robot: ClassVar[float] = 1.2e4
    polygon: Polygon
    altitude: Annotated[float, Key(ALTITUDE, "Height of the hitch's plane")] = 1.0
    legs: Annotated[
        Legs | None, Key(LEGS, f"{LEGS_TEXT}, at the step's end; spread without it")
    ] = None
    assign: Annotated[Assign, Key(words("auto", "fixed"), ASSIGN_TEXT)] = AUTO
    swap: Annotated[SwapSettings, Key(mapping_of(SwapSettings), "How drones turn in pairs")] = (
        field(default_factory=SwapSettings)
    )
    settle: SettleAtEnd = AUTO
    duration: Seconds = None

    @property
    def outline(self) -> Outline:
        """The polygon of the resolved step."""
        return known(self.goal_outline)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to tie the hitch.

        Drones fly to where cables hang clear of each other and of the ground, tie the hitch there,
        and lower it to its altitude.
        """
        requirements = task.requirements
        team = task.before.team
        goal = self._goal(team, requirements)
        check_at_rest(goal, requirements, AT_END, self.phase(task).place)
        plan = first_certified(tyings(task, goal, self.swap), task.effort, task.progress)
        after = plan.after.keeping(SWAP, self.swap)
        return plan.replaced(self.with_duration(task, plan.motion), after)

    @property
    def assigns_in_order(self) -> bool:
        """Return whether robot k takes edge k."""
        return self.assign == "fixed"

    def assignment(self, team: Team, drones: Array, requirements: Requirements) -> Assignment:
        """Return the assignment of robots to edges with the shortest flights of drones (2n, 3) [m].

        Among unequal cables it is the first one with which the hitch holds at rest: if short
        flights leave some cables too little slack, or others too much, slack is to be more even.
        """
        if np.ptp(team.cable_length) == 0.0:
            return assign_robots(team, drones, self.outline, requirements.limits.leg)
        goal = partial(self._goal, requirements=requirements)
        return holding_assignment(team, drones, self.outline, requirements, goal)

    def _goal(self, team: Team, requirements: Requirements) -> Hitch:
        """Return the hitch that a team ties."""
        return end_of_form(team, self.outline, self.altitude, self.split, requirements)

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edit that scales its polygon about the centroid, the centre of later steps."""
        centre = self.outline.centroid
        return (scaled_outline_edit("polygon", self.outline, factor, centre),), centre

    def knobs(self) -> Iterator[Knob]:
        """Yield the duration, the altitude, and the swap's radius if it exceeds the default."""
        yield from super().knobs()
        yield from altitude_knobs("altitude", self.altitude)
        if self.swap.radius > SwapSettings.radius:
            covers = checks_relaxed_by("length") | {"interlacing", "arena", "crossing"}
            yield Knob("swap.radius", self.swap.radius, "m", sign=-1, covers=covers)


SPOTS = points((None, 2), "x, y", 4, 2 * MAX_ROBOTS)
SPOTS_TEXT = "Landing spots [x, y] [m] of q0, r0, q1, r1, …"
LANDING_TEXT = "auto: choose which robot takes which pair of spots; fixed: in order"

Spots = Annotated[Points | None, Key(SPOTS, SPOTS_TEXT, [[0, 0], [1, 0], [0, 1], [1, 1]])]
AssignSpots = Annotated[Assign, Key(words("auto", "fixed"), LANDING_TEXT)]


class SpotsStep(Step):
    """A step that may end at landing spots."""

    to: Spots
    assign: AssignSpots

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team; raise InputError for another number of spots."""
        if self.to is None:
            return super().resolved_for(team)
        spots = np.asarray(self.to, dtype=float)
        if len(spots) != team.drones:
            bound = f"{team.drones} spots, one per drone"
            raise InputError("to", self.to, bound, "list q0, r0, q1, r1, …")
        return replace(super().resolved_for(team), to=spots)  # type: ignore[call-arg]

    @property
    def flights(self) -> list[Callable[[StepTask], StepPlan]]:
        """Planner of the flight over the spots; empty without spots."""
        if self.to is None:
            return []
        in_order = self.assign == "fixed"
        return [partial(flight_over, spots=np.asarray(self.to), in_order=in_order)]


@documented
@dataclass(frozen=True, eq=False)
class Release(SpotsStep):
    """Untie the hitch in the reverse order of tying, until its cables hang free.

    With ``to`` drones then fly to hover over these spots.
    """

    effort_per_robot: ClassVar[float] = 1.2e4
    duration: Seconds = None
    to: Spots = None
    assign: AssignSpots = AUTO

    def polygon_after(self, team: Team, outline: Any) -> None:
        """Return None, since the cables are free."""

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to untie a hitch, in the reverse order of tying it."""
        untied = first_certified(untyings(task), task.effort, task.progress)
        flights = self.flights
        plan = plan_in_sequence([lambda _: untied, *flights], task) if flights else untied
        return plan.replaced(self.with_duration(task, plan.motion), plan.after)


def untied(task: StepTask) -> StepPlan:
    """Return the plan that unties the hitch, as ``release``."""
    return Release().plan(task)


@documented
@dataclass(frozen=True, eq=False)
class Land(SpotsStep):
    """Descend straight to the ground, with ``to`` at these spots."""

    needs_hitch: ClassVar[bool | None] = False
    duration: Seconds = None
    to: Spots = None
    assign: AssignSpots = AUTO

    def plan(self, task: StepTask) -> StepPlan:
        """Plan the descent to the ground, after a flight to the spots if there are any."""
        plan = plan_in_sequence([*self.flights, descent], task)
        return plan.replaced(self.with_duration(task, plan.motion), plan.after)
