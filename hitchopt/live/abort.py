"""Certified aborts of a plan from the moving state at any time.

A command stops the plan's clock. The abort continues with a hold, with the plan backward, or with a
landing of its own. It is certified from a rest of the plan before the stop on: until the stop, it
is the plan. If that does not hold, a later stop is tried, up to the plan's next rest.
Where drones cannot land from any of these, as around an object, they continue, or fly back, to one
of the plan's rests from which they can, whichever lands first. No abort moves an object that is at
rest on its support at the time of the command.
"""

from __future__ import annotations

import tempfile
import zipfile
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial, reduce
from itertools import islice
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from hitchopt.checks import Certificate, Check, certify
from hitchopt.checks.arena import lowest_height
from hitchopt.checks.certifying import check_of
from hitchopt.checks.registry import RULE_OF, RULES
from hitchopt.checks.violations import infeasible_error
from hitchopt.directory import ABORT_PLANS, ABORTS
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, Progress
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import LANDING, Requirements
from hitchopt.live.player import Player
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import REST_RATE, Flight, TeamMotion
from hitchopt.motion.motion import JOINT, SHARE_TOLERANCE, Motion, Phase
from hitchopt.motion.plan_file import flight_digest, read_plan, write_plan
from hitchopt.motion.request import objects_at
from hitchopt.motion.retiming import append_motion, on_clock, resting, truncated, with_last_poses
from hitchopt.motion.states import final_hitch
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, in_world
from hitchopt.planners.along import vertical_motion
from hitchopt.planners.candidates import outcome
from hitchopt.planners.stages import stage, straight_lines
from hitchopt.planners.task import RestState, StepTask
from hitchopt.slices import provided
from hitchopt.storage.archive import READ_ERRORS
from hitchopt.storage.files import digest, file_bytes, parsed_json, replace_files, write_strict_json
from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.trajectory.piecewise import TIME_ROUNDING, on_breaks
from hitchopt.values import Array, check_choice, lazy, nonnegative, positive

How = Literal["hold", "back", "release_and_land", "land"]

FORMAT = "hitchopt-aborts/2"

HOLD = 1.0  # duration of the rest at the end of a hold [s]
DEFAULT_INTERVAL = 2.0  # default interval of the entries of a table [s]

# Candidate delays of the clock's stop [s]. The plan's own rests are candidates too: legs do not
# lean there
DELAYS = np.cumsum([0.0, *0.1 * 1.5 ** np.arange(7)])

# Checks that exclude rests while tensions change, or before the chords of a swap have met
REST_CHECKS = ("tension", "interlacing")

# Quick checks before all others, of the way to a rest, and with its continuation
WAY_CHECKS = ("thrust",)
QUICK_CHECKS = ("tension",)

KNOWN_STOPS = 64  # stops of a plan that are kept: those of one time serve all reactions


@dataclass(frozen=True, eq=False)
class StoppedPlan:
    """A plan up to a rest."""

    start: float  # plan time at which the clock starts to slow down [s]
    seconds: float  # time from there to the rest [s]
    rest: float  # plan time at the rest [s]
    flight: Flight


@dataclass(frozen=True, eq=False)
class Abort(StoppedPlan):
    """A plan that stops, and continues with a certified flight."""

    asked: float  # plan time of the command [s]

    @lazy
    def certificate(self) -> Certificate:
        """The certificate of the whole flight, which is computed when it is read."""
        return certify(self.flight)


@dataclass(frozen=True, eq=False)
class _Refused:
    """Why a continuation is refused."""

    error: InfeasibleError
    at_end: bool  # whether only what follows the way to a rest breaks limits


def aborted(flight: Flight, time: float, how: str) -> Abort:
    """Return the certified abort for a command at a plan time [s]; see ``Plan.abort``."""
    entry = Aborts(flight).plan(time, how)
    entry.certificate.raise_if_violated()
    return entry


