"""Settling at the end of steps: over-travels of the vertices that moved, or swings of drones.

Where cables slid, friction holds a hitch within a band about its goal, on the side from which it
came. Vertices that alternate about their goals along their own ways, each time a little less far,
end in the middle of the band, as in demagnetization. With smaller friction the band is narrower,
and what remains is as small. These over-travels are plain morphs, in which no leg leans.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import checked_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import SETTLE, Phase, concatenated
from hitchopt.motion.states import states_at
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.compensation import settling_plan
from hitchopt.planners.ends import end_of_morph
from hitchopt.planners.rests import rest_plan
from hitchopt.planners.routes import straight_plan
from hitchopt.planners.task import StepPlan, StepTask, plan_in_sequence, require_certified
from hitchopt.values import Array

MIN_SLIDE = 1e-3
"""[m] Change of leg lengths below which a step ends without settling."""

STEP = 0.02
"""[m] Difference in size of consecutive over-travels. Vertices rest within half of it of the middle
of their band: they stop moving once two over-travels together are smaller than the band."""

MAX_COUNT = 14
"""Largest number of over-travels; wider bands have larger steps."""

FIRST = 0.8
"""Ratio of the first over-travel to the width of the band; from one half on all friction yields."""

SHARES = (1.0, 0.8, 0.6, 0.4)
"""Shares of the first over-travel that are tried, where limits bind."""

FOLLOWING = 0.5
"""Smallest way of a vertex that over-travels, over that of the vertex that moved farthest."""

BOTH_SLIDE = 0.5
"""Share of the friction of one cable in that of two that slide at one clasp: the sine of half the
angle of 60° at which simulated cables cross there."""


def with_settling(plan: StepPlan, task: StepTask, settle: float | str | bool) -> StepPlan:
    """Return the plan with motions at its end that remove the hysteresis of cables that slid.

    ``settle`` is ``Step.settling`` of its last step. Vertices that moved over-travel; where limits
    bind or no vertex moved, after tying, or for a prescribed duration [s], drones swing. If limits
    bind, automatic swings are omitted, and swings of a prescribed duration raise InfeasibleError.
    """
    hitch = plan.after.hitch
    if settle is False or hitch is None or hitch.team.cable_friction == 0.0:
        return plan
    before = task.before.hitch
    largest_slide = np.max(np.ptp(plan.motion.legs.coefficients, axis=(0, -1)))
    if before is not None and largest_slide < MIN_SLIDE:
        return plan
    at_end = task.within(task.requirements, plan.after)
    phase = Phase(SETTLE, plan.motion.phases[-1].step, 0.0, 0.0)
    seconds = settle if isinstance(settle, float) else None
    if before is None or seconds is not None:
        settling = settling_plan(at_end, seconds, phase, required=seconds is not None)
    else:
        settling = first_certified(_ways_to_settle(at_end, before, phase), Effort())
    return replace(plan, motion=concatenated([plan.motion, settling.motion]))


def _ways_to_settle(task: StepTask, start: Hitch, phase: Phase) -> Iterator[Candidate[StepPlan]]:
    """Yield over-travels about a hitch at rest to which vertices moved from ``start``, then swings.

    There are only swings for bands that are narrower than STEP.
    """
    swings = partial(settling_plan, task, None, phase, required=False)
    bands = _bands(start, task.hitch, task.requirements)
    widths = length(bands)
    if not np.max(widths) >= STEP:  # nan without a balance
        yield Candidate("swing of drones", swings)
        return
    for share in SHARES:
        yield Candidate("over-travel", partial(_over_travel, task, bands, phase, share))
    widest = int(np.argmax(widths))
    name = task.hitch.team.point_names[widest]
    remark = f"no room for {name} to over-travel; without swings it may rest "
    remark += f"{50.0 * widths[widest]:.2g} cm short"
    yield Candidate("swing of drones", lambda: swings().with_remark(remark))


def _bands(start: Hitch, end: Hitch, requirements: Requirements) -> Array:
    """Return the bands of rest (points, 2) [m] of vertices along their ways, 0 for short ones.

    They span the rests with friction against the slides of the cables from ``start`` to ``end``,
    and in their direction. They are nan where friction has no balance.
    """
    from hitchopt.hitch.rest_errors import planned_rest, settled

    ways = (end.vertices - start.vertices)[:, :2]
    distances = length(ways)
    farthest = float(np.max(distances))
    if farthest < MIN_SLIDE:
        return np.zeros_like(ways)
    states = states_at(rest_plan(end, requirements).motion, np.zeros(2))
    planned = planned_rest(
        end.team, states.positions, states.vertices, states.tensions, states.cable_forces
    )
    slides = BOTH_SLIDE * end.team.cable_friction * np.sign(end.legs - start.legs)
    against, along = settled(
        end.team,
        planned,
        lengths=np.zeros((2, end.team.robots)),
        offsets=np.zeros_like(states.positions),
        friction=np.stack([slides, -slides]),
    )
    directions = ways / np.maximum(distances, MIN_SLIDE)[:, None]
    widths = np.abs(dot((along - against)[:, :2], directions))
    return np.where((distances >= FOLLOWING * farthest)[:, None], widths[:, None] * directions, 0.0)


def _over_travel(task: StepTask, bands: Array, phase: Phase, share: float) -> StepPlan:
    """Return the certified plan of over-travels from a hitch at rest and back to it."""
    goal = task.hitch
    widths = length(bands)
    widest = int(np.argmax(widths))
    size = share * FIRST * float(widths[widest])
    count = min(max(1, round(size / STEP)), MAX_COUNT)
    sizes = share * FIRST * np.linspace(1.0, 1.0 / count, count) * (-1.0) ** np.arange(count)
    hitches = [_beyond(goal, by * bands, task.requirements) for by in sizes.tolist()]

    def move(to: Hitch, task: StepTask) -> StepPlan:
        """Return the certified plan of a straight morph."""
        return require_certified(straight_plan(task, to, phase))

    plan = plan_in_sequence([partial(move, hitch) for hitch in [*hitches, goal]], task)
    motion = plan.motion.replaced(phases=(phase.retimed(0.0, plan.motion.duration),))
    name = goal.team.point_names[widest]
    remark = f"{name} over-travels {count} times, by up to {100.0 * size:.2g} cm"
    short = 0.5 * float(widths[widest]) - size
    if short > 0.0:
        remark += f", and may rest {100.0 * short:.2g} cm short: limits bind"
    return plan.replaced(motion, plan.after).with_remark(remark)


def _beyond(goal: Hitch, offsets: Array, requirements: Requirements) -> Hitch:
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
