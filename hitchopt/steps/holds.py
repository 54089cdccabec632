"""Whether a hitch holds an object at rest, and how it closes around one to grip it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product

import numpy as np

from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.planners.carrying.grip import GrippedHitch, check_pull, grip_left
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.planners.carrying.rest import HeldHitch
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
from hitchopt.steps.route_choice import NO_ROOM
from hitchopt.steps.step import Step, StepPlan, StepTask
from hitchopt.values import Array

HALVINGS, EASED = 7, 0.95
"""Halvings of the range of masses, and the share of the largest one at rest that is suggested:
lifting and carrying pull at it too."""

OTHER_TENSIONS = (1.25, 0.8, 1.5, 0.65)
"""Tensions that are tried for a suggestion, over those asked."""

WEIGHTY = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Limits at which less weight, or more of what bears it, is all that helps."""

LOOSE = (0.3, 0.5, 1.0)
"""[N] Tensions with which grips are opened: the less cables pull, the less they hold each other,
but the more their weight brings drones together."""

LEANS = (0.9, 0.6, 0.3, 0.0)
"""Shares of clasp friction against which legs are tried to lean while a hitch closes or opens."""

KEPT = ("separation", "cable_length")
"""Checks that decide how a hitch closes or opens. Where edges meet other corners they sag otherwise
at once, the more the less they are pulled."""

LEFT = 0.5
"""Share of the weight below which has to be what a hitch that has opened still grips with."""

PUSHED = 0.9
"""Share of friction with its support with which edges may push what stands."""

TURNING = SmoothLaw(0.5 * PRELOAD)
"""How tensions change, and how legs turn to lean."""


def check_held(task: StepTask) -> None:
    """Raise InfeasibleError where the hitch does not hold the object at rest.

    Where it holds by rest, it also keeps all limits as it rises to the rim and takes the weight.
    The refusal names the mass and the tension with which the hold at rest is certified.
    """
    holding = task.holding
    words = f"with objects.{holding.name} off its support"
    try:
        _check_bearing(task)
        if isinstance(holding.held, HeldHitch):
            words = f"as the clasps take objects.{holding.name}"
            moves = rim_move(task, gap_below(task.requirements), 0.0), transferred(task, 0.0, 1.0)
            checked(StepPlan(held_motion(task, moves, "lift"), task.before), words)
    except InfeasibleError as error:
        ways, told = _what_holds(task), []
        for each in error.violations:
            more = ["raise limits.tilt_deg"] if each.constraint == "tilt" else []
            more += [] if each.constraint in WEIGHTY else [each.remedy]
            told.append(replace(each, when=words, remedy=", or ".join([*ways, *more])))
        raise InfeasibleError(told) from None


def _check_bearing(task: StepTask) -> None:
    """Raise InfeasibleError where the hitch breaks a limit at rest with the object's weight."""
    held = task.holding.held
    if isinstance(held, HeldHitch):  # without the rim, which bends legs that do not carry it
        held.at_rest(task.holding.tension, held.body.mass)
    bearing = holding_otherwise(task, borne=True)
    motion = held_motion(bearing, [resting_move(bearing, 1.0)], "hold")
    checked(StepPlan(motion, bearing.before))


def _bears(task: StepTask) -> bool:
    try:
        _check_bearing(task)
    except InfeasibleError:
        return False
    return True


def _what_holds(task: StepTask) -> list[str]:
    """Return in words with which mass, tension or team the object is held at rest."""
    holding, requirements = task.holding, task.requirements
    held = holding.held
    assert held is not None

    def weighing(mass: float) -> StepTask:
        body = replace(held.body, mass=mass)
        objects = {**requirements.objects, holding.name: body}
        lighter = holding_otherwise(task, held=replace(held, body=body))
        return replace(lighter, requirements=replace(requirements, objects=objects))

    low, high = 0.0, held.body.mass
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _bears(weighing(middle)) else (low, middle)
    ways = [f"lower objects.{holding.name}.mass to {EASED * low:.3g} kg"] if low else []
    for factor in OTHER_TENSIONS:
        value = float(f"{factor * float(np.mean(holding.tension)):.3g}")
        if _bears(holding_otherwise(task, tension=np.full(held.team.robots, value))):
            ways.append(f"ask for a tension of {value:g} N")
            break
    ways = ways or [f"lower objects.{holding.name}.mass", "raise the tension"]
    if held.by is HoldBy.REST:
        return [*ways, "use more robots, as hitchopt fit counts them"]
    return [*ways, "use rougher cables, or give it a rim"]


