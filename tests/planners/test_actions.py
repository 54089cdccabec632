"""Actions: which drones move, that a way and its reverse come back, and what limits change."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.planners.morph.actions import vertex_track

SHAPES = {3: (1.4, 2.5), 4: (1.1, 2.1), 5: (1.3, 2.0), 6: (1.3, 2.0), 9: (1.3, 2.0)}
"""Edge and shortest cable [m] of regular hitches in which drones keep well apart."""


def uneven(n: int, tension: object = 0.4) -> ho.Hitch:
    """A hitch off the origin with unequal cables and legs, edges in no special direction."""
    edge, length = SHAPES[n]
    polygon = ho.regular_polygon(n, edge, angle=0.37).translated([3.0, -1.5])
    team = ho.Team(n, length + 0.01 * np.arange(n), tension=tension)  # type: ignore[arg-type]
    start = ho.Hitch.balanced(team, polygon, 1.3)
    return ho.Hitch(team, polygon, 1.3, start.q_legs + 0.01 * np.cos(np.arange(n)))


def movers(plan: ho.Plan) -> set[str]:
    """Names of the drones that leave their place, by dense sampling."""
    places = plan.at(np.linspace(0.0, plan.duration, 501)).positions
    away = np.max(np.linalg.norm(places - places[0], axis=-1), axis=0)
    assert not np.any((away > 1e-9) & (away < 1e-4)), "neither still nor moving"
    return {
        name for name, moved in zip(plan.motion.team.drone_names, away > 1e-9, strict=True) if moved
    }


def names(n: int, q: list[int], r: list[int]) -> set[str]:
    return {f"q{k % n}" for k in q} | {f"r{k % n}" for k in r}


def end_of(plan: ho.Plan) -> ho.Hitch:
    state = plan.at(plan.duration)
    return ho.Hitch(plan.motion.team, state.vertices[:, :2], state.vertices[0, 2], state.legs[:, 0])


@pytest.mark.parametrize(("n", "k"), [(3, 2), (4, 1), (9, 5)])
def test_moving_a_vertex_moves_the_four_drones_of_the_paper(n: int, k: int) -> None:
    start = uneven(n)
    plan = ho.move_vertex(start, k, by=[-0.05, 0.06])
    assert movers(plan) == names(n, q=[k, k + 1], r=[k - 1, k - 2])
    assert plan.phases[0].remark == ""
    legs = plan.at(np.linspace(0.0, plan.duration, 101)).legs
    kept = np.ones((n, 2), dtype=bool)
    kept[k, 0] = kept[k - 1, 1] = False  # the two that make up for the edges
    np.testing.assert_allclose(
        legs[:, kept], np.broadcast_to(start.legs[kept], (101, 2 * n - 2)), atol=1e-7
    )
    np.testing.assert_allclose(plan.at(plan.duration).legs[kept], start.legs[kept], atol=1e-12)
    state = plan.at(plan.duration)
    moved = state.vertices - start.vertices
    np.testing.assert_allclose(moved[k], [-0.05, 0.06, 0.0], atol=1e-12)
    np.testing.assert_array_equal(np.delete(moved, k, axis=0), 0.0)


def test_where_tensions_differ_legs_turn_with_both_edges_of_their_vertex() -> None:
    """Of p_{k-1} and p_{k+1} both drones move, where the two tensions that meet there differ."""
    start = uneven(6, tension=[0.40, 0.42, 0.42, 0.42, 0.41, 0.41])
    plan = ho.move_vertex(start, 2, by=[-0.04, 0.05])
    # p_1 holds cables 0 and 1 (unequal), p_3 cables 2 and 3 (equal).
    assert movers(plan) == names(6, q=[2, 3, 1], r=[1, 0])
    assert plan.phases[0].remark.startswith("q1 turns as well: tensions differ")


CHAIN = ho.Hitch.spread(
    ho.Team(4, [2.4, 1.8, 1.9, 2.3], topology="open"),
    [[-2.5, -0.3], [-1.0, 0.7], [0.0, 1.0], [1.1, 0.7], [2.5, -0.3]],
    0.8,
)


@pytest.mark.parametrize(
    ("k", "expected"),
    [
        (0, {"q0", "q1", "r0"}),  # cable 0 has one leg only, which makes up for its edge
        (1, {"q1", "r0", "q2"}),
        (2, {"q2", "r1", "q3", "r0"}),
        (3, {"q3", "r2", "r1"}),
        (4, {"r3", "r2", "q3"}),
    ],
)
def test_in_a_chain_the_drones_beyond_its_ends_are_left_out(k: int, expected: set[str]) -> None:
    plan = ho.move_vertex(CHAIN, k, by=[0.01, 0.03])
    assert movers(plan) == expected
    assert plan.phases[0].remark == ""
    back = ho.move_vertex(end_of(plan), k, by=[-0.01, -0.03])
    np.testing.assert_allclose(end_of(back).drones, CHAIN.drones, atol=1e-9)


@pytest.mark.parametrize(("n", "k"), [(4, 3), (9, 8)])
def test_an_edge_that_slides_moves_four_drones_and_any_other_six(n: int, k: int) -> None:
    start = uneven(n)
    p, u = start.polygon.vertices, start.polygon.edge_directions
    a, b = k, (k + 1) % n
    ends = [p[a] + 0.06 * u[k - 1], p[b] - 0.05 * u[b]]
    four = names(n, q=[k, k + 1], r=[k, k - 1])
    assert movers(ho.move_edge(start, k, to=ends)) == four
    six = four | names(n, q=[k + 2], r=[k - 2])
    assert movers(ho.move_edge(start, k, by=[0.05, 0.04])) == six


def test_adjusting_moves_only_the_drones_of_cables_whose_legs_change() -> None:
    start = uneven(6)
    wanted = start.q_legs + [0.0, 0.05, 0.0, 0.0, -0.03, 0.0]
    plan = ho.adjust(start, wanted)
    assert movers(plan) == {"q1", "r1", "q4", "r4"}
    states = plan.at(np.linspace(0.0, plan.duration, 101))
    still = np.broadcast_to(start.vertices, states.vertices.shape)
    np.testing.assert_allclose(states.vertices, still, atol=1e-12)
    np.testing.assert_allclose(end_of(plan).q_legs, wanted, atol=1e-12)
    balanced = end_of(ho.adjust(start, "balanced"))
    np.testing.assert_allclose(balanced.legs[:, 0], balanced.legs[:, 1], atol=1e-12)


THERE_AND_BACK: list[tuple[Callable[[ho.Hitch], ho.Plan], Callable[[ho.Hitch], ho.Plan]]] = [
    (
        lambda h: ho.move_vertex(h, 1, by=[0.06, -0.07]),
        lambda h: ho.move_vertex(h, 1, by=[-0.06, 0.07]),
    ),
    (
        lambda h: ho.move_edge(h, 4, by=[0.06, -0.07]),
        lambda h: ho.move_edge(h, 4, by=[-0.06, 0.07]),
    ),
    (
        lambda h: ho.adjust(h, "balanced"),
        lambda h: ho.adjust(h, uneven(5).q_legs),
    ),
    (
        lambda h: ho.follow_vertex(h, 0, [[2.0, *(h.vertices[0, :2] - [0.1, 0.05])]]),
        lambda h: ho.follow_vertex(h, 0, [[2.0, *(h.vertices[0, :2] + [0.1, 0.05])]]),
    ),
    (
        lambda h: ho.transport(h, [3.4, -1.2, 1.6], yaw=1.1),
        lambda h: ho.transport(h, [*uneven(5).polygon.centroid, 1.3], yaw=-1.1),
    ),
]


@pytest.mark.parametrize(
    ("there", "back"),
    THERE_AND_BACK,
    ids=["move_vertex", "move_edge", "adjust", "follow_vertex", "transport"],
)
def test_an_action_and_its_reverse_come_back(
    there: Callable[[ho.Hitch], ho.Plan], back: Callable[[ho.Hitch], ho.Plan]
) -> None:
    start = uneven(5)
    out = there(start)
    middle = end_of(out)
    assert np.max(np.abs(middle.drones - start.drones)) > 1e-3
    end = end_of(back(middle))
    np.testing.assert_allclose(end.vertices, start.vertices, atol=1e-9)
    np.testing.assert_allclose(end.legs, start.legs, atol=1e-9)
    np.testing.assert_allclose(end.drones, start.drones, atol=1e-9)


def test_where_a_limit_binds_the_nearest_sharing_is_taken_and_said() -> None:
    """A vertex of a square pushed out: the drones that stay with it come too close."""
    team = ho.Team(4, 2.0)
    square = [[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]
    start = ho.Hitch.balanced(team, square)
    plan = ho.move_vertex(start, 0, by=[0.3, 0.3])
    end = end_of(plan)
    outline = end.polygon
    kept = start.q_legs.copy()
    kept[0] = end.slack[0] - start.legs[0, 1]
    closest = ho.Hitch(team, outline, 1.0, kept).drones
    ratio = float(np.linalg.norm(closest[0] - closest[7])) / 0.24  # q0 and r3
    assert ratio < 1.0
    words = f"separation: {ratio:.6g} is below the limit of 1 at q0, r3"
    assert words in plan.phases[0].remark
    assert plan.phases[0].remark.startswith("r0, q3 slide as well: ")
    assert movers(plan) == {"q0", "q1", "r3", "r2", "r0", "q3"}
    # No sharing of the two cables on a grid is nearer and keeps the distances.
    deviation = float(np.sum((end.q_legs - kept) ** 2))
    nearer = [
        d
        for d in itertools.product(np.arange(0.16, 0.6, 0.01), repeat=2)
        if (d[0] - kept[0]) ** 2 + (d[1] - kept[3]) ** 2 < 0.98 * deviation
        and min(d[0], d[1], end.slack[0] - d[0], end.slack[3] - d[1]) >= 0.15
        and np.linalg.norm(
            np.subtract(
                *ho.Hitch(team, outline, 1.0, [d[0], kept[1], kept[2], d[1]]).drones[[0, 7]]
            )
        )
        >= 0.24
    ]
    assert nearer == []


@pytest.mark.parametrize("far", [0.3, 0.45])
def test_a_limit_that_binds_on_the_way_only_lets_cables_slide_there(far: float) -> None:
    start = ho.Hitch(ho.Team(6, 2.0), ho.regular_polygon(6, 1.3), 1.0, [0.45] * 6)
    tip = start.vertices[0, 0]
    plan = ho.follow_vertex(
        start, 0, [[4.0, tip + far, 0.0], [5.0, tip + far, 0.0], [9.0, tip, 0.0]]
    )
    remark = plan.phases[0].remark
    assert remark.startswith("r0, q5 slide as well: ")
    assert "of the path" in remark
    assert movers(plan) == names(6, q=[0, 1, 5], r=[5, 4, 0])
    np.testing.assert_allclose(end_of(plan).legs, start.legs, atol=1e-9)
    state = plan.at(4.5)
    slack = 2.0 - np.linalg.norm(start.vertices[5] - [tip + far, 0.0, 1.0])
    assert slack - 0.45 < 0.15  # the kept law's r-leg of cable 5 there
    assert state.legs[5, 1] >= 0.15
    for t in (0.0, 9.0):
        np.testing.assert_allclose(plan.at(t).velocities, 0.0, atol=1e-9)
        np.testing.assert_allclose(plan.at(t).accelerations, 0.0, atol=1e-9)


def test_a_duration_is_met_exactly_or_refused() -> None:
    start = uneven(5)
    for plan in (
        ho.move_vertex(start, 0, by=[-0.05, 0.0], duration=3.125),
        ho.move_edge(start, 0, by=[-0.05, 0.0], duration=3.125),
        ho.adjust(start, duration=3.125),
        ho.transport(start, [3.0, -1.0, 1.5], duration=3.125),
    ):
        assert plan.duration == 3.125
    with pytest.raises(ho.InfeasibleError, match=r"duration: 0\.2 s is below .* \(move_edge\)"):
        ho.move_edge(start, 0, by=[-0.05, 0.0], duration=0.2)


def test_wrong_arguments_are_told_by_their_own_names() -> None:
    start = uneven(5)
    with pytest.raises(ho.InputError, match=r"^vertex = 5: must be from 0 to 4"):
        ho.move_vertex(start, 5, by=[0.0, 0.1])
    with pytest.raises(ho.InputError, match=r"^edge = -1: must be a whole number, at least 0"):
        ho.move_edge(start, -1, by=[0.0, 0.1])
    with pytest.raises(ho.InputError, match=r"^to = None: must be given where by is not"):
        ho.move_vertex(start, 0)
    with pytest.raises(ho.InputError, match=r"^to = .*: must be given where by is not"):
        ho.move_vertex(start, 0, to=[1.0, 1.0], by=[1.0, 1.0])
    with pytest.raises(
        ho.InputError, match=r"^by = \[-5\.0, 3\.0\]: must be such that the outline"
    ):
        ho.move_vertex(start, 0, by=[-5.0, 3.0])
    with pytest.raises(ho.InputError, match=r"^to = .*: must be two points"):
        ho.move_edge(start, 0, to=[1.0, 1.0])
    with pytest.raises(ho.InputError, match=r"^path = .*: must be a path whose times increase"):
        ho.follow_vertex(start, 0, [[2.0, 3.0, 1.0], [1.0, 3.0, 1.0]])
    with pytest.raises(ho.InputError, match=r"^to = .*: must be a point \[x, y, z\]"):
        ho.transport(start, [1.0, 1.0])
    with pytest.raises(ho.InputError, match=r"^yaw = nan: must be finite"):
        ho.transport(start, [1.0, 1.0, 1.0], yaw=float("nan"))


START = ho.Hitch(
    ho.Team(5, [2.0, 2.05, 2.1, 2.0, 2.02]),
    ho.regular_polygon(5, 1.3, angle=1.2).translated([-2.0, 0.7]),
    1.4,
    [0.33, 0.36, 0.37, 0.34, 0.35],
)
K = 3
HERE = START.vertices[K, :2]
OFFSETS = [
    (2.0, 0.08, 0.05),
    (3.5, 0.15, -0.02),
    (5.0, 0.15, -0.02),
    (6.25, 0.05, -0.04),
    (9.0, 0.0, 0.03),
]
POINTS = [[t, *(HERE + [dx, dy])] for t, dx, dy in OFFSETS]


def test_points_are_met_at_their_times_and_standing_stands() -> None:
    plan = ho.follow_vertex(START, K, POINTS)
    assert plan.duration == 9.0
    for t, x, y in POINTS:
        np.testing.assert_allclose(plan.at(t).vertices[K], [x, y, 1.4], atol=1e-9)
    for t in (3.5, 4.2, 5.0):
        np.testing.assert_allclose(plan.at(t).velocities, 0.0, atol=1e-9)
    for t in (0.0, 3.5, 5.0, 9.0):
        np.testing.assert_allclose(plan.at(t).accelerations, 0.0, atol=1e-8)
    assert np.max(np.abs(plan.at(2.0).velocities)) > 0.01  # passed, not stopped at
    others = np.delete(plan.at(np.linspace(0.0, 9.0, 200)).vertices, K, axis=1)
    np.testing.assert_allclose(others, np.broadcast_to(others[0], others.shape), atol=1e-12)


def test_two_points_are_the_minimum_jerk_polynomial() -> None:
    plan = ho.follow_vertex(START, K, [[4.0, *(HERE + [0.1, -0.05])]])
    x = np.linspace(0.0, 1.0, 101)
    progress = 10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5
    expected = HERE + progress[:, None] * [0.1, -0.05]
    np.testing.assert_allclose(plan.at(4.0 * x).vertices[:, K, :2], expected, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
@settings(max_examples=30)
def test_between_rests_no_wiggle_of_the_track_has_less_jerk(seed: int, count: int) -> None:
    """Adding what vanishes at the points, and with two derivatives at the ends, only adds jerk."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, count))
    places = rng.normal(size=(count, 2))
    track = vertex_track(times, places)
    np.testing.assert_allclose(track.at(times), places, atol=1e-9)
    t = np.linspace(times[0], times[-1], 4001)
    x = (t - times[0]) / (times[-1] - times[0])
    rest = np.poly1d([1.0, -1.0, 0.0]) ** 3  # x³(x-1)³
    inner = np.poly1d((times[1:-1] - times[0]) / (times[-1] - times[0]), r=True)
    wiggle = rest * inner
    scale = np.max(np.abs(wiggle(x)))
    jerk = track.at(t, 3)
    bump = wiggle.deriv(3)(x) / (scale * (times[-1] - times[0]) ** 3)
    least = np.trapezoid(np.sum(jerk**2, axis=1), t)
    for size in (-0.1, 0.01, 0.1):
        wiggled = np.trapezoid((jerk[:, 0] + size * bump) ** 2 + jerk[:, 1] ** 2, t)
        assert wiggled > least


