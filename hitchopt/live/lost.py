"""Reactions to the loss of a drone: survivors let go, and sink clear of where it swings and falls.

Survivors notice the loss after DELAY. From then on the plan's clock stops as soon as its
certificate allows, and the team sinks as a whole until it is on the ground: at once with the
largest of a few shares of the limits that the stop leaves, else after the stop. Drones that are
higher go straight down then. A team that sinks as a whole keeps all its distances. All survivors of
a hitch let tension go in a moment; the lost drone swings below its clasp then, while its cable
runs. Where cables hang free it has to reach the ground before its cable is taut, since no drone
carries two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check
from hitchopt.checks.drones import largest_static_thrust
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, InputError, OneLine, Progress
from hitchopt.hitch import GRAVITY
from hitchopt.live.abort import Aborts, until_stop
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase
from hitchopt.motion.retiming import followed, resting
from hitchopt.motion.states import States, sample_times, states_at
from hitchopt.planners.forming.turns import straight
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.simulation.task import SAME_TIME, Setpoints, Task
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array, not_negative, positive

DELAY = 0.05
"""[s] Time from the loss until the survivors react."""

LETTING_GO = 0.3
"""[s] Time in which survivors let tension go. Cables that stay level are pulled hardest by what
falls, slack ones let it gather speed: in simulated flights peaks of tension were larger where all
was let go at once, or in twice the time."""

SHARES = (0.8, 0.5, 0.3)
"""Shares of the limits that sinking is tried with from the reaction on, while the clock stops."""

HOLD, REST = 0.1, 0.2
"""[s] Rest of drones whose cables hang free before they land, and of a team that has sunk."""

LEAST = 1e-3
"""[m] Drones that are so low are on the ground."""

DRAWN, NEAREST_LEG = 0.36, 0.05
"""[m] How far a lost drone draws a partner of its mass toward its clasp: in simulated flights legs
of 0.29 m were drawn to their clasps, those of 0.37 m were not; and the leg that remains."""

GAIN, DAMPING = 36.0, 10.0
"""[1/s²], [1/s] Stiffness and damping over mass of usual position loops."""

FRICTION = 0.2
"""Largest coefficient at the clasps, where the team's own is not larger. A cable turns by half a
turn about both of them while one end of it hangs."""

STEP, LASTS, EACH = 2e-3, 1.2, 5
"""[s] Step and time of a swing, which has turned back by then, and steps between its places."""

FALL, RATE = 0.02, 100.0
"""[s], [Hz] Time between samples of a free fall, and rate of a reaction's setpoints."""

EVERY, FEWEST = 1.0, 8
"""[s] Usual distance of the times at which losses are looked at, and their smallest number."""

SUNK = (
    *("speed", "acceleration", "jerk", "thrust", "tilt", "separation", "cable_clearance"),
    *("crossing", "legs", "arena", "keep_out", "continuity"),
)
"""Checks of the team while it sinks, the lost drone's place included; for all of the time."""

LANDED = ("separation", "speed", "acceleration", "jerk", "thrust", "tilt", "arena", "keep_out")
"""Checks of drones that land by themselves."""


@dataclass(frozen=True, eq=False)
class Course(OneLine):
    """What the survivors fly after a loss at a time, whichever drone it is.

    Attributes
    ----------
    time: of the loss [s].
    begins: when they react [s].
    sinking: the plan until ``begins``, and what follows until the lowest drone is on the ground.
    landing: the flights after that, of drones by themselves.
    checks: of all of it.
    """

    time: float
    begins: float
    sinking: Motion
    landing: tuple[Motion, ...]
    checks: tuple[Check, ...]

    @property
    def duration(self) -> float:
        """Time at which all are on the ground [s]."""
        return self.sinking.duration + sum(each.duration for each in self.landing)


@dataclass(frozen=True, eq=False)
class Reaction(OneLine):
    """A certified reaction to the loss of a drone.

    Attributes
    ----------
    drone: that is lost.
    course: what survivors fly.
    thrust: largest thrust of a survivor that hovers while its cable, level, pulls with the lost
        drone's weight, over its largest one.
    nearest: smallest separation of two survivors, or distance of one to the lost drone over two
        radii.
    """

    drone: str
    course: Course
    thrust: float
    nearest: float


