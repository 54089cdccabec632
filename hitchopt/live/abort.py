"""Aborts: a certified continuation of a plan from the moving state at any time.

A command stops the plan's clock; what follows is the plan backward, or a landing that the steps
plan. A hitch that is around an object cannot be lowered or untied: it lands from one of the plan's
own rests at which it is around none. That is ahead where the object has been moved, as it is set
down there, and behind where it has not been lifted yet.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.stops import SWITCH, StopTable, stop_phases
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, Progress
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.live.player import Player
from hitchopt.motion.final_hitch import final_hitch
from hitchopt.motion.loads import stated_tensions
from hitchopt.motion.motion import JOINT, CableState, HoldBy, Motion, Phase
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.motion.retiming import (
    SHORTEST,
    before,
    beside_objects,
    followed,
    resting,
    rests,
    retimed,
)
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL, in_world
from hitchopt.planners.forming.turns import straight
from hitchopt.steps import Land, Release
from hitchopt.steps.certified_motions import Certified, infeasible, lifted
from hitchopt.steps.step import Situation, StepTask
from hitchopt.storage.archive import opened_zip, read_members
from hitchopt.storage.files import parsed_json, replace_files, write_strict_json
from hitchopt.trajectory.piecewise import SAME_BREAK
from hitchopt.values import Array, choice, not_negative, positive

How = Literal["hold", "back", "release_and_land", "land"]

WAYS: tuple[How, ...] = get_args(How)

LANDINGS = ("release_and_land", "land")
"""Those of them that end on the ground."""

HOLD = 1.0
"""[s] Time at rest at the end of a hold."""

APART, FARTHER = 0.1, 1.5
"""[s] The clock's stops that are tried first are at least so far apart, and how many times farther
each time one is refused."""

TRIES = 8
"""Number of the clock's stops from which a continuation is tried; later ones begin where the plan
is at rest by itself: legs that lean against friction stand straight there."""

PASSING = frozenset({CableState.CLASPING, CableState.TIGHTENING})
"""States between hanging and hitched cables, that nothing but the clock leads out of."""

OBSTACLES = ("keep_out", "object_clearance")
"""Checks that are looked at before the others: most landings that are refused break them."""

EVERY = 2.0
"""[s] Usual distance of the entries of a table."""

FORMAT = "hitchopt-aborts/1"

SAME, SAMES = 1e-7, 33
"""[m] Drones of an entry that is read fly the plan within this until it begins, at so many times.
"""


@dataclass(frozen=True, eq=False)
class Stopped:
    """A plan that has come to rest.

    Attributes
    ----------
    motion: the plan up to the rest.
    start: plan time at which the clock begins to slow down [s].
    seconds: time from there to the rest [s].
    time: plan time at the rest [s].
    """

    motion: Motion
    start: float
    seconds: float
    time: float


@dataclass(frozen=True, eq=False)
class Abort:
    """A plan with a certified continuation.

    Attributes
    ----------
    start, seconds, rest: as of Stopped, its ``time`` being the rest.
    certified: the whole motion with its certificate.
    """

    start: float
    seconds: float
    rest: float
    certified: Certified


class Aborts:
    """The aborts of one plan: what they have in common is computed once.

    Parameters
    ----------
    motion: the plan.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.player = Player(motion)

    @cached_property
    def stops(self) -> StopTable:
        """The stops of the common clock that polynomials follow.

        Those whose clock's jerk jumps a little before or after a break of the plan are left out:
        pieces so short suffer from rounding, and longer ones do not follow a jump of the jerk.
        """
        table, breaks = self.player.stops, self.motion.drones.breaks
        jumps = np.stack([table.starts, table.starts + SWITCH * table.durations])
        later = np.clip(np.searchsorted(breaks, jumps), 1, len(breaks) - 1)
        away = np.minimum(np.abs(jumps - breaks[later - 1]), np.abs(jumps - breaks[later]))
        clear = np.all((away <= SAME_BREAK) | (away > SHORTEST), axis=0)
        return StopTable(table.end, table.starts[clear], table.durations[clear])

    def found(self, time: float, how: str) -> Abort:
        """Return the first abort for a command at a plan time [s], as ``Plan.abort`` explains.

        Raises
        ------
        InputError: a time outside the plan, or another word.
        InfeasibleError: no such continuation was found; says what binds.
        """
        choice("how", how, WAYS)
        if not_negative("t", time) > self.motion.duration:
            raise InputError("t", time, f"within {self.motion.duration:g} s", "ask within the plan")
        refusal: InfeasibleError | None = None
        for stopped, origin in self._tries(time, how):
            try:
                certified = self.continued(stopped, how, origin)
            except InfeasibleError as error:
                refusal = refusal or error
            else:
                return Abort(stopped.start, stopped.seconds, stopped.time, certified)
        raise refusal or _refused(f"from t = {time:.4g} s: the clock comes to rest nowhere")

    def stopped(self, time: float, *, landing: bool = False) -> Iterator[Stopped]:
        """Yield the plan stopped after a time [s], at the first rest and at later ones.

        After TRIES stops of the clock only those follow at which the plan is at rest by itself.
        Left out are rests that the states of the cables do not allow, and those for a landing from
        which the plan has to go on until it has left an object.
        """
        starts, durations = self.stops.starts, self.stops.durations
        ahead = (starts >= time) & np.isfinite(durations)
        options = [
            (start + duration, start, duration)
            for start, duration in zip(starts[ahead], durations[ahead], strict=True)
        ]
        still = self.motion.drones.breaks[rests(self.motion)]
        options += [(each, each, 0.0) for each in still[still >= time - JOINT].tolist()]
        latest, tries = -np.inf, 0
        for rest, start, duration in sorted(options):
            if duration > 0.0 and (rest < latest + APART * FARTHER**tries or tries == TRIES):
                continue
            # A stop takes half of its duration of plan time.
            if landing and self._around(start + 0.5 * duration) == (True, np.inf):
                continue
            latest = rest
            found = self._stop(float(start), float(duration))
            if found is not None:
                tries += duration > 0.0
                yield found

    def _stop(self, start: float, duration: float) -> Stopped | None:
        """Return the plan stopped by the clock, unless its cables do not allow that.

        The chords of a swap must have met, and tensions must be those that are stated.
        """
        motion = self.motion
        whole, time = until_stop(motion, start, duration, HOLD)
        whole = replace(whole.untimed, assignment=motion.assignment)
        last = whole.phases[-1]
        if last.formed:
            tension, least = whole.tensions.coefficients[-1, :, -1], motion.team.tension
            most = least
            if last.hold is not None:  # which may ask for another tension
                least, most = stated_tensions(whole)[-1].T
            off = tension - np.clip(tension, least, most)
            if np.max(np.abs(off)) > RULE_OF["tension"].limit_of(motion):
                return None
        if last.state in PASSING:
            check = RULE_OF["interlacing"].check(followed(whole, resting(whole, HOLD)))
            if check is not None and not check.holds:
                return None
        return Stopped(whole, start, duration, time)

    def _tries(self, time: float, how: str) -> Iterator[tuple[Stopped, float | None]]:
        """Yield stops after a time [s], and the plan times from which to go on; None for there.

        Single drones that can land from no rest ahead go back: plans may end above each other.
        """
        landing, first = how in LANDINGS, None
        most = None if how != "back" else TRIES  # what hangs free later is not behind
        for stopped in islice(self.stopped(time, landing=landing), most):
            first = first or stopped
            around = self._around(stopped.time) if landing else None
            if around is None or not around[0]:
                yield stopped, None
            if around is not None and np.isfinite(around[1]):
                yield stopped, around[1]
        if landing and first is not None and not self.motion.team.has_cables:
            for back in APART * np.cumsum(FARTHER ** np.arange(TRIES)):
                if first.time > back:
                    yield first, first.time - float(back)

    def continued(self, stopped: Stopped, how: str, origin: float | None = None) -> Certified:
        """Return the certified continuation of a plan at rest, as ``continuation``."""
        whole = self.continuation(stopped, how, origin)
        if how in LANDINGS:
            breaks = whole.drones.breaks
            first = int(np.searchsorted(breaks, stopped.motion.duration - JOINT))
            ahead = whole.taken(slice(first, None), whole.overlapping(breaks[first], breaks[-1]))
            for check in (RULE_OF[name].check(ahead) for name in OBSTACLES):
                if check is not None and not check.holds:
                    raise infeasible(Certificate(whole.duration, (check,)), whole)
        certificate = certify(whole)
        if not certificate.certified:
            raise infeasible(certificate, whole)
        return Certified(whole, certificate)

    def continuation(self, stopped: Stopped, how: str, origin: float | None = None) -> Motion:
        """Return the continuation of a plan at rest, not certified yet.

        Parameters
        ----------
        origin: plan time to which the clock goes before it lands; None to land where it rests.

        Raises
        ------
        InfeasibleError: there is none.
        """
        whole, time = stopped.motion, stopped.time
        if how == "hold":
            return followed(whole, resting(whole, HOLD))
        if how == "back":
            origin, phase = self._last_free(time)
        elif whole.phases[-1].state in PASSING:
            origin = self._way_out(time)
        if origin is not None and abs(origin - time) > JOINT:
            whole = followed(whole, retimed(self.motion, self.player.path(time, origin)))
        if how == "back":
            return followed(whole, resting(whole, HOLD, phase))
        return _landed(whole, untied=how == "release_and_land")

    def _last_free(self, time: float) -> tuple[float, Phase]:
        """Return the plan time at which cables have hung free last, up to ``time``, and its phase.

        Without cables, that is where the plan begins.
        """
        first = self.motion.phases[0]
        if not self.motion.team.has_cables:
            return first.start, first
        begun = [phase for phase in self.motion.phases if phase.start < time + JOINT]
        for phase in reversed(begun):
            if phase.state in (CableState.FREE, CableState.GROUND):
                return min(time, phase.end), phase
        raise _refused(
            f"back from t = {time:.4g} s: cables have not hung free before",
            "choose hold, land or release_and_land",
        )

    def _way_out(self, time: float) -> float:
        """Return the plan time at which cables that are being tied or untied hang free again.

        Ahead where they are being untied, behind where they are being tied.
        """
        after = [phase for phase in self.motion.phases if phase.end > time + JOINT]
        following = next((phase for phase in after if phase.state not in PASSING), None)
        if following is None:
            return self.motion.duration
        return self._last_free(time)[0] if following.formed else following.start

    @cached_property
    def _outside(self) -> Array:
        """Plan times of the rests at which the hitch is around no object [s]."""
        objects = self.motion.requirements.objects
        still = self.motion.drones.breaks[rests(self.motion)].tolist() if objects else []
        return np.array([time for time in still if self._enclosed(time) is None])

    def _around(self, time: float) -> tuple[bool, float] | None:
        """Return whether a hitch holds what it is around at a plan time, and from when it lands.

        None where it is around nothing; infinity where the plan goes on until it has left it: what
        has been moved is set down ahead, and grips open otherwise than they close.
        """
        index = self._enclosed(time)
        if index is None:
            return None
        before, after = self._outside[self._outside < time], self._outside[self._outside > time]
        holds = [
            phase.hold.by
            for phase in self.motion.phases
            if phase.hold is not None and phase.start < time + JOINT < phase.end
        ]
        onward = HoldBy.GRIP in holds or not len(before)
        if not onward:
            poses = self.motion.object_poses.at(np.array([before[-1], time]))[:, index]
            onward = bool(np.max(np.abs(poses[1] - poses[0])) > STILL)
        behind = len(before) > 0 and not (onward and len(after))
        return bool(holds), float(before[-1]) if behind else np.inf

    def _enclosed(self, time: float) -> int | None:
        """Return the index of an object that the hitch is around."""
        motion = self.motion
        phase = next(p for p in reversed(motion.phases) if p.start < time + JOINT)
        if not (motion.requirements.objects and phase.formed and motion.team.layout.closed):
            return None
        vertices, poses = motion.vertices.at(time), motion.object_poses.at(time)
        for index, body in enumerate(motion.requirements.objects.values()):
            if not body.fixed and _encloses(vertices, poses[index], body):
                return index
        return None


