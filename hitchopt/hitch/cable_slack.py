"""Whether outlines and legs fit a team: counts, topology, and what edges leave of the cables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexArc, ConvexPolygon, Outline
from hitchopt.hitch.team import Team

Array = NDArray[np.float64]

FIXED_LEG = 1e-4
"""How far off a leg that leaves no choice may be given, relative to its cable's length: as much as
a plan's cable lengths may be off."""


def fitting_polygon(team: Team, polygon: Outline | ArrayLike) -> Outline:
    """Return ``polygon`` as an outline of the team's topology and count, or raise InputError."""
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
    """Return (n,) [m] ``L_k - l_k``, or raise InfeasibleError where an edge uses up its cable."""
    lengths = polygon.edge_lengths
    slack: Array = team.cable_length - lengths
    if np.min(slack) <= 0.0:
        worst = int(np.argmin(slack))
        raise InfeasibleError(
            [
                Violation(
                    "legs",
                    float(slack[worst]),
                    0.0,
                    "min",
                    "m",
                    (f"cable {worst}",),
                    "",
                    f"edge {worst} is {lengths[worst]:.6g} m long on a cable of "
                    f"{team.cable_length[worst]:.6g} m: shorten the edge or lengthen the cable",
                )
            ]
        )
    return slack


def balanced_legs(team: Team, polygon: Outline) -> Array:
    """Return (n,) [m] ``d_k`` of half the slack, at a chain's ends the only ones there are."""
    slack = cable_slack(team, polygon)
    return team.layout.q_legs_of(0.5 * slack, slack)


def checked_legs(team: Team, given: Array, slack: Array) -> Array:
    """Return the q-legs, exact at a chain's ends, or raise InfeasibleError."""
    d = team.layout.q_legs_of(given, slack)
    k = int(np.argmax(np.abs(given - d) / team.cable_length))
    if abs(given[k] - d[k]) > FIXED_LEG * team.cable_length[k]:
        end = int(team.layout.has_leg[k, 0])
        violation = Violation(
            "legs",
            float(given[k]),
            float(d[k]),
            "max" if given[k] > d[k] else "min",
            "m",
            (f"q{k}",),
            "",
            f"{'qr'[end]}{k} stands at the chain's end, without a leg: write d_{k} = {d[k]:.9g}",
        )
        raise InfeasibleError([violation])
    legs = np.where(team.layout.has_leg, np.column_stack([d, slack - d]), np.inf)
    k, end = (int(i) for i in np.unravel_index(int(np.argmin(legs)), legs.shape))
    if legs[k, end] <= 0.0:
        violation = Violation(
            "legs",
            float(legs[k, end]),
            0.0,
            "min",
            "m",
            (f"{'qr'[end]}{k}",),
            "",
            f"cable {k} leaves {slack[k]:.6g} m for both legs: keep d_{k} within it",
        )
        raise InfeasibleError([violation])
    return d
