"""Fly a plan by an operator's commands: its clock, landings after aborts, and lost links.

Nothing here reads the system's clock: ``SetpointStream.tick`` receives the time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache, partial
from typing import Protocol

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError, InputError
from hitchopt.hitch import GRAVITY
from hitchopt.live.abort import Aborts, AbortTable, moves_standing
from hitchopt.live.player import Player, Setpoints
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT
from hitchopt.motion.states import flight_states_at
from hitchopt.planners.candidates import Candidate, Effort, first_certified, outcome
from hitchopt.slices import provided
from hitchopt.values import Array, positive

COMMANDS = ("pause", "resume", "back", "abort", "land", "lose")
EFFECTS = {
    "pause": "at rest",
    "resume": "full speed",
    "back": "flying back at full speed",
    "abort": "aborting",
    "land": "landing",
}
"""Effects of commands in messages, before the time until then."""

OPERATOR = "operator"  # name of the operator's link
MAX_ATTEMPTS = 6  # number of nearest entries of an abort table that are tried
LEAD = 0.2  # time by which setpoints are computed ahead, and commands delayed [s]
DRONE_TIMEOUT = 0.5  # time without measurements after which their link is lost [s]
OPERATOR_TIMEOUT = 1.0  # time without messages of the operator after which the link is lost [s]
MAX_ERROR = 0.3  # error of drones up to which a plan continues from rest [m]
RETRY_DELAY = 0.25  # delay before a rejected hold is requested again [s]
FLOOR_TIME = 0.3  # duration of setpoints without cable forces after a landing [s]


@dataclass(frozen=True, eq=False)
class FleetSetpoints:
    """Setpoints sent to drones at one time, in the plan's axes."""

    setpoints: Setpoints
    thrusts: Array  # (drones, 3) [N], with the cable forces of the plan time
    thrust_rates: Array  # (drones, 3) [N/s]
    feed_forward: Array  # (drones, 3) [m/s²], ``a - G F / m``, for controllers without cable model


