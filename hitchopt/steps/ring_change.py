"""Joining, withdrawing and replacing: steps that change a hitch's robots in flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hitchopt.checks.linking import INTERLACING
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import cable_slack
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.steps.certified_motions import check_at_rest, first_feasible, infeasible_error
from hitchopt.steps.moving import Adjust, Morph
from hitchopt.steps.step import (
    INDEX,
    RestState,
    Step,
    StepPlan,
    StepTask,
    WhichPoint,
    plan_in_sequence,
)
from hitchopt.steps.tying import adjusting_motions
from hitchopt.values import Array
from hitchopt.values.fields import Key
from hitchopt.values.units import LENGTH

if TYPE_CHECKING:
    from hitchopt.planners.forming.ring_change import RingChange

Ring = tuple[int, ...]

WhichRobot = Annotated[int, Key(INDEX, "Which robot, from 0", 3)]


def _check_waiting(key: str, robot: int, ring: Ring, team: Team) -> None:
    """Raise InputError unless a robot is waiting."""
    waiting = [k for k in range(team.robots) if k not in ring]
    if robot not in waiting:
        bound = f"one that waits: {', '.join(map(str, waiting))}" if waiting else "one that waits"
        remedy = "name another, or form the hitch with robots: of fewer"
        raise InputError(key, robot, bound, remedy)


def _ring_index(key: str, robot: int, ring: Ring) -> int:
    """Return a robot's index in the ring; raise InputError if it is not in the ring."""
    if robot not in ring:
        bound = f"one of the ring: {', '.join(map(str, ring))}"
        raise InputError(key, robot, bound, "name one that holds an edge")
    return ring.index(robot)


@dataclass(frozen=True)
class Join(Step):
    """Let a waiting robot join the hitch in flight, while all others stay tied.

    It cuts a vertex off: its cable is laid on both edges there, and its pairs roll. Its place in
    the ring is that of the vertex, which becomes two.
    """

    robot: WhichRobot
    vertex: WhichPoint
    cut: Annotated[float, Key(LENGTH, "From the vertex to both new ones, along its edges", 0.5)]

    def ring_after(self, ring: Ring, team: Team) -> Ring:
        """Return the ring with the robot."""
        _check_waiting("robot", self.robot, ring, team)
        if not 0 <= self.vertex < len(ring):
            bound = f"0 to {len(ring) - 1}"
            raise InputError("vertex", self.vertex, bound, "name a vertex of the polygon")
        return (*ring[: self.vertex], self.robot, *ring[self.vertex :])

    def polygon_after(self, team: Team, outline: Any) -> ConvexPolygon:  # noqa: ARG002
        """Return the outline with the vertex cut off."""
        from hitchopt.planners.forming.ring_change import corner_cut

        return corner_cut(outline, self.vertex, self.cut)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the robot's route, and of its tying from above."""
        return join_plan(self, task, 1.0)


def join_plan(step: Join, task: StepTask, side: float) -> StepPlan:
    """Return the plan of a robot that joins from above (``side`` 1) or from below (-1)."""
    from hitchopt.planners.forming.ring_change import RingChangeMotions, find_joining

    before, hitch, requirements = task.before, task.hitch, task.requirements
    ring = before.team.labels
    team = before.part((*ring[: step.vertex], step.robot, *ring[step.vertex :]))
    outline = step.polygon_after(before.team, hitch.polygon)
    rings, senses = (hitch, team, step.vertex, outline), before.assumed_senses
    joined = find_joining(*rings, senses, side, requirements)
    check_at_rest(joined.after, requirements, f"at the end of step {task.index} (join)")
    waiting = dict(before.waiting)
    start = waiting.pop(step.robot)
    joins = RingChangeMotions(joined, before.whole_team, waiting, requirements, task.index)
    parts = [joins.opening(start), *joins.arrival_motions(start), *joins.tying_motions()]
    after = replace(before, hitch=joined.after, senses=joined.senses_after, waiting=waiting)
    return _certified_plan(task, joined.before.q_legs, parts, after)


SAG_REMEDY = "raise team.tension, cut off less, or use lighter cables: these sag too much"


