"""Indices of the points, edges, cables and drones of a closed hitch or an open chain.

Cable k spans edge k, from point ``starts[k]`` to point ``ends[k]``. In a closed hitch of n cables
edge n-1 leads back to point 0, and every point is a clasp with two legs. An open chain has n+1
points; q_0 stands on the first and r_{n-1} on the last of them, each at the end of its own edge,
and has no leg.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

Index = NDArray[np.intp]

CLOSED, OPEN = "closed", "open"


@dataclass(frozen=True, eq=False)
class Layout:
    """Indices into arrays of points, cables (or edges) and drones.

    Attributes
    ----------
    robots: number n of cables.
    points: number of points, n or n + 1.
    starts, ends: (n,), the points between which each edge runs.
    clasps: (c,), the points at which two cables bend around each other: all, or all inner ones.
    ahead, behind: (c,), the cables that meet there: that of the edge which starts there, and that
        of the edge which ends there.
    has_leg: (n, 2), whether q_k and r_k hang on a leg.
    anchors: (2n,), the point that each drone q0, r0, q1, … belongs to.
    pulled_to: (2n,), the point that its cable leads to from it: the same, or its edge's other end
        where there is no leg.
    stencil: (n, 4), the points k-1 … k+2 about each edge. Beyond an open chain's ends the edge's
        other end stands in: mirrored so, the model of a closed hitch holds with legs of no length.
    neighbours: (n, 3), the cables k-1 … k+1, likewise.
    """

    robots: int
    points: int
    starts: Index
    ends: Index
    clasps: Index
    ahead: Index
    behind: Index
    has_leg: NDArray[np.bool_]
    anchors: Index
    pulled_to: Index
    stencil: Index
    neighbours: Index

    @property
    def closed(self) -> bool:
        """Whether the last edge leads back to the first point."""
        return self.points == self.robots

    @property
    def around_clasps(self) -> Index:
        """(c, 3): the points k-1, k and k+1 about every clasp."""
        return np.column_stack([self.starts[self.behind], self.clasps, self.ends[self.ahead]])

    @cached_property
    def parts(self) -> Index:
        """(parts,): taut cable parts ``3 k + type``, type 0 a q-leg, 1 an edge, 2 an r-leg."""
        exists = np.insert(self.has_leg, 1, True, axis=1)
        return np.flatnonzero(exists)

    @cached_property
    def drones_with_legs(self) -> Index:
        """(legs,): the drones that hang on a leg, in order."""
        return np.flatnonzero(self.has_leg)

    def edges(self, points: Array, axis: int = -2) -> Array:
        """Return the edge vectors: points (…, points, d) to (…, n, d), along ``axis``."""
        return np.take(points, self.ends, axis) - np.take(points, self.starts, axis)

    def legs_of(self, q_legs: Array, slack: Array) -> Array:
        """Return both legs (…, n, 2) [m] of q-legs and slacks (…, n); exactly zero without leg."""
        legs: Array = np.where(self.has_leg, np.stack([q_legs, slack - q_legs], axis=-1), 0.0)
        return legs

    def q_legs_of(self, wanted: Array, slack: Array) -> Array:
        """Return the wanted q-legs (…, n) [m], or the only possible ones at a chain's ends."""
        with_r = np.where(self.has_leg[:, 0], wanted, 0.0)
        q_legs: Array = np.where(self.has_leg[:, 1], with_r, slack)
        return q_legs


@lru_cache(maxsize=64)
def layout_of(robots: int, topology: str) -> Layout:
    """Return the layout of ``robots`` cables, topology ``closed`` or ``open``."""
    k = np.arange(robots)
    has_leg = np.ones((robots, 2), dtype=np.bool_)
    if topology == CLOSED:
        points, following, clasps = robots, (k + 1) % robots, k
        stencil = (k[:, None] + np.arange(-1, 3)) % robots
        neighbours = (k[:, None] + np.arange(-1, 2)) % robots
    else:
        points, following, clasps = robots + 1, k + 1, k[1:]
        stencil = k[:, None] + np.arange(-1, 3)
        stencil[0, 0], stencil[-1, -1] = 1, robots - 1
        neighbours = np.clip(k[:, None] + np.arange(-1, 2), 0, robots - 1)
        has_leg[0, 0] = has_leg[-1, 1] = False
    own = np.column_stack([k, following])
    layout = Layout(
        robots=robots,
        points=points,
        starts=k,
        ends=following,
        clasps=clasps,
        ahead=clasps,
        behind=(clasps - 1) % robots,
        has_leg=has_leg,
        anchors=own.ravel(),
        pulled_to=np.where(has_leg, own, own[:, ::-1]).ravel(),
        stencil=stencil,
        neighbours=neighbours,
    )
    for value in vars(layout).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return layout
