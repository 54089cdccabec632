"""What has been planned is not planned again, and nobody can tell from what comes of it."""

from __future__ import annotations

import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problem_cases import INFEASIBLE

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.memory import VARIABLE, Memory, Progress, remembered
from hitchopt.steps import STEPS, blending
from hitchopt.steps.blending import plan_blended
from hitchopt.steps.situation import StepPlan, StepTask
from problems.random_morph import random_morph

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
PULLED_IN = [[0.0, -0.5], [-0.4, 0.5], [0.4, 0.5]]
TEAM = ho.Team(robots=3, cable_length=2.4)


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
    "straight": problem_from_dict(random_morph(5, 2)),
    "swarm": ho.SwarmProblem(
        ho.Swarm(2), np.array([[0.0, 0, 1], [2, 0, 1]]), np.array([[2.0, 0, 1], [0, 0, 1]])
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_plans_from_memory_are_those_planned_anew_to_the_last_bit(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []
    first, again = ho.solve(PROBLEMS[name]), ho.solve(PROBLEMS[name], heard.append)
    assert heard == ["planned before, taken from memory"]
    monkeypatch.setenv(VARIABLE, "off")
    anew = ho.solve(PROBLEMS[name], heard.append)
    assert heard.count("planned before, taken from memory") == 1
    assert len(heard) > 1
    assert bits(anew) == bits(first) == bits(again)


def test_what_planning_asks_of_a_hitch_makes_no_other_request(planned: list[int]) -> None:
    start = ho.Hitch.spread(TEAM, ho.ConvexPolygon(TRIANGLE))
    known = set(vars(start))
    for _ in range(2):
        ho.morph(start, PULLED_IN)
    assert set(vars(start)) == known
    assert planned == [0]


def test_a_step_that_follows_remembered_ones_is_planned_as_after_new_ones() -> None:
    ho.solve(mission(0.3))
    edited = ho.solve(mission(0.4))
    ho.forget()
    assert bits(ho.solve(mission(0.4))) == bits(edited)


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
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.setflags(write=True)
    object.__setattr__(plan.motion.phases[0], "name", "another")
    object.__setattr__(plan.motion, "drones", None)
    assert bits(ho.hold(start, 1.0)) == before


def test_what_is_done_to_the_inputs_afterwards_changes_no_plan() -> None:
    start = ho.Hitch(TEAM, TRIANGLE, 1.0, ho.Hitch.spread(TEAM, TRIANGLE).q_legs)
    length = float(start.q_legs[0])
    before = bits(ho.hold(start, 1.0))
    start.q_legs.setflags(write=True)
    start.q_legs[0] = length + 1e-3
    assert bits(ho.hold(start, 1.0)) != before
    start.q_legs[0] = length
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
    monkeypatch.setattr(blending, "plan_blended", counted(plan_blended))
    return asked


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


def test_refusals_are_remembered_word_for_word(planned: list[int]) -> None:
    *steps, last = mission().mission
    assert isinstance(last, ho.Transport)
    tight = replace(mission(), mission=(*steps, replace(last, duration=0.1)))
    with pytest.raises(ho.InfeasibleError) as first:
        ho.solve(tight)
    asked = len(planned)
    with pytest.raises(ho.InfeasibleError) as again:
        ho.solve(tight)
    assert len(planned) == asked
    assert again.value is not first.value
    assert (str(again.value), again.value.violations) == (str(first.value), first.value.violations)


@pytest.mark.slow
def test_suggestions_are_those_of_a_process_that_remembers_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (path,) = [path for path in INFEASIBLE if path.stem == "plan_too_long"]
    budget = 1e6  # [s] a search that time cuts short depends on the machine
    first, again = ho.suggestions(path, budget), ho.suggestions(path, budget)
    repaired = ho.repair(path, budget)
    monkeypatch.setenv(VARIABLE, "off")
    assert [str(s) for s in ho.suggestions(path, budget)] == [str(s) for s in first]
    assert [str(s) for s in again] == [str(s) for s in first]
    assert bits(ho.repair(path, budget)) == bits(repaired)


class Counted:
    """Remembered work that counts how often it is done."""

    def __init__(self, memory: Memory | None = None) -> None:
        self.done = 0
        self.outcome: BaseException | None = None
        self.work = remembered(self._work, Memory() if memory is None else memory)

    def _work(self, progress: Progress | None, a: float, b: str) -> tuple[float, str]:
        self.done += 1
        if progress is not None:
            progress("at work")
        if self.outcome is not None:
            raise self.outcome
        return a, b

    def __call__(self, a: float = 1.0, b: str = "b", progress: Progress | None = None) -> object:
        return self.work(progress, a, b=b)


VIOLATION = ho.Violation("speed", 2.0, 1.0, "max", "m/s", ("q0",), "now", "go slower")


def test_only_plans_and_refusals_are_remembered() -> None:
    for outcome, times in (
        (None, 1),
        (ho.InfeasibleError([VIOLATION], "and more"), 1),
        (ho.HitchoptError("no timing"), 2),
        (ho.InputError("key", 1, "2", "3"), 2),
        (KeyboardInterrupt(), 2),
        (TimeoutError(), 2),
        (MemoryError(), 2),
    ):
        counted = Counted()
        counted.outcome = outcome
        for _ in range(2):
            if outcome is None:
                assert counted() == (1.0, "b")
                continue
            with pytest.raises(type(outcome)) as error:
                counted()
            assert str(error.value) == str(outcome)
        assert counted.done == times


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ho.InfeasibleError([VIOLATION])])
def test_what_a_listener_ends_is_not_remembered(error: BaseException) -> None:
    counted = Counted()

    def ends(message: str) -> None:
        assert message == "at work"
        raise error

    for _ in range(2):
        with pytest.raises(type(error)):
            counted(progress=ends)
    assert counted.done == 2
    heard: list[str] = []
    assert counted(progress=heard.append) == (1.0, "b")
    assert counted(progress=heard.append) == (1.0, "b")
    assert heard == ["at work", "planned before, taken from memory"]
    assert counted.done == 3


