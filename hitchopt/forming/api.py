"""The Python interface of forming."""

from __future__ import annotations

from hitchopt.api import seconds_of, solve, step_errors, step_problem
from hitchopt.forming.steps import Assign, Form
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.mission.starts import DronesStart
from hitchopt.plan import Plan
from hitchopt.steps.keys import Legs, Polygon, SettleAtEnd
from hitchopt.values import Points, check_instance
from hitchopt.values.fields import suggest_keywords


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
    settle: SettleAtEnd = "auto",
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
    settle: duration of the over-travels that end the step where cables slid against friction, added
        to its duration [s]; auto: as far as limits allow; or false.
    duration: exact duration [s]; default: as fast as the limits allow.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    step = Form(
        polygon=polygon,
        altitude=altitude,
        legs=legs,
        assign=assign,
        swap=swap or SwapSettings(),
        settle=settle,
        duration=duration,
    )
    seconds = seconds_of(limit)
    start = DronesStart(q, r)
    check_instance("team", team, Team)
    problem = step_problem(team, start, step, limits, separation, arena)
    with step_errors(step):
        return solve(problem, limit=seconds)
