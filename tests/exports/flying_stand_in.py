"""Stands for crazyflie_py and a fleet of Crazyflies whose planners evaluate uploaded memory.

Semantics of the firmware's high-level commander: an upload copies pieces into memory at once, a
trajectory, also a finished one, is evaluated from there at every step, and takeoff, goTo and land
fly a piece outside of that memory.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 0.04
"""[s] Between looks at the setpoints."""

RADIO = 0.002
"""[s] What one piece takes to upload: faster than any radio, so that scripts have to wait."""

POWERS = np.arange(8)


def rest_to_rest(duration: float, start: Array, goal: Array) -> Array:
    """Return one piece (33,) from position, velocity and acceleration (3, 3) to rest at a goal.

    Degree 7; jerk is zero at both ends.
    """
    rows, values = [], []
    for t, ends in ((0.0, [*start, np.zeros(3)]), (duration, [goal, *np.zeros((3, 3))])):
        for order, value in enumerate(ends):
            rows.append([np.polynomial.Polynomial.basis(k).deriv(order)(t) for k in POWERS])
            values.append(value)
    powers = np.linalg.solve(np.array(rows), np.array(values)).T
    return np.concatenate([[duration], powers.ravel(), np.zeros(8)])


class Craft:
    """One Crazyflie: its trajectory memory, its planner, and what it does between them."""

    def __init__(self, fleet: Fleet, name: str, needs_arming: bool) -> None:
        self.fleet, self.name = fleet, name
        self.memory = np.zeros((31, 33))
        self.defined: dict[int, tuple[int, int]] = {}
        self.state = "idle"
        self.armed = not needs_arming
        self.pieces = self.memory[:0]
        self.begun = 0.0
        self.setpoint = np.zeros((3, 3))
        """Position, velocity, acceleration: the last; where it stands while it is idle."""
        self.worst_jump = 0.0

    def evaluate(self) -> Array:
        """What the planner gives now, (3, 3): position, velocity and acceleration."""
        t = self.fleet.now - self.begun
        for piece in self.pieces:
            if t <= piece[0]:
                return self._at(piece, t)
            t -= piece[0]
        last = self._at(self.pieces[-1], self.pieces[-1][0])
        last[1:] = 0.0
        return last

    @staticmethod
    def _at(piece: Array, t: float) -> Array:
        out, powers = [], piece[1:25].reshape(3, 8)
        for _ in range(3):
            out.append(powers @ t ** np.arange(powers.shape[1]))
            powers = powers[:, 1:] * np.arange(1, powers.shape[1])
        return np.array(out)

    def look(self, dt: float) -> None:
        """Take the present setpoint and compare it with what the last one leads to."""
        if self.state == "idle":
            return
        here = self.evaluate()
        led = self.setpoint[0] + 0.5 * dt * (self.setpoint[1] + here[1])
        self.worst_jump = max(self.worst_jump, float(np.linalg.norm(here[0] - led)))
        self.setpoint = here
        if self.state == "landing" and self.fleet.now > self.begun + self.pieces[0][0]:
            self.state = "idle"
            self.setpoint[1:] = 0.0

    def _fly(self, state: str, pieces: Array) -> None:
        if not self.armed:
            return
        self.state, self.pieces, self.begun = state, pieces, self.fleet.now
        self.fleet.look(0.0)

    def _go(self, state: str, goal: Array, duration: float) -> None:
        self._fly(state, rest_to_rest(duration, self.setpoint, goal)[None])

    def takeoff(self, targetHeight: float, duration: float) -> None:
        if self.state == "idle":
            self._go("flying", np.array([*self.setpoint[0, :2], targetHeight]), duration)

    def land(self, targetHeight: float, duration: float) -> None:
        self._go("landing", np.array([*self.setpoint[0, :2], targetHeight]), duration)

    def goTo(self, goal: Array, _yaw: float, duration: float) -> None:
        self.fleet.calls.append((self.name, "goTo"))
        self._go("flying", np.asarray(goal), duration)

    def arm(self, arm: bool = True) -> None:
        self.fleet.calls.append((self.name, "arm"))
        self.armed = arm

    def uploadTrajectory(self, number: int, offset: int, trajectory: Rows) -> None:
        self.fleet.calls.append((self.name, "uploadTrajectory"))
        for i, row in enumerate(trajectory.rows):
            self.memory[offset + i] = row
            self.fleet.pass_time(RADIO)
        self.defined[number] = (offset, len(trajectory.rows))

    def startTrajectory(
        self, number: int, timescale: float = 1.0, reverse: bool = False, relative: bool = True
    ) -> None:
        if (timescale, reverse, relative) != (1.0, False, False):
            raise NotImplementedError("plans are flown as they are, in the room's coordinates")
        offset, count = self.defined[number]
        self._fly("flying", self.memory[offset : offset + count])  # a view: memory as it is then


class OldCraft(Craft):
    """As clients before arming know it."""

    @property
    def arm(self) -> None:  # type: ignore[override]
        raise AttributeError("arm")


class Rows:
    """Stands for uav_trajectory.Trajectory."""

    def loadcsv(self, path: Path) -> None:
        self.rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)


class Fleet:
    """Stands for Crazyswarm, its allcfs and its timeHelper at once.

    ``starts`` is where the drones stand; ``answers`` are given to the scripts' questions.
    """

    def __init__(
        self, starts: dict[str, Array], kind: type[Craft] = Craft, needs_arming: bool = True
    ) -> None:
        self.now = 0.0
        self.calls: list[tuple[str, str]] = []
        self.crazyfliesByName = {name: kind(self, name, needs_arming) for name in starts}
        for name, place in starts.items():
            self.crazyfliesByName[name].setpoint[0] = place
        self.allcfs = self.timeHelper = self

    @property
    def worst_jump(self) -> float:
        """[m] The largest of all drones since they took off."""
        return max(craft.worst_jump for craft in self.crazyfliesByName.values())

    def look(self, dt: float) -> None:
        for craft in self.crazyfliesByName.values():
            craft.look(dt)

    def pass_time(self, duration: float) -> None:
        count = max(1, round(duration / STEP))
        for _ in range(count):
            self.now += duration / count
            self.look(duration / count)

    def sleep(self, duration: float) -> None:
        self.pass_time(duration)

    def _each(self, call: str) -> Callable[..., None]:
        def command(*args: object, **keys: object) -> None:
            self.calls.append(("all", call))
            for craft in self.crazyfliesByName.values():
                getattr(craft, call)(*args, **keys)

        return command

    def __getattr__(self, name: str) -> Callable[..., None]:
        if name not in {"takeoff", "land", "startTrajectory"}:
            raise AttributeError(name)
        return self._each(name)

    def run(
        self,
        monkeypatch: pytest.MonkeyPatch,
        script: Path,
        arguments: Sequence[str] = (),
        answer: str = "",
    ) -> None:
        """Run a script as a user does."""
        package, reader = ModuleType("crazyflie_py"), ModuleType("crazyflie_py.uav_trajectory")
        package.__dict__["Crazyswarm"] = lambda: self
        reader.__dict__["Trajectory"] = Rows
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, "crazyflie_py", package)
            patched.setitem(sys.modules, "crazyflie_py.uav_trajectory", reader)
            patched.setattr("builtins.input", lambda _: answer)
            patched.setattr(sys, "argv", [script.name, *arguments])
            runpy.run_path(str(script), run_name="__main__")
