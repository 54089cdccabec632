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
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import HitchoptError, InfeasibleError, InputError, Progress
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.hitch.requirements import Requirements
from hitchopt.live.player import Player
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import before, beside_objects, followed, resting, rests, retimed
from hitchopt.motion.states import final_hitch
from hitchopt.objects.placing import STILL, in_world
from hitchopt.planners.forming.stages import straight
from hitchopt.steps import Land, Release
from hitchopt.steps.certified_motions import infeasible, lifted
from hitchopt.steps.step import Situation, StepTask
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.values import Array, choice, not_negative, positive

How = Literal["hold", "back", "release_and_land", "land"]

LANDINGS = ("release_and_land", "land")
"""Aborts that end on the ground."""

HOLD = 1.0
"""[s] Time at rest at the end of a hold."""

APART, FARTHER, TRIES = 0.1, 1.5, 8
"""[s] Distance of the clock's first two stops that are tried, how many times farther each later
one is, and their number. Besides, the plan's own rests are: legs that lean stand straight there."""

PASSING = frozenset({CableState.CLASPING, CableState.TIGHTENING})
"""States between hanging and hitched cables, that nothing but the clock leads out of."""

RESTS = ("tension", "interlacing")
"""Checks that refuse rests while tensions rise or fall, or before the chords of a swap have met."""

EVERY = 2.0
"""[s] Usual distance of the entries of a table."""


@dataclass(frozen=True, eq=False)
class Stopped:
    """A plan up to a rest."""

    start: float
    """Plan time at which the clock begins to slow down [s]."""
    seconds: float
    """Time from there to the rest [s]."""
    rest: float
    """Plan time at the rest [s]."""
    motion: Motion


@dataclass(frozen=True, eq=False)
class Abort(Stopped):
    """A plan that comes to rest, and whose motion goes on from there, with its certificate."""

    certificate: Certificate


