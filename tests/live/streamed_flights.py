"""A small plan, and stand-ins for its operator and fleet, on a clock of their own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.live.abort import AbortTable, abort_table
from hitchopt.live.fly import Course, Flight, Flown

Array = NDArray[np.float64]
T = TypeVar("T")

PATIENCE = 2.0


@cache
def plan_of() -> ho.Plan:
    """A triangle off the origin, one vertex of which is moved."""
    polygon = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
    return ho.move_vertex(ho.Hitch.spread(ho.Team(3, 2.4), polygon), 0, by=[0.0, 0.4])


@cache
def landing_plan() -> ho.Plan:
    """Two drones without cables that change places and end on the ground."""
    start = np.array([[1.0, 0.0, 1.0], [2.0, 0.5, 1.2]])
    goal = np.array([[2.0, 0.5, 0.0], [1.0, 0.1, 0.0]])
    return ho.separate(ho.SwarmProblem(ho.Swarm(2), start, goal))


@cache
def tables() -> dict[str, AbortTable]:
    motion = plan_of().motion
    return {"land": abort_table(motion, "land"), "abort": abort_table(motion, "release_and_land")}


@cache
def swarm_tables() -> dict[str, AbortTable]:
    return dict.fromkeys(("land", "abort"), abort_table(landing_plan().motion, "land", 0.5))


def at_once(compute: Callable[[], T]) -> Future[T]:
    """Compute now."""
    done: Future[T] = Future()
    try:
        done.set_result(compute())
    except ho.HitchoptError as error:
        done.set_exception(error)
    return done


class Rig:
    """Operator and fleet at once; time passes with ``run`` only."""

    def __init__(
        self,
        later: Callable[[Callable[[], str]], Future[str]] = at_once,
        rate: float = 50.0,
        *,
        swarm: bool = False,
    ) -> None:
        self.plan = plan = landing_plan() if swarm else plan_of()
        self.names = plan.motion.team.drone_names
        self.course = Course(plan.motion, swarm_tables() if swarm else tables())
        self.pressed: list[str] = []
        self.operator = True
        self.silent: set[str] = set()
        self.off = np.zeros(3)
        self.sent: list[Flown] = []
        self.said: list[str] = []
        self.now, self.going, self.rate = 100.0, True, rate
        parts = self.course, self, self.commands, self.names, later, self.said.append
        self.flight = Flight(*parts, rate=rate, patience=PATIENCE)

    def send(self, flown: Flown, now: float) -> None:
        assert now == self.now
        self.sent.append(flown)

    def measured(self) -> dict[str, Array]:
        if not self.sent:
            return {}
        places = zip(self.names, self.sent[-1].setpoints.positions, strict=True)
        return {name: place + self.off for name, place in places if name not in self.silent}

    def close(self, *, landed: bool) -> None:
        raise AssertionError(landed)

    def commands(self) -> tuple[list[str], bool]:
        found, self.pressed = self.pressed, []
        return found, self.operator

    def run(self, seconds: float, *commands: str) -> None:
        self.pressed += commands
        end = self.now + seconds
        while self.going and self.now < end - 1e-9:
            self.now += 1.0 / self.rate
            self.going = self.flight.tick(self.now)

    def begin(self, seconds: float) -> None:
        """Look at the start, and fly for some time."""
        self.run(0.1)
        self.run(seconds, "resume")

    @property
    def speed(self) -> float:
        return float(np.max(np.abs(self.sent[-1].setpoints.velocities)))

    @property
    def lowest(self) -> float:
        return float(np.min(self.sent[-1].setpoints.positions[:, 2]))

    def check(self) -> None:
        """All that was sent keeps the limits, and follows from the setpoint before."""
        limits, step = self.plan.motion.requirements.limits, 1.0 / self.rate
        series = [flown.setpoints for flown in self.sent]
        positions, velocities, accelerations = (
            np.array([getattr(each, name) for each in series])
            for name in ("positions", "velocities", "accelerations")
        )
        for values, most in ((velocities, limits.speed), (accelerations, limits.acceleration)):
            assert np.max(np.linalg.norm(values, axis=-1)) <= most * (1.0 + 1e-6)
        led = positions[:-1] + 0.5 * step * (velocities[1:] + velocities[:-1])
        assert np.max(np.abs(positions[1:] - led)) <= limits.jerk * step**3
