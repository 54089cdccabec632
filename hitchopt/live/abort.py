"""Certified aborts of a plan from the moving state at any time.

A command stops the plan's clock. The abort continues with a hold, with the plan backward, or with a
landing of its own. If the certificate does not hold, a later stop is tried. A hitch around an
object cannot be lowered or untied. It flies to one of the plan's own rests without an enclosed
object, and lands there: to a later rest if the object has been moved, as the plan sets it down
before, and to an earlier one if it has not been lifted yet.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULE_OF, check_of
from hitchopt.errors import HitchoptError, InfeasibleError, InputError, Progress
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.live.player import Player
from hitchopt.motion.motion import FREE_STATES, JOINT, CableState, Group, Motion, Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.request import objects_at
from hitchopt.motion.retiming import (
    append_motion,
    on_clock,
    rest_breaks,
    resting,
    truncated,
    with_last_poses,
)
from hitchopt.motion.states import final_hitch
from hitchopt.objects.placing import REST_DRIFT, in_world
from hitchopt.planners.forming.stages import stage, straight_lines
from hitchopt.steps.certified_motions import infeasible_error
from hitchopt.steps.step import RestState, StepTask
from hitchopt.steps.tying import Release, vertical_motion
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.values import Array, check_choice, nonnegative, positive

How = Literal["hold", "back", "release_and_land", "land"]

HOLD = 1.0  # duration of the rest at the end of a hold [s]
DEFAULT_INTERVAL = 2.0  # default interval of the entries of a table [s]

# Candidate delays of the clock's stop [s]. The plan's own rests are candidates too: legs do not
# lean there
DELAYS = np.cumsum([0.0, *0.1 * 1.5 ** np.arange(7)])

# Transient states between free and hitched cables, which only the plan itself can leave
TRANSIENT_STATES = FREE_STATES - {CableState.FREE, CableState.GROUND} | {CableState.ROLLING}

# Checks that exclude rests while tensions change, or before the chords of a swap have met
REST_CHECKS = ("tension", "interlacing")


@dataclass(frozen=True, eq=False)
class StoppedPlan:
    """A plan up to a rest."""

    start: float  # plan time at which the clock starts to slow down [s]
    seconds: float  # time from there to the rest [s]
    rest: float  # plan time at the rest [s]
    motion: Motion


@dataclass(frozen=True, eq=False)
class Abort(StoppedPlan):
    """A plan that stops, and continues with a certified motion."""

    certificate: Certificate


class Aborts:
    """The aborts of one plan."""

    def __init__(self, motion: Motion) -> None:
        self.others = motion.others  # they fly on regardless of this plan's clock
        self.motion = motion.replaced(others=()) if motion.others else motion

    def plan(self, time: float, how: str) -> Abort:
        """Return the first abort for a command at a plan time [s]; see ``Plan.abort``."""
        check_choice("how", how, get_args(How))
        if nonnegative("t", time) > self.motion.duration:
            raise InputError("t", time, f"within {self.motion.duration:g} s", "ask within the plan")
        refusal: InfeasibleError | None = None
        for stop in self.stops_after(time):
            origin = self._origin(stop, how)
            if origin is None:
                continue
            try:
                motion = self._continuation(stop, how, origin).replaced(others=self.others)
                certificate = certify(motion)
                if not certificate.certified:
                    raise infeasible_error(certificate, motion)
            except InfeasibleError as error:
                refusal = refusal or error
            else:
                return Abort(stop.start, stop.seconds, stop.rest, motion, certificate)
        raise refusal or _refusal(f"from t = {time:.4g} s: the clock comes to rest nowhere")

    def stops_after(self, time: float) -> Iterator[StoppedPlan]:
        """Yield the plan stopped after increasing delays from a time [s], and at its own rests.

        Rests while tensions change, or before the chords of a swap have met, are left out.
        """
        rests = self.motion.drones.breaks[rest_breaks(self.motion)]
        candidates = [(start, False) for start in time + DELAYS if start < self.motion.duration]
        candidates += [(rest, True) for rest in rests if rest >= time - JOINT]
        for start, is_rest in sorted(candidates):
            stop = until_stop(self.motion, float(start), stop=not is_rest)
            motion = append_motion(stop.motion, resting(stop.motion, HOLD))
            checks = [check_of(RULE_OF[name], motion) for name in REST_CHECKS]
            if all(check is None or check.holds for check in checks):
                yield stop

    def _origin(self, stop: StoppedPlan, how: str) -> float | None:
        """Return the plan time [s] from which to continue; None if a later stop is needed."""
        time = stop.rest
        if how == "hold":
            return time
        if how == "back":  # to the last time with free cables in all groups, or to the start
            groups = [each for each in self.motion.groups if each.motion.has_cables]
            if not groups:
                return 0.0
            while (free := min(min(time, _free_before(each, time).end) for each in groups)) < time:
                time = free
            return time
        origins = set[float | None]()
        for plan, part in zip(self.motion.groups, stop.motion.groups, strict=True):
            if part.motion.phases[-1].state not in TRANSIENT_STATES:
                origins.add(_clear_of_objects(plan.motion, time))
            else:
                later = (phase for phase in plan.motion.phases if phase.end > time + JOINT)
                starts = (phase.start for phase in later if phase.state not in TRANSIENT_STATES)
                origins.add(next(starts, plan.motion.duration))
        # Groups share one clock: several groups must land from the same rest
        return origins.pop() if len(self.motion.groups) == 1 or origins == {time} else None

    def _continuation(self, stop: StoppedPlan, how: str, origin: float) -> Motion:
        """Return the stopped plan continued from a plan time [s], not yet certified."""
        whole, time = stop.motion, stop.rest
        if abs(origin - time) > JOINT:
            player = Player(self.motion, time, 0.0)
            player.seek(origin)
            whole = append_motion(whole, on_clock(self.motion, player.ahead))
        groups = iter(self.motion.groups)

        def continued(motion: Motion) -> Motion:
            group = next(groups)
            if how in ("hold", "back"):
                phase = _free_before(group, origin) if how == "back" else None
                return append_motion(motion, resting(motion, HOLD, phase))
            try:
                return _with_landing(motion, untie=how == "release_and_land")
            except InfeasibleError as error:
                raise error.of_group(group.name) from None

        return whole.each_group(continued)


def _clear_of_objects(motion: Motion, time: float) -> float | None:
    """Return a plan time [s] without an enclosed object from which a hitch can land.

    It is ``time``, or one of the plan's rests; None if a later stop is needed.
    """
    enclosed = _enclosed_object(motion, time)
    if enclosed is None:
        return time
    rests: list[float] = motion.drones.breaks[rest_breaks(motion)].tolist()
    clear = [rest for rest in rests if _enclosed_object(motion, rest) is None]
    earlier, is_later = [rest for rest in clear if rest < time], max(clear, default=0.0) > time
    if earlier:
        poses = motion.poses.at(np.array([earlier[-1], time]))[:, enclosed]
        if np.max(np.abs(poses[1] - poses[0])) <= REST_DRIFT or not is_later:
            return earlier[-1]
    return None if is_later else time


def _free_before(group: Group, time: float) -> Phase:
    """Return the last phase of a group, not after a plan time [s], in which cables hang free.

    Without cables, that is the phase at this time.
    """
    for phase in reversed(group.motion.phases):
        is_free = phase.state in (CableState.FREE, CableState.GROUND, CableState.NONE)
        if phase.start < time + JOINT and is_free:
            return phase
    cables = f"cables of {group.name}" if group.name else "cables"
    reason = f"back from t = {time:.4g} s: {cables} have not hung free before"
    raise _refusal(reason, "choose hold, land or release_and_land")


def _enclosed_object(motion: Motion, time: float) -> int | None:
    """Return the index of an object that a group's hitch encloses below the object's top."""
    phase = next(p for p in reversed(motion.phases) if p.start < time + JOINT)
    if not (motion.requirements.objects and phase.formed and motion.team.layout.closed):
        return None
    vertices, poses = motion.vertices.at(time), motion.poses.at(time)
    for index, body in enumerate(motion.requirements.objects.values()):
        height = body.upper if body.rim is None else max(body.upper, body.rim.height)
        top = in_world(poses[index], np.append(body.section.centroid, height))
        offsets = (vertices - top)[:, :2] @ [1.0, 1.0j]
        inside = np.all((np.roll(offsets, -1) * offsets.conj()).imag < 0.0)  # convex and clockwise
        if not body.fixed and inside and np.min(vertices[:, 2]) < top[2]:
            return index
    return None


def until_stop(motion: Motion, time: float, *, stop: bool = True) -> StoppedPlan:
    """Return the plan until its clock has stopped, as soon as possible from a time [s] on.

    Without ``stop``, the time is a rest of the plan, which ends there. The result has no limit on
    its duration.
    """
    whole, player, parts = motion.untimed, Player(motion, time), list[Motion]()
    seconds = player.pause() if stop else 0.0
    clock = player.ahead
    player.step(seconds)
    if len(clock) and not np.any(clock.jets[0, 2:]):  # the first phase is at the plan's own rate
        time += float(clock.duration[0])
        clock = clock.select(slice(1, None))
    if time > JOINT:
        parts.append(truncated(whole, time))
    if len(clock):
        parts.append(on_clock(whole, clock))
    motion = reduce(append_motion, parts or [resting(whole, HOLD, first=True)])
    return StoppedPlan(time, float(np.sum(clock.duration)), player.time, motion)


def _refusal(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")


def _with_landing(whole: Motion, *, untie: bool) -> Motion:
    """Return a plan at rest with a landing, after untying the hitch if ``untie`` is set."""
    if not whole.phases[-1].formed:
        return _extended(whole, straight_down(whole))
    hitch = _hitch_at_end(whole)
    state = RestState(whole.team, hitch.drones, hitch, _turning_senses(whole))
    need = replace(whole.requirements, objects=objects_at(whole, -1)).with_reserve
    task = StepTask(state, whole.phases[-1].step + 1, need)
    if untie:
        released = _extended(whole, Release().plan(task).motion)
        return _extended(released, straight_down(released))
    return _extended(whole, _descent(hitch, need, task.index))


def _descent(hitch: Hitch, requirements: Requirements, index: int) -> Motion:
    """Return the vertical descent of a hitch until its lowest drones are on the ground."""
    altitude = hitch.altitude - (float(np.min(hitch.drones[:, 2])) - requirements.floor)
    return vertical_motion(hitch, altitude, requirements, Phase("land", index, 0.0, 0.0))


def _hitch_at_end(whole: Motion) -> Hitch:
    """Return the hitch at rest at the end of a motion; raises InfeasibleError if there is none."""
    try:
        return final_hitch(whole)
    except HitchoptError:
        reason = "legs differ from those of a hitch at rest, from which steps start"
        remedy = "abort earlier or later, or choose hold or back"
        when = f"at rest at t = {whole.duration:.4g} s"
        raise InfeasibleError([], f"{when}: {reason}; {remedy}") from None


def _extended(whole: Motion, motion: Motion) -> Motion:
    """Return two motions in a row, with objects staying where the first one leaves them."""
    return append_motion(whole, with_last_poses(whole, motion))


def straight_down(whole: Motion) -> Motion:
    """Return the vertical landing of drones without a hitch, from the end of a motion."""
    team, need = whole.team, replace(whole.requirements, objects=objects_at(whole, -1))
    drones, index = whole.drones.coefficients[-1, ..., -1], whole.phases[-1].step + 1
    ground = drones * [1.0, 1.0, 0.0] + [0.0, 0.0, need.floor]
    flight = straight_lines(team, need.limits.with_reserve, drones, ground)
    state = CableState.GROUND if team.has_cables else CableState.NONE
    return stage("land", flight, team, need, index, state)


def _turning_senses(whole: Motion) -> Array | None:
    """Return the senses in which pairs turned to form the hitch (clasps,): 1 if q rose first."""
    layout, phases = whole.team.layout, whole.phases
    pairs = enumerate(pairwise(phases))
    laid = [i for i, (a, b) in pairs if a.state is CableState.LAYING and b.formed]
    tying = next((phase for phase in phases if phase.state is CableState.CLASPING), None)
    if laid:  # after laying and a rest the pairs roll: the upper drones descend
        tying = phases[laid[0] + 2]
    if tying is None:
        return None
    heights = whole.drones.at(0.5 * (tying.start + tying.end))[:, 2]
    above = heights[2 * layout.ahead] >= heights[2 * layout.behind + 1]
    return np.where(above == (not laid), 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class AbortTable:
    """Certified aborts from all times of a plan."""

    how: str
    entries: tuple[Abort, ...]  # by start; between two the plan runs on to the later one
    end: float  # of the plan [s]

    @property
    def missing(self) -> list[tuple[float, float]]:
        """Spans of time [s] without an abort."""
        last = self.entries[-1].start if self.entries else 0.0
        return [(last, self.end)] if not self.entries or last < self.end - JOINT else []

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        starts = [0.0, *(entry.start for entry in self.entries)]
        rests = [entry.start + entry.seconds for entry in self.entries]
        return max((b - a for a, b in zip(starts, rests, strict=False)), default=float("inf"))


def abort_table(
    motion: Motion, how: str, every: float = DEFAULT_INTERVAL, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all times of a plan, with an entry about ``every`` [s] of plan time."""
    every, aborts, end = positive("every", every), Aborts(motion), motion.duration
    entries, time = list[Abort](), 0.0
    with suppress(InfeasibleError):
        while not entries or entries[-1].start < end - JOINT:
            if progress is not None:
                progress(f"{how} from t = {time:.4g} s")
            entries.append(aborts.plan(time, how))
            time = min(entries[-1].start + every, end)
    return AbortTable(how, tuple(entries), end)


def save_aborts(directory: Path | str, table: AbortTable) -> Path:
    """Write ``aborts.json`` and ``aborts.zip``, a plan file per entry, next to a plan."""
    names = [f"{table.how}_{i:03d}.npz" for i in range(len(table.entries))]
    rows = [
        {key: getattr(entry, key) for key in ("start", "seconds", "rest")}
        | {"ends": entry.motion.duration, "plan": name}
        for entry, name in zip(table.entries, names, strict=True)
    ]
    content = {
        "format": "hitchopt-aborts/1",
        "how": table.how,
        "longest": table.longest if rows else None,
        "missing": [list(span) for span in table.missing],
        "entries": rows,
    }

    def write_plans(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive, tempfile.TemporaryDirectory() as scratch:
            for entry, name in zip(table.entries, names, strict=True):
                file = Path(scratch) / name
                write_plan(file, entry.motion, f"{table.how} at {entry.start:g} s")
                archive.writestr(zipfile.ZipInfo(name), file.read_bytes())

    writers = {ABORTS: lambda path: write_strict_json(path, content), ABORT_PLANS: write_plans}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)
