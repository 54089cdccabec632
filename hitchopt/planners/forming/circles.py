"""Hitches on a circle: what robots tie where the goal cannot be tied directly.

A polygon whose vertices lie on a circle is the most regular one of its edge lengths. Its legs need
no roll and do not cross, so that drones at its clasps move out without passing each other. From
there the hitch is morphed to the goal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import rotated
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import SPREAD_MARGIN, LegTask
from hitchopt.values import Array


class CircleSize(NamedTuple):
    """Edge lengths of a polygon on a circle."""

    slack: float
    """Slack of every cable for its legs, over the shortest one of two legs."""

    max_edge: float
    """Longest edge over the shortest one."""


SIZES = tuple(
    CircleSize(slack, ratio) for slack in (3.0, 2.3, 1.35, 1.15) for ratio in (5.0, 2.5, 1.5)
)
"""Sizes in the order of the search: long legs tie easily, short ones allow short cables."""

MAX_SLACK_SHARE = 0.5
"""Largest slack over the length of a cable."""

PHASES = tuple(math.radians(angle) for angle in (0.0, 60.0, -60.0, 120.0, -120.0, 180.0))
"""[rad] Turns out of the polygon nearest to the goal, in the order of the search."""

MAX_ARC = math.radians(150.0)
"""[rad] Largest arc of an edge: longer edges are shortened, which keeps the centre inside."""

BISECTIONS = 50
"""Number of bisections of the circle's radius and of the longest edge."""


def circular_polygon(edge_lengths: Array) -> ConvexPolygon:
    """Return the polygon on a circle about the origin with these edges (n,) [m].

    Edges with an arc of more than MAX_ARC are shortened.
    """
    shortest, longest = float(np.min(edge_lengths)), float(np.max(edge_lengths))
    lengths = edge_lengths
    radius = _radius(lengths)
    if 2.0 * radius * math.sin(0.5 * MAX_ARC) < longest:
        for _ in range(BISECTIONS):
            middle = 0.5 * (shortest + longest)
            lengths = np.minimum(edge_lengths, middle)
            radius = _radius(lengths)
            if 2.0 * radius * math.sin(0.5 * MAX_ARC) < middle:
                longest = middle
            else:
                shortest = middle
        lengths = np.minimum(edge_lengths, shortest)
        radius = _radius(lengths)
    arcs = 2.0 * np.arcsin(0.5 * lengths / radius)
    angles = np.cumsum(arcs) - arcs
    return ConvexPolygon(radius * np.column_stack([np.cos(angles), -np.sin(angles)]))


def _radius(lengths: Array) -> float:
    """Return the radius [m] of the circle that chords of these lengths (n,) [m] close.

    It is half of the longest chord if they would close only beside the centre.
    """
    lower, upper = 0.5 * float(np.max(lengths)), 0.5 * float(np.sum(lengths))
    for _ in range(BISECTIONS):
        middle = 0.5 * (lower + upper)
        closes = np.sum(np.arcsin(np.minimum(0.5 * lengths / middle, 1.0))) > math.pi
        lower, upper = (middle, upper) if closes else (lower, middle)
    return lower


@dataclass(frozen=True, eq=False)
class CircularHitches:
    """The hitches on circles near a goal."""

    goal: Hitch
    requirements: Requirements
    """Limits and distances."""

    @property
    def shapes(self) -> Iterator[Hitch]:
        """Hitches without roll about the origin, whose legs keep all distances."""
        team, limits = self.goal.team, self.requirements.limits
        shortest = 2.0 * max(limits.leg, self.requirements.separation.radius)
        tried = list[Array]()
        for size in SIZES:
            slack = np.minimum(size.slack * shortest, MAX_SLACK_SHARE * team.cable_length)
            edges = team.cable_length - slack
            edges = np.minimum(edges, size.max_edge * np.min(edges))
            if any(np.allclose(edges, other) for other in tried):
                continue
            tried.append(edges)
            hitch = _spread(team, circular_polygon(edges), self.goal.altitude, self.requirements)
            if hitch is not None:
                yield hitch

    def placed(self, shape: Hitch) -> Iterator[Hitch]:
        """Yield a shape at the goal's centroid, turned to the goal and out of there."""
        outlines = self.goal.polygon, shape.polygon
        goal, points = (outline.vertices - outline.centroid for outline in outlines)
        nearest = np.angle(np.sum((goal @ [1.0, 1.0j]) * (points @ [1.0, -1.0j])))
        for phase in PHASES:
            turned = rotated(points, float(nearest) + phase)
            polygon = ConvexPolygon(self.goal.polygon.centroid + turned)
            yield Hitch(shape.team, polygon, shape.altitude, shape.q_legs)


def _spread(
    team: Team, polygon: ConvexPolygon, altitude: float, requirements: Requirements
) -> Hitch | None:
    """Return the hitch with spread legs without roll, or None if they break a distance."""
    try:
        legs = balanced_legs(team, polygon)
        task = LegTask.at_rest(team, polygon, legs, requirements, SPREAD_MARGIN)
        split = task.split()
        return Hitch(team, polygon, altitude, split.q_legs[0]) if split.margin >= 1.0 else None
    except InfeasibleError:
        return None
