"""One step of a mission, or several that are blended, to a motion: a function per kind of step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.checks import Certificate
from hitchopt.errors import InputError
from hitchopt.hitch import Hitch
from hitchopt.mission.ends import End, broken_on_the_way, end_of_action, end_of_morph, shared_hitch
from hitchopt.mission.morphing import WayTask, best_way
from hitchopt.mission.motions import check_at_rest, flying, resting
from hitchopt.mission.outlines import outline_after
from hitchopt.mission.step_records import (
    Adjust,
    FollowVertex,
    HitchStep,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    ShapeStep,
    Transport,
)
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.flying import Flying, fly_action
from hitchopt.planners.actions.following import follow_vertex
from hitchopt.planners.actions.shape_moves import adjust, move_edge, move_vertex
from hitchopt.planners.path.blended_path import SAME, blended, check_turns, passing_times
from hitchopt.planners.path.path_feasibility import check_loads, check_shapes
from hitchopt.planners.path.rigid_path import RigidPath
from hitchopt.planners.path.straight_morph import straight_morph
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements

IDLE = 0.01
"""[s] What a step takes that moves nothing and was given no duration."""


@dataclass(frozen=True, eq=False)
class Planned:
    """The motion of a step, and the hitch after it.

    Attributes
    ----------
    motion: from rest to rest.
    end: the hitch after it.
    certificate: of the step alone, its duration left open; None where nobody has asked for it yet.
    """

    motion: Motion
    end: Hitch
    certificate: Certificate | None = None


def plan_step(
    start: Hitch, step: HitchStep, i: int, requirements: Requirements, *, optimiser: bool = True
) -> Planned:
    """Return the plan of step i of a mission, from rest to rest.

    Raises
    ------
    InfeasibleError: the end breaks a limit at rest, or the way is shut.
    HitchoptError: a planner failed.
    """
    if isinstance(step, Hold):
        return Planned(
            resting(start, requirements, step.seconds, Phase(step.name, i, 0.0, 0.0)), start
        )
    if isinstance(step, Transport):
        return _transport(start, step, i, requirements)
    if isinstance(step, FollowVertex):
        return _follow(start, step, i, requirements)
    return _shape(start, step, i, requirements, optimiser=optimiser)


def plan_blended(
    start: Hitch, steps: Sequence[ShapeStep], first: int, requirements: Requirements
) -> Planned:
    """Return the plan of steps that go on into one another, from rest to rest.

    One path through all hitches that they would have ended with, timed as a whole; each phase ends
    when its step's hitch is passed.

    Raises
    ------
    InputError: a step that moves nothing.
    InfeasibleError, HitchoptError: as plan_step.
    """
    hitches = [start]
    for i, step in enumerate(steps, first):
        end = _end(hitches[-1], step, requirements).hitch
        check_at_rest(end, requirements, _end_of(i, step))
        if np.max(np.abs(end.drones - hitches[-1].drones)) < SAME:
            raise InputError(
                f"mission[{i}].{step.name}",
                "no motion",
                "a step that moves something where steps are blended",
                "leave it out, or leave out blend",
            )
        hitches.append(end)
    way = blended(hitches)
    check_shapes(way.path)
    check_turns(way)
    check_loads(way.path, requirements.limits)
    flight = fly(way.path, requirements.limits)
    passed = passing_times(way.path, way.s[1:-1], flight)
    times = [0.0, *passed.tolist(), flight.duration]
    phases = [
        Phase(
            step.name,
            first + j,
            times[j],
            times[j + 1],
            "goes on without a stop" if j + 1 < len(steps) else "",
        )
        for j, step in enumerate(steps)
    ]
    return Planned(flying(flight, start.team, requirements, phases), hitches[-1])


def _shape(
    start: Hitch, step: ShapeStep, i: int, requirements: Requirements, *, optimiser: bool
) -> Planned:
    """Return the plan of a step that ends with another shape or sharing, optimised if need be."""
    end = _end(start, step, requirements)
    check_at_rest(end.hitch, requirements, _end_of(i, step))

    def own() -> Motion:
        if not isinstance(step, Morph):
            return _action(start, step, i, requirements, end)
        flight = straight_morph(start, end.hitch, requirements, step.duration)
        return _moving(flight, end.hitch, step, i, requirements)

    optimize, tension = (step.optimize, step.tension) if isinstance(step, Morph) else (False, None)
    phase = Phase(step.name, i, 0.0, 0.0, tension=tension)
    task = WayTask(start, end.hitch, requirements, phase, step.duration, optimize, optimiser)
    found = best_way(own, task)
    return Planned(found.motion, end.hitch, found.certificate)


def _follow(start: Hitch, step: FollowVertex, i: int, requirements: Requirements) -> Planned:
    end = end_of_action(_worded(start, step, requirements), step.legs, requirements)
    check_at_rest(end.hitch, requirements, _end_of(i, step))
    return Planned(_action(start, step, i, requirements, end), end.hitch)


def _transport(start: Hitch, step: Transport, i: int, requirements: Requirements) -> Planned:
    path = RigidPath(start, step.to, step.yaw)
    end = Hitch(
        start.team,
        outline_after(start.team, start.polygon, step),
        float(step.to[2]),
        start.q_legs,
    )
    check_at_rest(end, requirements, _end_of(i, step))
    if path.still:
        return Planned(_moving(None, end, step, i, requirements), end)
    check_loads(path, requirements.limits)
    flight = fly(path, requirements.limits, step.duration)
    return Planned(_moving(flight, end, step, i, requirements), end)


def _action(
    start: Hitch,
    step: MoveVertex | MoveEdge | Adjust | FollowVertex,
    i: int,
    requirements: Requirements,
    end: End,
) -> Motion:
    """Return the motion of an action of the paper to the hitch that it ends with."""
    action = _worded(start, step, requirements)
    found = fly_action(action, end.hitch, requirements, _given(step))
    remark = _remark(action, end, found, asked=step.legs is not None, requirements=requirements)
    return _moving(found.flight, end.hitch, step, i, requirements, remark)


def _worded(
    start: Hitch, step: MoveVertex | MoveEdge | Adjust | FollowVertex, requirements: Requirements
) -> Action:
    """Return the action that a step asks for."""
    if isinstance(step, Adjust):
        asked = shared_hitch(start.team, start.polygon, start.altitude, step.legs, requirements)
        return adjust(start, asked.q_legs)
    outline = outline_after(start.team, start.polygon, step)
    if isinstance(step, MoveEdge):
        return move_edge(start, outline, step.edge)
    if isinstance(step, FollowVertex):
        return follow_vertex(start, outline, step.vertex, step.path)
    return move_vertex(start, outline, step.vertex)


def _end(start: Hitch, step: ShapeStep, requirements: Requirements) -> End:
    if isinstance(step, Morph):
        return end_of_morph(start, step.polygon, step.legs, requirements)
    return end_of_action(_worded(start, step, requirements), step.legs, requirements)


def _given(step: MoveVertex | MoveEdge | Adjust | FollowVertex) -> float | None:
    return None if isinstance(step, FollowVertex) else step.duration


def _moving(
    flight: Flight | None,
    end: Hitch,
    step: ShapeStep | FollowVertex | Transport,
    i: int,
    requirements: Requirements,
    remark: str = "",
) -> Motion:
    """Return the motion of a flight, or of a rest where nothing moves."""
    phase = Phase(step.name, i, 0.0, 0.0 if flight is None else flight.duration, remark)
    if flight is None:
        return resting(end, requirements, step.duration or IDLE, phase)
    return flying(flight, end.team, requirements, [phase])


def _remark(
    action: Action, end: End, found: Flying, asked: bool, requirements: Requirements
) -> str:
    """Return which drones move that the paper does not name, and why."""
    parts = []
    if found.turning:
        parts.append(
            f"{_all_of(found.turning, 'turn')} as well: tensions differ, so legs turn with both "
            "edges at their vertex"
        )
    if found.sliding:
        reasons = ["legs are to change"] if asked else []
        reasons += [end.reason] if end.reason else []
        if found.worst is not None:
            path = action.path(end.hitch.q_legs)
            reasons.append(
                broken_on_the_way(path, found.worst, action.start.altitude, requirements)
            )
        parts.append(f"{_all_of(found.sliding, 'slide')} as well: {', and '.join(reasons)}")
    return "; ".join(parts)


def _all_of(names: tuple[str, ...], verb: str) -> str:
    """Return such as "r0 slides" or "q1, r0 slide"."""
    return f"{', '.join(names)} {verb}{'s' if len(names) == 1 else ''}"


def _end_of(i: int, step: HitchStep) -> str:
    return f"at the end of step {i} ({step.name})"
