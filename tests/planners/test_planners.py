"""Every strategy shares the protocol of planners: what is asked can be looked at unsolved."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners import Planner
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.approach import DirectApproach, GatheredApproach
from hitchopt.planners.forming.prehitch import find_prehitch
from hitchopt.planners.morph.actions import ActionFlight, move_vertex
from hitchopt.planners.morph.morph import BlendedMorph, StraightMorph
from hitchopt.planners.optimise.search import OptimisedMorph
from hitchopt.planners.timing.flight import Flight

ASKED = Requirements()
TEAM = Team(4, [2.4, 2.5, 2.45, 2.4])
SQUARE = ho.regular_polygon(4, 1.2, np.pi / 4).translated([0.7, -0.4])
START = Hitch.spread(TEAM, SQUARE, 1.3)
TURNED = Hitch.spread(TEAM, SQUARE.rotated(0.3), 1.3)
FARTHER = Hitch.spread(TEAM, SQUARE.rotated(0.5).translated([0.3, 0.1]), 1.3)


def refused(*_: object) -> Flight | None:
    raise AssertionError("nothing is judged before it is solved")


def moved_vertex() -> ActionFlight:
    points = SQUARE.vertices.copy()
    points[1] += [0.1, 0.05]
    action = move_vertex(START, ho.ConvexPolygon(points), 1)
    return ActionFlight(action, Hitch(TEAM, action.polygon, 1.3, action.kept_legs), ASKED)


def test_strategies_are_planners_and_compute_nothing_when_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in ("morph.morph", "morph.actions"):
        monkeypatch.setattr(f"hitchopt.planners.{module}.fly", refused)
    monkeypatch.setattr("hitchopt.planners.forming.approach.separate", refused)
    goal = find_prehitch(TURNED, ASKED.separation, SwapSettings()).drones
    approach = (TEAM, START.drones, goal, ASKED)
    strategies: list[Planner[object, object]] = [
        StraightMorph(START, TURNED, ASKED),
        BlendedMorph((START, TURNED, FARTHER), ASKED),
        OptimisedMorph(START, TURNED, ASKED, refused),
        moved_vertex(),
        DirectApproach(*approach),
        GatheredApproach(*approach),
    ]
    for planner in strategies:
        assert planner.problem is not None
        with pytest.raises(AssertionError, match="nothing is judged"):
            planner.solve()
