"""Joining, withdrawing and replacing: hitches that change their robots in flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.steps.moving import Adjust, Morph
from hitchopt.steps.step import INDEX, RestState, Step, StepPlan, StepTask, WhichPoint
from hitchopt.steps.tying import adjusted
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

    def polygon_after(self, team: Team, outline: Any) -> ConvexPolygon:  # noqa: ARG002
        """Return the outline with the vertex cut off."""
        from hitchopt.planners.forming.joining import corner_cut

        return corner_cut(outline, self.vertex, self.cut)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the robot's way, and of its tying from above."""
        return joined_plan(self, task, 1.0)


def joined_plan(step: Join, task: StepTask, side: float) -> StepPlan:
    """Return the plan of a robot that comes from above, ``side`` 1, or from below, -1."""
    from hitchopt.planners.forming.joining import Joins, joining
    from hitchopt.steps.certified_motions import check_at_rest

    before, hitch, requirements = task.before, task.hitch, task.requirements
    ring = before.team.labels
    team = before.part((*ring[: step.vertex], step.robot, *ring[step.vertex :]))
    outline = step.polygon_after(before.team, hitch.polygon)
    joined = joining(hitch, team, step.vertex, outline, before.known_senses, side, requirements)
    check_at_rest(joined.after, requirements, f"at the end of step {task.index} (join)")
    waiting = dict(before.waiting)
    start = waiting.pop(step.robot)
    joins = Joins(joined, before.whole_team, waiting, requirements, task.index)
    parts = [joins.opening(start), *joins.arrival(start), *joins.tying()]
    after = joined_state(before, joined, waiting)
    slid = [before.with_waiting(x, requirements) for x in adjusted(task, joined.before.q_legs)]
    motion = joined_motions([*slid, *parts])
    return _clear(StepPlan(motion, after))


LIGHTER = "raise team.tension, cut off less, or use lighter cables: these sag too much"


def _clear(planned: StepPlan) -> StepPlan:
    """Return a plan that keeps all limits, else raise InfeasibleError.

    How pairs were tied before is known to the whole mission alone, whose certificate follows it.
    """
    from hitchopt.steps.certified_motions import infeasible

    broken = [each for each in planned.certificate.violated if each.name != INTERLACING.name]
    if broken:
        certificate = replace(planned.certificate, checks=tuple(broken))
        error = infeasible(certificate, planned.motion)
        heavy = {"cable_length", "equilibrium", "tension"}  # where cables lie across
        raise InfeasibleError(
            replace(each, remedy=LIGHTER) if each.constraint in heavy else each
            for each in error.violations
        )
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
    """A robot leaves the hitch in flight, and waits beside it; its neighbours' lines meet.

    It is lifted out if its cable is on top of both neighbours', as of one that has joined, or let
    down if it is below both.
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

    def leaving(self, task: StepTask, hitch: Hitch, *, slides: bool = True) -> Joining:
        """Return its leaving of a hitch, to whose legs cables slide straight if they ``slides``."""
        from hitchopt.planners.forming.joining import corner_restored, leaving

        before, requirements = task.before, task.requirements
        ring = before.team.labels
        place = _place("robot", self.robot, ring)
        senses = before.known_senses
        _check_free(self.robot, place, senses, task.index)
        outline, grown = corner_restored(hitch.polygon, place, self.robot)
        team = before.part(self.ring_after(ring, before.team))
        return leaving(hitch, team, place, outline, grown, senses, requirements, slides=slides)

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of its leaving, which is its joining backward."""
        from hitchopt.planners.forming.joining import Joins
        from hitchopt.planners.forming.stages import reversed_stages
        from hitchopt.steps.certified_motions import check_at_rest

        before, requirements = task.before, task.requirements
        joined = self.leaving(task, task.hitch)
        check_at_rest(joined.before, requirements, f"at the end of step {task.index} (withdraw)")
        joins = Joins(joined, before.whole_team, before.waiting, requirements, task.index)
        aside = joins.aside()
        parts = [joins.opening(aside), *joins.returning(aside), *joins.tying()]
        after = replace(
            before,
            team=joined.before.team,
            hitch=joined.before,
            drones=joined.before.drones,
            senses=joined.senses,
            levels=None,
            waiting={**before.waiting, self.robot: aside},
        )
        slid = [before.with_waiting(x, requirements) for x in adjusted(task, joined.after.q_legs)]
        motion = joined_motions([*slid, *reversed_stages(parts)])
        return _clear(StepPlan(motion, after))


