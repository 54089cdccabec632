"""One function for each kind of step: plans it alone and returns the certified plan.

All take ``limits``, ``separation`` and ``arena``, with the defaults of a problem file, and raise
``InputError`` for arguments that are wrong in themselves and ``InfeasibleError`` for what cannot be
met: it says what binds, where and when. ``legs`` is ``balanced``, ``spread`` or (n,) ``d_k`` [m].
Names in a plan that forms a hitch go by role: ``plan.motion.assignment`` says which robot flies
which.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.problem import DronesStart, Problem
from hitchopt.mission.solving import solve_problem, solve_steps
from hitchopt.plan import Plan
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.requirements import Arena, Limits, Requirements, Separation
from hitchopt.steps import (
    Adjust,
    FollowVertex,
    Form,
    Hold,
    Land,
    Morph,
    MoveEdge,
    MoveVertex,
    Release,
    Step,
    Transport,
)
from hitchopt.steps.form import Assign
from hitchopt.steps.slack_split import SlackSplit, slack_split

Legs = str | Sequence[float] | ArrayLike


def morph(
    start: Hitch,
    polygon: Outline | ArrayLike,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
) -> Plan:
    """Return the certified plan from one hitch to another.

    Vertices go straight where that keeps all limits; where it does not, an optimised route is
    looked for.

    Parameters
    ----------
    start: the hitch at t = 0.
    polygon: the outline at the end, (n, 2) [m], clockwise.
    limits, separation, arena: what the plan must satisfy; defaults as in a problem file.
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for those with fractions nearest to the
        start's.
    duration: exactly that long [s]; None for as fast as the limits allow.
    optimize: look for a faster route even where the straight one satisfies all limits.
    tension: smallest and largest [N] where tensions may change meanwhile.

    Raises
    ------
    InputError: arguments that are wrong in themselves.
    InfeasibleError: it cannot be met; says what binds, where and when.
    """
    outline = fitting_polygon(start.team, polygon)
    step = Morph(outline, _split(legs, start.team), duration, optimize=optimize, tension=tension)
    return _planned(start, step, limits, separation, arena)


def move_vertex(
    start: Hitch,
    vertex: int,
    *,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan in which one vertex goes elsewhere.

    Only the four drones move that the paper names, unless a limit binds; the phase's remark then
    says which others do, and why.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: which, from 0.
    to, by: its new place, or by how much it goes (2,) [m]; exactly one of them.
    legs: at the end; None for the paper's, or the nearest to those within the limits.
    limits, separation, arena, duration: as of morph.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    step = MoveVertex(vertex, _array(to), _array(by), _split(legs, start.team), duration)
    return _planned(start, step, limits, separation, arena)


def move_edge(
    start: Hitch,
    edge: int,
    *,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan in which both ends of an edge go elsewhere.

    Four drones move where the ends slide along their neighbours' lines, else six, unless a limit
    binds; the phase's remark then says which others do, and why.

    Parameters
    ----------
    start: the hitch at t = 0.
    edge: which, from 0; edge k runs from vertex k to vertex k + 1.
    to, by: the new places of its ends (2, 2), or by how much both go (2,) [m]; exactly one of them.
    legs, limits, separation, arena, duration: as of move_vertex.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    step = MoveEdge(edge, _array(to), _array(by), _split(legs, start.team), duration)
    return _planned(start, step, limits, separation, arena)


def adjust(
    start: Hitch,
    legs: Legs = "balanced",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan in which cables slide through their clasps and vertices stay.

    Parameters
    ----------
    start: the hitch at t = 0.
    legs: at the end.
    limits, separation, arena, duration: as of morph.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    step = Adjust(slack_split(legs, start.team), duration)
    return _planned(start, step, limits, separation, arena)


def follow_vertex(
    start: Hitch,
    vertex: int,
    path: ArrayLike,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    legs: Legs | None = None,
) -> Plan:
    """Return the certified plan in which one vertex meets timed points at their times.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: which, from 0.
    path: (J, 3), rows ``t, x, y`` [s, m, m], t increasing from 0 or later; at rest before the
        first and after the last, and between equal points in a row.
    legs, limits, separation, arena: as of move_vertex.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    step = FollowVertex(vertex, np.array(path), _split(legs, start.team))
    return _planned(start, step, limits, separation, arena)