def test_a_point_at_no_time_has_to_be_where_the_vertex_is() -> None:
    plan = ho.follow_vertex(START, K, [[0.0, *HERE], [3.0, *(HERE + [0.1, 0.0])]])
    assert plan.duration == 3.0
    with pytest.raises(ho.InfeasibleError, match=r"p3 at t = 0.*begin there, or later"):
        ho.follow_vertex(START, K, [[0.0, *(HERE + [0.01, 0.0])], [3.0, *HERE]])


def test_too_fast_points_name_the_check_and_the_time() -> None:
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.follow_vertex(START, K, [[0.4, *(HERE + [0.2, 0.0])]])
    fast = next(v for v in caught.value.violations if v.constraint == "vertex_speed")
    assert fast.value == pytest.approx(15.0 / 8.0 * 0.2 / 0.4, rel=1e-3)
    found = re.fullmatch(r"at t = (\S+) s, in step 0 \(follow_vertex\)", fast.when)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.2, abs=0.002)  # a flat maximum
    assert fast.remedy.endswith("or give the points more time")


TURNED = ho.Hitch(
    ho.Team(
        4,
        [2.1, 2.2, 2.15, 2.1],
        tension=[0.4, 0.42, 0.41, 0.4],
        cable_density=0.003,
        quadrotor=[ho.Quadrotor(0.13 + 0.01 * k, 2.6) for k in range(4)],
    ),
    [[2.6, 1.0], [2.5, -0.1], [1.4, -0.2], [1.5, 1.1]],
    1.3,
    [0.5, 0.55, 0.45, 0.5],
)


