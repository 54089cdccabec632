"""Large teams: legs that pass one another, and searches without a route that end soon."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.geometry import regular_polygon
from hitchopt.hitch.leg_program import LegTask
from hitchopt.hitch.legs import level_margin_bound, split_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.legs import STEEPEST, rolled_more
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.optimise import knots as search_task
from hitchopt.planners.optimise import program as ipopt_steps
from hitchopt.planners.optimise.knots import Effort, KnotPath
from hitchopt.planners.optimise.program import MorphProgram

N = 40
CABLE = 2.0


def rolled(edge: float, turn: float = 0.0) -> ho.Hitch:
    polygon = regular_polygon(N, edge).rotated(turn).translated([0.4, -0.2])
    return ho.Hitch.spread(ho.Team(N, CABLE), polygon)


@pytest.mark.slow
def test_drones_of_a_cable_pass_one_another_where_its_legs_are_rolled() -> None:
    """On the way the edge is half as long as the cable: in one plane both would be at one place."""
    start = rolled(1.3)
    goal = regular_polygon(N, 0.9).translated([0.4, -0.2])
    plan = ho.morph(start, goal)
    plan.certificate.raise_if_violated()
    t = np.linspace(0.0, plan.duration, 400)
    drones, vertices = plan.motion.drones.at(t), plan.motion.vertices.at(t)
    edges = np.linalg.norm(np.roll(vertices, -1, axis=1) - vertices, axis=-1)
    assert np.min(edges) < 0.5 * CABLE < np.max(edges)
    apart = (drones[:, 0::2] - drones[:, 1::2]) / [0.24, 0.24, 0.6]
    assert np.min(np.linalg.norm(apart, axis=-1)) > 1.0
    level = np.linalg.norm(apart[..., :2], axis=-1)
    assert np.min(level) < 1.0  # it is the height that keeps them apart
    np.testing.assert_allclose(drones[0], start.drones, atol=1e-9)


def test_legs_roll_more_half_way_and_end_as_they_are() -> None:
    start, end = rolled(1.3), rolled(1.2, 0.01)
    path = ShapePath.straight(start, end)
    s = np.linspace(0.0, 1.0, 9)
    assert path.roll is not None
    before = path.roll.at(s)
    raised = [each.roll for each in rolled_more(path)]
    assert raised
    for one, more in zip([path.roll, *raised], raised, strict=False):
        assert one is not None
        assert more is not None
        np.testing.assert_allclose(more.at(s)[[0, -1]], before[[0, -1]], atol=1e-12)
        assert np.all(np.abs(more.at(s)[1:-1]) > np.abs(one.at(s)[1:-1]))
        assert np.max(np.abs(more.at(s))) <= STEEPEST + 1e-12


def test_level_legs_are_not_rolled_on_the_way() -> None:
    team = ho.Team(3, 2.4)
    start = ho.Hitch.spread(team, np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]))
    assert not list(rolled_more(ShapePath.straight(start, start)))


@pytest.mark.parametrize("n", [12, 20, 28, 36])
def test_no_level_legs_have_a_larger_margin_than_their_bound(n: int) -> None:
    team = ho.Team(n, 2.0)
    for stretch in (1.0, 1.1):
        polygon = regular_polygon(n, 1.3).vertices * [1.0, stretch]
        task = LegTask(
            team, Requirements(), polygon[None], np.full((1, n), 0.3), 0.15, 1.5, roll=None
        )
        bound = level_margin_bound(task)
        assert split_slack(task).margin <= bound * (1.0 + 1e-9)


@pytest.mark.slow
def test_a_search_without_a_route_ends_when_its_work_is_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Level legs of a cable cannot pass one another, and the optimiser cannot know."""
    n, clearance = 36, 0.02
    spent: list[int] = []
    solve = ipopt_steps.solve_program

    def counting(program: MorphProgram, effort: Effort) -> KnotPath | None:
        before = effort.left
        found = solve(program, effort)
        spent.append(round(before - effort.left))
        return found

    work = 6e4
    monkeypatch.setattr(ipopt_steps, "solve_program", counting)
    monkeypatch.setattr(search_task, "WORK", work)
    separation = ho.Separation(cable=clearance, crossing=clearance)
    legs = {"sharing": "spread", "roll_deg": 0.0}
    start = ho.Hitch.spread(
        ho.Team(n, CABLE), regular_polygon(n, 1.3), separation=separation, roll=0.0
    )
    with pytest.raises(ho.InfeasibleError, match="separation"):
        ho.morph(start, regular_polygon(n, 0.8), legs=legs, separation=separation)
    assert 0 < sum(spent) <= work
