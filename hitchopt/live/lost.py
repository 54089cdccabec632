"""Reactions to the loss of a drone: survivors let go, and sink clear of where it swings and falls.

Survivors notice the loss after DELAY. From then on the plan's clock stops as soon as its
certificate allows, and the team sinks as a whole until its lowest drone is on the ground; drones
that are higher go straight down then. A team that sinks as a whole keeps all its distances. All
survivors of a hitch let tension go in a moment; the lost drone swings below its clasp then, while
its cable runs. Where cables hang free it has to reach the ground before its cable is taut, since no
drone carries two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.checks.drones import largest_at_rest, used_thrust
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, InputError, OneLine, Progress
from hitchopt.hitch import GRAVITY
from hitchopt.live.abort import straight_down, until_stop
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import append_motion, resting
from hitchopt.motion.states import States, states_at
from hitchopt.planners.forming.prehitch import smallest_separation
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.simulation.task import Task
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, nonnegative, positive

DELAY = 0.05  # time from the loss until the survivors react [s]
SHARE = 0.8  # of the limits, with which a team sinks
WAITS = (0.0, 0.1, 0.25)  # later begins of the stop, where polynomials do not follow the first [s]
LEAST = 1e-3  # height at which drones are on the ground [m]

# Time in which survivors let tension go [s]. Cables that stay level are pulled hardest by what
# falls, slack ones let it gather speed: in simulated flights peaks of tension were larger where all
# was let go at once, or in twice the time
RELEASE_TIME = 0.3

# Distance by which a lost drone draws its partner toward its clasp [m]: in simulated flights legs
# of 0.29 m were drawn to their clasps, those of 0.37 m were not; and the leg that remains
DRAWN, NEAREST_LEG = 0.36, 0.05

# Angle lost in a swing [rad]: it turns back below the height where it began, since cables that run
# take its energy. Computed swings of legs from 0.3 to 0.8 m, with tensions from none to 0.4 N and
# coefficients of friction up to 0.2, turned back 27° to 52° sooner
SWING_LOSS = np.radians(25.0)

# Numbers of angles of a swing, of lengths to which its cable may run, and of times at which
# survivors are compared with what lies on the ground; time between samples of a free fall [s]
SWINGS, RUNS, PLACES, FALL = 40, 5, 400, 0.02

# Usual distance of the times at which losses are looked at [s], and their smallest number
EVERY, FEWEST = 1.0, 8

# Checks of drones that land by themselves (how their cables come to lie is not looked at), and of
# the team before, the lost drone's place included; for all of the time
LANDED = ("separation", "speed", "acceleration", "jerk", "thrust", "tilt", "arena", "keep_out")
SUNK = (*LANDED, "cable_clearance", "crossing", "legs", "continuity")


@dataclass(frozen=True, eq=False)
class Reaction(OneLine):
    """A certified reaction to the loss of a drone."""

    drone: str
    begins: float  # when survivors react [s]
    motion: Motion  # the plan until then, and what all fly to the ground, whichever drone it is
    # largest thrust, over what there is, of a survivor that hovers while its cable, level, pulls
    # with the lost drone's weight
    thrust: float
    nearest: float  # smallest separation of survivors, or distance to the lost one over two radii


class Reactions:
    """The reactions of one plan; motions after a loss are computed once for all drones."""

    def __init__(self, motion: Motion) -> None:
        motion.refuse_several("a reaction to a lost drone")
        self.motion = motion
        self._flown = lru_cache(maxsize=256)(self._certified)

    def plan(self, drone: str, time: float) -> Reaction:
        """Return the reaction to the loss of a drone at a time [s].

        InfeasibleError names the limit that prevents it.
        """
        motion, names = self.motion, self.motion.team.drone_names
        if drone not in names:
            raise InputError("drone", drone, f"one of {', '.join(names)}", "name a drone")
        if nonnegative("t", time) > motion.duration:
            raise InputError("t", time, f"within {motion.duration:g} s", "ask within the plan")
        whole, states, lost = self._flown(float(time)), states_at(motion, time), names.index(drone)
        begins = min(time + DELAY, motion.duration)
        if bool(states.formed):
            thrust, nearest = self._hitched(lost, states)
        else:
            thrust, nearest = 0.0, self._falling(whole.drones, time, begins, lost)
        thrust = max(largest_at_rest(motion, used_thrust), thrust)
        if thrust > 1.0:
            raise _no_reaction(time, f"{drone} on its cable takes {thrust:.0%} of a thrust")
        if nearest < 1.0:
            raise _no_reaction(time, f"a survivor comes to {nearest:.3g} of its distance")
        return Reaction(drone, begins, whole, thrust, nearest)

    def _certified(self, time: float) -> Motion:
        """Return the certified motion after a loss at a time [s]."""
        if self.motion.team.has_cables and self.motion.requirements.objects:
            raise _no_reaction(time, "the team carries objects, or stands among them")
        words = list[str]()
        for wait in WAITS:
            motion, broken = _sunk_from(self.motion, time + DELAY + wait)
            if broken is None:
                return motion
            values = f"{broken.worst:.4g} {broken.unit} ({broken.number:.4g})"
            words.append(f"sinking breaks {broken.name}: {values}")
        raise _no_reaction(time, words[0])

    def _hitched(self, lost: int, states: States) -> tuple[float, float]:
        """Return the thrust and the nearest distance of a hitch that has lost a drone."""
        team, partner = self.motion.team, lost ^ 1
        points, others = team.layout.pulled_to, np.arange(team.drones) != lost
        near_loss = others & ((points == points[lost]) | (np.arange(team.drones) == partner))
        pulled = GRAVITY * np.hypot(team.mass, team.mass[lost]) / team.max_thrust
        leg = states.positions[partner] - states.vertices[points[partner]]
        size = float(np.linalg.norm(leg))
        gives = max(size - NEAREST_LEG, 0.0)
        swung = self._swung(lost, states, gives)
        moved = states.positions.copy()
        moved[partner] -= min(gives, DRAWN) / size * leg
        separation = self.motion.requirements.separation
        apart = smallest_separation(moved[None, others], separation)
        nearest = min(self._to_lost(states.positions[others, None], swung), apart)
        return float(np.max(pulled[near_loss])), nearest

    def _swung(self, lost: int, states: States, gives: float) -> Array:
        """Return places (k, 3) [m] of all swings below a clasp, as far as its cable may run.

        How far it runs depends on tension, friction and the partner, which is drawn along its leg
        by ``gives`` [m] at most.
        """
        clasp = states.vertices[self.motion.team.layout.pulled_to[lost]]
        leg = states.positions[lost] - clasp
        level = float(np.hypot(*leg[:2]))
        begins = np.arctan2(-leg[2], level)
        angles = np.linspace(begins, np.pi - begins - SWING_LOSS, SWINGS)[:, None]
        out = leg * [1.0, 1.0, 0.0] / max(level, 1e-9)
        arcs = np.cos(angles) * out - np.sin(angles) * [0.0, 0.0, 1.0]
        reach = np.linalg.norm(leg) + np.linspace(0.0, gives, RUNS)[:, None, None]
        places: Array = (clasp + reach * arcs).reshape(-1, 3)
        return np.maximum(places, [-np.inf, -np.inf, self.motion.requirements.floor])

    def _falling(self, drones: PiecewisePolynomial, time: float, begins: float, lost: int) -> float:
        """Return the nearest distance where cables hang free, or there are none."""
        team, floor = self.motion.team, self.motion.requirements.floor
        at_loss = self.motion.drones.at(time)[lost], self.motion.drones.at(time, 1)[lost]
        times, places = free_fall(*at_loss, floor)
        there = drones.at(np.minimum(time + times, drones.breaks[-1]))
        if team.has_cables:
            chords = np.linalg.norm(there[:, lost ^ 1] - places, axis=-1)
            taut = chords > team.cable_length[lost // 2]
            if np.any(taut):
                height = places[np.argmax(taut), 2] - floor
                words = f"hangs on its partner {height:.2g} m above the ground"
                raise _no_reaction(time, f"{team.drone_names[lost]} {words}")
        later = drones.at(np.linspace(begins, drones.breaks[-1], PLACES))  # no drone lands on it
        there, later = (np.delete(each, lost, axis=1) for each in (there, later))
        return min(self._to_lost(there, places[:, None]), self._to_lost(later, places[-1]))

    def _to_lost(self, survivors: Array, places: Array) -> float:
        """Return the smallest distance of survivors (…, 3) to places (…, 3) of the lost drone [m].

        It is over two radii in every direction: a drone without motors has no downwash.
        """
        distances = np.linalg.norm(survivors - places, axis=-1)
        radius = self.motion.requirements.separation.radius
        return float(np.min(distances, initial=np.inf)) / (2.0 * radius)


def _no_reaction(time: float, words: str) -> InfeasibleError:
    """Return the error that a loss at a time [s] has no reaction."""
    return InfeasibleError([], f"no reaction to a loss at t = {time:.4g} s: {words}")


def free_fall(position: Array, velocity: Array, floor: float) -> tuple[Array, Array]:
    """Return times (k,) [s] and places (k, 3) [m] of a free fall, the last one on the ground."""
    height, up = position[2] - floor, velocity[2]
    lasts = (up + np.sqrt(max(up**2 + 2.0 * GRAVITY * height, 0.0))) / GRAVITY
    times = np.append(np.arange(0.0, lasts, FALL), lasts)
    places = position + times[:, None] * velocity
    places[:, 2] -= 0.5 * GRAVITY * times**2
    return times, np.maximum(places, [-np.inf, -np.inf, floor])


def _heights(motion: Motion) -> Array:
    """Return how far drones are above the ground where a motion ends (2n,) [m]."""
    heights: Array = motion.drones.coefficients[-1, :, 2, -1] - motion.requirements.floor
    return heights


def _sunk_from(motion: Motion, time: float) -> tuple[Motion, Check | None]:
    """Return a plan that stops from a time [s] on and lands, and the first check it breaks."""
    motion = until_stop(motion, min(time, motion.duration)).motion
    if motion.phases[-1].formed or not motion.team.has_cables:
        motion = _sunk(motion)  # hanging cables would be dragged on the ground
    checks = [RULE_OF[name].check(motion) for name in SUNK]
    if np.max(_heights(motion)) > LEAST:
        landing = straight_down(motion)
        checks += [RULE_OF[name].check(landing) for name in LANDED]
        motion = append_motion(motion, landing)
    return motion, next((each for each in checks if each is not None and not each.holds), None)


def _sunk(motion: Motion) -> Motion:
    """Return a plan at rest whose team sinks as a whole then, its lowest drone to the ground."""
    depth, limits = float(np.min(_heights(motion))), motion.requirements.limits
    if depth <= LEAST:
        return motion
    bounds = (SHARE * bound for bound in (limits.speed, limits.acceleration, limits.jerk))
    down = fastest_clock(depth, *bounds)
    still = resting(motion, down.duration)
    still = still.map_curves(lambda part: on_breaks(part, down.breaks), still.phases)
    lower = down.coefficients[:, None, None] * np.array([0.0, 0.0, -1.0])[:, None]
    drones, vertices = (
        part.alike(part.coefficients + lower) for part in (still.drones, still.vertices)
    )
    return append_motion(motion, still.replaced(drones=drones, vertices=vertices))


def reacting(task: Task, reaction: Reaction) -> Task:
    """Return a plan's task until the survivors react, then what they fly, to the ground."""
    reacting_task = Task.of(reaction.motion)
    released = np.clip((reacting_task.t - reaction.begins) / RELEASE_TIME, 0.0, 1.0)[:, None, None]
    forces = reacting_task.setpoints.cable_forces * (1.0 - released**2 * (3.0 - 2.0 * released))
    setpoints = replace(reacting_task.setpoints, cable_forces=forces)
    parts = (
        task.team,
        task.t[0] + reacting_task.t,
        setpoints,
        reacting_task.formed,
        reacting_task.vertices,
        reacting_task.tensions,
    )
    return Task(*parts)