class Aborts:
    """The aborts of one plan."""

    def __init__(self, flight: Flight) -> None:
        self.others = flight.others  # they fly on regardless of this plan's clock
        self.flight = flight.without_others.each_team(_in_haste)
        self._rests = self.flight.breaks[self.flight.rest_breaks]
        self._stopped = lru_cache(KNOWN_STOPS)(self._stop_at)

    def plan(self, time: float, how: str) -> Abort:
        """Return the first abort for a command at a plan time [s]; see ``Plan.abort``."""
        check_choice("how", how, get_args(How))
        if nonnegative("t", time) > self.flight.duration:
            raise InputError(
                "t", time, f"within {self.flight.duration:g} s", "choose a time within the plan"
            )
        planned = self._in_place if how in ("hold", "back") else self._landing
        found = planned(time, how)
        if isinstance(found, Abort):
            return found
        when = f"from t = {time:.4g} s: every route moves an object at rest on its support"
        raise found or _refusal(when, "abort earlier or later, or choose another abort")

    def find(self, time: float, how: str, saved: Abort | None = None) -> Abort | None:
        """Return ``saved`` if it holds, or else the first abort for a command [s]; None if refused.

        Raises InputError as ``plan``.
        """
        if saved is not None and self.holds(saved):
            return saved
        found = outcome(partial(self.plan, time, how))
        return found if isinstance(found, Abort) else None

    def _in_place(self, time: float, how: str) -> Abort | InfeasibleError | None:
        """Return the first hold, way back or landing that starts where a stop ends, or an error."""
        refusal: InfeasibleError | None = None
        for stop in self._stops(time, holdable=how != "back"):
            if how in ("land", "release_and_land") and not self._can_land(stop):
                continue
            origin = self._free_before(stop.rest) if how == "back" else stop.rest
            if moves_standing(self.flight, time, stop.rest, origin):
                continue
            found = self._attempt(time, stop, how, origin)
            if isinstance(found, Abort):
                return found
            refusal = refusal or found.error
        return refusal

    def _landing(self, time: float, how: str) -> Abort | InfeasibleError | None:
        """Return the landing from the first stop, or from the nearest rest around a later one."""
        fallback = self._in_place(time, how)
        if isinstance(fallback, Abort) and fallback.start <= time + JOINT:
            return fallback
        unsuited = set[float]()  # rests from which landings are refused
        for stop in self._stops(time, holdable=False):
            for rest in self._landing_rests(stop.rest):
                if rest in unsuited or moves_standing(self.flight, time, stop.rest, rest):
                    continue
                attempt = self._attempt(time, stop, how, rest, fallback)
                if isinstance(attempt, Abort):
                    return attempt
                fallback = fallback or attempt.error
                if attempt.at_end:
                    unsuited.add(rest)
        return fallback

    def _attempt(
        self, time: float, stop: StoppedPlan, how: str, origin: float, shorter: object = None
    ) -> Abort | _Refused:
        """Return the certified continuation of a stop from a plan time [s], or why there is none.

        It must be shorter than the abort ``shorter``.
        """
        most = shorter.flight.duration if isinstance(shorter, Abort) else np.inf
        way = outcome(partial(self._way, stop, origin))
        if isinstance(way, InfeasibleError):
            return _Refused(way, at_end=False)
        if violated := self._violated(way, stop.start, WAY_CHECKS):
            return _Refused(_error(violated, way), at_end=False)
        flight = outcome(partial(self._shorter_continuation, way, how, origin, most))
        if isinstance(flight, InfeasibleError):
            return _Refused(flight, at_end=True)
        violated = self._violated(flight, stop.start, QUICK_CHECKS)
        violated = violated or self._violated(flight, stop.start)
        if not violated:
            return Abort(stop.start, stop.seconds, stop.rest, flight, time)
        at_end = all(check.time > way.duration + JOINT for check in violated)
        return _Refused(_error(violated, flight), at_end)

    def _violated(self, flight: Flight, start: float, names: Sequence[str] = ()) -> list[Check]:
        """Return the violated checks, all or those of some names, from a rest of the plan on.

        It is the last one before the clock slows down [s]. Rules of whole motions, such as how
        swaps interlace cables, are checked from the plan's start on.
        """
        first = min(start + JOINT, flight.duration - JOINT)
        rest = float(self._rests[self._rests <= first][-1])
        part = flight.between(rest, flight.duration)
        wanted = [RULE_OF[name] for name in names] if names else RULES
        whole = {rule.name: rule for rule in wanted if rule.whole}
        if names:
            partly = [check_of(rule, part) for rule in wanted if not rule.whole]
        else:
            violated = certify(part, reports=()).violated
            partly = [check for check in violated if check.name not in whole]
        checks = [check and replace(check, time=rest + check.time) for check in partly]
        checks += [check_of(rule, flight) for rule in whole.values()]
        return [check for check in checks if check is not None and not check.holds]

    def holds(self, entry: Abort) -> bool:
        """Return whether an abort from a file continues this plan from a rest, and is certified."""
        followed = entry.flight
        stopped = entry.start + entry.seconds
        try:
            ends = followed.drones.at(stopped), self.flight.drones.at(entry.rest)
            continues = np.max(np.abs(ends[0] - ends[1])) <= JOINT
            rests = np.max(np.abs(followed.drones.at(stopped, 1))) <= REST_RATE
            return bool(continues and rests) and not self._violated(followed, entry.start)
        except HitchoptError:
            return False

    def _stops(self, time: float, *, holdable: bool = True) -> Iterator[StoppedPlan]:
        """Yield the plan stopped after increasing delays from a time [s], up to its next rest.

        A stop later than that would begin what has not begun. ``holdable`` leaves out rests while
        tensions change, or before the chords of a swap have met.
        """
        candidates = [(start, False) for start in time + DELAYS if start < self.flight.duration]
        candidates += [(rest, True) for rest in self._rests if rest >= time - JOINT]
        for start, is_rest in sorted(candidates):
            stop, can_hold = self._stopped(float(start), is_rest)
            if can_hold or not holdable:
                yield stop
            if can_hold and is_rest:
                return

    def _stop_at(self, start: float, is_rest: bool) -> tuple[StoppedPlan, bool]:
        """Return the plan stopped from a time [s] on, and whether it can rest there."""
        stop = until_stop(self.flight, start, stop=not is_rest)
        held = stop.flight.followed_by(stop.flight.each_team(lambda end: resting(end, HOLD)))
        return stop, not self._violated(held, start, REST_CHECKS)

    def _free_before(self, time: float) -> float:
        """Return the last plan time [s] with free cables in all teams, 0 without cables."""
        teams = [each for each in self.flight.teams if each.motion.team.has_cables]
        if not teams:
            return 0.0
        while (free := min(min(time, _free_before(each, time).end) for each in teams)) < time:
            time = free
        return time

    def _can_land(self, stop: StoppedPlan) -> bool:
        """Return whether all teams can land from a stop."""
        teams = zip(self.flight.teams, stop.flight.teams, strict=True)
        return all(
            _can_land(plan.motion, part.motion.phases[-1], stop.rest) for plan, part in teams
        )

    def _landing_rests(self, time: float) -> list[float]:
        """Return the plan's rests [s] from which all teams can land, the nearest first.

        There is at most one after the time [s]: later ones belong to what has not begun.
        """
        rests = self._rests
        behind = [x for x in rests[rests < time - JOINT].tolist() if self._lands_at(x, ahead=False)]
        ahead = (x for x in rests[rests > time + JOINT].tolist() if self._lands_at(x, ahead=True))
        return sorted([*behind, *islice(ahead, 1)], key=lambda rest: abs(rest - time))

    def _lands_at(self, rest: float, *, ahead: bool) -> bool:
        """Return whether all teams can land from a rest [s] that is ahead, or behind."""
        for flown in self.flight.teams:
            phases = flown.motion.phases
            before = next(phase for phase in phases if phase.end > rest - JOINT)
            after = next((phase for phase in phases if phase.end > rest + JOINT), before)
            last = before if ahead else after  # the phase in which the rest is reached
            hangs = not (before.state.linked and after.state.linked)
            if not (_can_land(flown.motion, last, rest) or (hangs and not last.state.hitched)):
                return False
        return True

    def _way(self, stop: StoppedPlan, origin: float) -> Flight:
        """Return the stopped plan, flown on or back to a plan time [s]."""
        if abs(origin - stop.rest) <= JOINT:
            return stop.flight
        player = Player(self.flight, stop.rest, 0.0)
        player.seek(origin)
        return stop.flight.followed_by(_on_clock(self.flight, player.ahead))

    def _shorter_continuation(self, way: Flight, how: str, origin: float, most: float) -> Flight:
        """Return the continuation of a way; raise InfeasibleError unless it is below a duration."""
        _require_shorter(way, most)
        flight = replace(self._continuation(way, how, origin), others=self.others)
        _require_shorter(flight, most)
        return flight

    def _continuation(self, whole: Flight, how: str, origin: float) -> Flight:
        """Return a way to a plan time [s] and what follows it, not yet certified."""

        def continued(motion: Motion, planned: TeamMotion) -> Motion:
            """Return a team's way and what follows it."""
            if how in ("hold", "back"):
                phase = _free_before(planned, origin) if how == "back" else None
                return append_motion(motion, resting(motion, HOLD, phase))
            try:
                return _with_landing(motion, untie=how == "release_and_land")
            except InfeasibleError as error:
                raise error.of_team(planned.name) from None

        pairs = zip(whole.teams, self.flight.teams, strict=True)
        return Flight(
            tuple(replace(way, motion=continued(way.motion, planned)) for way, planned in pairs)
        )


