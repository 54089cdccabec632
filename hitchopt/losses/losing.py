"""The plan after the loss of a robot in flight, from the loss on.

The lost robot's drones have dropped their cable. All fly on to the next prepared stop, DELAY after
the loss or later; then the plan's clock stops, and these drones rise above all others, as the check
``survivable`` allows. Both neighbouring drones at the cable's clasps move to where the remaining
cables are an open chain in balance, and tensions rise again: ``hitchopt.losses.reactions`` says
when. Until then cables are loose, as the check ``survivable`` assumes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch, Swarm
from hitchopt.hitch.losses import Losses
from hitchopt.hitch.requirements import Requirements
from hitchopt.live.abort import HOLD, Aborts
from hitchopt.losses.checks import taut_runs
from hitchopt.losses.reactions import (
    DELAY,
    Chain,
    PreparedStop,
    Reaction,
    prepared_stops,
    rests_taut,
)
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import Flight, TeamMotion, team_label
from hitchopt.motion.motion import JOINT, Motion, Phase, concatenated
from hitchopt.motion.retiming import padded, resting, shifted, slice_time
from hitchopt.motion.states import fitted_hitch
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.stages import (
    PAUSE,
    SMOOTH,
    line_progress,
    on_lines,
    rise_seconds,
    straight_lines,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.piecewise import MIN_SPACING, on_breaks, on_spaced_breaks
from hitchopt.values import Array, Indices, check_choice, known, nonnegative

CHAIN = "chain"  # Name of the team that remains, if the plan's team has none
LOST = "lost"  # Name of the team of both drones of the lost robot, after that of its team
ASIDE = 3.0  # Distance of the lost robot's drones from all others, seen from above, over the radius

NOTHING_BEARS = "without one of its cables all others are loose until they are a chain"
"""Why nothing that a hitch holds is held after a loss, by a grip or by clasps below it."""

HOW = ("hold", "land")  # What follows once the chain is taut

LANDINGS = {"release_and_land": "untied landing", "land": "tied landing"}
"""How a chain lands, in order: untied, or else straight down with its hitch; and their names.

