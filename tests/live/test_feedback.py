"""Feedback in closed loop with a linear hitch, and its reaction to missing measurements."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import UnsupportedError
from hitchopt.lab.feedback import MAX_OFFSET, Cell, cells_of, vertex_responses
from hitchopt.steps.moving import Hold, MoveVertex
from hitchopt.values import Array

STEP = 0.01
STIFF = np.full(6, 4.75)
START = ho.Hitch.spread(ho.Team(3, 2.4), [[1.0, 1.0], [0.6, 2.5], [1.4, 2.5]], 1.0)


@cache
def plan_of() -> ho.Plan:
    """An acute triangle off the origin whose vertex moves for 8 s, at rest before and after."""
    steps = Hold(1.0), MoveVertex(0, by=np.array([0.0, 0.3]), duration=8.0), Hold(6.0)
    return ho.solve(ho.Problem(START.team, START, steps))


@pytest.mark.slow
def test_a_constant_error_is_taken_away_while_vertices_move() -> None:
    """Vertices follow setpoints as in statics, with a lag of 0.4 s, are off and seen 50 ms late."""
    plan, rng = plan_of(), np.random.default_rng(1)
    off = np.array([[0.01, -0.06, -0.1], [0.01, 0.0, -0.12], [-0.01, 0.0, -0.09]])
    times = (np.arange(100) + 0.5) / 100 * plan.duration
    responses = vertex_responses(plan.motion, times, 36.0 * plan.motion.team.mass)
    feedback, moved, seen, sizes = ho.Feedback(plan), np.zeros_like(off), list[Array](), []
    for i in range(int(plan.duration / STEP)):
        time, before = i * STEP, feedback.offsets
        forward = responses[min(int(time / plan.duration * 100), 99)][0]
        moved += STEP / 0.4 * ((forward @ before.ravel()).reshape(-1, 3) - moved)
        seen.append(plan.at(time).vertices + off + moved)
        vertices = seen[max(i - 5, 0)] + rng.normal(0.0, 0.01, off.shape)
        feedback.step(time, STEP, vertices)
        assert np.max(np.linalg.norm(feedback.offsets - before, axis=-1)) <= 0.1 * STEP + 1e-9
        sizes.append(np.linalg.norm(off + moved, axis=-1).mean())
    assert sizes[0] > 0.1
    assert np.mean(sizes[-200:]) < 0.012


def test_vertices_that_rest_in_their_places_change_nothing() -> None:
    plan = plan_of()
    for first, last in ((0.0, 1.0), (10.0, plan.duration)):
        feedback = ho.Feedback(plan, delay=0.0)
        for time in np.linspace(first, last, 40):
            states = plan.at(time)
            here = feedback.step(float(time), STEP, states.vertices, states.positions)
            for name, atol in (("positions", 1e-8), ("velocities", 1e-6), ("accelerations", 1e-6)):
                np.testing.assert_allclose(getattr(here, name), getattr(states, name), atol=atol)


def test_setpoints_lead_vertices_that_move_as_planned() -> None:
    """By 0.4 s, as far as the damped response moves them: friction is to be overcome first."""
    motion, feedback = plan_of().motion, ho.Feedback(plan_of(), delay=0.0)
    for time in np.arange(4.0, 5.0, STEP).tolist():
        feedback.step(time, STEP, motion.vertices.at(time))
    speeds = motion.vertices.at(5.0, 1).ravel()
    ((forward, inverse),) = vertex_responses(motion, 5.0, 36.0 * motion.team.mass)
    led = inverse @ (0.4 * speeds)
    assert np.linalg.norm(feedback.offsets.ravel() - led) < 0.1 * np.linalg.norm(led)
    assert forward @ led @ speeds > 0.0


def test_setpoints_do_not_lead_beyond_the_place_where_a_vertex_stops() -> None:
    """It moves by 0.3 m in 1.5 s, as setpoints do with a lag of 0.4 s."""
    move = MoveVertex(0, by=np.array([0.0, 0.3]), duration=1.5)
    plan = ho.solve(ho.Problem(START.team, START, (move, Hold(2.0))))
    times = (np.arange(50) + 0.5) / 50 * plan.duration
    responses = vertex_responses(plan.motion, times, 36.0 * plan.motion.team.mass)
    feedback, seen, places = ho.Feedback(plan, delay=0.0), plan.at(0.0).vertices, list[float]()
    for i in range(int(plan.duration / STEP)):
        time = i * STEP
        forward = responses[min(int(time / plan.duration * 50), 49)][0]
        led = plan.at(time).vertices + (forward @ feedback.offsets.ravel()).reshape(-1, 3)
        seen = seen + STEP / 0.4 * (led - seen)
        feedback.step(time, STEP, seen)
        places.append(seen[0, 1] - 1.3)
    assert abs(places[-1]) < 0.002
    assert max(places) < 0.013  # a lead by the speed alone overshoots by twice that


def test_missing_or_false_measurements_let_corrections_fade() -> None:
    plan, feedback = plan_of(), ho.Feedback(plan_of(), delay=0.0)
    sizes, there = list[float](), plan.at(0.0).vertices
    feedback.step(0.2, STEP, there + [5.0, 0.0, 0.0])
    assert np.all(feedback.offsets == 0.0)
    for seen, steps in ((-0.05, 300), (np.nan, 100), (None, 1200)):
        vertices = None if seen is None else there + [0.0, 0.0, seen]
        for _ in range(steps):
            feedback.step(0.5, STEP, vertices)
        sizes.append(float(np.max(np.abs(feedback.offsets))))
    grown, some, last = sizes
    assert grown > 0.03
    assert last < 0.05 * grown < some < grown
    feedback.reset()
    assert np.all(feedback.offsets == 0.0)


@pytest.mark.parametrize("missing", [[], [1]])
def test_corrections_do_not_grow_while_a_drone_is_far_from_its_place(missing: list[int]) -> None:
    plan, states = plan_of(), plan_of().at(0.5)
    vertices, drones = states.vertices - [0.0, 0.0, 0.05], states.positions.copy()
    drones[3, 0] += 0.4
    drones[missing] = np.nan
    free, kept = ho.Feedback(plan, delay=0.0), ho.Feedback(plan, delay=0.0)
    for _ in range(200):
        free.step(0.5, STEP, vertices)
        kept.step(0.5, STEP, vertices, drones)
    assert np.max(np.abs(kept.offsets)) < 0.5 * np.max(np.abs(free.offsets))


def test_corrections_are_over_before_the_hitch_is_untied() -> None:
    plan = ho.solve(
        ho.Hitch.spread(ho.Team(3, 2.4), [[0, -0.9], [-0.72, 0.45], [0.72, 0.45]]), ho.Release()
    )
    last = max(phase.end for phase in plan.phases if phase.formed)
    feedback = ho.Feedback(plan, delay=0.0)
    for time in np.append(np.arange(0.0, last, STEP), [last + 0.1] * 20).tolist():
        assert time < last or np.max(np.abs(feedback.offsets)) < 0.005
        feedback.step(time, STEP, plan.at(min(time, last)).vertices - [0.0, 0.0, 0.05])
    assert np.all(np.abs(feedback.offsets) < 1e-12)


def test_what_is_wrong_is_named() -> None:
    plan = plan_of()
    wrong: dict[str, object] = {"rate": 0.0, "reserve": -0.1, "delay": np.nan, "stiffness": -4.0}
    for key, value in ({"plan": "out"} | wrong).items():
        with pytest.raises(ho.InputError, match=key):
            ho.Feedback(**({"plan": plan} | {key: value}))  # type: ignore[arg-type]
    feedback, motion = ho.Feedback(plan), plan.motion
    for key in ("vertices", "drones"):
        with pytest.raises(ho.InputError, match=key):
            feedback.step(0.0, STEP, **{key: np.zeros((2, 3))})  # type: ignore[arg-type]
    wall = ho.Prism([[5, 5], [5, 6], [6, 6], [6, 5]], 0.0, 1.0)
    need = replace(motion.requirements, keep_out=(wall,))
    with pytest.raises(UnsupportedError, match="keep-outs"):
        ho.Feedback(replace(motion, requirements=need))


@pytest.mark.parametrize("topology", ["closed", "open"])
def test_vertices_answer_setpoints_as_in_the_statics(topology: str) -> None:
    """And the damped inverse moves them by less than is asked, never the other way."""
    outline = np.array([[1.0, 1.0], [0.4, 2.3], [1.7, 2.4]])
    if topology == "open":
        outline = np.array([[-1.5, 0.0], [-0.8, 0.9], [0.4, 1.0], [1.3, 0.1]])
    team = ho.Team(3, [2.4, 2.5, 2.3], topology=topology, tension=0.4)
    plan, push = ho.solve(ho.Hitch.spread(team, outline, 1.2), ho.Hold(1.0)), 1e-4
    ((forward, inverse),) = vertex_responses(plan.motion, 0.5, STIFF)
    pushes = push * np.eye(18).reshape(-1, 6, 3)
    given, both = {"stiffness": STIFF, "axial_stiffness": 1e7}, np.stack([pushes, -pushes])
    up, down = ho.equilibrium(plan, 0.5, offsets=both, **given).vertices[:, :, team.layout.clasps]
    expected = (up - down).reshape(len(pushes), -1).T / (2.0 * push)
    np.testing.assert_allclose(forward, expected, atol=2e-3)
    reached = forward @ inverse
    np.testing.assert_allclose(reached, reached.T, atol=1e-9)
    modes = np.linalg.svd(forward, compute_uv=False)[::-1] ** 2
    np.testing.assert_allclose(np.linalg.eigvalsh(reached), modes / (modes + 0.3**2), atol=1e-9)


ALONG = np.linspace(0.0, 1.0, 41)[:, None, None]
LEG_OF = np.array([p for k in range(3) for p in (k, (k + 1) % 3)])
PER_RATIO = np.array([0.24, 0.24, 0.6])


def distances(drones: Array, vertices: Array, away: float) -> tuple[float, float, float]:
    """Separation, distance to cables and shortest leg of a triangle's hitch, cables straight.

    Two drones each, a drone and a cable, or a leg's ends come ``away`` [m] closer to each other.
    """
    apart = drones[:, None] - drones
    steepest = apart / PER_RATIO**2
    steepest /= np.linalg.norm(steepest, axis=-1, keepdims=True) + np.eye(6)[..., None]
    ratio = np.linalg.norm((apart - 2.0 * away * steepest) / PER_RATIO, axis=-1)
    before = np.concatenate([vertices[LEG_OF], vertices])  # six legs, three edges
    after = np.concatenate([drones, np.roll(vertices, -1, axis=0)])
    near = np.linalg.norm((before + ALONG * (after - before))[:, :, None] - drones, axis=-1)
    cables = np.append(np.arange(6) // 2, np.arange(3))[:, None]
    own_leg = (cables == np.arange(6) // 2) & (np.arange(9) < 6)[:, None]
    legs = np.linalg.norm(drones - vertices[LEG_OF], axis=-1)
    least = np.min(ratio + 9.0 * np.eye(6)), np.min(near + 9.0 * own_leg), np.min(legs)
    return float(least[0]), float(least[1]) - 2.0 * away, float(least[2]) - 2.0 * away


@pytest.mark.parametrize("moving", [False, True])
def test_corrections_keep_every_distance_for_any_measurements(*, moving: bool) -> None:
    """Drones and vertices may be off by the reserve besides; a common shift moves both."""
    plan = plan_of() if moving else ho.solve(START, ho.Hold(1.0))
    reserve, rng, found = 0.01 if moving else 0.02, np.random.default_rng(3), []
    breaks, cells = cells_of(plan.motion, reserve, STIFF)
    for k in rng.integers(0, len(cells), 200 if moving else 400).tolist():
        cell, time = cells[k], rng.uniform(breaks[k], breaks[min(k + 2, len(cells))])
        assert cell is not None
        offsets, here = cell.projected(rng.normal(0.0, 0.12, (6, 3))), plan.at(time)
        vertices = here.vertices + offsets.mean(axis=0)
        found.append(distances(here.positions + offsets, vertices, reserve))
    ratio, cable, leg = np.min(found, axis=0)
    assert ratio >= 1.0 - 1e-9
    assert cable >= 0.1 - 1e-9
    assert leg >= 0.15 - 1e-9
    assert moving or cable < 0.12  # they are used


def test_a_hitch_that_turns_leaves_the_room_of_one_that_rests() -> None:
    """Directions that part bodies turn too: cells have to be short."""
    turning, rest = (
        ho.solve(START, ho.Transport(to=[2.5, 1.5, 1.3], yaw=2.0)),
        ho.solve(START, ho.Hold(1.0)),
    )
    rooms = [
        min(float(np.min(cell.bounds)) for cell in cells_of(plan.motion, 0.01, STIFF)[1] if cell)
        for plan in (turning, rest)
    ]
    assert 0.75 * rooms[1] < rooms[0] <= 1.1 * rooms[1]


def test_offsets_stay_within_half_spaces_that_leave_little_room() -> None:
    """More half-spaces than alternating steps satisfy; those within are kept, as small ones are."""
    rng, everywhere = np.random.default_rng(8), np.full(3, np.inf)
    for _ in range(50):
        rows = rng.normal(size=(24, 4, 3))
        rows = (rows - rows.mean(axis=1, keepdims=True)).reshape(24, 12)
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        bounds = rng.uniform(0.0, 0.02, 24)
        cell = Cell(rows, bounds, -everywhere, everywhere, rows, rows)
        asked = rng.normal(0.0, 0.05, (4, 3))
        found = cell.projected(asked)
        own = (found - found.mean(axis=0)).ravel()
        assert np.all(rows @ own <= bounds + 1e-12)
        assert np.linalg.norm(found - found.mean(axis=0), axis=1).max() <= MAX_OFFSET + 1e-12
        np.testing.assert_allclose(found.mean(axis=0), asked.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(cell.projected(found), found, atol=1e-12)
        # Of a single half-space it is the nearest place; what is far off is drawn in.
        one = Cell(rows[:1], bounds[:1], -everywhere, everywhere, rows, rows)
        beyond = max(float(rows[0] @ asked.ravel() - bounds[0]), 0.0)
        nearest = asked - beyond * rows[0].reshape(4, 3)
        np.testing.assert_allclose(one.projected(asked), nearest, atol=1e-12)
        far = one.projected(100.0 * asked)
        assert np.linalg.norm(far - far.mean(axis=0), axis=1).max() <= MAX_OFFSET + 1e-12


def test_the_arena_limits_a_common_correction() -> None:
    plan = ho.solve(plan_of().end, ho.Hold(3.0), arena=ho.Arena([-4, -4, 0], [4, 4, 1.3]))
    feedback, low = ho.Feedback(plan, delay=0.0), plan.end.vertices - [0.0, 0.0, 0.3]
    for time in np.arange(0.0, 3.0, STEP).tolist():
        here = feedback.step(time, STEP, low)
        assert np.max(here.positions[:, 2]) <= 1.3 - 0.01
