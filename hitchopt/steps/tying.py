"""Forming, releasing and landing: steps that tie and untie hitches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import AT_END, InputError, RequestError
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import MAX_ROBOTS, Assignment
from hitchopt.planners.candidates import first_certified
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.approach import assign_robots
from hitchopt.planners.forming.laying import levels_of
from hitchopt.planners.rests import check_at_rest
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence
from hitchopt.planners.tying import (
    descent,
    end_of_form,
    flight_over,
    holding_assignment,
    rolled_plan,
    tyings,
    untyings,
)
from hitchopt.steps.keys import (
    AUTO,
    INDEX,
    LEGS,
    LEGS_TEXT,
    Legs,
    Polygon,
    Seconds,
    SettleAtEnd,
    WhichPoint,
)
from hitchopt.steps.knob import Edits, Knob, altitude_knobs, checks_relaxed_by, scaled_outline_edit
from hitchopt.steps.step import Stage, Step
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.values import Array, Indices, Points, known
from hitchopt.values.fields import Key, documented, either, list_of, mapping_of, points, words
from hitchopt.values.units import ALTITUDE

__all__ = [  # noqa: RUF022, in the order of the keys of problem files
    "Form",
    "OpenVertex",
    "CloseVertex",
    "Release",
    "Land",
]

Assign = Literal["auto", "fixed"]
"""``auto`` chooses the assignment of robots to edges; with ``fixed`` robot k takes edge k."""

ASSIGN_TEXT = "auto: choose which robot takes which edge, and which end is its q; fixed: in order"
BY_TEXT = (
    "swaps: pairs of drones swap positions; laying: taut cables are laid on one another, and "
    "every pair rolls by half a turn"
)
ORDER_TEXT = "Order of laying, robots from bottom to top; auto: alternating levels"


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
    by: Annotated[Literal["swaps", "laying"], Key(words("swaps", "laying"), BY_TEXT)] = "swaps"
    order: Annotated[
        ArrayLike | Literal["auto"],
        Key(either(words("auto"), list_of(INDEX, 3, MAX_ROBOTS)), ORDER_TEXT),
    ] = AUTO
    duration: Seconds = None

    @property
    def outline(self) -> Outline:
        """The polygon of the resolved step."""
        return known(self.goal_outline)

    @property
    def rolls_pairs(self) -> bool:
        """Return whether pairs of drones roll: when cables are laid."""
        return self.by == "laying"

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team; raise InputError if the order is not one of its robots."""
        if self.stated_order is not None:
            order = self.stated_order.tolist()
            if self.by != "laying" or sorted(order) != [*range(team.robots)]:
                members = ", ".join(map(str, range(team.robots)))
                bound = f"with by: laying, each of the robots {members} once"
                raise InputError("order", order, bound, "omit it, or list all robots")
        return super().resolved_for(team)

    @property
    def stated_order(self) -> Indices | None:
        """The order of laying, robots from bottom to top; None for alternating levels."""
        return None if isinstance(self.order, str) else np.asarray(self.order, dtype=np.intp)

    def plan(self, task: StepTask) -> StepPlan:
        """Plan how to tie the hitch.

        Drones fly to where cables hang clear of each other and of the ground, tie the hitch there,
        and lower it to its altitude.
        """
        requirements = task.requirements
        team = task.before.team
        levels = self._levels(team)
        goal = self._goal(team, levels, requirements)
        check_at_rest(goal, requirements, AT_END, self.phase(task).place)
        plan = first_certified(tyings(task, goal, self.swap, levels), task.effort, task.progress)
        after = replace(plan.after, swap=self.swap, levels=levels)
        return plan.replaced(self.with_duration(task, plan.motion), after)

    def _levels(self, team: Team) -> Indices | None:
        """Return the levels (n,) of cables that are laid; None if swaps tie them."""
        if self.by != "laying":
            return None
        order = self.stated_order
        return levels_of(team.layout, None if order is None else team.edges[order])

    def assignment(self, team: Team, drones: Array, requirements: Requirements) -> Assignment:
        """Return the assignment of robots to edges with the shortest flights of drones (2n, 3) [m].

        Among unequal cables it is the first one with which the hitch holds at rest: if short
        flights leave some cables too little slack, or others too much, slack is to be more even.
        """
        if self.by == "laying" or np.ptp(team.cable_length) == 0.0:
            return assign_robots(team, drones, self.outline, requirements.limits.leg)
        goal = partial(self._goal, levels=None, requirements=requirements)
        return holding_assignment(team, drones, self.outline, requirements, goal)

    def _goal(self, team: Team, levels: Indices | None, requirements: Requirements) -> Hitch:
        """Return the hitch that a team ties, by laying cables on levels (n,) if there are any."""
        return end_of_form(team, self.outline, self.altitude, self.split, levels, requirements)

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


def check_rollable(step: str, team: Team) -> None:
    """Raise UnsupportedError for teams whose pairs cannot roll, or whose cables cannot be laid.

    ``step`` names the step that lays or rolls them.
    """
    present = {
        Neighbour.CHAINS: not team.layout.closed,
        Neighbour.WEIGHTLESS: team.cable_density == 0.0,
        Neighbour.LOADS: np.any(team.load),
    }
    for neighbour, is_present in present.items():
        if is_present:
            raise unsupported(Feature.LAYING, neighbour, step)


class RollStep(Step):
    """A step that rolls the pair of one vertex by half a turn; no vertex moves."""

    vertex: int
    duration: float | None

    @property
    def rolls_pairs(self) -> bool:
        """Return whether pairs of drones roll: always."""
        return True

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team, or raise InputError for a missing vertex."""
        if not self.vertex < team.robots:
            bound = f"0 to {team.robots - 1}"
            raise InputError("vertex", self.vertex, bound, "name a vertex of the polygon")
        return super().resolved_for(team)

    def rolled(self, task: StepTask, end: Array) -> StepPlan:
        """Return the plan that rolls pairs to the angles ``end`` (clasps,) [rad]."""
        plan = rolled_plan(task, end, self.phase(task))
        return plan.replaced(self.with_duration(task, plan.motion), plan.after)


@documented
@dataclass(frozen=True)
class OpenVertex(RollStep):
    """Roll a vertex's pair until both cables run straight and lie on each other.

    The rest is a chain on the same lines, with all other vertices intact.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.OPEN)
    vertex: WhichPoint
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan that rolls the vertex's pair back by half a turn."""
        end = task.hitch.roll.copy()
        end[self.vertex] = -np.pi * task.before.assumed_senses[self.vertex]
        return self.rolled(task, end)


@documented
@dataclass(frozen=True)
class CloseVertex(RollStep):
    """Roll the pair of an open vertex back into its clasp."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.OPEN, Stage.FREE)
    vertex: WhichPoint
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan that rolls the pair to where the hitch has it."""
        open_roll = task.before.open_roll
        rolled = np.flatnonzero(task.hitch.roll - (0.0 if open_roll is None else open_roll))
        if self.vertex not in rolled:
            bound = f"the open one, {', '.join(map(str, rolled.tolist()))}"
            raise RequestError("vertex", self.vertex, bound, "close the vertex that was opened")
        return self.rolled(task, task.hitch.roll)


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
