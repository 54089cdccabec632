"""Feedback in a loop with a hitch that answers linearly, and its reaction to what is missing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import InputError, UnsupportedError
from hitchopt.feedback.feedback import LEAD
from hitchopt.feedback.vertex_response import vertex_response
from hitchopt.values import Array

STEP = 0.01
DELAYED = 5


@cache
def plan_of() -> ho.Plan:
    """An acute triangle off the origin whose vertex moves for 8 s, at rest before and after."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[1.0, 1.0], [0.6, 2.5], [1.4, 2.5]], 1.0)
    steps = ho.Hold(1.0), ho.MoveVertex(0, by=np.array([0.0, 0.3]), duration=8.0), ho.Hold(6.0)
    return ho.solve(ho.Problem(start.team, start, steps))


class Linear:
    """Vertices that follow setpoints as in statics, with a lag, and are off by a constant."""

    def __init__(self, plan: ho.Plan, off: Array) -> None:
        self.plan, self.off = plan, off
        self.moved = np.zeros_like(off)
        self.seen: list[Array] = []

    def step(self, time: float, offsets: Array) -> tuple[Array, Array]:
        """Return errors now, and vertices as they were 50 ms ago."""
        states = self.plan.at(time)
        team = self.plan.motion.team
        forward = vertex_response(
            team,
            states.positions[None],
            states.vertices[None],
            states.tensions[None],
            36.0 * team.mass,
        ).forward[0]
        goal = (forward @ offsets.ravel()).reshape(-1, 3)
        self.moved += STEP / 0.4 * (goal - self.moved)
        error = self.off + self.moved
        self.seen.append(states.vertices + error)
        return error, self.seen[max(len(self.seen) - 1 - DELAYED, 0)]


def test_a_constant_error_is_taken_away_while_vertices_move() -> None:
    plan = plan_of()
    off = np.array([[0.01, -0.06, -0.1], [0.01, 0.0, -0.12], [-0.01, 0.0, -0.09]])
    hitch, feedback = Linear(plan, off), ho.Feedback(plan)
    rng = np.random.default_rng(1)
    sizes = []
    for i in range(int(plan.duration / STEP)):
        error, seen = hitch.step(i * STEP, feedback.offsets)
        before = feedback.offsets
        feedback.step(i * STEP, STEP, seen + rng.normal(0.0, 0.01, seen.shape))
        assert np.max(np.linalg.norm(feedback.offsets - before, axis=-1)) <= 0.1 * STEP + 1e-9
        sizes.append(np.linalg.norm(error, axis=-1).mean())
    assert sizes[0] > 0.1
    assert np.mean(sizes[-200:]) < 0.012


def test_vertices_that_rest_in_their_places_change_nothing() -> None:
    plan = plan_of()
    for first, last in ((0.0, 1.0), (10.0, plan.duration)):
        feedback = ho.Feedback(plan, delay=0.0)
        for time in np.linspace(first, last, 40):
            states = plan.at(time)
            here = feedback.step(float(time), STEP, states.vertices, states.positions)
            np.testing.assert_allclose(here.positions, states.positions, atol=1e-8)
            np.testing.assert_allclose(here.velocities, states.velocities, atol=1e-6)
            np.testing.assert_allclose(here.accelerations, states.accelerations, atol=1e-6)


def test_setpoints_lead_the_plan_of_vertices_that_move() -> None:
    plan = plan_of()
    feedback = ho.Feedback(plan, delay=0.0)
    for time in np.arange(4.0, 5.0, STEP):
        feedback.step(float(time), STEP, plan.at(time).vertices)
    states, team = plan.at(5.0), plan.motion.team
    forward = vertex_response(
        team,
        states.positions[None],
        states.vertices[None],
        states.tensions[None],
        36.0 * team.mass,
    ).forward[0]
    moved = (forward @ feedback.offsets.ravel()).reshape(-1, 3)
    ahead = moved[0] @ states.vertex_velocities[0] / np.sum(states.vertex_velocities[0] ** 2)
    assert 0.2 < ahead < LEAD


def test_missing_measurements_let_corrections_fade() -> None:
    plan = plan_of()
    feedback = ho.Feedback(plan, delay=0.0)
    vertices = plan.at(0.0).vertices - [0.0, 0.0, 0.05]
    for _ in range(300):
        feedback.step(0.5, STEP, vertices)
    grown = np.max(np.abs(feedback.offsets))
    assert grown > 0.03
    for _ in range(100):
        feedback.step(0.5, STEP, np.full((3, 3), np.nan))
    some = np.max(np.abs(feedback.offsets))
    for _ in range(1200):
        feedback.step(0.5, STEP)
    assert np.max(np.abs(feedback.offsets)) < 0.05 * grown < some < grown
    feedback.reset()
    assert np.all(feedback.offsets == 0.0)


def test_a_false_measurement_counts_as_missing() -> None:
    plan = plan_of()
    feedback = ho.Feedback(plan)
    wrong = plan.at(0.0).vertices + [5.0, 0.0, 0.0]
    feedback.step(0.2, STEP, wrong)
    assert np.all(feedback.offsets == 0.0)


@pytest.mark.parametrize("missing", [[], [1]])
def test_corrections_do_not_grow_while_a_drone_is_far_from_its_place(missing: list[int]) -> None:
    plan = plan_of()
    states = plan.at(0.5)
    vertices, drones = states.vertices - [0.0, 0.0, 0.05], states.positions.copy()
    drones[3, 0] += 0.4
    drones[missing] = np.nan
    free, kept = ho.Feedback(plan, delay=0.0), ho.Feedback(plan, delay=0.0)
    for _ in range(200):
        free.step(0.5, STEP, vertices)
        kept.step(0.5, STEP, vertices, drones)
    assert np.max(np.abs(kept.offsets)) < 0.5 * np.max(np.abs(free.offsets))


def test_corrections_are_over_before_the_hitch_is_untied() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), 0.9 * np.array([[0, -1], [-0.8, 0.5], [0.8, 0.5]]))
    plan = ho.release(start)
    last = max(phase.end for phase in plan.phases if phase.formed)
    feedback = ho.Feedback(plan, delay=0.0)
    time = 0.0
    while time < last:
        vertices = plan.at(time).vertices - [0.0, 0.0, 0.05]
        feedback.step(time, STEP, vertices)
        time += STEP
    assert np.max(np.abs(feedback.offsets)) < 0.005
    for _ in range(20):
        feedback.step(last + 0.1, STEP, vertices)
    assert np.all(np.abs(feedback.offsets) < 1e-12)


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"rate": 0.0}, "rate"),
        ({"reserve": -0.1}, "reserve"),
        ({"delay": np.nan}, "delay"),
        ({"stiffness": -4.0}, "stiffness"),
    ],
)
def test_settings_are_checked(given: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=key):
        ho.Feedback(plan_of(), **given)


def test_measurements_are_checked() -> None:
    feedback = ho.Feedback(plan_of())
    with pytest.raises(InputError, match="vertices"):
        feedback.step(0.0, STEP, np.zeros((2, 3)))
    with pytest.raises(InputError, match="drones"):
        feedback.step(0.0, STEP, None, np.zeros((2, 3)))
    with pytest.raises(InputError, match="plan"):
        ho.Feedback("out")


def test_keep_outs_are_refused() -> None:
    motion = plan_of().motion
    wall = ho.Prism([[5, 5], [5, 6], [6, 6], [6, 5]], 0.0, 1.0)
    need = replace(motion.requirements, keep_out=(wall,))
    with pytest.raises(UnsupportedError, match="keep-outs"):
        ho.Feedback(replace(motion, requirements=need))
