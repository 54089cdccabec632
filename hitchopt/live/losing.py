"""The plan after the loss of a robot in flight, from the loss on.

The lost robot's drones have dropped their cable. For DELAY, all fly on; then the plan's clock
stops, and these drones rise above all others, as the check ``survivable`` allows. Both neighbouring
drones at the cable's clasps move to where the remaining cables are an open chain in balance
(``hitchopt.hitch.losses``), and tensions rise again. Until then cables are loose, as the check
``survivable`` assumes.

Candidates rise while the clock stops if limits allow, and let the ends move before the others are
up if they stay clear; the last one does one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.losses import RISE, taut_runs
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry.vectors import hull_distance, unit
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.losses import Losses, places_after_loss
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import OPEN, Assignment
from hitchopt.live.abort import HOLD, Aborts, StoppedPlan, until_stop
from hitchopt.motion.flight import Flight, TeamMotion, team_label
from hitchopt.motion.motion import JOINT, CableState, HoldBy, Motion, Phase, concatenated
from hitchopt.motion.retiming import MIN_SPACING, padded, resting, shifted, slice_time, truncated
from hitchopt.motion.states import fitted_hitch
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.forming.stages import (
    PAUSE,
    SMOOTH,
    line_progress,
    on_lines,
    rise_seconds,
    straight_lines,
)
from hitchopt.planners.losses import DELAY
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array, Indices, check_choice, known, lazy, nonnegative
from hitchopt.values.fields import with_fields

CHAIN = "chain"
"""Name of the team that remains, if the plan's team has none."""

LOST = "lost"
"""Name of the team of both drones of the lost robot, after that of its team."""

ASIDE = 3.0
"""Distance of the lost robot's drones from all others, seen from above, over the radius."""

HOW = ("hold", "land")
"""What follows once the chain is taut."""

MAX_USED = 0.7
"""Largest share of a limit that stopping uses where drones rise in the meantime."""

SAMPLES = 41
"""Number of times at which drones on their ways are compared."""

STARTS = 9
"""Number of times from which ends may begin to move."""


@dataclass(frozen=True, eq=False)
class Remaining:
    """What remains after the loss of a robot."""

    flight: Flight
    """The flight from the loss on."""

    certificate: Certificate

    begin: float
    """[s] Plan time at which it begins, at most MIN_SPACING from the loss; or that of a stop."""

    reacts: float
    """[s] Time from the loss until all react."""

    stops: float
    """[s] Time from the loss until the plan's clock has stopped."""

    rest: float
    """[s] Plan time at which it has stopped."""

    starts: float
    """[s] Time from the loss until drones at the ends of the chain begin to move."""

    taut: float
    """[s] Time from the loss until its tensions are back."""

    rise: float
    """[m] How far the lost robot's drones rise."""

    lift: PiecewisePolynomial
    """(1,) [m] How far they have risen, until they are up."""

    robots: dict[str, str]
    """Robots of the plan by those of the chain."""

    drones: tuple[str, ...]
    """The drones of the flight, in its order, by their names in the plan."""


class _Place(NamedTuple):
    """A robot in a flight."""

    team: int
    cable: int


def check_loss(flight: Flight, robot: str, time: float) -> None:
    """Raise InputError if a robot cannot be lost at a plan time [s]; see ``Plan.after_loss``."""
    place = _place(flight, robot)
    _taut_run(flight.teams[place.team].motion, nonnegative("t", time), robot)


def after_loss_at_rest(flight: Flight, robot: str, time: float, rest: float) -> Remaining:
    """Return the certified flight after a loss, where the clock stops at a plan time ``rest`` [s].

    It begins there, and can be landed if possible. Errors are those of ``Plan.after_loss``.
    """

    def until_rest(motion: Motion) -> Motion:
        return truncated(motion, rest) if rest > JOINT else resting(motion, HOLD, first=True)

    stopped = flight.untimed.each_team(until_rest)
    stop = StoppedPlan(rest, 0.0, rest, stopped)
    begin = stopped.duration
    levels = [True, False]
    return _after_loss(flight, robot, time, stop, begin=begin, delay=0.0, levels=levels)


