"""Cables with friction: vertices over-travel to settle."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.forming.steps import Form
from hitchopt.friction import settling
from hitchopt.friction.steps import Settle
from hitchopt.steps import Step
from hitchopt.steps.moving import (
    Adjust,
    FollowVertex,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    Transport,
)

SLIDING = ho.ConvexPolygon([[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]])
WORKED = ho.ConvexPolygon([[3.0, -0.25], [3.65, -1.375], [2.35, -1.375]])
Q = np.array([[2.2, 0.4, 0.9], [3.9, -0.6, 0.9], [2.9, -2.2, 0.9]])
R = np.array([[3.1, 0.5, 0.9], [3.9, -1.6, 0.9], [2.1, -1.8, 0.9]])


def planned(steps: tuple[Step, ...], start: Any, team: ho.Team, kept: Any) -> ho.Plan:
    plan = ho.solve(ho.Problem(team, start, steps, **kept))
    assert plan.certificate.certified
    return plan


def slid(*steps: Step, friction: float = 0.1, **kept: Any) -> ho.Plan:
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=friction)
    return planned(steps, ho.HitchStart(SLIDING, 1.0), team, kept)


def settled(
    *steps: Step, tied: bool = True, friction: float = 0.1, density: float = 0.0, **kept: Any
) -> ho.Plan:
    team = ho.Team(3, 2.4, tension=0.6, cable_friction=friction, cable_density=density)
    start = ho.HitchStart(WORKED, 1.2) if tied else ho.DronesStart(Q, R)
    return planned(steps, start, team, kept)


def moved(x: float, y: float, seconds: float | None, settle: Any = False) -> Step:
    return MoveVertex(0, by=np.array([x, y]), duration=seconds, settle=settle)


MOVE = moved(0.1, 0.3, 4.0)


def test_friction_alone_changes_no_motion() -> None:
    rough, smooth = slid(MOVE), slid(MOVE, friction=0.0)
    t = np.linspace(0.0, smooth.duration, 300)
    np.testing.assert_allclose(rough.at(t).positions, smooth.at(t).positions, atol=1e-12)
    assert rough.duration == smooth.duration
    assert not rough.motion.leg_tensions_differ


def test_a_hitch_settles_by_shrinking_and_growing_less_and_less() -> None:
    plan = settled(Settle())
    assert [phase.name for phase in plan.phases] == ["settle"]
    samples = plan.at(np.linspace(0.0, plan.duration, 8_001))
    np.testing.assert_allclose(samples.vertices[-1], samples.vertices[0], atol=1e-9)
    np.testing.assert_allclose(samples.positions[-1], samples.positions[0], atol=1e-9)
    sides = samples.vertices - np.roll(samples.vertices, 1, axis=1)
    perimeter = np.linalg.norm(sides, axis=-1).sum(axis=1)
    turns = turned(perimeter - perimeter[0])
    np.testing.assert_array_equal(np.sign(turns), -((-1.0) ** np.arange(len(turns))))
    assert np.all(np.abs(turns[2:]) < np.abs(turns[:-2]))  # bands are wider on one side
    resting = samples.t > plan.duration - 0.5
    assert np.max(np.ptp(samples.vertices[resting], axis=0)) < 1e-9
    jerks = np.linalg.norm(samples.jerks, axis=-1)
    assert (
        0.9 * settling.MAX_JERK
        < np.max(jerks)
        < settling.MAX_JERK
        < plan.motion.requirements.limits.jerk
    )


MOVES = (
    Morph(ho.ConvexPolygon(SLIDING.vertices * [1.1, 0.94])),
    MoveVertex(0, by=np.array([0.1, 0.1]), duration=4.0),
    MoveEdge(1, by=np.array([0.0, -0.1])),
    Adjust(np.array([0.45, 0.55, 0.65])),
    FollowVertex(0, np.array([[1.0, 0.0, 0.8], [3.0, 0.05, 0.9]])),
)


@pytest.mark.parametrize("move", MOVES, ids=lambda step: str(step.name))
def test_moves_of_cables_with_friction_end_with_settling(move: Any) -> None:
    """The settled end is the planned one, and the motion before it that of ``settle: false``."""
    worked, left = slid(move), slid(replace(move, settle=False))
    smooth = slid(move, friction=0.0)
    assert [phase.name for phase in worked.phases] == [move.name, "settle"]
    np.testing.assert_allclose(
        worked.at(worked.duration).positions, left.at(left.duration).positions, atol=1e-9
    )
    t = np.linspace(0.0, left.duration, 300)
    np.testing.assert_allclose(worked.at(t).positions, left.at(t).positions, atol=1e-12)
    t = np.linspace(left.duration, worked.duration, 300)
    vertices = worked.at(t).vertices
    assert np.max(np.ptp(vertices, axis=0)) > settling.STEP
    np.testing.assert_allclose(worked.motion.pulls.at(t), 0.5, atol=1e-9)
    np.testing.assert_allclose(vertices[-1], vertices[0], atol=1e-9)
    assert {phase.name for phase in (*left.phases, *smooth.phases)} == {move.name}


OUTWARD = MoveVertex(0, by=np.array([0.05, 0.2]))


def turning_points(plan: ho.Plan, way: Any) -> Any:
    """Return the offsets [m] of vertex 0 along its over-travels where it turns.

    All vertices over-travel in proportion, vertex 0 forward on its way and farthest.
    """
    start, end = plan.phases[-1].start, plan.phases[-1].end
    vertices = plan.at(np.linspace(start, end, 4_001)).vertices[..., :2]
    offsets = (vertices - vertices[0]).reshape(len(vertices), -1)
    sizes, directions = np.linalg.svd(offsets, full_matrices=False)[1:]
    assert sizes[1] < 1e-6 * sizes[0]
    of_vertices = directions[0].reshape(-1, 2)
    ways = np.linalg.norm(of_vertices, axis=-1)
    assert np.argmax(ways) == 0
    along = of_vertices[0] @ way / np.linalg.norm(way)
    assert abs(along) > 0.9 * ways[0]
    return turned(offsets @ directions[0] * np.copysign(ways[0], along))


def turned(offsets: Any) -> Any:
    """Return offsets (samples,) [m] where they turn back, except within 1 µm of zero."""
    rates = np.diff(offsets)
    turns = offsets[1 + np.flatnonzero(rates[1:] * rates[:-1] < 0.0)]
    return turns[np.abs(turns) > 1e-6]


def test_over_travels_alternate_along_the_way_and_decay_and_grow_with_friction() -> None:
    firsts = list[float]()
    for friction in (0.035, 0.07):
        plan = slid(OUTWARD, friction=friction)
        turns = turning_points(plan, OUTWARD.by)
        signs = (-1.0) ** np.arange(len(turns))
        np.testing.assert_array_equal(np.sign(turns), signs)
        sizes = np.append(np.abs(turns), 0.0)
        assert np.all(sizes[2:] < sizes[:-2])
        outward_and_back = np.mean(sizes[:2])  # bands are wider outward
        assert 0.5 * settling.STEP < outward_and_back / len(turns) < settling.STEP + 1e-6
        firsts.append(sizes[0])
        assert f"over-travels {len(turns)} times" in plan.phases[-1].remark
        assert "short" not in plan.phases[-1].remark
        rest = plan.certificate["rest_shift"].worst  # 3 and 7 cm without over-travels
        assert rest < 0.5 * settling.STEP
    assert 1.5 < firsts[1] / firsts[0] < 2.5
    assert sizes[2] > sizes[1]  # friction stops vertices earlier on their way out than back


def test_every_cable_that_slid_slides_back_in_over_travels() -> None:
    """Also that between two vertices that moved by 0.3 of the largest way."""
    goal = SLIDING.vertices + [[0.0, 0.17], [-0.05, -0.01], [0.05, -0.01]]
    plan = slid(Morph(ho.ConvexPolygon(goal)))
    end = plan.phases[0].end
    legs = plan.motion.legs
    slides = legs.at(end) - legs.at(0.0)
    settling_legs = legs.at(np.linspace(end, plan.duration, 2_001)) - legs.at(end)
    assert np.min(np.abs(slides)) > 0.02
    assert np.all(np.max(settling_legs, axis=0) > 0.005)
    assert np.all(np.min(settling_legs, axis=0) < -0.005)


@pytest.mark.slow
def test_a_range_of_friction_needs_no_over_travels_below_its_least(tmp_path: Path) -> None:
    counts = list[int]()
    for friction in (0.1, [0.0, 0.1], [0.1, 0.1]):
        plan = slid(OUTWARD, friction=friction)  # type: ignore[arg-type]
        assert plan.motion.team.friction == 0.1
        counts.append(len(turning_points(plan, OUTWARD.by)))
    assert counts[0] == counts[1] > counts[2] + 1
    plan.save(tmp_path)
    assert verify.main([str(tmp_path)]) == 0
    with pytest.raises(ho.InputError, match=r"cable_friction .* write \[0.1, 0.2\]"):
        ho.Team(3, 2.4, cable_friction=[0.2, 0.1])  # type: ignore[arg-type]


def test_turned_and_mirrored_hitches_over_travel_alike() -> None:
    expected = turning_points(slid(OUTWARD), OUTWARD.by)
    c, s = np.cos(2.0), np.sin(2.0)
    for matrix, order in (([[c, -s], [s, c]], [0, 1, 2]), ([[-1.0, 0.0], [0.0, 1.0]], [0, 2, 1])):
        by = np.array(matrix) @ OUTWARD.by
        start = ho.HitchStart(
            ho.ConvexPolygon((SLIDING.vertices @ np.transpose(matrix))[order]), 1.0
        )
        team = ho.Team(3, 2.4, tension=0.5, cable_friction=0.1)
        plan = planned((replace(OUTWARD, by=by),), start, team, {})
        np.testing.assert_allclose(turning_points(plan, by), expected, atol=1e-4)


@pytest.mark.slow
def test_vertices_over_travel_less_where_limits_bind(tmp_path: Path) -> None:
    """A wall leaves no room for all of it; the remark names the vertex and what may be left."""
    free = slid(OUTWARD)
    highest = np.max(free.at(np.linspace(0.0, free.duration, 999)).positions[..., 1])
    tight = slid(OUTWARD, arena=ho.Arena([-9.0, -9.0, 0.0], [9.0, highest - 0.1, 9.0]))
    sizes = [turning_points(plan, OUTWARD.by)[0] for plan in (free, tight)]
    assert sizes[1] < 0.75 * sizes[0]
    remark = "p0 over-travels .* may rest .* cm short, since larger over-travels break arena: "
    assert re.search(remark, tight.phases[-1].remark)
    tight.save(tmp_path)
    assert verify.main([str(tmp_path)]) == 0


def test_remarks_say_where_polygons_leave_no_room_to_over_travel() -> None:
    """Also where no over-travel moves a vertex against so much friction."""
    nearly_flat = ho.ConvexPolygon([[0.0, 0.75], [0.5, 0.5], [-0.65, -0.375]])
    short = "it may rest .* cm short, .* break (convexity|separation): "
    for friction, words in ((0.2, "p0 over-travels"), (0.8, "p0 does not settle")):
        remark = slid(Morph(nearly_flat), friction=friction).phases[-1].remark
        assert re.match(f"{words}.* {short}", remark)


def test_settling_follows_where_cables_slid_and_stop() -> None:
    """Once after blended steps; not after a transport, or a morph to where the hitch is."""
    blended = replace(MOVES[0], blend=True), moved(0.1, 0.0, None, settle="auto")
    plan = slid(*blended)
    assert [phase.name for phase in plan.phases] == ["morph", "move_vertex", "settle"]
    assert plan.phases[-1].step == 1
    still = Morph(SLIDING), Transport(np.array([0.5, 0.0, 1.4]), yaw=0.35)
    assert [phase.name for phase in slid(*still).phases] == ["morph", "transport"]
    with pytest.raises(ho.InputError, match="settle"):
        slid(replace(blended[0], settle=5.0), blended[1])


def form(settle: Any = "auto") -> Step:
    return Form(WORKED, 1.2, settle=settle)


@pytest.mark.slow
def test_forming_with_friction_ends_with_settling() -> None:
    worked, left, given = (settled(form(each), tied=False) for each in ("auto", False, 30.0))
    smooth = settled(form(), tied=False, friction=0.0)
    assert worked.phases[-1].name == "settle"
    assert given.duration == pytest.approx(left.duration + 30.0)
    assert "settle" not in {phase.name for phase in (*left.phases, *smooth.phases)}
    ends = [plan.at(plan.duration).positions for plan in (worked, left, given)]
    np.testing.assert_allclose(ends, [ends[1]] * 3, atol=1e-9)


@pytest.mark.slow
def test_cables_with_weight_and_the_independent_verifier(tmp_path: Path) -> None:
    plan = settled(Settle(25.0), density=0.01)
    assert plan.duration == pytest.approx(25.0)
    plan.save(tmp_path)
    assert verify.main([str(tmp_path)]) == 0


@pytest.mark.slow
def test_settling_takes_the_time_that_limits_and_over_travels_need() -> None:
    free, slow = settled(Settle()), settled(Settle(), limits=ho.Limits(speed=0.1))
    assert slow.duration > free.duration
    with pytest.raises(ho.InfeasibleError, match=r"duration: .* settle: \d+"):
        settled(Settle(1.0))


@pytest.mark.slow
def test_vertices_without_room_to_over_travel_are_named_or_refused() -> None:
    """Walls that drones just reach; without over-travels, friction holds half of its band.

    The refusal names the walls, and changes of walls and of cables are found and planned.
    """
    still = slid(Hold(1.0)).at(0.0).positions
    walls = ho.Arena(still.min(axis=0) - 0.005, still.max(axis=0) + 0.005)
    loose = ho.Limits(rest_shift=0.5)
    tight = slid(Settle(), arena=walls, limits=loose)
    remark = re.search(r"p\d does not settle; it may rest (.*) cm .* arena", tight.phases[0].remark)
    assert remark is not None
    short = 0.01 * float(remark[1])
    enough, tighter = ho.Limits(vertex_error=short + 0.2), ho.Limits(vertex_error=0.9 * short)
    assert slid(Settle(), arena=walls, limits=enough).phases[0].remark == tight.phases[0].remark
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=0.1)
    start = ho.HitchStart(SLIDING, 1.0)
    refused = ho.Problem(team, start, (Settle(),), arena=walls, limits=tighter)
    with pytest.raises(ho.InfeasibleError, match=r"vertex_error: .* after over-travels") as caught:
        ho.solve(refused)
    vertex_error, *causes = caught.value.violations
    assert vertex_error.value == pytest.approx(short, abs=6e-3)
    assert {cause.constraint for cause in causes} == {"arena", "friction_shift"}
    found = ho.suggestions(refused)
    assert found
    for suggestion in found:
        changed = ho.solve(suggestion.change.problem)
        assert changed.certificate.certified
        assert changed.duration == pytest.approx(suggestion.duration)


NEARLY_FLAT = ho.ConvexPolygon([[0.3, 0.75], [0.8, 0.5], [-0.35, -0.375]])


def test_requested_over_travels_that_leave_vertices_far_off_are_refused() -> None:
    """Automatic ones are planned with a note, and requested ones where a limit allows more."""
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=0.2)
    start = ho.HitchStart(NEARLY_FLAT, 1.0)
    with pytest.raises(ho.InfeasibleError, match=r"rest_shift: .* limit of 0.05 m at p") as caught:
        planned((Settle(),), start, team, {})
    assert caught.value.violations[1].constraint == "convexity"
    accepted = planned((Settle(),), start, team, {"limits": ho.Limits(rest_shift=0.9)})
    assert re.search("it may rest .* cm short", accepted.phases[0].remark)

    sliding = Morph(ho.ConvexPolygon([[0.0, 0.75], [0.5, 0.5], [-0.65, -0.375]]))
    automatic = slid(sliding, Hold(1.0), friction=0.8)
    (note,) = [each for each in automatic.notes if each.startswith("friction may hold p")]
    assert f"{100.0 * automatic.certificate['rest_shift'].worst:.2g} cm off the plan" in note
    with pytest.raises(ho.InfeasibleError, match=r"rest_shift|duration"):
        slid(replace(sliding, settle=30.0), friction=0.8)


@pytest.mark.slow
def test_smoother_cables_are_suggested_where_over_travels_do_not_settle() -> None:
    team = ho.Team(3, 2.4, tension=0.5, cable_friction=(0.1, 0.2))
    refused = ho.Problem(team, ho.HitchStart(NEARLY_FLAT, 1.0), (Settle(),))
    (smoother,) = [
        each for each in ho.suggestions(refused) if each.change.key == "team.cable_friction"
    ]
    least, largest = np.array(smoother.change.edits[0].value)
    assert largest == pytest.approx(2.0 * least, rel=1e-6)
    assert largest < 0.15
    assert ho.solve(smoother.change.problem).certificate.certified


def test_settling_needs_friction() -> None:
    with pytest.raises(ho.InputError, match="settle"):
        settled(Settle(), friction=0.0)
