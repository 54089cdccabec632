"""How a hitch takes, holds and lets go of an object: its moves, one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.rule import CheckRule
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Hold, HoldBy, Motion, Phase, joined_motions
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, poses_of, stacked_on, surface_below
from hitchopt.planners.carrying.grip import GrippedHitch, check_pull, grip_left
from hitchopt.planners.carrying.moves import CarriedMove, Move, SmoothLaw
from hitchopt.planners.carrying.rest import HeldHitch
from hitchopt.steps.step import Holding, Step, StepPlan, StepTask
from hitchopt.values import Array

LIFT_SPEED, BELOW = 0.1, 0.01
"""Speed upright with an object, and against its rim [m/s]; how much farther than
``separation.object`` cables pass below a rim [m]."""

CARRY_ACCELERATION, LIFT_ACCELERATION = 1.0, 0.3
"""[m/s²] Largest acceleration of what is carried, and where it is lifted or set down."""

TURNING = SmoothLaw(0.75)
"""How tensions change, legs turn to lean, and weight passes from support to clasps or back."""

STRETCHES, SLOWER = 5, 1.5
"""So often a move is slowed until limits hold; by this factor where it is not known how far."""

LOOSE = (0.3, 0.6)
"""[N] Tensions with which grips are opened: the less cables pull, the less they hold each other,
but the more they sag; with the first they are closed where edges would push what stands."""

LEANS, KEPT = (0.9, 0.6, 0.3, 0.0), ("separation", "cable_length")
"""Shares of clasp friction against which legs are tried to lean while a hitch closes or opens, and
checks that decide how far. Where edges meet other corners they sag otherwise at once."""

LEFT, PUSHED = 0.5, 0.9
"""Share of the weight below which has to be what a hitch that has opened still grips with; and of
friction with its support with which edges may push what stands."""

WEIGHTY = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Limits at which less weight, or more of what bears it, is all that helps."""


def gap_below(requirements: Requirements) -> float:
    """Return how far below a rim cables pass before they touch it [m]."""
    return requirements.separation.object + BELOW


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object, where it is by now; raise InputError unless it can be held."""
    objects, key = task.requirements.objects, f"objects.{name}"
    body = objects[name]
    if not task.before.team.layout.closed:
        raise InputError("team.topology", "open", "closed where objects are held", "close it")
    if body.fixed:
        raise InputError(f"{key}.fixed", True, "false where it is held", "leave it out")
    if body.friction == 0.0:
        bound, remedy = "above 0 where it is held", "nothing else takes it along as cables move"
        raise InputError(f"{key}.friction", 0.0, bound, remedy)
    for other in stacked_on(objects, name, task.requirements.floor):
        at, bound = objects[other].at.tolist(), f"off objects.{name}, which is held on its own"
        raise InputError(f"objects.{other}.at", at, bound, f"carry objects.{other} away before")
    return body


def polygon_at(body: SolidObject, places: Array) -> ConvexPolygon:
    """Return a polygon (n, 2) [m] in an object's frame as seen from the world."""
    flat = np.column_stack([places, np.zeros(len(places))])
    return ConvexPolygon(in_world(body.pose, flat)[:, :2])


def place_of(body: SolidObject) -> Array:
    """Return where an object's base is (4,): x, y, z [m] and yaw [rad]."""
    return np.append(body.at, body.yaw)


def places(step: Step, requirements: Requirements, name: str) -> tuple[Array, Array]:
    """Return where a held object's base is (4,) before a step, and after it."""
    objects, start = requirements.objects, place_of(requirements.objects[name])
    below, _ = surface_below(objects, poses_of(objects), name, requirements.floor)
    to = step.place_after(objects[name], below)
    return start, start if to is None else to


def moved_to(body: SolidObject, place: Array) -> SolidObject:
    """Return an object whose base is at (4,) x, y, z [m] and yaw [rad]."""
    return replace(body, at=place[:3], yaw=float(place[3]))


def holding_otherwise(task: StepTask, **changes: Any) -> StepTask:
    """Return the task with a hitch that holds the object otherwise."""
    return replace(task, before=replace(task.before, holding=replace(task.holding, **changes)))


# Moves.


def changed_move(task: StepTask, law: SmoothLaw, **changes: Any) -> Move:
    """Return a move from where an object is, with everything unchanged that is not given."""
    holding = task.holding
    place = place_of(task.requirements.objects[holding.name])
    share, pulls = float(holding.borne), np.stack([holding.tension, holding.tension])
    if "tension" in changes:
        changes["tension"] = np.stack(changes["tension"])
    return replace(Move(place, place, pulls, (share, share), (0.0, 0.0), law), **changes)


