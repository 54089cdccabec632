"""A hitch at rest: outline, legs and tensions determine every drone's place and force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch.cable_slack import balanced_legs, cable_slack, checked_legs, fitting_polygon
from hitchopt.hitch.leg_lengths import split_slack
from hitchopt.hitch.leg_task import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.statics import cable_forces, leg_directions
from hitchopt.hitch.team import Team
from hitchopt.requirements import Arena, Limits, Requirements, Separation
from hitchopt.values import coordinate

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hitch:
    """A hitch in a horizontal plane, in balance: closed, or an open chain.

    Parameters
    ----------
    team: its cables tie the hitch.
    polygon: its outline, ``p_0 … p_{n-1}`` of a closed hitch and ``p_0 … p_n`` of a chain, or the
        points (n, 2) or (n + 1, 2) [m].
    altitude: height of its plane [m].
    q_legs: (n,) [m], ``d_k``: from vertex k to drone q_k. The rest of cable k's slack is
        ``e_k = L_k - l_k - d_k``, from vertex k+1 to drone r_k. A chain leaves no choice at its
        ends: ``d_0 = 0`` and ``d_{n-1} = L_{n-1} - l_{n-1}``, to be given within 1e-4 of the cable.

    Raises
    ------
    InputError: a count that does not fit the team, or numbers that are not finite.
    InfeasibleError: an edge as long as its cable, a leg that is not positive, or one at a chain's
        end that is not the only one there is.
    """

    team: Team
    polygon: Outline
    altitude: float
    q_legs: Array

    def __init__(
        self, team: Team, polygon: Outline | ArrayLike, altitude: float, q_legs: ArrayLike
    ) -> None:
        outline = fitting_polygon(team, polygon)
        slack = cable_slack(team, outline)
        d = np.array(q_legs, dtype=np.float64)
        if d.shape != (team.robots,) or not np.all(np.isfinite(d)):
            raise InputError(
                "legs", q_legs, f"a list of {team.robots} finite lengths d_k", "give one per robot"
            )
        d = checked_legs(team, d, slack)
        d.setflags(write=False)
        object.__setattr__(self, "team", team)
        object.__setattr__(self, "polygon", outline)
        object.__setattr__(self, "altitude", coordinate("altitude", altitude))
        object.__setattr__(self, "q_legs", d)

    @classmethod
    def balanced(cls, team: Team, polygon: Outline | ArrayLike, altitude: float = 1.0) -> Hitch:
        """Return the hitch with ``d_k = e_k = (L_k - l_k)/2``, the paper's balanced configuration.

        At the ends of a chain, the cable's one leg takes all of its slack.

        Raises
        ------
        InputError, InfeasibleError: as the class.
        """
        outline = fitting_polygon(team, polygon)
        return cls(team, outline, altitude, balanced_legs(team, outline))

    @classmethod
    def spread(
        cls,
        team: Team,
        polygon: Outline | ArrayLike,
        altitude: float = 1.0,
        *,
        limits: Limits | None = None,
        separation: Separation | None = None,
    ) -> Hitch:
        """Return the hitch whose leg lengths keep drones well apart.

        They are nearest to balanced (least squares in ``d``) among those with separations and
        distances to cables of at least 1.5 times their limits and legs within theirs; where there
        are none, they have the largest such margin.

        Raises
        ------
        InputError, InfeasibleError: as the class.
        """
        outline = fitting_polygon(team, polygon)
        d = _nearest_legs(
            team,
            outline,
            balanced_legs(team, outline),
            SPREAD_MARGIN,
            Requirements(limits or Limits(), separation or Separation()),
        )
        return cls(team, outline, altitude, d)

    @classmethod
    def nearest(
        cls,
        team: Team,
        polygon: Outline | ArrayLike,
        altitude: float,
        fractions: ArrayLike,
        *,
        limits: Limits,
        separation: Separation,
        arena: Arena | None = None,
    ) -> Hitch:
        """Return the hitch within every limit whose slack split is nearest to ``fractions`` (n,).

        Where there is none, the one with the largest margin.

        Raises
        ------
        InputError, InfeasibleError: as the class.
        """
        outline = fitting_polygon(team, polygon)
        slack = cable_slack(team, outline)
        wanted = np.asarray(fractions, dtype=np.float64) * slack
        wanted = team.layout.q_legs_of(wanted, slack)
        d = _nearest_legs(
            team, outline, wanted, LIMIT_MARGIN, Requirements(limits, separation, arena)
        )
        return cls(team, outline, altitude, d)

    @property
    def slack(self) -> Array:
        """(n,) [m]: slack of cable k for its two legs, ``L_k - l_k``."""
        return self.team.cable_length - self.polygon.edge_lengths

    @property
    def legs(self) -> Array:
        """(n, 2) [m]: ``d_k`` and ``e_k``; zero where a chain's end has no leg."""
        return self.team.layout.legs_of(self.q_legs, self.slack)

    @property
    def fractions(self) -> Array:
        """(n,): slack split ``d_k / (d_k + e_k)``."""
        return self.q_legs / self.slack

    @property
    def vertices(self) -> Array:
        """(points, 3) [m]: n of a closed hitch, n + 1 of a chain."""
        return np.column_stack([self.polygon.vertices, np.full(len(self.polygon), self.altitude)])

    @property
    def leg_directions(self) -> Array:
        """(2n, 3): unit vectors from the vertex to the drone, in the order q0, r0, q1, ….

        Where a chain's end has no leg: along its edge, outward.
        """
        team = self.team
        q, r = leg_directions(self.polygon.edge_directions, team.tension, team.topology)
        level = np.stack([q, r], axis=1).reshape(-1, 2)
        return np.column_stack([level, np.zeros(len(level))])

    @property
    def drones(self) -> Array:
        """(2n, 3) [m]: ``q_k = p_k + d_k q̂_k`` and ``r_k = p_{k+1} + e_k r̂_k``."""
        anchors = self.vertices[self.team.layout.anchors]
        drones: Array = anchors + self.legs.reshape(-1, 1) * self.leg_directions
        return drones

    @property
    def cable_forces(self) -> Array:
        """(2n, 3) [N]: the force that the taut cable puts on each drone."""
        pulls, taut = np.repeat(self.team.tension, 2), np.ones(self.team.robots)
        return cable_forces(self.team, self.drones, self.vertices, pulls, taut)


def _nearest_legs(
    team: Team, polygon: Outline, reference: Array, margin: float, requirements: Requirements
) -> Array:
    task = LegTask(
        team,
        requirements,
        polygon.vertices[None],
        reference[None],
        requirements.limits.leg * LIMIT_MARGIN,
        margin,
    )
    q_legs: Array = split_slack(task).q_legs[0]
    return q_legs
