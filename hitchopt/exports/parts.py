"""Cut plans at rests into parts that are flown one by one, for drones of little memory.

Drones hover where a part ends, until the next one is uploaded. Setpoints with offsets, which hold
the tension, come to rest later than the plan. So every part has offsets of its own, and its end
rests longer than planned. The plan is certified with these rests, in which its phases last longer.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial, reduce
from itertools import pairwise

from hitchopt.checks.certifying import certificate_of
from hitchopt.exports.format import ExportTask
from hitchopt.exports.held_tension import REST_TIME
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, TAKE_OFF

Fits = Callable[[ExportTask], bool]  # Whether a part fits in memory


def cut_into_parts(task: ExportTask, fits: Fits) -> Sequence[ExportTask]:
    """Return the task cut at rests into the fewest parts that fit; empty if none do.

    A plan is not cut if other plans fly at the same time, since they would not wait. No part is a
    take-off alone, after which tying would wait for the next upload. Of as many parts, those that
    end with a taut hitch are preferred.
    """
    flight = task.plan if task.rests_longer else task.flight
    if flight.others:
        return ()
    rests = flight.breaks[flight.rest_breaks].tolist()
    while len(cuts := _cuts(task, flight, rests, fits)) > 2:
        parts = _parts(task, cuts)
        if not task.rests_longer or certificate_of(_flown(parts)).certified:
            return parts
        uncertified = [cut for cut in cuts[1:-1] if not _may_rest(flight, cut)]
        if not uncertified:
            break
        rests = [rest for rest in rests if rest not in uncertified]
    return ()


def _cuts(task: ExportTask, flight: Flight, rests: Sequence[float], fits: Fits) -> list[float]:
    """Return the times [s] of the parts' starts and of the end; empty if parts do not fit."""

    def is_too_long(start: float, end: float) -> bool:
        return not fits(task.between(start, end))

    cuts = [*rests[:1]]
    while (start := cuts[-1]) < rests[-1]:
        after = max(start, _end_of_take_off(flight, start)) + JOINT
        ends = [rest for rest in rests if rest > after]
        count = bisect_left(ends, True, key=partial(is_too_long, start))
        if count == 0:
            return []
        cuts.append(ends[count - 1])
    for i in range(len(cuts) - 2, 0, -1):
        after = max(cuts[i - 1], _end_of_take_off(flight, cuts[i - 1])) + JOINT
        taut = [rest for rest in rests if after < rest <= cuts[i] and _is_taut(flight, rest)]
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


def _is_taut(flight: Flight, time: float) -> bool:
    """Return whether all hitches are taut right before and after a time [s]."""
    phases = [phase for each in flight.teams for phase in each.motion.phases]
    return all(phase.formed for phase in phases if phase.start - JOINT < time < phase.end + JOINT)


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
    parts = []
    for i, (start, end) in enumerate(pairwise(cuts), 1):
        part = f"part {i} of {count}, t = {start:.3f} s to {end:.3f} s of the plan"
        own_notes = (*task.notes, *notes, part)
        parts.append(replace(task.between(start, end), number=i, part=part, notes=own_notes))
    return parts


def _flown(parts: Sequence[ExportTask]) -> Flight:
    """Return the plan as its parts fly it, with the rests that are added."""
    return reduce(Flight.followed_by, (part.plan.prolonged(part.rest) for part in parts))


def _may_rest(flight: Flight, time: float) -> bool:
    """Return whether a plan is certified with a longer rest at a time [s]."""
    first, last = flight.breaks[[0, -1]].tolist()
    before = flight.between(first, time).prolonged(REST_TIME)
    return certificate_of(before.followed_by(flight.between(time, last))).certified
