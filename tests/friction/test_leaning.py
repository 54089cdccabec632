"""Cables with friction: legs lean where they slide, and vertices over-travel to settle."""

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
from hitchopt.friction.leaning import (
    DISTANCE_FACTOR,
    MAX_LEAN,
    FrictionFeedforward,
    friction_feedforward,
)
from hitchopt.friction.steps import Settle
from hitchopt.motion.motion import Motion
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
from tests.helpers.clasp_balance import unit

POLYGON = np.array([[2.0, 0.3], [1.2, -1.0], [0.1, -0.4], [0.5, 0.6]])
GOAL = np.array([[2.2, 0.4], [1.2, -1.0], [0.1, -0.4], [0.45, 0.75]])
LENGTHS, TENSIONS = [2.9, 2.8, 2.7, 3.0], [0.5, 0.45, 0.55, 0.5]


def morphed() -> Motion:
    """A morph without friction and with constant fractions, so that laws are exact."""
    start = ho.Hitch.balanced(ho.Team(4, LENGTHS, tension=TENSIONS), POLYGON, altitude=1.2)
    motion = ho.morph(start, GOAL, legs="balanced", duration=4.0).motion
    assert isinstance(motion, Motion)
    return motion


def leaned(motion: Motion, friction: float = 0.1, share: float = 1.0) -> FrictionFeedforward:
    rubbing = replace(motion, team=replace(motion.team, cable_friction=friction))
    found = friction_feedforward(rubbing, share, slower=True)
    assert found is not None
    return found


@pytest.mark.parametrize("friction", [0.05, 0.3])
def test_growing_legs_have_higher_tensions_within_friction(friction: float) -> None:
    motion = leaned(morphed(), friction).motion
    inner = motion.duration * np.linspace(0.2, 0.8, 121)
    rates = motion.legs.at(inner, 1).reshape(len(inner), -1)
    ratio = np.log(motion.pulls.at(inner) / np.repeat(motion.tensions.at(inner), 2, axis=1))
    sliding = np.abs(rates) > 0.3 * np.max(np.abs(rates))
    assert np.sum(sliding) > 100
    assert np.all(np.sign(rates[sliding]) == np.sign(ratio[sliding]))
    assert np.max(np.abs(ratio)) > 0.2 * friction
    assert np.max(np.abs(ratio)) < np.pi * friction


def test_a_cable_that_slides_alone_expects_the_friction_of_its_whole_twist() -> None:
    """The resting cable of its clasp bears what of this friction is along it, on the other side.

    With unequal tensions the weaker cable turns by more than the other one.
    """
    team = ho.Team(4, LENGTHS, tension=[0.5, 0.42, 0.58, 0.5], cable_friction=0.03)
    start = ho.Hitch.balanced(team, POLYGON, altitude=1.2)
    motion = ho.solve(
        start, ho.Adjust(start.legs[:, 0] + [0.0, 0.1, 0.0, 0.0], duration=6.0)
    ).motion
    ratio = np.log(motion.pulls.at(3.0).reshape(4, 2) / motion.tensions.at(3.0)[:, None])
    p, x = motion.vertices.at(3.0), start.drones

    def turn(cable: int, end: int) -> float:
        """Return the angle by which a cable turns at the clasp of its q or r."""
        at, other = (cable + end) % 4, (cable + 1 - end) % 4
        arriving, leaving = unit(p[at] - x[2 * cable + end]), unit(p[other] - p[at])
        return float(np.arccos(arriving @ leaving))

    for end, sign in ((0, 1.0), (1, -1.0)):  # both of cable 1, one let out, one drawn in
        resting = 2 * end, 1 - end
        turns = turn(1, end), turn(*resting)
        bends = np.pi * np.sin(0.5 * np.array(turns))
        alone = sign * 0.03 / 1.1  # a tenth of the largest speed counts as still
        assert ratio[1, end] == pytest.approx(alone * bends[0], rel=0.03)
        assert ratio[resting] == pytest.approx(-alone * bends[1] * np.mean(np.cos(turns)), rel=0.1)
    assert np.max(np.abs(ratio[3])) < 1e-9


@pytest.mark.parametrize("friction", [0.05, 2.0])
def test_leans_are_limited_and_drones_keep_their_distances(friction: float) -> None:
    """At large friction both limits bind: a sharp vertex would lock."""
    plain = morphed()
    found, s, layout = leaned(plain, friction), np.linspace(0.0, 1.0, 401), plain.team.layout
    motions = (found.motion, plain)
    places = [m.drones.at(s * m.duration) for m in motions]
    here, there = (
        unit(x - m.vertices.at(s * m.duration)[:, layout.anchors])
        for x, m in zip(places, motions, strict=True)
    )
    most = np.max(np.arccos(np.clip(np.sum(here * there, axis=-1), -1.0, 1.0)))
    assert most <= MAX_LEAN * 1.05
    assert found.lean == pytest.approx(most, rel=0.02)
    pairs = [x[:, 2 * layout.ahead] - x[:, 2 * layout.behind + 1] for x in places]
    gaps = [np.linalg.norm(pair, axis=-1) / 0.24 for pair in pairs]
    assert np.all(gaps[0] >= np.minimum(gaps[1], DISTANCE_FACTOR) - 0.01)


