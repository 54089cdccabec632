"""Settling: over-travels of vertices that decay, which remove the hysteresis of friction.

Where cables slid, friction holds a hitch within a band about its goal, on the side from which it
came. Vertices that alternate about their goals, each time a little less far, end in the middle of
the band, as in demagnetization. With smaller friction the band is narrower, and what remains is as
small; without friction vertices follow the plan. Over-travels are plain morphs: no leg leans.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import checked_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.rest_errors import longest_period, planned_rest, settled, sliding_shares
from hitchopt.motion.motion import SETTLE, Motion, Phase, concatenated
from hitchopt.motion.states import states_at
from hitchopt.planners.along import straight_plan
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.ends import end_of_morph
from hitchopt.planners.rests import IDLE, rest_motion, rest_plan
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.values import Array, counted
from hitchopt.values.fields import with_fields

MIN_SLIDE = 1e-3
"""[m] Change of leg lengths below which a step ends without settling."""

STEP = 0.025
"""[m] Mean difference in size of consecutive over-travels against the stated friction. Vertices
rest within half a difference: they stop once two over-travels together are within the band."""

DECAY = 0.75
"""Exponent of the frictions over time, which makes differences of large over-travels smaller, since
friction that needs these leaves vertices farther off."""

FIRST = 0.9
"""Mean friction of the first over-travel over that of cables that slide alone."""

CORRECTIONS = 2
"""Corrections of the sizes of over-travels, after which vertices are within 5 mm of their goals."""

SUFFICIENT = 0.8
"""Least such share from which all friction yields, since a cable may slide alone. With 0.65,
vertices of simulated triangles rest 4 cm off, 0.16 of the width of their bands."""

MOVE_SHARE = 0.8
"""Shortest duration of an over-travel, and of the rest after the last one, over the longest period
with which vertices swing without friction. At 0.5 over-travels are in resonance with it: with 0.6,
simulated drones reached a clasp; with 0.8, vertices swing by 1 to 3 cm."""

SHARES = (1.0, 0.8, 0.6, 0.4)
"""Shares of the first friction from which over-travels are tried, where limits bind."""

FOLLOWING = 0.2
"""Smallest way of a vertex that over-travels, over that of the vertex that moved farthest.