def transport(
    start: Hitch,
    to: ArrayLike,
    yaw: float = 0.0,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan in which the whole hitch is carried and turned, rigidly.

    Parameters
    ----------
    start: the hitch at t = 0.
    to: (3,) [m], where the centroid of its outline goes.
    yaw: by how much it turns about that, counter-clockwise [rad]; more than a turn is one.
    limits, separation, arena, duration: as of morph.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    step = Transport(np.array(to), yaw, duration)
    return _planned(start, step, limits, separation, arena)


def hold(
    start: Hitch,
    seconds: float,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
) -> Plan:
    """Return the certified plan in which a hitch stays as it is for ``seconds`` [s].

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    return _planned(start, Hold(seconds), limits, separation, arena)


def form(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    polygon: Outline | ArrayLike,
    altitude: float = 1.0,
    *,
    legs: str | ArrayLike | None = None,
    assign: Assign = "auto",
    swap: SwapSettings | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan that ties a hitch of drones on free cables.

    Parameters
    ----------
    team: the team; robot k's drones start at ``q[k]`` and ``r[k]``.
    q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.
    polygon: the hitch's outline, (n, 2) [m], clockwise.
    altitude: of the hitch [m].
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for spread, with a margin to the cables
        where drones stand close to them.
    assign: ``auto``: which robot takes which edge is chosen, and which of its drones is q;
        ``fixed``: robot k takes edge k as it is.
    swap: how the drones turn about each other.
    limits, separation, arena: what the plan must satisfy; defaults as in a problem file.
    duration: exactly that long [s]; None for as fast as the limits allow.

    Raises
    ------
    InputError: arguments that are wrong in themselves.
    InfeasibleError: it cannot be met; says what binds, where and when.
    """
    outline = fitting_polygon(team, polygon)
    step = Form(outline, altitude, _split(legs, team), assign, swap or SwapSettings(), duration)
    return _from_drones(team, q, r, step, limits, separation, arena)


def release(
    start: Hitch,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan that unties a hitch, until its cables hang free.

    It reverses ``form``, in which every q has gone up first.

    Parameters
    ----------
    start: the hitch at t = 0.
    limits, separation, arena, duration: as of form.

    Raises
    ------
    InputError, InfeasibleError: as form.
    """
    return _planned(start, Release(duration), limits, separation, arena)


def land(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Plan:
    """Return the certified plan in which drones on free cables go straight down to the ground.

    The ground is the arena's floor, or z = 0 where there is none.

    Parameters
    ----------
    team, q, r, limits, separation, arena, duration: as of form.

    Raises
    ------
    InputError, InfeasibleError: as form.
    """
    return _from_drones(team, q, r, Land(duration), limits, separation, arena)


def _array(value: ArrayLike | None) -> np.ndarray | None:
    return None if value is None else np.array(value)


def _split(legs: Legs | None, team: Team) -> SlackSplit | None:
    return None if legs is None else slack_split(legs, team)


def _planned(
    start: Hitch,
    step: Step,
    limits: Limits | None,
    separation: Separation | None,
    arena: Arena | None,
) -> Plan:
    step.polygon_left(start.team, start.polygon)  # what is wrong in itself is said first
    requirements = Requirements(limits or Limits(), separation or Separation(), arena)
    found = solve_steps(start, (step,), requirements)
    return Plan(found.motion, found.certificate)


def _from_drones(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    step: Form | Land,
    limits: Limits | None,
    separation: Separation | None,
    arena: Arena | None,
) -> Plan:
    start = DronesStart(np.asarray(q, dtype=object), np.asarray(r, dtype=object))  # checked there
    problem = Problem(team, start, (step,), limits or Limits(), separation or Separation(), arena)
    found = solve_problem(problem)
    return Plan(found.motion, found.certificate)
