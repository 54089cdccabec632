"""Follow a path: one vertex meets timed points at their times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import follow_vertex
from hitchopt.steps.edits import FORCES, PLAN_DURATION, RATES, StepEdit, Tunable, points_scaled
from hitchopt.steps.hitch_step import ActionStep
from hitchopt.steps.keys import VERTEX, Key, LegsAtEnd
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import check_index, check_within, convex_outline, numbers
from hitchopt.values import Array

MIN_GAP = 1e-3
"""Shortest time between two points [s]: less is a typing error, as no drone could follow."""


@dataclass(frozen=True, eq=False)
class FollowVertex(ActionStep):
    """One vertex follows timed points.

    It meets them at their times, at rest before and after.

    Parameters
    ----------
    vertex: which, from 0.
    path: (J, 3), rows ``t, x, y`` [s, m, m], t from the step's start and increasing. Where a
        point follows an equal one, the vertex stands still in between.
    legs: at the end; without them as of MoveVertex.
    """

    name: ClassVar[str] = "follow_vertex"
    summary: ClassVar[str] = "Lead one vertex along timed points"
    blendable: ClassVar[bool] = False
    vertex: Annotated[int, VERTEX]
    path: Annotated[
        Array,
        Key(
            "TimedPath",
            "Points [t, x, y] [s, m, m], t from the step's start, increasing; between "
            "equal points that follow each other the vertex stands still",
            ([[1.0, 0.0, -0.9]],),
        ),
    ]
    legs: LegsAtEnd = None

    def __post_init__(self) -> None:
        check_index("vertex", self.vertex)
        path = numbers("path", self.path, (None, 3), "points [t, x, y]")
        times = path[:, 0]
        gaps = np.diff(times, prepend=0.0)
        if times[0] == 0.0:
            gaps = gaps[1:]
        if len(gaps) == 0 or np.min(gaps) < MIN_GAP:
            increase = f"increase from 0 or later, by {MIN_GAP:g} s or more, and end after it"
            bound, remedy = f"a path whose times {increase}", "sort its points by time"
            raise InputError("path", path.tolist(), bound, remedy)
        object.__setattr__(self, "path", path)

    @property
    def duration(self) -> float:
        """Time at which the last point is met [s]."""
        return float(self.path[-1, 0])

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline with the vertex at the last point."""
        points = outline.vertices.copy()
        check_within("vertex", self.vertex, len(points))
        points[self.vertex] = self.path[-1, 1:]
        return convex_outline(team, points, "path", self.path)

    def action(self, task: StepTask) -> Action:
        """Return the action."""
        start = task.hitch
        return follow_vertex(
            start, self.polygon_after(start.team, start.polygon), self.vertex, self.path
        )

    def fly(self, task: StepTask) -> StepPlan:
        """Return the plan along the points; there is no other route."""
        end = self.end(task)
        self.check_end(end.hitch, task)
        return task.ended(self.own_route(task, end).motion(), end.hitch)

    def advice(self, check: str) -> str:
        """Return that more time helps, where it does."""
        return "give the points more time" if RULE_OF[check].derivative else ""

    def tunables(self) -> Iterator[Tunable]:
        """Yield the points' times."""

        def put(factor: float) -> StepEdit:
            return self._rewritten(points_scaled(times, factor, np.zeros(1)), points)

        times, points = self.path[:, 0], self.path[:, 1:]
        raises, lowers = RATES | FORCES, frozenset({PLAN_DURATION})
        yield Tunable("path", 1.0, "times", put, raises, lowers, "times of its points")

    def scaled(self, factor: float, centre: Array) -> tuple[StepEdit, Array]:
        """Return the edit that scales the points about the centre."""
        points = points_scaled(self.path[:, 1:], factor, centre)
        return self._rewritten(self.path[:, 0], points), centre

    def _rewritten(self, times: Array, points: Array) -> StepEdit:
        path = np.column_stack([times, points])
        return StepEdit("path", path.tolist(), {"path": path})
