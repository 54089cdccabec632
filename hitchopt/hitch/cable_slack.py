"""Checks of outlines and legs against a team: counts, topology, and the cables' slack."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexArc, ConvexPolygon, Outline
from hitchopt.hitch.cable_spans import cable_slack_of
from hitchopt.hitch.team import Team
from hitchopt.values import Array, instance

FIXED_LEG = 1e-4
"""Tolerance of a given leg that is not free, relative to its cable's length, as of cable lengths in
plans."""

SAGGING_LEG = 1e-2
"""The same where cables have weight: whoever gives the leg may have left out that edges sag."""


FAR_OFF = 100.0
"""Edge over cable beyond which one of the two is probably in another unit."""


def fitting_polygon(team: Team, polygon: Outline | ArrayLike) -> Outline:
    """Return ``polygon`` as an outline of the team's topology and count, or raise InputError."""
    instance("team", team, Team)
    closed, points = team.layout.closed, team.layout.points
    if not isinstance(polygon, Outline):
        polygon = ConvexPolygon(polygon) if closed else ConvexArc(polygon)
    if polygon.closed != closed:
        raise InputError(
            "polygon",
            polygon.vertices.tolist(),
            f"a {'ConvexPolygon' if closed else 'ConvexArc'}, the team being {team.topology}",
            "give its points as such, or change team.topology",
        )
    if len(polygon) != points:
        raise InputError(
            "polygon",
            f"{len(polygon)} points",
            f"a list of {points} points, {'one per robot' if closed else 'one more than robots'}",
            "add or remove points, or change team.robots",
        )
    return polygon


def cable_slack(team: Team, polygon: Outline) -> Array:
    """Return (n,) [m] ``L_k - l_k``, or raise InfeasibleError where an edge uses up its cable.

    The cable of an edge that sags is longer than the edge (``cable_spans``).
    """
    lengths = polygon.edge_lengths
    slack: Array = team.cable_length - lengths
    if team.cable_density > 0.0:
        slack = cable_slack_of(team, polygon.edge_directions * lengths[:, None])
    worst = int(slack.argmin())
    if slack[worst] <= 0.0:
        remedy = (
            f"edge {worst} is {lengths[worst]:.6g} m long on a cable of "
            f"{team.cable_length[worst]:.6g} m: shorten the edge or lengthen the cable"
        )
        if lengths[worst] > FAR_OFF * team.cable_length[worst]:
            remedy += f"; if millimetres were meant, {1e-3 * lengths[worst]:.3g} m"
        raise _refusal(slack[worst], 0.0, "min", f"cable {worst}", remedy)
    return slack


def balanced_legs(team: Team, polygon: Outline) -> Array:
    """Return ``d_k`` (n,) [m]: half of the slack, or the only possible leg at a chain's ends."""
    slack = cable_slack(team, polygon)
    return team.layout.q_legs_of(0.5 * slack, slack)


def checked_legs(team: Team, given: Array, slack: Array) -> Array:
    """Return the q-legs, exact at a chain's ends, or raise InfeasibleError."""
    d = team.layout.q_legs_of(given, slack)
    k = int((np.abs(given - d) / team.cable_length).argmax())
    tolerance = FIXED_LEG if team.cable_density == 0.0 else SAGGING_LEG
    if abs(given[k] - d[k]) > tolerance * team.cable_length[k]:
        end = int(team.layout.has_leg[k, 0])
        remedy = (
            f"{'qr'[end]}{k} stands at the chain's end, without a leg: write d_{k} = {d[k]:.9g}"
        )
        sense = "max" if given[k] > d[k] else "min"
        raise _refusal(given[k], d[k], sense, f"q{k}", remedy)
    legs = np.where(team.layout.has_leg, np.stack([d, slack - d], axis=1), np.inf)
    k, end = divmod(int(legs.argmin()), 2)
    if legs[k, end] <= 0.0:
        remedy = f"cable {k} leaves {slack[k]:.6g} m for both legs: keep d_{k} within it"
        raise _refusal(legs[k, end], 0.0, "min", f"{'qr'[end]}{k}", remedy)
    return d


def checked_roll(team: Team, given: ArrayLike) -> Array:
    """Return the roll of every clasp (clasps,) [rad], read-only, or raise InputError."""
    clasps = len(team.layout.clasps)
    try:
        each = np.asarray(given, dtype=np.float64)
        roll = np.array(np.broadcast_to(each, clasps)) if each.ndim else np.full(clasps, each)
    except (TypeError, ValueError):
        bound = f"one angle, or a list of {clasps} (one per clasp)"
        raise InputError("roll", given, bound, "give radians") from None
    if not np.all(np.abs(roll) < 0.5 * np.pi):  # nan too
        raise InputError("roll", given, "within ±π/2 rad", "give radians below a right angle")
    roll.setflags(write=False)
    return roll


def _refusal(value: float, limit: float, sense: str, where: str, remedy: str) -> InfeasibleError:
    """Return the error of a leg [m] beyond its limit."""
    violation = Violation("legs", float(value), float(limit), sense, "m", (where,), "", remedy)
    return InfeasibleError([violation])
