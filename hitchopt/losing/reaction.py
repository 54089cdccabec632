"""Reactions to the loss of a drone: who lets tension go and when, who moves where, how they land.

Survivors notice the loss after DELAY. From then on the plan's clock stops as soon as its
certificate allows, and the team sinks as a whole, as fast as the limits leave room for, until it is
on the ground; drones above others go aside and land by themselves. All survivors of a hitch let
tension go in a moment; where a hitch can hold the lost drone and it hangs still once it has swung
down, they come to pull as its weight needs, until it lies on the ground. They do so at once where
its leg or its partner's is short and its fall would end on the cable, not on the ground: on what
has run by then it falls far, and draws its partner to its clasp. Else they push inward for a while,
so that they do not spring back from where it has drawn them. Where cables hang free the lost drone
has to reach the ground before its cable is taut, since no drone carries two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from hitchopt.checks.bounds.static_thrust import largest_static_thrust
from hitchopt.checks.certificate import Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.hitch import GRAVITY, Team
from hitchopt.losing.falling import GAIN, free_fall, resting_place
from hitchopt.losing.pushing import pushing
from hitchopt.losing.reaction_records import Course, Held, Reaction
from hitchopt.losing.sinking import SHARE, Sinking, alone, deepest_first, landed, stopped, sunk
from hitchopt.losing.spacing import apart, to_lost
from hitchopt.losing.swinging import LEAST_LEG, swings
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import followed, resting
from hitchopt.motion.states import States, states_at
from hitchopt.stopping.abort import Aborts
from hitchopt.values import Array, not_negative

DELAY = 0.05
"""[s] Time from the loss until the survivors react."""

HOLD = 0.1
"""[s] Rest of drones whose cables hang free before they land."""

SWING = 0.8
"""[s] Time in which a lost drone swings down: one that lies on the ground then is not held."""

CAUGHT, AT_ONCE = (1.0, 2.0), (DELAY, 2.0 * DELAY)
"""[s] Times after the loss between which survivors come to pull as a hanging drone needs; AT_ONCE
where a leg is short and the ground is far."""

OVERSHOOT = 1.2
"""Distance over which a weight that falls draws a partner, over that at rest: in simulated flights
legs of 0.29 m were drawn to their clasps, those of 0.37 m were not."""

STOPS = (1.0, 1.5, 2.2)
"""Durations of the clock's stop that are tried, over that of the shortest one."""

COURSES = 12
"""Number of courses that are certified, before one that sinks only after the stop."""

SWUNG = 0.65
"""[s] Time after the loss at which a lost drone pulls most: a team that has sunk deeper by then
brakes it less. In simulated flights peaks of tension were larger where it had not sunk yet."""

SUNK = (
    "speed",
    "acceleration",
    "jerk",
    "thrust",
    "tilt",
    "separation",
    "cable_clearance",
    "crossing",
    "legs",
    "arena",
    "keep_out",
    "continuity",
)
"""Checks of the team while it sinks, the lost drone's place included; for all of the time."""

