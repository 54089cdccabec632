"""Forming, releasing and landing: steps that tie and untie hitches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np

from hitchopt.errors import HitchoptError, InputError, UnsupportedError
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.motion.motion import CableState, Motion, Phase, concatenated
from hitchopt.planners.forming import SwapSettings
from hitchopt.steps.certified_motions import (
    attempt,
    check_at_rest,
    combined_failure,
    require_certified,
    rest_plan,
    split_hitch,
)
from hitchopt.steps.step import (
    AUTO,
    INDEX,
    LEGS,
    LEGS_TEXT,
    Edits,
    Knob,
    Polygon,
    RolledLegs,
    Seconds,
    SettleAtEnd,
    SlackSplit,
    Stage,
    Step,
    StepPlan,
    StepTask,
    WhichPoint,
    altitude_knobs,
    checks_relaxed_by,
    scaled_outline_edit,
)
from hitchopt.values import Array, Indices
from hitchopt.values.fields import Key, documented, either, list_of, mapping_of, with_fields, words
from hitchopt.values.units import ALTITUDE

if TYPE_CHECKING:
    from hitchopt.planners.forming.laying import Laying
    from hitchopt.planners.forming.prehitch import PreHitch

Assign = Literal["auto", "fixed"]
"""``auto`` chooses the assignment of robots to edges; with ``fixed`` robot k takes edge k."""

CABLE_MARGINS = (1.5, 1.25)
"""Preferred clearances of drones from cables during tightening, in ``separation.cable``."""


ASSIGN_TEXT = (
    "auto: which robot takes which edge, and which end is its q, is chosen; fixed: in order"
)
BY_TEXT = (
    "swaps: pairs of drones exchange places; laying: taut cables are laid on one another, and "
    "every pair rolls by half a turn"
)
ORDER_TEXT = "Order of laying, robots from bottom to top; auto: alternating levels"


@documented
@dataclass(frozen=True, eq=False)
class Form(Step):
    """Tie a hitch from drones with hanging cables, which the team's tension then pulls.

    Without ``legs`` they are spread, with a margin to the cables where drones stand close to them.
    """

    needs_hitch: ClassVar[bool | None] = False
    polygon: Polygon
    altitude: Annotated[float, Key(ALTITUDE, "Height of the hitch's plane")] = 1.0
    legs: Annotated[
        SlackSplit | None, Key(LEGS, f"{LEGS_TEXT}, at the step's end; spread without it")
    ] = None
    assign: Annotated[Assign, Key(words("auto", "fixed"), ASSIGN_TEXT)] = AUTO
    swap: Annotated[SwapSettings, Key(mapping_of(SwapSettings), "How drones turn in pairs")] = (
        field(default_factory=SwapSettings)
    )
    settle: SettleAtEnd = AUTO
    by: Annotated[Literal["swaps", "laying"], Key(words("swaps", "laying"), BY_TEXT)] = "swaps"
    order: Annotated[
        Array | Literal["auto"],
        Key(either(words("auto"), list_of(INDEX, 3, MAX_ROBOTS)), ORDER_TEXT),
    ] = AUTO
    duration: Seconds = None

    @property
    def rolls_pairs(self) -> bool:
        """Whether pairs of drones roll: when cables are laid."""
        return self.by == "laying"

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team; raise InputError if the order is not one of its robots."""
        if not isinstance(self.order, str):
            order = np.asarray(self.order).tolist()
            if self.by != "laying" or sorted(order) != [*range(team.robots)]:
                members = ", ".join(map(str, range(team.robots)))
                bound = f"with by: laying, each of the robots {members} once"
                raise InputError("order", order, bound, "leave it out, or list all robots")
        return super().resolved_for(team)

    def shown_at_end(self, team: Team, requirements: Requirements) -> dict[str, Any]:
        """Return the altitude and the legs of the hitch."""
        return super().shown_at_end(team, requirements) | {"altitude": self.altitude}

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from free cables to a hitch.

        Drones fly to where cables hang clear of each other and of the ground, tie the hitch there,
        and lower it to its altitude.
        """
        from hitchopt.planners.forming.laying import find_laying, levels_of

        before, requirements, i = task.before, task.requirements, task.index
        team, levels = before.team, None
        if self.by == "laying":
            order = None if isinstance(self.order, str) else np.asarray(self.order, dtype=np.intp)
            levels = levels_of(team.layout, None if order is None else team.edges[order])
        goal = self._goal(team, levels, requirements)
        check_at_rest(goal, requirements, f"at the end of step {i} (form)")
        tying: Laying | PreHitch
        if levels is None:
            goal, tying = self._prehitch(goal, requirements)
        else:
            tying = find_laying(goal, levels, requirements).clear_of_ground(requirements)
        tied = concatenated(tying.stages(requirements, i))
        if tying.doubtful:  # no approach helps if tying is infeasible
            require_certified(StepPlan(tied, before))
        parts = [approach_motion(task, tying.drones_hanging), tied]
        if tying.hitch is not goal:
            lower = Phase("lower", i, 0.0, 0.0, HEIGHT_REMARK)
            parts.append(vertical_motion(tying.hitch, goal.altitude, requirements, lower))
        after = replace(before, hitch=goal, drones=goal.drones, senses=tying.senses)
        after = replace(after, swap=self.swap, levels=levels)
        return StepPlan(self.with_duration(task, concatenated(parts)), after)

    def _goal(self, team: Team, levels: Indices | None, requirements: Requirements) -> Hitch:
        """Return the hitch.

        Without ``legs`` drones are apart as pairs roll, if cables are laid; else legs are spread,
        with the largest feasible cable margin.
        """
        from hitchopt.planners.forming.laying import senses_of, split_for_rolling

        if self.legs is not None:
            return split_hitch(team, self.polygon, self.altitude, self.legs, requirements)
        if levels is not None:
            halves = Hitch.balanced(team, self.polygon, self.altitude)
            return split_for_rolling(halves, senses_of(team.layout, levels), requirements)
        spread = split_hitch(team, self.polygon, self.altitude, "spread", requirements)
        cable = requirements.separation.cable
        clearance = rest_plan(spread, requirements).certificate["cable_clearance"].worst
        for margin in CABLE_MARGINS:
            if clearance >= margin * cable:
                break
            separation = with_fields(requirements.separation, cable=margin * cable)
            wider = replace(requirements, separation=separation)
            same_roll = RolledLegs("spread", spread.roll)
            hitch = split_hitch(team, self.polygon, self.altitude, same_roll, wider)
            if rest_plan(hitch, wider).certificate.certified:
                return hitch
        return spread

    def _prehitch(self, goal: Hitch, requirements: Requirements) -> tuple[Hitch, PreHitch]:
        """Return the goal and its pre-hitch; without ``legs``, with short ones if need be.

        Where both legs of a cable cross, the drones of long legs would collide on their way out.
        """
        from hitchopt.planners.forming.prehitch import find_prehitch

        prehitch = find_prehitch(goal, requirements, self.swap).clear_of_ground(requirements)
        if not prehitch.doubtful or self.legs is not None:
            return goal, prehitch
        options = {name: getattr(requirements, name) for name in ("limits", "separation", "arena")}
        fractions = np.zeros(goal.team.robots)
        short = Hitch.nearest(goal.team, self.polygon, self.altitude, fractions, **options)
        if rest_plan(short, requirements).certificate.certified:
            nearer = find_prehitch(short, requirements, self.swap).clear_of_ground(requirements)
            if not nearer.doubtful:
                return short, nearer
        return goal, prehitch

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edit that scales its polygon about the centroid, the centre of later steps."""
        centre = self.polygon.centroid
        return (scaled_outline_edit("polygon", self.polygon, factor, centre),), centre

    def knobs(self) -> Iterator[Knob]:
        """Yield the duration, the altitude, and the swap's radius if it exceeds the default."""
        yield from super().knobs()
        yield from altitude_knobs("altitude", self.altitude)
        if self.swap.radius > SwapSettings.radius:
            covers = checks_relaxed_by("length") | {"interlacing", "arena", "crossing"}
            yield Knob("swap.radius", self.swap.radius, "m", sign=-1, covers=covers)


