"""A small plan, and stand-ins for its operator and fleet, on a clock of their own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import cache

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.live.abort import AbortTable, abort_table
from hitchopt.live.fly import Course, Flight, Flown

Array = NDArray[np.float64]

PATIENCE = 2.0


@cache
def plan_of(*, swarm: bool = False) -> ho.Plan:
    """A triangle off the origin, one vertex of which is moved.

    Or two drones without cables that change places and end on the ground.
    """
    if swarm:
        start = np.array([[1.0, 0.0, 1.0], [2.0, 0.5, 1.2]])
        goal = np.array([[2.0, 0.5, 0.0], [1.0, 0.1, 0.0]])
        return ho.separate(ho.SwarmProblem(ho.Swarm(2), start, goal))
    polygon = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]
    return ho.move_vertex(ho.Hitch.spread(ho.Team(3, 2.4), polygon), 0, by=[0.0, 0.4])


@cache
def tables(*, swarm: bool) -> dict[str, AbortTable]:
    motion = plan_of(swarm=swarm).motion
    if swarm:
        return dict.fromkeys(("land", "abort"), abort_table(motion, "land", 0.5))
    return {"land": abort_table(motion, "land"), "abort": abort_table(motion, "release_and_land")}


def check_setpoints(series: list[ho.Setpoints], limits: ho.Limits, step: float) -> None:
    """Setpoints, a step [s] apart, keep the limits, and each follows from the one before."""
    names = "positions", "velocities", "accelerations", "jerks"
    p, v, a, j = (np.array([getattr(each, name) for each in series]) for name in names)
    for values, most in ((v, limits.speed), (a, limits.acceleration), (j, limits.jerk)):
        assert np.max(np.linalg.norm(values, axis=-1)) <= most * (1.0 + 1e-6)
    led = p[:-1] + 0.5 * step * (v[1:] + v[:-1])
    assert np.max(np.abs(p[1:] - led), initial=0.0) <= limits.jerk * step**3


def at_once(compute: Callable[[], str]) -> Future[str]:
    """Compute now."""
    done: Future[str] = Future()
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
        self.plan = plan_of(swarm=swarm)
        self.names = self.plan.motion.team.drone_names
        self.course = Course(self.plan.motion, tables(swarm=swarm))
        self.pressed: list[str] = []
        self.operator, self.silent, self.off = True, set[str](), np.zeros(3)
        self.sent: list[Flown] = []
        self.said: list[str] = []
        self.now, self.going, self.rate = 100.0, True, rate
        parts = self.course, self, self.commands, self.names, later, self.said.append
        self.flight = Flight(*parts, rate=rate, patience=PATIENCE)

    def send(self, flown: Flown, now: float) -> None:
        assert now == self.now
        self.sent.append(flown)

    def measured(self) -> dict[str, Array]:
        places = [p + self.off for p in self.sent[-1].setpoints.positions] if self.sent else []
        found = zip(self.names, places, strict=False)
        return {name: place for name, place in found if name not in self.silent}

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

    def check(self, *, landed: bool) -> None:
        """All that was sent keeps the limits, and follows from the setpoint before."""
        series = [flown.setpoints for flown in self.sent]
        check_setpoints(series, self.plan.motion.requirements.limits, 1.0 / self.rate)
        assert self.flight.landed == landed
        assert not landed or abs(np.min(series[-1].positions[:, 2])) <= 1e-9