def _in_haste(motion: Motion) -> Motion:
    """Return a motion that may swing."""
    requirements = motion.requirements.in_haste
    same = requirements is motion.requirements
    return motion if same else motion.replaced(requirements=requirements)


def _on_clock(flight: Flight, clock: ClockPhases) -> Flight:
    """Return a flight on a clock, as ``on_clock``."""
    return flight.each_team(lambda motion: on_clock(motion, clock))


def moves_standing(flight: Flight, *times: float) -> bool:
    """Return whether an object at rest at the first plan time [s] moves between them."""
    first, last = min(times), max(times)
    for flown in flight.teams:
        own = flown.motion
        standing = own.load_share.at(times[0]) < 1.0 - SHARE_TOLERANCE
        if not np.any(standing) or last - first <= JOINT:
            continue
        inner = own.drones.breaks[(own.drones.breaks > first) & (own.drones.breaks < last)]
        poses = on_breaks(own.poses, np.concatenate([[first], inner, [last]])).coefficients
        moves = np.max(np.ptp(poses, axis=(0, -1)), axis=-1) > REST_DRIFT
        if np.any(moves & standing):
            return True
    return False


def _require_shorter(flight: Flight, most: float) -> None:
    if flight.duration >= most:
        raise _refusal("is shorter")