def _certified_plan(
    task: StepTask, q_legs: Array, parts: Sequence[Motion], after: RestState
) -> StepPlan:
    """Return the plan in which cables slide to q-legs (n,) [m], and parts follow.

    Team and drones ``after`` it are those of the hitch then. Raises InfeasibleError for violated
    limits except interlacing, which depends on the whole mission, whose certificate covers it.
    """
    adjusting, hitch = adjusting_motions(task, q_legs), after.tied
    slides = [task.before.with_waiting(each, task.requirements) for each in adjusting]
    after = replace(after, team=hitch.team, drones=hitch.drones, levels=None)
    plan = StepPlan(concatenated([*slides, *parts]), after)
    violated = [check for check in plan.certificate.violated if check.name != INTERLACING.name]
    if violated:
        certificate = replace(plan.certificate, limited=tuple(violated))
        error = infeasible_error(certificate, plan.motion)
        sagging = {"cable_length", "equilibrium", "tension"}  # where cables lie on one another
        raise InfeasibleError(
            replace(each, remedy=SAG_REMEDY) if each.constraint in sagging else each
            for each in error.violations
        )
    return plan


@dataclass(frozen=True)
class Withdraw(Step):
    """Take a robot out of the hitch in flight; it waits beside it, and its neighbours' lines meet.

    It is lifted out if its cable is on top of both neighbours', as of one that has joined, or let
    down if it is below both.
    """

    robot: WhichRobot

    def ring_after(self, ring: Ring, team: Team) -> Ring:  # noqa: ARG002
        """Return the ring without the robot."""
        _ring_index("robot", self.robot, ring)
        if len(ring) < 4:
            bound = "of a ring of at least 4"
            raise InputError("robot", self.robot, bound, "release the hitch, or join another one")
        return tuple(k for k in ring if k != self.robot)

    def polygon_after(self, team: Team, outline: Any) -> Outline:
        """Return the outline with the corner restored."""
        from hitchopt.planners.forming.ring_change import corner_restored

        index = _ring_index("robot", self.robot, team.labels)
        return corner_restored(outline, index, self.robot)[0]

    def leaving(self, task: StepTask, hitch: Hitch, *, slides: bool = True) -> RingChange:
        """Return the withdrawal from a hitch, to whose legs cables slide first if ``slides``.

        Raises InfeasibleError unless the cable is on top of both neighbours', or below both.
        """
        from hitchopt.planners.forming.ring_change import corner_restored, find_leaving

        before, requirements = task.before, task.requirements
        ring = before.team.labels
        index = _ring_index("robot", self.robot, ring)
        senses = before.assumed_senses
        if (senses[index] > 0.0) != (senses[(index + 1) % len(senses)] < 0.0):
            remedy = (
                "its cable is over one of them and under the other: it can neither be lifted nor "
                "let down; release and lay in another order, or replace it"
            )
            names, when = (f"cable {self.robot}",), f"of step {task.index} (withdraw)"
            values = "cables under it", 1.0, 2.0, "min", "", names, when, remedy
            raise InfeasibleError([Violation(*values)])
        outline, extensions = corner_restored(hitch.polygon, index, self.robot)
        rings = hitch, before.part(self.ring_after(ring, before.team)), index, outline
        return find_leaving(*rings, extensions, senses, requirements, slides=slides)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the withdrawal: a join in reverse."""
        from hitchopt.planners.forming.ring_change import RingChangeMotions
        from hitchopt.planners.forming.stages import reversed_stages

        before, requirements = task.before, task.requirements
        joined = self.leaving(task, task.hitch)
        check_at_rest(joined.before, requirements, f"at the end of step {task.index} (withdraw)")
        joins = RingChangeMotions(
            joined, before.whole_team, before.waiting, requirements, task.index
        )
        aside = joins.waiting_position()
        parts = [joins.opening(aside), *joins.return_motions(aside), *joins.tying_motions()]
        waiting = {**before.waiting, self.robot: aside}
        after = replace(before, hitch=joined.before, senses=joined.senses, waiting=waiting)
        return _certified_plan(task, joined.after.q_legs, reversed_stages(parts), after)


@dataclass(frozen=True)
class Replace(Step):
    """Let a waiting robot join beside another one, which then withdraws.

    Then polygon and slack split are as before. The hitch stays tied all the time.
    """

    robot: WhichRobot
    by: Annotated[int, Key(INDEX, "Which robot takes its place", 4)]

    def ring_after(self, ring: Ring, team: Team) -> Ring:
        """Return the ring with one robot in the place of the other."""
        index = _ring_index("robot", self.robot, ring)
        _check_waiting("by", self.by, ring, team)
        return (*ring[:index], self.by, *ring[index + 1 :])

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of a join, a withdrawal and a morph, with the first feasible cut."""
        before, hitch = task.before, task.hitch
        index, senses = _ring_index("robot", self.robot, before.team.labels), before.assumed_senses
        # From these sides, the edge's robot is then on top of both neighbours, or below both
        sides = float(senses[(index + 1) % len(senses)]), -float(senses[index])
        cuts = [
            (*cut, side)
            for share in EDGE_SHARES
            for cut, side in zip(cut_outlines(hitch.polygon, index, share), sides, strict=True)
        ]
        withdraw = Withdraw(self.robot)

        def plan_cut(vertex: int, polygon: Outline, side: float, share: float) -> StepPlan:
            lengths = hitch.polygon.edge_lengths
            cut = share * float(min(lengths[vertex - 1], lengths[vertex % len(lengths)]))
            join = partial(join_plan, Join(self.by, vertex, cut), side=side)
            reshape = partial(_reshape_plan, polygon, withdraw)
            return plan_in_sequence((join, reshape, withdraw.plan, split), task)

        def split(task: StepTask) -> StepPlan:
            return Adjust(legs=hitch.fractions * task.hitch.slack).plan(task)  # as before

        return first_feasible(partial(plan_cut, *cut, x) for cut, x in product(cuts, CUT_SHARES))