def test_a_listener_that_raises_within_planning_ends_it_and_leaves_nothing() -> None:
    def refuse(message: str) -> None:
        assert message
        raise ho.InfeasibleError([VIOLATION])

    for problem in (mission(), tied(), problem_from_swarm()):
        with pytest.raises(ho.InfeasibleError, match="go slower"):
            ho.solve(problem, refuse)
        assert ho.solve(problem).certificate.certified


def problem_from_swarm() -> ho.SwarmProblem:
    """Two drones that exchange their places."""
    found = PROBLEMS["swarm"]
    assert isinstance(found, ho.SwarmProblem)
    return found


def test_what_was_used_last_is_dropped_last() -> None:
    memory = Memory(max_outcomes=2)
    for key in (b"a", b"b"):
        memory.store(key, key)
    assert memory.recall(b"a") == b"a"
    memory.store(b"c", b"c")
    assert memory.recall(b"b") is None
    assert memory.recall(b"a") == b"a"


def test_a_result_after_a_listener_has_raised_is_not_remembered() -> None:
    done = []

    def work(progress: Progress | None) -> float:
        done.append(progress)
        assert progress is not None
        with pytest.raises(TimeoutError):
            progress("at work")
        return 1.0

    def ends(message: str) -> None:
        raise TimeoutError(message)

    found = remembered(work, Memory())
    assert [found(ends), found(ends)] == [1.0, 1.0]
    assert len(done) == 2


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


def test_what_cannot_be_compared_is_worked_out_every_time() -> None:
    done = []

    def work(progress: Progress | None, value: object) -> float:
        done.append((progress, value))
        return 1.0

    found = remembered(work, Memory())
    for thing in (lambda: 1.0, threading.Lock(), (i for i in range(2)), memoryview(b"one")):
        done.clear()
        assert [found(None, thing), found(None, thing)] == [1.0, 1.0]
        assert done == [(None, thing)] * 2


