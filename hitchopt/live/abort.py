"""Aborts: a certified continuation of a plan from the moving state at any time.

A command stops the plan's clock; what follows is a rest, the plan backward, or a landing that the
steps plan. Where the certificate refuses that, a later stop is tried. A hitch that is around an
object cannot be lowered or untied: it lands from one of the plan's own rests at which it is around
none. That is ahead where the object has been moved, as it is set down there, and behind where it
has not been lifted yet.
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
from hitchopt.motion.chapters import chapters
from hitchopt.motion.motion import FREE_STATES, JOINT, CableState, Group, Motion, Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import (
    append_motion,
    before,
    on_clock,
    rest_breaks,
    resting,
    with_last_poses,
)
from hitchopt.motion.states import final_hitch
from hitchopt.objects.placing import STILL, in_world
from hitchopt.planners.forming.joining import landed
from hitchopt.planners.forming.stages import stage, straight_lines
from hitchopt.steps import Release
from hitchopt.steps.certified_motions import infeasible_error
from hitchopt.steps.step import RestState, StepTask
from hitchopt.steps.tying import vertical_motion
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.values import Array, check_choice, nonnegative, positive

How = Literal["hold", "back", "release_and_land", "land"]

HOLD = 1.0  # time at rest at the end of a hold [s]
EVERY = 2.0  # usual distance of the entries of a table [s]

# Delays of the clock's stops that are tried [s]. Besides, the plan's own rests are: legs that lean
# stand straight there
DELAYS = np.cumsum([0.0, *0.1 * 1.5 ** np.arange(7)])

# States between hanging and hitched cables, that nothing but the clock leads out of
PASSING = FREE_STATES - {CableState.FREE, CableState.GROUND} | {CableState.ROLLING}

LAYING = CableState.LAYING

# Checks that refuse rests while tensions rise or fall, or before the chords of a swap have met
RESTS = ("tension", "interlacing")


@dataclass(frozen=True, eq=False)
class Stopped:
    """A plan up to a rest."""

    start: float  # plan time at which the clock begins to slow down [s]
    seconds: float  # time from there to the rest [s]
    rest: float  # plan time at the rest [s]
    motion: Motion


@dataclass(frozen=True, eq=False)
class Abort(Stopped):
    """A plan that comes to rest, and whose motion goes on from there, with its certificate."""

    certificate: Certificate


class Aborts:
    """The aborts of one plan."""

    def __init__(self, motion: Motion) -> None:
        self.others = motion.others  # who fly on, whatever this plan's clock does
        self.motion = motion.replaced(others=()) if motion.others else motion

    def plan(self, time: float, how: str) -> Abort:
        """Return the first abort for a command at a plan time [s], as ``Plan.abort`` explains."""
        check_choice("how", how, get_args(How))
        if nonnegative("t", time) > self.motion.duration:
            raise InputError("t", time, f"within {self.motion.duration:g} s", "ask within the plan")
        refusal: InfeasibleError | None = None
        for stopped in self.stopped(time):
            origin = self._origin(stopped, how)
            if origin is None:
                continue
            try:
                motion = self._continued(stopped, how, origin).replaced(others=self.others)
                certificate = certify(motion)
                if not certificate.certified:
                    raise infeasible_error(certificate, motion)
            except InfeasibleError as error:
                refusal = refusal or error
            else:
                return Abort(stopped.start, stopped.seconds, stopped.rest, motion, certificate)
        raise refusal or _refused(f"from t = {time:.4g} s: the clock comes to rest nowhere")

    def stopped(self, time: float) -> Iterator[Stopped]:
        """Yield the plan stopped from a time [s] on, at first and later, and at its own rests.

        Where tensions change, or chords of a swap have not met, there is no rest.
        """
        still = self.motion.drones.breaks[rest_breaks(self.motion)]
        options = [(begin, False) for begin in time + DELAYS if begin < self.motion.duration]
        options += [(each, True) for each in still if each >= time - JOINT]
        for begin, resting_there in sorted(options):
            stop_plan = until_stop(self.motion, float(begin), stop=not resting_there)
            held = append_motion(stop_plan.motion, resting(stop_plan.motion, HOLD))
            checks = [check_of(RULE_OF[name], held) for name in RESTS]
            if all(check is None or check.holds for check in checks):
                yield stop_plan

    def _origin(self, stopped: Stopped, how: str) -> float | None:
        """Return the plan time [s] from which to go on; None if a later stop is needed."""
        time = stopped.rest
        if how == "hold":
            return time
        if how == "back":
            return self._all_free_before(time)
        each = zip(self.motion.groups, stopped.motion.groups, strict=True)
        origins = {_landing_from(own.motion, time, there.motion) for own, there in each}
        # Groups have one clock: of several each lands from the rest, or a later one
        return origins.pop() if len(self.motion.groups) == 1 or origins == {time} else None

    def _all_free_before(self, time: float) -> float:
        """Return the last plan time [s], up to one, at which the cables of all groups hang free.

        Without cables, that is the time at which the plan begins.
        """
        groups = [each for each in self.motion.groups if each.motion.has_cables]
        if not groups:
            return 0.0
        while (free := min(min(time, _free_before(each, time).end) for each in groups)) < time:
            time = free
        return time

    def _continued(self, stopped: Stopped, how: str, origin: float) -> Motion:
        """Return the continuation of a plan at rest from a plan time [s], not certified yet."""
        whole, time = stopped.motion, stopped.rest
        if abs(origin - time) > JOINT:
            player = Player(self.motion, time, 0.0)
            player.seek(origin)
            whole = append_motion(whole, on_clock(self.motion, player.ahead))
        planned = iter(self.motion.groups)

        def of_group(own: Motion) -> Motion:
            here = next(planned)
            if how in ("hold", "back"):
                phase = _free_before(here, origin) if how == "back" else None
                return append_motion(own, resting(own, HOLD, phase))
            try:
                return _landed(own, untied=how == "release_and_land")
            except InfeasibleError as error:
                raise error.of_group(here.name) from None

        return whole.each_group(of_group)


def _landing_from(motion: Motion, time: float, stopped: Motion) -> float | None:
    """Return the plan time [s] from which a group lands; None if a later stop is needed."""
    if stopped.phases[-1].state not in PASSING:
        return _clear_of_objects(motion, time)
    after = (phase for phase in motion.phases if phase.end > time + JOINT)
    free = (phase.start for phase in after if phase.state not in PASSING)
    return next(free, motion.duration)  # of a hitch that is being untied


def _clear_of_objects(motion: Motion, time: float) -> float | None:
    """Return the time, or the rest from which a hitch lands that is around an object then."""
    around = _around(motion, time)
    if around is None:
        return time
    still: list[float] = motion.drones.breaks[rest_breaks(motion)].tolist()
    outside = [each for each in still if _around(motion, each) is None]
    behind, ahead = [each for each in outside if each < time], max(outside, default=0.0) > time
    if behind:
        poses = motion.object_poses.at(np.array([behind[-1], time]))[:, around]
        if np.max(np.abs(poses[1] - poses[0])) <= STILL or not ahead:
            return behind[-1]
    return None if ahead else time


def _free_before(group: Group, time: float) -> Phase:
    """Return the last phase of a group, up to a plan time [s], in which cables hang free.

    Without cables, that is the phase then.
    """
    for phase in reversed(group.motion.phases):
        free = phase.state in (CableState.FREE, CableState.GROUND, CableState.NONE)
        if phase.start < time + JOINT and free:
            return phase
    cables = f"cables of {group.name}" if group.name else "cables"
    words = f"back from t = {time:.4g} s: {cables} have not hung free before"
    raise _refused(words, "choose hold, land or release_and_land")


def _around(motion: Motion, time: float) -> int | None:
    """Return the index of an object that a group's hitch goes around, below its top."""
    phase = next(p for p in reversed(motion.phases) if p.start < time + JOINT)
    if not (motion.requirements.objects and phase.formed and motion.team.layout.closed):
        return None
    vertices, poses = motion.vertices.at(time), motion.object_poses.at(time)
    for index, body in enumerate(motion.requirements.objects.values()):
        top = body.upper if body.rim is None else max(body.upper, body.rim.height)
        middle = in_world(poses[index], np.append(body.section.centroid, top))
        away = (vertices - middle)[:, :2] @ [1.0, 1.0j]
        inside = np.all((np.roll(away, -1) * away.conj()).imag < 0.0)  # convex and clockwise
        if not body.fixed and inside and np.min(vertices[:, 2]) < middle[2]:
            return index
    return None


