"""Actions: moving drones, reversibility, and effects of limits."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho

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
    """Names of the drones that move, by dense sampling."""
    places = plan.at(np.linspace(0.0, plan.duration, 501)).positions
    away = np.max(np.linalg.norm(places - places[0], axis=-1), axis=0)
    assert not np.any((away > 1e-9) & (away < 1e-4)), "neither still nor moving"
    return set(np.array(plan.motion.team.drone_names)[away > 1e-9])


def names(n: int, q: list[int], r: list[int]) -> set[str]:
    return {f"q{k % n}" for k in q} | {f"r{k % n}" for k in r}


@pytest.mark.parametrize(("n", "k"), [(3, 2), (4, 1), (9, 5)])
def test_moving_a_vertex_moves_the_four_drones_of_the_paper(n: int, k: int) -> None:
    start = uneven(n)
    plan = ho.solve(start, ho.MoveVertex(k, by=[-0.05, 0.06]))
    assert movers(plan) == names(n, q=[k, k + 1], r=[k - 1, k - 2])
    assert plan.phases[0].remark == ""
    kept = np.ones((n, 2), dtype=bool)
    kept[k, 0] = kept[k - 1, 1] = False  # the two that make up for the edges
    legs = plan.at(np.linspace(0.0, plan.duration, 101)).legs[:, kept]
    np.testing.assert_allclose(legs, np.broadcast_to(start.legs[kept], legs.shape), atol=1e-7)
    moved = np.zeros((n, 3))
    moved[k] = -0.05, 0.06, 0.0
    np.testing.assert_allclose(plan.end.vertices - start.vertices, moved, atol=1e-12)


def test_with_unequal_tensions_legs_turn_with_both_edges_of_their_vertex() -> None:
    """Of p_{k-1} and p_{k+1} both drones move, where the two tensions that meet there differ."""
    start = uneven(6, tension=[0.40, 0.42, 0.42, 0.42, 0.41, 0.41])
    plan = ho.solve(start, ho.MoveVertex(2, by=[-0.04, 0.05]))
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
    [*enumerate(("q0 q1 r0", "q1 r0 q2", "q2 r1 q3 r0", "q3 r2 r1", "r3 r2 q3"))],
)
def test_a_chain_has_no_drones_to_move_beyond_its_ends(k: int, expected: str) -> None:
    """A chain's first and last cable have one leg only, which makes up for its edge."""
    plan = ho.solve(CHAIN, ho.MoveVertex(k, by=[0.01, 0.03]))
    assert movers(plan) == set(expected.split())
    assert plan.phases[0].remark == ""
    back = ho.solve(plan.end, ho.MoveVertex(k, by=[-0.01, -0.03]))
    np.testing.assert_allclose(back.end.drones, CHAIN.drones, atol=1e-9)


@pytest.mark.parametrize(("n", "k"), [(4, 3), (9, 8)])
def test_an_edge_that_slides_moves_four_drones_and_any_other_six(n: int, k: int) -> None:
    start = uneven(n)
    p, u = start.polygon.vertices, start.polygon.edge_directions
    a, b = k, (k + 1) % n
    ends = [p[a] + 0.06 * u[k - 1], p[b] - 0.05 * u[b]]
    four = names(n, q=[k, k + 1], r=[k, k - 1])
    assert movers(ho.solve(start, ho.MoveEdge(k, to=ends))) == four
    six = four | names(n, q=[k + 2], r=[k - 2])
    assert movers(ho.solve(start, ho.MoveEdge(k, by=[0.05, 0.04]))) == six


def test_adjusting_moves_only_the_drones_of_cables_whose_legs_change() -> None:
    start = uneven(6)
    wanted = start.q_legs + [0.0, 0.05, 0.0, 0.0, -0.03, 0.0]
    plan = ho.solve(start, ho.Adjust(wanted))
    assert movers(plan) == {"q1", "r1", "q4", "r4"}
    states = plan.at(np.linspace(0.0, plan.duration, 101))
    still = np.broadcast_to(start.vertices, states.vertices.shape)
    np.testing.assert_allclose(states.vertices, still, atol=1e-12)
    np.testing.assert_allclose(plan.end.q_legs, wanted, atol=1e-12)
    balanced = ho.solve(start, ho.Adjust("balanced")).end
    np.testing.assert_allclose(balanced.legs[:, 0], balanced.legs[:, 1], atol=1e-12)