def test_results_that_cannot_be_pickled_are_worked_out_every_time() -> None:
    done = []

    def work(progress: Progress | None, value: float) -> Iterator[float]:
        done.append((progress, value))
        return (value for _ in range(1))

    found = remembered(work, Memory())
    assert [list(found(None, 2.0)), list(found(None, 2.0))] == [[2.0], [2.0]]
    assert len(done) == 2


def test_a_result_that_can_be_changed_does_not_change_the_next_one() -> None:
    def work(progress: Progress | None, value: float) -> list[float]:
        assert progress is None
        return [value]

    found = remembered(work, Memory())
    for _ in range(3):
        values = found(None, 2.0)
        assert values == [2.0]
        values.append(3.0)


def test_results_of_kinds_that_cannot_be_copied_are_worked_out_every_time() -> None:
    done = []

    def work(progress: Progress | None, value: float) -> tuple[set[float], ...]:
        done.append((progress, value))
        return ({value},)

    found = remembered(work, Memory())
    first, again = found(None, 2.0), found(None, 2.0)
    assert first == again == ({2.0},)
    assert first[0] is not again[0]
    assert len(done) == 2


@pytest.mark.parametrize("name", PROBLEMS)
def test_copies_share_nothing_but_what_nobody_can_change(name: str) -> None:
    one, other = ho.solve(PROBLEMS[name]), ho.solve(PROBLEMS[name])
    mine, theirs = ({id(part): part for part in parts_of(plan)} for plan in (one, other))
    assert len(mine) == len(theirs) > 20
    assert not mine.keys() & theirs.keys()
    for array in arrays_in(other):
        with warnings.catch_warnings():  # numpy 2.5 deprecates it, and people do it
            warnings.simplefilter("ignore", DeprecationWarning)
            array.shape = (1, *array.shape)
    assert bits(ho.solve(PROBLEMS[name])) == bits(one) != bits(other)


def parts_of(value: Any) -> Iterator[object]:
    """All records, dicts and arrays that a plan holds."""
    if is_dataclass(value) or isinstance(value, dict | np.ndarray):
        yield value
    items = vars(value) if is_dataclass(value) else value if isinstance(value, dict) else {}
    for part in value if isinstance(value, tuple) else items.values():
        yield from parts_of(part)


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 40), st.booleans()), max_size=40),
    st.integers(1, 5),
    st.integers(1, 60),
)
def test_memory_is_bounded_and_forgets_the_least_recently_used(
    steps: list[tuple[int, int, bool]], most: int, most_bytes: int
) -> None:
    memory = Memory(most, most_bytes)
    model: OrderedDict[int, tuple[int, int]] = OrderedDict()
    for i, (name, size, ask) in enumerate(steps):
        key = bytes([name])
        if ask:
            expected = model.get(name)
            assert memory.recall(key) == (
                None if expected is None else bytes([expected[0]]) * expected[1]
            )
            if expected is not None:
                model.move_to_end(name)
            continue
        memory.store(key, bytes([i]) * size)
        if size > most_bytes:
            continue
        model.pop(name, None)
        model[name] = (i, size)
        while len(model) > most or sum(size for _, size in model.values()) > most_bytes:
            model.popitem(last=False)
        assert len(memory) == len(model) <= most
        assert memory.size == sum(size for _, size in model.values()) <= most_bytes
    memory.forget()
    assert (len(memory), memory.size) == (0, 0)


def test_plans_are_counted_with_all_their_arrays() -> None:
    memory = Memory()

    def zeros(progress: Progress | None, n: int) -> tuple[np.ndarray]:
        assert progress is None
        return (np.zeros(n),)

    remembered(zeros, memory)(None, 1000)
    assert 8000 < memory.size < 9000


def test_threads_share_it() -> None:
    memory = Memory(max_outcomes=3)
    counted = Counted(memory)
    wrong: list[object] = []

    def ask() -> None:
        for i in range(300):
            a = float(i % 5)
            if counted(a) != (a, "b"):
                wrong.append(a)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert len(memory) == 3
    assert memory.size > 0