class Aborts:
    """The aborts of one plan: what they have in common is computed once."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion

    def found(self, time: float, how: str) -> Abort:
        """Return the first abort for a command at a plan time [s], as ``Plan.abort`` explains.

        Raises
        ------
        InputError: a time outside the plan, or another word.
        InfeasibleError: no such continuation was found; says what binds.
        """
        choice("how", how, get_args(How))
        if not_negative("t", time) > self.motion.duration:
            raise InputError("t", time, f"within {self.motion.duration:g} s", "ask within the plan")
        refusal = _refused(f"from t = {time:.4g} s: the clock comes to rest nowhere")
        for i, (stopped, origin) in enumerate(self._tries(time, how)):
            try:
                motion = self._continued(stopped, how, origin)
                certificate = certify(motion)
                if not certificate.certified:
                    raise infeasible(certificate, motion)
            except InfeasibleError as error:
                refusal = error if i == 0 else refusal
            else:
                known = stopped.start, stopped.seconds, stopped.rest
                return Abort(*known, motion, certificate)
        raise refusal

    def stopped(self, time: float) -> Iterator[Stopped]:
        """Yield the plan stopped from a time [s] on, at first and later, and at its own rests.

        Where tensions change, or chords of a swap have not met, there is no rest.
        """
        later = np.cumsum([0.0, *APART * FARTHER ** np.arange(TRIES - 1)])
        still = self.motion.drones.breaks[rests(self.motion)]
        options = [(begin, False) for begin in (time + later).tolist()]
        options += [(each, True) for each in still.tolist() if each >= time - JOINT]
        for begin, resting_there in sorted(options):
            if begin < self.motion.duration or resting_there:
                found = until_stop(self.motion, begin, stop=not resting_there)
                held = followed(found.motion, resting(found.motion, HOLD))
                looked = [RULE_OF[name].check(held) for name in RESTS]
                if all(check is None or check.holds for check in looked):
                    yield found

    def _tries(self, time: float, how: str) -> Iterator[tuple[Stopped, float]]:
        """Yield stops after a time [s], and the plan times to which the clock goes from there.

        Single drones that can land from no rest ahead go back: plans may end above each other.
        """
        first = None
        for i, stopped in enumerate(self.stopped(time)):
            if how == "back" and i == TRIES:  # what hangs free later is not behind
                return
            first = first or stopped
            origin = self._origin(stopped, how)
            if origin is not None:
                yield stopped, origin
        if how in LANDINGS and first is not None and not self.motion.team.has_cables:
            for back in APART * np.cumsum(FARTHER ** np.arange(TRIES)):
                if first.rest > back:
                    yield first, first.rest - float(back)

    def _origin(self, stopped: Stopped, how: str) -> float | None:
        """Return the plan time [s] from which to go on; None where a later stop has to be taken."""
        time = stopped.rest
        if how == "hold":
            return time
        if how == "back":
            return min(time, self._free_before(time).end)
        passing = stopped.motion.phases[-1].state in PASSING
        return self._passed(time) if passing else self._clear_of_objects(time)

    def _passed(self, time: float) -> float:
        """Return the plan time [s], ahead or before, at which cables that are passing hang free."""
        after = [phase for phase in self.motion.phases if phase.end > time + JOINT]
        following = next((phase for phase in after if phase.state not in PASSING), None)
        if following is None:
            return self.motion.duration
        return self._free_before(time).end if following.formed else following.start

    def _clear_of_objects(self, time: float) -> float | None:
        """Return the same of a hitch: where it is around no object, ahead if one has been moved."""
        around = self._around(time)
        if around is None:
            return time
        behind, ahead = self._outside[self._outside < time], self._outside[self._outside > time]
        if len(behind):
            poses = self.motion.object_poses.at(np.array([behind[-1], time]))[:, around]
            if np.max(np.abs(poses[1] - poses[0])) <= STILL or not len(ahead):
                return float(behind[-1])
        return None if len(ahead) else time

    def _free_before(self, time: float) -> Phase:
        """Return the last phase, up to a plan time [s], in which cables hang free.

        Without cables, that is the place where the plan begins.
        """
        first = self.motion.phases[0]
        if not self.motion.team.has_cables:
            return first.lasting(first.start, first.start)
        for phase in reversed(self.motion.phases):
            if phase.start < time + JOINT and phase.state in (CableState.FREE, CableState.GROUND):
                return phase
        raise _refused(
            f"back from t = {time:.4g} s: cables have not hung free before",
            "choose hold, land or release_and_land",
        )

    @cached_property
    def _outside(self) -> Array:
        """Plan times of the rests at which the hitch is around no object [s]."""
        still = self.motion.drones.breaks[rests(self.motion)].tolist()
        return np.array([time for time in still if self._around(time) is None])

    def _around(self, time: float) -> int | None:
        """Return the index of an object that the hitch goes around, below its top."""
        motion = self.motion
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

    def _continued(self, stopped: Stopped, how: str, origin: float) -> Motion:
        """Return the continuation of a plan at rest from a plan time [s], not certified yet."""
        whole, time = stopped.motion, stopped.rest
        if abs(origin - time) > JOINT:
            player = Player(self.motion, time, 0.0)
            player.seek(origin)
            whole = followed(whole, retimed(self.motion, player.ahead))
        if how in LANDINGS:
            return _landed(whole, untied=how == "release_and_land")
        phase = self._free_before(time) if how == "back" else None
        return followed(whole, resting(whole, HOLD, phase))


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
        clock = clock.taken(slice(1, None))
    if time > JOINT:
        parts.append(before(whole, time))
    if len(clock):
        parts.append(retimed(whole, clock))
    if not parts:
        parts.append(resting(whole, HOLD, first=True))
    found = parts[0] if len(parts) == 1 else followed(*parts)
    return Stopped(time, float(np.sum(clock.duration)), player.time, found)


def _refused(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")


def _landed(whole: Motion, *, untied: bool) -> Motion:
    """Return a plan at rest followed by steps that bring it to the ground, untied first or not."""
    team, need, index = whole.team, whole.requirements, whole.phases[-1].step + 1
    if not team.has_cables:
        return followed(whole, straight_down(whole))

    def on(first: Motion, motion: Motion) -> Motion:
        return followed(first, beside_objects(first, replace(motion, requirements=need)))

    drones, planned = whole.drones.coefficients[-1, ..., -1], _where_left(whole).planned
    if not whole.phases[-1].formed:
        task = StepTask(Situation(team, drones), index, planned)
        return on(whole, Land().plan(task).motion)
    try:
        hitch = final_hitch(whole)
    except HitchoptError:
        words = "legs stand otherwise than those of a hitch at rest, from which steps start"
        remedy = "abort earlier or later, or choose hold or back"
        when = f"at rest at t = {whole.duration:.4g} s"
        raise InfeasibleError([], f"{when}: {words}; {remedy}") from None
    task = StepTask(Situation(team, hitch.drones, hitch, _senses(whole)), index, planned)
    if untied:
        release = Release().plan(task)
        landing = Land().plan(replace(task, before=release.after, index=index + 1))
        return on(on(whole, release.motion), landing.motion)
    lower = hitch.altitude - (float(np.min(drones[:, 2])) - need.floor)
    motion = lifted(hitch, lower, "land", task)
    return on(whole, motion.altered(phases=tuple(replace(p, remark="") for p in motion.phases)))


def straight_down(whole: Motion) -> Motion:
    """Return the flight of single drones to the ground, below where a motion ends."""
    team, need = whole.team, whole.requirements
    drones = whole.drones.coefficients[-1, ..., -1]
    flight = straight(team, need.limits.planned, drones, drones * [1, 1, 0] + [0, 0, need.floor])
    step = whole.phases[-1].step + 1
    phase = Phase("land", step, 0.0, flight.duration, state=CableState.GROUND)
    return Motion.single(team, need, flight, [phase])


def _where_left(whole: Motion) -> Requirements:
    """Return a plan's requirements with objects standing where it has left them."""
    need = whole.requirements
    poses = whole.object_poses.coefficients[-1, ..., -1]
    objects = {
        name: replace(body, at=pose[:3], yaw=float(np.arctan2(pose[4], pose[3])))
        for pose, (name, body) in zip(poses, need.objects.items(), strict=True)
    }
    return replace(need, objects=objects)


def _senses(whole: Motion) -> Array | None:
    """Return how pairs have turned to form the hitch (clasps,): 1 where q went up first."""
    tied = [phase for phase in whole.phases if phase.state is CableState.CLASPING]
    if not tied:
        return None
    layout, first = whole.team.layout, tied[0]
    there = whole.drones.at(first.start + 0.5 * (first.end - first.start))
    above = there[2 * layout.ahead, 2] - there[2 * layout.behind + 1, 2]
    return np.where(above >= 0.0, 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class AbortTable:
    """Certified aborts over all of a plan."""

    how: str
    entries: tuple[Abort, ...]
    """Sorted by start: a command between two entries lets the plan run on to the later one."""
    end: float
    """The plan's end [s]."""

    @property
    def missing(self) -> list[tuple[float, float]]:
        """Spans of time [s] from which no abort was found."""
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
            entries.append(aborts.found(time, how))
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
