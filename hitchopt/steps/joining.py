"""Joining, withdrawing and replacing: hitches that change their robots in flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hitchopt.checks.linking import INTERLACING
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.steps.step import INDEX, RestState, Step, StepPlan, StepTask, WhichPoint
from hitchopt.steps.tying import refuse_rolls
from hitchopt.values import Array
from hitchopt.values.fields import Key
from hitchopt.values.units import LENGTH

if TYPE_CHECKING:
    from hitchopt.planners.forming.joining import Joining

Ring = tuple[int, ...]

WhichRobot = Annotated[int, Key(INDEX, "Which robot, from 0", 3)]


def _waiting(key: str, robot: int, ring: Ring, team: Team) -> None:
    """Raise InputError for a robot that is not one of those who wait."""
    others = [k for k in range(team.robots) if k not in ring]
    if robot not in others:
        bound = f"one that waits: {', '.join(map(str, others))}" if others else "one that waits"
        remedy = "name another, or form the hitch with robots: of fewer"
        raise InputError(key, robot, bound, remedy)


def _place(key: str, robot: int, ring: Ring) -> int:
    """Return a robot's place in the ring; raise InputError where it has none."""
    if robot not in ring:
        bound = f"one of the ring: {', '.join(map(str, ring))}"
        raise InputError(key, robot, bound, "name one that holds an edge")
    return ring.index(robot)


@dataclass(frozen=True)
class Join(Step):
    """A robot that waits joins the hitch in flight, while all others stay tied.

    It cuts a vertex off: its cable is laid on both edges there, and its pairs roll. Its place in
    the ring is that of the vertex, which becomes two.
    """

    robot: WhichRobot
    vertex: WhichPoint
    cut: Annotated[float, Key(LENGTH, "From the vertex to both new ones, along its edges", 0.5)]

    def ring_after(self, ring: Ring, team: Team) -> Ring:
        """Return the ring with the robot."""
        _waiting("robot", self.robot, ring, team)
        if not 0 <= self.vertex < len(ring):
            bound = f"0 to {len(ring) - 1}"
            raise InputError("vertex", self.vertex, bound, "name a vertex of the polygon")
        return (*ring[: self.vertex], self.robot, *ring[self.vertex :])

    def polygon_after(self, team: Team, outline: Any) -> Outline:  # noqa: ARG002
        """Return the outline with the vertex cut off."""
        from hitchopt.planners.forming.joining import corner_cut

        return corner_cut(outline, self.vertex, self.cut)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the robot's way, and of its tying."""
        from hitchopt.planners.forming.joining import Joins, joining
        from hitchopt.steps.certified_motions import check_at_rest

        before, hitch, requirements = task.before, task.hitch, task.requirements
        refuse_rolls(before.whole_team, requirements)
        ring = self.ring_after(before.team.labels, before.whole_team)
        outline, team = self.polygon_after(before.team, hitch.polygon), before.part(ring)
        joined = joining(hitch, team, self.vertex, outline, before.known_senses, requirements)  # type: ignore[arg-type]
        check_at_rest(joined.after, requirements, f"at the end of step {task.index} (join)")
        waiting = dict(before.waiting)
        start = waiting.pop(self.robot)
        joins = Joins(joined, before.whole_team, waiting, requirements, task.index)
        parts = [joins.opening(start), *joins.arrival(start), *joins.tying()]
        after = joined_state(before, joined, waiting)
        return _clear(StepPlan(joined_motions(parts), after))


def _clear(planned: StepPlan) -> StepPlan:
    """Return a plan that keeps all limits, else raise InfeasibleError.

    How pairs were tied before is known to the whole mission alone, whose certificate follows it.
    """
    from hitchopt.steps.certified_motions import infeasible

    broken = [each for each in planned.certificate.violated if each.name != INTERLACING.name]
    if broken:
        certificate = replace(planned.certificate, checks=tuple(broken))
        raise infeasible(certificate, planned.motion)
    return planned


def joined_state(before: RestState, joined: Joining, waiting: Mapping[int, Array]) -> RestState:
    """Return the state in which a robot has joined."""
    return replace(
        before,
        team=joined.after.team,
        hitch=joined.after,
        drones=joined.after.drones,
        senses=joined.senses_after,
        levels=None,
        waiting=waiting,
    )