class CommandedPlan:
    """A plan at rest at its start, flown by commands; ``abort`` and ``land`` use tables.

    The tables of these commands may be planned further during the flight (``extend``).
    """

    def __init__(self, flight: Flight, tables: Mapping[str, AbortTable]) -> None:
        self.flight = flight
        self._player = _player_at(flight, 0.0, 0.0)
        self._landing_of = cache(
            lambda entry: _player_at(entry.flight, entry.start + entry.seconds, 1.0)
        )
        self._tables = dict[str, AbortTable]()
        for command, table in tables.items():
            self.extend(command, table)
        # command that holds until its table has been planned further, or until all rest
        self._waiting, self._awaits_rest = "", False
        self._is_extended = False  # whether that has happened
        self._landing: Player | None = None
        self.descending = False  # whether the landing itself has started
        self.started = False  # whether the plan has left its start
        self.lost = ""  # the robot that was lost, if any

    def extend(self, command: str, table: AbortTable) -> None:
        """Use a table that is planned further; another thread may call this."""
        for entry in table.entries:
            self._landing_of(entry)
        self._tables[command] = table
        self._is_extended = True

    def retry(self) -> str:
        """Return the command that waited and may be possible now, once; empty if there is none."""
        is_possible = self._player.resting if self._awaits_rest else self._is_extended
        if not (self._waiting and is_possible):
            return ""
        self._is_extended = False
        return self._waiting

    @property
    def time(self) -> float:
        """Plan time [s], of the landing once it has begun."""
        return self._player.time

    @property
    def resting(self) -> bool:
        """Return whether all drones are at rest and not about to move."""
        return self._player.resting and self._landing is None

    @property
    def landed(self) -> bool:
        """Return whether the plan is completed and the drones are on the ground."""
        flight = self._player.flight
        if not self._player.resting or self._player.time < flight.duration - JOINT:
            return False
        heights = flight.drones.coefficients[-1, :, 2, -1]
        ground = flight.requirements.ground_or(-math.inf)
        return self.descending or bool(np.all(heights <= ground + JOINT))

    def step(self, seconds: float) -> FleetSetpoints:
        """Advance the time [s] and return the setpoints to send.

        Those of drones that have landed have no cable forces: on the floor they would tip drones.
        """
        if self._landing is not None and self._player.resting:
            self._player, self._landing = self._landing, None
            self.descending = True
        flight, setpoints = self._player.flight, self._player.step(seconds)
        states, team = flight_states_at(flight, [setpoints.time]), flight.team
        listed, share = self._player.listed, 0.0 if self.landed else 1.0
        mass = states.masses[0, listed, None]
        forces = states.held_forces(team.false_pull)[0, listed]
        rates = states.held_force_rates(team.false_pull)[0, listed]
        forward = setpoints.accelerations - share * forces / mass
        return FleetSetpoints(
            setpoints,
            mass * (forward + [0.0, 0.0, GRAVITY]),
            mass * setpoints.jerks - setpoints.rate * share * rates,
            forward,
        )

    def obey(self, command: str) -> str:
        """Execute one of COMMANDS, such as ``lose 2``; return a message with its effect.

        Raises InfeasibleError if that is not possible now; the current command continues.
        """
        name, _, robot = command.partition(" ")
        if name not in COMMANDS or bool(robot) != (name == "lose"):
            raise InputError("command", command, f"one of {', '.join(COMMANDS)}", "choose one")
        self._waiting, self._awaits_rest = "", False
        if robot:
            return self._lose(robot)
        if command in self._tables:
            return self._land_chain(command) if self.lost else self._land(command)
        if self.lost and command == "back":
            raise InfeasibleError([], f"back: robot {self.lost} is lost")
        if self.descending and command == "back":
            raise InfeasibleError([], "back: the landing has begun; pause and resume it only")
        seconds = getattr(self._player, command)()
        self.started = self.started or command == "resume"
        self._landing = None
        return f"{EFFECTS[command]} in {seconds:.2f} s"

    def _await_rest(self, command: str) -> None:
        """Let a command be retried at the next rest."""
        self._waiting, self._awaits_rest = command, True

    def _lose(self, robot: str) -> str:
        """Stop, and fly on without a robot; that is planned at rest, where delays are harmless."""
        player = self._player
        if self.lost or self.descending:
            after = f"robot {self.lost} is lost" if self.lost else "the landing has begun"
            raise InfeasibleError([], f"lose {robot}: no reaction since {after}; land")
        if not player.resting:
            provided("check_loss")(player.flight, robot, player.time)
            self._landing, seconds = None, player.pause()
            self._await_rest(f"lose {robot}")
            return f"lose {robot}: at rest in {seconds:.2f} s"
        team = provided("team_of_robot")(player.flight, robot)

        def with_chain() -> str:
            """Hold the chain that remains."""
            return f"the others hold a chain in {player.lose(robot):.2f} s"

        def without_cables() -> str:
            """Hover without the cables of the team."""
            found = provided("dropped_at_rest")(player.flight, team.name, player.time)
            player.follow(found.flight, found.drones)
            return "no chain is certified: all drop their cables and hover"

        answers = [Candidate("chain", with_chain)]
        if team.motion.team.release:
            answers.append(Candidate("hover without cables", without_cables))
        effect = first_certified(answers, Effort())
        self.lost = robot
        return f"robot {robot} is lost: {effect}"

    def _land_chain(self, command: str) -> str:
        """Land what remains after a loss once it is held: as commanded, or else in another way.

        The last way is without cables, where drones can drop them.
        """
        player = self._player
        if self.descending:
            return f"landing continues at full speed in {player.resume():.2f} s"
        flight, is_held = player.flight, player.time >= player.flight.duration - JOINT
        if not (player.resting and is_held):
            if player.resting:
                player.resume()
            self._await_rest(command)
            return f"{command}: as soon as the chain is held"
        chain = flight.teams[0]  # what remains; then the lost robot's drones, and other teams

        def land(before: Flight, drones: tuple[str, ...], how: str) -> None:
            """Land from the end of a flight; setpoints keep their order."""
            found = Aborts(before).plan(before.duration, how)
            landing = found.flight.between(found.start + found.seconds, found.flight.duration)
            player.follow(landing, drones)

        def land_chain(how: str) -> str:
            """Land with its cables, and return how."""
            land(flight, flight.team.drone_names, how)
            return how

        def land_without_cables() -> str:
            """Drop all cables and land, and return how."""
            found = provided("dropped_at_rest")(flight, chain.name, player.time)
            land(found.flight, found.drones, "land")
            return "without cables"

        hows = dict.fromkeys((self._tables[command].how, "release_and_land", "land"))
        answers = [Candidate("landing", partial(land_chain, how)) for how in hows]
        if chain.motion.team.release:
            answers.append(Candidate("landing without cables", land_without_cables))
        flown = first_certified(answers, Effort())
        self.descending = True
        return f"{EFFECTS[command]}: {flown}"

    def _land(self, command: str) -> str:
        """Move the clock to the nearest rest with a landing, preferably a later one.

        No object that is now at rest on its support moves. While no such landing is planned, it
        may be an earlier one, or the clock stops until there is one.
        """
        if self.descending:
            return f"landing continues at full speed in {self._player.resume():.2f} s"
        self._is_extended = False
        time, table = self._player.time, self._tables[command]
        refusal = InfeasibleError([], f"{command}: the plan has no such landing")
        entries = [x for x in table.entries if not moves_standing(self.flight, time, x.rest)]
        nearest = sorted(entries, key=lambda x: (x.rest < time, abs(x.rest - time)))
        for entry in nearest[:MAX_ATTEMPTS]:
            seconds = outcome(partial(self._player.seek, entry.rest))
            if isinstance(seconds, InfeasibleError):
                refusal = seconds
                continue
            self._landing = self._landing_of(entry)
            is_behind = bool(table.pending) and entry.rest < time
            back = f", back at t = {entry.rest:.4g} s: {ahead_planned(table)}"
            return f"{EFFECTS[command]} in {seconds:.2f} s{back if is_behind else ''}"
        if not table.pending:
            raise refusal
        seconds, self._waiting = self._player.pause(), command
        return f"{command}: {ahead_planned(table)}; stops within {seconds:.2f} s and waits for one"