def approach_motion(task: StepTask, goal: Array) -> Motion:
    """Return the motion of free cables along the first feasible route, or raise one error."""
    from hitchopt.planners.forming.approach import DirectApproach, GatheredApproach, OverApproach

    before = task.before
    arguments = before.team, before.drones, goal, task.requirements, task.index
    errors, kinds = list[HitchoptError](), [DirectApproach, GatheredApproach]
    if task.requirements.objects:
        kinds.append(OverApproach)
    for route in (kind(*arguments) for kind in kinds):
        outcome = attempt(
            lambda route=route: require_certified(StepPlan(concatenated(route.solve()), before))  # type: ignore[misc]
        )
        if isinstance(outcome, StepPlan):
            return outcome.motion
        errors.append(outcome)
    raise combined_failure(errors[0], errors[1], "no other route to the pre-hitch was found")


def check_rollable(step: str, team: Team, requirements: Requirements) -> None:
    """Raise UnsupportedError for teams whose pairs cannot roll, or whose cables cannot be laid.

    ``step`` names the step that lays or rolls them.
    """
    for unsupported, reason in (
        (not team.layout.closed, "an open chain: laying ties rings; use by: swaps"),
        (team.cable_density == 0.0, "cables without weight: give team.cable_density, from which "
         "the pull of a taut cable follows"),
        (np.ptp(team.tension) > 0.0, "unequal tensions: give one team.tension"),
        (np.any(team.load), "loads on clasps, which do not roll: leave out team.load"),
        (requirements.limits.tube.level, "limits.tracking, which taut cables alone do not allow: "
         "set limits.tracking: 0 (left out, it follows from the controller), and a larger "
         "separation.radius for the drones' errors"),
    ):  # fmt: skip
        if unsupported:
            raise UnsupportedError(f"{step}: laying and rolling do not know {reason}")