def spaced(requirements: Requirements, factor: float) -> Requirements:
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
    )
    here = holding_otherwise(task, tension=asked, held=held)
    check_held(here)
    motion, _, words = _passed(step, here, (team.tension, asked), (0.0, 1.0))
    return ended_holding(task, here.holding, motion, place_of(body)).remarked(words)


def grip_opened(step: Step, task: StepTask) -> StepPlan:
    """Return the plan of opening a grip to a hitch around the standing object.

    Raises
    ------
    InfeasibleError: clasps that stick would hold too much of it, or edges would push it.
    """
    team, holding = task.before.team, task.holding
    body, held = object_of(task, holding.name), holding.held
    assert isinstance(held, GrippedHitch)
    motion, moves, words = _passed(step, task, (holding.tension, team.tension), (1.0, 0.0))
    _check_let_go(holding.name, held, moves)
    polygon, altitude = polygon_at(body, held.around), float(body.at[2]) + held.height
    hitch = Hitch(team, polygon, altitude, held.open_fractions * cable_slack(team, polygon))
    freed = replace(holding, tension=team.tension, held=None)
    drones = motion.drones.at(motion.duration)
    after = replace(task.before, drones=drones, hitch=hitch, holding=freed)
    return StepPlan(motion, after).remarked(words)


def _passed(
    step: Step, task: StepTask, tension: tuple[Array, Array], closed: tuple[float, float]
) -> tuple[Motion, list[Move], str]:
    """Return the motion that closes or opens a hitch, the first that satisfies the checks KEPT.

    Cables pull as hard as while the object is held, or less: as little as possible where the hitch
    opens. Legs lean against clasp friction as far as drones stay apart; the remark says how far.

    Parameters
    ----------
    tension: (n,) [N], before and after.
    closed: how far the hitch is closed before and after.

    Raises
    ------
    InfeasibleError: none does, or edges would push the object along its support.
    """
    holding = task.holding
    held, name = holding.held, f"objects.{holding.name}"
    assert isinstance(held, GrippedHitch)
    opening, largest = closed[0] > closed[1], float(np.max(holding.tension))
    tried = LOOSE if opening else (math.inf, *reversed(LOOSE))
    leans = LEANS if held.team.cable_friction else LEANS[-1:]
    most = PUSHED * held.body.friction * held.body.mass * GRAVITY
    pushed, refused = list[InfeasibleError](), list[InfeasibleError]()
    for value, lean in product(dict.fromkeys(min(each, largest) for each in tried), leans):
        between = np.minimum(holding.tension, value)
        if (push := held.largest_push(between)) > most:
            remedy = f"give it more weight, raise {name}.friction, or give it a rim"
            when = "on its support, which its edges push it along as they close around it"
            broken = Violation("grip", push, most, "max", "N", (name,), when, remedy)
            pushed.append(InfeasibleError([broken]))
            continue
        lax = holding_otherwise(task, tension=between)
        ends = (tension[0], between, closed[0]), (between, tension[1], closed[1])
        first, last = (
            [changed_move(task, TURNING, tension=(p, q), closed=(at, at))] if np.any(p != q) else []
            for p, q, at in ends
        )
        signed = -lean if opening else lean
        try:
            moves = [*first, *_leaning(lax, *closed, signed), *last]
            motion = held_motion(task, moves, step.name)
        except InfeasibleError as error:  # legs cannot lean so far
            refused.append(error)
            continue
        for check in filter(None, (RULE_OF[each].check(motion) for each in KEPT)):
            if not check.holds:
                when = f"as the hitch {'opens' if opening else 'closes'} around {name}"
                remedy = "use lighter cables or other lengths of them, or smooth the outline"
                refused.append(InfeasibleError([check.violation(when, remedy)]))
                break
        else:
            words = f"legs lean against {lean:.0%} of clasp friction" if lean else NO_ROOM
            rubbing = bool(held.team.cable_friction)
            return step.lasting(task, motion), moves, words if rubbing else ""
    raise [*refused, *pushed][0]


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


def _leaning(task: StepTask, start: float, end: float, lean: float) -> Iterator[Move]:
    """Yield the moves from one share of the path to the grip to another, legs leaning.

    Legs are turned for that before and after; drones rest where edges come to touch.
    """
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
