"""Edges and legs at a clasp as series of arrays or of casadi's expressions, by the law of forces.

A clasp ``p_k`` depends on ``p_{k-1} … p_{k+1}`` and on cables k-1 and k only. Legs are lengths of
cable; the distances of the drones from their vertices are less where it sags.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hitchopt.hitch.forces import chord_pull, closed_triangle, shortening
from hitchopt.hitch.series import Series
from hitchopt.values import Indices


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge of a hitch.

    Attributes
    ----------
    along, cable: its direction, and the length of its cable [m].
    pull, tension: along its chord, and of its cable [N].
    sag: factor of ``forces.cable_of`` for its cable [1/m²]; None without weight.
    """

    along: Series
    cable: Series
    pull: Series
    tension: Series
    sag: Any

    @classmethod
    def of(cls, vector: Series, tension: Series, weight: Any) -> Edge:
        """Return an edge, of cables with a weight per length [N/m]; None for none."""
        size = vector.dot(vector).root
        along = vector / size
        if weight is None:
            return cls(along, size, tension, tension, None)
        sag = tension.constant(weight * weight / 24.0) / (tension * tension)
        level = vector.row(0, 1)
        cable = size + size * sag * level.dot(level)
        pull = chord_pull(tension, cable * (0.5 * weight))
        return cls(along, cable, pull, tension, sag)

    def taken(self, index: Indices) -> Edge:
        """Return some of many edges."""
        parts: dict[str, Any] = vars(self)
        return Edge(**{name: part and part.taken(index) for name, part in parts.items()})


@dataclass(frozen=True, eq=False)
class Clasp:
    """Both legs at clasp k, that of r_{k-1} first: directions, and distances of the drones [m].

    ``r_cable`` is the length of cable of r_{k-1}'s leg [m].
    """

    directions: tuple[Series, Series]
    legs: tuple[Series, Series]
    r_cable: Series

    @classmethod
    def of(
        cls,
        edges: tuple[Edge, Edge],
        q_legs: tuple[Series, Series],
        cable_length: Any,
        load: Any,
        weight: Any,
        roll: Series | None,
        *,
        alike: bool = False,
    ) -> Clasp:
        """Return the legs at ``p_k``.

        Parameters
        ----------
        edges, q_legs: of cables k-1 and k.
        cable_length: of cable k-1 [m].
        load, weight, roll: outside force on the clasp [N], of cables per length [N/m], [rad]; each
            None for none.
        alike: whether all tensions are equal: legs then go on along the neighbouring edges, where
            nothing else is to be carried.
        """
        behind, ahead = edges
        whole = q_legs[0].constant(cable_length)
        e, d = whole - behind.cable - q_legs[0], q_legs[1]
        tensions = behind.tension, ahead.tension
        if alike and load is None and weight is None and roll is None:
            return cls((-ahead.along, behind.along), (e, d), e)
        V = behind.pull * behind.along - ahead.pull * ahead.along
        if load is not None:
            V = V - V.constant(load)
        onward = behind.along + ahead.along
        if weight is None:
            return cls(closed_triangle(V, onward, roll, tensions, None), (e, d), e)
        half = 0.5 * weight
        # Half of what lies about the clasp: of cable k-1 all but its q-leg.
        carried = (whole - q_legs[0] + d + ahead.cable) * half
        halves = e * half, d * half
        directions = closed_triangle(V + carried.upward, onward, roll, tensions, halves)
        legs = []
        for cable, direction, edge in zip((e, d), directions, edges, strict=True):
            level = direction.row(0, 1)
            legs.append(cable * shortening(edge.sag * cable * cable * level.dot(level)))
        return cls(directions, (legs[0], legs[1]), e)
