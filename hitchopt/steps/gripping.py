"""Closing of a hitch around an object until it grips, and opening of one that does."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from hitchopt.checks.cable_length import LIMIT
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.hitch.cable_slack import cable_slack
from hitchopt.motion.motion import Motion
from hitchopt.planners.carrying.clasp_opening import grip_left
from hitchopt.planners.carrying.gripped_hitch import GrippedHitch
from hitchopt.planners.carrying.moves import Move, held_flight, separation_ratios
from hitchopt.planners.carrying.smooth_law import SmoothLaw
from hitchopt.steps.carrying import (
    LIFT_SPEED,
    PRELOAD,
    changed_move,
    ended_holding,
    gentle_rates,
    held_motion,
    object_of,
    place_of,
    polygon_at,
    resting_move,
    within_limits,
)
from hitchopt.steps.certified_motions import certified, infeasible
from hitchopt.steps.free_cables import lasting
from hitchopt.steps.friction_lean import NO_ROOM, remarked
from hitchopt.steps.situation import Holding, StepPlan, StepTask
from hitchopt.values import Array

LOOSE = (0.3, 0.4, 0.5, 0.7, 1.0)
"""[N] Tensions with which grips are opened: the less cables pull, the less they hold each other,
but the more their weight brings drones together."""

LEANS = (0.9, 0.75, 0.6, 0.45, 0.3, 0.15)
"""Shares of clasp friction against which legs are tried to lean while a hitch closes or opens."""

KEPT, NEAREST = 1.02, 1.0005
"""Separation of drones that is kept while legs lean, or at all."""

LEFT = 0.5
"""Share of the weight below which has to be what a hitch that has opened still grips with."""

PUSHED = 0.9
"""Share of friction with its support with which edges may push what stands."""

SEAM = 0.8 * LIMIT
"""Largest relative error of cable lengths where edges meet other corners."""

OTHER_BENDS = "smooth the outline: edges come to bend otherwise as they take the weight"
"""What to change where a grip that could hold an object at first is out of balance with it."""

APART = 1.15
"""Distance of neighbouring drones while legs lean, over the least one."""


def grip_closed(
    task: StepTask, name: str, tension: float | None, duration: float | None, step: str
) -> StepPlan:
    """Return the plan from around an object to cables that grip it.

    Parameters
    ----------
    name: of the object.
    tension: of all cables [N]; None for the team's.
    duration, step: of the step, and what it is called.

    Raises
    ------
    InputError: an object with a rim.
    InfeasibleError: the object cannot be gripped, with what binds and what to change.
    """
    from hitchopt.planners.carrying.grip_polygon import check_pull

    body, team = object_of(task, name), task.before.team
    if body.rim is not None:
        bound = "rest where the object has a rim, which the hitch is below"
        raise InputError(f"mission[{task.index}].{step}.by", "grip", bound, "leave out the rim")
    asked = team.tension if tension is None else np.full(team.robots, tension)
    check_pull(float(np.max(asked)), team, task.requirements)
    polygons = task.holding.polygons
    held = GrippedHitch(
        team,
        body,
        polygons.around,
        polygons.closed,
        float(body.centre_of_mass[2]),
        task.hitch.fractions,
        APART * 2.0 * task.requirements.separation.radius,
    )
    holding = Holding(name, polygons, asked, held)
    here = replace(task, before=replace(task.before, holding=holding))
    check_grip(here)
    moves = _passing(here, (team.tension, asked), (0.0, 1.0), (math.inf, *reversed(LOOSE)))
    motion = held_motion(here, [held_flight(held, move) for move in moves], step)
    motion = _remarked_lean(lasting(motion, duration, task.index, step), moves)
    return ended_holding(task, holding, motion, place_of(body))


def grip_opened(task: StepTask, name: str, duration: float | None, step: str) -> StepPlan:
    """Return the plan of opening a grip to a hitch around the standing object.

    Raises
    ------
    InfeasibleError: clasps that stick would hold too much of it, or edges would push it.
    """
    body, team, holding = object_of(task, name), task.before.team, task.holding
    held = holding.held
    assert isinstance(held, GrippedHitch)
    moves = _passing(task, (holding.tension, team.tension), (1.0, 0.0), LOOSE)
    _check_let_go(name, held, moves)
    motion = held_motion(task, [held_flight(held, move) for move in moves], step)
    motion = _remarked_lean(lasting(motion, duration, task.index, step), moves)
    polygon, altitude = polygon_at(body, held.around), float(body.at[2]) + held.height
    hitch = Hitch(team, polygon, altitude, held.open_fractions * cable_slack(team, polygon))
    freed = replace(holding, tension=team.tension, held=None)
    drones = motion.drones.at(motion.duration)
    return StepPlan(motion, replace(task.before, drones=drones, hitch=hitch, holding=freed))


def _passing(
    task: StepTask,
    tension: tuple[Array, Array],
    closed: tuple[float, float],
    tried: Iterable[float],
) -> list[Move]:
    """Return moves that close or open a hitch, the first at which all is as it has to be.

    Drones stay apart, edges do not push what stands, and cables keep their lengths. Where drones
    never stay apart, the first with all else is taken.

    Parameters
    ----------
    tension: (n,) [N], before and after; that in between is no larger than while the object is held.
    closed: how far the hitch is closed before and after.
    tried: tensions in between [N].

    Raises
    ------
    InfeasibleError: edges would push the object along its support at any of these tensions, or
        cables would not keep their lengths.
    """
    holding = task.holding
    held, name = holding.held, holding.name
    assert isinstance(held, GrippedHitch)
    friction = held.body.friction * held.body.mass * GRAVITY
    push = math.inf
    found: list[tuple[float, list[Move]]] = []
    for value in dict.fromkeys(min(each, float(np.max(holding.tension))) for each in tried):
        between = np.minimum(holding.tension, value)
        pushed = held.largest_push(between)
        push = min(push, pushed)
        if pushed > PUSHED * friction:
            continue
        lax = replace(task, before=replace(task.before, holding=replace(holding, tension=between)))
        ends = ((tension[0], between), closed[0]), ((between, tension[1]), closed[1])
        first, last = (
            [changed_move(task, law, tension=T, closed=(at, at)) for law, T in _pulls(*pulls)]
            for pulls, at in ends
        )
        moves = [*first, *_closing(lax, *closed), *last]
        seam = held.largest_seam(between)
        if seam <= SEAM and all(_apart(task, move, NEAREST) for move in moves):
            return moves
        found.append((seam, moves))
    if not found:
        remedy = f"give it more weight, raise objects.{name}.friction, or give it a rim"
        when = "on its support, which its edges push it along as they close around it one by one"
        over = Violation(
            "grip", push, PUSHED * friction, "max", "N", (f"objects.{name}",), when, remedy
        )
        raise InfeasibleError([over])
    seam, moves = next((each for each in found if each[0] <= SEAM), found[0])
    if seam > LIMIT:
        remedy = "use lighter cables, smooth the outline, or make it rougher for its support"
        when = "where edges come to meet other corners, and sag otherwise, as they close around it"
        where = (f"objects.{name}",)
        uneven = Violation("cable_length", seam, LIMIT, "max", "1", where, when, remedy)
        raise InfeasibleError([uneven])
    return moves


def _check_let_go(name: str, held: GrippedHitch, moves: list[Move]) -> None:
    """Raise InfeasibleError where clasps that stick would hold half of the object's weight."""
    opening = [move for move in moves if move.closed[0] > move.closed[1]][-1]
    end = held.curves(opening, np.array([opening.law.duration]))
    layout, body = held.team.layout, held.body
    legs = (end["drones"] - end["vertices"][:, layout.anchors])[0, :, :2]
    pair = np.stack([legs[2 * layout.ahead], legs[2 * layout.behind + 1]], axis=1)
    left = grip_left(pair, opening.tension[1], held.team.cable_friction, body.friction)
    most = LEFT * body.mass * GRAVITY
    if left > most:
        remedy = "use smoother cables (team.cable_friction), longer ones, or a hitch tied larger"
        broken = Violation(
            "grip", left, most, "max", "N", (f"objects.{name}",), "left as clasps stick", remedy
        )
        raise InfeasibleError([broken])


