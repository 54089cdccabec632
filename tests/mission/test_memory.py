"""What has been planned is not planned again, and nobody can tell from what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import Progress
from hitchopt.mission import solving
from hitchopt.mission.solving import VARIABLE, remembered
from hitchopt.steps import STEPS
from hitchopt.steps.moving import plan_blended
from hitchopt.steps.step import StepPlan, StepTask

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
PULLED_IN = [[0.0, -0.5], [-0.4, 0.5], [0.4, 0.5]]
TEAM = ho.Team(robots=3, cable_length=2.4)
KNOWN = "planned before, taken from memory"


@pytest.fixture(autouse=True)
def _remembering(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv(VARIABLE)
    ho.forget()
    yield
    ho.forget()


def mission(last: float = 0.3, limits: ho.Limits | None = None) -> ho.Problem:
    """Four steps of the paper's triangle, the last one by so much."""
    goal = ho.ConvexPolygon(PULLED_IN)
    steps = (
        ho.Morph(goal, optimize=True),
        ho.Hold(1.0),
        ho.MoveVertex(0, by=np.array([0.1, 0.0]), blend=True),
        ho.MoveVertex(1, by=np.array([0.0, 0.1])),
        ho.Transport(np.array([last, 0.2, 1.1]), 0.2),
    )
    start = ho.HitchStart(ho.ConvexPolygon(TRIANGLE), 1.0)
    return ho.Problem(TEAM, start, steps, limits or ho.Limits())


def tied() -> ho.Problem:
    """A hitch formed of drones, its robots assigned to edges."""
    q = np.array([[0.9, -0.9, 0.0], [-1.0, -0.6, 0.0], [0.0, 1.3, 0.0]])
    r = np.array([[-0.6, -1.4, 0.0], [-1.2, 1.1, 0.0], [1.4, 0.9, 0.0]])
    polygon = ho.regular_polygon(3, 0.9)
    return ho.Problem(TEAM, ho.DronesStart(q, r), (ho.Form(polygon, 1.2), ho.Release()))


def bits(value: Any) -> Any:
    """All that a plan holds, arrays as bytes and the order in which they lie in memory."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.strides, value.tobytes()
    if is_dataclass(value):
        return type(value), [bits(part) for part in vars(value).values()]
    return [bits(part) for part in value] if isinstance(value, tuple) else repr(value)


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    """All arrays that a plan holds."""
    if isinstance(value, np.ndarray):
        yield value
    for part in vars(value).values() if is_dataclass(value) else ():
        yield from arrays_in(part)
    for part in value if isinstance(value, tuple) else ():
        yield from arrays_in(part)


PROBLEMS: dict[str, ho.Problem | ho.SwarmProblem] = {
    "mission": mission(),
    "tied": tied(),
    "swarm": ho.SwarmProblem(
        ho.Swarm(2), np.array([[0.0, 0, 1], [2, 0, 1]]), np.array([[2.0, 0, 1], [0, 0, 1]])
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_plans_from_memory_are_those_planned_anew_to_the_last_bit(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []
    first, again = ho.solve(PROBLEMS[name]), ho.solve(PROBLEMS[name], heard.append)
    assert heard.count(KNOWN) == sum(not word.startswith("planning step") for word in heard)
    assert heard
    monkeypatch.setenv(VARIABLE, "off")
    heard.clear()
    anew = ho.solve(PROBLEMS[name], heard.append)
    assert KNOWN not in heard
    assert bits(anew) == bits(first) == bits(again)


def test_nothing_done_to_a_plan_changes_the_next_one() -> None:
    start = ho.Hitch.spread(TEAM, TRIANGLE)
    plan = ho.hold(start, 1.0)
    before = bits(plan)
    found = [array for array in arrays_in(plan) if array.size]
    assert len(found) > 5
    for array in found:
        for place in ((0,) * array.ndim, (-1,) * array.ndim):
            with pytest.raises(ValueError, match="read-only"):
                array[place] = 7.0
    object.__setattr__(plan.motion.phases[0], "name", "another")
    object.__setattr__(plan.motion, "drones", None)
    assert bits(ho.hold(start, 1.0)) == before


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The first steps of all groups that the planners are asked for."""
    asked: list[int] = []

    def counted(planner: Callable[[Any, StepTask], StepPlan]) -> Any:
        def counting(step: Any, task: StepTask) -> StepPlan:
            asked.append(task.index)
            return planner(step, task)

        return counting

    for kind in STEPS:
        monkeypatch.setattr(kind, "plan", counted(kind.plan))
    monkeypatch.setattr(solving, "plan_blended", counted(plan_blended))
    return asked


@pytest.mark.slow
def test_after_an_edit_only_what_it_changes_is_planned(planned: list[int]) -> None:
    ho.solve(mission(0.3))
    assert planned == [0, 1, 2, 4]
    ho.solve(mission(0.4))
    assert planned[4:] == [4]
    ho.solve(replace(mission(0.4), title="renamed"))
    assert len(planned) == 5
    ho.solve(mission(0.4, ho.Limits(speed=0.99)))
    assert planned[5:] == [0, 1, 2, 4]
    ho.forget()
    ho.solve(mission(0.4))
    assert planned[9:] == [0, 1, 2, 4]


class Counted:
    """Remembered work that counts how often it is done."""

    def __init__(self) -> None:
        self.done = 0
        self.outcome: BaseException | None = None
        self.work = remembered(self._work)

    def _work(self, progress: Progress | None, value: Any) -> list[Any]:
        self.done += 1
        if progress is not None:
            progress("at work")
        if self.outcome is not None:
            raise self.outcome
        return [value]

    def __call__(self, value: Any = 1.0, progress: Progress | None = None) -> list[Any]:
        return self.work(progress, value)


VIOLATION = ho.Violation("speed", 2.0, 1.0, "max", "m/s", ("q0",), "now", "go slower")


@pytest.mark.parametrize(
    ("outcome", "times"),
    [
        (ho.InfeasibleError([VIOLATION], "and more"), 1),
        (ho.TimeLimitError([VIOLATION]), 2),
        (ho.HitchoptError("no timing"), 2),
        (KeyboardInterrupt(), 2),
    ],
)
def test_only_plans_and_refusals_are_remembered(outcome: BaseException, times: int) -> None:
    counted = Counted()
    counted.outcome = outcome
    for _ in range(2):
        with pytest.raises(type(outcome)) as error:
            counted()
        assert str(error.value) == str(outcome)
    assert counted.done == times


def test_the_variable_turns_it_off_at_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Counted()
    counted()
    monkeypatch.setenv(VARIABLE, "OFF")
    counted()
    counted()
    assert counted.done == 3
    monkeypatch.setenv(VARIABLE, "on")
    counted()
    assert counted.done == 3


def test_requests_of_other_contents_are_told_apart() -> None:
    array = np.arange(6.0).reshape(2, 3)
    alike = [1, 1.0, True, "1", (1,), [1], np.float32(1.0), 0.0, -0.0, np.nextafter(1.0, 2.0)]
    alike += [array, array.reshape(3, 2), np.asfortranarray(array), ho.Release(1.0), ho.Land(1.0)]
    counted = Counted()
    for value in [*alike, *alike]:
        counted(value)
    assert counted.done == len(alike)
