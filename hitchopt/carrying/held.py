"""The enclosed or held object between steps, and plans of moves with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hitchopt.carrying.moves import Move
from hitchopt.carrying.planner import GraspState, MovePlanner
from hitchopt.errors import RequestError
from hitchopt.motion.motion import Motion
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.planners.timing.timed_motion import check_duration
from hitchopt.steps.step import Step
from hitchopt.values import Array

GRASP = "grasp"  # Name of the enclosed or held object in what steps leave to the next ones


def grasp_of(task: StepTask) -> GraspState:
    """Return the enclosed or held object; raises InputError without one."""
    grasp: GraspState | None = task.before.kept.get(GRASP)
    if grasp is None:
        raise RequestError("start", "no object", "an enclosed object", "enclose one first")
    return grasp


def held_of(task: StepTask) -> MovePlanner:
    """Return the planner of moves with the object of ``grasp_of``; raises InputError without it."""
    return MovePlanner(grasp_of(task), task.requirements, task.index)


def plan_with_object(
    task: StepTask, motion: Motion, grasp: GraspState, place: Array, below: float = 0.0
) -> StepPlan:
    """Return the plan of a motion to a grasp, with the object's base at a pose (4,).

    The clasps end ``below`` the rim [m].
    """
    body = task.requirements.objects[grasp.object].moved_to(place)
    hitch = task.before.hitch
    hold = grasp.hold
    if hold is not None:
        drop = float(hold.drop(grasp.tension, float(grasp.carried)))
        hitch = hold.hitch(body, below + drop)
    after = replace(
        task.before.keeping(GRASP, grasp),
        drones=motion.drones.at(motion.duration),
        hitch=hitch,
        objects={**task.requirements.objects, grasp.object: body},
    )
    return StepPlan(motion, after)


def plan_of_moves(step: Step, task: StepTask, grasp: GraspState, moves: Sequence[Move]) -> StepPlan:
    """Return the plan of a step's moves to a grasp, in its prescribed duration.

    Their laws are slowed down, not their curves: legs tilt with the object's acceleration.
    """
    duration = step.prescribed_duration
    if duration is not None:
        fastest = sum(move.law.duration for move in moves)
        check_duration(duration, fastest, step.phase(task).place)
        moves = [replace(move, law=move.law.slowed(duration / fastest)) for move in moves]
    motion = held_of(task).motion(moves, step.name)
    last = moves[-1]
    return plan_with_object(task, motion, grasp, last.end, last.below[1])


def held_rest(step: Step, task: StepTask, seconds: float) -> StepPlan | None:
    """Return the plan of a step that rests with the held object [s]; None if none is held."""
    grasp: GraspState | None = task.before.kept.get(GRASP)
    if grasp is None or grasp.hold is None:
        return None
    return plan_of_moves(step, task, grasp, [held_of(task).rest(seconds)])
