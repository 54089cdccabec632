"""Problems to plans: laws of symmetry, bounds against sampling, and what is said when it fails."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plans import PROBLEMS, planned
from problem_cases import hitch_start, random_chain

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.planners.optimise.search import OptimisedMorph
from hitchopt.storage.yaml_file import read_yaml
from problems.random_morph import random_morph

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
PULLED_IN = [[0.0, -0.5], [-0.4, 0.5], [0.4, 0.5]]


def random_problem(n: int, seed: int) -> ho.Problem:
    return problem_from_dict(random_morph(n, seed))


def places(plan: ho.Plan) -> np.ndarray:
    """Positions of drones at shares of a plan's time."""
    found: np.ndarray = plan.at(plan.duration * np.linspace(0.0, 1.0, 41)).positions
    return found


def moved(problem: ho.Problem, change: object) -> ho.Problem:
    """The problem with both polygons changed by ``change``."""
    (step,) = problem.mission
    assert isinstance(step, ho.Morph)
    assert callable(change)
    return replace(
        problem,
        start=replace(hitch_start(problem), polygon=change(hitch_start(problem).polygon)),
        mission=(replace(step, polygon=change(step.polygon)),),
    )


Map = Callable[[np.ndarray], np.ndarray]
"""How positions (times, 2n, 3) of a plan become those of the changed problem's."""


def turned(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    angle, offset = 0.7, np.array([3.0, -1.0])
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    other = moved(problem, lambda p: p.rotated(angle).translated(offset))
    return other, lambda x: x @ turn.T + [*offset, 0.0]


def renumbered(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    team = ho.Team(problem.team.robots, np.roll(problem.team.cable_length, -2))
    other = replace(moved(problem, lambda p: p.renumbered(2)), team=team)
    return other, lambda x: np.roll(x, -4, axis=1)


def mirrored(problem: ho.Problem) -> tuple[ho.Problem, Map]:
    """Edge k of a polygon's image is edge n-2-k; q and r change places. A chain runs back."""
    n, given = problem.team.robots, problem.team
    order = (n - 2 - np.arange(n)) % n if given.layout.closed else np.arange(n)[::-1]
    lengths, tension = given.cable_length[order], given.tension[order]
    team = ho.Team(n, lengths, topology=given.topology, tension=tension)
    drones = np.column_stack([2 * order + 1, 2 * order]).ravel()
    other = replace(moved(problem, lambda p: p.mirrored()), team=team)
    return other, lambda x: x[:, drones] * [-1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (turned, random_problem(5, 2)),
        (renumbered, random_problem(6, 5)),
        (mirrored, random_problem(5, 7)),
        (mirrored, problem_from_dict(random_chain(5, 6))),
    ],
)
def test_the_changed_problem_has_the_changed_plan(
    change: Callable[[ho.Problem], tuple[ho.Problem, Map]], problem: ho.Problem
) -> None:
    changed, mapped = change(problem)
    plan, other = ho.solve(problem), ho.solve(changed)
    assert other.duration == pytest.approx(plan.duration, rel=1e-3)
    np.testing.assert_allclose(places(other), mapped(places(plan)), atol=1e-3)


def test_reversing_start_and_end_reverses_the_path() -> None:
    problem = random_problem(6, 9)
    plan = ho.solve(problem)
    first, last = plan.at(0.0), plan.at(plan.duration)
    (step,) = problem.mission
    assert isinstance(step, ho.Morph)
    start, goal = ho.Hitch(problem.team, step.polygon, 1.0, last.legs[:, 0]), hitch_start(problem)
    back = ho.morph(start, goal.polygon, first.legs[:, 0], separation=problem.separation)
    assert back.duration == pytest.approx(plan.duration, rel=5e-3)
    np.testing.assert_allclose(places(back)[::-1], places(plan), atol=5e-3)


@pytest.mark.parametrize(("n", "seed"), [(3, 10), (30, 14)])
def test_sampling_a_plan_never_beats_its_certificate(n: int, seed: int) -> None:
    plan = ho.solve(random_problem(n, seed))
    team, certificate = plan.motion.team, plan.certificate
    state = plan.at(np.linspace(0.0, plan.duration, 3001 if n < 20 else 301))
    x = state.positions * plan.motion.requirements.separation.scale
    i, j = np.triu_indices(2 * n, 1)
    ratio = min(
        float(np.min(np.linalg.norm(x[:, a] - x[:, b], axis=-1))) for a, b in zip(i, j, strict=True)
    )
    thrust = team.mass[:, None] * (state.accelerations + [0, 0, 9.81]) - state.cable_forces
    vertices = state.vertices
    ends = np.roll(vertices, -1, axis=1)
    cable = (
        np.linalg.norm(state.positions[:, 0::2] - vertices, axis=-1)
        + np.linalg.norm(ends - vertices, axis=-1)
        + np.linalg.norm(state.positions[:, 1::2] - ends, axis=-1)
    )
    edges = (ends - vertices)[..., :2]
    before = np.roll(edges, 1, axis=1)
    cross = before[..., 1] * edges[..., 0] - before[..., 0] * edges[..., 1]
    angles = np.degrees(np.arctan2(cross, np.sum(before * edges, axis=-1)))
    sampled = {
        "separation": ratio,
        "speed": np.max(np.linalg.norm(state.velocities, axis=-1)),
        "acceleration": np.max(np.linalg.norm(state.accelerations, axis=-1)),
        "jerk": np.max(np.linalg.norm(state.jerks, axis=-1)),
        "thrust": np.max(np.linalg.norm(thrust, axis=-1)),
        "tilt": np.degrees(
            np.max(np.arctan2(np.hypot(thrust[..., 0], thrust[..., 1]), thrust[..., 2]))
        ),
        "legs": np.min(state.legs),
        "cable_length": np.max(np.abs(cable / team.cable_length - 1.0)),
        "convexity": np.min(angles),
    }
    for name, value in sampled.items():
        check = certificate[name]
        sign = 1.0 if check.sense == "min" else -1.0
        assert sign * (value - check.worst) >= -1e-12, name
        coarse = 0.01 if n < 20 or name != "jerk" else 0.1
        assert abs(value - check.bound) <= coarse * abs(check.bound) + 1e-6, name


def test_a_given_duration_is_met_exactly_and_a_short_one_refused() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE)
    plan = ho.morph(start, PULLED_IN, duration=4.125, limits=ho.Limits(speed=0.8))
    assert (plan.duration, plan.certificate["speed"].limit) == (4.125, 0.8)
    np.testing.assert_allclose(plan.at(0.0).positions, start.drones, atol=1e-9)
    np.testing.assert_allclose(plan.at(4.125).vertices[:, :2], PULLED_IN, atol=1e-9)
    with pytest.raises(ho.InfeasibleError, match=r"duration: 0\.5 s is below"):
        ho.morph(start, PULLED_IN, duration=0.5)
    with pytest.raises(ho.InfeasibleError, match="duration") as caught:
        ho.morph(start, PULLED_IN, limits=ho.Limits(duration=1.0))
    assert caught.value.violations[0].limit == 1.0