def _pulls(before: Array, after: Array) -> Iterator[tuple[SmoothLaw, tuple[Array, Array]]]:
    """Yield the law and the tensions of a change of tensions, if there is one."""
    if np.any(before != after):
        yield SmoothLaw(0.5 * PRELOAD), (before, after)


def _closing(task: StepTask, start: float, end: float) -> list[Move]:
    """Return the moves that close or open a hitch; drones rest where edges come to touch.

    Legs lean against clasp friction all the while, and are turned for that before and after: as far
    as drones stay apart.
    """
    held = task.holding.held
    assert isinstance(held, GrippedHitch)
    sign = math.copysign(1.0, end - start)
    for share in LEANS if held.team.cable_friction else ():
        moves = list(_leaning(task, start, end, sign * share))
        if all(_apart(task, move, KEPT) for move in moves):
            return moves
    return list(_leaning(task, start, end, 0.0))


def _leaning(task: StepTask, start: float, end: float, lean: float) -> Iterator[Move]:
    """Yield the moves from one share of the path to the grip to another, legs leaning."""
    held = task.holding.held
    assert isinstance(held, GrippedHitch)
    turning = SmoothLaw(0.5 * PRELOAD)
    if lean:
        yield changed_move(task, turning, closed=(start, start), lean=(0.0, lean))
    places = np.unique([start, *held.events, end])
    if start > end:
        places = places[::-1]
    for one, other in pairwise(places.tolist()):
        length = held.farthest * abs(other - one)
        law = SmoothLaw.fastest(LIFT_SPEED / length, *gentle_rates(task, length))
        yield within_limits(task, changed_move(task, law, closed=(one, other), lean=(lean, lean)))
    if lean:
        yield changed_move(task, turning, closed=(end, end), lean=(lean, 0.0))


