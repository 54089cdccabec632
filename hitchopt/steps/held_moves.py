"""Moves of a hitch that holds an object, and the motions of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.checks.clasps import QUICK_EQUILIBRIUM
from hitchopt.checks.objects import GRIP
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.rule import CheckRule
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Hold, Motion, Phase, joined_motions
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, stacked_on
from hitchopt.planners.carrying.moves import Move, SmoothLaw, move_motion
from hitchopt.planners.carrying.rest import ROOM, HeldHitch
from hitchopt.planners.timing.flight import check_duration, needed_stretch
from hitchopt.steps.moving import Morph, Transport
from hitchopt.steps.step import Holding, Step, StepPlan, StepTask
from hitchopt.steps.step_keys import RolledLegs
from hitchopt.values import Array

LIFT_SPEED = 0.1
"""[m/s] Speed upright with an object, and against its rim."""

PRELOAD = 1.5
"""[s] The weight passes from support to clasps, or back, in this time."""

LEVEL = 1e-6
"""[m] Places that differ by less are the same."""

STRETCHES = 5
"""So often a move is slowed down until no limit of motion is broken."""

BELOW = 0.01
"""[m] How much farther than ``separation.object`` cables pass below a rim."""


def gap_around(requirements: Requirements) -> float:
    """Return how far edges around an object keep from it [m]."""
    return requirements.separation.object + ROOM


def gap_below(requirements: Requirements) -> float:
    """Return how far below a rim cables pass before they touch it [m]."""
    return requirements.separation.object + BELOW


def gentle_rates(task: StepTask, length: float) -> tuple[float, float]:
    """Return limits of acceleration and jerk over a length, gentle ones."""
    limits = task.requirements.limits
    return 0.5 * limits.acceleration / length, 0.5 * limits.jerk / length


def holding_otherwise(task: StepTask, **changes: Any) -> StepTask:
    """Return the task with a hitch that holds the object otherwise."""
    return replace(task, before=replace(task.before, holding=replace(task.holding, **changes)))


def object_of(task: StepTask, name: str) -> SolidObject:
    """Return an object that can be held, where it is by now.

    Raises
    ------
    InputError: a fixed or frictionless one, one on which another one stands, or an open chain.
    """
    objects = task.requirements.objects
    body = objects[name]
    key = f"objects.{name}"
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


def moved_to(body: SolidObject, place: Array) -> SolidObject:
    """Return an object whose base is at (4,) x, y, z [m] and yaw [rad]."""
    return replace(body, at=place[:3], yaw=float(place[3]))


def place_of(body: SolidObject) -> Array:
    """Return where an object's base is (4,): x, y, z [m] and yaw [rad]."""
    return np.append(body.at, body.yaw)


def resting_move(task: StepTask, seconds: float) -> Move:
    """Return the move in which nothing changes for ``seconds`` [s]."""
    return changed_move(task, SmoothLaw(0.5 * seconds))


def changed_move(task: StepTask, law: SmoothLaw, **changes: Any) -> Move:
    """Return a move from where an object is, with everything unchanged that is not given."""
    holding = task.holding
    place = place_of(task.requirements.objects[holding.name])
    share, pulls = float(holding.borne), np.stack([holding.tension, holding.tension])
    if "tension" in changes:
        changes["tension"] = np.stack(changes["tension"])
    return replace(Move(place, place, pulls, (share, share), (0.0, 0.0), law), **changes)


def transferred(task: StepTask, before: float, after: float) -> Move:
    """Return the move in which weight passes to the clasps or back."""
    return within_limits(task, changed_move(task, SmoothLaw(0.5 * PRELOAD), borne=(before, after)))


def within_limits(task: StepTask, move: Move, *rules: CheckRule) -> Move:
    """Return a move that is slowed down as far as limits of motion, and some rules, need."""
    for _ in range(STRETCHES):
        factor = _longer(task, move, rules)
        if not 1.0 < factor < math.inf:
            break
        move = replace(move, law=move.law.slowed(1.01 * factor))
    return move


