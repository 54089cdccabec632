"""A flight: setpoints sent in time, commands obeyed, a hold and a landing where links are lost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.flying.course import Course, Flown
from hitchopt.flying.outlet import Outlet
from hitchopt.values import Array, positive

OPERATOR = "operator"
"""Name of the operator's link."""

AGAIN = 0.25
"""[s] Delay before a hold that was refused is tried again."""


class Steering(Protocol):
    """Where commands come from."""

    def commands(self) -> tuple[list[str], bool]:
        """Return the commands since the last call, and whether the operator was heard of."""


@dataclass(frozen=True)
class Timing:
    """Times of a flight.

    Attributes
    ----------
    rate: setpoints a second [Hz].
    lead: time [s] by which setpoints are computed ahead, and after which a command takes effect.
    silence: time [s] after which a drone that is not measured is lost.
    operator: time [s] after which a silent operator is lost.
    patience: time [s] from a lost link to the landing.
    near: distance [m] within which drones must be measured before the plan goes on.
    """

    rate: float = 50.0
    lead: float = 0.2
    silence: float = 0.5
    operator: float = 1.0
    patience: float = 5.0
    near: float = 0.3

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            positive(key, value)


class Flight:
    """A course that is streamed to a fleet, one ``tick`` after the other.

    Parameters
    ----------
    course: what is flown.
    outlet: the fleet.
    steering: the operator.
    timing: rates and times.
    watched: names of the drones that must be measured.
    later: starts a command's computation while setpoints that are ready are sent.
    say: called with what happens, in words.
    """

    def __init__(
        self,
        course: Course,
        outlet: Outlet,
        steering: Steering,
        timing: Timing,
        watched: tuple[str, ...],
        later: Callable[[Callable[[], str]], Future[str]],
        say: Callable[[str], None],
    ) -> None:
        self._course, self._outlet, self._steering = course, outlet, steering
        self._timing, self._later, self._say = timing, later, say
        limits = dict.fromkeys(watched, timing.silence) | {OPERATOR: timing.operator}
        self._watch = LinkWatch(limits)
        self._names = course.motion.team.drone_names
        self._measured: dict[str, Array] = {}
        self._ready: deque[Flown] = deque()
        self._asked: deque[str] = deque()
        self._job: Future[str] | None = None
        self._last: Flown | None = None
        self._next = -math.inf
        self._lost_since: float | None = None
        self._reacted = -math.inf
        self._quit = False
        self.landed = False
        """Whether drones are on the ground, all of the course flown."""
        self.late = 0
        """Number of setpoints that had to be sent twice, as a command took longer than the lead."""

    def tick(self, now: float) -> bool:
        """Do what is due at a time [s]; return whether the flight goes on."""
        self._listen(now)
        self._guard(now)
        self._command()
        self._prepare()
        self._send(now)
        return not (self.landed or self._quit)

    def _listen(self, now: float) -> None:
        found = self._outlet.measured()
        self._measured |= found
        self._watch.heard(found, now)
        commands, heard = self._steering.commands()
        if heard:
            self._watch.heard([OPERATOR], now)
        for command in commands:
            self._ask(command, now)

    def _ask(self, command: str, now: float) -> None:
        """Queue an operator's command, unless it may not be given now."""
        course = self._course
        if command == "end":
            command = "land" if course.begun else "quit"
        if command == "quit":
            self._quit = not course.begun and self._job is None and not self._asked
            if not self._quit:
                self._say("quit: drones have left their start; land first")
            return
        if command == "toggle":
            command = "resume" if course.resting else "pause"
        if command != "pause" and not course.begun and command != "resume":
            self._say(f"{command}: the plan has not begun")
            return
        if command in ("resume", "back") and (hindrance := self._hindrance(now)):
            self._say(f"{command}: {hindrance}")
            return
        self._asked.append(command)

    def _hindrance(self, now: float) -> str:
        """Return why the plan may not go on from rest."""
        lost = self._watch.lost(now)
        if lost:
            return f"nothing is heard of {', '.join(lost)}"
        if self._last is None or not self._course.resting:
            return ""
        for name, place in zip(self._names, self._last.setpoints.positions, strict=True):
            if name in self._measured:
                off = float(np.linalg.norm(self._measured[name] - place))
                if off > self._timing.near:
                    return f"{name} is {off:.2f} m from its setpoint, not {self._timing.near:g} m"
        return ""

    def _guard(self, now: float) -> None:
        """Hold where a link is lost, land where it stays lost."""
        lost = self._watch.lost(now)
        if not lost:
            if self._lost_since is not None and self._course.begun:
                self._say("all are heard of again")
            self._lost_since = None
            return
        if self._lost_since is None:
            self._lost_since, self._reacted = now, -math.inf
            if self._course.begun:
                self._say(f"lost: {', '.join(lost)}")
        patient = now - self._lost_since < self._timing.patience
        if not self._course.begun:
            if not patient and OPERATOR in lost:
                self._say("no operator is heard of, and the plan has not begun: the stream ends")
                self._quit = True
            return
        wait = AGAIN if patient else self._timing.patience
        if self._job is not None or now - self._reacted < wait:
            return
        if patient and not (self._course.descending or self._course.resting):
            self._reacted = now
            self._asked.append("pause")
        elif not patient and self._course.resting and not self._course.landed:
            self._reacted = now
            self._asked.append("land")

    def _command(self) -> None:
        """Begin the next command, or say what has become of the present one."""
        if self._job is not None and self._job.done():
            try:
                self._say(self._job.result())
            except HitchoptError as error:
                self._say(str(error))
            self._job = None
        if self._job is None and self._asked:
            command = self._asked.popleft()
            self._job = self._later(lambda: self._course.obey(command))

    def _prepare(self) -> None:
        """Compute setpoints ahead, unless a command is about to change them."""
        timing = self._timing
        while len(self._ready) < max(1, round(timing.lead * timing.rate)):
            if self._job is not None or self._course.landed:
                return
            self._ready.append(self._course.step(1.0 / timing.rate))

    def _send(self, now: float) -> None:
        """Send the setpoint that is due, the last one again where none is ready."""
        period = 1.0 / self._timing.rate
        if now < self._next:
            return
        due = 1 if self._last is None else max(1, int((now - self._next) / period) + 1)
        self._next = now + period if self._last is None else self._next + due * period
        for _ in range(due):
            if not self._ready:
                self.late += 1
                break
            self._last = self._ready.popleft()
        if self._last is not None:
            self._outlet.send(self._last, now)
        ended = self._course.landed and not self._asked and self._job is None
        self.landed = ended and not self._ready and self._course.begun


class LinkWatch:
    """When each of several links was heard of last.

    Parameters
    ----------
    timeouts: time [s] after which a silent link is lost, by the links' names.
    """

    def __init__(self, timeouts: dict[str, float]) -> None:
        self._timeouts = timeouts
        self._heard = dict.fromkeys(timeouts, -math.inf)

    def heard(self, names: Iterable[str], now: float) -> None:
        """Note that links were heard of at a time [s]; other names are ignored."""
        for name in names:
            if name in self._heard:
                self._heard[name] = now

    def lost(self, now: float) -> tuple[str, ...]:
        """Return the names of the links that are lost at a time [s], never heard ones too."""
        return tuple(
            name for name, last in self._heard.items() if now - last > self._timeouts[name]
        )