def _remarked_lean(motion: Motion, moves: list[Move]) -> Motion:
    """Return a motion that says against how much of clasp friction its legs lean, if there is."""
    if not motion.team.cable_friction:
        return motion
    share = max(abs(end) for move in moves for end in move.lean)
    return remarked(
        motion, f"legs lean against {share:.0%} of clasp friction" if share else NO_ROOM
    )


def _apart(task: StepTask, move: Move, least: float) -> bool:
    """Return whether drones keep that many times their separation at samples of a move."""
    held = task.holding.held
    assert held is not None
    return bool(np.min(separation_ratios(held, move, task.requirements.separation)) >= least)


def check_grip(task: StepTask) -> None:
    """Raise InfeasibleError where an object cannot be gripped at rest, with what to change."""
    holding, requirements, team = task.holding, task.requirements, task.before.team
    held = holding.held
    assert isinstance(held, GrippedHitch)
    body, words = held.body, f"with objects.{holding.name} off its support"
    bearing = replace(task, before=replace(task.before, holding=replace(holding, borne=True)))

    @cache
    def suggested(otherwise: str) -> str:
        from hitchopt.planners.carrying.grip_polygon import grip_suggestion

        tension = float(np.min(holding.tension))
        given = holding.name, body, held.closed, team, tension, requirements
        capacity, remedies = grip_suggestion(*given)
        if capacity.mass >= body.mass:
            return otherwise
        return f"{remedies} ({capacity.binding} binds)"

    try:
        flight = held_flight(held, resting_move(bearing, 1.0))
    except InfeasibleError as error:
        broken = [replace(v, when=words, remedy=suggested(v.remedy)) for v in error.violations]
        raise InfeasibleError(broken) from None
    found = certified(held_motion(bearing, [flight], "hold"))
    if found.certificate.certified:
        return
    refusal = infeasible(found.certificate, found.motion, words)
    weighty = {"thrust", "tilt", "equilibrium", "grip"}
    raise InfeasibleError(
        [
            replace(v, remedy=suggested(OTHER_BENDS if v.constraint in weighty else v.remedy))
            for v in refusal.violations
        ]
    )
