"""Hitches on a circle: what robots tie where the goal cannot be tied directly.

A polygon whose vertices lie on a circle is the most regular one of its edge lengths. Its legs need
no roll and do not cross, so that drones at its clasps move out without passing each other. From
there the hitch is morphed to the goal.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import rotated
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.ends import spread_hitch
from hitchopt.values import Array


class CircleSize(NamedTuple):
    """Edge lengths of a polygon on a circle."""

    slack: float  # Slack of every cable for its legs, over the shortest one of two legs
    max_edge: float  # Longest edge over the shortest one


SIZES = tuple(
    CircleSize(slack, ratio) for slack in (3.0, 2.3, 1.35, 1.15) for ratio in (5.0, 2.5, 1.5)
)
"""Sizes in the order of the search: long legs tie easily, short ones allow short cables."""

FURTHER_SIZES = tuple(CircleSize(slack, 5.0) for slack in (1.5, 1.8))
"""Sizes between them, of which many robots on short cables need one: their legs are long enough to
keep drones off cables, and short enough not to cross."""

MAX_SLACK_SHARE = 0.5  # Largest slack over the length of a cable

PHASES = tuple(math.radians(angle) for angle in (0.0, 60.0, -60.0, 120.0, -120.0, 180.0))
"""[rad] Turns out of the polygon nearest to the goal, in the order of the search."""

MAX_ARC = math.radians(150.0)
"""[rad] Largest arc of an edge: longer edges are shortened, which keeps the centre inside."""

BISECTIONS = 50  # Number of bisections of the circle's radius and of the longest edge


def circular_polygon(edge_lengths: Array) -> ConvexPolygon:
    """Return the polygon on a circle about the origin with these edges (n,) [m].

    Edges with an arc of more than MAX_ARC are shortened.
    """
    chords = _shortened(edge_lengths)
    radius = _radius(chords)
    arcs = 2.0 * np.arcsin(0.5 * chords / radius)
    angles = np.cumsum(arcs) - arcs
    return ConvexPolygon(radius * np.column_stack([np.cos(angles), -np.sin(angles)]))


def _shortened(edge_lengths: Array) -> Array:
    """Return the edges (n,) [m], at most as long as lets the longest one have MAX_ARC."""
    longest = float(np.max(edge_lengths))
    if not _exceeds_arc(edge_lengths, longest):
        return edge_lengths
    feasible = float(np.min(edge_lengths))
    infeasible = longest
    for _ in range(BISECTIONS):
        middle = 0.5 * (feasible + infeasible)
        if _exceeds_arc(np.minimum(edge_lengths, middle), middle):
            infeasible = middle
        else:
            feasible = middle
    return np.minimum(edge_lengths, feasible)


def _exceeds_arc(chords: Array, longest: float) -> bool:
    """Return whether the longest of the chords (n,) [m] of a circle has more than MAX_ARC."""
    return 2.0 * _radius(chords) * math.sin(0.5 * MAX_ARC) < longest


def _radius(chords: Array) -> float:
    """Return the radius [m] of the circle that chords (n,) [m] close.

    It is half of the longest chord if the centre of that circle is outside of the polygon.
    """
    lower = 0.5 * float(np.max(chords))
    upper = 0.5 * float(np.sum(chords))
    for _ in range(BISECTIONS):
        middle = 0.5 * (lower + upper)
        half_arcs = np.arcsin(np.minimum(0.5 * chords / middle, 1.0))
        if np.sum(half_arcs) > math.pi:
            lower = middle
        else:
            upper = middle
    return lower


@dataclass(frozen=True, eq=False)
class CircularHitches:
    """The hitches on circles near a goal."""

    goal: Hitch  # The hitch that cannot be tied directly
    requirements: Requirements  # Limits and distances

    def shapes(self, sizes: Iterable[CircleSize]) -> Iterator[Hitch]:
        """Yield hitches without roll about the origin, whose legs keep all distances."""
        team = self.goal.team
        requirements = self.requirements
        shortest_leg = max(requirements.limits.leg, requirements.separation.radius)
        tried = list[Array]()
        for size in sizes:
            slack = np.minimum(2.0 * shortest_leg * size.slack, MAX_SLACK_SHARE * team.cable_length)
            edges = team.cable_length - slack
            edges = np.minimum(edges, size.max_edge * np.min(edges))
            if any(np.allclose(edges, other) for other in tried):
                continue
            tried.append(edges)
            hitch = spread_hitch(team, circular_polygon(edges), self.goal.altitude, requirements)
            if hitch is not None:
                yield hitch

    def placed(self, shape: Hitch) -> Iterator[Hitch]:
        """Yield a shape at the goal's centroid, turned to the goal and by PHASES from there."""
        goal = self.goal.polygon
        goal_points = goal.vertices - goal.centroid
        points = shape.polygon.vertices - shape.polygon.centroid
        # As complex numbers, the sum of squared distances is smallest at the angle of Σ g conj(p)
        products = (goal_points @ [1.0, 1.0j]) * (points @ [1.0, -1.0j])
        angle = float(np.angle(np.sum(products)))
        for phase in PHASES:
            polygon = ConvexPolygon(goal.centroid + rotated(points, angle + phase))
            yield Hitch(shape.team, polygon, shape.altitude, shape.q_legs)