@pytest.mark.parametrize("offset", [1e-8, 1e-4])
def test_moves_of_next_to_nothing_are_planned(offset: float) -> None:
    goal = np.array(TRIANGLE) + offset
    plan = ho.morph(ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE), goal)
    assert plan.duration <= 0.2
    np.testing.assert_allclose(plan.at(1.0).vertices[:, :2], goal, atol=1e-12)


def test_optimize_is_never_slower_and_says_that_it_helped() -> None:
    start = ho.Hitch.spread(ho.Team(4, 2.4), ho.regular_polygon(4, 1.2, np.pi / 4))
    goal = ho.regular_polygon(4, 1.2, np.pi / 4).renumbered(1)
    straight, optimised = ho.morph(start, goal), ho.morph(start, goal, optimize=True)
    assert straight.phases[0].remark == ""
    assert optimised.duration < straight.duration
    assert "faster than the step's own route" in optimised.phases[0].remark
    exact = ho.morph(start, goal, optimize=True, duration=3.0)
    assert exact.duration == 3.0
    assert exact.certificate.certified


def test_a_way_that_is_shut_is_gone_round_or_the_refusal_says_what_was_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    square = ho.regular_polygon(4, 1.2, np.pi / 4)
    start = ho.Hitch.spread(ho.Team(4, 2.4), square)
    half = ho.morph(start, square.renumbered(2))
    assert "the step's own route is infeasible" in half.phases[0].remark
    assert half.certificate.certified
    monkeypatch.setattr(OptimisedMorph, "solve", lambda _: [])
    ho.forget()
    with pytest.raises(ho.InfeasibleError, match="the optimiser found no other route") as caught:
        ho.morph(start, square.renumbered(2))
    assert caught.value.violations[0].constraint == "convexity"
    with pytest.raises(ho.InfeasibleError, match="no route that is fast enough"):
        ho.morph(start, square.renumbered(1), duration=2.0)


def noisy(points: Any, rng: np.random.Generator) -> Any:
    """Return lists of coordinates [m] with noise in the last places."""
    if isinstance(points, list):
        return [noisy(point, rng) for point in points]
    return points + 1e-14 * float(rng.uniform(-1.0, 1.0))