@dataclass(frozen=True)
class Lost(OneLine):
    """A span of a plan in which the loss of a drone has no certified reaction."""

    drone: str
    start: float  # half-way to the neighbouring sampled time [s]
    end: float
    reason: str  # why there is none, at its first time


def survivable(
    motion: Motion, every: float = EVERY, progress: Progress | None = None
) -> tuple[Check, list[Lost]]:
    """Return the share of (drone, time), about ``every`` [s], with a certified reaction to a loss.

    It is sampled, not a bound for all times. Spans without a reaction are listed.
    """
    reactions, names, without = Reactions(motion), motion.team.drone_names, list[Lost]()
    count = max(FEWEST, round(motion.duration / positive("every", every)))
    edges, refused = np.linspace(0.0, motion.duration, count + 1).tolist(), 0
    for name in names:
        for start, end in pairwise(edges):
            if progress is not None:
                progress(f"loss of {name} at t = {start:.4g} s")
            try:
                reactions.plan(name, 0.5 * (start + end))
            except InfeasibleError as error:
                refused += 1
                last = without[-1] if without else None
                if last is not None and (last.drone, last.end) == (name, start):
                    without[-1] = replace(last, end=end)
                else:
                    without.append(Lost(name, start, end, str(error)))
    share, where = 1.0 - refused / (count * len(names)), dict.fromkeys(x.drone for x in without)
    time = without[0].start if without else 0.0
    check = Check("survivable", True, share, None, "min", "1", time, tuple(where), "sampled")
    return check, without
