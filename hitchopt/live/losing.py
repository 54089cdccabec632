"""The plan after the loss of a robot in flight.

For DELAY, the others fly on; then the plan's clock stops. The lost robot's drones have dropped
their cable and rise above all others, as the check ``survivable`` allows. There this plan begins:
both neighbouring drones at its clasps move to where the remaining cables are an open chain in
balance (``hitchopt.hitch.losses``), and tensions rise again. Until then cables are loose, as the
check ``survivable`` assumes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.losses import RISE, taut_runs
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.losses import Losses, places_after_loss
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import OPEN, Assignment
from hitchopt.live.abort import HOLD, Aborts, StoppedPlan, until_stop
from hitchopt.motion.flight import Flight, TeamMotion, team_label
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase, concatenated
from hitchopt.motion.retiming import resting, truncated
from hitchopt.planners.forming.stages import SMOOTH, rise_seconds, straight_lines
from hitchopt.planners.losses import DELAY
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices, check_choice, known, nonnegative
from hitchopt.values.fields import with_fields

CHAIN = "chain"
"""Name of the team that remains, if the plan's team has none."""

LOST = "lost"
"""Name of the team of both drones of the lost robot, after that of its team."""

ASIDE = 3.0
"""Distance of the lost robot's drones from all others, seen from above, over the radius."""

HOW = ("hold", "land")
"""What follows once the chain is taut."""


