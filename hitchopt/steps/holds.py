"""Whether a hitch holds an object at rest, and how it closes around one to grip it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT as LIMIT
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.carrying.grip import GrippedHitch
from hitchopt.planners.carrying.grip_polygon import (
    TENSIONS,
    check_pull,
    grip_left,
    grip_suggestion,
)
from hitchopt.planners.carrying.moves import Move, SmoothLaw, separation_ratios
from hitchopt.planners.carrying.rest import EASED, EMPTY, HeldHitch, broken_at, rest_capacity
from hitchopt.steps.certified_motions import checked
from hitchopt.steps.held_moves import (
    LIFT_SPEED,
    PRELOAD,
    changed_move,
    ended_holding,
    gap_below,
    gentle_rates,
    held_motion,
    holding_otherwise,
    object_of,
    place_of,
    polygon_at,
    resting_move,
    rim_move,
    transferred,
    within_limits,
)
from hitchopt.steps.route_choice import NO_ROOM, end_of_morph, remarked
from hitchopt.steps.step import Step, StepPlan, StepTask
from hitchopt.steps.step_keys import RolledLegs
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

APART = 1.15
"""Distance of neighbouring drones while legs lean, over the least one."""

WEIGHTY = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Limits at which less weight, or more of what bears it, is all that helps."""

MORE_ROLL = 1.3
"""Factor of the least roll with which legs without a load keep off each other, where a load brings
them nearer."""

TURNING = SmoothLaw(0.5 * PRELOAD)
"""How tensions change, and how legs turn to lean."""

SPARE, SPREAD = 1.01, 1.03
"""Distances of the hitch at rest, over those to be kept: those with which legs stay as they are,
since the motion takes some of them, and those to which they are moved otherwise."""


def check_rest(task: StepTask, spare: float = 1.0) -> None:
    """Raise InfeasibleError where the hitch does not hold the object by its rim at rest.

    It names what to change: masses and tensions that statics allow at rest.

    Parameters
    ----------
    spare: distances that the hitch keeps with the object on its clasps, over those to be kept; it
        keeps those themselves as it rises to the rim and takes the weight.
    """
    held, holding, requirements = task.holding.held, task.holding, task.requirements
    assert isinstance(held, HeldHitch)
    wide = replace(task, requirements=_spaced(requirements, spare))
    words = f"with objects.{holding.name} on the clasps"
    try:
        held.at_rest(holding.tension, held.body.mass)
        checked(_bearing(wide), words)
        words = f"as the clasps take objects.{holding.name}"
        moves = rim_move(task, gap_below(requirements), 0.0), transferred(task, 0.0, 1.0)
        checked(held_motion(task, moves, "lift"), words)
    except InfeasibleError as error:
        capacity = rest_capacity(held, holding.tension, requirements.limits)
        lighter = EASED * min(capacity.mass, held.body.mass)
        ways = [f"lower objects.{holding.name}.mass to {lighter:.3g} kg"] if lighter else []
        ways += _other_tension(held, holding.tension, requirements.limits)
        ways += ["use more robots, as hitchopt fit counts them"]
        told = []
        for each in error.violations:
            more = ["raise limits.tilt_deg"] if each.constraint == "tilt" else []
            more += [] if each.constraint in WEIGHTY else [each.remedy]
            binds = f" ({capacity.binding} binds)" if each.constraint == "load" else ""
            told.append(replace(each, when=words, remedy=", or ".join([*ways, *more]) + binds))
        raise InfeasibleError(told) from None


def _bearing(task: StepTask) -> Motion:
    """Return the motion of the hitch at rest with the object's weight on it."""
    bearing = holding_otherwise(task, borne=True)
    return held_motion(bearing, [resting_move(bearing, 1.0)], "hold")


def check_grip(task: StepTask) -> None:
    """Raise InfeasibleError where an object cannot be gripped at rest, with what to change."""
    holding, team = task.holding, task.before.team
    held = holding.held
    assert isinstance(held, GrippedHitch)
    words = f"with objects.{holding.name} off its support"
    bends = False
    try:
        motion = _bearing(task)
        bends = True  # of its own accord, to be refused by the certificate
        checked(motion, words)
    except InfeasibleError as error:
        given = holding.name, held.body, held.closed, team, float(np.min(holding.tension))
        capacity, remedies = grip_suggestion(*given, task.requirements)
        told = []
        for each in error.violations:
            remedy = each.remedy
            if capacity.mass < held.body.mass:
                remedy = f"{remedies} ({capacity.binding} binds)"
            elif bends and each.constraint in WEIGHTY:
                remedy = "smooth the outline: edges come to bend otherwise as they take the weight"
            told.append(replace(each, when=words, remedy=remedy))
        raise InfeasibleError(told) from None


def _other_tension(held: HeldHitch, asked: Array, limits: Limits) -> list[str]:
    """Return the tension nearest to those asked (n,) [N] with which statics hold, in words."""
    for value in sorted(TENSIONS, key=lambda value: abs(value - float(np.mean(asked)))):
        pulls = np.full(held.team.robots, float(f"{value:.3g}"))
        if not broken_at(held, held.body.mass, pulls, limits) and not broken_at(
            held, 0.0, EMPTY * pulls, limits
        ):
            return [f"ask for a tension of {value:.3g} N"]
    return []


def farther_legs(start: Hitch, hitch: Hitch, requirements: Requirements) -> RolledLegs:
    """Return legs that keep larger distances: rolled more, if they are rolled, or moved on.

    Parameters
    ----------
    start, hitch: before and after closing.
    """
    if np.any(hitch.roll):
        return RolledLegs(hitch.q_legs, MORE_ROLL * hitch.roll)
    moved = end_of_morph(start, hitch.polygon, None, _spaced(requirements, SPREAD)).hitch
    return RolledLegs(moved.q_legs, moved.roll)