LANDED = ("separation", "speed", "acceleration", "jerk", "thrust", "tilt", "arena", "keep_out")
"""Checks of drones that land by themselves."""


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
        course = self.course(float(time))
        lost = names.index(drone)
        states = states_at(self.motion, time)
        if bool(states.formed):
            return pushing(self.motion, states, lost, *self._hitched(course, drone, lost))
        return self._falling(course, drone, lost, states)

    def _course(self, time: float) -> Course:
        motion = self.motion
        if motion.team.has_cables and motion.requirements.objects:
            raise _none(time, "the team carries objects, or stands among them")
        begins = min(time + DELAY, motion.duration)
        stoppings = [stopped(motion, self._aborts.stops, begins, stop) for stop in STOPS]
        first = stoppings[0]
        tries = deepest_first(stoppings, begins, time + SWUNG)[:COURSES]
        tries.append(Sinking(first, first.motion.duration, SHARE))
        if motion.team.has_cables and not first.motion.phases[-1].formed:
            tries = [replace(tries[-1], share=0.0)]  # cables are not dragged over the ground
        refusal: Check | None = None
        for each in tries:
            held = followed(each.stopping.motion, resting(each.stopping.motion, HOLD))
            sinking = sunk(each) if each.share else held
            checks = list(_checks(sinking, SUNK))
            landing = tuple(alone(sinking, landed(sinking)))
            checks += [check for part in landing for check in _checks(part, LANDED)]
            broken = next((check for check in checks if not check.holds), None)
            if broken is None:
                return Course(time, begins, sinking, landing, each.share, tuple(checks))
            refusal = refusal or broken
        raise _none(time, _words(refusal))

    def _hitched(self, course: Course, drone: str, lost: int) -> tuple[Reaction, Array]:
        """Return the reaction of a hitch, whose clasps hold the lost drone's cable, but for pushes.

        With it come places (m, 3) [m] through which the lost drone swings.
        """
        motion, team = self.motion, self.motion.team
        states = states_at(motion, course.time)
        floor = motion.requirements.floor
        rest = resting_place(motion, states, lost)
        if rest is None:
            return self._dropped(course, drone, lost, states)
        if rest.thrust > 1.0:
            raise _none(course.time, f"{drone} on its cable takes {rest.thrust:.0%} of a thrust")
        others, point = np.arange(team.drones) != lost, team.layout.pulled_to[lost]
        start, end = states.positions[lost], rest.positions[lost]
        longest = float(np.linalg.norm(end - rest.vertices[point]))
        arcs = swings(team, states, lost, longest, floor)
        nearest = min(
            to_lost(motion, states.positions[others], arcs),
            to_lost(motion, rest.positions[others], end[None]),
            apart(motion, rest.positions[others]),
        )
        _check_apart(course, nearest)
        t = np.linspace(course.begins, course.sinking.duration, 400)
        sunk_by = start[2] - course.sinking.drones.at(t)[:, lost, 2]
        there = np.flatnonzero(sunk_by >= end[2] - floor)
        lands = float(t[there[0]]) if len(there) else course.sinking.duration
        held, pair, farther = None, [lost, lost ^ 1], OVERSHOOT * _gives(team, lost)
        legs = states.positions[pair] - states.vertices[team.layout.pulled_to[pair]]
        lengths = np.linalg.norm(legs, axis=-1)
        deep = start[2] - floor > np.sum(lengths) + farther  # else it falls to the ground
        short = deep and np.min(lengths) < farther
        if not rest.lies and lands > course.time + CAUGHT[0]:
            begins, full = AT_ONCE if short else CAUGHT
            held = Held(rest.pulls, course.time + begins, course.time + full, lands)
        return Reaction(drone, course, rest.thrust, nearest, held), arcs

    def _dropped(
        self, course: Course, drone: str, lost: int, states: States
    ) -> tuple[Reaction, Array]:
        """Return the reaction of a hitch that cannot hold a lost drone, but lets it down.

        All let go, and the partner gives way as far as the weight moves it: that and what the team
        has sunk once the lost drone has swung down must reach to the ground.
        """
        motion, team = self.motion, self.motion.team
        points, partner = team.layout.pulled_to, lost ^ 1
        clasps, floor = states.vertices[points], motion.requirements.floor
        legs = states.positions - clasps
        lengths = np.linalg.norm(legs, axis=-1)
        gives = min(_gives(team, lost), float(lengths[partner]) - LEAST_LEG)
        when = min(course.time + SWING, course.sinking.duration)
        sunk_by = float(states.positions[lost, 2] - course.sinking.drones.at(when)[lost, 2])
        above = float(clasps[lost, 2]) - floor - float(lengths[lost]) - gives - sunk_by
        if above > 0.0:
            words = f"no rest was found with {drone} on its cable, {above:.2g} m above the ground"
            raise _none(course.time, words)
        moved = states.positions.copy()
        moved[partner] -= gives * legs[partner] / lengths[partner]
        others = np.arange(team.drones) != lost
        arcs = swings(team, states, lost, float(lengths[lost]) + gives, floor)
        nearest = min(apart(motion, moved[others]), to_lost(motion, moved[others], arcs))
        _check_apart(course, nearest)
        thrust = largest_static_thrust(motion)
        return Reaction(drone, course, thrust, nearest), arcs

    def _falling(self, course: Course, drone: str, lost: int, states: States) -> Reaction:
        """Return the reaction of drones whose cables hang free, or that have none."""
        motion, team = self.motion, self.motion.team
        times, places = free_fall(
            states.positions[lost], states.velocities[lost], motion.requirements.floor
        )
        whole = course.sinking.drones
        there = whole.at(np.minimum(course.time + times, whole.breaks[-1]))
        others = np.arange(len(team.drone_names)) != lost
        nearest = min(
            to_lost(motion, each[others], place[None])
            for each, place in zip(there, places, strict=True)
        )
        if nearest < 1.0:
            raise _none(course.time, f"{drone} falls past a survivor at {nearest:.3g}")
        nearest = min(nearest, self._lying(course, others, places[-1], drone))
        thrust = largest_static_thrust(motion)
        if team.has_cables:
            chords = np.linalg.norm(there[:, lost ^ 1] - places, axis=-1)
            taut = chords > team.cable_length[lost // 2]
            if np.any(taut):
                height = places[np.argmax(taut), 2] - motion.requirements.floor
                words = f"{drone} hangs on its partner {height:.2g} m above the ground"
                raise _none(course.time, words)
        return Reaction(drone, course, thrust, nearest)

    def _lying(self, course: Course, others: Array, place: Array, drone: str) -> float:
        """Return the smallest separation of survivors and a drone that lies on the ground."""
        parts = [course.sinking, *course.landing]
        least = np.inf
        for part in parts:
            t = np.linspace(course.begins if part is parts[0] else 0.0, part.duration, 200)
            least = min(
                least, to_lost(part, part.drones.at(t)[:, others].reshape(-1, 3), place[None])
            )
        if least < 1.0:
            raise _none(course.time, f"a survivor lands on {drone}, at {least:.3g}")
        return float(least)


def _gives(team: Team, lost: int) -> float:
    """Return how far a lost drone's weight draws its partner from its setpoint [m]."""
    return GRAVITY / GAIN * float(team.mass[lost] / team.mass[lost ^ 1])


def _checks(motion: Motion, names: tuple[str, ...]) -> Iterator[Check]:
    """Yield the checks of a motion, up to the first that does not hold."""
    for name in names:
        found = RULE_OF[name].check(motion)
        if found is not None:
            yield found
            if not found.holds:
                return


def _check_apart(course: Course, nearest: float) -> None:
    if nearest < 1.0:
        raise _none(course.time, f"a survivor comes to {nearest:.3g} of its separation")


def _words(refusal: Check | None) -> str:
    if refusal is None:
        return "nothing was tried"
    return (
        f"sinking breaks {refusal.name}: {refusal.worst:.4g} {refusal.unit} ({refusal.number:.4g})"
    )


def _none(time: float, words: str) -> InfeasibleError:
    return InfeasibleError([], f"no reaction to a loss at t = {time:.4g} s: {words}")
