"""What a search for a path must satisfy, how far a step may go, and the bounds of its variables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hitchopt.hitch import GRAVITY, Team
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements
from hitchopt.values import Array

INSET = 5e-3
"""[m] Distance from walls and shortest legs, for what the spline does between knots."""

TENSION_INSET = 0.02
"""Share of a range of tensions that stays free at both its ends, for the same reason."""

STATIC_SHARE = 0.97
"""Share of thrust and tilt that holding the hitch at rest may take; the rest moves it."""

RAMP = 2.0
"""Number of knots in which the margin rises from that of an end: a jump would bend the path."""

SMALL = 3000
"""Number of a program's rows that do not count towards a search's work: n = 6 or so, or 20 at the
knots alone."""

WORK = 2.5e5
"""Rows that count times iterations of IPOPT, for all programs of a search: some 4 s of large ones.
To turn a regular 100-gon takes 1.8e5."""

ASKED_SHARE = 5.0
"""Factor on it where the problem asks for an optimised route."""

FEW_SHARE, FEW = 8.0, 36
"""Factor on it for 12 robots and fewer, and from how many on there is none: between them it falls
with the square of their number. Hard morphs of 12 robots take up to 1.5e6, in some 30 s."""

FEWEST_ITERATIONS = 3
"""Least number of iterations that is worth building a program for."""

Judge = Callable[[ShapePath], Flight | None]
"""Flies a path and verifies all of the time: the flight if it satisfies every limit, else None."""


@dataclass(frozen=True)
class SolverStep:
    """One step of the optimiser, from a path to a better one.

    Attributes
    ----------
    stride: [m], how far a coordinate of a vertex or drone may go.
    parts: number of parts of a step between knots at whose ends distances are enforced as well; 1
        for at the knots alone.
    fastest: minimise the time, not the energy.
    multipliers: estimate those of the rows before the first iteration, which takes as long as one;
        else they start at zero, as suits a start where few rows bind.
    near: share of its stride that the step is expected to go: pairs that are farther apart than
        they can come in that get no row.
    """

    stride: float
    parts: int = 1
    fastest: bool = False
    multipliers: bool = True
    near: float = 1.0

    @property
    def reach(self) -> float:
        """[m] Pairs farther apart than their limit and this cannot come near in such a step."""
        return 2.0 * math.sqrt(2.0) * self.near * self.stride + 0.02


def work_for(robots: int, *, asked: bool) -> float:
    """Return how much work a search for so many robots may do."""
    few = min(FEW_SHARE, (FEW / robots) ** 2)
    return WORK * max(few, ASKED_SHARE if asked else 1.0)


@dataclass
class Effort:
    """How much work a search may still do, so that large teams without a route say so soon.

    Attributes
    ----------
    left: rows beyond SMALL times iterations of programs.
    """

    left: float = WORK

    @property
    def over(self) -> bool:
        """Whether no large program can be begun any more."""
        return self.left < FEWEST_ITERATIONS * SMALL

    def iterations(self, rows: int, most: int) -> int:
        """Return after how many iterations, at most ``most``, a program is given up; 0: at once."""
        if rows <= SMALL:
            return most
        allowed = int(self.left // (rows - SMALL))
        if allowed < FEWEST_ITERATIONS:
            self.left = 0.0  # others of the search are as large
            return 0
        return min(most, allowed)

    def spend(self, rows: int, iterations: int) -> None:
        """Take what a program has done off what is left."""
        self.left -= float(max(0, rows - SMALL) * iterations)


@dataclass(frozen=True, eq=False)
class Search:
    """What every path of one search must satisfy.

    Attributes
    ----------
    requirements: of the problem.
    judge: decides about every path.
    tension: smallest and largest [N] where tensions may change on the path, or None.
    end_margins: how many times their limits the first and last hitch exceed their distances.
    margin: how many times their limits distances are enforced at the knots.
    effort: of all its programs together.
    """

    requirements: Requirements
    judge: Judge
    tension: tuple[float, float] | None
    end_margins: tuple[float, float]
    margin: float = 1.02
    effort: Effort = field(default_factory=Effort)

    def margins(self, steps: int, places: Array) -> Array:
        """Return (K,): the margin at places (K,) of a path, in steps from its start.

        Near an end it is at most that of the end.
        """
        first, last = (min(m, self.margin) for m in self.end_margins)
        out, back = (np.minimum(a / RAMP, 1.0) for a in (places, steps - places))
        return np.minimum(first + out * (self.margin - first), last + back * (self.margin - last))


def variable_bounds(path: KnotPath, search: Search, stride: float) -> tuple[Array, Array]:
    """Return bounds of the inner knots' variables: legs, walls, a stride, static tensions.

    Parameters
    ----------
    path, search: around which the bounds are, and what it must satisfy.
    stride: [m], how far a coordinate of a vertex or drone may go.
    """
    columns, table, team = path.columns, path.table[1:-1], path.team
    margins = search.margins(path.steps, np.arange(1.0, path.steps))
    arena, limits = search.requirements.arena, search.requirements.limits
    lower = np.full(table.shape, -np.inf)
    upper = np.full(table.shape, np.inf)
    if arena is not None:
        lower[:, columns.drones] = arena.lower[:2] + INSET
        upper[:, columns.drones] = arena.upper[:2] - INSET
    if search.tension is None:
        lower[:, columns.tensions] = upper[:, columns.tensions] = team.tension
    else:
        least, most = search.tension
        inset = TENSION_INSET * (most - least)
        static = static_tension(team, limits.tilt)
        lower[:, columns.tensions] = least + inset
        upper[:, columns.tensions] = np.maximum(least + inset, np.minimum(most - inset, static))
    rise = (margins - 1.0) / max(search.margin - 1.0, 1e-9)
    legs = limits.leg + INSET * np.clip(rise, 0.0, 1.0)
    lower[:, columns.q_legs] = lower[:, columns.r_legs] = legs[:, None]
    nodes = columns.nodes
    lower[:, nodes] = np.maximum(lower[:, nodes], table[:, nodes] - stride)
    upper[:, nodes] = np.minimum(upper[:, nodes], table[:, nodes] + stride)
    # A guess may stand outside the arena: then the walls are what it is pulled towards.
    return np.minimum(lower, upper).ravel(), np.maximum(lower, upper).ravel()


def static_tension(team: Team, tilt: float) -> Array:
    """Return (n,) [N]: the largest pull against which both drones of each robot can hover.

    Legs that are level count, with half of the cable's weight.
    """
    lift = team.mass * GRAVITY + team.cable_weight
    by_thrust = np.sqrt(np.maximum((STATIC_SHARE * team.max_thrust) ** 2 - lift**2, 0.0))
    by_tilt = lift * math.tan(STATIC_SHARE * tilt)
    largest: Array = np.min(np.minimum(by_thrust, by_tilt).reshape(-1, 2), axis=1)
    return largest