A cable that slid keeps its friction until it slides back: where vertices with 0.3 of the way stayed
in place, a third cable held the farthest one 4 cm off."""

MAX_JERK = 8.0
"""[m/s³] Largest jerk of drones."""


def with_settling(plan: StepPlan, task: StepTask, settle: float | str | bool) -> StepPlan:
    """Return the plan with over-travels at its end if cables slid against friction.

    ``settle`` is ``Step.settling`` of its last step. Raises InfeasibleError as ``settling_plan``.
    """
    hitch = plan.after.hitch
    if settle is False or hitch is None or hitch.team.friction == 0.0:
        return plan
    before = task.before.hitch
    largest_slide = np.max(np.ptp(plan.motion.legs.coefficients, axis=(0, -1)))
    if before is not None and largest_slide < MIN_SLIDE:
        return plan
    at_end = task.within(task.requirements, plan.after)
    phase = Phase(SETTLE, plan.motion.phases[-1].step, 0.0, 0.0)
    seconds = settle if isinstance(settle, float) else None
    settling = settling_plan(at_end, seconds, phase, before)
    return replace(plan, motion=concatenated([plan.motion, settling.motion]))


def settling_plan(
    task: StepTask, duration: float | None, phase: Phase, start: Hitch | None = None
) -> StepPlan:
    """Return the plan in which vertices over-travel and return to their goals.

    They over-travel along their paths from the hitch ``start``, or inward and outward without one.
    Where limits bind they over-travel less, or not at all; the remark names the vertex that may
    rest farthest off, and what it lacks. Raises InfeasibleError if that is farther than
    ``limits.vertex_error`` or ``rest_shift``, or if limits bind within a prescribed ``duration``.
    """
    settling = Settling(task, duration, phase, start)
    if not settling.width >= STEP:  # nan without a balance
        return settling.rest(f"friction holds vertices within {50.0 * settling.width:.2g} cm")
    shares = (*SHARES, 0.0) if duration is None else SHARES
    settled = first_certified([settling.candidate(shares)], Effort())
    settling.require_near(settled)
    return settled.plan


class Settled(NamedTuple):
    """A certified plan at whose end friction may hold a vertex off its goal."""

    plan: StepPlan
    """The plan."""

    short: float
    """Distance that the vertex may be off [m]."""

    cause: InfeasibleError | None
    """What larger over-travels break; None if these suffice."""


@dataclass(frozen=True, eq=False)
class Settling:
    """How a hitch at rest settles; arguments are those of ``settling_plan``."""

    task: StepTask
    duration: float | None
    phase: Phase
    start: Hitch | None

    @cached_property
    def at_rest(self) -> dict[str, Array]:
        """The hitch at rest, as ``planned_rest``."""
        return _rests([self.task.hitch], self.task.requirements)

    @cached_property
    def slides(self) -> Array:
        """(n, 2), shares of friction of cables that slid since the start, or outward without one.

        Both cables of a clasp share its friction; that of one that slides alone is 1.
        """
        end, start = self.task.hitch, self.start
        slid = np.ones_like(end.legs) if start is None else end.legs - start.legs
        return sliding_shares(end.team, self.at_rest, slid)

    @cached_property
    def bands(self) -> Array:
        """(points, 2) [m], the bands of rest across which vertices over-travel.

        They span the rests with friction against the slides of the cables, and in their direction.
        If vertices moved, bands are along their ways, and 0 for others. They are nan where friction
        has no balance.
        """
        end, start = self.task.hitch, self.start
        both_ways = {name: np.repeat(values, 2, axis=0) for name, values in self.at_rest.items()}
        against, along = self._resting(both_ways, np.array([1.0, -1.0]))
        bands = np.zeros_like(end.polygon.vertices)
        clasps = end.team.layout.clasps
        bands[clasps] = (along - against)[clasps, :2]
        ways = np.zeros_like(bands) if start is None else (end.vertices - start.vertices)[:, :2]
        distances = length(ways)
        farthest = float(np.max(distances))
        if farthest < MIN_SLIDE:
            return bands
        directions = ways / np.maximum(distances, MIN_SLIDE)[:, None]
        widths = np.abs(dot(bands, directions)) * (distances >= FOLLOWING * farthest)
        return np.asarray(widths[:, None] * directions)

    def _resting(self, rests: dict[str, Array], parts: Array) -> Array:
        """Return vertices (S, points, 3) [m] of rests (S, …) with parts (S,) of the friction.

        It acts against slides; a negative part acts in their direction.
        """
        team = self.task.hitch.team
        return settled(
            team,
            rests,
            lengths=np.zeros((len(parts), team.robots)),
            offsets=np.zeros((len(parts), team.drones, 3)),
            friction=(team.friction * parts)[:, None, None] * self.slides,
        )

    @property
    def width(self) -> float:
        """Width of the widest band [m]."""
        return float(np.max(length(self.bands)))

    @property
    def vertex(self) -> str:
        """Name of the vertex with the widest band."""
        return self.task.hitch.team.point_names[int(np.argmax(length(self.bands)))]

    @cached_property
    def shortest_move(self) -> float:
        """Shortest duration of an over-travel [s]."""
        return MOVE_SHARE * longest_period(self.task.hitch.team, self.at_rest)

    def candidate(
        self, shares: Sequence[float], cause: InfeasibleError | None = None
    ) -> Candidate[Settled]:
        """Return the candidate of the first share, amended to the next ones where limits bind."""
        share, *smaller = shares

        def amended(error: InfeasibleError) -> Candidate[Settled] | None:
            """Return the candidate of smaller over-travels."""
            return self.candidate(smaller, cause or error) if smaller else None

        return Candidate("over-travel", partial(self._settled, share, cause), amended)

    def _settled(self, share: float, cause: InfeasibleError | None) -> Settled:
        """Return the certified plan of over-travels from a share of the first friction on."""
        short = min(0.5, SUFFICIENT - share * FIRST) * self.width
        plan = self.over_travels(share) if share else self.rest(f"{self.vertex} does not settle")
        if cause is None:
            return Settled(plan, 0.0, None)
        broken = str(replace(cause.violations[0], remedy="")).rstrip("; ")
        remark = (
            f"it may rest {100.0 * short:.2g} cm short, since larger over-travels break {broken}; "
            "limits.rest_shift refuses that, and finds changes that help"
        )
        return Settled(plan.with_remark(remark), short, cause)

    def over_travels(self, share: float) -> StepPlan:
        """Return the certified plan of the over-travels from a share of the first friction on."""
        goal = self.task.hitch
        slid = self.slides[self.slides != 0.0]
        together = float(np.sqrt(np.mean(slid**2)))
        hitches = self._beyond(self._frictions(share * FIRST / together))
        size = max(float(np.max(length(each.vertices - goal.vertices))) for each in hitches)
        ends = [*hitches, goal, goal]
        moves = plan_in_sequence([partial(self._move, end) for end in ends], self._smooth_task)
        motion = moves.motion.replaced(
            phases=(self.phase.retimed(0.0, moves.motion.duration),),
            requirements=self.task.requirements,
        )
        if self.duration is not None:
            motion = _lasting(motion, self.duration)
        times = counted(len(hitches), "time")
        remark = f"{self.vertex} over-travels {times}, by up to {100.0 * size:.2g} cm"
        return require_certified(moves.replaced(motion, moves.after).with_remark(remark))

    @property
    def _smooth_task(self) -> StepTask:
        """The task with jerks at which motors do not saturate as drones turn back."""
        requirements = self.task.requirements
        limits = requirements.limits
        smooth = with_fields(limits, jerk=min(limits.jerk, MAX_JERK))
        return self.task.within(replace(requirements, limits=smooth), self.task.before)

    def _frictions(self, first: float) -> Array:
        """Return the parts of friction of over-travels, which decay from the first; none is above.

        The first ones are against the friction of cables that slide alone, the others against that
        of cables that slide together. The last one is not above that of the least friction, which
        does not yield to smaller ones.
        """
        team = self.task.hitch.team
        last = team.least_friction / team.friction
        together = _steps(0.5 * self.width) ** DECAY
        beyond = max(first - 1.0, 0.0)
        alone = 1.0 + beyond * _steps(0.5 * self.width * beyond) ** 2
        parts = np.unique(np.minimum(np.concatenate([alone, together]), first))[::-1]
        before = np.append(np.inf, parts[:-1])
        return np.asarray(parts[before > last])

    def _beyond(self, parts: Array) -> list[Hitch]:
        """Return hitches beyond the goal on alternating sides, one by part of the friction.

        Friction stops vertices on their way there at the goal. Its band is wider on one side, so
        vertices that over-travelled by the same sizes would end off the goal.
        """
        goal, requirements = self.task.hitch, self.task.requirements
        widest = int(np.argmax(length(self.bands)))
        directions = self.bands / self.width
        signed = parts * (-1.0) ** np.arange(len(parts))
        sizes = 0.5 * self.width * signed
        for _ in range(CORRECTIONS):
            hitches = [_displaced(goal, size * directions, requirements) for size in sizes.tolist()]
            stopped = self._resting(_rests(hitches, requirements), signed)
            beyond = (stopped - goal.vertices)[:, widest, :2] @ directions[widest]
            sizes -= np.where(np.isfinite(beyond), beyond, 0.0)
        return [_displaced(goal, size * directions, requirements) for size in sizes.tolist()]

    def _move(self, end: Hitch, task: StepTask) -> StepPlan:
        """Return the plan of a straight morph, or of a rest."""
        plan = straight_plan(task, end, self.phase)
        factor = max(1.0, self.shortest_move / plan.motion.duration)
        return plan.replaced(plan.motion.slowed(factor), plan.after)

    def rest(self, remark: str) -> StepPlan:
        """Return the plan of a rest."""
        hitch, requirements = self.task.hitch, self.task.requirements
        motion = rest_motion(hitch, requirements, self.duration or IDLE, self.phase)
        return self.task.plan_ending(motion, hitch).with_remark(remark)

    def require_near(self, settled: Settled) -> None:
        """Raise InfeasibleError for a vertex that may rest farther off [m] than its limit."""
        limits = self.task.requirements.limits
        limit = limits.held_at_rest
        if limit is None or settled.cause is None or settled.short <= limit:
            return
        where, when = (self.vertex,), "after over-travels"
        remedy = "give vertices room to over-travel, or use smoother cables (cable_friction)"
        name = "vertex_error" if limit == limits.vertex_error else "rest_shift"
        values = name, settled.short, limit, "max", "m", where, when, remedy
        raise InfeasibleError([Violation(*values), *settled.cause.violations])


def _steps(way: float) -> Array:
    """Return shares of a way [m], from 1 on, whose differences are at most STEP."""
    count = math.ceil(way / STEP)
    return np.arange(count, 0, -1) / max(count, 1)


def _lasting(motion: Motion, duration: float) -> Motion:
    """Return the motion slowed down to a duration [s]; raise InfeasibleError for a shorter one."""
    if duration < motion.duration:
        remedy = f"settle: {math.ceil(motion.duration)}"
        values = "duration", motion.duration, duration, "max", "s", (), "of over-travels", remedy
        raise InfeasibleError([Violation(*values)])
    return motion.slowed(duration / motion.duration)


def _rests(hitches: list[Hitch], requirements: Requirements) -> dict[str, Array]:
    """Return hitches of a team at rest, as ``planned_rest``."""
    rests = []
    for hitch in hitches:
        motion = rest_plan(hitch, requirements).motion
        states = states_at(motion, np.zeros(1))
        forces = states.cable_forces
        rests.append(
            planned_rest(motion.team, states.positions, states.vertices, states.tensions, forces)
        )
    return {name: np.concatenate([rest[name] for rest in rests]) for name in rests[0]}


def _displaced(goal: Hitch, offsets: Array, requirements: Requirements) -> Hitch:
    """Return the hitch with vertices displaced by offsets (points, 2) [m] and the nearest legs."""
    try:
        polygon = checked_polygon(goal.team, goal.polygon.vertices + offsets)
    except InputError:
        farthest = float(np.max(length(offsets)))
        when = "during over-travels"
        raise InfeasibleError(
            [Violation("convexity", farthest, 0.0, "max", "m", (), when, "settle: false")]
        ) from None
    return end_of_morph(goal, polygon, None, requirements).hitch
