"""Aborts: certified continuations of a plan from the moving state at any time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Literal, get_args

import numpy as np

from hitchopt.checks import certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.stops import SWITCH, StopTable
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.motion.cutting import rests
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.phases import JOINT, CableState
from hitchopt.motion.retiming import SHORTEST, followed, resting, retimed
from hitchopt.motion.tensions import stated_tensions
from hitchopt.steps.certified_motions import Certified, infeasible
from hitchopt.stopping.enclosures import Enclosures
from hitchopt.stopping.grounding import check_obstacles, descended, released
from hitchopt.stopping.player import Player
from hitchopt.stopping.stopped_motion import until_stop
from hitchopt.trajectory.splitting import SAME_BREAK
from hitchopt.values import choice, not_negative

How = Literal["hold", "back", "release_and_land", "land"]

WAYS: tuple[How, ...] = get_args(How)

HOLD = 1.0
"""[s] Time at rest at the end of a hold."""

APART, FARTHER = 0.1, 1.5
"""[s] The clock's stops that are tried first are at least so far apart, and how many times farther
each time one is refused."""

TRIES = 8
"""Number of the clock's stops from which a continuation is tried; later ones begin where the plan
is at rest by itself: legs that lean against friction stand straight there."""

LANDINGS = ("release_and_land", "land")
"""Those of them that end on the ground."""

PASSING = frozenset({CableState.CLASPING, CableState.TIGHTENING})
"""States between hanging and hitched cables, that nothing but the clock leads out of."""


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
    start: plan time at which the clock begins to slow down [s]; until then it is the plan.
    seconds: time from there to rest [s].
    rest: plan time at the rest [s].
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
        self.enclosures = Enclosures(motion)

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
        """Return the first abort for a command at a time [s].

        Parameters
        ----------
        time: plan time of the command [s].
        how: ``hold`` stops and stays; ``back`` stops and flies backward to the last phase in which
            cables hang free, or to the start without cables; ``release_and_land`` stops, unties
            what is tied and lands; ``land`` stops and goes straight down, tied or not. An object
            that has been lifted is set down first, as the plan does.

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
        if refusal is None:
            raise _refused(f"from t = {time:.4g} s: the clock comes to rest nowhere")
        raise refusal

    def stopped(self, time: float, *, landing: bool = False) -> Iterator[Stopped]:
        """Yield the plan stopped after a time [s], at the first rest and at later ones.

        After TRIES stops of the clock only those follow at which the plan is at rest by itself.
        Rests that the states of the cables do not allow are left out: before the chords of a swap
        have met, or while tensions are not the team's; and those for a landing from which the plan
        has to go on until it has left an object.
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
            if landing and (around := self.enclosures.at(rest)) and around.held and around.onward:
                continue
            latest = rest
            found = self._stop(float(start), float(duration))
            if found is not None:
                tries += duration > 0.0
                yield found

    def _stop(self, start: float, duration: float) -> Stopped | None:
        """Return the plan stopped by the clock, unless its cables do not allow that."""
        motion = self.motion
        whole, time = until_stop(motion, start, duration, HOLD)
        whole = replace(whole.untimed, assignment=motion.assignment)
        if whole.phases[-1].formed:
            tension, least = whole.tensions.coefficients[-1, :, -1], motion.team.tension
            most = least
            if whole.phases[-1].hold is not None:  # which may ask for another tension
                least, most = stated_tensions(whole)[-1].T
            off = tension - np.clip(tension, least, most)
            if np.max(np.abs(off)) > RULE_OF["tension"].limit_of(motion):
                return None
        if whole.phases[-1].state in PASSING:
            held = followed(whole, resting(whole, HOLD))
            check = RULE_OF["interlacing"].check(held)
            if check is not None and not check.holds:
                return None
        return Stopped(whole, start, duration, time)

    def _tries(self, time: float, how: str) -> Iterator[tuple[Stopped, float | None]]:
        """Yield stops after a time [s], and the plan times from which to go on; None for there.

        Single drones that can land from no rest ahead go back: plans may end above each other.
        """
        landing, first = how in LANDINGS, None
        later = None if how != "back" else TRIES  # what hangs free later is not behind
        for stopped in islice(self.stopped(time, landing=landing), later):
            first = first or stopped
            around = self.enclosures.at(stopped.time) if landing else None
            if around is None or not around.held:
                yield stopped, None
            if around is not None and not around.onward and around.way_out is not None:
                yield stopped, around.way_out
        if landing and first is not None and not self.motion.team.has_cables:
            for back in APART * np.cumsum(FARTHER ** np.arange(TRIES)):
                if first.time > back:
                    yield first, first.time - float(back)

    def continued(self, stopped: Stopped, how: str, origin: float | None = None) -> Certified:
        """Return the certified continuation of a plan at rest, as ``continuation``."""
        whole = self.continuation(stopped, how, origin)
        if how in LANDINGS:
            check_obstacles(whole, stopped.motion.duration)
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
        phase = None
        if how == "back":
            goal, phase = self._last_free(time)
            whole = self._sought(whole, time, goal)
        elif how != "hold":
            if whole.phases[-1].state in PASSING:
                origin = self._way_out(time)
            if origin is not None:
                whole = self._sought(whole, time, origin)
            whole = released(whole) if how == "release_and_land" else descended(whole)
        if how in ("hold", "back"):
            whole = followed(whole, resting(whole, HOLD, phase))
        return whole

    def _sought(self, whole: Motion, time: float, goal: float) -> Motion:
        """Return a plan at rest at a plan time followed by the clock's move to another one."""
        if abs(goal - time) <= JOINT:
            return whole
        clock = self.player.path(time, goal)
        return followed(whole, retimed(self.motion, clock))

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
        phases = self.motion.phases
        after = [phase for phase in phases if phase.end > time + JOINT]
        following = next((phase for phase in after if phase.state not in PASSING), None)
        if following is None:
            return self.motion.duration
        if following.formed:
            return self._last_free(time)[0]
        return following.start


def _refused(when: str, remedy: str = "abort earlier or later") -> InfeasibleError:
    return InfeasibleError([], f"no abort {when}; {remedy}")
