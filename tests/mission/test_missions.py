"""Missions of many steps: one plan, stops where they are asked for, nothing planned twice."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.errors import AT_END, StepPlace, Violation
from hitchopt.forming.steps import Land, Release
from hitchopt.hitch.requirements import Requirements
from hitchopt.mission.cache import contents
from hitchopt.planners.task import RestState, StepTask
from hitchopt.steps import Step
from hitchopt.steps.blended import BlendedStep
from hitchopt.steps.moving import Adjust, FollowVertex, Hold, Morph, MoveEdge, MoveVertex, Transport
from hitchopt.values import MAX_COORDINATE
from hitchopt.values.fields import with_fields
from problems.random_steps import random_timed_blend

SQUARE = ho.regular_polygon(4, 1.3, angle=0.2).translated([1.0, 2.0])
MOVES: tuple[Step, ...] = (
    MoveVertex(0, by=np.array([-0.15, 0.03])),
    MoveEdge(2, by=np.array([0.02, 0.1])),
    Morph(SQUARE, np.full(4, 0.33)),
    Adjust("balanced"),
)


def mission(*steps: Step, **options: Any) -> ho.Problem:
    team = ho.Team(4, [2.0, 2.02, 2.04, 2.0])
    return ho.Problem(team, ho.HitchStart(SQUARE, 1.2, "balanced"), steps, **options)


def blended(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """All of them without a stop."""
    changed = [type(s)(**{**vars(s), "blend": True}) for s in steps[:-1]]
    return (*changed, steps[-1])


def fastest(plan: ho.Plan, t: float) -> float:
    return float(np.max(np.linalg.norm(plan.at(t).velocities, axis=-1)))


def test_steps_of_all_kinds_are_one_plan_at_rest_in_between() -> None:
    x, y = SQUARE.vertices[1]
    steps: tuple[Step, ...] = (
        *MOVES,
        FollowVertex(1, np.array([[1.5, x + 0.05, y], [3.0, x, y]])),
        Transport(np.array([0.5, 2.2, 1.5]), yaw=0.4),
        Hold(0.5),
    )
    plan = ho.solve(mission(*steps))
    assert [(p.name, p.step) for p in plan.phases] == [(s.name, i) for i, s in enumerate(steps)]
    ends = [phase.end for phase in plan.phases]
    assert [phase.start for phase in plan.phases] == [0.0, *ends[:-1]]
    assert ends[-1] == pytest.approx(plan.duration, abs=1e-12)
    assert max(fastest(plan, end) for end in ends) < 1e-9
    assert ends[4] - ends[3] == pytest.approx(3.0, abs=1e-12)
    assert plan.certificate["continuity"].worst < 1e-9
    names = [check.name for check in plan.certificate.checks]
    assert len(names) == len(set(names))  # one certificate, not one per step


def test_blended_steps_pass_the_hitches_of_the_same_steps_with_stops() -> None:
    stopping, passing = ho.solve(mission(*MOVES)), ho.solve(mission(*blended(MOVES)))
    assert passing.duration < 0.9 * stopping.duration
    for passed, stopped in zip(passing.phases, stopping.phases, strict=True):
        state, rest = passing.at(passed.end), stopping.at(stopped.end)
        assert passed.name == stopped.name
        np.testing.assert_allclose(state.vertices, rest.vertices, atol=1e-6)
        np.testing.assert_allclose(state.legs, rest.legs, atol=1e-6)
    for phase in passing.phases[:-1]:
        assert fastest(passing, phase.end) > 0.1
        assert phase.remark == "continues without a stop"
    assert fastest(passing, passing.duration) < 1e-9
    assert [p.start for p in passing.phases[1:]] == [p.end for p in passing.phases[:-1]]
    assert passing.certificate["continuity"].worst < 1e-9


def test_blends_are_led_along_the_routes_of_their_steps() -> None:
    """The smooth path through the ends alone swings out of the arena, by 2.75 cm."""
    corners = [[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]
    square = ho.Hitch.balanced(ho.Team(4, 2.0), corners, 1.2)
    arena = ho.Arena([-2, -2, 0], [2, 1.31, 3])
    steps = [MoveEdge(3, by=[0, 0.3], blend=True), MoveEdge(1, by=[0, -0.3])]
    free = ho.solve(square, steps)
    assert np.max(free.motion.drones.at(np.linspace(0.0, free.duration, 500))[..., 1]) > 1.31
    plan = ho.solve(square, steps, arena=arena)
    assert plan.certificate.certified
    first, _ = plan.motion.phases
    assert first.remark == "continues without a stop"
    assert fastest(plan, first.end) > 0.05
    end = plan.motion.vertices.at(plan.duration)
    np.testing.assert_allclose(end, free.motion.vertices.at(free.duration), atol=1e-9)


def test_a_blend_that_cannot_be_flown_stops_where_it_has_to_and_says_so() -> None:
    outward = MoveVertex(0, by=np.array([-0.15, 0.03]), blend=True)
    back = MoveVertex(0, by=np.array([0.15, -0.03]))
    plan = ho.solve(mission(outward, back))
    first, second = plan.motion.phases
    assert re.match(r"stops: without a stop, blend: .*", first.remark)
    assert second.remark == ""
    assert fastest(plan, first.end) < 1e-9
    with pytest.raises(ho.InfeasibleError, match=r"omit blend"):
        ho.solve(mission(outward, replace(back, by=np.array([0.9, 0.0]))))


@pytest.mark.parametrize(
    ("turn", "seconds"),
    [
        (-2.0, 6.0),
        (0.4, 1.0),
        *(pytest.param(*x, marks=pytest.mark.slow) for x in ((0.4, 6.0), (-2.0, 1.0))),
    ],
)
def test_transports_blend_and_take_their_duration_at_least(turn: float, seconds: float) -> None:
    """Only the transport is slowed down until it takes as long."""
    goal = np.array([2.2, 2.2, 1.5])
    transport, last = Transport(goal, turn), Transport(goal + [0.3, 0.0, 0.0])
    fast = ho.solve(mission(*blended((MOVES[0], transport, Adjust("spread"), last))))
    timed = replace(transport, duration=seconds)
    plan = ho.solve(mission(*blended((MOVES[0], timed, Adjust("spread"), last))))
    share, least = (x.phases[1].end - x.phases[1].start for x in (plan, fast))
    assert seconds <= share * (1.0 + 1e-9)
    assert share == pytest.approx(max(seconds, least), rel=3e-3)
    assert plan.duration - share < 1.3 * (fast.duration - least)
    for phase in plan.phases[:-1]:
        assert phase.remark == "continues without a stop"
        assert fastest(plan, phase.end) > 0.02
    phase = plan.phases[1]
    times = np.linspace(phase.start, phase.end, 40)
    vertices = plan.motion.vertices.at(times)[..., :2] @ [1.0, 1.0j]
    edges = np.roll(vertices, -1, axis=1) - vertices
    np.testing.assert_allclose(edges[-1], edges[0] * np.exp(1.0j * turn), atol=1e-6)
    lengths = np.abs(edges) / np.abs(edges[0])
    assert np.max(np.abs(lengths - 1.0)) < 0.1  # it swings on from the step before


def with_stops(problem: dict[str, Any]) -> dict[str, Any]:
    """The same steps, each of which stops."""
    steps = [
        {name: {key: value for key, value in keys.items() if key != "blend"}}
        for step in problem["mission"]
        for name, keys in step.items()
    ]
    return {**problem, "mission": steps}


@pytest.mark.parametrize(
    "seed", [1, 7, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 9, 10, 15))]
)
def test_blends_take_their_durations_and_no_longer_than_with_stops(seed: int) -> None:
    problem = random_timed_blend(seed)
    plan, stopping = (
        ho.solve(ho.problem_from_dict(each)) for each in (problem, with_stops(problem))
    )
    assert plan.duration <= stopping.duration + 1e-6
    for index, step in enumerate(problem["mission"]):
        (keys,) = step.values()
        flown = sum(phase.end - phase.start for phase in plan.phases if phase.step == index)
        assert flown >= keys.get("duration", 0.0) - 1e-9
        (last,) = [phase for phase in plan.phases if phase.step == index][-1:]
        is_moving = fastest(plan, last.end) > 1e-6
        assert is_moving == ("continues" in last.remark)
        assert is_moving or not keys.get("blend") or "stops: " in last.remark


def test_hitches_of_blended_steps_are_found_once() -> None:
    step = MoveVertex(0, by=np.array([-0.05, 0.03]), blend=True)
    start = ho.Hitch.balanced(ho.Team(4, 2.0), SQUARE, 1.2)
    task = StepTask(RestState(start.team, start.drones, start), 0, Requirements())
    step_of_blend = BlendedStep(step, task)
    assert step_of_blend.passed.hitches(2) is step_of_blend.passed.hitches(2)
    assert len(step_of_blend.passed.hitches(0)) == 1


def test_a_blend_that_is_not_faster_stops_and_says_so() -> None:
    """Durations that are longer than stops need leave nothing to gain."""
    steps = [with_fields(step, duration=3.0) for step in blended(MOVES[:2])]
    plan = ho.solve(mission(*steps))
    assert plan.duration == pytest.approx(6.0, abs=1e-9)
    assert plan.phases[0].remark == "stops: not faster without a stop (6 s or more, 6 s with)"


def test_steps_that_blend_may_take_longer_than_they_state() -> None:
    """A duration that is too short for a stop is a least one."""
    steps = [with_fields(step, duration=0.1) for step in blended(MOVES[:2])]
    plan = ho.solve(mission(*steps))
    assert plan.duration < ho.solve(mission(*MOVES[:2])).duration
    assert plan.phases[0].remark == "continues without a stop"


VERTEX = blended(MOVES)[0]
NO_MOTION = Adjust("balanced", blend=True)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([VERTEX, Hold(1.0)], r"\.blend = True: must be false before a hold"),
        ([VERTEX, Morph(SQUARE, tension=(0.2, 0.7))], r"mission\[1\]\.morph\.tension = .*: must"),
        ([NO_MOTION, NO_MOTION, MOVES[0]], r"mission\[0\]\.adjust.*with motion"),
    ],
)
def test_what_cannot_be_blended_is_refused(steps: list[Step], words: str) -> None:
    with pytest.raises(ho.InputError, match=words):
        ho.solve(mission(*steps))


def test_errors_name_the_step_that_they_are_of() -> None:
    arena = ho.Arena([-3, -3, 0], [3.9, 5, 2])
    transport = Transport(np.array([3.0, 2.0, 1.2]))
    with pytest.raises(ho.InfeasibleError, match=r"arena: .* at the end of step 1 \(transport\)"):
        ho.solve(mission(MOVES[0], transport, arena=arena))
    short = MoveVertex(0, by=np.array([-0.15, 0.03]), duration=0.1)
    in_step = r"duration: .* in step 1 \(move_vertex\)"
    with pytest.raises(ho.InfeasibleError, match=in_step) as refused:
        ho.solve(mission(Hold(0.1), short))
    assert refused.value.violations[0].step == 1


def test_the_time_of_a_violation_follows_from_its_fields() -> None:
    morph = StepPlace(2, "morph")
    swap = StepPlace(10, "form", "swap 1")
    plain = Violation("legs", 0.1, 0.15, "min", "m", ("q0",), "at t = 1.5 s", "lengthen")
    assert (plain.moment, plain.step) == ("at t = 1.5 s", None)
    moments = {
        "at t = 1.5 s, in step 10 (form, swap 1)": replace(plain, steps=(swap,)),
        "at the end of step 2 (morph)": replace(plain, when=AT_END, steps=(morph,)),
        "in step 2 (morph) of a": replace(plain, when="", steps=(morph,), team="a"),
        "at t = 1.5 s, in step 2 (morph) and 10 (form, swap 1)": replace(
            plain, steps=(morph, swap)
        ),
    }
    for moment, violation in moments.items():
        assert violation.moment == moment
        assert f" at q0 {moment}; lengthen" in str(violation)
        assert violation.to_dict()["when"] == moment


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    """All arrays that a plan holds."""
    if isinstance(value, np.ndarray):
        yield value
    for part in vars(value).values() if is_dataclass(value) else ():
        yield from arrays_in(part)
    for part in value if isinstance(value, tuple) else ():
        yield from arrays_in(part)


def test_nothing_can_be_written_into_a_plan() -> None:
    arrays = [array for array in arrays_in(ho.solve(mission(Hold(1.0)))) if array.size]
    assert len(arrays) > 5
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 7.0


FROM_CACHE = "reused from cache"


def test_after_an_edit_only_what_it_changes_is_planned() -> None:
    def edited(last: float, **options: object) -> ho.Problem:
        transport = Transport(np.array([last, 2.2, 1.3]), 0.2)
        return mission(MOVES[3], Hold(1.0), *blended(MOVES[:2]), transport, **options)

    cache = ho.Cache()

    def solved(problem: ho.Problem, cache: ho.Cache | None = cache) -> tuple[ho.Plan, list[bool]]:
        """Return the plan, and whether each of its four motions is from the cache."""
        reports: list[str] = []
        plan = ho.solve(problem, progress=reports.append, cache=cache)
        parts = [x for x in reports if x == FROM_CACHE or x.startswith("certifying step")]
        return plan, [part == FROM_CACHE for part in parts]

    first, cached = solved(edited(0.3))
    assert cached == [False] * 4
    assert solved(edited(0.4))[1] == [True, True, True, False]
    assert solved(replace(edited(0.4), title="renamed"))[1] == [True] * 4
    assert solved(edited(0.4, limits=ho.Limits(speed=0.99)))[1] == [False] * 4
    again, cached = solved(edited(0.3))
    assert cached == [True] * 4
    anew, cached = solved(edited(0.3), None)  # by default nothing is remembered
    assert cached == [False] * 4
    small = ho.Cache(1)
    assert solved(edited(0.3), small)[1] == solved(edited(0.3), small)[1] == [False] * 4
    contents = [[array.tobytes() for array in arrays_in(plan)] for plan in (first, again, anew)]
    assert contents[0] == contents[1] == contents[2]


def test_requests_of_other_contents_are_told_apart() -> None:
    array = np.arange(6.0).reshape(2, 3)
    alike = [1, 1.0, True, "1", (1,), [1], np.float32(1.0), 0.0, -0.0, np.nextafter(1.0, 2.0)]
    alike += [array, array.reshape(3, 2), np.asfortranarray(array), Release(1.0), Land(1.0)]
    assert len({repr(contents(value)) for value in [*alike, *alike]}) == len(alike)


def test_a_translated_problem_has_the_translated_plan(tmp_path: Path) -> None:
    """Its certificate has the same margins, and its file is proven by the other method too."""
    offset = [195.0, -195.0]

    def planned(offset: list[float]) -> ho.Plan:
        square, to = SQUARE.translated(offset), np.array([0.5, 2.2, 1.5]) + [*offset, 0.0]
        start = ho.HitchStart(square, 1.2, "balanced")
        steps = (MOVES[0], Morph(square.rotated(0.0), "balanced"), Transport(to, yaw=0.4))
        return ho.solve(ho.Problem(ho.Team(4, 2.0), start, steps))

    plan, moved = planned([0.0, 0.0]), planned(offset)
    assert moved.duration == pytest.approx(plan.duration, rel=1e-6)
    for t in np.linspace(0.0, plan.duration, 9):
        there = plan.at(t).positions + [*offset, 0.0]
        np.testing.assert_allclose(moved.at(t).positions, there, atol=1e-6)
    for check in plan.certificate.checks:
        other = moved.certificate[check.name]
        assert other.holds
        assert other.worst == pytest.approx(check.worst, rel=1e-6, abs=1e-6)
    moved.save(tmp_path)
    assert {row.verdict for row in verify.verify(tmp_path)} <= verify.PASSING


def test_problems_far_from_the_origin_are_refused_with_a_remedy() -> None:
    for corner in ([10_000.0, 0.0], [0.0, 1.01 * MAX_COORDINATE]):
        with pytest.raises(ho.InputError, match="subtract an offset from all coordinates"):
            ho.HitchStart(ho.ConvexPolygon(SQUARE.vertices + corner), 1.2, "balanced")
    with pytest.raises(ho.InputError, match="altitude = 1100"):
        ho.HitchStart(SQUARE, 1100.0, "balanced")
    path = [[900.0, *SQUARE.vertices[0]]]  # times may be larger
    assert FollowVertex(0, path).points.tolist() == path
    ho.Arena([-1e3, -1e3, 0.0], [1e3, 1e3, 50.0])