def _longer(task: StepTask, move: Move, rules: Sequence[CheckRule]) -> float:
    """Return how much longer a move has to take to keep all limits, by estimates."""
    try:
        motion = held_motion(task, [move], "")
        curves = motion.drones, motion.vertices, motion.pulls
        factor = needed_stretch(motion.team, task.requirements.limits, *curves)
        if factor > 1.0 or not rules:  # infinite where a limit is reached at rest itself
            return SLOWER if rules and factor == math.inf else factor
    except InfeasibleError:
        if not rules:
            raise
        return SLOWER
    checks = (rule.check(motion) for rule in rules)
    return 1.0 if all(check is None or check.holds for check in checks) else SLOWER


def tension_moves(task: StepTask, before: Array, after: Array, gap: float) -> list[Move]:
    """Return the change of tensions (n,) [N] that far below a rim [m], if there is one."""
    if np.array_equal(before, after):
        return []
    law, pulls = SmoothLaw(0.5 * PRELOAD), (before, after)
    return [within_limits(task, changed_move(task, law, tension=pulls, below=(gap, gap)))]


def rim_move(task: StepTask, before: float, after: float) -> Move:
    """Return the move from one distance below a rim to another [m], one of them 0."""
    gap = max(before, after)
    law = SmoothLaw.fastest(LIFT_SPEED / gap, *gentle_rates(task, gap))
    return within_limits(task, changed_move(task, law, below=(before, after)))


def in_turn(step: Step, ways: Sequence[Transport | Morph], task: StepTask) -> StepPlan:
    """Return the plan of moves without an object as parts of a step.

    One to where the hitch already is is left out.
    """
    motions, here = [], task
    for way in ways:
        place = np.append(here.hitch.polygon.centroid, here.hitch.altitude)
        if isinstance(way, Transport) and np.max(np.abs(place - way.to)) < LEVEL:
            continue
        planned = rolling_morph(step, way, here) if isinstance(way, Morph) else step.part(way, here)
        motions.append(planned.motion)
        here = here.within(here.requirements, planned.after)
    return StepPlan(joined_motions(motions), here.before)


def rolling_morph(step: Step, morph: Morph, task: StepTask) -> StepPlan:
    """Return the plan of a morph, as a part of a step.

    Legs that are rolled only at one of its ends, and have no route so, are rolled before it, or
    back after it.

    Raises
    ------
    InfeasibleError: no route, with what breaks without that.
    """
    try:
        return step.part(morph, task)
    except InfeasibleError as error:
        start, end = task.hitch, morph.end(task).hitch
        more = np.where(np.abs(end.roll) > np.abs(start.roll), end.roll, start.roll)
        ways = [Morph(end.polygon, RolledLegs(end.q_legs, more))]
        if np.any(more != start.roll):
            ways.insert(0, Morph(start.polygon, RolledLegs(start.q_legs, more)))
        if np.any(more != end.roll):
            ways.append(Morph(end.polygon, RolledLegs(end.q_legs, end.roll)))
        if len(ways) == 1:
            raise
        motions, here = [], task
        for way in ways:
            try:
                planned = step.part(way, here)
            except InfeasibleError:
                raise error from None
            motions.append(planned.motion)
            here = here.within(here.requirements, planned.after)
        return StepPlan(joined_motions(motions), here.before)


def held_plan(step: Step, task: StepTask, after: Holding, moves: Sequence[Move]) -> StepPlan:
    """Return the plan of moves one after the other, and that it ends holding ``after``.

    Where the step was given a duration, all are slowed alike.
    """
    if step.given_duration is not None:
        total, wanted = sum(move.law.duration for move in moves), step.given_duration
        check_duration(wanted, total, f"of step {task.index}")
        moves = [replace(move, law=move.law.slowed(wanted / total)) for move in moves]
    motion = held_motion(task, moves, step.name)
    return ended_holding(task, after, motion, moves[-1].end, moves[-1].below[1])