def _error(violated: Sequence[Check], flight: Flight) -> InfeasibleError:
    """Return the error of the violated checks of a flight."""
    return infeasible_error(Certificate(flight.duration, tuple(violated)), flight)


def _can_land(motion: Motion, phase: Phase, time: float) -> bool:
    """Return whether a team can land from a phase at a plan time [s].

    It can from free cables, and with a hitch that neither holds nor encloses an object.
    """
    if not phase.state.hitched:
        return not phase.state.linked
    return phase.hold is None and not _encloses(motion, time)


def _free_before(flown: TeamMotion, time: float) -> Phase:
    """Return the last phase of a team, not after a plan time [s], in which cables hang free.

    Without cables, that is the phase at this time.
    """
    for phase in reversed(flown.motion.phases):
        if phase.start < time + JOINT and not phase.state.linked:
            return phase
    cables = f"cables of {flown.name}" if flown.name else "cables"
    reason = f"back from t = {time:.4g} s: {cables} were never free before"
    raise _refusal(reason, "choose hold, land or release_and_land")


def _encloses(motion: Motion, time: float) -> bool:
    """Return whether a team's hitch encloses an object below the object's top."""
    if not (motion.requirements.objects and motion.team.layout.closed):
        return False
    vertices, poses = motion.vertices.at(time), motion.poses.at(time)
    for index, body in enumerate(motion.requirements.objects.values()):
        height = body.upper if body.rim is None else max(body.upper, body.rim.height)
        top = in_world(poses[index], np.append(body.section.centroid, height))
        offsets = (vertices - top)[:, :2] @ [1.0, 1.0j]
        inside = np.all((np.roll(offsets, -1) * offsets.conj()).imag < 0.0)  # convex and clockwise
        if not body.fixed and inside and np.min(vertices[:, 2]) < top[2]:
            return True
    return False


def until_stop(flight: Flight, time: float, *, stop: bool = True) -> StoppedPlan:
    """Return the plan until its clock has stopped, as soon as possible from a time [s] on.

    Without ``stop``, the time is a rest of the plan, which ends there. The result has no limit on
    its duration.
    """
    whole = flight.untimed
    parts = list[Flight]()
    cut = float(flight.spaced(time))
    while True:
        time = cut
        player = Player(flight, time)
        seconds = player.pause() if stop else 0.0
        clock = player.ahead
        if len(clock) and not np.any(clock.jets[0, 2:]):  # first at the plan's own rate
            time += float(clock.duration[0])
            clock = clock.select(slice(1, None))
        cut = float(flight.spaced(time))
        if cut - time <= TIME_ROUNDING:
            break
    player.step(seconds)
    if time > JOINT:
        parts.append(whole.each_team(lambda motion: truncated(motion, time)))
    if len(clock):
        parts.append(_on_clock(whole, clock))
    if not parts:
        parts.append(whole.each_team(lambda motion: resting(motion, HOLD, first=True)))
    stopped = reduce(Flight.followed_by, parts)
    return StoppedPlan(time, float(np.sum(clock.duration)), player.time, stopped)


