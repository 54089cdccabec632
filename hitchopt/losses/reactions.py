"""Reactions to the loss of a robot: when the plan's clock stops, who moves where, and how long.

The clock stops at prepared instants only: a loss is answered by the soonest rest of those stops
that begin DELAY after it. From that begin on, what follows depends on the stop and the robot alone,
so all reactions of a plan are known. The lost robot's drones rise; the neighbours at its clasps
move to where the other cables are a chain in balance (``hitchopt.hitch.losses``) as soon as they
stay clear of these; then tensions rise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from hitchopt.checks.stops import stop_phases, stop_table
from hitchopt.geometry.vectors import hull_distance
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.losses import Losses, places_after_loss
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import OPEN, Assignment
from hitchopt.losses.checks import RISE
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.retiming import on_clock, resting, truncated
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.planners.stages import line_progress, rise_seconds
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices, lazy
from hitchopt.values.fields import with_fields

DELAY = 0.1  # [s] Time from a loss until the others react
MAX_USED = 0.7  # Largest share of a limit that stopping uses where drones rise in the meantime

CLEAR = 0.01
"""[m] Distance beyond what is required of drones and cables, which are compared at samples."""

SAMPLES = 41  # Number of times at which drones on their ways are compared
STARTS = 9  # Number of times from which ends may begin to move


class PreparedStop(NamedTuple):
    """A stop of the plan's clock that keeps all limits, or its end."""

    since: float  # [s] Plan time from which on commands are answered by it, until it begins
    start: float  # [s] Plan time at which it begins
    seconds: float  # [s] Time until rest

    @property
    def rest(self) -> float:
        """Plan time at rest [s]."""
        return self.start + 0.5 * self.seconds

    def until_rest(self, flight: Flight) -> Flight:
        """Return a flight up to this rest."""
        return reduce(Flight.followed_by, self._parts(flight.untimed))

    def _parts(self, flight: Flight) -> Iterator[Flight]:
        """Yield a flight up to the stop, and the stop."""
        if self.start > JOINT:
            yield flight.each_team(lambda motion: truncated(motion, self.start))
        if self.seconds:
            yield flight.each_team(self.stopping)
        elif self.start <= JOINT:
            yield flight.each_team(lambda motion: resting(motion, DELAY, first=True))

    def stopping(self, motion: Motion) -> Motion:
        """Return a motion from the begin of the stop on, at t = 0, to its rest."""
        return on_clock(motion, stop_phases(np.array([self.start]), np.array([self.seconds])))


def prepared_stops(flight: Flight) -> list[PreparedStop]:
    """Return the stops that answer commands at all times of a flight, by time.

    They are those of ``stoppable`` that no later one precedes at rest.
    """
    table = stop_table(flight)
    starts = np.append(table.starts, table.end)
    seconds = np.append(table.durations, 0.0)
    rests = starts + seconds
    soonest_later = np.append(np.minimum.accumulate(rests[::-1])[-2::-1], math.inf)
    needed = rests < soonest_later
    since = np.append(flight.breaks[0], starts[needed][:-1])
    rows = zip(since.tolist(), starts[needed].tolist(), seconds[needed].tolist(), strict=True)
    return [PreparedStop(*row) for row in rows]


def rests_taut(run: Motion, motion: Motion, rest: float) -> bool:
    """Return whether a motion is at a plan time [s] where it is within a part with a taut hitch."""
    moved = motion.drones.at(rest) - motion.drones.at(_within(run, rest))
    return bool(np.max(np.abs(moved)) <= REST_DRIFT)


def _within(run: Motion, time: float) -> float:
    """Return the nearest time [s] of a part of a motion."""
    first, last = run.drones.breaks[[0, -1]]
    return float(np.clip(time, first, last))


