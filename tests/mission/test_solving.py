"""Problems to plans: laws of symmetry, ties, durations, and what is said when it fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.planners.optimise.search import OptimisedMorph, Routes
from hitchopt.steps.moving import Morph
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.values import Array
from problems.random_morph import random_morph
from tests.helpers.plans import PROBLEMS, planned
from tests.helpers.problem_cases import hitch_start

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
PULLED_IN = [[0.0, -0.5], [-0.4, 0.5], [0.4, 0.5]]
SQUARE = ho.regular_polygon(4, 1.2, np.pi / 4)


def places(plan: ho.Plan) -> Array:
    """Positions of drones at shares of a plan's time."""
    positions: Array = plan.at(plan.duration * np.linspace(0.0, 1.0, 41)).positions
    return positions


def moved(problem: ho.Problem, change: Callable[[Any], Any]) -> ho.Problem:
    """The problem with both polygons changed by ``change``."""
    (step,), start = problem.mission, hitch_start(problem)
    assert isinstance(step, Morph)
    steps = (replace(step, polygon=change(step.polygon)),)
    return replace(problem, start=replace(start, polygon=change(start.polygon)), mission=steps)


Map = Callable[[Array], Array]
"""Map of positions (times, 2n, 3) of a plan to those of the changed problem."""

Change = Callable[[ho.Problem], tuple[ho.Problem, Map]]