def centroid(points: np.ndarray) -> np.ndarray:
    """Of the area, by a fan of triangles about the origin of coordinates."""
    following = np.roll(points, -1, axis=0)
    double = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    return np.asarray(((points + following) * double[:, None]).sum(axis=0) / (3.0 * double.sum()))


@pytest.mark.parametrize("yaw", [0.0, 0.6, -4.7, 4.0 * np.pi])
def test_the_centroid_goes_straight_and_the_hitch_turns_all_the_way(yaw: float) -> None:
    to = np.array([1.2, 1.4, 1.9])
    plan = ho.transport(TURNED, to, yaw=yaw)
    state = plan.at(np.linspace(0.0, plan.duration, 601))
    middle = np.array([centroid(p[:, :2]) for p in state.vertices])
    first = np.array([*centroid(TURNED.polygon.vertices), 1.3])
    np.testing.assert_allclose(middle[-1], to[:2], atol=1e-9)
    gone = np.column_stack([middle, state.vertices[:, 0, 2]]) - first
    line = (to - first) / np.linalg.norm(to - first)
    np.testing.assert_allclose(gone, (gone @ line)[:, None] * line, atol=1e-6)
    np.testing.assert_allclose(state.vertices[-1, :, 2], 1.9, atol=1e-12)
    edge = state.vertices[:, 1] - state.vertices[:, 0]
    turned = np.unwrap(np.arctan2(edge[:, 1], edge[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(yaw, abs=1e-9)
    # Turning and going share one clock.
    share = gone @ line / np.linalg.norm(to - first)
    np.testing.assert_allclose(turned - turned[0], share * yaw, atol=1e-5)


def test_thrust_holds_weight_pull_and_acceleration_on_the_climb() -> None:
    plan = ho.transport(TURNED, [*TURNED.polygon.centroid, 2.1])
    state = plan.at(np.linspace(0.0, plan.duration, 2001))
    team = TURNED.team
    leg = state.positions - np.repeat(state.vertices, 2, axis=1)
    leg[:, 1::2] = state.positions[:, 1::2] - np.roll(state.vertices, -1, axis=1)
    length, half = np.linalg.norm(leg, axis=-1), 0.5 * 9.81 * 0.003
    pull = np.repeat(team.tension, 2) + half * leg[..., 2]  # tension grows with height
    weight = 9.81 * team.mass + half * length
    thrust = team.mass[:, None] * state.accelerations + (pull / length)[..., None] * leg
    thrust[..., 2] += weight
    largest = float(np.max(np.linalg.norm(thrust, axis=-1)))
    assert plan.certificate["thrust"].worst == pytest.approx(largest, rel=1e-3)
    assert largest > np.max(np.hypot(weight, np.repeat(team.tension, 2))) + 0.1  # more than at rest


def test_where_it_cannot_go_is_told() -> None:
    arena = ho.Arena([-4, -4, 0], [4, 4, 2])
    with pytest.raises(ho.InfeasibleError, match=r"arena: .*end of step 0 \(transport\)"):
        ho.transport(TURNED, [1.2, 1.4, 2.1], arena=arena)
    with pytest.raises(ho.InfeasibleError, match=r"arena: .* in step 0 \(transport\)"):
        # Both ends are inside; half way through the turn a corner's drone is not.
        ho.transport(TURNED, [*TURNED.polygon.centroid, 1.3], yaw=2.0 * np.pi, arena=inside(TURNED))


def inside(hitch: ho.Hitch) -> ho.Arena:
    """A box just about the hitch as it stands."""
    drones = hitch.drones
    return ho.Arena(drones.min(axis=0) - 0.02, drones.max(axis=0) + 0.02)