HEIGHT_REMARK = "hanging cables need more height over the ground than the hitch"
"""Remark on motions of a hitch to and from the altitude at which it is tied."""


def vertical_motion(
    hitch: Hitch, altitude: float, requirements: Requirements, phase: Phase
) -> Motion:
    """Return the motion of a hitch straight up or down, in a phase whose end it sets."""
    from hitchopt.planners.morph.path import RigidPath
    from hitchopt.planners.timing.flight import fly

    path = RigidPath(hitch, np.append(hitch.polygon.centroid, altitude), 0.0)
    motion = fly(path, requirements)
    return motion.replaced(phases=(replace(phase, end=motion.duration),))


def adjusting_motions(task: StepTask, q_legs: Array) -> list[Motion]:
    """Return the motion in which cables slide to q-legs; no motion if they have them."""
    from hitchopt.steps.moving import Adjust

    if np.array_equal(q_legs, task.hitch.q_legs):
        return []
    direct = replace(task, optimiser=False)  # other splits are faster to try than other routes
    return [Adjust(legs=RolledLegs(q_legs, task.hitch.roll)).plan(direct).motion]


class RollStep(Step):
    """A step that rolls the pair of one vertex by half a turn; no vertex moves."""

    vertex: int
    duration: float | None

    @property
    def rolls_pairs(self) -> bool:
        """Whether pairs of drones roll: always."""
        return True

    def rolls(self, task: StepTask) -> Array:
        """Return the roll (clasps,) [rad] after the step."""
        raise NotImplementedError

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team, or raise InputError for a missing vertex."""
        if not self.vertex < team.robots:
            bound = f"0 to {team.robots - 1}"
            raise InputError("vertex", self.vertex, bound, "name a vertex of the polygon")
        return super().resolved_for(team)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the roll."""
        from hitchopt.planners.forming.laying import RollPath, roll_motion

        before, hitch = task.before, task.hitch
        start = hitch.roll if before.open_roll is None else before.open_roll
        end = self.rolls(task)
        phase = Phase(self.name, task.index, 0.0, 0.0)
        motion = roll_motion(RollPath(hitch, start, end), task.requirements, phase)
        open_roll = None if np.array_equal(end, hitch.roll) else end
        drones = motion.drones.coefficients[-1, ..., -1]
        after = replace(before, drones=drones, open_roll=open_roll)
        return StepPlan(self.with_duration(task, motion), after)


