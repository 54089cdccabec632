"""A robot lets go of its cable in flight: what falls, what is commanded, and what remains."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.losses import displacements
from hitchopt.lab.simulation.cuts import task_with_cut
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.judgement import loss_outcome
from hitchopt.lab.simulation.ropes import bend_lengths, bends_about, hanging
from hitchopt.lab.simulation.settings import Loss, Settings
from hitchopt.lab.simulation.task import RATE, Task
from hitchopt.lab.simulation.world import check_valid
from tests.helpers.scripted import world_of


@cache
def square() -> ho.Plan:
    """Return the plan of a square that is reshaped."""
    drone = ho.Quadrotor(stiffness=4.75)
    team = ho.Team(4, 2.2, tension=0.3, cable_density=0.008, release=True, quadrotor=drone)
    start = ho.Hitch.balanced(team, ho.regular_polygon(4, 1.2), 1.6)
    moved = start.polygon.vertices + 0.1 * np.eye(4)[:, :1]
    return ho.solve(start, ho.Morph(moved), limits=ho.Limits(survive="cable"))


def test_a_rope_that_is_let_go_falls_freely_and_others_stay() -> None:
    drones = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
    world = world_of(1.5, 1.5)
    world.place(hanging(world.ropes, drones, 0.0))
    own = world.masses + 0.5 * np.repeat(world.ropes.density * world.ropes.segment_lengths, 2)
    before = world.nodes.copy()
    world.let_go(0)
    thrusts = own * GRAVITY  # the last of both ropes' halves of a segment included
    step, count = world.ropes.preset.time_step, 200
    for _ in range(count):
        world.push(thrusts, np.zeros((4, 3)), np.zeros((4, 3)))
        world.step(loose=True)
        check_valid(world, 0.0)
    first = np.flatnonzero(world.node_cables == 0)[1:-1]
    fallen = np.mean(world.nodes[first] - before[first], axis=0)
    seconds = step * count
    np.testing.assert_allclose(fallen[2], -0.5 * GRAVITY * seconds**2, rtol=0.03)
    np.testing.assert_allclose(fallen[:2], 0.0, atol=1e-3)
    np.testing.assert_allclose(world.drones[:2], drones[:2], atol=5e-4)  # one step of pull
    assert world.tensions[world.edge_cables == 0][[0, -1]].tolist() == [0.0, 0.0]
    assert np.min(world.nodes[world.node_cables == 0][:, 2]) < 2.5
    assert np.max(world.nodes[world.node_cables == 0][:, 2]) < 2.95  # nothing reaches the drones


def test_neighbours_are_shorter_by_the_bends_that_vanish() -> None:
    (task,) = Task.of(square().flight).teams
    bends = bend_lengths(task, 0.012, 0.05)
    shorter = bends_about(task, 0.012, 0.05, 1)
    np.testing.assert_allclose(shorter, [bends[1], 0.0, bends[2], 0.0])
    assert np.min(bends) > 0.005
    world = world_of(1.5, 1.5)
    before = world.model.flexedge_length0.copy()
    for by in (0.02, 0.01):  # not one after the other
        world.shorten(np.array([0.0, by]))
    changed = np.bincount(world.edge_cables, before - world.model.flexedge_length0)
    np.testing.assert_allclose(changed, [0.0, 0.01], atol=1e-12)


@pytest.mark.parametrize("robot", [0, 2])
def test_setpoints_are_those_of_the_plan_its_stop_and_the_chain(robot: int) -> None:
    plan, time = square(), 0.6
    task, found = task_with_cut(Task.of(plan.flight), Loss(str(robot), time), react=True)
    states, team = task.states, plan.motion.team
    drones = np.arange(team.drones)
    lost = drones // 2 == robot
    moves = drones[np.isin(team.drone_names, [f"q{(robot + 1) % 4}", f"r{(robot - 1) % 4}"])]
    speed = plan.motion.requirements.limits.speed
    steps = np.linalg.norm(np.diff(states.positions, axis=0), axis=-1)
    assert np.max(steps) <= 1.01 * speed / RATE  # nothing jumps
    until = states.t <= time + 0.1
    planned = plan.motion.drones.at(states.t[until])
    np.testing.assert_allclose(states.positions[until], planned, atol=1e-9)
    rests = states.t >= found.begin + found.stops
    stays = np.setdiff1d(drones[~lost], moves)
    np.testing.assert_allclose(np.ptp(states.positions[rests][:, stays], axis=0), 0.0, atol=1e-9)
    assert np.all(np.ptp(states.positions[rests][:, moves], axis=0).max(axis=-1) > 0.3)
    assert np.all(states.cable_forces[states.t >= time][:, lost] == 0.0)
    np.testing.assert_allclose(states.tensions[-1], np.where(np.arange(4) == robot, 0.0, 0.3))
    end = dict(zip(found.drones, found.flight.drones.coefficients[-1, ..., -1], strict=True))
    placed = [end[name] for name in team.drone_names]
    np.testing.assert_allclose(states.positions[-1], placed, atol=1e-9)


def test_without_a_reaction_all_others_fly_on() -> None:
    plan, loss = square(), Loss("1", 0.6)
    task, found = task_with_cut(Task.of(plan.flight), loss, react=False)
    states = task.states
    planned = plan.at(states.t)
    others = np.arange(8) // 2 != 1
    np.testing.assert_allclose(states.positions[:, others], planned.positions[:, others])
    np.testing.assert_allclose(states.cable_forces[:, others], planned.cable_forces[:, others])
    rises = states.positions[-1, ~others, 2] - planned.positions[-1, ~others, 2]
    np.testing.assert_allclose(rises, found.rise)


def test_cuts_without_an_answer_are_refused() -> None:
    task = Task.of(square().flight)
    for text, words in {"7@0.5": "cut = '7': must be one of 0", "1@99": "cut = 99"}.items():
        with pytest.raises(ho.InputError, match=words):
            task_with_cut(task, Loss.parsed(text), react=True)
    for text in ("2", "2@", "@1", "2@soon"):
        with pytest.raises(ho.InputError, match=r"write 2@12\.5"):
            Loss.parsed(text)


@pytest.mark.slow
def test_the_others_hold_a_chain_within_the_bound_only_if_they_react() -> None:
    plan, loss = square(), Loss("2", 0.6)
    bound = float(np.max(displacements(plan.motion.team)))
    taut = []
    for react in (True, False):
        task, _ = task_with_cut(Task.of(plan.flight), loss, react=react)
        flight = fly(task, Settings(lost=loss))
        outcome = loss_outcome(flight)
        assert flight.error is None
        assert outcome is not None
        assert outcome.among == outcome.others == ()
        assert outcome.bound == pytest.approx(bound)
        assert outcome.displaced <= bound
        assert outcome.linked == ("p0", "p1")
        taut.append(outcome.taut_after)
    assert taut[0] < 6.0
    assert np.isnan(taut[1])
