"""Settling: over-travels of vertices that decay, which remove the hysteresis of friction.

Where cables slid, friction holds a hitch within a band about its goal, on the side from which it
came. Vertices that alternate about their goals, each time a little less far, end in the middle of
the band, as in demagnetization. With smaller friction the band is narrower, and what remains is as
small; without friction vertices follow the plan. Over-travels are plain morphs.

``friction.hysteresis`` follows the vertices as the hitch goes beyond its goal and back, with
the largest friction of the range, in the direction opposite to that in which it left them. So the
first over-travels are as large as it takes to move them to their goals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.friction.hysteresis import held_vertices
from hitchopt.friction.shifts import SETTLED, frictions_of
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import checked_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.rest_errors import longest_period, planned_rest
from hitchopt.motion.motion import SETTLE, Motion, Phase, concatenated
from hitchopt.motion.states import states_at
from hitchopt.planners.along import straight_plan
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.ends import end_of_morph
from hitchopt.planners.morph.legs import legs_clear
from hitchopt.planners.morph.morph import moves, straight_path
from hitchopt.planners.rests import IDLE, rest_motion, rest_plan
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.planners.timing.swing import after_swing, calm_stretch
from hitchopt.values import Array, counted
from hitchopt.values.fields import with_fields

MIN_SLIDE = 1e-3  # [m] Change of leg lengths below which a step ends without settling

STEP = 0.02
"""[m] Mean difference in size of consecutive over-travels. Vertices rest within half a difference,
where smaller over-travels no longer move them, and as much farther off as they overshoot. With
3 cm, vertices of simulated triangles rest up to 3 cm off instead of 2.1."""

LARGER = 1
"""Number of over-travels that are larger than friction needs, since large ones overshoot by several
centimetres. Without one, a vertex of a simulated triangle rests 5 cm off."""

FARTHEST = (0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 12.0)
"""Sizes of first over-travels that are tried, over the distance at which friction holds vertices
off their goals."""

SWEEP = np.array([0.4, 0.55, 0.7, 0.85, 1.0, 1.15, 1.3])
"""Sizes of later over-travels that are tried, over the first one. On either side they differ by up
to a fifth, since angles are sharper on one."""

MOVE_SHARE = 0.8
"""Shortest duration of an over-travel, and of the rest after the last one, over the longest period
with which vertices swing without friction. At 0.5 over-travels are in resonance with it: with 0.6,
simulated drones reached a clasp; with 1.1, vertices rest no nearer."""

SHARES = (1.0, 0.8, 0.6, 0.4)
"""Shares of the first over-travel from which over-travels are tried, where limits bind."""

MAX_JERK = 8.0  # [m/s³] Largest jerk of drones


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
    at_end = task.within(after_swing(task.requirements, plan.motion), plan.after)
    phase = Phase(SETTLE, plan.motion.phases[-1].step, 0.0, 0.0)
    seconds = settle if isinstance(settle, float) else None
    start = None if np.any(plan.motion.holding) else before
    settling = settling_plan(at_end, seconds, phase, start, requested=seconds is not None)
    return replace(plan, motion=concatenated([plan.motion, settling.motion]))


def settling_plan(
    task: StepTask,
    duration: float | None,
    phase: Phase,
    start: Hitch | None = None,
    *,
    requested: bool,
) -> StepPlan:
    """Return the plan in which vertices over-travel and return to their goals.

    ``start`` is the hitch before its cables slid, None if these may hold any friction. Vertices
    over-travel as friction left them behind. Where limits bind they over-travel less, or not at
    all; the remark names the vertex that may rest farthest off, and what it lacks.
    Raises InfeasibleError if that is farther than ``limits.vertex_error`` or ``rest_shift``, or
    than SETTLED, with any friction of the range, where the problem ``requested`` over-travels and
    no limit; and if limits bind within a prescribed ``duration``.
    """
    settling = Settling(task, duration, phase, start)
    if settling.lag < 0.5 * STEP:
        return settling.rest(f"friction holds vertices within {100.0 * settling.lag:.2g} cm")
    if math.isnan(settling.lag):
        settled = settling.without_balance
    else:
        shares = SHARES if settling.first > 0.0 else ()
        if duration is None or not shares:
            shares = (*shares, 0.0)
        settled = first_certified([settling.candidate(shares)], Effort())
    limit = task.requirements.limits.held_at_rest
    is_stated = limit is not None
    if limit is None and requested:
        limit = SETTLED
    if limit is None:
        return settled.plan
    settling.require_within(limit, settled, settled.short, settling.vertex)
    if not is_stated:  # others are limits of the certificate
        left = settling.left_by(settled)
        farthest = int(np.argmax(left))
        names = task.hitch.team.point_names
        settling.require_within(limit, settled, float(left[farthest]), names[farthest])
    return settled.plan


class Settled(NamedTuple):
    """A certified plan at whose end friction may hold a vertex off its goal."""

    plan: StepPlan  # The plan
    short: float  # Distance that the vertex may be off [m]
    over_travels: tuple[Hitch, ...] = ()  # Hitches beyond the goal
    causes: tuple[Violation, ...] = ()  # What larger over-travels break


@dataclass(frozen=True, eq=False)
class Settling:
    """How a hitch at rest settles; arguments are those of ``settling_plan``."""

    task: StepTask
    duration: float | None
    phase: Phase
    start: Hitch | None
    _by_size: dict[float, Hitch] = field(default_factory=dict, init=False)  # Hitches beyond

    @cached_property
    def at_rest(self) -> dict[str, Array]:
        """The hitch at rest, as ``planned_rest``."""
        return _rests([self.task.hitch], self.task.requirements)

    @cached_property
    def _history(self) -> dict[str, Array]:
        """The hitch before its cables slid and at rest, as ``planned_rest``."""
        if self.start is None:
            return self.at_rest
        return _rests([self.start, self.task.hitch], self.task.requirements)

    @cached_property
    def offsets(self) -> Array:
        """(points, 2) [m], from the goal to where the largest friction of the range holds vertices.

        They are nan where forces have no balance.
        """
        return np.asarray(self._held([])[0])

    @property
    def lag(self) -> float:
        """Largest distance at which friction holds a vertex off its goal [m]."""
        return float(np.max(length(self.offsets)))

    @property
    def directions(self) -> Array:
        """(points, 2), ways of vertices over the size of an over-travel, against their offsets."""
        return np.asarray(-self.offsets / self.lag)

    @property
    def _farthest(self) -> int:
        """Point that friction holds farthest off."""
        return int(np.argmax(length(self.offsets)))

    @property
    def vertex(self) -> str:
        """Its name."""
        return self.task.hitch.team.point_names[self._farthest]

    def _held(self, beyond: Sequence[Hitch]) -> Array:
        """Return offsets from the goal (1 + S, points, 2) [m] at which friction holds vertices.

        The hitch goes from its history to the goal, and then to S hitches beyond it.
        """
        share = 1.0 if self.start is None else 0.0
        largest = np.array([self.task.hitch.team.friction])
        return self._held_by(beyond, largest, np.array([share]))[:, 0]

    def _held_by(self, beyond: Sequence[Hitch], frictions: Array, shares: Array) -> Array:
        """Return ``_held`` for F coefficients of friction (1 + S, F, points, 2) [m].

        At the start of the history, clasps hold ``shares`` (F,), as in ``held_vertices``.
        """
        samples = self._history
        if beyond:
            rests = _rests(beyond, self.task.requirements)
            samples = {name: np.concatenate([samples[name], rests[name]]) for name in samples}
        vertices = held_vertices(self.task.hitch.team, samples, frictions, shares)
        from_goal = vertices[-1 - len(beyond) :] - self.task.hitch.vertices
        return np.asarray(from_goal[..., :2])

    def left_by(self, settled: Settled) -> Array:
        """Return how far (points,) [m] any friction of the range holds vertices off their goals.

        It is infinite where forces have no balance.
        """
        frictions = frictions_of(settled.plan.motion)
        shares = np.array([-1.0, 1.0] if self.start is None else [0.0])
        path = [*settled.over_travels, self.task.hitch]
        every = np.tile(frictions, len(shares)), np.repeat(shares, len(frictions))
        left = length(self._held_by(path, *every)[-1])
        return np.asarray(np.max(np.where(np.isfinite(left), left, np.inf), axis=0))

    def _beyond(self, sizes: Array) -> list[Hitch]:
        """Return hitches beyond the goal by over-travels of sizes (S,) [m]."""
        return [self._hitch_beyond(size) for size in sizes.tolist()]

    def _hitch_beyond(self, size: float) -> Hitch:
        """Return the hitch beyond the goal by an over-travel of a size [m], computed once."""
        if size not in self._by_size:
            offsets = size * self.directions
            hitch = _displaced(self.task.hitch, offsets, self.task.requirements)
            self._by_size[size] = hitch
        return self._by_size[size]

    def _after(self, sizes: Array) -> Array:
        """Return how far (S,) [m] beyond its goal the farthest vertex is after each over-travel."""
        path = np.outer(sizes, [1.0, 0.0])
        returned = self._held(self._beyond(path.ravel()))[2::2, self._farthest]
        return np.asarray(returned @ self.directions[self._farthest])

    @cached_property
    def growing(self) -> tuple[Array, Array, tuple[Violation, ...]]:
        """Sizes (S,) [m] of over-travels that grow, and how far beyond each leaves the vertex [m].

        They end where hitches beyond are no polygons, which the violations tell, or where forces
        have no balance.
        """
        sizes, broken = self.lag * np.array(FARTHEST), tuple[Violation, ...]()
        while True:
            try:
                beyond = self._after(sizes)
            except InfeasibleError as error:
                sizes, broken = sizes[:-1], tuple(error.violations)
            else:
                balanced = np.isfinite(beyond)
                return sizes[balanced], beyond[balanced], broken

    @cached_property
    def first(self) -> float:
        """Size [m] of the over-travel after which the vertex is at its goal."""
        sizes, beyond, _ = self.growing
        return _root(sizes, beyond)

    def _sizes(self, share: float) -> Array:
        """Return the sizes (k,) [m] of over-travels from a share of the first one on.

        They go forward and back in turn, and decay in equal steps. The second one is as large as it
        takes to return the vertex to its goal from farther beyond. The last one is not larger than
        the least friction needs, which does not yield to smaller ones.
        """
        first = share * self.first
        sweep = first * SWEEP
        after = self._after(np.concatenate([sweep[-1:], -sweep, sweep]))
        after_back, after_forward = after[1 : 1 + len(sweep)], after[1 + len(sweep) :]
        back, forward = _root(sweep, -after_back), _root(sweep, after_forward)
        steps = math.ceil(max(back, forward) / STEP)
        decay = np.arange(steps + LARGER, 0, -1) / steps
        team = self.task.hitch.team
        decay = decay[np.append(np.inf, decay[:-1]) > team.least_friction / team.friction]
        sizes = decay * np.resize([forward, -back], len(decay))
        sizes[0] = max(sizes[0], first)
        return np.asarray(sizes)

    @cached_property
    def shortest_move(self) -> float:
        """Shortest duration of an over-travel [s]."""
        return MOVE_SHARE * longest_period(self.task.hitch.team, self.at_rest)

    @property
    def without_balance(self) -> Settled:
        """The hitch at rest, where forces have no balance with the largest friction."""
        return Settled(self.rest("with this friction, forces have no balance"), math.inf)

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
        """Return the certified plan of over-travels from a share of the first one on."""
        if share:
            self._check_clear(share * self.first)
            hitches = self._beyond(self._sizes(share))
            plan = self.over_travels(hitches)
        else:
            hitches, plan = [], self.rest(f"{self.vertex} does not settle")
        sizes, beyond, broken = self.growing
        short = max(0.0, -float(np.interp(share * self.first, sizes, beyond)))
        if cause is None and short <= 0.5 * STEP:
            return Settled(plan, 0.0, tuple(hitches))
        causes = broken if cause is None else tuple(cause.violations)
        since = "".join(
            f", since larger over-travels break {str(replace(each, remedy='')).rstrip('; ')}"
            for each in causes[:1]
        )
        remark = (
            f"it may rest {100.0 * short:.2g} cm short{since}; "
            "limits.rest_shift refuses that, and finds changes that help"
        )
        return Settled(plan.with_remark(remark), short, tuple(hitches), causes)

    def over_travels(self, hitches: Sequence[Hitch]) -> StepPlan:
        """Return the certified plan of over-travels to hitches beyond the goal."""
        goal = self.task.hitch
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

    def _check_clear(self, size: float) -> None:
        """Raise InfeasibleError if limits bind on the way to the goal plus a size [m].

        All over-travels of a larger first one are then spared their computation.
        """
        end, requirements = self._hitch_beyond(size), self.task.requirements
        if moves(self.task.hitch, end):
            path = straight_path(self.task.hitch, end, requirements)
            if not legs_clear(path, requirements):
                require_certified(self._move(end, self._smooth_task))

    @property
    def _smooth_task(self) -> StepTask:
        """The task with jerks at which motors do not saturate as drones turn back."""
        requirements = self.task.requirements
        limits = requirements.limits
        smooth = with_fields(limits, jerk=min(limits.jerk, MAX_JERK))
        return self.task.within(replace(requirements, limits=smooth), self.task.before)

    def _move(self, end: Hitch, task: StepTask) -> StepPlan:
        """Return the plan of a straight morph, or of a rest."""
        plan = straight_plan(task, end, self.phase)
        factor = calm_stretch(plan.motion, max(1.0, self.shortest_move / plan.motion.duration))
        return plan.replaced(plan.motion.slowed(factor), plan.after)

    def rest(self, remark: str) -> StepPlan:
        """Return the plan of a rest."""
        hitch, requirements = self.task.hitch, self.task.requirements
        motion = rest_motion(hitch, requirements, self.duration or IDLE, self.phase)
        return self.task.plan_ending(motion, hitch).with_remark(remark)

    def require_within(self, limit: float, settled: Settled, left: float, vertex: str) -> None:
        """Raise InfeasibleError for a vertex that may be left farther off [m] than a limit [m]."""
        if left <= limit:
            return
        limits = self.task.requirements.limits
        name = "vertex_error" if limit == limits.vertex_error else "rest_shift"
        remedy = "give vertices room to over-travel, use smoother cables (cable_friction), or raise"
        values = name, left, limit, "max", "m", (vertex,), "after over-travels"
        raise InfeasibleError([Violation(*values, f"{remedy} limits.{name}"), *settled.causes])


def _root(sizes: Array, beyond: Array) -> float:
    """Return the size of an over-travel after which a vertex is at its goal, or the largest one.

    Where forces have no balance ``beyond`` is nan.
    """
    balanced = np.isfinite(beyond)
    if not np.any(balanced):
        return float(sizes[-1])
    return float(np.interp(0.0, np.maximum.accumulate(beyond[balanced]), sizes[balanced]))


def _lasting(motion: Motion, duration: float) -> Motion:
    """Return the motion slowed down to a duration [s]; raise InfeasibleError for a shorter one."""
    if duration < motion.duration:
        remedy = f"settle: {math.ceil(motion.duration)}"
        values = "duration", motion.duration, duration, "max", "s", (), "of over-travels", remedy
        raise InfeasibleError([Violation(*values)])
    return motion.slowed(duration / motion.duration)


def _rests(hitches: Sequence[Hitch], requirements: Requirements) -> dict[str, Array]:
    """Return hitches of a team at rest, as ``planned_rest``."""
    each = [_rests_of(rest_plan(hitch, requirements).motion, np.zeros(1)) for hitch in hitches]
    return {name: np.concatenate([rest[name] for rest in each]) for name in each[0]}


def _rests_of(motion: Motion, t: Array) -> dict[str, Array]:
    """Return the hitch at times t (S,) [s] of a motion, as ``planned_rest``."""
    states = states_at(motion, t)
    return planned_rest(
        motion.team, states.positions, states.vertices, states.tensions, states.cable_forces
    )


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
