"""A flight by commands: the plan on its clock, after an abort its landing, and lost links.

Nothing here reads a clock: ``Flight.tick`` receives the time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError, InputError
from hitchopt.hitch import GRAVITY
from hitchopt.live.abort import AbortTable
from hitchopt.live.player import Player, Setpoints
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.states import states_at
from hitchopt.values import Array, positive

COMMANDS = ("pause", "resume", "back", "abort", "land")
OPERATOR = "operator"  # name of the operator's link
TRIES = 6  # number of a table's entries that the clock is led to, the nearest first
LEAD = 0.2  # setpoints are computed so long ahead, and a command takes effect after it [s]
SILENCE, UNATTENDED = 0.5, 1.0  # a drone without measurements, a silent operator are lost [s]
NEAR = 0.3  # a plan goes on from rest with drones this near to their setpoints [m]
AGAIN = 0.25  # delay before a hold that was refused is tried again [s]


@dataclass(frozen=True, eq=False)
class FleetSetpoints:
    """Setpoints sent to drones at one time, in the plan's axes."""

    setpoints: Setpoints
    thrusts: Array  # (drones, 3) [N]; the cables' pull is that at the plan time
    thrust_rates: Array  # (drones, 3) [N/s]
    feed_forward: Array  # (drones, 3) [m/s²], ``a - G F / m``, for controllers that know no cable


class CommandedPlan:
    """A plan at rest at its start, to be flown by commands: ``abort`` and ``land`` by tables."""

    def __init__(self, motion: Motion, tables: Mapping[str, AbortTable]) -> None:
        self.motion = motion
        self._player = _ready(motion, 0.0, 0.0)
        ready = cache(lambda entry: _ready(entry.motion, entry.start + entry.seconds, 1.0))
        self._landings = {
            command: [(entry.rest, ready(entry)) for entry in table.entries]
            for command, table in tables.items()
        }
        self._landing: Player | None = None
        self.descending = False  # whether the landing itself has begun
        self.started = False  # whether the plan has ever left its start

    @property
    def resting(self) -> bool:
        """Whether all drones stand still and are not about to move."""
        return self._player.resting and self._landing is None

    @property
    def landed(self) -> bool:
        """Whether everything has been flown and the drones are on the ground."""
        motion = self._player.motion
        if not self._player.resting or self._player.time < motion.duration - JOINT:
            return False
        heights = motion.drones.coefficients[-1, :, 2, -1]
        return self.descending or bool(np.all(heights <= motion.requirements.floor + JOINT))

    def step(self, seconds: float) -> FleetSetpoints:
        """Let time [s] pass and return what drones are sent then."""
        if self._landing is not None and self._player.resting:
            self._player, self._landing = self._landing, None
            self.descending = True
        motion, setpoints = self._player.motion, self._player.step(seconds)
        states = states_at(motion, [setpoints.time])
        mass, gain = motion.team.mass[:, None], motion.team.pull_gain
        forward = setpoints.accelerations - gain * states.cable_forces[0] / mass
        return FleetSetpoints(
            setpoints,
            mass * (forward + [0.0, 0.0, GRAVITY]),
            mass * setpoints.jerks - setpoints.rate * gain * states.cable_force_rates[0],
            forward,
        )

    def obey(self, command: str) -> str:
        """Carry out one of COMMANDS; return its effect in words.

        InfeasibleError is raised if it cannot be done now; the present command goes on.
        """
        if command not in COMMANDS:
            raise InputError("command", command, f"one of {', '.join(COMMANDS)}", "choose one")
        if command in self._landings:
            return self._land(command)
        if self.descending and command == "back":
            raise InfeasibleError([], "back: the landing has begun; pause and resume it only")
        seconds = getattr(self._player, command)()
        self.started = self.started or command == "resume"
        self._landing = None
        return f"{command}: takes {seconds:.2f} s"

    def _land(self, command: str) -> str:
        """Lead the clock to the nearest rest from which it can land, ahead if there is one."""
        if self.descending:
            return f"landing goes on, in {self._player.resume():.2f} s"
        time, refusal = self._player.time, InfeasibleError([], f"{command}: the plan has none")
        nearest = sorted(self._landings[command], key=lambda x: (x[0] < time, abs(x[0] - time)))
        for rest, landing in nearest[:TRIES]:
            try:
                seconds = self._player.seek(rest)
            except InfeasibleError as error:
                refusal = error
            else:
                self._landing = landing
                return f"{command}: begins in {seconds:.2f} s"
        raise refusal


def _ready(motion: Motion, time: float, rate: float) -> Player:
    """Return a player that knows its stops: a pause must not wait for them."""
    player = Player(motion, time, rate)
    _ = player.stops
    return player


