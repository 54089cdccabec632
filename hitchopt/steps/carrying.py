"""Shared by the steps that hold an object: motions with it, and whether it can be held."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch
from hitchopt.hitch.cable_slack import cable_slack
from hitchopt.motion.motion import Motion, Phase, joined_motions
from hitchopt.motion.phases import Hold
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_world, poses_of, stacked_on
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.planners.carrying.moves import HeldFlight, Move, held_flight
from hitchopt.planners.carrying.rest_polygon import ROOM
from hitchopt.planners.carrying.smooth_law import SmoothLaw
from hitchopt.planners.timing.flight_curves import check_duration
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.requirements import Requirements
from hitchopt.steps.morph import Morph
from hitchopt.steps.situation import Holding, StepPlan, StepTask
from hitchopt.steps.slack_split import RolledLegs
from hitchopt.steps.step import Step
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LIFT_SPEED = 0.1
"""[m/s] Speed upright with an object, and against its rim."""

AROUND_SPEED = 0.15
"""[m/s] Speed upright around an object."""

PRELOAD = 1.5
"""[s] The weight passes from support to clasps, or back, in this time."""

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


def changed_move(
    task: StepTask,
    law: SmoothLaw,
    to: Array | None = None,
    tension: tuple[Array, Array] | None = None,
    borne: tuple[float, float] | None = None,
    below: tuple[float, float] = (0.0, 0.0),
    closed: tuple[float, float] = (1.0, 1.0),
    lean: tuple[float, float] = (0.0, 0.0),
) -> Move:
    """Return a move from where an object is, with everything unchanged that is not given."""
    holding = task.holding
    start = place_of(task.requirements.objects[holding.name])
    share = float(holding.borne)
    pulls = (holding.tension, holding.tension) if tension is None else tension
    return Move(
        start,
        start if to is None else to,
        np.stack(pulls),
        (share, share) if borne is None else borne,
        below,
        law,
        closed,
        lean,
    )


def transferred(task: StepTask, before: float, after: float) -> Move:
    """Return the move in which weight passes to the clasps or back."""
    return within_limits(task, changed_move(task, SmoothLaw(0.5 * PRELOAD), borne=(before, after)))


def within_limits(task: StepTask, move: Move) -> Move:
    """Return a move that is slowed down as far as limits of motion need."""
    held = task.holding.held
    assert held is not None
    for _ in range(STRETCHES):
        flight = held_flight(held, move)
        factor = needed_stretch(held.team, task.requirements.limits, *flight.parts)
        if not 1.0 < factor < math.inf:
            break
        move = replace(move, law=move.law.slowed(1.01 * factor))
    return move


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


def lasting_moves(moves: Sequence[Move], duration: float | None, task: StepTask) -> list[Move]:
    """Return moves that take exactly as long as a step was given, all slowed alike."""
    total = sum(move.law.duration for move in moves)
    if duration is None:
        return list(moves)
    check_duration(duration, total, f"of step {task.index}")
    return [replace(move, law=move.law.slowed(duration / total)) for move in moves]


def rolling_morph(step: Step, morph: Morph, task: StepTask) -> StepPlan:
    """Return the plan of a morph, as a part of a step.

    Where legs that are rolled only at one of its ends have no way, they are rolled before it, or
    back after it.

    Raises
    ------
    InfeasibleError: no way, with what breaks without that.
    """
    try:
        return step.part(morph, task)
    except InfeasibleError as error:
        start, end = task.hitch, morph.end(task).hitch
        more = np.where(np.abs(end.roll) > np.abs(start.roll), end.roll, start.roll)
        legs = (start.q_legs, more), (end.q_legs, more), (end.q_legs, end.roll)
        outlines = start.polygon, end.polygon, end.polygon
        ways = [Morph(at, RolledLegs(*each)) for at, each in zip(outlines, legs, strict=True)]
        wanted = [bool(np.any(more != start.roll)), True, bool(np.any(more != end.roll))]
        if sum(wanted) == 1:
            raise
        motions, here = [], task
        for each in compress(ways, wanted):
            try:
                planned = step.part(each, here)
            except InfeasibleError:
                raise error from None
            motions.append(planned.motion)
            here = here.within(here.requirements, planned.after)
        return StepPlan(joined_motions(motions), planned.after)


def held_plan(task: StepTask, after: Holding, moves: Sequence[Move], name: str) -> StepPlan:
    """Return the plan of moves one after the other, and that it ends holding ``after``."""
    held = task.holding.held
    assert held is not None
    motion = held_motion(task, [held_flight(held, move) for move in moves], name)
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


def held_motion(task: StepTask, flights: Sequence[HeldFlight], name: str) -> Motion:
    """Return the motion of a hitch that holds an object, as one phase."""
    holding, requirements = task.holding, task.requirements
    held = holding.held
    assert held is not None
    hold = Hold(holding.name, held.by, tuple(range(task.before.team.robots)))
    parts = []
    for each in flights:
        breaks = each.pose.breaks
        index = list(requirements.objects).index(holding.name)
        poses = np.repeat(
            poses_of(requirements.objects)[None, :, :, None], each.pose.pieces, axis=0
        )
        poses = np.repeat(poses, each.pose.degree + 1, axis=-1)
        poses[:, index] = each.pose.coefficients
        share = np.zeros((each.borne.pieces, len(requirements.objects), each.borne.degree + 1))
        share[:, index] = each.borne.coefficients
        parts.append(
            Motion(
                task.before.team,
                requirements,
                **vars(each.flight),
                phases=(Phase(name, task.index, 0.0, each.flight.duration),),
                poses=PiecewisePolynomial(breaks, poses),
                borne=PiecewisePolynomial(breaks, share),
                contacts=each.contacts,
                leg_tensions=each.leg_tensions,
            )
        )
    return one_phase(joined_motions(parts), task, name, hold)


def one_phase(motion: Motion, task: StepTask, name: str, hold: Hold | None = None) -> Motion:
    """Return a motion as one phase of a step, in which an object may be held.

    It has the remarks of all of the motion's own phases.
    """
    tension = None
    pulls = motion.tensions.coefficients
    least, most = float(np.min(pulls)), float(np.max(pulls))
    if np.any(pulls != task.before.team.tension[:, None]):
        tension = (least, most)
    remark = "; ".join(dict.fromkeys(each.remark for each in motion.phases if each.remark))
    phase = Phase(name, task.index, 0.0, motion.duration, remark, tension=tension, hold=hold)
    return replace(motion, requirements=task.requirements, phases=(phase,))