@dataclass(frozen=True, eq=False)
class Chain:
    """What remains of a hitch without one of its cables."""

    motion: Motion  # The hitch
    cable: int  # The lost cable

    @lazy
    def need(self) -> Requirements:
        """Requirements of what follows the loss."""
        requirements = self.motion.requirements.in_haste
        limits = with_fields(requirements.limits, survive=None, duration=None)
        return replace(requirements, limits=limits)

    @property
    def lost(self) -> Indices:
        """Both drones of the lost cable."""
        return np.array([2 * self.cable, 2 * self.cable + 1])

    @lazy
    def cables(self) -> Indices:
        """The other cables, in order along the chain."""
        team = self.motion.team
        cables: Indices = np.arange(team.robots)
        if team.layout.closed:
            cables = np.roll(cables, -self.cable)
        others: Indices = cables[cables != self.cable]
        return others

    @lazy
    def drones(self) -> Indices:
        """Their drones, in order along the chain."""
        return np.column_stack([2 * self.cables, 2 * self.cables + 1]).ravel()

    @lazy
    def points(self) -> Indices:
        """Vertices of the chain, with the clasps that vanish, or its own ends."""
        layout = self.motion.team.layout
        return np.append(layout.starts[self.cables], layout.ends[self.cables[-1]])

    @lazy
    def team(self) -> Team:
        """The team of the chain.

        Its robots are numbered in the order of the problem, without the lost one.
        """
        team = self.motion.team
        cables = self.cables
        labels = np.array(team.labels)[cables]
        numbers = np.argsort(np.argsort(labels))
        flipped = (False,) * len(cables)
        if team.assignment is not None:
            flipped = tuple(team.assignment.flipped[cable] for cable in cables.tolist())
        return Team(
            len(cables),
            team.cable_length[cables],
            topology=OPEN,
            cable_density=team.cable_density,
            cable_friction=team.cable_friction,
            tension=team.tension[cables],
            quadrotor=[team.kinds[drone] for drone in self.drones.tolist()],
            errors=team.errors,
            release=team.release,
            assignment=Assignment(tuple(numbers.tolist()), flipped),
        )

    @lazy
    def swarm(self) -> Swarm:
        """Both drones of the lost robot."""
        return Swarm(2, quadrotor=[self.motion.team.kinds[drone] for drone in self.lost.tolist()])

    def reaction(self, run: Motion, rest: float, stopping: PiecewisePolynomial | None) -> Reaction:
        """Return the reaction from a rest [s], where the hitch is as in a part that is taut.

        ``stopping`` are paths of its drones (2n, 3) [m] from t = 0 to the rest; None without any.
        """
        motion = self.motion
        time = _within(run, rest)
        drones, vertices = motion.drones.at(time), motion.vertices.at(time)
        losses = Losses.of(motion.team.layout)
        moves = losses.lost == self.cable
        places, _ = places_after_loss(motion.team, drones, vertices, motion.tensions.at(time))
        balanced = drones.copy()
        balanced[losses.drone[moves]] = places[moves]
        return Reaction(self, stopping, drones, vertices, balanced)