def after_loss_of(flight: Flight, robot: str, time: float, how: str = "hold") -> Remaining:
    """Return the certified flight after the loss of a robot; see ``Plan.after_loss``.

    The clock stops as soon as it can, DELAY after the loss.
    """
    check_choice("how", how, HOW)
    check_loss(flight, robot, time)
    stop = until_stop(flight, min(time + DELAY, flight.duration))
    held = how == "hold"
    found = _after_loss(flight, robot, time, stop, begin=time, delay=DELAY, levels=[not held])
    if held:
        return found
    landed = Aborts(found.flight).plan(found.flight.duration, "release_and_land").flight
    return replace(found, flight=landed, certificate=_certified(landed, robot, time))


def _certified(flight: Flight, robot: str, time: float) -> Certificate:
    """Return the certificate of a flight after a loss at a plan time [s], with all limits kept."""
    certificate = certify(flight)
    if not certificate.certified:
        raise infeasible_error(
            certificate, flight, f"after the loss of {robot} at t = {time:.4g} s"
        )
    return certificate


def _after_loss(
    flight: Flight,
    robot: str,
    time: float,
    stop: StoppedPlan,
    *,
    begin: float,
    delay: float,
    levels: Sequence[bool],
) -> Remaining:
    """Return the flight after a loss at a plan time [s] that begins ``begin`` [s] in a stop.

    It begins at a break within MIN_SPACING of that. The lost robot's drones rise after a ``delay``
    [s] at the earliest. Chains are tried that are a hitch at one height, or not, by ``levels``.
    """
    place = _place(flight, robot)
    flown = flight.teams[place.team]
    run = _taut_run(flown.motion, nonnegative("t", time), robot)
    nearest = stop.flight.breaks[np.argmin(np.abs(stop.flight.breaks - begin))]
    begin = float(nearest) if abs(nearest - begin) < MIN_SPACING else begin
    end = max(stop.flight.duration, begin + max(delay, PAUSE))
    stopping = {
        each.name: shifted(slice_time(each.motion.untimed, begin, end), -begin)
        for each in stop.flight.teams
    }
    tied = _TiedAtRest.of(flown.motion, run, place.cable, stopping[flown.name], stop.rest, robot)
    name = flown.name or CHAIN
    lost = f"{flown.name}-{LOST}" if flown.name else LOST

    def certified(variant: _TiedAtRest, schedule: _Schedule) -> Remaining:
        chain = variant.chain(schedule)
        teams = [TeamMotion(name, chain), TeamMotion(lost, variant.leaving(schedule))]
        teams += [
            TeamMotion(other.name, padded(stopping[other.name], 0.0, chain.duration))
            for other in flight.teams
            if other is not flown
        ]
        held = Flight(tuple(teams))
        places = {name: _chain_places(flown.motion.team, place.cable), lost: _own(place.cable)}
        drones = [
            each.label(drone)
            for part in teams
            for each in [flown if part.name in places else part]
            for drone in np.array(each.motion.team.drone_names)[places.get(part.name, ...)].tolist()
        ]
        return Remaining(
            flight=held,
            certificate=_certified(held, robot, time),
            begin=begin,
            reacts=delay,
            stops=variant.stopping.duration,
            rest=stop.rest,
            starts=variant.starts(schedule),
            taut=chain.duration - HOLD,
            rise=variant.rise,
            lift=schedule.lift,
            robots=_robots(flown, name, robot),
            drones=tuple(drones),
        )

    candidates = (
        Candidate("reaction", partial(certified, variant, schedule))
        for variant in [replace(tied, level=level) for level in levels]
        for schedule in variant.schedules(delay)
    )
    return first_certified(candidates, Effort())


def _robots(flown: TeamMotion, name: str, robot: str) -> dict[str, str]:
    """Return the robots of a plan's team by those of the chain, of which one is lost."""
    labels = sorted(label for label in flown.motion.team.labels if label != _label(robot))
    return {
        team_label(name, str(number)): flown.label(str(label))
        for number, label in enumerate(labels)
    }


def _label(robot: str) -> int:
    """Return the number of a robot with a name such as ``2`` or ``a.2``."""
    return int(robot.rpartition(".")[2])