def resting_move(task: StepTask, seconds: float) -> Move:
    """Return the move in which nothing changes for ``seconds`` [s]."""
    return changed_move(task, SmoothLaw(0.5 * seconds))


def transferred(task: StepTask, before: float, after: float) -> Move:
    """Return the move in which weight passes to the clasps or back."""
    return within_limits(task, changed_move(task, TURNING, borne=(before, after)))


def tension_moves(task: StepTask, before: Array, after: Array, gap: float) -> list[Move]:
    """Return the change of tensions (n,) [N] that far below a rim [m], if there is one."""
    if np.array_equal(before, after):
        return []
    move = changed_move(task, TURNING, tension=(before, after), below=(gap, gap))
    return [within_limits(task, move)]


def _gentle_law(task: StepTask, length: float) -> SmoothLaw:
    """Return the law of a slow motion over a length [m]."""
    limits = task.requirements.limits
    rates = LIFT_SPEED, 0.5 * limits.acceleration, 0.5 * limits.jerk
    return SmoothLaw.fastest(*(rate / length for rate in rates))


def rim_move(task: StepTask, before: float, after: float) -> Move:
    """Return the move from one distance below a rim to another [m], one of them 0."""
    law = _gentle_law(task, max(before, after))
    return within_limits(task, changed_move(task, law, below=(before, after)))


def carried_move(task: StepTask, start: Array, to: Array, speed: float) -> Move:
    """Return the fastest move of a carried object within all limits.

    It goes straight from ``start`` to ``to`` (4,) x, y, z [m] and yaw [rad]; the object, and drones
    about it, go with ``speed`` [m/s] at most. Raises InfeasibleError: it cannot be carried.
    """
    held, limits = task.holding.held, task.requirements.limits
    assert held is not None
    turned = abs(float(to[3] - start[3])) * held.reach
    length = float(np.linalg.norm((to - start)[:3])) + turned
    upright = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
    gentle = LIFT_ACCELERATION if upright else CARRY_ACCELERATION
    acceleration = min(gentle, limits.acceleration, held.largest_acceleration)
    law = SmoothLaw(0.5)
    if length > 0.0 and acceleration > 0.0:
        top = min(speed, limits.speed, limits.vertex_speed)
        law = SmoothLaw.fastest(top / length, acceleration / length, limits.jerk / length)
    lifted = holding_otherwise(task, borne=True)
    rules = [RULE_OF[name] for name in ("equilibrium", "grip", "separation", "crossing")]
    return within_limits(lifted, changed_move(lifted, law, start=start, end=to), *rules)


def within_limits(task: StepTask, move: Move, *rules: CheckRule) -> Move:
    """Return a move that is slowed down as far as limits of motion, and some rules, need."""
    from hitchopt.planners.timing.flight import needed_stretch

    for _ in range(STRETCHES):
        try:
            motion = held_motion(task, [move], "")
            factor = needed_stretch(motion.team, task.requirements.limits, motion)
            checks = (rule.check(motion) for rule in rules)
            if factor <= 1.0 and any(check and not check.holds for check in checks):
                factor = math.inf
        except InfeasibleError:
            if not rules:
                raise
            factor = math.inf
        if factor == math.inf and rules:  # how much slower is not known
            factor = SLOWER
        if not 1.0 < factor < math.inf:
            break
        move = replace(move, law=move.law.slowed(1.01 * factor))
    return move


# Motions.


def held_motion(task: StepTask, moves: Sequence[Move], name: str) -> Motion:
    """Return the motion of moves one after the other with a held object, as one phase."""
    held, requirements = task.holding.held, task.requirements
    assert held is not None
    hold = Hold(task.holding.name, held.by, tuple(range(held.team.robots)))
    phase = Phase(name, task.index, 0.0, 1.0, hold=hold)
    parts = [CarriedMove(held, move, requirements, phase).solve() for move in moves]
    return one_phase(parts, task, name, hold)


def one_phase(
    parts: Sequence[Motion], task: StepTask, name: str, hold: Hold | None = None
) -> Motion:
    """Return motions in a row as one phase of a step, with all remarks; an object may be held."""
    motion = joined_motions([replace(each, requirements=task.requirements) for each in parts])
    pulls = motion.tensions.coefficients
    tension = None
    if np.any(pulls != task.before.team.tension[:, None]):
        tension = float(np.min(pulls)), float(np.max(pulls))
    remark = "; ".join(dict.fromkeys(each.remark for each in motion.phases if each.remark))
    phase = Phase(name, task.index, 0.0, motion.duration, remark, tension=tension, hold=hold)
    return replace(motion, phases=(phase,))