def _reshape_plan(polygon: Outline, withdraw: Withdraw, task: StepTask) -> StepPlan:
    """Return the plan of a morph to a polygon and legs from which a robot can withdraw.

    The shrinking edge leaves long legs with a drone at each end. The morph is planned with the
    wider cable clearance of laying, because real ropes deviate; its motion has the task's limits.
    """
    from hitchopt.planners.forming.laying import planned_distance

    hitch, requirements = task.hitch, task.requirements
    wider = replace(requirements.separation, cable=planned_distance(requirements.separation))
    task = replace(task, requirements=replace(requirements, separation=wider))
    legs = hitch.fractions * cable_slack(hitch.team, polygon)
    goal = Hitch(hitch.team, polygon, hitch.altitude, legs, hitch.roll)
    withdrawal = withdraw.leaving(task, goal, slides=False)
    plan = Morph(polygon=polygon, legs=withdrawal.after.q_legs).plan(task)
    return replace(plan, motion=plan.motion.replaced(requirements=requirements))


def cut_outlines(polygon: Outline, edge: int, share: float) -> Iterator[tuple[int, Outline]]:
    """Yield vertices at which another robot may join next to an edge, and the outlines after it.

    The other robot then holds the edge, and the edge's robot cuts off a ``share`` of it at the
    corner, which its withdrawal restores.
    """
    points, u, n = polygon.vertices, polygon.edge_directions, len(polygon.vertices)
    last = (edge + 1) % n
    start, end, cuts = points[edge], points[last], share * polygon.edge_lengths
    before, after = min(cuts[edge - 1], cuts[edge]), min(cuts[edge], cuts[last])
    vertices = np.insert(points, edge + 1, end - after * u[edge], axis=0)
    vertices[(edge + 2) % (n + 1)] = end + after * u[last]
    yield edge, ConvexPolygon(vertices)
    vertices = np.insert(points, edge + 1, start + before * u[edge], axis=0)
    vertices[edge] = start - before * u[edge - 1]
    yield edge + 1, ConvexPolygon(vertices)


EDGE_SHARES = (0.5, 0.35)  # Shares of an edge that its robot still holds before the withdrawal
CUT_SHARES = (0.4, 0.5, 0.6)  # Shares of the shorter edge that a replacing robot cuts off