def turned(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    other = moved(problem, lambda p: p.rotated(0.7).translated([3.0, -1.0]))
    return other, lambda x: x @ turn.T + [3.0, -1.0, 0.0]


def renumbered(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    team = ho.Team(problem.team.robots, np.roll(problem.team.cable_length, -2))
    other = replace(moved(problem, lambda p: p.renumbered(2)), team=team)
    return other, lambda x: np.roll(x, -4, axis=1)


def mirrored(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    """Edge k of a polygon's image is edge n-2-k; q and r change places. A chain runs back."""
    n, original = problem.team.robots, problem.team
    order = (n - 2 - np.arange(n)) % n if original.layout.closed else np.arange(n)[::-1]
    lengths, tension = original.cable_length[order], original.tension[order]
    team = ho.Team(n, lengths, topology=original.topology, tension=tension)
    drones = np.column_stack([2 * order + 1, 2 * order]).ravel()
    other = replace(moved(problem, lambda p: p.mirrored()), team=team)
    return other, lambda x: x[:, drones] * [-1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("change", "data"),
    [
        (turned, random_morph(5, 2)),
        (renumbered, random_morph(6, 5)),
        (mirrored, random_morph(5, 7)),
        (mirrored, read_yaml(PROBLEMS / "open_arc.yaml")),
    ],
)
def test_the_changed_problem_has_the_changed_plan(change: Change, data: dict[str, Any]) -> None:
    problem = problem_from_dict(data)
    changed, mapped = change(problem)
    plan, other = ho.solve(problem), ho.solve(changed)
    assert other.duration == pytest.approx(plan.duration, rel=1e-3)
    np.testing.assert_allclose(places(other), mapped(places(plan)), atol=1e-3)


def test_reversing_start_and_end_reverses_the_path() -> None:
    problem = problem_from_dict(random_morph(6, 9))
    plan = ho.solve(problem)
    legs = plan.at(0.0).legs[:, 0]
    goal = hitch_start(problem).polygon
    back = ho.morph(plan.end, goal, legs, separation=problem.separation)
    assert back.duration == pytest.approx(plan.duration, rel=5e-3)
    np.testing.assert_allclose(places(back)[::-1], places(plan), atol=5e-3)


def test_a_given_duration_is_met_exactly_and_a_short_one_refused() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE)
    plan = ho.morph(start, PULLED_IN, duration=4.125, limits=ho.Limits(speed=0.8))
    assert (plan.duration, plan.certificate["speed"].limit) == (4.125, 0.8)
    np.testing.assert_allclose(plan.at(0.0).positions, start.drones, atol=1e-9)
    np.testing.assert_allclose(plan.at(4.125).vertices[:, :2], PULLED_IN, atol=1e-9)
    assert ho.solve(start, ho.Adjust("spread", duration=3.125)).duration == 3.125
    assert ho.solve(start, ho.Transport([1.0, -1.0, 1.5], duration=5.125)).duration == 5.125
    with pytest.raises(ho.InfeasibleError, match=r"duration: 0\.2 s is below .* \(move_edge\)"):
        ho.solve(start, ho.MoveEdge(0, by=[-0.05, 0.0], duration=0.2))
    with pytest.raises(ho.InfeasibleError, match="duration") as caught:
        ho.morph(start, PULLED_IN, limits=ho.Limits(duration=1.0))
    assert caught.value.violations[0].limit == 1.0


@pytest.mark.parametrize("offset", [1e-8, 1e-4])
def test_moves_of_next_to_nothing_are_planned(offset: float) -> None:
    goal = np.array(TRIANGLE) + offset
    plan = ho.morph(ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE), goal)
    assert plan.duration <= 0.2
    np.testing.assert_allclose(plan.end.vertices[:, :2], goal, atol=1e-12)


def test_optimize_is_never_slower_and_says_that_it_helped() -> None:
    start, goal = ho.Hitch.spread(ho.Team(4, 2.4), SQUARE), SQUARE.renumbered(1)
    plans = ho.morph(start, goal), ho.morph(start, goal, optimize=True)
    assert plans[1].duration <= plans[0].duration
    for plan in plans:  # edges that turn by as much are searched without a request, too
        assert "faster than the step's own route" in plan.phases[0].remark
    assert ho.morph(start, goal, optimize=True, duration=3.0).duration == 3.0


def test_a_shut_way_is_gone_round_or_the_refusal_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    start = ho.Hitch.spread(ho.Team(4, 2.4), SQUARE)
    half = ho.morph(start, SQUARE.renumbered(2))
    assert "the step's own route is infeasible" in half.phases[0].remark
    assert half.certificate.certified
    monkeypatch.setattr(OptimisedMorph, "solve", lambda _: Routes([], None))
    tried = "the best of 2 candidates: the step's own route, optimised route"
    with pytest.raises(ho.InfeasibleError, match=tried) as caught:
        ho.morph(start, SQUARE.renumbered(2))
    assert caught.value.violations[0].constraint == "convexity"
    with pytest.raises(ho.InfeasibleError, match=tried):
        ho.morph(start, SQUARE.renumbered(1), duration=2.0)


def noisy(points: Any, rng: np.random.Generator) -> Any:
    """Return coordinates [m] of a start or goal with noise in the last places."""
    if isinstance(points, dict):
        return {key: noisy(value, rng) for key, value in points.items()}
    if isinstance(points, list):
        return [noisy(point, rng) for point in points]
    return points if isinstance(points, str) else points + 1e-14 * float(rng.uniform(-1.0, 1.0))


def noisy_plan(name: str) -> ho.Plan:
    """Return a problem's plan from starts and goals with noise in the last places."""
    data: Any = read_yaml(PROBLEMS / f"{name}.yaml")
    rng = np.random.default_rng(1)
    changed = {key: noisy(data[key], rng) for key in ("start", "goal") if key in data}
    return ho.solve(problem_from_dict({**data, **changed}))


@pytest.mark.parametrize(
    "name",
    [
        "transport",  # legs of a symmetric triangle are split one way or the mirrored one
        "form_square",  # two assignments of robots are as short, and two ways to turn a cable
        "move_edge",  # the acceleration jumps where the mesh of a flight looks at it
    ],
)
def test_ties_are_settled_by_a_rule(name: str) -> None:
    plan, before = noisy_plan(name), planned(name)
    assert plan.duration == pytest.approx(before.duration, rel=1e-6)
    # Programs of single drones are solved to 1e-3; another choice would be decimetres away.
    np.testing.assert_allclose(places(plan), places(before), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["swarms/door", "swarms/stack"])
def test_who_gives_way_is_settled_by_a_rule(name: str) -> None:
    """Drones that give way otherwise pass each other on the other side, half a metre away.

    Up to sixteen programs, each solved to 1e-3 from the one before, enlarge noise to centimetres (5
    in the door), and durations follow.
    """
    plan, before = noisy_plan(name), planned(name)
    assert plan.duration == pytest.approx(before.duration, rel=1e-2)
    np.testing.assert_allclose(places(plan), places(before), atol=0.1)


def test_the_published_scripts_case() -> None:
    """Four cables of 5 m, one clasp on a circle of 0.5 m, the other clasps and both ends still."""
    plan = planned("open_chain")
    s = plan.at(np.linspace(0.0, plan.duration, 3001))
    p, still = s.vertices, [0, 1, 3, 4]
    assert np.max(np.abs(np.linalg.norm(p[:, 2, :2] - [0.0, 1.7], axis=-1) - 0.5)) < 1e-4
    turned = np.unwrap(np.arctan2(p[:, 2, 1] - 1.7, p[:, 2, 0]))
    assert turned[0] - turned[-1] == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(p[:, still], np.broadcast_to(p[0, still], p[:, still].shape))
    moves = np.max(np.ptp(s.positions, axis=0), axis=1) > 1e-9
    names = np.array(plan.motion.team.drone_names)
    assert set(names[moves]) == {"r0", "r1", "q2", "q3"}
    # Lengths with all three coordinates, which the script forgot one of.
    length = np.linalg.norm(np.diff(p, axis=1), axis=-1) + np.sum(s.legs, axis=-1)
    np.testing.assert_allclose(length, 5.0, atol=1e-5)