class Reactions:
    """The reactions of one plan: what they have in common is computed once.

    Parameters
    ----------
    motion: the plan.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.course = lru_cache(maxsize=256)(self._course)
        self._aborts = Aborts(motion)

    def found(self, drone: str, time: float) -> Reaction:
        """Return the reaction to the loss of a drone at a time [s].

        Raises
        ------
        InputError: no such drone, or a time outside the plan.
        InfeasibleError: none was found; says what binds.
        """
        names = self.motion.team.drone_names
        if drone not in names:
            raise InputError("drone", drone, f"one of {', '.join(names)}", "name a drone")
        if not_negative("t", time) > self.motion.duration:
            raise InputError("t", time, f"within {self.motion.duration:g} s", "ask within the plan")
        course, states = self.course(float(time)), states_at(self.motion, time)
        found = self._hitched if bool(states.formed) else self._falling
        thrust, nearest = found(course, names.index(drone), states)
        if thrust > 1.0:
            raise _none(time, f"{drone} on its cable takes {thrust:.0%} of a thrust")
        if nearest < 1.0:
            raise _none(time, f"a survivor comes to {nearest:.3g} of its distance")
        return Reaction(drone, course, thrust, nearest)

    def _course(self, time: float) -> Course:
        motion = self.motion
        if motion.team.has_cables and motion.requirements.objects:
            raise _none(time, "the team carries objects, or stands among them")
        begins = min(time + DELAY, motion.duration)
        stopped = self._stopped(begins)
        if motion.team.has_cables and not stopped.phases[-1].formed:
            tries = [followed(stopped, resting(stopped, HOLD))]  # no cable is dragged on the ground
        else:
            tries = [_sunk(stopped, begins, share) for share in SHARES]
            tries.append(_sunk(stopped, stopped.duration, 1.0))
        refusal: Check | None = None
        for sinking in tries:
            landing = tuple(_landed(sinking))
            checks = list(_checks(sinking, SUNK))
            checks += [check for part in landing for check in _checks(part, LANDED)]
            broken = next((check for check in checks if not check.holds), None)
            if broken is None:
                return Course(time, begins, sinking, landing, tuple(checks))
            refusal = refusal or broken
        assert refusal is not None
        values = f"{refusal.worst:.4g} {refusal.unit} ({refusal.number:.4g})"
        raise _none(time, f"sinking breaks {refusal.name}: {values}")

    def _stopped(self, time: float) -> Motion:
        """Return the plan that rests as soon after a time [s] as its clock can."""
        motion = self.motion.untimed
        if time >= motion.duration - JOINT:
            return motion
        return until_stop(motion, *self._aborts.stops.after(time), REST)[0]

    def _hitched(self, _course: Course, lost: int, states: States) -> tuple[float, float]:
        """Return the thrust and the nearest distance of a hitch that has lost a drone."""
        motion, team = self.motion, self.motion.team
        points, partner = team.layout.pulled_to, lost ^ 1
        others = np.arange(team.drones) != lost
        beside = others & ((points == points[lost]) | (np.arange(team.drones) == partner))
        pulled = GRAVITY * np.hypot(team.mass, team.mass[lost]) / team.max_thrust
        leg = states.positions[partner] - states.vertices[points[partner]]
        size = float(np.linalg.norm(leg))
        gives = max(size - NEAREST_LEG, 0.0)
        swung = self._swung(lost, states, gives)
        moved = states.positions.copy()
        moved[partner] -= min(gives, DRAWN * team.mass[lost] / team.mass[partner]) / size * leg
        nearest = min(
            _to_lost(motion, states.positions[others], swung),
            _to_lost(motion, moved[others], swung[np.argmin(swung[:, 2])][None]),
            _apart(motion, moved[others]),
        )
        return max(float(np.max(pulled[beside])), largest_static_thrust(motion)), nearest

    def _swung(self, lost: int, states: States, gives: float) -> Array:
        """Return places (k, 3) [m] of a swing below its clasp, up to where it turns back.

        The clasp stays where it is, the partner is a mass on the spring of its position loop, drawn
        along its leg by ``gives`` [m] at most. What it pulls with, and what friction takes of that,
        is not known: cases have the tension or none, and frictions from none to the largest.
        """
        team, floor = self.motion.team, self.motion.requirements.floor
        clasp = states.vertices[team.layout.pulled_to[lost]]
        leg = states.positions[lost] - clasp
        size, level = float(np.linalg.norm(leg)), float(np.hypot(*leg[:2]))
        mass, other = team.mass[[lost, lost ^ 1]].tolist()
        friction = max(team.cable_friction, FRICTION)
        ratio, pull = np.meshgrid(
            np.exp(friction * np.pi * np.linspace(0.0, 1.0, 3)), [0.0, states.tensions[lost // 2]]
        )
        run, speed, turning = np.zeros((3, *pull.shape))
        angle = np.full(pull.shape, np.arctan2(-leg[2], level))
        back = np.zeros(pull.shape, dtype=np.bool_)
        found = [(size + run, angle)]
        for _ in range(round(LASTS / STEP)):
            outward = mass * ((size + run) * turning**2 + GRAVITY * np.sin(angle))
            held = pull + other * (GAIN * run + DAMPING * speed)
            runs = (outward - ratio * held) / (mass + ratio * other)
            returns = (outward - held / ratio) / (mass + other / ratio)
            starts = np.where(runs > 0.0, runs, np.minimum(returns, 0.0))
            rate = np.where(speed > 0.0, runs, np.where(speed < 0.0, returns, starts))
            faster = speed + STEP * rate
            faster = np.where(faster * speed < 0.0, 0.0, faster)  # friction holds before it returns
            ended = (run >= gives) & (faster > 0.0) | (run <= 0.0) & (faster < 0.0)
            speed = np.where(ended | back, 0.0, faster)
            swing = (GRAVITY * np.cos(angle) - 2.0 * speed * turning) / (size + run)
            turning = np.where(back, 0.0, turning + STEP * swing)
            back |= turning < 0.0
            run = np.clip(run + STEP * np.where(back, 0.0, speed), 0.0, gives)
            angle = angle + STEP * np.where(back, 0.0, turning)
            found.append((size + run, angle))
        reach, angle = (np.ravel(part) for part in zip(*found[::EACH], strict=True))
        out = leg * [1.0, 1.0, 0.0] / max(level, 1e-9)
        arcs = np.cos(angle)[:, None] * out - np.sin(angle)[:, None] * [0.0, 0.0, 1.0]
        places: Array = np.maximum(clasp + reach[:, None] * arcs, [-np.inf, -np.inf, floor])
        return places

    def _falling(self, course: Course, lost: int, states: States) -> tuple[float, float]:
        """Return the same of drones whose cables hang free, or that have none."""
        motion, team, whole = self.motion, self.motion.team, course.sinking.drones
        floor = motion.requirements.floor
        times, places = free_fall(states.positions[lost], states.velocities[lost], floor)
        there = whole.at(np.minimum(course.time + times, whole.breaks[-1]))
        others = np.arange(len(team.drone_names)) != lost
        nearest = min(
            _to_lost(motion, each[others], place[None])
            for each, place in zip(there, places, strict=True)
        )
        for part in (course.sinking, *course.landing):  # nobody lands on it
            t = np.linspace(course.begins if part is course.sinking else 0.0, part.duration, 200)
            near = part.drones.at(t)[:, others].reshape(-1, 3)
            nearest = min(nearest, _to_lost(motion, near, places[-1:]))
        if team.has_cables:
            chords = np.linalg.norm(there[:, lost ^ 1] - places, axis=-1)
            taut = chords > team.cable_length[lost // 2]
            if np.any(taut):
                height = places[np.argmax(taut), 2] - floor
                words = f"hangs on its partner {height:.2g} m above the ground"
                raise _none(course.time, f"{team.drone_names[lost]} {words}")
        return largest_static_thrust(motion), nearest


def _checks(motion: Motion, names: tuple[str, ...]) -> Iterator[Check]:
    """Yield the checks of a motion, up to the first that does not hold."""
    for name in names:
        found = RULE_OF[name].check(motion)
        if found is not None:
            yield found
            if not found.holds:
                return


def _none(time: float, words: str) -> InfeasibleError:
    return InfeasibleError([], f"no reaction to a loss at t = {time:.4g} s: {words}")


def _to_lost(motion: Motion, survivors: Array, places: Array) -> float:
    """Return the smallest distance of survivors (k, 3) and places of the lost drone (m, 3) [m].

    It is over two radii in every direction: ellipsoids are higher for the downwash, which a drone
    without motors has not, and does not mind.
    """
    distances = np.linalg.norm(survivors[:, None] - places, axis=-1)
    return float(np.min(distances, initial=np.inf)) / (2.0 * motion.requirements.separation.radius)


def _apart(motion: Motion, survivors: Array) -> float:
    """Return the smallest separation of two survivors (k, 3) [m]."""
    scale = motion.requirements.separation.scale
    i, j = np.triu_indices(len(survivors), 1)
    distances = np.linalg.norm((survivors[i] - survivors[j]) * scale, axis=-1)
    return float(np.min(distances, initial=np.inf))


def free_fall(position: Array, velocity: Array, floor: float) -> tuple[Array, Array]:
    """Return times (k,) [s] and places (k, 3) [m] of a free fall, the last one on the ground."""
    height, up = position[2] - floor, velocity[2]
    lasts = (up + np.sqrt(max(up**2 + 2.0 * GRAVITY * height, 0.0))) / GRAVITY
    times = np.append(np.arange(0.0, lasts, FALL), lasts)
    places = position + times[:, None] * velocity
    places[:, 2] -= 0.5 * GRAVITY * times**2
    return times, np.maximum(places, [-np.inf, -np.inf, floor])


def _depth(motion: Motion) -> float:
    """Return how far the lowest drone is above the ground where a motion ends [m]."""
    heights = motion.drones.coefficients[-1, :, 2, -1]
    return float(np.min(heights)) - motion.requirements.floor


def _shift(motion: Motion, share: float) -> PiecewisePolynomial:
    """Return the offset (3,) [m] of a team that sinks to the ground with a share of the limits."""
    limits = motion.requirements.limits
    bounds = limits.speed, limits.acceleration, limits.jerk
    down = fastest_clock(_depth(motion), *(share * bound for bound in bounds))
    below = np.array([0.0, 0.0, -1.0])[:, None]
    return PiecewisePolynomial(down.breaks, below * down.coefficients[:, None])


def _sunk(motion: Motion, begin: float, share: float) -> Motion:
    """Return a plan that stops and sinks from a time on until its lowest drone is on the ground."""
    if _depth(motion) <= LEAST:
        return followed(motion, resting(motion, REST))
    shift = _shift(motion, share)
    end = begin + shift.duration + REST
    if end > motion.duration + JOINT:
        motion = followed(motion, resting(motion, end - motion.duration))
    parts = [PiecewisePolynomial.constant([0.0, begin], np.zeros(3))] if begin > JOINT else []
    rest = [0.0, motion.duration - begin - shift.duration]
    parts += [shift, PiecewisePolynomial.constant(rest, shift.coefficients[-1, ..., -1])]
    whole = joined(parts)
    whole = PiecewisePolynomial(np.append(whole.breaks[:-1], motion.duration), whole.coefficients)
    breaks = merged_breaks([motion.drones.breaks, whole.breaks])
    moved = on_breaks(whole, breaks)
    finer = motion.changed(lambda part: on_breaks(part, breaks), motion.phases)

    def shifted(part: PiecewisePolynomial) -> PiecewisePolynomial:
        degree = max(part.degree, moved.degree)
        by = moved.elevated(degree).coefficients[:, None]
        return PiecewisePolynomial(breaks, part.elevated(degree).coefficients + by)

    return finer.altered(drones=shifted(finer.drones), vertices=shifted(finer.vertices))


def _landed(motion: Motion) -> Iterator[Motion]:
    """Yield the flights of drones by themselves, straight down from where a motion ends."""
    team, need = motion.team, motion.requirements
    start = motion.drones.coefficients[-1, ..., -1]
    down = start.copy()
    down[:, 2] = need.floor
    if np.max(start[:, 2]) - need.floor > LEAST:
        flight = straight(team, need.limits.planned, start, down)
        step = motion.phases[-1].step
        phase = Phase("land", step, 0.0, flight.duration, state=CableState.GROUND)
        yield Motion.single(team, need, flight, [phase])


def reacting(task: Task, reaction: Reaction) -> Task:
    """Return a plan's task until the survivors react, then what they fly, to the ground."""
    course = reaction.course
    first = task.t < task.t[0] + course.begins - SAME_TIME
    own = sample_times(course.sinking.duration, RATE)
    own = np.append(course.begins, own[own > course.begins + SAME_TIME])
    rows, offset = [(own, states_at(course.sinking, own))], course.sinking.duration
    for part in course.landing:
        own = sample_times(part.duration, RATE)[1:]
        rows.append((offset + own, states_at(part, own)))
        offset += part.duration
    times = np.concatenate([t for t, _ in rows])

    def after(name: str) -> Array:
        found: Array = np.concatenate([getattr(states, name) for _, states in rows])
        return found

    gone = np.clip((times - course.begins) / LETTING_GO, 0.0, 1.0)
    keeps = 1.0 - gone**2 * (3.0 - 2.0 * gone)
    names = [field.name for field in fields(Setpoints)]
    values = {name: after(name) for name in names}
    values["cable_forces"] *= keeps[:, None, None]
    whole = [np.concatenate([getattr(task.setpoints, name)[first], values[name]]) for name in names]
    formed = after("formed").astype(np.bool_)
    return Task(
        task.team,
        np.concatenate([task.t[first], task.t[0] + times]),
        Setpoints(*whole),
        np.concatenate([task.formed[first], formed]),
        np.concatenate(
            [task.vertices[first], np.where(formed[:, None, None], after("vertices"), 0.0)]
        ),
        np.concatenate([task.tensions[first], np.where(formed[:, None], after("tensions"), 0.0)]),
    )