@documented
@dataclass(frozen=True)
class OpenVertex(RollStep):
    """Roll a vertex's pair until both cables run straight through and lie on one another.

    What is left is a chain on the same lines: all other vertices hold.
    """

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.OPEN)
    vertex: WhichPoint
    duration: Seconds = None

    def rolls(self, task: StepTask) -> Array:
        """Return the roll after the step, with the vertex's pair rolled back."""
        senses, end = task.before.senses, task.hitch.roll.copy()
        end[self.vertex] = -np.pi * (1.0 if senses is None else senses[self.vertex])
        return end


@documented
@dataclass(frozen=True)
class CloseVertex(RollStep):
    """Roll the pair of an open vertex back into its clasp."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.OPEN, Stage.FREE)
    vertex: WhichPoint
    duration: Seconds = None

    def rolls(self, task: StepTask) -> Array:
        """Return the roll of the closed hitch."""
        open_roll = task.before.open_roll
        rolled = np.flatnonzero(task.hitch.roll - (0.0 if open_roll is None else open_roll))
        if self.vertex not in rolled:
            bound = f"the open one, {', '.join(map(str, rolled.tolist()))}"
            raise InputError("vertex", self.vertex, bound, "close the vertex that was opened")
        return task.hitch.roll


@documented
@dataclass(frozen=True)
class Release(Step):
    """Untie the hitch in the reverse order of tying, until its cables hang free."""

    duration: Seconds = None

    def polygon_after(self, team: Team, outline: Any) -> None:
        """Return None: cables are free."""

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from a hitch to free cables: its tying in reverse."""
        from hitchopt.planners.forming.laying import find_laying, split_for_rolling
        from hitchopt.planners.forming.prehitch import find_prehitch
        from hitchopt.planners.forming.stages import reversed_stages

        before, requirements, i = task.before, task.requirements, task.index
        hitch, senses = task.hitch, before.assumed_senses
        tying: PreHitch | Laying
        if before.levels is None:
            tying = find_prehitch(hitch, requirements, before.swap).with_senses(senses)
        else:
            hitch = split_for_rolling(hitch, senses, requirements)
            tying = find_laying(hitch, before.levels, requirements)
        tying = tying.clear_of_ground(requirements)
        parts = adjusting_motions(task, hitch.q_legs)
        if tying.hitch is not hitch:
            higher = Phase("raise", i, 0.0, 0.0, HEIGHT_REMARK)
            parts.append(vertical_motion(hitch, tying.hitch.altitude, requirements, higher))
        parts += reversed_stages(tying.stages(requirements, i))
        after = replace(before, drones=tying.drones_hanging, hitch=None, senses=None, levels=None)
        return StepPlan(self.with_duration(task, concatenated(parts)), after)


@documented
@dataclass(frozen=True)
class Land(Step):
    """Descend straight to the ground."""

    of_two_robots: ClassVar[bool] = True
    needs_hitch: ClassVar[bool | None] = False
    duration: Seconds = None

    def shown_at_end(self, team: Team, requirements: Requirements) -> dict[str, Any]:
        """Return the heights of drones on the ground."""
        return {"heights": np.full(team.drones, requirements.floor)}

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan straight down."""
        from hitchopt.planners.forming.stages import stage, straight_lines

        before, requirements = task.before, task.requirements
        flat = np.array([1.0, 1.0, 0.0])
        floor = requirements.floor * np.array([0.0, 0.0, 1.0])
        down = before.drones * flat + floor
        flight = straight_lines(before.team, requirements.limits, before.drones, down)
        motion = stage("land", flight, before.team, requirements, task.index, CableState.GROUND)
        after = replace(before, drones=down)
        return StepPlan(self.with_duration(task, motion), after)
