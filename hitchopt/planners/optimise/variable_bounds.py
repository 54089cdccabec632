"""What a way has to keep, how far a step may take it, and the box of its variables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import GRAVITY, Team
from hitchopt.planners.optimise.variables import Layout
from hitchopt.requirements import Requirements

Array = NDArray[np.float64]

INSET = 5e-3
"""[m] From walls and shortest legs, for what the spline does between knots."""

TENSION_INSET = 0.02
"""Of a range of tensions, kept free at both its ends for what the spline does between knots."""

STATIC_SHARE = 0.97
"""Of thrust and tilt that holding the hitch at rest may take, so that it can still be moved."""

RAMP = 2.0
"""Knots in which the margin rises from what an end has: a step there would bend the way."""


@dataclass(frozen=True)
class Step:
    """One step of the optimiser, from a way to a better one.

    Attributes
    ----------
    stride: [m], how far a coordinate of a vertex or drone may go.
    parts: into how many parts a step between knots is divided, at whose ends distances are kept as
        well; 1 for at the knots alone.
    fastest: minimise the time, not the energy.
    """

    stride: float
    parts: int = 1
    fastest: bool = False

    @property
    def reach(self) -> float:
        """[m] Pairs farther apart than their limit and this cannot come near in such a step."""
        return 2.0 * math.sqrt(2.0) * self.stride + 0.02


@dataclass(frozen=True, eq=False)
class Bounds:
    """What a way has to keep.

    Attributes
    ----------
    requirements: of the problem.
    tension: smallest and largest [N] where tensions are free, or None.
    margin: how many times their limits distances are kept at the knots.
    end_margins: how many times their limits they are kept by the first and the last hitch.
    """

    requirements: Requirements
    tension: tuple[float, float] | None
    margin: float
    end_margins: tuple[float, float]

    def margins(self, steps: int, places: Array) -> Array:
        """Return (K,): the margin at places (K,) of a way, in steps from its start.

        Near an end it is at most what that end has.
        """
        first, last = (min(m, self.margin) for m in self.end_margins)
        out, back = (np.minimum(a / RAMP, 1.0) for a in (places, steps - places))
        margins: Array = np.minimum(
            first + out * (self.margin - first), last + back * (self.margin - last)
        )
        return margins


def variable_box(
    layout: Layout, team: Team, bounds: Bounds, table: Array, stride: float
) -> tuple[Array, Array]:
    """Return bounds of the variables: legs, walls, a stride, tensions that hold at rest.

    Parameters
    ----------
    layout, team, bounds: of the way.
    table: (knots, size), the way around which the box is.
    stride: [m], how far a coordinate of a vertex or drone may go.
    """
    margins, table = bounds.margins(len(table) - 1, np.arange(1.0, len(table) - 1.0)), table[1:-1]
    inner = len(table)
    lower = np.full(layout.size, -np.inf)
    upper = np.full(layout.size, np.inf)
    if bounds.requirements.arena is not None:
        lower[layout.drones] = bounds.requirements.arena.lower[:2] + INSET
        upper[layout.drones] = bounds.requirements.arena.upper[:2] - INSET
    if bounds.tension is None:
        lower[layout.tensions] = upper[layout.tensions] = team.tension
    else:
        least, most = bounds.tension
        inset = TENSION_INSET * (most - least)
        lower[layout.tensions] = least + inset
        upper[layout.tensions] = np.minimum(most - inset, _static_tension(team, bounds))
        upper = np.maximum(lower, upper)
    lower, upper = np.tile(lower, (inner, 1)), np.tile(upper, (inner, 1))
    rise = (margins - 1.0) / max(bounds.margin - 1.0, 1e-9)
    legs = bounds.requirements.limits.leg + INSET * np.clip(rise, 0.0, 1.0)
    lower[:, layout.q_legs] = lower[:, layout.r_legs] = legs[:, None]
    places = layout.nodes.ravel()
    lower[:, places] = np.maximum(lower[:, places], table[:, places] - stride)
    upper[:, places] = np.minimum(upper[:, places], table[:, places] + stride)
    # A guess may stand outside the arena: then the walls are what it is pulled towards.
    return np.minimum(lower, upper).ravel(), np.maximum(lower, upper).ravel()


def _static_tension(team: Team, bounds: Bounds) -> Array:
    """Return (n,) [N]: the largest pull against which both drones of each robot can hover."""
    lift = team.mass * GRAVITY + team.cable_weight
    by_thrust = np.sqrt(np.maximum((STATIC_SHARE * team.max_thrust) ** 2 - lift**2, 0.0))
    by_tilt = lift * math.tan(STATIC_SHARE * bounds.requirements.limits.tilt)
    largest: Array = np.min(np.minimum(by_thrust, by_tilt).reshape(-1, 2), axis=1)
    return largest
