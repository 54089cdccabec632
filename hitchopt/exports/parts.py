"""Cut plans at rests into parts that are flown one by one, for drones of little memory.

Drones hover where a part ends, until the next one is uploaded: at the end of a phase rather than in
the middle of over-travels, where vertices are off their goals. Setpoints with offsets, which hold
the tension, come to rest later than the plan. So every part has offsets of its own, and its end
rests longer than planned. The plan is certified with these rests, in which its phases last longer.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchopt.checks.certifying import certificate_of
from hitchopt.exports.format import ExportTask
from hitchopt.exports.held_tension import REST_TIME
from hitchopt.geometry.vectors import length
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, TAKE_OFF

Fits = Callable[[ExportTask], bool]  # Whether a part fits in memory
AT_GOAL = 1e-3  # [m] Distance from the end of its phase up to which a rest is at a goal


class Rest(NamedTuple):
    """A rest of a plan."""

    distance: float  # Largest distance of a drone from where the phase ends [m]
    phase: str  # Name of the phase

    @property
    def is_goal(self) -> bool:
        """Return whether the plan rests at a goal, rather than in the middle of over-travels."""
        return self.distance <= AT_GOAL


def cut_into_parts(task: ExportTask, fits: Fits) -> Sequence[ExportTask]:
    """Return the task cut at rests into parts that fit.

    Empty if other plans fly, if no two or more parts fit, or if none keep all limits.

    Parts end where phases end, and are the fewest that do. Where no such part fits, it ends at the
    rest that is nearest to the end of its phase, such as the smallest over-travel. A plan is not
    cut if other plans fly at the same time, since they would not wait. No part is a take-off alone,
    after which tying would wait for the next upload. Of as many parts, those that end with a taut
    hitch are preferred.
    """
    flight = task.timeline
    if flight.others:
        return ()
    rests = flight.breaks[flight.rest_breaks].tolist()
    while len(cuts := _cuts(task, flight, rests, fits)) > 2:
        parts = _parts(task, cuts)
        # Unless rests matter, the plan's own certificate holds for its parts
        if not _rests_matter(task) or certificate_of(_flown(parts)).certified:
            return parts
        # Cut again, without the rests that violate a limit by themselves
        uncertified = [cut for cut in cuts[1:-1] if not _may_rest(task, cut)]
        if not uncertified:
            break
        rests = [rest for rest in rests if rest not in uncertified]
    return ()


def _cuts(task: ExportTask, flight: Flight, rests: Sequence[float], fits: Fits) -> list[float]:
    """Return the times [s] of the parts' starts and of the end; empty if parts do not fit."""

    def is_too_long(start: float, end: float) -> bool:
        return not fits(task.between(start, end))

    goals = [rest for rest in rests if _rest_at(flight, rest).is_goal]
    cuts = [*rests[:1]]
    while (start := cuts[-1]) < rests[-1]:
        after = max(start, _end_of_take_off(flight, start)) + JOINT
        ends = [rest for rest in rests if rest > after]
        count = bisect_left(ends, True, key=partial(is_too_long, start))
        if count == 0:
            return []
        reached = ends[:count]
        nearest = min(reversed(reached), key=partial(_rest_at, flight))
        cuts.append(next((end for end in reversed(reached) if end in goals), nearest))
    for i in range(len(cuts) - 2, 0, -1):
        after = max(cuts[i - 1], _end_of_take_off(flight, cuts[i - 1])) + JOINT
        taut = [goal for goal in goals if after < goal <= cuts[i] and _is_taut(flight, goal)]
        fitting = (rest for rest in reversed(taut) if not is_too_long(rest, cuts[i + 1]))
        cuts[i] = next(fitting, cuts[i])
    return cuts


def _end_of_take_off(flight: Flight, start: float) -> float:
    """Return the end [s] of the take-offs at a time; the time without any, or with nothing else."""
    end = start
    for each in flight.teams:
        phases = [phase for phase in each.motion.phases if phase.end > start + JOINT]
        others = (phase.start for phase in phases if phase.name != TAKE_OFF)
        end = max(end, next(others, start))
    return end


def _rest_at(flight: Flight, time: float) -> Rest:
    """Return the rest at a time [s], of the team whose drones are farthest from its end."""
    return max(_rests_of_teams(flight, time))


def _rests_of_teams(flight: Flight, time: float) -> Iterator[Rest]:
    """Yield the rest of each team at a time [s]; of two phases, the one that ends there counts."""
    for each in flight.teams:
        phase = next(phase for phase in each.motion.phases if phase.end > time - JOINT)
        before_end = each.motion.drones.at(phase.end) - each.motion.drones.at(time)
        yield Rest(float(np.max(length(before_end))), phase.name)


def _is_taut(flight: Flight, time: float) -> bool:
    """Return whether all hitches are taut right before and after a time [s]."""
    phases = [phase for each in flight.teams for phase in each.motion.phases]
    there = (phase for phase in phases if phase.start - JOINT < time < phase.end + JOINT)
    return all(phase.state.hitched for phase in there)


def _parts(task: ExportTask, cuts: Sequence[float]) -> list[ExportTask]:
    """Return the parts of a task between times [s] at rest, with notes."""
    count = len(cuts) - 1
    notes = [
        f"the plan is cut into {count} parts at rests, to fit memory or keep a limit: before each "
        "upload, goTo every drone's hover point"
    ]
    if task.rests_longer:
        times = ", ".join(f"{rest:.3f}" for rest in cuts[1:-1])
        notes.append(
            f"rests at t = {times} s are extended by {REST_TIME:g} s "
            f"({REST_TIME * (count - 1):g} s in total) until setpoints are at rest; the "
            "certificate covers them"
        )
    notes += [
        f"the part that ends at t = {cut:.3f} s leaves drones up to {100.0 * rest.distance:.2g} cm "
        f"from where {rest.phase} ends, since none that reaches a goal fits: stream the plan, or "
        "start the next part soon"
        for cut in cuts[1:-1]
        if not (rest := _rest_at(task.timeline, cut)).is_goal
    ]
    parts = []
    for i, (start, end) in enumerate(pairwise(cuts), 1):
        part = f"part {i} of {count}, t = {start:.3f} s to {end:.3f} s of the plan"
        own_notes = (*task.notes, *notes, part)
        parts.append(replace(task.between(start, end), number=i, part=part, notes=own_notes))
    return parts


def _rests_matter(task: ExportTask) -> bool:
    """Return whether rests at the ends of parts may break a limit that the plan keeps.

    Parts last longer, or friction may hold a vertex farther off than a limit of rests.
    """
    teams = task.flight.teams
    limits = [each.motion.requirements.limits.held_at_rest for each in teams]
    return task.rests_longer or any(limit is not None for limit in limits)


def _flown(parts: Sequence[ExportTask]) -> Flight:
    """Return the plan as its parts fly it, with a rest after each of them.

    The time of uploads counts toward no limit of duration.
    """
    rested = [
        part.plan.prolonged(part.rest) if part.rest else part.plan.untimed.prolonged(REST_TIME)
        for part in parts
    ]
    return reduce(Flight.followed_by, rested)


def _may_rest(task: ExportTask, time: float) -> bool:
    """Return whether a plan is certified with a longer rest at a time [s]."""
    plan = task.plan if task.rests_longer else task.plan.untimed
    first, last = plan.breaks[[0, -1]].tolist()
    before = plan.between(first, time).prolonged(REST_TIME)
    return certificate_of(before.followed_by(plan.between(time, last))).certified