def ahead_planned(table: AbortTable) -> str:
    """Return words on how far a table is planned."""
    return f"no landing ahead is planned yet ({table.planned:.0%} of the plan done)"


def _player_at(flight: Flight, time: float, rate: float) -> Player:
    """Return a player with computed stops, so that a pause is immediate."""
    player = Player(flight, time, rate)
    _ = player.stops
    return player


class Outlet(Protocol):
    """A connection to a fleet that receives setpoints."""

    def send(self, targets: FleetSetpoints, now: float) -> None:
        """Send each drone its setpoint at a time [s]; network failures are ignored."""

    def measured(self) -> dict[str, Array]:
        """Return received positions (3,) [m] in the plan's axes, by drone names."""

    def arm(self) -> None:
        """Arm the drones before the plan leaves its start."""

    def close(self, *, landed: bool) -> None:
        """End the stream."""


class SetpointStream:
    """A plan that is streamed to a fleet in ticks.

    ``commands`` returns the operator's commands since the last call, and whether the operator is
    connected; ``watched`` drones must be measured. ``submit`` starts the computation of a command,
    as ``Executor.submit``, while setpoints are sent at a ``rate`` [Hz]. After ``patience`` [s] a
    lost link leads to a landing.
    """

    def __init__(
        self,
        plan: CommandedPlan,
        outlet: Outlet,
        commands: Callable[[], tuple[list[str], bool]],
        watched: tuple[str, ...],
        submit: Callable[[Callable[[], str]], Future[str]],
        say: Callable[[str], None],
        *,
        rate: float = 50.0,
        patience: float = 5.0,
    ) -> None:
        self._plan, self._outlet, self._commands = plan, outlet, commands
        self._submit, self._say = submit, say
        self._rate, self._patience = positive("rate", rate), positive("patience", patience)
        self._timeouts = dict.fromkeys(watched, DRONE_TIMEOUT) | {OPERATOR: OPERATOR_TIMEOUT}
        self._last_message = dict.fromkeys(self._timeouts, -math.inf)  # times of links [s]
        self._measured: dict[str, Array] = {}
        self._buffer: deque[FleetSetpoints] = deque()
        self._queue: deque[str] = deque()
        self._job: Future[str] | None = None
        self._last: FleetSetpoints | None = None
        self._next = self._last_reaction = -math.inf
        self._lost_since: float | None = None
        self._quit = self._armed = False
        self.landed = False  # whether the plan is completed and drones are on the ground
        self.late = 0  # setpoints sent repeatedly, because a command took longer than the lead

    def tick(self, now: float) -> bool:
        """Process messages, commands and setpoints at a time [s]; return whether to continue."""
        measured = self._outlet.measured()
        self._measured |= measured
        commands, is_connected = self._commands()
        active = [*measured, OPERATOR] if is_connected else measured
        self._last_message |= dict.fromkeys(active, now)
        for command in commands:
            self._queue_command(command, now)
        self._handle_lost_links(now)
        self._run_command()
        # A running command may change the setpoints that are computed ahead
        while len(self._buffer) < max(1, round(LEAD * self._rate)):
            if self._job is not None or self._plan.landed:
                break
            self._buffer.append(self._plan.step(1.0 / self._rate))
            if self._plan.landed:
                self._buffer.extend([self._buffer[-1]] * round(FLOOR_TIME * self._rate))
        self._send(now)
        return not (self.landed or self._quit)

    def _lost_links(self, now: float) -> list[str]:
        """Return the names of lost links, including those never established."""
        timeouts = self._timeouts.items()
        return [name for name, timeout in timeouts if now - self._last_message[name] > timeout]

    def _queue_command(self, command: str, now: float) -> None:
        """Queue an operator's command, or report why it is not allowed now."""
        plan = self._plan
        if command == "end":
            command = "land" if plan.started else "quit"
        if command == "toggle":
            command = "resume" if plan.resting else "pause"
        refusal = ""
        if command == "quit":
            self._quit = not plan.started and self._job is None and not self._queue
            refusal = "" if self._quit else "drones have left their start; land first"
        elif command in ("resume", "back"):
            refusal = self._reason_to_stay(now)
        if command not in ("pause", "resume", "quit") and not plan.started:
            refusal = "the plan has not begun"
        if refusal:
            self._say(f"{command}: {refusal}")
        elif command != "quit":
            self._queue.append(command)

    def _reason_to_stay(self, now: float) -> str:
        """Return why the plan may not continue from rest; empty if it may."""
        lost = self._lost_links(now)
        if lost:
            return f"no signal from {', '.join(lost)}"
        if self._last is not None and self._plan.resting:
            names = self._plan.flight.team.listed_names
            for name, setpoint in zip(names, self._last.setpoints.positions, strict=True):
                error = float(np.linalg.norm(self._measured.get(name, setpoint) - setpoint))
                if error > MAX_ERROR:
                    return f"{name} is {error:.2f} m from its setpoint, more than {MAX_ERROR:g} m"
        return ""

    def _handle_lost_links(self, now: float) -> None:
        """Hold when a link is lost, and land if it is not restored."""
        plan, lost = self._plan, self._lost_links(now)
        if not lost:
            if self._lost_since is not None and plan.started:
                self._say("all links are restored")
            self._lost_since = None
            return
        if self._lost_since is None:
            self._lost_since, self._last_reaction = now, -math.inf
            if plan.started:
                self._say(f"lost: {', '.join(lost)}")
        is_brief = now - self._lost_since < self._patience
        delay = RETRY_DELAY if is_brief else self._patience
        if not plan.started:
            if not is_brief and OPERATOR in lost:
                self._say("no operator is connected, and the plan has not begun: the stream ends")
                self._quit = True
        elif self._job is None and now - self._last_reaction >= delay:
            is_moving = not (plan.descending or plan.resting)
            if is_moving if is_brief else plan.resting and not plan.landed:
                self._last_reaction = now
                self._queue.append("pause" if is_brief else "land")

    def _run_command(self) -> None:
        """Start the next command, or report the result of the current one."""
        if self._job is not None and self._job.done():
            try:
                self._say(self._job.result())
            except HitchoptError as error:
                self._say(str(error))
            self._job = None
            if self._plan.started and not self._armed:  # not before, to avoid idling on the floor
                self._outlet.arm()
                self._armed = True
        if self._job is None and (retried := self._plan.retry()):
            self._queue.append(retried)
        if self._job is None and self._queue:
            command = self._queue.popleft()
            self._job = self._submit(lambda: self._plan.obey(command))

    def _send(self, now: float) -> None:
        """Send the setpoint that is due, or repeat the last one if the buffer is empty."""
        period = 1.0 / self._rate
        if now < self._next:
            return
        due = 1 if self._last is None else max(1, int((now - self._next) / period) + 1)
        self._next = now + period if self._last is None else self._next + due * period
        for _ in range(due):
            if not self._buffer:
                self.late += 1
                break
            self._last = self._buffer.popleft()
        if self._last is not None:
            self._outlet.send(self._last, now)
        is_complete = self._plan.landed and not self._queue and self._job is None
        self.landed = is_complete and not self._buffer and self._plan.started