def test_the_lean_is_proportional_to_the_expected_friction() -> None:
    turned = [leaned(morphed(), 0.04, share).lean for share in (0.25, 0.5, 1.0)]
    np.testing.assert_allclose(turned[1:], [2.0 * turned[0], 4.0 * turned[0]], rtol=0.1)


SLIDING = ho.ConvexPolygon([[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]])
WORKED = ho.ConvexPolygon([[3.0, -0.25], [3.65, -1.375], [2.35, -1.375]])
Q = np.array([[2.2, 0.4, 0.9], [3.9, -0.6, 0.9], [2.9, -2.2, 0.9]])
R = np.array([[3.1, 0.5, 0.9], [3.9, -1.6, 0.9], [2.1, -1.8, 0.9]])
LEANING = "legs lean against friction, by up to"


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


@pytest.mark.parametrize(
    ("step", "friction", "cable", "leans"),
    [
        (MOVE, 1e-3, 0.1, False),  # too little to lean for
        (MOVE, 0.1, 0.0, True),
        (moved(0.0, 0.4, 8.0), 0.3, 0.1, True),
    ],
)
def test_remarks_say_whether_legs_lean(
    step: Step, friction: float, cable: float, leans: bool
) -> None:
    plan = slid(step, friction=friction, separation=ho.Separation(cable=cable))
    remark = plan.phases[0].remark
    assert LEANING in remark if leans else "lean" not in remark
    assert "limits bind" not in remark
    assert plan.motion.leg_tensions_differ == leans


def test_legs_lean_less_if_less_friction_moved_vertices_off_their_ways() -> None:
    free = slid(MOVE, limits=ho.Limits(tracking=0.05))
    allowed = 0.8 * free.certificate["friction_shift"].worst
    tight = slid(MOVE, limits=ho.Limits(tracking=allowed))
    assert tight.certificate["friction_shift"].worst <= allowed
    assert re.search("% of the friction: limits bind", tight.phases[0].remark)


def test_only_the_steps_that_slide_lean() -> None:
    turned = Transport(np.array([0.5, 0.0, 1.4]), yaw=0.35)
    plan = slid(Hold(0.5), MOVE, turned, Adjust("balanced", duration=4.0, settle=False))
    assert [LEANING in phase.remark for phase in plan.phases] == [False, True, False, True]
    for phase in plan.phases[::2]:
        t = np.linspace(phase.start, phase.end, 50)
        np.testing.assert_allclose(plan.motion.pulls.at(t), 0.5, atol=1e-9)
    assert np.ptp(plan.motion.pulls.at(np.linspace(0.0, plan.duration, 2_000))) > 0.02


def test_legs_lean_less_near_their_limits() -> None:
    """A tilt limit just above that of the hitch at rest lets no leg pull much harder."""
    inward, t = moved(0.0, -0.25, 6.0), np.linspace(0.0, 6.0, 2_000)
    free = slid(inward)
    most, least = (p.certificate["tilt"].worst for p in (free, slid(inward, friction=0.0)))
    assert most > least + 0.1
    tight = slid(inward, limits=ho.Limits(tilt=np.radians(0.5 * (most + least))))
    assert "limits bind" in tight.phases[0].remark
    ratios = [np.max(np.abs(plan.motion.pulls.at(t) - 0.5)) for plan in (tight, free)]
    assert 0.0 < ratios[0] < ratios[1]


def test_motions_whose_lean_would_violate_limits_have_none() -> None:
    """Within walls that the drones just reach; vertices move as without friction."""
    step, t = moved(0.2, 0.0, 4.0), np.linspace(0.0, 4.0, 4_001)
    plain, free = slid(step, friction=0.0).at(t), slid(step).at(t)
    np.testing.assert_allclose(free.vertices, plain.vertices, atol=1e-9)
    away = np.linalg.norm(free.positions - plain.positions, axis=-1)
    np.testing.assert_allclose(away[[0, -1]], 0.0, atol=1e-7)
    assert 0.01 < np.max(away) < 0.2
    places = plain.positions.reshape(-1, 3)
    plan = slid(step, arena=ho.Arena(places.min(axis=0) - 1e-4, places.max(axis=0) + 1e-4))
    assert "clasp friction is not compensated: limits bind" in plan.phases[0].remark
    np.testing.assert_array_equal(plan.at(t).positions, plain.positions)


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
    """The settled end is the planned one, and the motion before it that of ``settle: false``.

    Vertices over-travel, by moves in which no leg leans.
    """
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
        assert (plan.motion.team.friction, LEANING in plan.phases[0].remark) == (0.1, True)
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