def _refusal(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")


def _with_landing(whole: Motion, *, untie: bool) -> Motion:
    """Return a plan at rest with a landing, after untying the hitch if ``untie`` is set."""
    if not whole.phases[-1].state.hitched:
        return _extended(whole, straight_down(whole))
    hitch = _hitch_at_end(whole)
    state = RestState(whole.team, hitch.drones, hitch, _turning_senses(whole))
    need = replace(whole.requirements, objects=objects_at(whole, -1)).with_reserve
    task = StepTask(state, whole.phases[-1].step + 1, need)
    if untie:
        released = _extended(whole, provided("untie")(task).motion)
        return _extended(released, straight_down(released))
    return _extended(whole, _descent(hitch, need, task.index))


def _descent(hitch: Hitch, requirements: Requirements, index: int) -> Motion:
    """Return the vertical descent of a hitch until its lowest drones are on the ground.

    Raises InfeasibleError if its cables would be there first.
    """
    ground = requirements.ground_for(LANDING)
    depth = float(np.min(hitch.drones[:, 2])) - ground
    phase = Phase("land", index, 0.0, 0.0)
    landed = vertical_motion(hitch, hitch.altitude - depth, requirements, phase)
    height = lowest_height(landed) - ground
    if height < -CONTACT_GAP:
        reason = f"by landing the hitch: its cables would be {-height:.2g} m below the ground"
        raise _refusal(reason, "choose release_and_land, or hold")
    return landed


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
    team = whole.team
    need = replace(whole.requirements, objects=objects_at(whole, -1))
    drones = whole.drones.coefficients[-1, ..., -1]
    index = whole.phases[-1].step + 1
    ground = drones * [1.0, 1.0, 0.0] + [0.0, 0.0, need.ground_for(LANDING)]
    flight = straight_lines(team, need.limits.with_reserve, drones, ground)
    state = CableState.GROUND if team.has_cables else CableState.NONE
    return stage("land", flight, team, need, index, state)


def _turning_senses(whole: Motion) -> Array | None:
    """Return the senses in which pairs turned to form the hitch (clasps,): 1 if q rose first."""
    layout = whole.team.layout
    phases = whole.phases
    tying = next((phase for phase in phases if phase.state.clasping), None)
    if tying is None:
        return None
    heights = whole.drones.at(0.5 * (tying.start + tying.end))[:, 2]
    above = heights[2 * layout.ahead] >= heights[2 * layout.behind + 1]
    return np.where(above, 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class AbortTable:
    """Certified aborts from all times of a plan, or from those planned so far."""

    how: str
    entries: tuple[Abort, ...]  # by start; between two the plan runs on to the later one
    end: float  # of the plan [s]
    refused: tuple[float, ...] = ()  # times of commands [s] without an abort
    pending: tuple[float, ...] = ()  # times of commands [s] that are not planned yet
    every: float = DEFAULT_INTERVAL  # time between commands [s]

    @classmethod
    def unplanned(cls, flight: Flight, how: str, every: float = DEFAULT_INTERVAL) -> AbortTable:
        """Return the table of a plan whose aborts, one ``every`` [s] or so, are not planned yet."""
        end = flight.duration
        every = positive("every", every)
        return cls(how, (), end, pending=_command_times(end, every), every=every)

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        starts = [0.0, *(entry.start for entry in self.entries)]
        rests = [entry.start + entry.seconds for entry in self.entries]
        return max((b - a for a, b in zip(starts, rests, strict=False)), default=float("inf"))

    @property
    def missing(self) -> tuple[tuple[float, float], ...]:
        """Spans of time [s] from whose commands no abort was found, up to the next entry."""
        starts = [entry.start for entry in self.entries]
        spans = set[tuple[float, float]]()
        for time in self.refused:
            after = bisect_left(starts, time)
            last = starts[after - 1] if after else 0.0
            spans.add((last, starts[after] if after < len(starts) else self.end))
        return tuple(sorted(spans))

    @property
    def planned(self) -> float:
        """Share of the plan's times that are planned, 0 to 1."""
        return 1.0 - len(self.pending) / len(_command_times(self.end, self.every))

    def with_outcome(self, time: float, entry: Abort | None) -> AbortTable:
        """Return the table with the abort found for a command at a time [s], or without one.

        An entry serves all commands from its own to the start of its stop.
        """
        pending = [each for each in self.pending if each != time]
        if entry is None:
            return replace(self, pending=tuple(pending), refused=(*self.refused, time))
        pending = [each for each in pending if not entry.asked <= each <= entry.start + JOINT]
        entries = sorted([*self.entries, entry], key=lambda each: each.start)
        return replace(self, pending=tuple(pending), entries=tuple(entries))


def _command_times(end: float, every: float) -> tuple[float, ...]:
    """Return the times [s] of commands of a table, with the plan's end."""
    return *np.arange(0.0, end - JOINT, every).tolist(), end


def abort_table(
    flight: Flight, how: str, every: float = DEFAULT_INTERVAL, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all times of a plan, with an entry about ``every`` [s] of plan time."""
    table = AbortTable.unplanned(flight, how, every)
    aborts = Aborts(flight)
    while table.pending:
        if progress is not None:
            progress(f"{how} from t = {table.pending[0]:.4g} s, {table.planned:.0%}")
        table = table.with_outcome(table.pending[0], aborts.find(table.pending[0], how))
    return table


def save_aborts(directory: Path | str, flight: Flight, tables: Iterable[AbortTable]) -> Path:
    """Write ``aborts.json`` and ``aborts.zip``, a plan file per entry, next to a plan."""
    named = [
        (table, entry, f"{table.how}_{i:03d}.npz")
        for table in tables
        for i, entry in enumerate(table.entries)
    ]
    keys = "asked", "start", "seconds", "rest"

    def content_of(table: AbortTable) -> dict[str, Any]:
        """Return what the file states of a table."""
        rows = [
            {key: getattr(entry, key) for key in keys}
            | {"ends": entry.flight.duration, "plan": name}
            for owner, entry, name in named
            if owner is table
        ]
        return {
            "how": table.how,
            "longest": table.longest if rows else None,
            "missing": [list(span) for span in table.missing],
            "every": table.every,
            "refused": list(table.refused),
            "pending": list(table.pending),
            "entries": rows,
        }

    def write_plans(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive, tempfile.TemporaryDirectory() as scratch:
            for table, entry, name in named:
                file = Path(scratch) / name
                write_plan(file, entry.flight, f"{table.how} at {entry.start:g} s")
                archive.writestr(zipfile.ZipInfo(name), file.read_bytes())

    def write_table(path: Path) -> None:
        content = {"format": FORMAT, "plan": flight_digest(flight)}
        content |= {"plans": digest(path.with_name(ABORT_PLANS))}
        write_strict_json(path, content | {"tables": [content_of(table) for table in tables]})

    tables = list(tables)
    writers = {ABORT_PLANS: write_plans, ABORTS: write_table}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)


def read_aborts(directory: Path, flight: Flight) -> dict[str, AbortTable]:
    """Return the saved tables of a plan by their reactions; none if they are of another plan.

    Their entries are not certified here: ``Aborts.holds`` tells whether they can be flown.
    """
    path, plans = directory / ABORTS, directory / ABORT_PLANS
    if not (path.is_file() and plans.is_file()):
        return {}
    try:
        content = parsed_json(file_bytes(path))
        if (content["format"], content["plan"], content["plans"]) != (
            *(FORMAT, flight_digest(flight), digest(plans)),
        ):
            return {}
        with zipfile.ZipFile(plans) as archive, tempfile.TemporaryDirectory() as scratch:

            def entry_of(row: dict[str, Any]) -> Abort:
                """Return an entry with its plan, which others flown at the same time join."""
                file = Path(scratch) / ABORT_PLANS
                file.write_bytes(archive.read(row["plan"]))
                own = replace(read_plan(file), others=flight.others)
                return Abort(row["start"], row["seconds"], row["rest"], own, row["asked"])

            return {
                table["how"]: AbortTable(
                    table["how"],
                    tuple(map(entry_of, table["entries"])),
                    flight.duration,
                    tuple(table["refused"]),
                    tuple(table["pending"]),
                    table["every"],
                )
                for table in content["tables"]
            }
    except READ_ERRORS as error:
        raise FileError(f"{path}: cannot be read: {error}; remove it, or abort again") from None