def _place(flight: Flight, robot: str) -> _Place:
    """Return a robot's team and cable; raises InputError for a robot that cannot be lost."""
    places = {
        flown.label(str(label)): _Place(index, cable)
        for index, flown in enumerate(flight.teams)
        for cable, label in enumerate(flown.motion.team.labels)
    }
    if robot not in places:
        raise InputError("lose", robot, f"one of {', '.join(places)}", "name a robot")
    place = places[robot]
    team = flight.teams[place.team].motion.team
    if place.cable not in Losses.of(team.layout).robots:
        bound = "a robot without which the others hold one another"
        raise InputError("lose", robot, bound, "name another one, such as an end of a chain")
    if not team.release:
        bound = "omitted unless drones can drop the ends of their cables"
        raise InputError("lose", robot, bound, "set team.release: true if they can")
    return place


def _taut_run(motion: Motion, time: float, robot: str) -> Motion:
    """Return the part of a motion with a taut hitch at a time [s]."""
    runs = taut_runs(motion)
    for run in runs:
        if run.drones.breaks[0] - JOINT <= time <= run.drones.breaks[-1] + JOINT:
            return run
    for phase in motion.overlapping(time - JOINT, time + 2.0 * JOINT):
        if phase.hold is not None:
            falls = "falls" if phase.hold.by is HoldBy.GRIP else "tips over, or falls"
            reason = f"the hitch holds {phase.hold.object}, which {falls} without one of its cables"
            raise InfeasibleError([], f"loss of {robot} at t = {time:.4g} s: {reason}")
    spans = [f"{each[0]:.4g} to {each[-1]:.4g} s" for each in (run.drones.breaks for run in runs)]
    bound = f"while a hitch is taut, {' or '.join(spans) or 'never in this plan'}"
    remedy = f"otherwise all land after the loss of {robot}: see hitchopt simulate --lose"
    raise InputError("t", time, bound, remedy)


class _Schedule(NamedTuple):
    """When parts of a reaction begin [s]."""

    lift: PiecewisePolynomial
    """(1,) [m], how far the lost robot's drones have risen, up to the end of their rise."""

    overlaps: bool
    """Whether drones at the ends of the chain move as soon as they stay clear of these."""


