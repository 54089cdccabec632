"""Functions that plan a single step, such as ``morph`` and ``form``.

They take the arguments of the step's record, and the requirements of the plan. Steps that need an
object or an open vertex are steps of a ``Mission`` only.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import ArrayLike

from hitchopt.api import Legs, Polygon, SettleTime, new_step, solve
from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.mission.problem import DronesStart, Problem, Start
from hitchopt.plan import Plan
from hitchopt.planners.forming import SwapSettings
from hitchopt.steps.moving import (
    Adjust,
    FollowVertex,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    Settle,
    Transport,
)
from hitchopt.steps.step import Step
from hitchopt.steps.tying import Assign, Form, Land, OpenVertex, Release
from hitchopt.values import Points, check_instance, positive
from hitchopt.values.fields import suggest_keywords


@suggest_keywords
def morph(
    start: Hitch,
    polygon: Polygon,
    legs: Legs | None = None,
    duration: float | None = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
    settle: SettleTime = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
    cost: CostFunction | None = None,
) -> Plan:
    """Return the certified plan of a change of the polygon: every vertex moves to its goal.

    Parameters
    ----------
    start: the hitch at t = 0.
    polygon: vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one
        more of the convex arc of an open chain.
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end.
    duration: exact duration [s]; default: as fast as the limits allow.
    optimize: search for a faster route even if the straight one is feasible; by default only if
        that takes more than 1.3 times its lower bound.
    tension: range of tensions during the step [N].
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.
    cost: a function of shapes in casadi, to be minimised together with the duration: its integral
        over s counts as seconds. It takes outputs of ``model`` at rest by name (``positions``,
        ``thrusts``, ``tilt_cosines``, ``legs``, ``exterior_angles``, ``separations``), the inputs
        ``vertices``, ``q_legs`` and ``tensions``, and s. The optimiser then always runs.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(
        Morph,
        polygon=polygon,
        legs=legs,
        duration=duration,
        optimize=optimize,
        tension=tension,
        settle=settle,
        cost=cost,
    )
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def hold(
    start: Hitch,
    seconds: float,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of keeping everything at rest.

    Parameters
    ----------
    start: the hitch at t = 0.
    seconds: duration [s].
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Hold, seconds=seconds)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def move_vertex(
    start: Hitch,
    vertex: int,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
    settle: SettleTime = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of moving one vertex.

    Only four drones move, those whose legs continue the two edges of the vertex; where a limit
    binds, further drones slide along their cables as well.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: index, from 0.
    to: goal [x, y] [m].
    by: displacement [dx, dy] [m], instead of to.
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end.
    duration: exact duration [s]; default: as fast as the limits allow.
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(
        MoveVertex, vertex=vertex, to=to, by=by, legs=legs, duration=duration, settle=settle
    )
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def move_edge(
    start: Hitch,
    edge: int,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
    settle: SettleTime = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of moving both ends of one edge.

    Edge k runs from vertex k to vertex k + 1. Four drones move, or six where edges turn.

    Parameters
    ----------
    start: the hitch at t = 0.
    edge: index, from 0.
    to: goals of its ends, [[x, y], [x, y]] [m], its first vertex first.
    by: displacement [dx, dy] [m], instead of to.
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end.
    duration: exact duration [s]; default: as fast as the limits allow.
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(MoveEdge, edge=edge, to=to, by=by, legs=legs, duration=duration, settle=settle)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def adjust(
    start: Hitch,
    legs: Legs = "balanced",
    duration: float | None = None,
    settle: SettleTime = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of sliding cables through their clasps; the outline stays.

    Parameters
    ----------
    start: the hitch at t = 0.
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg.
    duration: exact duration [s]; default: as fast as the limits allow.
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Adjust, legs=legs, duration=duration, settle=settle)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def follow_vertex(
    start: Hitch,
    vertex: int,
    path: Points,
    legs: Legs | None = None,
    speed: float | None = None,
    settle: SettleTime = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of moving one vertex through points, at rest before and after.

    It meets timed points at their times. With a speed, points need no times: it moves at this speed
    on a smooth path through them. It stops where the path turns by more than 90°, and slows down
    where a drone's limit binds.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: index, from 0.
    path: points [t, x, y] [s, m, m], t from the step's start, increasing; the vertex rests between
        equal consecutive points; with a speed also points [x, y].
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end.
    speed: largest speed of the vertex on its path through points [x, y] [m/s];
        None: limits.vertex_speed.
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(FollowVertex, vertex=vertex, path=path, legs=legs, speed=speed, settle=settle)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def transport(
    start: Hitch,
    to: ArrayLike,
    yaw: float = 0.0,
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of moving the hitch and turning it about its centroid.

    Parameters
    ----------
    start: the hitch at t = 0.
    to: goal [x, y, z] of its centroid [m].
    yaw: rotation, counter-clockwise [rad].
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Transport, to=to, yaw=yaw, duration=duration)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def form(
    team: Team,
    q: Points,
    r: Points,
    polygon: Polygon,
    altitude: float = 1.0,
    legs: Legs | None = None,
    assign: Assign = "auto",
    swap: SwapSettings | None = None,
    settle: SettleTime = "auto",
    by: Literal["swaps", "laying"] = "swaps",
    order: ArrayLike | Literal["auto"] = "auto",
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of tying a hitch from drones with hanging cables.

    Without ``legs`` they are spread, with a margin to the cables where drones are close to them.

    Parameters
    ----------
    team: the robots; the drones of robot k start at ``q[k]`` and ``r[k]``.
    q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.
    polygon: vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one
        more of the convex arc of an open chain.
    altitude: height of the hitch's plane [m].
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end; spread without it.
    assign: auto: choose which robot takes which edge, and which end is its q; fixed: in order.
    swap: how drones turn in pairs.
    settle: duration of the swings that end the step where cables slid against friction, added to
        its duration [s]; auto: as far as limits allow; or false.
    by: swaps: pairs of drones swap positions; laying: taut cables are laid on one another, and
        every pair rolls by half a turn.
    order: order of laying, robots from bottom to top; auto: alternating levels.
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(
        Form,
        polygon=polygon,
        altitude=altitude,
        legs=legs,
        assign=assign,
        swap=swap or SwapSettings(),
        settle=settle,
        by=by,
        order=order,
        duration=duration,
    )
    required = Required(limits, separation, arena, limit)
    return _plan_from_drones(team, q, r, step, required)


@suggest_keywords
def settle(
    start: Hitch,
    seconds: float | Literal["auto"] = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of swings that remove friction hysteresis at the clasps.

    Drones swing about their positions with decreasing amplitude; planned vertices do not move.

    Parameters
    ----------
    start: the hitch at t = 0.
    seconds: duration [s]; auto: four swings, slower where limits require it.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Settle, seconds=seconds)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def open_vertex(
    start: Hitch,
    vertex: int,
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of rolling a vertex's pair until both its cables run straight.

    The rest is a chain on the same lines, with all other vertices intact.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: index, from 0.
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(OpenVertex, vertex=vertex, duration=duration)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def release(
    start: Hitch,
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of untying the hitch in the reverse order of tying.

    Parameters
    ----------
    start: the hitch at t = 0.
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Release, duration=duration)
    required = Required(limits, separation, arena, limit)
    return _plan_from_hitch(start, step, required)


@suggest_keywords
def land(
    team: Team,
    q: Points,
    r: Points,
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of descending straight to the ground.

    Parameters
    ----------
    team: the robots; the drones of robot k start at ``q[k]`` and ``r[k]``.
    q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = new_step(Land, duration=duration)
    required = Required(limits, separation, arena, limit)
    return _plan_from_drones(team, q, r, step, required)


@dataclass(frozen=True)
class Required:
    """Requirements of a single step; None stands for the defaults of a problem file."""

    limits: Limits | None
    separation: Separation | None
    arena: Arena | None
    limit: float | None  # [s], of the time for planning

    def __post_init__(self) -> None:
        if self.limit is not None:
            positive("limit", self.limit)


def problem_from_hitch(start: Hitch, step: Step, required: Required) -> Problem:
    """Return the problem of a step from a hitch; errors name its arguments as a function's."""
    check_instance("start", start, Hitch)
    resolved = step.resolved_for(start.team)  # invalid arguments are reported first
    resolved.checked_polygon_after(start.team, start.polygon)
    return _problem_of_step(start.team, start, resolved, required)


def _plan_from_hitch(start: Hitch, step: Step, required: Required) -> Plan:
    """Return the certified plan of a step from a hitch."""
    problem = problem_from_hitch(start, step, required)
    with step_errors(step):
        return solve(problem, limit=required.limit)


def _plan_from_drones(team: Team, q: Any, r: Any, step: Step, required: Required) -> Plan:
    """Return the certified plan of a step from drones at rest."""
    start = DronesStart(q, r)
    check_instance("team", team, Team)
    resolved = step.resolved_for(team)  # invalid arguments are reported first
    resolved.checked_polygon_after(team, None)
    problem = _problem_of_step(team, start, resolved, required)
    with step_errors(step):
        return solve(problem, limit=required.limit)


def _problem_of_step(team: Team, start: Start, step: Step, required: Required) -> Problem:
    """Return the problem of one step; errors name its arguments as a function's."""
    requirements: dict[str, Any] = {
        "limits": required.limits,
        "separation": required.separation,
        "arena": required.arena,
    }
    given = {name: value for name, value in requirements.items() if value is not None}
    with step_errors(step):
        return Problem(team, start, (step,), **given)


@contextmanager
def step_errors(step: Step) -> Iterator[None]:
    """Name the arguments in errors of a step as those of a function."""
    try:
        yield
    except InputError as error:
        nested = rf"^(start\.drones|mission\[0\]\.{step.name})\b\.?"
        raise error.renamed(lambda key: re.sub(nested, "", key) or step.name) from None