# fmt: off
THERE_AND_BACK: dict[str, Callable[[ho.Hitch, int], ho.Plan]] = {
    "move_vertex": lambda h, sign: ho.solve(h, ho.MoveVertex(1, by=[0.06 * sign, -0.07 * sign])),
    "move_edge": lambda h, sign: ho.solve(h, ho.MoveEdge(4, by=[0.06 * sign, -0.07 * sign])),
    "adjust": lambda h, sign: ho.solve(h, ho.Adjust("balanced" if sign > 0 else uneven(5).q_legs)),
    "follow_vertex": lambda h, sign: ho.solve(
        h, ho.FollowVertex(0, [[2.0, *(h.vertices[0, :2] - [0.1 * sign, 0.05 * sign])]])),
    "follow_vertex at a speed": lambda h, sign: ho.solve(
        h, ho.FollowVertex(0, [h.vertices[0, :2] - [0.1 * sign, 0.05 * sign]], speed=0.1)),
    "transport": lambda h, sign: ho.solve(
        h, ho.Transport([3.4, -1.2, 1.6] if sign > 0 else [*uneven(5).polygon.centroid, 1.3],
                        yaw=1.1 * sign)),
}
# fmt: on


@pytest.mark.parametrize("name", THERE_AND_BACK)
def test_an_action_and_its_reverse_come_back(name: str) -> None:
    start, action = uneven(5), THERE_AND_BACK[name]
    middle = action(start, 1).end
    assert np.max(np.abs(middle.drones - start.drones)) > 1e-3
    end = action(middle, -1).end
    np.testing.assert_allclose(end.vertices, start.vertices, atol=1e-9)
    np.testing.assert_allclose(end.drones, start.drones, atol=1e-9)


