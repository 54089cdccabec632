"""The separation planner as a whole: laws, hard meetings, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.planners.separation import Separated, SeparationTask, separate

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
    found = separate(task)
    assert_kept(task, found)
    assert found.drones.duration <= slower * found.bound
    assert "right" in found.remark


@pytest.mark.parametrize("seed", range(2))
def test_random_teams(seed: int) -> None:
    task = scattered(12 + seed, seed)
    found = separate(task)
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
    found = separate(task)
    t = np.linspace(0.0, found.drones.duration, 50)
    expected = found.drones.at(t)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([4.0, -3.0, 1.0])
    moved = separate(
        replace(task, start=task.start @ turn.T + shift, goal=task.goal @ turn.T + shift)
    )
    assert moved.drones.duration == pytest.approx(found.drones.duration, rel=1e-3)
    times = t * moved.drones.duration / found.drones.duration
    np.testing.assert_allclose(moved.drones.at(times), expected @ turn.T + shift, atol=5e-3)
    order = np.random.default_rng(1).permutation(9)
    other = separate(replace(task, start=task.start[order], goal=task.goal[order]))
    assert other.drones.duration == pytest.approx(found.drones.duration, rel=1e-3)
    times = t * other.drones.duration / found.drones.duration
    np.testing.assert_allclose(other.drones.at(times), expected[:, order], atol=5e-3)


def test_quicker_drones_fly_the_same_ways_in_less_time() -> None:
    task, k = scattered(8, 3), 2.5
    found = separate(task)
    quicker = Limits(
        speed=k * LIMITS.speed, acceleration=k**2 * LIMITS.acceleration, jerk=k**3 * LIMITS.jerk
    )
    other = separate(replace(task, requirements=replace(task.requirements, limits=quicker)))
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
    expected, rng = separate(task).drones, np.random.default_rng(8)
    for _ in range(2):
        noise = 1e-14 * rng.uniform(-1.0, 1.0, (2, *task.start.shape))
        found = separate(replace(task, start=task.start + noise[0], goal=task.goal + noise[1]))
        assert found.drones.duration == pytest.approx(expected.duration, rel=1e-6)
        np.testing.assert_allclose(
            found.drones.at(0.4 * found.drones.duration),
            expected.at(0.4 * expected.duration),
            atol=1e-5,
        )


def test_a_given_duration_is_met_and_leaves_ways_nearer_to_straight() -> None:
    task = circle(8, 1.8)
    fast = separate(task)
    slow_task = replace(task, duration=2.0 * fast.drones.duration)
    slow = separate(slow_task)
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
    assert_kept(around, separate(around))
    start = np.array([[-1.5, 0.0, 1.0], [1.5, 0.1, 1.0], [-1.4, 0.6, 1.0]])
    goal = np.array([[1.5, 0.0, 1.0], [-1.5, 0.1, 1.0], [1.4, -0.6, 1.0]])
    past = SeparationTask(start, goal, Requirements(LIMITS, SEPARATION, keep_out=(POST,)))
    assert_kept(past, separate(past))


def test_weak_drones_accelerate_as_they_can() -> None:
    task = replace(circle(4, 1.5), acceleration=[0.5, 2.0, 1.0, 9.0])
    found = separate(task)
    t = np.linspace(0.0, found.drones.duration, 900)
    largest = np.max(np.linalg.norm(found.drones.at(t, 2), axis=-1), axis=0)
    assert np.all(largest <= np.array([0.5, 2.0, 1.0, 2.5]) * (1.0 + 1e-9))


def test_one_drone_flies_straight_and_who_is_there_stays() -> None:
    one = SeparationTask([[0.1, 0.2, 1.0]], [[2.0, 1.0, 1.5]], Requirements(LIMITS, SEPARATION))  # type: ignore[arg-type]
    found = separate(one)
    assert_kept(one, found)
    assert found.drones.duration <= 1.06 * found.bound
    assert found.remark == ""
    still = replace(circle(5, 1.0), goal=circle(5, 1.0).start)
    resting = separate(still).drones
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
        separate(changed(task, change))
    violation = caught.value.violations[0]
    assert violation.constraint == constraint
    assert violation.where[: len(where)] == where
    assert words in str(violation)
    value, limit = violation.value, violation.limit
    assert value < limit if violation.sense == "min" else value > limit


@pytest.mark.slow
def test_a_duration_that_would_do_is_offered() -> None:
    task = row(4)
    fast = separate(task)
    assert fast.drones.duration > 1.02 * fast.bound
    with pytest.raises(InfeasibleError, match="allow") as caught:
        separate(replace(task, duration=1.001 * fast.bound))
    offered = caught.value.violations[0].value
    enough = replace(task, duration=1.0001 * offered)
    assert_kept(enough, separate(enough))


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
    first, second = separate(circle(7, 1.5)).drones, separate(circle(7, 1.5)).drones
    np.testing.assert_array_equal(first.coefficients, second.coefficients)
    np.testing.assert_array_equal(first.breaks, second.breaks)