def held_plan(step: Step, task: StepTask, after: Holding, moves: Sequence[Move]) -> StepPlan:
    """Return the plan of moves one after the other, slowed alike, that ends holding ``after``."""
    motion = step.lasting(task, held_motion(task, moves, step.name))
    return ended_holding(task, after, motion, moves[-1].end, moves[-1].below[1])


def ended_holding(
    task: StepTask, after: Holding, motion: Motion, place: Array, below: float = 0.0
) -> StepPlan:
    """Return the plan of a motion that ends with the object's base at a place (4,)."""
    objects = dict(task.requirements.objects)
    body = objects[after.name] = moved_to(objects[after.name], place)
    held, hitch = after.held, task.hitch
    if held is not None:
        altitude = float(place[2]) + float(held.places[0, 2]) - below
        if isinstance(held, HeldHitch):
            altitude -= float(held.drop(after.tension, float(after.borne)))
        polygon = polygon_at(body, held.places[:, :2])
        q_legs = held.fractions * cable_slack(held.team, polygon)
        hitch = Hitch(held.team, polygon, altitude, q_legs, held.roll)
    drones = motion.drones.at(motion.duration)
    situation = replace(task.before, drones=drones, hitch=hitch, holding=after, objects=objects)
    return StepPlan(motion, situation)


# Whether an object is held, and how a hitch closes around one to grip it.


def check_held(task: StepTask) -> None:
    """Raise InfeasibleError where the hitch breaks limits at rest, or as it rises to a rim."""
    from hitchopt.steps.certified_motions import checked

    holding = task.holding
    held, name = holding.held, f"objects.{holding.name}"
    assert held is not None
    bearing, words = holding_otherwise(task, borne=True), f"with {name} off its support"
    try:
        if isinstance(held, HeldHitch):  # without the rim, which bends legs that do not carry it
            held.at_rest(holding.tension, held.body.mass)
        still = held_motion(bearing, [resting_move(bearing, 1.0)], "hold")
        checked(StepPlan(still, bearing.before), words)
        if isinstance(held, HeldHitch):
            words = f"as the clasps take {name}"
            moves = rim_move(task, gap_below(task.requirements), 0.0), transferred(task, 0.0, 1.0)
            checked(StepPlan(held_motion(task, moves, "lift"), task.before), words)
    except InfeasibleError as error:
        robots = "use more robots, as hitchopt fit counts them"
        last = robots if held.by is HoldBy.REST else "use rougher cables, or give it a rim"
        ways, told = f"lower {name}.mass, or ask for another tension, or {last}", []
        for each in error.violations:
            more = ", or raise limits.tilt_deg" if each.constraint == "tilt" else ""
            more += "" if each.constraint in WEIGHTY else f", or {each.remedy}"
            told.append(replace(each, when=words, remedy=ways + more))
        raise InfeasibleError(told) from None


def grip_closed(step: Step, task: StepTask, asked: Array) -> StepPlan:
    """Return the plan from around an object to cables that grip it with tensions (n,) [N].

    Raises InputError for an object with a rim, InfeasibleError for one that cannot be gripped.
    """
    around, team = task.holding, task.before.team
    body, polygons = object_of(task, around.name), around.polygons
    if body.rim is not None:
        key = f"mission[{task.index}].{step.name}.by"
        bound = "rest where the object has a rim, which the hitch is below"
        raise InputError(key, "grip", bound, "leave out the rim")
    check_pull(float(np.max(asked)), team, task.requirements)
    height, fractions = float(body.centre_of_mass[2]), task.hitch.fractions
    held = GrippedHitch(team, body, polygons.around, polygons.closed, height, fractions)
    here = holding_otherwise(task, tension=asked, held=held)
    check_held(here)
    motion, _, words = _passed(step, here, (team.tension, asked), (0.0, 1.0))
    plan = ended_holding(task, here.holding, motion, place_of(body))
    return plan.remarked(words) if words else plan


