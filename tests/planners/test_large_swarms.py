"""Crowds of single drones: programs of those that are too close, the others staying."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from hitchopt import separate
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.planners.separation.curve_evaluation import Evaluation, evaluate
from hitchopt.planners.separation.guess import PriorityRule, pushed_apart
from hitchopt.planners.separation.qp import MOST_ITERATIONS, Solver
from hitchopt.planners.separation.separation_program import build_program
from hitchopt.planners.separation.setting import Setting, setting_of
from hitchopt.planners.separation.task import SeparationTask
from hitchopt.requirements import Requirements
from hitchopt.values import Array
from problems.swarm import antipodal_circle, random_crowd

search = import_module("hitchopt.planners.separation.separate")


def crowd(drones: int, seed: int = 3) -> SwarmProblem:
    problem = any_problem_from_dict(random_crowd(drones, seed))
    assert isinstance(problem, SwarmProblem)
    return problem


def circle(drones: int) -> SwarmProblem:
    problem = any_problem_from_dict(antipodal_circle(drones))
    assert isinstance(problem, SwarmProblem)
    return problem


def setting(drones: int) -> Setting:
    problem = crowd(drones)
    return setting_of(SeparationTask(problem.start, problem.goal, Requirements()))


def test_a_part_is_the_whole_with_the_others_at_rest() -> None:
    here = setting(12)
    found = evaluate(here, pushed_apart(here, PriorityRule(0.5)))
    built = build_program(here, search._around(here, found, None))
    moving = np.zeros(12, dtype=np.bool_)
    moving[[1, 4, 5]] = True
    part, whole = built.among(moving), built.program
    rng = np.random.default_rng(0)
    for _ in range(5):
        x = rng.uniform(-1.0, 1.0, len(part.kept))
        y = part.whole(x)
        assert 0.5 * x @ part.program.P @ x + part.program.q @ x == pytest.approx(
            0.5 * y @ whole.P @ y + whole.q @ y
        )
        values, rest = np.asarray(part.program.A @ x), np.asarray(whole.A @ y)
        rows = np.flatnonzero(np.abs(rest) > 0.0)
        np.testing.assert_allclose(np.sort(values[values != 0.0]), np.sort(rest[rows]))
        moved = built.moved(y)
        np.testing.assert_array_equal(moved[~moving], found.coefficients[~moving])
    assert len(part.program.lower) < len(whole.lower)


def test_what_is_among_all_is_the_whole() -> None:
    here = setting(6)
    found = evaluate(here, pushed_apart(here, PriorityRule(0.5)))
    built = build_program(here, search._around(here, found, None))
    part = built.among(np.ones(6, dtype=np.bool_))
    np.testing.assert_array_equal(part.kept, np.arange(len(built.program.q)))
    used = np.flatnonzero(np.diff(built.program.A.tocsr().indptr))
    np.testing.assert_array_equal(part.program.A.toarray(), built.program.A.toarray()[used])


def test_programs_of_large_crowds_have_fewer_planes_and_smaller_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only as long as drones are too close, and not of those that are far too close."""
    here = setting(40)
    guess = evaluate(here, pushed_apart(here, PriorityRule(0.5)))
    guess = replace(guess, broken=evaluate(here, here.nominal).broken)
    whole = search._around(here, guess, None)
    np.testing.assert_array_equal(whole.moves, 1.0)
    monkeypatch.setattr(search, "LARGE", 40)
    gaps, between = np.min(whole.planes.gaps, axis=1), whole.planes.between
    monkeypatch.setattr(search, "DEEP", np.sort(gaps)[1])  # one plane is
    part = search._around(here, guess, None)
    deep = {int(ends[np.argmin(gaps)]) for ends in (between.first, between.second)}
    assert set(np.flatnonzero(part.moves == 1.0)) == deep
    assert set(part.moves) == {search.CAREFUL, 1.0}
    kept = gaps < 1.0 + search.MARGIN + search.NARROW
    kept |= np.isin(between.first, list(deep)) | np.isin(between.second, list(deep))
    assert 0 < len(part.planes.between) == np.sum(kept) < len(kept)
    clear = replace(guess, broken=())
    np.testing.assert_array_equal(search._around(here, clear, None).moves, 1.0)


def test_programs_around_a_roundabout_take_few_iterations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[int] = []

    class Counting(Solver):
        def __init__(self, iterations: int) -> None:
            given.append(iterations)
            super().__init__(iterations)

    monkeypatch.setattr(search, "Solver", Counting)
    for drones in (6, 32):  # the second one is a crowd
        separate(circle(drones)).certificate.raise_if_violated()
    assert given == [MOST_ITERATIONS, search.AROUND_CROWDS]


@pytest.mark.parametrize(
    ("shares", "crowd", "rounds"),
    [
        ([1.4, 1.13, 1.075, 1.06, 1.058], True, 2),  # 4.9 % in the second round
        ([1.4, 1.13, 1.075, 1.06, 1.058], False, 3),  # 1.4 % in the third one
        ([1.4, 1.13, 1.12, 1.11, 1.10], False, 2),
        ([3.0, 2.9, 2.8, 2.7, 1.04], True, 4),  # far from as fast as single flights
    ],
)
def test_rounds_around_a_roundabout_must_be_worthwhile(
    monkeypatch: pytest.MonkeyPatch, shares: list[float], crowd: bool, rounds: int
) -> None:
    here = setting(6)
    durations = iter(shares)
    told: list[str] = []

    def evaluation(_: Setting, coefficients: Array) -> Evaluation:
        return Evaluation(coefficients, next(durations) * here.alone, 1.2, ())

    monkeypatch.setattr(search, "evaluate", evaluation)
    best = search._improved(here, here.nominal, told.append, crowd=crowd)
    assert len(told) == rounds
    assert best.duration == pytest.approx(shares[rounds] * here.alone)


def test_drones_that_nobody_meets_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(search, "LARGE", 40)
    monkeypatch.setattr("hitchopt.planners.separation.guess.ROUNDS", 2)  # guesses are not clear
    moved: list[int] = []
    moving = search._moving

    def counting(*given: object) -> object:
        found = moving(*given)
        moved.append(int(np.sum(found)))
        return found

    monkeypatch.setattr(search, "_moving", counting)
    ring = antipodal_circle(12)
    x, y = np.meshgrid(np.arange(6) - 2.5, 8.0 + np.arange(5), indexing="ij")
    away = np.column_stack([x.ravel(), y.ravel(), np.full(30, 1.5)]).tolist()
    data = ring | {
        "team": {"drones": 42}, "start": ring["start"] + away, "goal": ring["goal"] + away
    }  # fmt: skip
    problem = any_problem_from_dict(data)
    assert isinstance(problem, SwarmProblem)
    plan = separate(problem)
    plan.certificate.raise_if_violated()
    assert moved
    assert max(moved) <= 12
    drones = plan.motion.drones.at(np.linspace(0.0, plan.duration, 300))
    i, j = np.triu_indices(42, 1)
    apart = (drones[:, i] - drones[:, j]) / [0.24, 0.24, 0.6]
    assert np.min(np.linalg.norm(apart, axis=-1)) >= 1.0
    np.testing.assert_allclose(drones[:, 12:], np.broadcast_to(away, (300, 30, 3)), atol=1e-12)
    np.testing.assert_allclose(drones[-1], problem.goal, atol=1e-9)