def until_stop(motion: Motion, start: float, duration: float, hold: float) -> tuple[Motion, float]:
    """Return the motion until its clock has stopped, and the plan time of its rest [s].

    Parameters
    ----------
    start, duration: of the stop [s]; no duration where the motion is at rest.
    hold: how long it stays where it would not move at all [s].
    """
    parts, rest = [before(motion, start)] if start > JOINT else [], start
    if duration > 0.0:
        clock = stop_phases(np.array([start]), np.array([duration]))
        parts.append(retimed(motion, clock))
        rest = float(clock.ends[-1, 0])
    if not parts:
        parts = [resting(motion, hold, first=True)]
    return parts[0] if len(parts) == 1 else followed(*parts), rest


def _refused(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")


def _encloses(vertices: Array, pose: Array, body: SolidObject) -> bool:
    """Return whether a polygon of vertices (n, 3) [m] goes around an object, below its top."""
    top = body.upper if body.rim is None else max(body.upper, body.rim.height)
    middle = in_world(pose, np.append(body.section.centroid, top))
    away = (vertices - middle)[:, :2] @ [1.0, 1.0j]
    turned = np.sum(np.angle(np.roll(away, -1) * away.conj()))
    return bool(abs(turned) > np.pi and np.min(vertices[:, 2]) < middle[2])


def _landed(whole: Motion, *, untied: bool) -> Motion:
    """Return a plan at rest followed by steps that bring it to the ground, untied first or not.

    Raises
    ------
    InfeasibleError: there is no plan for it, or the hitch is not one that a step can start from.
    """
    drones, floor = whole.drones.coefficients[-1, ..., -1], whole.requirements.floor
    index, need = whole.phases[-1].step + 1, whole.requirements

    def on(first: Motion, motion: Motion) -> Motion:
        return followed(first, beside_objects(first, replace(motion, requirements=need)))

    if not whole.team.has_cables:
        down = drones.copy()
        down[:, 2] = floor
        flight = straight(whole.team, need.limits.planned, drones, down)
        phase = Phase("land", index, 0.0, flight.duration)
        return on(whole, Motion.single(whole.team, need, flight, [phase]))
    objects = dict(need.objects)
    poses = whole.object_poses.coefficients[-1, ..., -1]
    for pose, (name, body) in zip(poses, objects.items(), strict=True):
        objects[name] = replace(body, at=pose[:3], yaw=float(np.arctan2(pose[4], pose[3])))
    planned = replace(need, objects=objects).planned
    if not whole.phases[-1].formed:
        task = StepTask(Situation(whole.team, drones), index, planned)
        return on(whole, Land().plan(task).motion)
    try:
        hitch = final_hitch(whole)
    except HitchoptError:
        words = "legs stand otherwise than those of a hitch at rest, from which steps start"
        remedy = "abort earlier or later, or choose hold or back"
        when = f"at rest at t = {whole.duration:.4g} s"
        raise InfeasibleError([], f"{when}: {words}; {remedy}") from None
    task = StepTask(Situation(whole.team, hitch.drones, hitch, _senses(whole)), index, planned)
    if untied:
        release = Release().plan(task)
        landing = Land().plan(replace(task, before=release.after, index=index + 1))
        return on(on(whole, release.motion), landing.motion)
    lower = hitch.altitude - (float(np.min(drones[:, 2])) - floor)
    motion = lifted(hitch, lower, "land", task)
    return on(whole, motion.altered(phases=tuple(replace(p, remark="") for p in motion.phases)))


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
    """Certified aborts over all of a plan.

    Attributes
    ----------
    how: what they do.
    entries: by the time at which the clock begins to slow down: a command between two entries lets
        the plan run on to the later one.
    missing: spans of time [s], each from one entry to the next, from which no abort was found.
    """

    how: str
    entries: tuple[Abort, ...]
    missing: tuple[tuple[float, float], ...]

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        begins = [0.0, *(entry.start for entry in self.entries)]
        waits = [
            entry.start - begin + entry.seconds
            for begin, entry in zip(begins, self.entries, strict=False)
        ]
        return max(waits, default=float("inf"))


def abort_table(
    motion: Motion, how: str, every: float = EVERY, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all of a plan, about ``every`` [s] of plan time apart.

    Raises
    ------
    InputError: an unknown kind of abort, or a distance that is not positive.
    """
    every, aborts = positive("every", every), Aborts(motion)
    entries: list[Abort] = []
    time = 0.0
    while not entries or entries[-1].start < motion.duration - JOINT:
        if progress is not None:
            progress(f"{how} from t = {time:.4g} s")
        try:
            entries.append(aborts.found(time, how))
        except InfeasibleError:
            begin = entries[-1].start if entries else 0.0
            return AbortTable(how, tuple(entries), ((begin, motion.duration),))
        time = min(entries[-1].start + every, motion.duration)
    return AbortTable(how, tuple(entries), ())


def save_aborts(directory: Path | str, table: AbortTable) -> Path:
    """Write ``aborts.json`` and ``aborts.zip``, a plan file per entry, next to a plan.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    names = [f"{table.how}_{i:03d}.npz" for i in range(len(table.entries))]
    rows = [
        {
            "start": entry.start,
            "seconds": entry.seconds,
            "rest": entry.rest,
            "ends": entry.certified.motion.duration,
            "plan": name,
        }
        for entry, name in zip(table.entries, names, strict=True)
    ]
    content = {
        "format": FORMAT,
        "how": table.how,
        "longest": table.longest if rows else None,
        "missing": [list(span) for span in table.missing],
        "entries": rows,
    }

    def write_plans(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive, tempfile.TemporaryDirectory() as place:
            for entry, name in zip(table.entries, names, strict=True):
                file = Path(place) / name
                write_plan(file, entry.certified.motion, f"{table.how} at {entry.start:g} s")
                archive.write(file, name)

    writers = {ABORTS: lambda path: write_strict_json(path, content), ABORT_PLANS: write_plans}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)


def read_aborts(
    directory: Path, motion: Motion, progress: Progress | None = None
) -> AbortTable | None:
    """Return the table that stands next to a plan, certified anew; None where there is none.

    Raises
    ------
    FileError: it is damaged, not of this plan, or one of its entries is not certified.
    """
    source = directory / ABORTS
    if not source.exists():
        return None
    try:
        content = parsed_json(source.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        entries = []
        with (
            tempfile.TemporaryDirectory() as place,
            opened_zip(directory / ABORT_PLANS, "table of aborts") as archive,
        ):
            members = [archive.getinfo(str(each["plan"])) for each in content["entries"]]
            found = list(read_members(directory / ABORT_PLANS, archive, members))
            for given, data in zip(content["entries"], found, strict=True):
                if progress is not None:
                    progress(f"certifying {content['how']} at {float(given['start']):.4g} s")
                file = Path(place) / "plan.npz"
                file.write_bytes(data)
                entries.append(_entry(given, read_plan(file), motion))
        missing = tuple((float(a), float(b)) for a, b in content["missing"])
        return AbortTable(str(content["how"]), tuple(entries), missing)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"{source}: {error}; run hitchopt abort again") from error


def _entry(given: Mapping[str, Any], whole: Motion, motion: Motion) -> Abort:
    """Return an entry whose plan is the given one until its clock slows down, and is certified.

    Raises
    ------
    ValueError: it is another plan's, or not certified.
    """
    start, seconds, rest = (float(given[name]) for name in ("start", "seconds", "rest"))
    if not 0.0 <= start <= motion.duration + JOINT or whole.team.drones != motion.team.drones:
        raise ValueError(f"the entry at {start:g} s is of another plan")
    times = np.linspace(0.0, min(start, motion.duration), SAMES)
    places = [each.drones.at(times) for each in (whole, motion)]
    ends = whole.drones.at(min(start + seconds, whole.duration)), motion.drones.at(rest)
    if not all(np.allclose(a, b, rtol=0.0, atol=SAME) for a, b in (places, ends)):
        raise ValueError(f"the entry at {start:g} s does not fly this plan until then")
    whole = replace(whole, team=motion.team, requirements=motion.requirements.untimed)
    certificate = certify(whole)
    if not certificate.certified:
        broken = ", ".join(check.name for check in certificate.violated)
        raise ValueError(f"the entry at {start:g} s is not certified: {broken}")
    return Abort(start, seconds, rest, Certified(whole, certificate))
