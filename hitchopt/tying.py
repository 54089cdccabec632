"""The user's side of tying and untying: from drones on free cables to a hitch, and back.

As in ``hitchopt.actions``, all take ``limits``, ``separation`` and ``arena`` and raise
``InputError`` and ``InfeasibleError``. Names in a plan go by role: ``plan.motion.assignment`` says
which robot flies which.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.problem import DronesStart, Problem, SwapSettings
from hitchopt.mission.solving import solve_problem, solve_steps
from hitchopt.plan import Plan
from hitchopt.requirements import Arena, Limits, Requirements, Separation
from hitchopt.steps.form import Assign, Form
from hitchopt.steps.land import Land
from hitchopt.steps.release import Release
from hitchopt.steps.slack_split import slack_split


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
    team: who flies; robot k's drones start at ``q[k]`` and ``r[k]``.
    q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.
    polygon: the hitch's outline, (n, 2) [m], clockwise.
    altitude: of the hitch [m].
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m]; None for spread, with room at the cables
        where drones stand close to them.
    assign: ``auto``: which robot takes which edge is chosen, and which of its drones is q;
        ``fixed``: robot k takes edge k as it is.
    swap: how the drones turn about each other.
    limits, separation, arena: what is kept; defaults as in a problem file.
    duration: exactly that long [s]; None for as fast as the limits allow.

    Raises
    ------
    InputError: arguments that are wrong in themselves.
    InfeasibleError: it cannot be met; says what binds, where and when.
    """
    sharing = None if legs is None else slack_split(legs, team)
    outline = fitting_polygon(team, polygon)
    step = Form(outline, altitude, sharing, assign, swap or SwapSettings(), duration)
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

    The way back of ``form``, every q having gone up first.

    Parameters
    ----------
    start: the hitch at t = 0.
    limits, separation, arena, duration: as of form.

    Raises
    ------
    InputError, InfeasibleError: as form.
    """
    requirements = Requirements(limits or Limits(), separation or Separation(), arena)
    found = solve_steps(start, (Release(duration),), requirements)
    return Plan(found.motion, found.certificate)


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