def _spaced(requirements: Requirements, factor: float) -> Requirements:
    """Return requirements with larger distances between drones and cables."""
    far = {key: factor * value for key, value in vars(requirements.separation).items()}
    return replace(requirements, separation=replace(requirements.separation, **far))


def grip_closed(step: Step, task: StepTask, tension: float | None) -> StepPlan:
    """Return the plan from around an object to cables that grip it.

    Parameters
    ----------
    step: what is planned; it names the object.
    tension: of all cables [N]; None for the team's.

    Raises
    ------
    InputError: an object with a rim.
    InfeasibleError: the object cannot be gripped, with what binds and what to change.
    """
    around, team = task.holding, task.before.team
    body = object_of(task, around.name)
    if body.rim is not None:
        bound = "rest where the object has a rim, which the hitch is below"
        raise InputError(
            f"mission[{task.index}].{step.name}.by", "grip", bound, "leave out the rim"
        )
    asked = team.tension if tension is None else np.full(team.robots, tension)
    check_pull(float(np.max(asked)), team, task.requirements)
    held = GrippedHitch(
        team,
        body,
        around.polygons.around,
        around.polygons.closed,
        float(body.centre_of_mass[2]),
        task.hitch.fractions,
        APART * 2.0 * task.requirements.separation.radius,
    )
    here = holding_otherwise(task, tension=asked, held=held)
    check_grip(here)
    pulls = team.tension, asked
    motion, _ = _passed(step, here, pulls, (0.0, 1.0), (math.inf, *reversed(LOOSE)))
    return ended_holding(task, here.holding, motion, place_of(body))


def grip_opened(step: Step, task: StepTask) -> StepPlan:
    """Return the plan of opening a grip to a hitch around the standing object.

    Raises
    ------
    InfeasibleError: clasps that stick would hold too much of it, or edges would push it.
    """
    team, holding = task.before.team, task.holding
    body, held = object_of(task, holding.name), holding.held
    assert isinstance(held, GrippedHitch)
    motion, moves = _passed(step, task, (holding.tension, team.tension), (1.0, 0.0), LOOSE)
    _check_let_go(holding.name, held, moves)
    polygon, altitude = polygon_at(body, held.around), float(body.at[2]) + held.height
    hitch = Hitch(team, polygon, altitude, held.open_fractions * cable_slack(team, polygon))
    freed = replace(holding, tension=team.tension, held=None)
    drones = motion.drones.at(motion.duration)
    return StepPlan(motion, replace(task.before, drones=drones, hitch=hitch, holding=freed))


def _passed(
    step: Step,
    task: StepTask,
    tension: tuple[Array, Array],
    closed: tuple[float, float],
    tried: Iterable[float],
) -> tuple[Motion, list[Move]]:
    """Return the motion of ``_passing`` moves; it says how far legs lean against friction."""
    moves = _passing(task, tension, closed, tried)
    motion = step.lasting(task, held_motion(task, moves, step.name))
    if motion.team.cable_friction:
        share = max(abs(end) for move in moves for end in move.lean)
        words = f"legs lean against {share:.0%} of clasp friction" if share else NO_ROOM
        motion = remarked(motion, words)
    return motion, moves


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
    held, name = holding.held, f"objects.{holding.name}"
    assert isinstance(held, GrippedHitch)
    most = PUSHED * held.body.friction * held.body.mass * GRAVITY
    kept: list[Move] = []
    refused: Violation | None = None
    for value in dict.fromkeys(min(each, float(np.max(holding.tension))) for each in tried):
        between = np.minimum(holding.tension, value)
        push, seam = held.largest_push(between), held.largest_seam(between)
        if push > most:
            remedy = f"give it more weight, raise {name}.friction, or give it a rim"
            when = "on its support, which its edges push it along as they close around it"
            found = Violation("grip", push, most, "max", "N", (name,), when, remedy)
            refused = refused or found
            continue
        if seam > SEAM:
            remedy = "use lighter cables, smooth the outline, or make it rougher for its support"
            when = "where edges come to meet other corners, and sag otherwise, as they close"
            refused = Violation("cable_length", seam, SEAM, "max", "1", (name,), when, remedy)
            continue
        lax = holding_otherwise(task, tension=between)
        ends = (tension[0], between, closed[0]), (between, tension[1], closed[1])
        first, last = (
            [changed_move(task, TURNING, tension=(p, q), closed=(at, at))] if np.any(p != q) else []
            for p, q, at in ends
        )
        moves = [*first, *_closing(lax, *closed), *last]
        if all(_apart(task, move, NEAREST) for move in moves):
            return moves
        kept = kept or moves
    if not kept and refused is not None:
        raise InfeasibleError([refused])
    return kept


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
    if lean:
        yield changed_move(task, TURNING, closed=(start, start), lean=(0.0, lean))
    places = np.unique([start, *held.events, end])
    if start > end:
        places = places[::-1]
    for one, other in pairwise(places.tolist()):
        length = held.farthest * abs(other - one)
        law = SmoothLaw.fastest(LIFT_SPEED / length, *gentle_rates(task, length))
        yield within_limits(task, changed_move(task, law, closed=(one, other), lean=(lean, lean)))
    if lean:
        yield changed_move(task, TURNING, closed=(end, end), lean=(lean, 0.0))


def _apart(task: StepTask, move: Move, least: float) -> bool:
    """Return whether drones keep that many times their separation at samples of a move."""
    held = task.holding.held
    assert held is not None
    return bool(np.min(separation_ratios(held, move, task.requirements.separation)) >= least)
