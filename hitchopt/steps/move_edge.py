"""Move an edge: both ends of one edge go elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hitchopt.hitch import Team
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import move_edge
from hitchopt.steps.hitch_step import MoveStep
from hitchopt.steps.keys import VERTEX, Blend, By, Key, LegsAtEnd, Seconds
from hitchopt.steps.situation import StepTask
from hitchopt.steps.step import check_index, check_within
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class MoveEdge(MoveStep):
    """Both ends of one edge go elsewhere.

    Four drones move, or six where edges turn.

    Parameters
    ----------
    edge: which, from 0; edge k runs from vertex k to vertex k + 1.
    to, by: the new places of its ends (2, 2), or by how much both go (2,) [m]; exactly one of them.
    legs, duration, blend: as of MoveVertex.
    """

    name: ClassVar[str] = "move_edge"
    summary: ClassVar[str] = "Move one edge"
    edge: Annotated[int, VERTEX]
    to: Annotated[
        Array | None,
        Key("TwoPoints", "Where its ends go, [[x, y], [x, y]] [m], its first vertex first"),
    ] = None
    by: By = None
    legs: LegsAtEnd = None
    duration: Seconds = None
    blend: Blend = False

    def __post_init__(self) -> None:
        check_index("edge", self.edge)
        self.check_to_or_by((2, 2), "two points [[x, y], [x, y]]")
        super().__post_init__()

    def moved_points(self, team: Team, count: int) -> list[int]:
        """Return the edge's ends."""
        check_within("edge", self.edge, team.robots)
        return [self.edge, (self.edge + 1) % count]

    def action(self, task: StepTask) -> Action:
        """Return the action."""
        start = task.hitch
        return move_edge(start, self.polygon_after(start.team, start.polygon), self.edge)
