"""Certified aborts of a plan from the moving state at any time.

A command stops the plan's clock. The abort continues with a hold, with the plan backward, or with a
landing of its own. If the certificate does not hold, a later stop is tried, up to the plan's next
rest. Where drones cannot land from any of these, as around an object, they continue, or fly back,
to one of the plan's rests from which they can, whichever lands first. No abort moves an object that
is at rest on its support at the time of the command.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce
from itertools import islice, pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.arena import height_above_floor
from hitchopt.checks.registry import RULE_OF, check_of
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import HitchoptError, InfeasibleError, InputError, Progress
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.live.player import Player
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import JOINT, SHARE_TOLERANCE, CableState, Motion, Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.request import objects_at
from hitchopt.motion.retiming import (
    append_motion,
    on_clock,
    resting,
    truncated,
    with_last_poses,
)
from hitchopt.motion.states import final_hitch
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, in_world
from hitchopt.planners.forming.stages import stage, straight_lines
from hitchopt.planners.forming.tying import vertical_motion
from hitchopt.planners.task import RestState, StepTask
from hitchopt.steps.tying import Release
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, check_choice, nonnegative, positive

How = Literal["hold", "back", "release_and_land", "land"]

HOLD = 1.0  # duration of the rest at the end of a hold [s]
DEFAULT_INTERVAL = 2.0  # default interval of the entries of a table [s]

# Candidate delays of the clock's stop [s]. The plan's own rests are candidates too: legs do not
# lean there
DELAYS = np.cumsum([0.0, *0.1 * 1.5 ** np.arange(7)])

HANGING_STATES = frozenset({CableState.FREE, CableState.GROUND, CableState.NONE})
"""States from which drones can go straight down."""

# Checks that exclude rests while tensions change, or before the chords of a swap have met
REST_CHECKS = ("tension", "interlacing")


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

    certificate: Certificate


@dataclass(frozen=True, eq=False)
class _Refused:
    """Why a continuation is refused."""

    error: InfeasibleError
    at_end: bool  # whether only what follows the way to a rest breaks limits


class Aborts:
    """The aborts of one plan."""

    def __init__(self, flight: Flight) -> None:
        self.others = flight.others  # they fly on regardless of this plan's clock
        self.flight = flight.without_others

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

    def _in_place(self, time: float, how: str) -> Abort | InfeasibleError | None:
        """Return the first hold, way back or landing that starts where a stop ends, or an error."""
        refusal: InfeasibleError | None = None
        for stop in self._stops(time, holdable=how != "back"):
            if how in ("land", "release_and_land") and not self._can_land(stop):
                continue
            origin = self._free_before(stop.rest) if how == "back" else stop.rest
            if moves_standing(self.flight, time, stop.rest, origin):
                continue
            found = self._attempt(stop, how, origin)
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
                attempt = self._attempt(stop, how, rest, fallback)
                if isinstance(attempt, Abort):
                    return attempt
                fallback = fallback or attempt.error
                if attempt.at_end:
                    unsuited.add(rest)
        return fallback

    def _attempt(
        self, stop: StoppedPlan, how: str, origin: float, shorter: object = None
    ) -> Abort | _Refused:
        """Return the certified continuation of a stop from a plan time [s], or why there is none.

        It must be shorter than the abort ``shorter``.
        """
        try:
            way = self._way(stop, origin)
        except InfeasibleError as error:
            return _Refused(error, at_end=False)
        try:
            flight = replace(self._continuation(way, how, origin), others=self.others)
        except InfeasibleError as error:
            return _Refused(error, at_end=True)
        if isinstance(shorter, Abort) and flight.duration >= shorter.flight.duration:
            return _Refused(_refusal("is shorter"), at_end=True)
        certificate = certify(flight)
        if certificate.certified:
            return Abort(stop.start, stop.seconds, stop.rest, flight, certificate)
        at_end = all(check.time > way.duration + JOINT for check in certificate.violated)
        return _Refused(infeasible_error(certificate, flight), at_end)

    def _stops(self, time: float, *, holdable: bool = True) -> Iterator[StoppedPlan]:
        """Yield the plan stopped after increasing delays from a time [s], up to its next rest.

        A stop later than that would begin what has not begun. ``holdable`` leaves out rests while
        tensions change, or before the chords of a swap have met.
        """
        rests = self.flight.breaks[self.flight.rest_breaks]
        candidates = [(start, False) for start in time + DELAYS if start < self.flight.duration]
        candidates += [(rest, True) for rest in rests if rest >= time - JOINT]
        for start, is_rest in sorted(candidates):
            stop = until_stop(self.flight, float(start), stop=not is_rest)
            can_hold = _is_holdable(stop.flight)
            if can_hold or not holdable:
                yield stop
            if can_hold and is_rest:
                return

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
        rests = self.flight.breaks[self.flight.rest_breaks]
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
            hangs = not {before.state, after.state}.isdisjoint(HANGING_STATES)
            if not (_can_land(flown.motion, last, rest) or (hangs and not last.formed)):
                return False
        return True

    def _way(self, stop: StoppedPlan, origin: float) -> Flight:
        """Return the stopped plan, flown on or back to a plan time [s]."""
        if abs(origin - stop.rest) <= JOINT:
            return stop.flight
        player = Player(self.flight, stop.rest, 0.0)
        player.seek(origin)
        return stop.flight.followed_by(_on_clock(self.flight, player.ahead))

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


def _is_holdable(flight: Flight) -> bool:
    """Return whether a flight can rest at its end."""
    held = flight.followed_by(flight.each_team(lambda motion: resting(motion, HOLD)))
    checks = [check_of(RULE_OF[name], held) for name in REST_CHECKS]
    return all(check is None or check.holds for check in checks)


def _can_land(motion: Motion, phase: Phase, time: float) -> bool:
    """Return whether a team can land from a phase at a plan time [s].

    It can from free cables, and with a hitch that neither holds nor encloses an object.
    """
    if phase.state is not CableState.HITCHED:
        return phase.state in HANGING_STATES
    return phase.hold is None and not _encloses(motion, time)


def _free_before(flown: TeamMotion, time: float) -> Phase:
    """Return the last phase of a team, not after a plan time [s], in which cables hang free.

    Without cables, that is the phase at this time.
    """
    for phase in reversed(flown.motion.phases):
        if phase.start < time + JOINT and phase.state in HANGING_STATES:
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
    whole, player, parts = flight.untimed, Player(flight, time), list[Flight]()
    seconds = player.pause() if stop else 0.0
    clock = player.ahead
    player.step(seconds)
    if len(clock) and not np.any(clock.jets[0, 2:]):  # the first phase is at the plan's own rate
        time += float(clock.duration[0])
        clock = clock.select(slice(1, None))
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
    """Return the vertical descent of a hitch until its lowest drones are on the ground.

    Raises InfeasibleError if its cables would be there first.
    """
    depth = float(np.min(hitch.drones[:, 2])) - requirements.floor
    phase = Phase("land", index, 0.0, 0.0)
    landed = vertical_motion(hitch, hitch.altitude - depth, requirements, phase)
    height = height_above_floor(landed)
    if height < -CONTACT_GAP:
        reason = f"landed: cables of the hitch would be {-height:.2g} m below the ground"
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
    missing: tuple[tuple[float, float], ...] = ()  # spans of time [s] without an abort

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        starts = [0.0, *(entry.start for entry in self.entries)]
        rests = [entry.start + entry.seconds for entry in self.entries]
        return max((b - a for a, b in zip(starts, rests, strict=False)), default=float("inf"))


def abort_table(
    flight: Flight, how: str, every: float = DEFAULT_INTERVAL, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all times of a plan, with an entry about ``every`` [s] of plan time."""
    every, aborts, end = positive("every", every), Aborts(flight), flight.duration
    entries, missing, time = list[Abort](), list[tuple[float, float]](), 0.0
    last, refused = 0.0, False  # start of the last entry; whether none was found since
    while True:
        if progress is not None:
            progress(f"{how} from t = {time:.4g} s")
        try:
            entry = aborts.plan(time, how)
        except InfeasibleError:
            reached, refused = time, True
        else:
            entries.append(entry)
            if refused:
                missing.append((last, entry.start))
            reached, last, refused = entry.start, entry.start, False
        if reached >= end - JOINT:
            break
        time = min(reached + every, end)
    if refused:
        missing.append((last, end))
    return AbortTable(how, tuple(entries), end, tuple(missing))


def save_aborts(directory: Path | str, table: AbortTable) -> Path:
    """Write ``aborts.json`` and ``aborts.zip``, a plan file per entry, next to a plan."""
    names = [f"{table.how}_{i:03d}.npz" for i in range(len(table.entries))]
    rows = [
        {key: getattr(entry, key) for key in ("start", "seconds", "rest")}
        | {"ends": entry.flight.duration, "plan": name}
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
                write_plan(file, entry.flight, f"{table.how} at {entry.start:g} s")
                archive.writestr(zipfile.ZipInfo(name), file.read_bytes())

    writers = {ABORTS: lambda path: write_strict_json(path, content), ABORT_PLANS: write_plans}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)