def grip_opened(step: Step, task: StepTask) -> StepPlan:
    """Return the plan of opening a grip; clasps that stick must not hold half of the weight."""
    team, holding = task.before.team, task.holding
    body, held = object_of(task, holding.name), holding.held
    assert isinstance(held, GrippedHitch)
    motion, moves, words = _passed(step, task, (holding.tension, team.tension), (1.0, 0.0))
    letting = [move for move in moves if move.closed[0] > move.closed[1]][-1]
    end = held.curves(letting, np.array([letting.law.duration]))
    legs = (end["drones"] - end["vertices"][:, team.layout.anchors])[0, :, :2]
    pair = np.stack([legs[2 * team.layout.ahead], legs[2 * team.layout.behind + 1]], axis=1)
    left = grip_left(pair, letting.tension[1], team.cable_friction, body.friction)
    most = LEFT * body.mass * GRAVITY
    if left > most:
        where, when = (f"objects.{holding.name}",), "left as clasps stick"
        remedy = "use smoother cables (team.cable_friction), longer ones, or a hitch tied larger"
        raise InfeasibleError([Violation("grip", left, most, "max", "N", where, when, remedy)])
    polygon, altitude = polygon_at(body, held.around), float(body.at[2]) + held.height
    hitch = Hitch(team, polygon, altitude, held.open_fractions * cable_slack(team, polygon))
    freed = replace(holding, tension=team.tension, held=None)
    drones = motion.drones.at(motion.duration)
    plan = StepPlan(motion, replace(task.before, drones=drones, hitch=hitch, holding=freed))
    return plan.remarked(words) if words else plan


def _passed(
    step: Step, task: StepTask, tension: tuple[Array, Array], closed: tuple[float, float]
) -> tuple[Motion, list[Move], str]:
    """Return the motion that closes or opens a hitch, its moves, and how far legs lean.

    Cables pull so that edges do not push the object along. ``tension`` (n,) [N] and ``closed``, how
    far the hitch is, are before and after.
    """
    holding, opening = task.holding, closed[0] > closed[1]
    held, name = holding.held, f"objects.{holding.name}"
    assert isinstance(held, GrippedHitch)
    most = PUSHED * held.body.friction * held.body.mass * GRAVITY
    low, high = (np.minimum(holding.tension, each) for each in LOOSE)
    gentle = holding.tension * min(1.0, most / max(held.largest_push(holding.tension), 1e-9))
    tried = (low, high) if opening else (holding.tension, np.maximum(low, gentle))
    resting = [each for each in tried if held.largest_push(each) <= most * (1.0 + 1e-9)]
    if not resting:
        push, when = held.largest_push(low), "on its support, which its edges push it along"
        remedy = f"give it more weight, raise {name}.friction, or give it a rim"
        raise InfeasibleError([Violation("grip", push, most, "max", "N", (name,), when, remedy)])
    rubbing, refused = bool(held.team.cable_friction), list[InfeasibleError]()
    for between, lean in product(resting, LEANS if rubbing else LEANS[-1:]):
        lax = holding_otherwise(task, tension=between)
        ends = (tension[0], between, closed[0]), (between, tension[1], closed[1])
        first, last = (
            [changed_move(task, TURNING, tension=(p, q), closed=(at, at))] if np.any(p != q) else []
            for p, q, at in ends
        )
        try:
            moves = [*first, *_leaning(lax, *closed, -lean if opening else lean), *last]
            motion = held_motion(task, moves, step.name)
        except InfeasibleError as error:  # legs cannot lean so far
            refused.append(error)
            continue
        checks = filter(None, (RULE_OF[each].check(motion) for each in KEPT))
        broken = next((check for check in checks if not check.holds), None)
        if broken is None:
            words = f"legs lean against {lean:.0%} of clasp friction" if rubbing else ""
            return step.lasting(task, motion), moves, words
        when = f"as the hitch {'opens' if opening else 'closes'} around {name}"
        remedy = "use lighter cables or other lengths of them, or smooth the outline"
        refused.append(InfeasibleError([broken.violation(when, remedy)]))
    raise refused[0]


def _leaning(task: StepTask, start: float, end: float, lean: float) -> Iterator[Move]:
    """Yield moves from one share of the path to the grip to another; legs lean in between."""
    held = task.holding.held
    assert isinstance(held, GrippedHitch)
    if lean:
        yield changed_move(task, TURNING, closed=(start, start), lean=(0.0, lean))
    places = np.unique([start, *held.events, end])
    for one, other in pairwise((places if start < end else places[::-1]).tolist()):
        law = _gentle_law(task, held.farthest * abs(other - one))
        yield within_limits(task, changed_move(task, law, closed=(one, other), lean=(lean, lean)))
    if lean:
        yield changed_move(task, TURNING, closed=(end, end), lean=(lean, 0.0))
