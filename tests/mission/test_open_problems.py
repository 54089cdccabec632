"""Problems of open chains to plans: laws of symmetry, files, and the published script's case."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problem_cases import ROOT, hitch_start

import hitchopt as ho
from hitchopt.geometry import ConvexArc, Outline
from hitchopt.mission.loading import load_problem, problem_from_dict
from problems.random_morph import random_convex_polygon


def random_data(n: int, seed: int, tension: bool = True) -> dict[str, Any]:
    """A run of n edges of a random (n + 3)-gon, bent a little, turned and shifted."""
    rng = np.random.default_rng([n, seed])
    polygon = random_convex_polygon(n + 3, 1.3, rng, 0.15).translated(rng.uniform(-2.0, 2.0, 2))
    first = ConvexArc(polygon.vertices[: n + 1])
    centre = first.centroid
    second = first.translated(-centre).rotated(rng.uniform(-0.3, 0.3))
    second = second.scaled(rng.uniform(0.95, 1.05)).translated(centre + rng.uniform(-0.4, 0.4, 2))
    longest = np.maximum(first.edge_lengths, second.edge_lengths)
    return {
        "team": {
            "robots": n,
            "topology": "open",
            "cable_length": (longest + rng.uniform(0.65, 0.7, n)).round(4).tolist(),
            "tension": rng.uniform(0.4, 0.42, n).round(4).tolist() if tension else 0.4,
        },
        "start": {"hitch": {"polygon": first.vertices.round(6).tolist(), "altitude": 1.1}},
        "mission": [{"morph": {"polygon": second.vertices.round(6).tolist()}}],
    }


def morph_of(problem: ho.Problem) -> ho.Morph:
    (step,) = problem.mission
    assert isinstance(step, ho.Morph)
    return step


def moved(problem: ho.Problem, change: Any, team: ho.Team | None = None) -> ho.Problem:
    """The problem with both outlines changed by ``change``."""
    step = morph_of(problem)
    return replace(
        problem,
        team=team or problem.team,
        start=replace(hitch_start(problem), polygon=change(hitch_start(problem).polygon)),
        mission=(replace(step, polygon=change(step.polygon)),),
    )


def positions(plan: ho.Plan) -> np.ndarray:
    found: np.ndarray = plan.at(plan.duration * np.linspace(0.0, 1.0, 41)).positions
    return found


@pytest.mark.parametrize("n", range(2, 9))
def test_chains_of_any_size_are_planned_and_hold_at_dense_samples(n: int) -> None:
    plan = ho.solve(problem_from_dict(random_data(n, 1)))
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


@pytest.mark.parametrize(("n", "seed"), [(2, 2), (4, 3)])
def test_translating_and_turning_the_problem_moves_the_plan_with_it(n: int, seed: int) -> None:
    problem = problem_from_dict(random_data(n, seed))
    plan = ho.solve(problem)
    angle, offset = 0.7, np.array([3.0, -1.0])
    other = ho.solve(moved(problem, lambda p: p.rotated(angle).translated(offset)))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert other.duration == pytest.approx(plan.duration, rel=1e-3)
    expected = positions(plan) @ turn.T + [*offset, 0.0]
    np.testing.assert_allclose(positions(other), expected, atol=1e-3)


@pytest.mark.parametrize(("n", "seed"), [(2, 4), (3, 5), (5, 6)])
def test_the_chain_run_the_other_way_exchanges_q_and_r(n: int, seed: int) -> None:
    problem = problem_from_dict(random_data(n, seed))
    team = ho.Team(
        n,
        problem.team.cable_length[::-1],
        topology="open",
        tension=problem.team.tension[::-1],
    )
    plan = ho.solve(problem)
    other = ho.solve(moved(problem, Outline.mirrored, team))
    assert other.duration == pytest.approx(plan.duration, rel=1e-3)
    expected = positions(plan)[:, ::-1] * [-1.0, 1.0, 1.0]  # r of the last cable is q of the first
    np.testing.assert_allclose(positions(other), expected, atol=1e-3)


def test_forth_and_back_comes_back() -> None:
    data = random_data(4, 7)
    data["start"]["hitch"]["legs"] = "balanced"
    back = {"morph": {"polygon": data["start"]["hitch"]["polygon"], "legs": "balanced"}}
    data["mission"][0]["morph"]["legs"] = "balanced"
    data["mission"].append(back)
    plan = ho.solve(problem_from_dict(data))
    first, last = plan.at(0.0), plan.at(plan.duration)
    np.testing.assert_allclose(last.positions, first.positions, atol=1e-9)
    np.testing.assert_allclose(last.legs, first.legs, atol=1e-9)


def test_equal_and_nearly_equal_tensions_give_the_same_plan() -> None:
    """Two branches of the model, one at the ends of the chain as well as at its clasps."""
    data = random_data(3, 8, tension=False)
    plan = ho.solve(problem_from_dict(data))
    data["team"]["tension"] = [0.4, 0.4 + 1e-7, 0.4 - 1e-7]
    other = ho.solve(problem_from_dict(data))
    np.testing.assert_allclose(positions(other), positions(plan), atol=1e-5)


def test_a_chain_survives_its_files(tmp_path: Path) -> None:
    plan = ho.solve(problem_from_dict(random_data(3, 9)))
    plan.save(tmp_path / "chain", rate=20.0)
    again = ho.load(tmp_path / "chain")
    assert again.motion.team.topology == "open"
    assert again.certificate == plan.certificate
    np.testing.assert_array_equal(positions(again), positions(plan))
    with (tmp_path / "chain" / "vertices.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["vertex"] for row in rows[:8]] == ["0", "1", "2", "3"] * 2
    assert [row["tension"] for row in rows if row["vertex"] == "3"] == [""] * (len(rows) // 4)
    for k in range(3):
        tension = {float(row["tension"]) for row in rows if row["vertex"] == str(k)}
        assert tension == {plan.motion.team.tension[k]}
    for row in rows:
        point = plan.at(float(row["t"])).vertices[int(row["vertex"])]
        np.testing.assert_allclose([float(row[c]) for c in "xyz"], point, atol=1e-9)


def test_legs_that_leave_no_choice_are_given_and_checked() -> None:
    data = random_data(3, 10)
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


def test_edges_that_cross_break_the_crossing_limit() -> None:
    """The arc turns by 300° in all, and its last edge passes through its first."""
    data = random_data(4, 11)
    data["team"].update(cable_length=[4.5, 3.0, 3.0, 6.5], tension=0.4)
    points = [[0, -2], [0, 1.5], [1.5, 1.5], [1.5, 0], [-3.0, 0.4]]
    data["start"]["hitch"]["polygon"] = points
    data["mission"] = [{"hold": {"seconds": 1.0}}]
    with pytest.raises(ho.InfeasibleError, match=r"crossing: 0 m .*edge 0, edge 3"):
        ho.solve(problem_from_dict(data))


def test_the_published_scripts_case() -> None:
    """Four cables of 5 m, one clasp on a circle of 0.5 m, the other clasps and both ends still."""
    problem = load_problem(ROOT / "problems" / "open_chain.yaml")
    np.testing.assert_array_equal(problem.team.cable_length, [5.0] * 4)
    plan = ho.solve(problem)
    s = plan.at(np.linspace(0.0, plan.duration, 3001))
    p = s.vertices
    assert np.max(np.abs(np.linalg.norm(p[:, 2, :2] - [0.0, 1.7], axis=-1) - 0.5)) < 1e-4
    turned = np.unwrap(np.arctan2(p[:, 2, 1] - 1.7, p[:, 2, 0]))
    assert turned[0] - turned[-1] == pytest.approx(2.0 * np.pi)
    still = [0, 1, 3, 4]
    np.testing.assert_allclose(p[:, still], np.broadcast_to(p[0, still], p[:, still].shape))
    moves = np.max(np.ptp(s.positions, axis=0), axis=1) > 1e-9
    assert {name for name, m in zip(problem.team.drone_names, moves, strict=True) if m} == {
        "r0",
        "r1",
        "q2",
        "q3",
    }
    # Lengths with all three coordinates, which the script forgot one of.
    length = np.linalg.norm(np.diff(p, axis=1), axis=-1) + np.sum(s.legs, axis=-1)
    np.testing.assert_allclose(length, 5.0, atol=1e-5)