@dataclass(frozen=True, eq=False)
class Remaining:
    """What remains after the loss of a robot."""

    flight: Flight
    certificate: Certificate
    stopped: Flight
    """The plan until its clock has stopped."""

    rising: Flight
    """What follows at once: the lost robot's drones rise, and all others rest."""

    start: float
    """[s] Time from the loss to the start of the flight, at rest."""

    rest: float
    """[s] Time at which the plan's clock has stopped."""

    rise: float
    """[m] How far the lost robot's drones have risen then."""

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

    Errors are those of ``Plan.after_loss``.
    """

    def until_rest(motion: Motion) -> Motion:
        return truncated(motion, rest) if rest > JOINT else resting(motion, HOLD, first=True)

    stopped = flight.untimed.each_team(until_rest)
    return after_loss_of(flight, robot, time, stop=StoppedPlan(rest, 0.0, rest, stopped))


def after_loss_of(
    flight: Flight, robot: str, time: float, how: str = "hold", stop: StoppedPlan | None = None
) -> Remaining:
    """Return the certified flight after the loss of a robot; see ``Plan.after_loss``.

    By default the clock stops as soon as it can, DELAY after the loss.
    """
    check_choice("how", how, HOW)
    place = _place(flight, robot)
    flown = flight.teams[place.team]
    run = _taut_run(flown.motion, nonnegative("t", time), robot)
    stop = stop or until_stop(flight, min(time + DELAY, flight.duration))
    first_taut, last_taut = run.drones.breaks[[0, -1]]
    if not first_taut - JOINT <= stop.rest <= last_taut + JOINT:
        reason = f"the plan does not stop before t = {run.drones.breaks[-1]:.4g} s, when its hitch"
        raise InfeasibleError([], f"loss of {robot} at t = {time:.4g} s: {reason} is not taut")
    chain, leaving, rise = _motions_after(flown.motion, place.cable, stop.rest)
    seconds = leaving.rising.duration
    name = flown.name or CHAIN
    lost = f"{flown.name}-{LOST}" if flown.name else LOST
    teams = [TeamMotion(name, chain), TeamMotion(lost, leaving.aside)]
    waiting = resting(chain, seconds, first=True)
    first = [TeamMotion(name, waiting), TeamMotion(lost, leaving.rising)]
    for other in flight.teams:
        if other is not flown:
            stopped = next(each for each in stop.flight.teams if each.name == other.name)
            teams.append(TeamMotion(other.name, resting(stopped.motion, chain.duration)))
            first.append(TeamMotion(other.name, resting(stopped.motion, seconds)))
    held = Flight(tuple(teams))
    if how == "land":
        held = Aborts(held).plan(held.duration, "release_and_land").flight
    certificate = certify(held)
    if not certificate.certified:
        raise infeasible_error(certificate, held, f"after the loss of {robot} at t = {time:.4g} s")
    start = stop.start - time + stop.seconds + seconds
    labels = sorted(label for label in flown.motion.team.labels if label != _label(robot))
    robots = {
        team_label(name, str(number)): flown.label(str(label))
        for number, label in enumerate(labels)
    }
    places = {name: _chain_places(flown.motion.team, place.cable), lost: _own(place.cable)}
    drones = [
        each.label(drone)
        for part in teams
        for each in [flown if part.name in places else part]
        for drone in np.array(each.motion.team.drone_names)[places.get(part.name, ...)].tolist()
    ]
    return Remaining(
        held,
        certificate,
        stop.flight,
        Flight(tuple(first)),
        start,
        stop.rest,
        rise,
        robots,
        tuple(drones),
    )


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
    spans = [f"{each[0]:.4g} to {each[-1]:.4g} s" for each in (run.drones.breaks for run in runs)]
    bound = f"while a hitch is taut, {' or '.join(spans) or 'never in this plan'}"
    remedy = f"otherwise all land after the loss of {robot}: see hitchopt simulate --lose"
    raise InputError("t", time, bound, remedy)


class _Leaving(NamedTuple):
    """The drones of a lost robot."""

    rising: Motion
    """Their flight up."""

    aside: Motion
    """Their flight aside, above all others."""


def _motions_after(motion: Motion, cable: int, time: float) -> tuple[Motion, _Leaving, float]:
    """Return the motions of the chain and the lost drones after a stop at a plan time [s].

    The last value is by how much these drones have risen before [m].
    """
    team = motion.team
    limits = with_fields(motion.requirements.limits, survive=None, duration=None)
    need = replace(motion.requirements, limits=limits)
    drones = motion.drones.at(time)
    vertices = motion.vertices.at(time)
    losses = Losses.of(team.layout)
    moves = losses.lost == cable
    places, _ = places_after_loss(team, drones, vertices, motion.tensions.at(time))
    balanced = drones.copy()
    balanced[losses.drone[moves]] = places[moves]
    heights = np.concatenate([drones[:, 2], balanced[:, 2]])
    rise = RISE * need.with_reserve.separation.height + float(np.ptp(heights))
    chain = _chain(motion, need, cable, drones, vertices, balanced)
    level = np.concatenate([drones, balanced])[:, :2] - np.mean(drones, axis=0)[:2]
    reach = float(np.max(np.linalg.norm(level, axis=1)))
    return chain, _leaving(team, need, cable, drones, rise, reach), rise


def _leaving(
    team: Team, need: Requirements, cable: int, drones: Array, rise: float, reach: float
) -> _Leaving:
    """Return the flight of a cable's drones aside, above all others, after they have risen.

    All others are within ``reach`` [m] from the middle of all drones, seen from above.
    """
    own = _own(cable)
    swarm = Swarm(2, quadrotor=[team.kinds[drone] for drone in own])
    above = drones[own] + [0.0, 0.0, rise]
    outward = np.mean(drones[own], axis=0) - np.mean(drones, axis=0)
    outward = unit(outward * [1.0, 1.0, 0.0])
    offsets = (above - np.mean(drones, axis=0)) @ outward
    distance = max(0.0, reach + ASIDE * need.with_reserve.separation.radius - np.min(offsets))
    aside = above + _within(need, above, distance * outward)
    limits = need.limits.with_reserve

    def straight(name: str, start: Array, end: Array) -> Motion:
        """Return the flight on straight lines."""
        lines = straight_lines(swarm, limits, start, end)
        return Motion.single(swarm, need, lines, [Phase(name, 0, 0.0, lines.duration)])

    return _Leaving(straight("rise", drones[own], above), straight("aside", above, aside))


def _within(need: Requirements, points: Array, move: Array) -> Array:
    """Return a horizontal move of points (m, 3) [m], shortened to stay in the arena."""
    if need.arena is None:
        return move
    arena = known(need.with_reserve.arena)
    room = np.where(move > 0.0, arena.upper - points, points - arena.lower)[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(move[:2] == 0.0, np.inf, room / np.abs(move[:2]))
    return np.asarray(move * float(np.clip(np.min(shares), 0.0, 1.0)))


def _chain(
    motion: Motion, need: Requirements, cable: int, drones: Array, vertices: Array, balanced: Array
) -> Motion:
    """Return the motion of all cables but one from rest: to balanced places, and under tension."""
    layout = motion.team.layout
    places = _chain_places(motion.team, cable)
    cables = places[::2] // 2
    team = _chain_team(motion.team, cables)
    clasps = vertices[layout.starts[cables[1:]]]
    end = balanced[places]
    lines = straight_lines(team, need.limits.with_reserve, drones[places], end)
    still = np.broadcast_to(clasps[..., None], (lines.pieces, *clasps.shape, lines.degree + 1))
    ends = lines.coefficients
    points = np.concatenate([ends[:, :1], still, ends[:, -1:]], axis=1)
    phase = Phase("reach", 0, 0.0, lines.duration, state=CableState.LOOSE)
    reach = Motion.single(team, need, lines, [phase]).replaced(vertices=lines.replaced(points))
    seconds = rise_seconds(team)
    breaks = np.array([0.0, seconds])
    legs = np.linalg.norm(end - points[-1, :, :, -1][team.layout.anchors], axis=1).reshape(-1, 2)
    rising = team.tension[:, None] * SMOOTH
    tightened = Motion(
        team,
        need,
        drones=PiecewisePolynomial.constant(breaks, end),
        vertices=PiecewisePolynomial.constant(breaks, points[-1, ..., -1]),
        legs=PiecewisePolynomial.constant(breaks, legs),
        tensions=PiecewisePolynomial(breaks, rising[None]),
        phases=(Phase("tension", 0, 0.0, seconds),),
    )
    held = resting(tightened, HOLD, Phase("hold", 1, 0.0, HOLD))
    return concatenated([reach, tightened, held])


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