def test_a_binding_limit_gives_the_nearest_slack_split_and_a_remark() -> None:
    """A vertex of a square moves outward: q0 and r3, which follow it, come too close."""
    team = ho.Team(4, 2.0)
    start = ho.Hitch.balanced(team, [[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
    plan = ho.solve(start, ho.MoveVertex(0, by=[0.3, 0.3]))
    end, kept = plan.end, start.q_legs.copy()
    kept[0] = end.slack[0] - start.legs[0, 1]

    def ratio(first: float, last: float) -> float:
        """Their distance over its limit, for legs of cables 0 and 3."""
        places = ho.Hitch(team, end.polygon, 1.0, [first, kept[1], kept[2], last]).drones[[0, 7]]
        return float(np.linalg.norm(places[0] - places[1])) / 0.24

    words = f"separation: {ratio(kept[0], kept[3]):.6g} is below the limit of 1 at q0, r3"
    assert plan.phases[0].remark.startswith("r0, q3 slide as well: ")
    assert words in plan.phases[0].remark
    assert movers(plan) == {"q0", "q1", "r3", "r2", "r0", "q3"}
    # No sharing of the two cables on a grid is nearer and keeps the distances.
    deviation = float(np.sum((end.q_legs - kept) ** 2))
    for d in itertools.product(np.arange(0.16, 0.6, 0.01), repeat=2):
        long = min(*d, end.slack[0] - d[0], end.slack[3] - d[1]) >= 0.15
        near = (d[0] - kept[0]) ** 2 + (d[1] - kept[3]) ** 2 < 0.98 * deviation
        assert not (long and near and ratio(*d) >= 1.0)


@pytest.mark.parametrize("far", [0.3, 0.45])
def test_a_limit_that_binds_only_on_the_path_makes_cables_slide_there(far: float) -> None:
    start = ho.Hitch(ho.Team(6, 2.0), ho.regular_polygon(6, 1.3), 1.0, [0.45] * 6)
    tip = start.vertices[0, 0]
    path = [[4.0, tip + far, 0.0], [5.0, tip + far, 0.0], [9.0, tip, 0.0]]
    plan = ho.solve(start, ho.FollowVertex(0, path))
    assert plan.phases[0].remark.startswith("r0, q5 slide as well: ")
    assert "of the path" in plan.phases[0].remark
    assert movers(plan) == names(6, q=[0, 1, 5], r=[5, 4, 0])
    np.testing.assert_allclose(plan.end.legs, start.legs, atol=1e-9)
    slack = 2.0 - np.linalg.norm(start.vertices[5] - [tip + far, 0.0, 1.0])
    assert slack - 0.45 < 0.15 <= plan.at(4.5).legs[5, 1]  # the kept law's r-leg of cable 5 there
    ends = plan.at([0.0, 9.0])
    np.testing.assert_allclose([ends.velocities, ends.accelerations], 0.0, atol=1e-9)


START = ho.Hitch(
    ho.Team(5, [2.0, 2.05, 2.1, 2.0, 2.02]),
    ho.regular_polygon(5, 1.3, angle=1.2).translated([-2.0, 0.7]),
    1.4,
    [0.33, 0.36, 0.37, 0.34, 0.35],
)
K = 3
HERE = START.vertices[K, :2]
ROWS = [(2.0, 0.08, 0.05), (3.5, 0.15, -0.02), (5.0, 0.15, -0.02), (6.25, 0.05, -0.04)]
POINTS = [[t, *(HERE + [x, y])] for t, x, y in (*ROWS, (9.0, 0.0, 0.03))]


def test_points_are_reached_at_their_times_and_pauses_are_at_rest() -> None:
    plan = ho.solve(START, ho.FollowVertex(K, POINTS))
    assert plan.duration == 9.0
    met = plan.at([t for t, *_ in POINTS]).vertices[:, K]
    np.testing.assert_allclose(met, [[x, y, 1.4] for _, x, y in POINTS], atol=1e-9)
    np.testing.assert_allclose(plan.at([3.5, 4.2, 5.0]).velocities, 0.0, atol=1e-9)
    np.testing.assert_allclose(plan.at([0.0, 3.5, 5.0, 9.0]).accelerations, 0.0, atol=1e-8)
    assert np.max(np.abs(plan.at(2.0).velocities)) > 0.01  # passed, not stopped at
    others = np.delete(plan.at(np.linspace(0.0, 9.0, 200)).vertices, K, axis=1)
    np.testing.assert_allclose(others, np.broadcast_to(others[0], others.shape), atol=1e-12)


CORNERS = [HERE + by for by in ([0.0, 0.06], [0.08, 0.06], [0.08, -0.05])]


@pytest.mark.parametrize("speed", [0.02, 0.1])
@pytest.mark.parametrize("points", [[HERE + [0.12, 0.05]], CORNERS, [HERE, CORNERS[1], HERE]])
def test_a_vertex_keeps_its_speed_on_its_path_through_points(
    points: list[np.ndarray[Any, Any]], speed: float
) -> None:
    plan = ho.solve(START, ho.FollowVertex(K, points, speed=speed))
    times = np.linspace(0.0, plan.duration, 3001)
    places = plan.at(times).vertices[:, K, :2]
    for point in points:
        assert np.min(np.linalg.norm(places - point, axis=1)) < 1.1e-3 * plan.duration * speed
    np.testing.assert_allclose(places[-1], points[-1], atol=1e-9)
    speeds = np.linalg.norm(plan.motion.vertices.at(times, 1)[:, K], axis=-1)
    assert np.max(speeds) <= speed
    stops = np.array([0.0, *(phase.end for phase in plan.phases)])
    assert len(stops) == 2 + (points[-1] is HERE)  # it also stops where it turns back
    np.testing.assert_allclose(plan.at(stops).velocities, 0.0, atol=1e-9)
    ramp = 0.4  # [s] to this speed and back, within the limits of drones
    moving = np.min(np.abs(times[:, None] - stops), axis=1) > ramp
    assert np.min(speeds[moving]) > 0.95 * speed
    others = np.delete(plan.at(times).vertices, K, axis=1)
    np.testing.assert_allclose(others, np.broadcast_to(others[0], others.shape), atol=1e-12)


def test_a_speed_limits_points_with_times_and_is_limited_itself() -> None:
    path, peak = [[4.0, *(HERE + [0.1, 0.0])]], 15.0 / 8.0 * 0.1 / 4.0
    plans = [
        ho.solve(START, ho.FollowVertex(K, path, speed=speed)) for speed in (None, 1.01 * peak)
    ]
    a, b = (plan.motion.vertices.coefficients for plan in plans)
    np.testing.assert_array_equal(a, b)
    even = ho.solve(START, ho.FollowVertex(K, path, speed=0.8 * peak))
    assert even.duration == 4.0
    with pytest.raises(ho.InfeasibleError, match="allow more time for the points, omit") as caught:
        ho.solve(START, ho.FollowVertex(K, path, speed=0.9 * 0.1 / 4.0))
    (fast,) = caught.value.violations
    assert (fast.constraint, fast.where) == ("vertex_speed", (f"p{K}",))
    assert fast.value == pytest.approx(peak, rel=1e-4)
    with pytest.raises(ho.InfeasibleError, match=r"0\.3 m/s is above the limit of 0\.2 m/s at p3"):
        ho.solve(START, ho.FollowVertex(K, CORNERS, speed=0.3), limits=ho.Limits(vertex_speed=0.2))
    for points, words in (
        ([CORNERS[0]], "add times, or the step's speed"),
        ([CORNERS[0], CORNERS[0]], "remove repeated points"),
    ):
        speed = 0.1 if len(points) > 1 else None
        with pytest.raises(ho.InputError, match=rf"^path = .*{words}"):
            ho.solve(START, ho.FollowVertex(K, points, speed=speed))


def test_infeasible_points_are_refused_by_name() -> None:
    plan = ho.solve(START, ho.FollowVertex(K, [[0.0, *HERE], [3.0, *(HERE + [0.1, 0.0])]]))
    assert plan.duration == 3.0
    with pytest.raises(ho.InfeasibleError, match=r"p3 at t = 0.*start there, or later"):
        ho.solve(START, ho.FollowVertex(K, [[0.0, *(HERE + [0.01, 0.0])], [3.0, *HERE]]))
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(START, ho.FollowVertex(K, [[0.4, *(HERE + [0.2, 0.0])]]))
    fast = next(v for v in caught.value.violations if v.constraint == "vertex_speed")
    assert fast.value == pytest.approx(15.0 / 8.0 * 0.2 / 0.4, rel=1e-3)
    assert re.fullmatch(r"at t = 0\.(199|2|201)\S* s, in step 0 \(follow_vertex\)", fast.moment)
    assert fast.remedy.endswith("or allow more time for the points")


KINDS = [ho.Quadrotor(0.13 + 0.01 * k, 2.6) for k in range(4)]
UNLIKE: Any = {"tension": [0.4, 0.42, 0.41, 0.4], "cable_density": 0.003, "quadrotor": KINDS}
TURNED = ho.Hitch(
    ho.Team(4, [2.1, 2.2, 2.15, 2.1], **UNLIKE),
    [[2.6, 1.0], [2.5, -0.1], [1.4, -0.2], [1.5, 1.1]],
    1.3,
    [0.5, 0.55, 0.45, 0.5],
)


@pytest.mark.parametrize("yaw", [0.0, 0.6, -4.7, 4.0 * np.pi])
def test_the_centroid_moves_straight_and_the_hitch_turns_linearly(yaw: float) -> None:
    begin, to = np.append(TURNED.polygon.centroid, 1.3), np.array([1.2, 1.4, 1.9])
    plan = ho.solve(TURNED, ho.Transport(to, yaw=yaw))
    vertices = plan.at(np.linspace(0.0, plan.duration, 301)).vertices
    middle = [[*ho.ConvexPolygon(p[:, :2]).centroid, p[0, 2]] for p in vertices]
    np.testing.assert_allclose(middle[-1], to, atol=1e-9)
    gone, way = np.array(middle) - begin, to - begin
    share = gone @ way / (way @ way)
    np.testing.assert_allclose(gone, share[:, None] * way, atol=1e-6)
    edge = vertices[:, 1] - vertices[:, 0]
    turned = np.unwrap(np.arctan2(edge[:, 1], edge[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(yaw, abs=1e-9)
    np.testing.assert_allclose(turned - turned[0], share * yaw, atol=1e-5)  # on one clock
    np.testing.assert_allclose(plan.end.vertices, vertices[-1], atol=1e-9)


def test_infeasible_transports_name_the_point() -> None:
    """Both ends are inside the arena; halfway through the turn a corner's drone is not."""
    x = TURNED.drones
    around = ho.Arena(x.min(axis=0) - [0.02, 0.02, 0.2], x.max(axis=0) + 0.02)  # edges sag
    with pytest.raises(ho.InfeasibleError, match=r"arena: .* in step 0 \(transport\)"):
        ho.solve(
            TURNED, ho.Transport([*TURNED.polygon.centroid, 1.3], yaw=2.0 * np.pi), arena=around
        )


WILD = Path(__file__).parent / "wild"


@pytest.mark.slow
def test_legs_are_spread_where_the_nearest_ones_cannot_hold() -> None:
    """The morph and the move of a vertex of a chain are refused with the nearest legs."""
    plan = ho.solve(WILD / "steps_of_a_chain.yaml")
    assert plan.certificate.certified


@pytest.mark.parametrize("at", [None, 12.0])
def test_legs_roll_where_they_would_cross_on_the_path_of_a_vertex(at: float | None) -> None:
    """Legs cross if they keep their roll, with any legs at the end and however slow."""
    problem = ho.load_problem(WILD / "writes_an_eight.yaml")
    step = problem.mission[0]
    if at is not None:
        times = np.linspace(0.0, at, len(step.path) + 1)[1:]
        step = replace(step, path=np.column_stack([times, step.path]), speed=None)
    plan = ho.solve(replace(problem, mission=(step,)))
    (phase,) = plan.motion.phases
    assert "legs roll by up to" in phase.remark
    assert at is None or plan.duration == at
    t = np.linspace(0.0, plan.duration, 4001)
    path = plan.motion.vertices.at(t)[:, step.vertex, :2]
    distances = np.linalg.norm(path[:, None] - np.asarray(step.path)[:, -2:], axis=-1)
    assert np.max(np.min(distances, axis=0)) < 1e-3


@pytest.mark.slow
def test_legs_roll_on_the_paths_of_blended_steps() -> None:
    """Legs that keep the roll of the steps' own routes come too close at a joint."""
    plan = ho.solve(WILD / "blends_with_roll.yaml")
    *before, last = plan.motion.phases
    assert all("continues without a stop; legs roll by" in phase.remark for phase in before)
    speeds = [np.linalg.norm(plan.motion.drones.at(phase.end, 1)) for phase in before]
    assert min(speeds) > 0.05
    assert last.name == "morph"
