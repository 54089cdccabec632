"""What is flown: the plan on its clock, then, after an abort, the certified landing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.states import states_at
from hitchopt.stopping.abort import Abort
from hitchopt.stopping.abort_table import AbortTable
from hitchopt.stopping.player import Player
from hitchopt.stopping.sampler import Setpoints
from hitchopt.values import Array

Later = Callable[[Callable[[], Player]], Future[Player]]
"""Start a computation, as ``Executor.submit`` does."""

COMMANDS = ("pause", "resume", "back", "abort", "land")

TRIES = 6
"""Number of a table's entries that the clock is led to, the nearest first."""


@dataclass(frozen=True, eq=False)
class Flown:
    """What drones are sent at one time, in the plan's axes.

    Attributes
    ----------
    setpoints: positions and derivatives.
    thrusts, thrust_rates: (drones, 3) [N], [N/s], with the cables' pull at that plan time.
    feed_forward: (drones, 3) [m/s²], ``a - F / m``, for controllers that know no cable.
    """

    setpoints: Setpoints
    thrusts: Array
    thrust_rates: Array
    feed_forward: Array


class Course:
    """A plan at rest at its start, to be flown by commands.

    Parameters
    ----------
    motion: the plan.
    tables: aborts of the plan for the commands ``abort`` and ``land``.
    later: starts the preparation of a landing while drones are on the way to it.
    """

    def __init__(self, motion: Motion, tables: Mapping[str, AbortTable], later: Later) -> None:
        self.motion = motion
        self._tables = tables
        self._later = later
        self._player = Player(motion, rate=0.0)
        _ = self._player.stops  # a pause must not wait for them
        self._landing: Future[Player] | None = None
        self.descending = False
        """Whether the landing itself has begun."""
        self.begun = False
        """Whether the plan has ever left its start."""

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

    def step(self, seconds: float) -> Flown:
        """Let time [s] pass and return what drones are sent then."""
        if self._landing is not None and self._player.resting and self._landing.done():
            self._player, self._landing = self._landing.result(), None
            self.descending = True
        return self._flown(self._player.step(seconds))

    def obey(self, command: str) -> str:
        """Carry out one of COMMANDS; return what is done, in words.

        Raises
        ------
        InputError: another word.
        InfeasibleError: it cannot be done now; what was done before goes on.
        """
        if command not in COMMANDS:
            raise InputError("command", command, f"one of {', '.join(COMMANDS)}", "choose one")
        if command in ("abort", "land"):
            return self._land(command)
        if self.descending and command == "back":
            raise InfeasibleError([], "back: the landing has begun; pause and resume it only")
        seconds = getattr(self._player, command)()
        self.begun = self.begun or command == "resume"
        self._landing = None
        return f"{command}: takes {seconds:.2f} s"

    def _land(self, command: str) -> str:
        table = self._tables[command]
        if self.descending:
            return f"landing goes on, in {self._player.resume():.2f} s"
        time = self._player.time
        entries = sorted(table.entries, key=lambda each: (each.rest < time, abs(each.rest - time)))
        refusal = InfeasibleError([], f"{table.how}: the plan has no abort of this kind")
        for entry in entries[:TRIES]:
            try:
                seconds = self._player.seek(entry.rest)
            except InfeasibleError as error:
                refusal = error
                continue
            self._landing = self._later(partial(_landing, entry))
            return f"{table.how}: begins in {seconds:.2f} s"
        raise refusal

    def _flown(self, setpoints: Setpoints) -> Flown:
        motion = self._player.motion
        states = states_at(motion, [setpoints.time])
        mass = motion.team.mass[:, None]
        pull = states.cable_forces[0]
        forward = setpoints.accelerations - pull / mass
        return Flown(
            setpoints,
            mass * (forward + [0.0, 0.0, GRAVITY]),
            mass * setpoints.jerks - setpoints.rate * states.cable_force_rates[0],
            forward,
        )


def _landing(entry: Abort) -> Player:
    """Return the player of what follows the rest of an entry, which it is ready to stop."""
    player = Player(entry.certified.motion, entry.start + entry.seconds)
    _ = player.stops
    return player