def until_stop(motion: Motion, time: float, *, stop: bool = True) -> Stopped:
    """Return the plan until its clock has stopped as soon as it can from a time [s] on.

    With no stop it ends at that time, a rest of its own. It has no limit on its duration.
    """
    whole, player, parts = motion.untimed, Player(motion, time), list[Motion]()
    until = player.pause() if stop else 0.0
    clock = player.ahead
    player.step(until)
    if len(clock) and not np.any(clock.jets[0, 2:]):  # the plan runs on, at its own rate
        time += float(clock.duration[0])
        clock = clock.select(slice(1, None))
    if time > JOINT:
        parts.append(before(whole, time))
    if len(clock):
        parts.append(on_clock(whole, clock))
    motion = reduce(append_motion, parts or [resting(whole, HOLD, first=True)])
    return Stopped(time, float(np.sum(clock.duration)), player.time, motion)


def _refused(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")


def _landed(whole: Motion, *, untied: bool) -> Motion:
    """Return a plan at rest followed by steps that bring it to the ground, untied first or not."""
    if whole.changes:
        return append_motion(whole, _landing_of_chapter(whole, untied=untied))
    if not whole.phases[-1].formed:
        return _followed_by(whole, straight_down(whole))
    need = whole.requirements
    hitch = _hitch_at_end(whole)
    state = RestState(whole.team, hitch.drones, hitch, _senses(whole))
    task = StepTask(state, whole.phases[-1].step + 1, _requirements_after(whole).with_reserve)
    if untied:
        released = _followed_by(whole, Release().plan(task).motion)
        return _followed_by(released, straight_down(released))
    return _followed_by(whole, _lowered(hitch, task, need.floor))


def _landing_of_chapter(whole: Motion, *, untied: bool) -> Motion:
    """Return the motion in which the last ring of a plan and who waits land, the ring still tied.

    How its pairs are tied is known to the plan's certificate alone, so none is untied.
    """
    ring, need = chapters(whole)[-1].groups[0].motion, whole.requirements
    index, formed = whole.phases[-1].step + 1, ring.phases[-1].formed
    if untied and formed:
        words = f"at t = {whole.duration:.4g} s: a hitch whose robots change is not untied"
        raise _refused(words, "choose land, hold or back")
    if formed:
        hitch = _hitch_at_end(ring)
        state = RestState(ring.team, hitch.drones, hitch)
        down = _lowered(hitch, StepTask(state, index, need.with_reserve), need.floor)
    else:
        down = straight_down(ring)
    end = whole.drones.coefficients[-1, ..., -1].reshape(-1, 2, 3)
    waiting = {robot: end[robot] for robot, _ in whole.phases[-1].waiting}
    return landed(down, whole.team, waiting, need)


def _lowered(hitch: Hitch, task: StepTask, floor: float) -> Motion:
    """Return the motion straight down of a hitch until its lowest drones are on the ground."""
    lower = hitch.altitude - (float(np.min(hitch.drones[:, 2])) - floor)
    motion = vertical_motion(hitch, lower, "land", task)
    return motion.replaced(phases=tuple(replace(phase, remark="") for phase in motion.phases))


def _hitch_at_end(whole: Motion) -> Hitch:
    """Return the hitch at rest in which a motion ends; InfeasibleError where it is none."""
    try:
        return final_hitch(whole)
    except HitchoptError:
        words = "legs differ from those of a hitch at rest, from which steps start"
        remedy = "abort earlier or later, or choose hold or back"
        when = f"at rest at t = {whole.duration:.4g} s"
        raise InfeasibleError([], f"{when}: {words}; {remedy}") from None


def _followed_by(whole: Motion, motion: Motion) -> Motion:
    """Return two motions in a row, objects staying where the first one leaves them."""
    return append_motion(whole, with_last_poses(whole, motion))


def straight_down(whole: Motion) -> Motion:
    """Return the landing of drones without a hitch, from where a motion ends."""
    team, need = whole.team, _requirements_after(whole)
    drones, index = whole.drones.coefficients[-1, ..., -1], whole.phases[-1].step + 1
    down = drones * [1.0, 1.0, 0.0] + [0.0, 0.0, need.floor]
    flight = straight_lines(team, need.limits.with_reserve, drones, down)
    state = CableState.GROUND if team.has_cables else CableState.NONE
    return stage("land", flight, team, need, index, state)


def _requirements_after(whole: Motion) -> Requirements:
    """Return a plan's requirements with objects standing where it ends."""
    need = whole.requirements
    poses = whole.object_poses.coefficients[-1, ..., -1]
    objects = {
        name: replace(body, at=pose[:3], yaw=float(np.arctan2(pose[4], pose[3])))
        for pose, (name, body) in zip(poses, need.objects.items(), strict=True)
    }
    return replace(need, objects=objects)


def _senses(whole: Motion) -> Array | None:
    """Return how pairs have turned to form the hitch (clasps,): 1 where q went up first."""
    layout, phases = whole.team.layout, whole.phases
    laid = [i for i, (a, b) in enumerate(pairwise(phases)) if a.state is LAYING and b.formed]
    tied = next((phase for phase in phases if phase.state is CableState.CLASPING), None)
    if laid:  # after a rest on one another the pairs roll: those above go down
        tied = phases[laid[0] + 2]
    if tied is None:
        return None
    heights = whole.drones.at(0.5 * (tied.start + tied.end))[:, 2]
    above = heights[2 * layout.ahead] >= heights[2 * layout.behind + 1]
    return np.where(above == (not laid), 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class AbortTable:
    """Certified aborts over all of a plan."""

    how: str
    entries: tuple[Abort, ...]  # by start: from between two the plan runs on to the later one
    end: float  # of the plan [s]

    @property
    def missing(self) -> list[tuple[float, float]]:
        """Spans of time [s] without an abort."""
        last = self.entries[-1].start if self.entries else 0.0
        return [(last, self.end)] if not self.entries or last < self.end - JOINT else []

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        begins = [0.0, *(entry.start for entry in self.entries)]
        rests = [entry.start + entry.seconds for entry in self.entries]
        return max((b - a for a, b in zip(begins, rests, strict=False)), default=float("inf"))


def abort_table(
    motion: Motion, how: str, every: float = EVERY, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all of a plan, about ``every`` [s] of plan time apart."""
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
        with zipfile.ZipFile(path, "w") as archive, tempfile.TemporaryDirectory() as place:
            for entry, name in zip(table.entries, names, strict=True):
                file = Path(place) / name
                write_plan(file, entry.motion, f"{table.how} at {entry.start:g} s")
                archive.write(file, name)

    writers = {ABORTS: lambda path: write_strict_json(path, content), ABORT_PLANS: write_plans}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)
