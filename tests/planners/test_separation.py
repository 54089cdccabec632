"""The separation planner as a whole: laws, hard meetings, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Result, Ruckig, Trajectory

import hitchopt as ho
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.mission.problem import SwarmProblem
from hitchopt.planners.separation import Separated, SeparatedFlight, SeparationTask
from hitchopt.planners.separation.guesses import points_along, routes_around
from hitchopt.planners.separation.program import hull_points
from hitchopt.planners.timing.ramps import fastest_ramps
from problems.swarm import antipodal_circle

LIMITS, SEPARATION = Limits(speed=1.1, acceleration=2.5, jerk=22.0), Separation(0.13, 0.28)
POST = Prism([[-0.2, -0.25], [-0.2, 0.25], [0.3, 0.25], [0.3, -0.25]], -1.0, 9.0)


def circle(n: int, radius: float) -> SeparationTask:
    """Drones off the origin that trade places through one point."""
    angles = 2.0 * np.pi * np.arange(n) / n + 0.1
    offset = radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    middle = np.array([0.7, -1.3, 1.4])
    return SeparationTask(middle + offset, middle - offset, Requirements(LIMITS, SEPARATION))


def scattered(n: int, seed: int) -> SeparationTask:
    """Drones between random places."""
    rng = np.random.default_rng(seed)
    ends = []
    for _ in range(2):
        points = np.empty((0, 3))
        while len(points) < n:
            point = rng.uniform([-1.0, -2.0, 0.5], [2.0, 1.0, 2.0])
            apart = np.linalg.norm((points - point) * SEPARATION.scale, axis=1)
            if np.all(apart > 1.1):
                points = np.vstack([points, point])
        ends.append(points)
    return SeparationTask(ends[0], ends[1], Requirements(LIMITS, SEPARATION))


def assert_kept(task: SeparationTask, found: Separated, samples: int = 1500) -> None:
    """Samples keep all of the task, and never beat the bound."""
    curves = found.drones
    t = np.linspace(0.0, curves.duration, samples)
    points = curves.at(t)
    np.testing.assert_allclose(points[0], task.start, atol=1e-9)
    np.testing.assert_allclose(points[-1], task.goal, atol=1e-9)
    for order in (1, 2):
        for end in curves.at([0.0, curves.duration], order):
            np.testing.assert_allclose(end, 0.0, atol=1e-8)
    for order in (0, 1, 2):
        first, last = curves.ends(order)
        np.testing.assert_allclose(last[:-1], first[1:], atol=1e-9)
    caps = (
        task.requirements.limits.speed,
        task.requirements.limits.acceleration,
        task.requirements.limits.jerk,
    )
    for order, cap in enumerate(caps, start=1):
        assert np.max(np.linalg.norm(curves.at(t, order), axis=-1)) <= cap * (1.0 + 1e-9)
    i, j = np.triu_indices(task.drones, 1)
    ratio = np.linalg.norm(
        (points[:, i] - points[:, j]) * task.requirements.separation.scale, axis=-1
    )
    if task.drones > 1:
        assert np.min(ratio) >= found.closest >= 1.0
    if task.requirements.arena is not None:
        assert np.all(
            (points >= task.requirements.arena.lower) & (points <= task.requirements.arena.upper)
        )
    for prism in task.requirements.keep_out:
        assert np.min(prism.clearance(points).distance) >= task.requirements.separation.radius
    for one, other, longest in task.tethers:
        apart = np.linalg.norm(points[:, one] - points[:, other], axis=-1)
        assert np.max(apart) <= longest
    assert found.bound <= curves.duration
    if task.duration is not None:
        assert curves.duration == pytest.approx(task.duration, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "slower"), [(2, 1.1), (24, 1.25)])
def test_a_circle_is_crossed_nearly_as_fast_as_alone(n: int, slower: float) -> None:
    task = circle(n, 2.0)
    found = SeparatedFlight(task).solve()
    assert_kept(task, found)
    assert found.drones.duration <= slower * found.bound
    assert "right" in found.remark


@pytest.mark.parametrize("seed", range(2))
def test_random_teams(seed: int) -> None:
    task = scattered(12 + seed, seed)
    found = SeparatedFlight(task).solve()
    assert_kept(task, found)
    assert found.drones.duration <= 1.2 * found.bound


def stack(n: int) -> SeparationTask:
    z = 0.5 + 0.65 * np.arange(n)
    start = np.column_stack([np.full(n, 0.3), np.full(n, -0.2), z])
    return SeparationTask(start, start[::-1], Requirements(LIMITS, SEPARATION))


def row(n: int) -> SeparationTask:
    x = 0.4 * np.arange(n)
    start = np.column_stack([x, np.full(n, 0.5), np.full(n, 1.0)])
    return SeparationTask(start, start[::-1], Requirements(LIMITS, SEPARATION))


def test_what_is_moved_turned_and_renumbered_takes_as_long() -> None:
    """As exactly as OSQP, which stops at 1e-4, lets it."""
    task = scattered(9, 7)
    found = SeparatedFlight(task).solve()
    t = np.linspace(0.0, found.drones.duration, 50)
    expected = found.drones.at(t)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([4.0, -3.0, 1.0])
    moved = SeparatedFlight(
        replace(task, start=task.start @ turn.T + shift, goal=task.goal @ turn.T + shift)
    ).solve()
    assert moved.drones.duration == pytest.approx(found.drones.duration, rel=1e-3)
    times = t * moved.drones.duration / found.drones.duration
    np.testing.assert_allclose(moved.drones.at(times), expected @ turn.T + shift, atol=5e-3)
    order = np.random.default_rng(1).permutation(9)
    other = SeparatedFlight(replace(task, start=task.start[order], goal=task.goal[order])).solve()
    assert other.drones.duration == pytest.approx(found.drones.duration, rel=1e-3)
    times = t * other.drones.duration / found.drones.duration
    np.testing.assert_allclose(other.drones.at(times), expected[:, order], atol=5e-3)


def test_quicker_drones_fly_the_same_ways_in_less_time() -> None:
    task, k = scattered(8, 3), 2.5
    found = SeparatedFlight(task).solve()
    quicker = Limits(
        speed=k * LIMITS.speed, acceleration=k**2 * LIMITS.acceleration, jerk=k**3 * LIMITS.jerk
    )
    other = SeparatedFlight(
        replace(task, requirements=replace(task.requirements, limits=quicker))
    ).solve()
    assert other.drones.duration * k == pytest.approx(found.drones.duration, rel=1e-6)


def through_a_door() -> SeparationTask:
    """Mirror images that trade places through a door: who gives route is left to a rule."""
    y = np.array([-0.5, 0.0, 0.5])
    one = np.column_stack([np.full(3, -1.6), y, np.full(3, 1.2)])
    other = one * [-1.0, 1.0, 1.0]
    walls = tuple(
        Prism([[-0.1, low], [-0.1, high], [0.1, high], [0.1, low]], 0.0, 3.0)
        for low, high in ((0.6, 2.0), (-2.0, -0.6))
    )
    room = Arena([-2.5, -2.0, 0.0], [2.5, 2.0, 2.6])
    ends = np.vstack([one, other]), np.vstack([other, one])
    return SeparationTask(*ends, Requirements(LIMITS, SEPARATION, room, walls))


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        circle(36, 2.4),
        stack(5),
        through_a_door(),
    ],
    ids=["crowd", "stack", "door"],
)
def test_noise_on_the_input_changes_nothing(task: SeparationTask) -> None:
    expected, rng = SeparatedFlight(task).solve().drones, np.random.default_rng(8)
    for _ in range(2):
        noise = 1e-14 * rng.uniform(-1.0, 1.0, (2, *task.start.shape))
        found = SeparatedFlight(
            replace(task, start=task.start + noise[0], goal=task.goal + noise[1])
        ).solve()
        assert found.drones.duration == pytest.approx(expected.duration, rel=1e-6)
        np.testing.assert_allclose(
            found.drones.at(0.4 * found.drones.duration),
            expected.at(0.4 * expected.duration),
            atol=1e-5,
        )


def test_a_given_duration_is_met_and_leaves_ways_nearer_to_straight() -> None:
    task = circle(8, 1.8)
    fast = SeparatedFlight(task).solve()
    slow_task = replace(task, duration=2.0 * fast.drones.duration)
    slow = SeparatedFlight(slow_task).solve()
    assert_kept(slow_task, slow)

    def astray(found: Separated) -> float:
        t = np.linspace(0.0, found.drones.duration, 300)
        points, route = found.drones.at(t), task.goal - task.start
        along = route / np.linalg.norm(route, axis=1, keepdims=True)
        offset = points - task.start
        aside = offset - np.sum(offset * along, axis=-1, keepdims=True) * along
        return float(np.mean(np.linalg.norm(aside, axis=-1)))

    assert astray(slow) < 1.05 * astray(fast)


def test_arena_prism_and_cables_are_kept() -> None:
    around = replace(
        circle(6, 1.8),
        requirements=replace(
            circle(6, 1.8).requirements, arena=Arena([-1.3, -3.3, 1.0], [2.7, 0.7, 1.7])
        ),
        tethers=((0, 1, 2.0), (2, 3, 1.9)),
    )
    assert_kept(around, SeparatedFlight(around).solve())
    start = np.array([[-1.5, 0.0, 1.0], [1.5, 0.1, 1.0], [-1.4, 0.6, 1.0]])
    goal = np.array([[1.5, 0.0, 1.0], [-1.5, 0.1, 1.0], [1.4, -0.6, 1.0]])
    past = SeparationTask(start, goal, Requirements(LIMITS, SEPARATION, keep_out=(POST,)))
    assert_kept(past, SeparatedFlight(past).solve())


def test_weak_drones_accelerate_as_they_can() -> None:
    task = replace(circle(4, 1.5), acceleration=[0.5, 2.0, 1.0, 9.0])
    found = SeparatedFlight(task).solve()
    t = np.linspace(0.0, found.drones.duration, 900)
    largest = np.max(np.linalg.norm(found.drones.at(t, 2), axis=-1), axis=0)
    assert np.all(largest <= np.array([0.5, 2.0, 1.0, 2.5]) * (1.0 + 1e-9))


def test_one_drone_flies_straight_and_who_is_there_stays() -> None:
    one = SeparationTask([[0.1, 0.2, 1.0]], [[2.0, 1.0, 1.5]], Requirements(LIMITS, SEPARATION))  # type: ignore[arg-type]
    found = SeparatedFlight(one).solve()
    assert_kept(one, found)
    assert found.drones.duration <= 1.06 * found.bound
    assert found.remark == ""
    still = replace(circle(5, 1.0), goal=circle(5, 1.0).start)
    resting = SeparatedFlight(still).solve().drones
    points = resting.at(np.array([0.0, 0.5, 1.0]) * resting.duration)
    np.testing.assert_allclose(points, np.broadcast_to(still.start, points.shape), atol=1e-6)


def changed(task: SeparationTask, change: dict[str, object]) -> SeparationTask:
    """The task with other fields, those of its requirements included."""
    required = {key: value for key, value in change.items() if key in vars(task.requirements)}
    own = {key: value for key, value in change.items() if key not in required}
    requirements = replace(task.requirements, **required)  # type: ignore[arg-type]
    return replace(task, requirements=requirements, **own)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "constraint", "where", "words"),
    [
        ({"goal": [[0.0, 0, 1], [0.1, 0, 1]]}, "separation", ("d0", "d1"), "goals"),
        ({"start": [[1.0, 0, 1], [1.1, 0, 1]]}, "separation", ("d0", "d1"), "start"),
        ({"arena": Arena([-1.5, -1, 0], [0.9, 1, 2])}, "arena", ("d1",), "start"),
        ({"keep_out": (POST,), "goal": [[0.0, 0, 1], [-1, 0, 1]]}, "keep_out", ("d0",), "goal"),
        ({"tethers": ((0, 1, 1.5),)}, "span", ("d0", "d1"), "start"),
        ({"duration": 1.5}, "duration", (), "2.372 s"),
        ({"arena": Arena([-2, -0.05, 0.9], [2, 0.05, 1.1])}, "separation", ("d0", "d1"), "t ="),
    ],
)
def test_what_cannot_be_is_told_with_names_and_time(
    change: dict[str, object], constraint: str, where: tuple[str, ...], words: str
) -> None:
    ends = np.array([[-1.0, 0, 1], [1.0, 0, 1]])
    task = SeparationTask(ends, ends[::-1], Requirements(LIMITS, SEPARATION))
    with pytest.raises(InfeasibleError) as caught:
        SeparatedFlight(changed(task, change)).solve()
    violation = caught.value.violations[0]
    assert violation.constraint == constraint
    assert violation.where[: len(where)] == where
    assert words in str(violation)
    value, limit = violation.value, violation.limit
    assert value < limit if violation.sense == "min" else value > limit


@pytest.mark.slow
def test_a_duration_that_would_do_is_offered() -> None:
    task = row(4)
    fast = SeparatedFlight(task).solve()
    assert fast.drones.duration > 1.02 * fast.bound
    with pytest.raises(InfeasibleError, match="allow") as caught:
        SeparatedFlight(replace(task, duration=1.001 * fast.bound)).solve()
    offered = caught.value.violations[0].value
    enough = replace(task, duration=1.0001 * offered)
    assert_kept(enough, SeparatedFlight(enough).solve())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start": [[0, 0]]}, "start"),
        ({"start": [[0, 0, np.nan]]}, "start"),
        ({"goal": [[0, 0, 1], [1, 1, 1]]}, "goal"),
        ({"duration": -1.0}, "duration"),
        ({"names": ("a", "b")}, "names"),
    ],
)
def test_tasks_that_are_wrong_in_themselves(change: dict[str, object], words: str) -> None:
    task = SeparationTask(np.zeros((1, 3)), np.ones((1, 3)), Requirements(LIMITS, SEPARATION))
    with pytest.raises(InputError, match=words):
        replace(task, **change)  # type: ignore[arg-type]


def test_the_same_task_gives_the_same_plan_to_the_last_bit() -> None:
    first, second = (
        SeparatedFlight(circle(7, 1.5)).solve().drones,
        SeparatedFlight(circle(7, 1.5)).solve().drones,
    )
    np.testing.assert_array_equal(first.coefficients, second.coefficients)
    np.testing.assert_array_equal(first.breaks, second.breaks)


PILLAR = Prism([[-0.3, -0.4], [-0.3, 0.4], [0.5, 0.4], [0.5, -0.4]], 0.0, 9.0)


@given(st.floats(1e-3, 50.0), st.floats(0.1, 5.0), st.floats(0.2, 9.0), st.floats(0.5, 90.0))
@settings(max_examples=60)
def test_fastest_ramps_are_those_of_another_library(d: float, v: float, a: float, j: float) -> None:
    asked = InputParameter(1)
    asked.target_position = [d]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [v], [a], [j]
    found = Trajectory(1)
    assert Ruckig(1).calculate(asked, found) == Result.Working
    (duration,), (rise,) = fastest_ramps(np.array([d]), v, a, j)
    assert duration == pytest.approx(found.duration, rel=1e-6)
    assert 2.0 * rise <= duration * (1.0 + 1e-12)
    assert d <= v * (duration - rise) * (1.0 + 1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0))
@settings(max_examples=40)
def test_no_point_of_a_hull_is_nearer_than_the_one_that_is_found(seed: int, away: float) -> None:
    points = np.random.default_rng(seed).normal(size=(1, 3, 6)) + away * np.ones((3, 1))
    (nearest,) = hull_points(points)
    if np.any(nearest):  # a plane through it has all of the hull on its far side
        assert np.min(nearest @ points[0]) == pytest.approx(nearest @ nearest, rel=1e-3)
    else:  # the origin is a mean of the points, which no plane cuts off
        normals = np.random.default_rng(1).normal(size=(4000, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert np.max(np.min(normals @ points[0], axis=1)) < 0.05


def test_the_way_around_a_pillar_is_the_shortest_and_stays_out() -> None:
    start, goal = np.array([[-2.0, 0.1, 1.0]]), np.array([[2.0, 0.0, 1.0]])
    task = SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(PILLAR,)))
    (route,) = routes_around(task)
    off = 1.25 * task.requirements.separation.radius
    corners = [[-0.3 - off, 0.4 + off], [0.5 + off, 0.4 + off]]
    by_hand = np.vstack([start[0, :2], corners, goal[0, :2]])
    length = float(np.sum(np.linalg.norm(np.diff(by_hand, axis=0), axis=1)))
    steps = np.linalg.norm(np.diff(route, axis=0), axis=1)
    assert np.sum(steps) == pytest.approx(length, rel=1e-6)
    points = points_along(route, np.linspace(0.0, 1.0, 500))
    assert np.min(PILLAR.clearance(points).distance) > task.requirements.separation.radius
    np.testing.assert_allclose(points[[0, -1]], [start[0], goal[0]], atol=1e-12)


def test_a_low_prism_is_flown_over_where_that_is_shorter() -> None:
    low = Prism(PILLAR.polygon, 0.0, 0.9)
    start, goal = np.array([[-2.0, 0.1, 0.8]]), np.array([[2.0, 0.0, 0.8]])
    (route,) = routes_around(
        SeparationTask(start, goal, Requirements(Limits(), Separation(), keep_out=(low,)))
    )
    assert np.max(points_along(route, np.linspace(0.0, 1.0, 99))[:, 2]) > 1.0
    assert np.sum(np.linalg.norm(np.diff(route, axis=0), axis=1)) < 4.2


def test_a_slit_is_told_with_the_drone() -> None:
    walls = tuple(
        Prism([[-0.1, low], [-0.1, high], [0.1, high], [0.1, low]], 0.0, 3.0)
        for low, high in ((0.08, 5.0), (-5.0, -0.08))
    )
    start, goal = np.array([[-1.0, 0.3, 1.0]]), np.array([[1.0, 0.2, 1.0]])
    room = Arena([-2, -4, 0], [2, 4, 3])
    task = SeparationTask(
        start, goal, Requirements(Limits(), Separation(), arena=room, keep_out=walls)
    )
    with pytest.raises(InfeasibleError, match="keep_out") as caught:
        routes_around(task)
    assert caught.value.violations[0].where == ("d0",)


search = import_module("hitchopt.planners.separation.separate")


def test_drones_that_nobody_meets_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(search, "LARGE", 40)
    monkeypatch.setattr("hitchopt.planners.separation.guesses.ROUNDS", 2)  # guesses are not clear
    ring = antipodal_circle(12)
    x, y = np.meshgrid(np.arange(6) - 2.5, 8.0 + np.arange(5), indexing="ij")
    away = np.column_stack([x.ravel(), y.ravel(), np.full(30, 1.5)]).tolist()
    data = ring | {
        "team": {"drones": 42}, "start": ring["start"] + away, "goal": ring["goal"] + away
    }  # fmt: skip
    problem = any_problem_from_dict(data)
    assert isinstance(problem, SwarmProblem)
    plan = ho.separate(problem)
    plan.certificate.raise_if_violated()
    drones = plan.motion.drones.at(np.linspace(0.0, plan.duration, 300))
    i, j = np.triu_indices(42, 1)
    apart = (drones[:, i] - drones[:, j]) / [0.24, 0.24, 0.6]
    assert np.min(np.linalg.norm(apart, axis=-1)) >= 1.0
    np.testing.assert_allclose(drones[:, 12:], np.broadcast_to(away, (300, 30, 3)), atol=1e-12)
    np.testing.assert_allclose(drones[-1], problem.goal, atol=1e-9)