@dataclass(frozen=True, eq=False)
class Reaction:
    """What follows the loss of a cable from the begin of a stop on; times are from there [s]."""

    chain: Chain  # The cables that remain
    stopping: PiecewisePolynomial | None  # (2n, 3) [m], paths to the rest; None at rest
    drones: Array  # (2n, 3) [m] at rest
    vertices: Array  # (points, 3) [m] at rest
    balanced: Array  # (2n, 3) [m], with both ends of the chain in balance

    @property
    def stops(self) -> float:
        """Time until rest."""
        return 0.0 if self.stopping is None else self.stopping.duration

    @property
    def rise(self) -> float:
        """[m] Height by which the lost robot's drones rise, above all others."""
        heights = np.concatenate([self.drones[:, 2], self.balanced[:, 2]])
        height = RISE * self.chain.need.with_reserve.separation.height
        return height + float(np.ptp(heights))

    @lazy
    def lift(self) -> PiecewisePolynomial:
        """(1,) [m] How far they have risen, from the begin of their rise on.

        They rise while they stop, with what limits leave, or else after it.
        """
        names = ("speed", "acceleration", "jerk")
        limits = self.chain.need.limits.with_reserve
        most = np.array([getattr(limits, name) for name in names])
        level, upright = self._used.T
        begin = 0.0
        if np.any(level + upright > MAX_USED * most):
            begin, level, upright = self.stops, np.zeros(3), np.zeros(3)
        left = np.sqrt(most**2 - level**2) - upright
        limits = with_fields(limits, **dict(zip(names, left.tolist(), strict=True)))
        start = self.drones[self.chain.lost]
        progress = line_progress(self.chain.swarm, limits, start, start + [0.0, 0.0, self.rise])
        lift = self.rise * progress.coefficients[:, None]
        return PiecewisePolynomial(begin + progress.breaks, lift)

    @property
    def _used(self) -> Array:
        """Horizontal and vertical speed, acceleration and jerk (3, 2) of these drones at most."""
        used = np.zeros((3, 2))
        if self.stopping is None:
            return used
        for order, row in enumerate(used, 1):
            rates = self.stopping.differentiated(order).coefficients[:, self.chain.lost]
            row[0] = np.max(np.linalg.norm(rates[:, :, :2], axis=2))
            row[1] = np.max(np.abs(rates[:, :, 2]))
        return used

    @property
    def start_of_reach(self) -> tuple[Array, Array]:
        """Drones and vertices of the chain (…, 3) [m] at rest."""
        return self.drones[self.chain.drones], self.vertices[self.chain.points]

    @property
    def end_of_reach(self) -> tuple[Array, Array]:
        """Drones and vertices of the chain (…, 3) [m] in balance.

        Cables have their lengths over vertices on the way: both ends move with their drones.
        """
        drones = self.balanced[self.chain.drones]
        clasps = self.vertices[self.chain.points]
        return drones, np.concatenate([drones[:1], clasps[1:-1], drones[-1:]])

    @lazy
    def progress(self) -> PiecewisePolynomial:
        """The progress of both ends of the chain on their ways."""
        limits = self.chain.need.limits.with_reserve
        return line_progress(self.chain.team, limits, self.start_of_reach[0], self.end_of_reach[0])

    @lazy
    def starts(self) -> float:
        """First time from which the ends reach their places clear of the lost robot's drones.

        Times are sampled: what follows is certified.
        """
        lift = self.lift
        times = np.linspace(0.0, self.progress.duration, SAMPLES)
        shares = self.progress.at(times)[:, None, None]
        drones, vertices = (
            start + shares * (end - start)
            for start, end in zip(self.start_of_reach, self.end_of_reach, strict=True)
        )
        ends = drones[:, [0, -1]]
        first = np.concatenate([drones[:, :2], vertices[:, :2]], axis=1)
        last = np.concatenate([drones[:, -2:], vertices[:, -2:]], axis=1)
        cables = np.stack([first, last], axis=1)  # corners of their regions
        own = self.drones[self.chain.lost]
        need = self.chain.need.with_reserve
        level = hull_distance(own[:, None, None, None, :2], cables[..., :2])  # (2, times, ends)
        top = np.max(cables[..., 2], axis=-1)
        first_lift, lifted = lift.breaks[[0, -1]].tolist()
        begins: list[float] = np.linspace(min(self.stops, lifted), lifted, STARTS).tolist()
        for begin in begins:  # the last one is after the rise
            heights = lift.at(np.clip(begin + times, first_lift, lifted))
            lost = own + heights[:, :, None] * [0.0, 0.0, 1.0]
            offsets = (lost[:, :, None] - ends[:, None]) * need.separation.scale
            gaps = np.linalg.norm(offsets, axis=-1)
            above = (lost.swapaxes(0, 1)[..., 2, None] - top) / need.height_ratio
            if (
                np.min(gaps) >= 1.0 + CLEAR / need.separation.radius
                and np.min(np.maximum(level, above)) >= need.separation.cable + CLEAR
            ):
                break
        return float(max(begin, self.stops))

    @property
    def taut(self) -> float:
        """Time until tensions are back."""
        return self.starts + self.progress.duration + rise_seconds(self.chain.team)