def ended_holding(
    task: StepTask, after: Holding, motion: Motion, place: Array, below: float = 0.0
) -> StepPlan:
    """Return the plan of a motion that ends with the object's base at a place (4,)."""
    objects = dict(task.requirements.objects)
    body = objects[after.name] = moved_to(objects[after.name], place)
    held = after.held
    hitch = task.hitch
    if held is not None:
        altitude = float(place[2]) + float(held.places[0, 2]) - below
        if isinstance(held, HeldHitch):
            altitude -= float(held.drop(after.tension, float(after.borne)))
        polygon = polygon_at(body, held.places[:, :2])
        q_legs = held.fractions * cable_slack(held.team, polygon)
        hitch = Hitch(held.team, polygon, altitude, q_legs, held.roll)
    drones = motion.drones.at(float(motion.drones.breaks[-1]))
    situation = replace(task.before, drones=drones, hitch=hitch, holding=after, objects=objects)
    return StepPlan(motion, situation)


def held_motion(task: StepTask, moves: Sequence[Move], name: str) -> Motion:
    """Return the motion of moves one after the other with a held object, as one phase."""
    held, requirements = task.holding.held, task.requirements
    assert held is not None
    hold = Hold(task.holding.name, held.by, tuple(range(held.team.robots)))
    phase = Phase(name, task.index, 0.0, 1.0, hold=hold)
    parts = [move_motion(held, move, requirements, phase) for move in moves]
    return one_phase(parts, task, name, hold)


def one_phase(
    parts: Sequence[Motion], task: StepTask, name: str, hold: Hold | None = None
) -> Motion:
    """Return motions one after the other as one phase of a step, in which an object may be held.

    It has the remarks of all of the motions' own phases.
    """
    motion = joined_motions([replace(each, requirements=task.requirements) for each in parts])
    pulls = motion.tensions.coefficients
    tension = None
    if np.any(pulls != task.before.team.tension[:, None]):
        tension = float(np.min(pulls)), float(np.max(pulls))
    remark = "; ".join(dict.fromkeys(each.remark for each in motion.phases if each.remark))
    phase = Phase(name, task.index, 0.0, motion.duration, remark, tension=tension, hold=hold)
    return replace(motion, phases=(phase,))


CARRY_ACCELERATION = 1.0
"""[m/s²] Largest acceleration of what is carried."""

LIFT_ACCELERATION = 0.3
"""[m/s²] The same where it is lifted or set down."""

SLOWER = 1.5
"""How much longer a move takes that is tried where a grip slips, cables do not balance, edges do
not bear weight and inertia, or inertia brings drones or cables too close."""


def carried_move(task: StepTask, start: Array, to: Array, speed: float) -> Move:
    """Return the fastest move of a carried object within all limits.

    Parameters
    ----------
    start, to: (4,) x, y, z [m] and yaw [rad], in a straight line.
    speed: largest one of the object and of drones about it [m/s]

    Raises
    ------
    InfeasibleError: the weight cannot be carried.
    """
    holding, limits = task.holding, task.requirements.limits
    held = holding.held
    assert held is not None
    turned = abs(float(to[3] - start[3])) * held.reach
    length = float(np.linalg.norm((to - start)[:3])) + turned
    upright = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
    acceleration = min(
        LIFT_ACCELERATION if upright else CARRY_ACCELERATION,
        limits.acceleration,
        held.largest_acceleration,
    )
    if length == 0.0 or acceleration == 0.0:
        law = SmoothLaw(0.5)
    else:
        top = min(speed, limits.speed, limits.vertex_speed)
        law = SmoothLaw.fastest(top / length, acceleration / length, limits.jerk / length)
    lifted = holding_otherwise(task, borne=True)
    move = changed_move(lifted, law, start=start, end=to)
    rules = GRIP, QUICK_EQUILIBRIUM, RULE_OF["separation"], RULE_OF["crossing"]
    return within_limits(lifted, move, *rules)
