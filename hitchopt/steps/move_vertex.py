"""Move a vertex: one vertex goes elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hitchopt.hitch import Team
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import move_vertex
from hitchopt.steps.hitch_step import MoveStep
from hitchopt.steps.keys import VERTEX, Blend, By, Key, LegsAtEnd, Seconds
from hitchopt.steps.situation import StepTask
from hitchopt.steps.step import check_index, check_within
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class MoveVertex(MoveStep):
    """One vertex goes elsewhere.

    Only the four drones move that the paper names; where a limit binds, further drones slide along
    their cables as well.

    Parameters
    ----------
    vertex: which, from 0.
    to, by: its new place, or by how much it goes (2,) [m]; exactly one of them.
    legs, duration, blend: as of Morph; without legs those of the paper are left as they are.
    """

    name: ClassVar[str] = "move_vertex"
    summary: ClassVar[str] = "Move one vertex"
    vertex: Annotated[int, VERTEX]
    to: Annotated[Array | None, Key("Point2", "Where to, [x, y] [m]")] = None
    by: By = None
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False

    def __post_init__(self) -> None:
        check_index("vertex", self.vertex)
        self.check_to_or_by((2,), "a point [x, y]")
        super().__post_init__()

    def moved_points(self, team: Team, count: int) -> list[int]:  # noqa: ARG002
        """Return the vertex."""
        check_within("vertex", self.vertex, count)
        return [self.vertex]

    def action(self, task: StepTask) -> Action:
        """Return the action."""
        start = task.hitch
        return move_vertex(start, self.polygon_after(start.team, start.polygon), self.vertex)