@dataclass(frozen=True)
class Lost(OneLine):
    """A span of a plan in which the loss of a drone has no certified reaction.

    Attributes
    ----------
    drone: its name.
    start, end: [s], half-way to the neighbouring times that were looked at.
    reason: why there is none, at its first time.
    """

    drone: str
    start: float
    end: float
    reason: str


@dataclass(frozen=True, eq=False)
class Survivable(OneLine):
    """Reactions over all of a plan, at sampled times.

    Attributes
    ----------
    t: (k,) [s]
    covered: (k, D), whether there is a reaction.
    without: spans without one, by drone and time.
    """

    t: Array
    covered: NDArray[np.bool_]
    without: tuple[Lost, ...]

    @property
    def share(self) -> float:
        """Share of (drone, time) with a reaction."""
        return float(np.mean(self.covered))

    @property
    def check(self) -> Check:
        """The share as a certificate lists it; it is sampled, not a bound for all of the time."""
        time = self.without[0].start if self.without else 0.0
        where = tuple(dict.fromkeys(lost.drone for lost in self.without))
        return Check("survivable", True, self.share, None, "min", "1", time, where, "sampled")


def survivable(
    motion: Motion, every: float = EVERY, progress: Progress | None = None
) -> Survivable:
    """Return which losses of a drone have a certified reaction, about ``every`` [s].

    Raises
    ------
    InputError: a distance that is not positive.
    """
    reactions, names = Reactions(motion), motion.team.drone_names
    count = max(FEWEST, round(motion.duration / positive("every", every)))
    edges = np.linspace(0.0, motion.duration, count + 1)
    t = 0.5 * (edges[1:] + edges[:-1])
    reasons: list[list[str]] = []
    for time in t.tolist():
        if progress is not None:
            progress(f"losses at t = {time:.4g} s")
        reasons.append([_reason(reactions, name, time) for name in names])
    covered = np.array([[not reason for reason in row] for row in reasons])
    without = []
    for drone, name in enumerate(names):
        bounds = np.flatnonzero(np.diff(np.concatenate([[True], covered[:, drone], [True]])))
        for first, last in bounds.reshape(-1, 2).tolist():
            span = float(edges[first]), float(edges[last])
            without.append(Lost(name, *span, reasons[first][drone]))
    return Survivable(t, covered, tuple(without))


def _reason(reactions: Reactions, name: str, time: float) -> str:
    """Return why there is no reaction; nothing where there is one."""
    try:
        reactions.found(name, time)
    except InfeasibleError as error:
        return str(error)
    return ""