def _check_free(robot: int, place: int, senses: Array, index: int) -> None:
    """Raise InfeasibleError unless a robot's cable is on top of both neighbours', or below."""
    over = senses[place] > 0.0, senses[(place + 1) % len(senses)] < 0.0
    if over[0] != over[1]:
        remedy = (
            "its cable is over one of them and under the other: it can neither be lifted nor let "
            "down; release and lay in another order, or replace it"
        )
        names, when = (f"cable {robot}",), f"of step {index} (withdraw)"
        broken = Violation("cables under it", 1.0, 2.0, "min", "", names, when, remedy)
        raise InfeasibleError([broken])


@dataclass(frozen=True)
class Replace(Step):
    """A robot that waits joins beside another one, which withdraws.

    Then polygon and slack split are as before. The hitch stays tied all the time.
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
        from hitchopt.steps.certified_motions import first_planned

        before, hitch = task.before, task.hitch
        place, senses = _place("robot", self.robot, before.team.labels), before.known_senses
        ways = [
            (vertex, outline, side)
            for rest in RESTS
            for (vertex, outline), side in zip(
                outlines_beside(hitch.polygon, place, rest), _sides(senses, place), strict=True
            )
        ]

        withdraw = Withdraw(self.robot)

        def split_as_before(task: StepTask) -> StepPlan:
            return Adjust(legs=hitch.fractions * task.hitch.slack).plan(task)

        def planned(vertex: int, polygon: Outline, side: float, share: float) -> StepPlan:
            lengths = hitch.polygon.edge_lengths
            cut = share * float(min(lengths[vertex - 1], lengths[vertex % len(lengths)]))
            join = partial(joined_plan, Join(self.by, vertex, cut), side=side)
            plans = join, partial(_reshaped, polygon, withdraw), withdraw.plan, split_as_before
            return _in_a_row(plans, task)

        return first_planned(partial(planned, *way, share) for way, share in product(ways, CUTS))


def _reshaped(polygon: Outline, withdraw: Withdraw, task: StepTask) -> StepPlan:
    """Return the plan of a morph to a polygon, and to legs with which a robot can leave it.

    The edge that shrinks leaves long legs with a drone at the end of each: drones keep off cables
    as distances are planned, for ropes are not quite there. The motion keeps the task's limits.
    """
    from hitchopt.planners.forming.laying import planned_distance

    hitch, kept = task.hitch, task.requirements
    own = kept.separation
    wider = replace(own, cable=planned_distance(own))
    task = replace(task, requirements=replace(kept, separation=wider))
    legs = hitch.fractions * cable_slack(hitch.team, polygon)
    there = Hitch(hitch.team, polygon, hitch.altitude, legs, hitch.roll)
    left = withdraw.leaving(task, there, slides=False)
    planned = Morph(polygon=polygon, legs=left.after.q_legs).plan(task)
    return replace(planned, motion=planned.motion.replaced(requirements=kept))


def _sides(senses: Array, place: int) -> tuple[float, float]:
    """Return from which side another robot joins behind an edge, or ahead of it.

    So that the robot of the edge is then on top of both neighbours, or below both.
    """
    return float(senses[(place + 1) % len(senses)]), -float(senses[place])


def outlines_beside(polygon: Outline, place: int, share: float) -> Iterator[tuple[int, Outline]]:
    """Yield vertices at which another robot may join beside an edge, and outlines after that.

    There the other robot holds the edge, and the one to be replaced cuts off a ``share`` of it at
    the corner, which is restored as it leaves.
    """
    points, u, n = polygon.vertices, polygon.edge_directions, len(polygon.vertices)
    last = (place + 1) % n
    start, end, half = points[place], points[last], share * polygon.edge_lengths
    before, after = min(half[place - 1], half[place]), min(half[place], half[last])
    cut = np.insert(points, place + 1, end - after * u[place], axis=0)
    cut[(place + 2) % (n + 1)] = end + after * u[last]
    yield place, ConvexPolygon(cut)
    cut = np.insert(points, place + 1, start + before * u[place], axis=0)
    cut[place] = start - before * u[place - 1]
    yield place + 1, ConvexPolygon(cut)


RESTS = (0.5, 0.35)
"""Shares of an edge that its robot holds at last, before another one has it all."""

CUTS = (0.4, 0.5, 0.6)
"""Shares of the shorter edge that a robot which takes another's place cuts off."""


def _in_a_row(plans: Sequence[Callable[[StepTask], StepPlan]], task: StepTask) -> StepPlan:
    """Return the plan of steps one after the other, as one step."""
    state, motions = task.before, list[Motion]()
    for plan in plans:
        planned = plan(replace(task, before=state))
        motions.append(state.with_waiting(planned.motion, task.requirements))
        state = planned.after
    return StepPlan(joined_motions(motions), state)