If neither is certified, a team that can (``release``) drops all its cables, and its drones land.
"""


@dataclass(frozen=True, eq=False)
class Remaining:
    """What remains after the loss of a robot."""

    flight: Flight  # The flight from the loss on
    certificate: Certificate

    # [s] Plan time at which it begins, at most MIN_SPACING from the loss; or that of a stop
    begin: float
    reacts: float  # [s] Time from the loss until all react
    stops: float  # [s] Time from the loss until the plan's clock has stopped
    rest: float  # [s] Plan time at which it has stopped
    starts: float  # [s] Time from the loss until drones at the ends of the chain begin to move
    taut: float  # [s] Time from the loss until its tensions are back; infinite without a chain
    rise: float  # [m] How far the lost robot's drones rise
    lift: PiecewisePolynomial  # (1,) [m] How far they have risen, until they are up
    robots: dict[str, str]  # Robots of the plan by those of the chain
    drones: tuple[str, ...]  # The drones of the flight, in its order, by their names in the plan


class _Place(NamedTuple):
    """A robot in a flight."""

    team: int
    cable: int


def check_loss(flight: Flight, robot: str, time: float) -> None:
    """Raise InputError if a robot cannot be lost at a plan time [s]; see ``Plan.after_loss``."""
    _taut_run(team_of(flight, robot).motion, nonnegative("t", time), robot)


def team_of(flight: Flight, robot: str) -> TeamMotion:
    """Return the team of a robot; raises InputError for a robot that cannot be lost."""
    return flight.teams[_place(flight, robot).team]


def after_loss_at_rest(flight: Flight, robot: str, time: float, rest: float) -> Remaining:
    """Return the certified flight after a loss, where the clock stops at a plan time ``rest`` [s].

    It begins there, and can be landed if possible. Errors are those of ``Plan.after_loss``.
    """
    stop = PreparedStop(rest, rest, 0.0)
    begin = stop.until_rest(flight).duration
    candidates = (
        Candidate("chain", partial(_after_loss, flight, robot, time, stop, begin, 0.0, level))
        for level in (True, False)
    )
    return first_certified(candidates, Effort())


def after_loss_of(flight: Flight, robot: str, time: float, how: str = "hold") -> Remaining:
    """Return the certified flight after the loss of a robot; see ``Plan.after_loss``."""
    check_choice("how", how, HOW)
    check_loss(flight, robot, time)
    stops = (stop for stop in prepared_stops(flight) if stop.start >= time + DELAY)
    ending = PreparedStop(flight.duration, flight.duration, 0.0)
    stop = next(stops, ending)
    if how == "hold":
        return _after_loss(flight, robot, time, stop, time, DELAY, level=False)
    flown = team_of(flight, robot)
    with_chain = cache(partial(_after_loss, flight, robot, time, stop, time, DELAY, level=True))
    dropped = partial(_all_dropped, flight, flown, stop, time, DELAY)

    when = _when_lost(robot, time)

    def landed(before: Callable[[], Remaining], how: str) -> Remaining:
        found = before()
        landing = Aborts(found.flight).plan(found.flight.duration, how).flight
        return replace(found, flight=landing, certificate=_certified(landing, when))

    candidates = [
        Candidate(name, partial(landed, with_chain, how)) for how, name in LANDINGS.items()
    ]
    if flown.motion.team.release:
        candidates.append(Candidate("landing without cables", partial(landed, dropped, "land")))
        return first_certified(candidates, Effort())
    try:
        return first_certified(candidates, Effort())
    except InfeasibleError as error:
        remedy = "set team.release: true if drones can drop their cables; they then land without"
        raise error.with_note(remedy) from None


def dropped_at_rest(flight: Flight, team: str, rest: float) -> Remaining:
    """Return the certified flight from a rest [s] on, where a team has dropped all its cables.

    The team is given by its name. Raises InfeasibleError if a limit is not kept.
    """
    flown = next(each for each in flight.teams if each.name == team)
    stop = PreparedStop(rest, rest, 0.0)
    begin = stop.until_rest(flight).duration
    found = _all_dropped(flight, flown, stop, begin, 0.0)
    certificate = _certified(found.flight, f"without cables at t = {rest:.4g} s")
    return replace(found, certificate=certificate)


def _all_dropped(
    flight: Flight, flown: TeamMotion, stop: PreparedStop, begin: float, delay: float
) -> Remaining:
    """Return the flight after a loss in which a team drops all its cables.

    It begins ``begin`` [s] before a rest, and all stop as in ``_after_loss``. It is not certified
    yet.
    """
    begin, reacts, planned = _way_to_rest(flight, stop, begin, delay)
    drones = planned[flown.name].drones
    team = flown.motion.team
    swarm = Swarm(team.drones, quadrotor=list(team.kinds))
    need = Chain(flown.motion, 0).need
    phase = Phase("stop", 0, 0.0, drones.duration)
    name = flown.name or LOST
    teams = [TeamMotion(name, Motion.single(swarm, need, drones, [phase]))]
    teams += [
        TeamMotion(each.name, planned[each.name]) for each in flight.teams if each is not flown
    ]
    return Remaining(
        flight=Flight(tuple(teams)),
        certificate=Certificate(drones.duration, ()),
        begin=begin,
        reacts=delay,
        stops=reacts + stop.seconds,
        rest=stop.rest,
        starts=math.inf,
        taut=math.inf,
        rise=0.0,
        lift=PiecewisePolynomial.constant([0.0, drones.duration], [0.0]),
        robots={},
        drones=_names_in_plan(flown, teams, {name: np.arange(team.drones)}),
    )


class _WayToRest(NamedTuple):
    """The plan from a loss to the rest that follows it."""

    begin: float  # [s] Plan time at which it begins
    reacts: float  # [s] Time from there until the plan's clock begins to stop
    planned: dict[str, Motion]  # Motions of all teams from there, by name


def _way_to_rest(flight: Flight, stop: PreparedStop, begin: float, delay: float) -> _WayToRest:
    """Return the plan from ``begin`` [s] before a rest, or from a break within MIN_SPACING.

    The others react after a ``delay`` [s] at the earliest.
    """
    until_rest = stop.until_rest(flight)
    nearest = until_rest.breaks[np.argmin(np.abs(until_rest.breaks - begin))]
    begin = float(nearest) if abs(nearest - begin) < MIN_SPACING else begin
    reacts = max(until_rest.duration - stop.seconds - begin, delay, PAUSE)
    end = begin + reacts + stop.seconds
    planned = {
        each.name: shifted(slice_time(each.motion.untimed, begin, end), -begin)
        for each in until_rest.teams
    }
    return _WayToRest(begin, reacts, planned)


def _names_in_plan(
    flown: TeamMotion, teams: Sequence[TeamMotion], places: Mapping[str, Indices]
) -> tuple[str, ...]:
    """Return the drones of a flight's teams by their names in the plan.

    ``places`` has, by the teams that a team of the plan has become, its drones in them.
    """
    return tuple(
        each.label(drone)
        for part in teams
        for each in [flown if part.name in places else part]
        for drone in np.array(each.motion.team.drone_names)[places.get(part.name, ...)].tolist()
    )


def _certified(flight: Flight, when: str) -> Certificate:
    """Return the certificate of a flight, with all limits kept; its error says ``when``."""
    certificate = certify(flight)
    if not certificate.certified:
        raise infeasible_error(certificate, flight, when)
    return certificate


def _when_lost(robot: str, time: float) -> str:
    """Return words on the loss of a robot at a plan time [s]."""
    return f"after the loss of {robot} at t = {time:.4g} s"


def _after_loss(
    flight: Flight,
    robot: str,
    time: float,
    stop: PreparedStop,
    begin: float,
    delay: float,
    level: bool,
) -> Remaining:
    """Return the flight after a loss at a plan time [s] that begins ``begin`` [s] before a rest.

    It begins at a break within MIN_SPACING of that. The others react after a ``delay`` [s] at the
    earliest. With ``level``, the chain becomes a hitch at one height, from which steps start.
    """
    place = _place(flight, robot)
    flown = flight.teams[place.team]
    run = _taut_run(flown.motion, nonnegative("t", time), robot)
    if not rests_taut(run, flown.motion, stop.rest):
        last = run.drones.breaks[-1]
        reason = f"the plan does not stop before t = {last:.4g} s, when its hitch is not taut"
        raise InfeasibleError([], f"loss of {robot}: {reason}; all drop their cables and land")
    begin, reacts, planned = _way_to_rest(flight, stop, begin, delay)
    remaining = Chain(flown.motion, place.cable)
    stopping = stop.stopping(flown.motion.untimed).drones if stop.seconds else None
    reaction = remaining.reaction(run, stop.rest, stopping)
    chain = _chain_motion(reaction, planned[flown.name], level=level)
    name = flown.name or CHAIN
    lost = f"{flown.name}-{LOST}" if flown.name else LOST
    teams = [
        TeamMotion(name, chain),
        TeamMotion(lost, _leaving(reaction, planned[flown.name], reacts)),
    ]
    teams += [
        TeamMotion(other.name, padded(planned[other.name], 0.0, chain.duration))
        for other in flight.teams
        if other is not flown
    ]
    held = Flight(tuple(teams))
    places = {name: remaining.drones, lost: remaining.lost}
    return Remaining(
        flight=held,
        certificate=_certified(held, _when_lost(robot, time)),
        begin=begin,
        reacts=delay,
        stops=reacts + reaction.stops,
        rest=stop.rest,
        starts=reacts + reaction.starts,
        taut=chain.duration - HOLD,
        rise=reaction.rise,
        lift=_lift_from(reaction.lift, reacts),
        robots=_robots(flown, name, robot),
        drones=_names_in_plan(flown, teams, places),
    )


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
        raise InputError("lose", robot, f"one of {', '.join(sorted(places))}", "name a robot")
    place = places[robot]
    layout = flight.teams[place.team].motion.team.layout
    if place.cable not in Losses.of(layout).robots:
        bound = "a robot without which the others hold one another"
        raise InputError("lose", robot, bound, "name another one, such as an end of a chain")
    return place


def _taut_run(motion: Motion, time: float, robot: str) -> Motion:
    """Return the part of a motion with a taut hitch at a time [s]."""
    runs = taut_runs(motion)
    for run in runs:
        if run.drones.breaks[0] - JOINT <= time <= run.drones.breaks[-1] + JOINT:
            return run
    for phase in motion.overlapping(time - JOINT, time + 2.0 * JOINT):
        if phase.hold is not None:
            reason = f"the hitch holds {phase.hold.object}, which falls: {NOTHING_BEARS}"
            raise InfeasibleError([], f"loss of {robot} at t = {time:.4g} s: {reason}")
    spans = [f"{each[0]:.4g} to {each[-1]:.4g} s" for each in (run.drones.breaks for run in runs)]
    bound = f"while a hitch is taut, {' or '.join(spans) or 'never in this plan'}"
    raise InputError("t", time, bound, "choose a time within it")


def _chain_motion(reaction: Reaction, planned: Motion, *, level: bool) -> Motion:
    """Return the motion of all cables but one, from the loss on: loose, then under tension.

    ``planned`` is that of their hitch from the loss to the rest.
    """
    chain = reaction.chain
    stopping = _loose(
        chain,
        "stop",
        planned.drones.replaced(planned.drones.coefficients[:, chain.drones]),
        planned.vertices.replaced(planned.vertices.coefficients[:, chain.points]),
    )
    start, end, progress = reaction.start_of_reach, reaction.end_of_reach, reaction.progress
    if level and chain.team.cable_density > 0.0:
        hitch = _level_hitch(reaction)
        end = hitch.drones, hitch.vertices
        progress = line_progress(chain.team, chain.need.limits.with_reserve, start[0], end[0])
    drones, vertices = (on_lines(progress, *ends) for ends in zip(start, end, strict=True))
    reach = _loose(chain, "reach", drones, vertices)
    parts = [stopping]
    waits = reaction.starts - reaction.stops
    if waits > JOINT:
        wait = Phase("wait", 0, 0.0, waits, state=CableState.LOOSE)
        parts.append(resting(reach, waits, wait, first=True))
    tightened = _tightened(chain, *end)
    held = resting(tightened, HOLD, Phase("hold", 1, 0.0, HOLD))
    return concatenated([*parts, reach, tightened, held])


def _loose(
    chain: Chain, name: str, drones: PiecewisePolynomial, vertices: PiecewisePolynomial
) -> Motion:
    """Return a motion of a chain with loose cables."""
    begin, end = drones.breaks[[0, -1]].tolist()
    phase = Phase(name, 0, begin, end, state=CableState.LOOSE)
    return Motion.single(chain.team, chain.need, drones, [phase]).replaced(vertices=vertices)


def _tightened(chain: Chain, drones: Array, vertices: Array) -> Motion:
    """Return the motion at rest in which the tensions of a chain rise."""
    team = chain.team
    seconds = rise_seconds(team)
    breaks = np.array([0.0, seconds])
    legs = np.linalg.norm(drones - vertices[team.layout.anchors], axis=1)
    rising = team.tension[:, None] * SMOOTH
    return Motion(
        team,
        chain.need,
        drones=PiecewisePolynomial.constant(breaks, drones),
        vertices=PiecewisePolynomial.constant(breaks, vertices),
        legs=PiecewisePolynomial.constant(breaks, legs.reshape(-1, 2)),
        tensions=PiecewisePolynomial(breaks, rising[None]),
        phases=(Phase("tension", 0, 0.0, seconds),),
    )


def _level_hitch(reaction: Reaction) -> Hitch:
    """Return the hitch at one height of a chain in balance.

    Its clasps roll as before. Only the weight of cables makes it another one.
    """
    chain = reaction.chain
    tied = chain.motion.team
    layout = chain.motion.team.layout
    legs = np.linalg.norm(reaction.drones - reaction.vertices[layout.anchors], axis=1)
    before = fitted_hitch(tied, reaction.drones, reaction.vertices, legs.reshape(-1, 2))
    roll = before.roll[np.searchsorted(layout.clasps, chain.points[1:-1])]
    vertices = reaction.end_of_reach[1]
    outline = vertices.copy()
    outline[:, 2] = np.mean(vertices[1:-1, 2])
    for end, clasp in ((0, 1), (-1, -2)):
        chord = vertices[end] - vertices[clasp]
        along = unit(chord * [1.0, 1.0, 0.0])
        outline[end] = outline[clasp] + np.linalg.norm(chord) * along
    altitude = float(outline[0, 2])
    slack = Hitch.balanced(chain.team, outline[:, :2], altitude).slack
    q_legs = chain.team.layout.q_legs_of(before.legs[chain.cables, 0], slack)
    return Hitch(chain.team, outline[:, :2], altitude, q_legs, roll)


def _leaving(reaction: Reaction, planned: Motion, reacts: float) -> Motion:
    """Return the flight of the lost robot's drones, up and aside; they rise ``reacts`` [s] after.

    ``planned`` is the motion of the hitch from the loss to the rest.
    """
    chain = reaction.chain
    lift = _lift_from(reaction.lift, reacts)
    # The drones stay on the planned path in plan view, and rise above it by the lift
    end = max(planned.duration, lift.duration)
    lift = _held_until(lift, end)
    path = on_spaced_breaks(padded(planned, 0.0, end).drones, lift.breaks)
    breaks = path.breaks
    rising, heights = same_degree(
        path.coefficients[:, chain.lost], on_breaks(lift, breaks).coefficients
    )
    rising[:, :, 2] += heights
    # At rest above all others, they move aside
    above = reaction.drones[chain.lost] + [0.0, 0.0, reaction.rise]
    limits = chain.need.limits.with_reserve
    aside = straight_lines(chain.swarm, limits, above, above + _aside(reaction))
    parts = [
        Motion.single(chain.swarm, chain.need, lines, [Phase(name, 0, 0.0, lines.duration)])
        for name, lines in (("rise", PiecewisePolynomial(breaks, rising)), ("aside", aside))
    ]
    return concatenated(parts)


def _aside(reaction: Reaction) -> Array:
    """Return the move (3,) [m] of the lost robot's drones away from all others, above them."""
    drones = reaction.drones
    lost = reaction.chain.lost
    need = reaction.chain.need
    middle = np.mean(drones, axis=0)
    outward = unit((np.mean(drones[lost], axis=0) - middle) * [1.0, 1.0, 0.0])
    level = np.concatenate([drones, reaction.balanced])[:, :2] - middle[:2]
    reach = float(np.max(np.linalg.norm(level, axis=1)))
    offsets = (drones[lost] - middle) @ outward
    radius = need.with_reserve.separation.radius
    distance = max(0.0, reach + ASIDE * radius - np.min(offsets))
    return _within(need, drones[lost], distance * outward)


def _lift_from(lift: PiecewisePolynomial, reacts: float) -> PiecewisePolynomial:
    """Return a rise that begins at its time after ``reacts`` [s], with a rest from t = 0."""
    rest = np.zeros((1, *lift.coefficients.shape[1:]))
    breaks = np.append(0.0, reacts + lift.breaks)
    return PiecewisePolynomial(breaks, np.concatenate([rest, lift.coefficients]))


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