@pytest.mark.parametrize(
    ("name", "tie"),
    [
        ("transport", "legs of a symmetric triangle are split one way or the mirrored one"),
        ("form_square", "two assignments of robots are as short, and two ways to turn a cable"),
        ("move_edge", "the acceleration jumps where the mesh of a flight looks at it"),
    ],
)
def test_ties_are_settled_by_a_rule(name: str, tie: str) -> None:
    data: Any = read_yaml(PROBLEMS / f"{name}.yaml")
    rng, before = np.random.default_rng(1), ho.solve(problem_from_dict(data)).duration
    for start in data["start"].values():
        for key in sorted({"polygon", "q", "r"} & set(start)):
            start[key] = noisy(start[key], rng)
    assert ho.solve(problem_from_dict(data)).duration == pytest.approx(before, rel=1e-6), tie


@pytest.mark.parametrize("n", [2, 5])
def test_chains_of_any_size_are_planned_and_hold_at_dense_samples(n: int) -> None:
    plan = ho.solve(problem_from_dict(random_chain(n, 1)))
    assert plan.certificate.certified
    s = plan.at(np.linspace(0.0, plan.duration, 1501))
    x, p, L = s.positions, s.vertices, plan.motion.team.cable_length
    assert p.shape[1:] == (n + 1, 3)
    np.testing.assert_allclose(x[:, 0], p[:, 0], atol=1e-9)
    np.testing.assert_allclose(x[:, -1], p[:, -1], atol=1e-9)
    assert not np.any(s.legs[:, 0, 0])
    assert not np.any(s.legs[:, -1, 1])
    used = np.linalg.norm(np.diff(p, axis=1), axis=-1)
    used += np.linalg.norm(x[:, 0::2] - p[:, :-1], axis=-1)
    used += np.linalg.norm(x[:, 1::2] - p[:, 1:], axis=-1)
    assert np.max(np.abs(used / L - 1.0)) <= plan.certificate["cable_length"].bound <= 1e-4
    # The forces that setpoints.csv holds balance the cables' at every clasp.
    forces = s.cable_forces.reshape(len(x), n, 2, 3)
    edges = np.diff(p, axis=1)
    pulls = s.tensions[..., None] * edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    for k in range(1, n):
        residual = -forces[:, k, 0] - forces[:, k - 1, 1] + pulls[:, k] - pulls[:, k - 1]
        size = np.max(np.linalg.norm(residual, axis=-1) / np.min(s.tensions[:, k - 1 : k + 1], 1))
        assert size <= plan.certificate["equilibrium"].bound <= 5e-3
    np.testing.assert_allclose(forces[:, 0, 0], pulls[:, 0], atol=1e-9)
    np.testing.assert_allclose(forces[:, -1, 1], -pulls[:, -1], atol=1e-9)


def test_legs_that_leave_no_choice_are_given_and_checked() -> None:
    data = random_chain(3, 10)
    data["mission"] = [{"hold": {"seconds": 1.0}}]
    slack = problem_from_dict(data)
    free = slack.team.cable_length - hitch_start(slack).polygon.edge_lengths
    data["start"]["hitch"]["legs"] = [0, 0.3, round(float(free[2]), 5)]
    state = ho.solve(problem_from_dict(data)).at(0.5)
    np.testing.assert_allclose(state.legs, [[0, free[0]], [0.3, free[1] - 0.3], [free[2], 0]])
    data["start"]["hitch"]["legs"] = [0.3, 0.3, round(float(free[2]), 5)]
    with pytest.raises(ho.InfeasibleError, match=r"q0 stands at the chain's end.*write d_0 = 0"):
        ho.solve(problem_from_dict(data))
    data["start"]["hitch"]["legs"] = [0, 0, 0.3]
    with pytest.raises(ho.InputError, match=r"start\.hitch\.legs\[1\] = 0\.0: must be greater"):
        problem_from_dict(data)


def test_the_published_scripts_case() -> None:
    """Four cables of 5 m, one clasp on a circle of 0.5 m, the other clasps and both ends still."""
    plan = planned("open_chain")
    team = plan.motion.team
    s = plan.at(np.linspace(0.0, plan.duration, 3001))
    p = s.vertices
    assert np.max(np.abs(np.linalg.norm(p[:, 2, :2] - [0.0, 1.7], axis=-1) - 0.5)) < 1e-4
    turned = np.unwrap(np.arctan2(p[:, 2, 1] - 1.7, p[:, 2, 0]))
    assert turned[0] - turned[-1] == pytest.approx(2.0 * np.pi)
    still = [0, 1, 3, 4]
    np.testing.assert_allclose(p[:, still], np.broadcast_to(p[0, still], p[:, still].shape))
    moves = np.max(np.ptp(s.positions, axis=0), axis=1) > 1e-9
    assert {name for name, m in zip(team.drone_names, moves, strict=True) if m} == {
        "r0",
        "r1",
        "q2",
        "q3",
    }
    # Lengths with all three coordinates, which the script forgot one of.
    length = np.linalg.norm(np.diff(p, axis=1), axis=-1) + np.sum(s.legs, axis=-1)
    np.testing.assert_allclose(length, 5.0, atol=1e-5)
