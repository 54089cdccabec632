"""One function for each kind of step: plans it alone and returns the certified plan.

All take ``limits``, ``separation`` and ``arena``, with the defaults of a problem file, and raise
``InputError`` for arguments that are wrong in themselves and ``InfeasibleError`` for what cannot be
met: it says what binds, where and when. ``legs`` is ``balanced``, ``spread`` or (n,) ``d_k`` [m];
or a mapping of that as ``sharing`` and of ``roll_deg``: ``auto``, one angle, or one per clasp.
Names in a plan that forms a hitch go by role: ``plan.motion.assignment`` says which robot flies
which.
"""

from __future__ import annotations

from typing import Unpack

from numpy.typing import ArrayLike

from hitchopt import steps
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.plan import Plan
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.single_step import Legs, Required, explicit, free_drones, moved, planned
from hitchopt.steps.form import Assign


@explicit
def morph(
    start: Hitch,
    polygon: Outline | ArrayLike,
    *,
    legs: Legs | None = None,
    duration: float | None = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
    **requirements: Unpack[Required],
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
    values = polygon, legs, duration, False, optimize, tension
    return moved(start, requirements, steps.Morph, *values)


@explicit
def move_vertex(
    start: Hitch,
    vertex: int,
    *,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    values = vertex, to, by, legs, duration
    return moved(start, requirements, steps.MoveVertex, *values)


@explicit
def move_edge(
    start: Hitch,
    edge: int,
    *,
    to: ArrayLike | None = None,
    by: ArrayLike | None = None,
    legs: Legs | None = None,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    return moved(start, requirements, steps.MoveEdge, edge, to, by, legs, duration)


@explicit
def adjust(
    start: Hitch,
    legs: Legs = "balanced",
    *,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    return moved(start, requirements, steps.Adjust, legs, duration)


@explicit
def follow_vertex(
    start: Hitch,
    vertex: int,
    path: ArrayLike,
    *,
    legs: Legs | None = None,
    **requirements: Unpack[Required],
) -> Plan:
    """Return the certified plan in which one vertex meets timed points at their times.

    Parameters
    ----------
    start: the hitch at t = 0.
    vertex: which, from 0.
    path: (J, 3), rows ``t, x, y`` [s, m, m], t increasing from 0 or later; at rest before the
        first and after the last, and between equal points that follow each other.
    legs, limits, separation, arena: as of move_vertex.

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    return moved(start, requirements, steps.FollowVertex, vertex, path, legs)


@explicit
def transport(
    start: Hitch,
    to: ArrayLike,
    yaw: float = 0.0,
    *,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    return moved(start, requirements, steps.Transport, to, yaw, duration)


@explicit
def hold(start: Hitch, seconds: float, **requirements: Unpack[Required]) -> Plan:
    """Return the certified plan in which a hitch stays as it is for ``seconds`` [s].

    Raises
    ------
    InputError, InfeasibleError: as morph.
    """
    return moved(start, requirements, steps.Hold, seconds)


@explicit
def form(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    polygon: Outline | ArrayLike,
    altitude: float = 1.0,
    *,
    legs: Legs | None = None,
    assign: Assign = "auto",
    swap: SwapSettings | None = None,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    swap = SwapSettings() if swap is None else swap
    values = polygon, altitude, legs, assign, swap, duration
    return planned(team, free_drones(q, r), requirements, steps.Form, *values)


@explicit
def release(
    start: Hitch, *, duration: float | None = None, **requirements: Unpack[Required]
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
    return moved(start, requirements, steps.Release, duration)


@explicit
def land(
    team: Team,
    q: ArrayLike,
    r: ArrayLike,
    *,
    duration: float | None = None,
    **requirements: Unpack[Required],
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
    return planned(team, free_drones(q, r), requirements, steps.Land, duration)