@dataclass(frozen=True)
class Withdraw(Step):
    """A robot leaves the hitch in flight, upward, and waits over it; its neighbours' lines meet.

    It can be lifted out only if its cable is on top of both neighbours', as of one that has joined.
    """

    robot: WhichRobot

    def ring_after(self, ring: Ring, team: Team) -> Ring:  # noqa: ARG002
        """Return the ring without the robot."""
        _place("robot", self.robot, ring)
        if len(ring) < 4:
            bound = "of a ring of at least 4"
            raise InputError("robot", self.robot, bound, "release the hitch, or join another one")
        return tuple(k for k in ring if k != self.robot)

    def polygon_after(self, team: Team, outline: Any) -> Outline:
        """Return the outline whose corner is restored."""
        from hitchopt.planners.forming.joining import corner_restored

        place = _place("robot", self.robot, team.labels)
        return corner_restored(outline, place, self.robot)[0]

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of its leaving, which is its joining backward."""
        from hitchopt.planners.forming.joining import Joins, corner_restored, leaving
        from hitchopt.planners.forming.stages import reversed_stages
        from hitchopt.steps.certified_motions import attempt, check_at_rest

        before, hitch, requirements = task.before, task.hitch, task.requirements
        refuse_rolls(before.whole_team, requirements)
        ring = before.team.labels
        place = _place("robot", self.robot, ring)
        senses = before.known_senses
        _check_on_top(self.robot, place, senses, task.index)
        outline, grown = corner_restored(hitch.polygon, place, self.robot)
        team = before.part(self.ring_after(ring, before.team))

        def planned(side: float) -> StepPlan:
            """Return the plan with the cable ahead on top of the one behind, or under it."""
            joined = leaving(hitch, team, place, outline, grown, senses, side)
            when = f"at the end of step {task.index} (withdraw)"
            check_at_rest(joined.before, requirements, when)
            over = joined.raised(requirements)[0]
            joins = Joins(joined, before.whole_team, before.waiting, requirements, task.index)
            motion = joined_motions(reversed_stages([joins.opening(over), *joins.tying()]))
            after = replace(
                before,
                team=team,
                hitch=joined.before,
                drones=joined.before.drones,
                senses=joined.senses,
                levels=None,
                waiting={**before.waiting, self.robot: over},
            )
            return _clear(StepPlan(motion, after))

        first = attempt(lambda: planned(1.0))
        return first if isinstance(first, StepPlan) else planned(-1.0)


def _check_on_top(robot: int, place: int, senses: Array, index: int) -> None:
    """Raise InfeasibleError unless a robot's cable lies on both of its neighbours'."""
    over = np.array([senses[place], -senses[(place + 1) % len(senses)]]) > 0.0
    if np.all(over):
        return
    words = "under both" if not np.any(over) else "over one of them and under the other"
    remedy = f"its cable is {words}: release and lay in another order, or withdraw another robot"
    names, when = (f"cable {robot}",), f"of step {index} (withdraw)"
    count = float(np.sum(over))
    broken = Violation("cables under it", count, 2.0, "min", "", names, when, remedy)
    raise InfeasibleError([broken])


@dataclass(frozen=True)
class Replace(Step):
    """A robot that waits joins beside another one, which withdraws; then the polygon is as before.

    The hitch stays tied all the time.
    """

    robot: WhichRobot
    by: Annotated[int, Key(INDEX, "Which robot takes its place", 4)]

    def ring_after(self, ring: Ring, team: Team) -> Ring:
        """Return the ring with one robot in the place of the other one."""
        place = _place("robot", self.robot, ring)
        _waiting("by", self.by, ring, team)
        return (*ring[:place], self.by, *ring[place + 1 :])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of a join, a withdrawal and a morph, at the first cut that fits."""
        from hitchopt.steps.certified_motions import attempt
        from hitchopt.steps.moving import Morph

        before, polygon = task.before, task.hitch.polygon
        place = _place("robot", self.robot, before.team.labels)
        lengths, n = polygon.edge_lengths, len(polygon.vertices)
        refused = list[Exception]()
        for vertex, share in ((v, s) for s in CUTS for v in (place, (place + 1) % n)):
            cut = share * float(min(lengths[vertex - 1], lengths[vertex]))
            steps: Sequence[Step] = (
                Join(self.by, vertex, cut),
                Withdraw(self.robot),
                Morph(polygon=polygon),
            )
            found = attempt(lambda steps=steps: _in_a_row(steps, task))  # type: ignore[misc]
            if isinstance(found, StepPlan):
                return found
            refused.append(found)
        raise refused[0]


CUTS = (0.35, 0.25, 0.5)
"""Shares of the shorter edge that a robot which takes another's place cuts off."""


def _in_a_row(steps: Sequence[Step], task: StepTask) -> StepPlan:
    """Return the plan of steps one after the other, as one step."""
    state, motions = task.before, list[Motion]()
    for step in steps:
        here = replace(task, before=state)
        planned = step.plan(here)
        motions.append(state.with_waiting(planned.motion, task.requirements))
        state = planned.after
    return StepPlan(joined_motions(motions), state)