@dataclass(frozen=True, eq=False)
class _TiedAtRest:
    """A hitch that has stopped after the loss of a cable, and where its drones go."""

    motion: Motion
    """The hitch."""

    need: Requirements
    """Requirements of what follows."""

    cable: int
    """The lost cable."""

    stopping: Motion
    """The hitch from the loss to the rest, as planned."""

    drones: Array
    """(2n, 3) [m] at rest."""

    vertices: Array
    """(points, 3) [m] at rest."""

    balanced: Array
    """(2n, 3) [m], with both ends of the chain in balance."""

    level: bool = False
    """Whether the chain becomes a hitch at one height, from which steps start; with weight others
    have raised ends."""

    @classmethod
    def of(
        cls, motion: Motion, run: Motion, cable: int, stopping: Motion, rest: float, robot: str
    ) -> _TiedAtRest:
        """Return the hitch at a plan time ``rest`` [s], where it is as at the end of a taut run.

        Raises InfeasibleError if it has moved since.
        """
        first_taut, last_taut = run.drones.breaks[[0, -1]].tolist()
        taut = min(max(rest, first_taut), last_taut)
        drones = motion.drones.at(taut)
        moved = np.max(np.abs(motion.drones.at(rest) - drones))
        if moved > REST_DRIFT:
            reason = f"the plan does not stop before t = {last_taut:.4g} s, when its hitch"
            raise InfeasibleError([], f"loss of {robot}: {reason} is not taut")
        vertices = motion.vertices.at(taut)
        losses = Losses.of(motion.team.layout)
        moves = losses.lost == cable
        places, _ = places_after_loss(motion.team, drones, vertices, motion.tensions.at(taut))
        balanced = drones.copy()
        balanced[losses.drone[moves]] = places[moves]
        limits = with_fields(motion.requirements.limits, survive=None, duration=None)
        need = replace(motion.requirements, limits=limits)
        return cls(motion, need, cable, stopping, drones, vertices, balanced)

    @property
    def rise(self) -> float:
        """[m] Height by which the lost robot's drones rise, above all others."""
        heights = np.concatenate([self.drones[:, 2], self.balanced[:, 2]])
        height = RISE * self.need.with_reserve.separation.height
        return height + float(np.ptp(heights))

    @lazy
    def places(self) -> Indices:
        """The drones of the chain, in order along it."""
        return _chain_places(self.motion.team, self.cable)

    @lazy
    def team(self) -> Team:
        """The team of the chain."""
        return _chain_team(self.motion.team, self.places[::2] // 2)

    @lazy
    def swarm(self) -> Swarm:
        """Both drones of the lost robot."""
        kinds = self.motion.team.kinds
        return Swarm(2, quadrotor=[kinds[drone] for drone in _own(self.cable)])

    @lazy
    def points(self) -> Indices:
        """Vertices of the chain, with the clasps that vanish, or its own ends."""
        layout = self.motion.team.layout
        cables = self.places[::2] // 2
        return np.append(layout.starts[cables], layout.ends[cables[-1]])

    @lazy
    def reach(self) -> Motion:
        """The motion of the drones at the ends of the chain to their places, from rest.

        Cables have their lengths over its vertices: those at the ends move with the drones there.
        """
        start = self.drones[self.places]
        end = self.balanced[self.places]
        clasps = self.vertices[self.points]
        moved = np.concatenate([end[:1], clasps[1:-1], end[-1:]])
        if self.level and self.team.cable_density > 0.0:
            hitch = self._levelled(moved)
            end = hitch.drones
            moved = hitch.vertices
        progress = line_progress(self.team, self.need.limits.with_reserve, start, end)
        return self._loose(
            "reach", on_lines(progress, start, end), on_lines(progress, clasps, moved)
        )

    def _levelled(self, vertices: Array) -> Hitch:
        """Return the hitch at one height of a chain in balance with vertices (n, 3) [m].

        Its clasps roll as before. Only the weight of cables makes it another one.
        """
        layout = self.motion.team.layout
        legs = np.linalg.norm(self.drones - self.vertices[layout.anchors], axis=1).reshape(-1, 2)
        before = fitted_hitch(self.motion.team, self.drones, self.vertices, legs)
        roll = before.roll[np.searchsorted(layout.clasps, self.points[1:-1])]
        outline = vertices.copy()
        outline[:, 2] = np.mean(vertices[1:-1, 2])
        for end, clasp in ((0, 1), (-1, -2)):
            chord = vertices[end] - vertices[clasp]
            along = unit(chord * [1.0, 1.0, 0.0])
            outline[end] = outline[clasp] + np.linalg.norm(chord) * along
        altitude = float(outline[0, 2])
        slack = Hitch.balanced(self.team, outline[:, :2], altitude).slack
        q_legs = self.team.layout.q_legs_of(before.legs[self.places[::2] // 2, 0], slack)
        return Hitch(self.team, outline[:, :2], altitude, q_legs, roll)

    def _loose(
        self, name: str, drones: PiecewisePolynomial, vertices: PiecewisePolynomial
    ) -> Motion:
        """Return a motion of the chain with loose cables."""
        begin, end = drones.breaks[[0, -1]].tolist()
        phase = Phase(name, 0, begin, end, state=CableState.LOOSE)
        motion = Motion.single(self.team, self.need, drones, [phase])
        return motion.replaced(vertices=vertices)

    def schedules(self, delay: float) -> Iterator[_Schedule]:
        """Yield the schedules, the shortest one first; the last one does one after the other."""
        at_rest = self._lift(self.stopping.duration, np.zeros((3, 2)))
        for lift in (self._lift_while_stopping(delay), at_rest):
            if lift is not None:
                yield _Schedule(lift, overlaps=True)
        yield _Schedule(at_rest, overlaps=False)

    def _lift(self, begin: float, used: Array) -> PiecewisePolynomial:
        """Return the rise (1,) [m], from a time [s] on, with what limits leave.

        ``used`` (3, 2) are level and upright speeds, accelerations and jerks of the motion besides.
        """
        names = ("speed", "acceleration", "jerk")
        limits = self.need.limits.with_reserve
        left = [
            math.sqrt(max(getattr(limits, name) ** 2 - level**2, 0.0)) - upright
            for name, (level, upright) in zip(names, used.tolist(), strict=True)
        ]
        limits = with_fields(limits, **dict(zip(names, left, strict=True)))
        start = self.drones[_own(self.cable)]
        progress = line_progress(self.swarm, limits, start, start + [0.0, 0.0, self.rise])
        lift = self.rise * progress.coefficients[:, None]
        rest = np.zeros((1, *lift.shape[1:]))
        breaks = np.append(0.0, begin + progress.breaks)
        return PiecewisePolynomial(breaks, np.concatenate([rest, lift]))

    def _lift_while_stopping(self, delay: float) -> PiecewisePolynomial | None:
        """Return the rise from a delay [s] on; None if limits leave too little."""
        curve = self.stopping.drones
        own = _own(self.cable)
        used = np.zeros((3, 2))
        limits = self.need.limits.with_reserve
        for order, row in enumerate(used, 1):
            rates = curve.differentiated(order).coefficients[:, own]
            row[:] = (
                np.max(np.linalg.norm(rates[:, :, :2], axis=2)),
                np.max(np.abs(rates[:, :, 2])),
            )
        most = [limits.speed, limits.acceleration, limits.jerk]
        if delay >= self.stopping.duration or np.any(
            np.sum(used, axis=1) > MAX_USED * np.array(most)
        ):
            return None
        return self._lift(max(delay, PAUSE), used)

    def starts(self, schedule: _Schedule) -> float:
        """Return the first time [s] from which the ends reach their places clear of the others.

        Times are sampled: what follows is certified.
        """
        lift = schedule.lift
        rests = self.stopping.duration
        lifted = float(lift.breaks[-1])
        if not schedule.overlaps:
            return max(lifted, rests)
        reach = self.reach
        times = np.linspace(0.0, reach.duration, SAMPLES)
        drones = reach.drones.at(times)
        vertices = reach.vertices.at(times)
        ends = drones[:, [0, -1]]
        first = np.concatenate([drones[:, :2], vertices[:, :2]], axis=1)
        last = np.concatenate([drones[:, -2:], vertices[:, -2:]], axis=1)
        cables = np.stack([first, last], axis=1)  # corners of their regions
        own = self.drones[_own(self.cable)]
        need = self.need.with_reserve
        level = hull_distance(own[:, None, None, None, :2], cables[..., :2])  # (2, times, ends)
        top = np.max(cables[..., 2], axis=-1)
        begins: list[float] = np.linspace(min(rests, lifted), lifted, STARTS).tolist()
        for begin in begins:
            heights = lift.at(np.minimum(begin + times, lifted))
            lost = own + heights[:, :, None] * [0.0, 0.0, 1.0]
            gaps = (lost[:, :, None] - ends[:, None]) * need.separation.scale
            above = (lost.swapaxes(0, 1)[..., 2, None] - top) / need.height_ratio
            if (
                np.min(np.linalg.norm(gaps, axis=-1)) >= 1.0
                and np.min(np.maximum(level, above)) >= need.separation.cable
            ):
                return max(begin, rests)
        return max(lifted, rests)

    def chain(self, schedule: _Schedule) -> Motion:
        """Return the motion of all cables but one, from the loss on: loose, then under tension."""
        reach = self.reach
        stopping = self._loose(
            "stop",
            self.stopping.drones.replaced(self.stopping.drones.coefficients[:, self.places]),
            self.stopping.vertices.replaced(self.stopping.vertices.coefficients[:, self.points]),
        )
        parts = [stopping]
        waits = self.starts(schedule) - stopping.duration
        if waits > JOINT:
            wait = Phase("wait", 0, 0.0, waits, state=CableState.LOOSE)
            parts.append(resting(reach, waits, wait, first=True))
        seconds = rise_seconds(self.team)
        breaks = np.array([0.0, seconds])
        drones, vertices = reach.drones.ends()[1][-1], reach.vertices.ends()[1][-1]
        legs = np.linalg.norm(drones - vertices[self.team.layout.anchors], axis=1)
        rising = self.team.tension[:, None] * SMOOTH
        tightened = Motion(
            self.team,
            self.need,
            drones=PiecewisePolynomial.constant(breaks, drones),
            vertices=PiecewisePolynomial.constant(breaks, vertices),
            legs=PiecewisePolynomial.constant(breaks, legs.reshape(-1, 2)),
            tensions=PiecewisePolynomial(breaks, rising[None]),
            phases=(Phase("tension", 0, 0.0, seconds),),
        )
        held = resting(tightened, HOLD, Phase("hold", 1, 0.0, HOLD))
        return concatenated([*parts, reach, tightened, held])

    def leaving(self, schedule: _Schedule) -> Motion:
        """Return the flight of the lost robot's drones, up and aside."""
        own = _own(self.cable)
        lift = schedule.lift
        end = max(self.stopping.duration, float(lift.breaks[-1]))
        planned = padded(self.stopping, 0.0, end).drones
        breaks = merged_breaks([planned.breaks, lift.breaks])
        planned = on_breaks(planned, breaks)
        lift = on_breaks(_held_until(lift, end), breaks)
        path, lifted = same_degree(planned.coefficients[:, own], lift.coefficients)
        path[:, :, 2] += lifted
        rising = PiecewisePolynomial(breaks, path)
        above = self.drones[own] + [0.0, 0.0, self.rise]
        aside = straight_lines(
            self.swarm, self.need.limits.with_reserve, above, above + self._aside()
        )
        parts = [
            Motion.single(self.swarm, self.need, lines, [Phase(name, 0, 0.0, lines.duration)])
            for name, lines in (("rise", rising), ("aside", aside))
        ]
        return concatenated(parts)

    def _aside(self) -> Array:
        """Return the move (3,) [m] of the lost robot's drones away from all others, above them."""
        drones = self.drones
        own = _own(self.cable)
        middle = np.mean(drones, axis=0)
        outward = unit((np.mean(drones[own], axis=0) - middle) * [1.0, 1.0, 0.0])
        level = np.concatenate([drones, self.balanced])[:, :2] - middle[:2]
        reach = float(np.max(np.linalg.norm(level, axis=1)))
        offsets = (drones[own] - middle) @ outward
        radius = self.need.with_reserve.separation.radius
        distance = max(0.0, reach + ASIDE * radius - np.min(offsets))
        return _within(self.need, drones[own], distance * outward)


def _held_until(curve: PiecewisePolynomial, end: float) -> PiecewisePolynomial:
    """Return a curve that stays at its end until a time [s]."""
    if end - curve.breaks[-1] <= JOINT:
        return curve
    last = np.broadcast_to(curve.coefficients[-1:, ..., -1:], curve.coefficients[-1:].shape)
    breaks = np.append(curve.breaks, end)
    return PiecewisePolynomial(breaks, np.concatenate([curve.coefficients, last]))


def _within(need: Requirements, points: Array, move: Array) -> Array:
    """Return a horizontal move of points (m, 3) [m], shortened to stay in the arena."""
    if need.arena is None:
        return move
    arena = known(need.with_reserve.arena)
    room = np.where(move > 0.0, arena.upper - points, points - arena.lower)[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(move[:2] == 0.0, np.inf, room / np.abs(move[:2]))
    return np.asarray(move * float(np.clip(np.min(shares), 0.0, 1.0)))


def _own(cable: int) -> Indices:
    """Return the drones of a cable."""
    return np.array([2 * cable, 2 * cable + 1])


def _chain_places(team: Team, cable: int) -> Indices:
    """Return the drones of all other cables than one, in order along the chain."""
    cables = np.arange(team.robots)
    cables = np.roll(cables, -cable)[1:] if team.layout.closed else cables[cables != cable]
    return np.column_stack([2 * cables, 2 * cables + 1]).ravel()


def _chain_team(team: Team, cables: Indices) -> Team:
    """Return the team of some cables of another one, in order along the chain.

    Its robots are numbered in the order of the problem, without the lost one.
    """
    labels = np.array(team.labels)[cables]
    numbers = np.argsort(np.argsort(labels))
    flipped = (False,) * len(cables)
    if team.assignment is not None:
        flipped = tuple(team.assignment.flipped[cable] for cable in cables.tolist())
    kinds = team.kinds
    return Team(
        len(cables),
        team.cable_length[cables],
        topology=OPEN,
        cable_density=team.cable_density,
        cable_friction=team.cable_friction,
        tension=team.tension[cables],
        quadrotor=[kinds[2 * cable + end] for cable in cables.tolist() for end in (0, 1)],
        errors=team.errors,
        release=team.release,
        assignment=Assignment(tuple(numbers.tolist()), flipped),
    )