class Outlet(Protocol):
    """A fleet that is sent setpoints."""

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send every drone its setpoint at a time [s]; a network that fails is no error."""

    def measured(self) -> dict[str, Array]:
        """Return positions (3,) [m] that have arrived, in the plan's axes, by drones' names."""

    def arm(self) -> None:
        """Arm the drones: the plan is about to leave its start."""

    def close(self, *, landed: bool) -> None:
        """End the stream."""


class Flight:
    """A plan that is streamed to a fleet, one ``tick`` after the other.

    ``commands`` returns the operator's commands since the last call, and whether it was heard of;
    ``watched`` drones must be measured. ``later`` starts a command's computation, as
    ``Executor.submit`` does, while setpoints that are ready are sent, ``rate`` a second. A lost
    link ends in a landing after ``patience`` [s].
    """

    def __init__(
        self,
        plan: CommandedPlan,
        outlet: Outlet,
        commands: Callable[[], tuple[list[str], bool]],
        watched: tuple[str, ...],
        later: Callable[[Callable[[], str]], Future[str]],
        say: Callable[[str], None],
        *,
        rate: float = 50.0,
        patience: float = 5.0,
    ) -> None:
        self._plan, self._outlet, self._commands = plan, outlet, commands
        self._later, self._say = later, say
        self._rate, self._patience = positive("rate", rate), positive("patience", patience)
        self._timeouts = dict.fromkeys(watched, SILENCE) | {OPERATOR: UNATTENDED}
        self._heard = dict.fromkeys(self._timeouts, -math.inf)
        self._measured: dict[str, Array] = {}
        self._ready: deque[FleetSetpoints] = deque()
        self._queue: deque[str] = deque()
        self._job: Future[str] | None = None
        self._last: FleetSetpoints | None = None
        self._next = self._reacted = -math.inf
        self._lost_since: float | None = None
        self._quit = self._armed = False
        self.landed = False  # whether drones are on the ground, all of the plan flown
        self.late = 0  # setpoints that were sent twice, as a command took longer than the lead

    def tick(self, now: float) -> bool:
        """Do what is due at a time [s]; return whether the flight goes on."""
        measured = self._outlet.measured()
        self._measured |= measured
        commands, heard = self._commands()
        self._heard |= dict.fromkeys([*measured, *([OPERATOR] if heard else [])], now)
        for command in commands:
            self._ask(command, now)
        self._guard(now)
        self._command()
        self._prepare()
        self._send(now)
        return not (self.landed or self._quit)

    def _lost(self, now: float) -> list[str]:
        """Return the names of the links that are lost, never heard ones too."""
        return [name for name, most in self._timeouts.items() if now - self._heard[name] > most]

    def _ask(self, command: str, now: float) -> None:
        """Queue an operator's command, unless it may not be given now."""
        plan = self._plan
        if command == "end":
            command = "land" if plan.started else "quit"
        if command == "toggle":
            command = "resume" if plan.resting else "pause"
        hindrance = ""
        if command == "quit":
            self._quit = not plan.started and self._job is None and not self._queue
            hindrance = "" if self._quit else "drones have left their start; land first"
        elif command in ("resume", "back"):
            hindrance = self._hindrance(now)
        if command not in ("pause", "resume", "quit") and not plan.started:
            hindrance = "the plan has not begun"
        if hindrance:
            self._say(f"{command}: {hindrance}")
        elif command != "quit":
            self._queue.append(command)

    def _hindrance(self, now: float) -> str:
        """Return why the plan may not go on from rest."""
        lost = self._lost(now)
        if lost:
            return f"nothing is heard of {', '.join(lost)}"
        if self._last is not None and self._plan.resting:
            names = self._plan.motion.team.drone_names
            for name, place in zip(names, self._last.setpoints.positions, strict=True):
                off = float(np.linalg.norm(self._measured.get(name, place) - place))
                if off > NEAR:
                    return f"{name} is {off:.2f} m from its setpoint, not {NEAR:g} m"
        return ""

    def _guard(self, now: float) -> None:
        """Hold where a link is lost, land where it stays lost."""
        plan, lost = self._plan, self._lost(now)
        if not lost:
            if self._lost_since is not None and plan.started:
                self._say("all are heard of again")
            self._lost_since = None
            return
        if self._lost_since is None:
            self._lost_since, self._reacted = now, -math.inf
            if plan.started:
                self._say(f"lost: {', '.join(lost)}")
        patient = now - self._lost_since < self._patience
        if not plan.started:
            if not patient and OPERATOR in lost:
                self._say("no operator is heard of, and the plan has not begun: the stream ends")
                self._quit = True
        elif self._job is None and now - self._reacted >= (AGAIN if patient else self._patience):
            moving = not (plan.descending or plan.resting)
            if moving if patient else plan.resting and not plan.landed:
                self._reacted = now
                self._queue.append("pause" if patient else "land")

    def _command(self) -> None:
        """Start the next command, or report the result of the present one."""
        if self._job is not None and self._job.done():
            try:
                self._say(self._job.result())
            except HitchoptError as error:
                self._say(str(error))
            self._job = None
            if self._plan.started and not self._armed:  # no hovering on the floor before
                self._outlet.arm()
                self._armed = True
        if self._job is None and self._queue:
            command = self._queue.popleft()
            self._job = self._later(lambda: self._plan.obey(command))

    def _prepare(self) -> None:
        """Compute setpoints ahead, unless a command is about to change them."""
        while len(self._ready) < max(1, round(LEAD * self._rate)):
            if self._job is not None or self._plan.landed:
                return
            self._ready.append(self._plan.step(1.0 / self._rate))

    def _send(self, now: float) -> None:
        """Send the setpoint that is due, the last one again where none is ready."""
        period = 1.0 / self._rate
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
        ended = self._plan.landed and not self._queue and self._job is None
        self.landed = ended and not self._ready and self._plan.started
