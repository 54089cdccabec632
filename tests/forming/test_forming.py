"""Swaps, pre-hitches and assignments: geometry by other means, and laws."""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.drones.controllers import Tube
from hitchopt.forming.approach import assign_robots
from hitchopt.forming.prehitch import find_prehitch
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import Motion
from hitchopt.planners.stages import (
    hover_altitude,
    reversed_stages,
    rise_seconds,
    straight_lines,
)
from hitchopt.values import Array
from problems.random_morph import random_convex_polygon

IRREGULAR = np.array([[0, 1.0], [1.1, 0.5], [0.8, -0.6], [-0.4, -0.8], [-0.9, 0.3]]) + [3.0, -2.0]
LENGTHS = np.array([2.2, 2.3, 2.1, 2.4, 2.2])

KINDS = [ho.Quadrotor(0.12 + 0.01 * k, 2.4 + 0.1 * k) for k in range(5)]
SLACK = LENGTHS - ho.ConvexPolygon(IRREGULAR).edge_lengths
PENTAGON = Hitch(
    Team(5, LENGTHS, quadrotor=KINDS), IRREGULAR, 1.7, SLACK * [0.5, 0.45, 0.55, 0.5, 0.6]
)
"""Unequal cables, drones and legs, off the origin."""


def stages_of(hitch: Hitch) -> list[Motion]:
    prehitch = find_prehitch(hitch, Requirements(), SwapSettings())
    return prehitch.stages(Requirements())


def sampled(stage: Motion) -> Array:
    return stage.drones.at(np.linspace(0.0, stage.drones.duration, 1001))


def test_cables_of_unequal_tensions_clasp() -> None:
    """Legs turn; pairs are then across their vertices, and separated on the path to the hitch."""
    rng, n = np.random.default_rng(6), 7
    polygon = random_convex_polygon(n, 0.9, rng)
    team = Team(n, 1.7, tension=rng.uniform(0.35, 0.5, n))
    y = 1.1 * (np.arange(n) - 0.5 * (n - 1))
    q = np.column_stack([np.full(n, -0.7), y[::-1], np.full(n, 1.5)])
    plan = ho.form(team, q, q * [-1.0, 1.0, 1.0], polygon, altitude=1.5)
    assert plan.certificate.certified


def test_release_is_form_reversed() -> None:
    stages = stages_of(PENTAGON)
    back = reversed_stages(stages)
    assert [s.phases[0].name for s in back] == ["relax", "loosen", "unswap 1", "unswap 2"]
    for there, again in zip(stages, reversed(back), strict=True):
        np.testing.assert_allclose(sampled(there), sampled(again)[::-1], atol=1e-9)
    pulls = back[0].tensions.at([0.0, back[0].duration])
    np.testing.assert_array_equal(pulls, [PENTAGON.team.tension, np.zeros(5)])


@pytest.mark.parametrize("tracking", [0.03, 0.06, ho.Tube(0.05, 0.2)])
def test_cables_whose_slack_errors_take_up_are_tightened_slowly(
    tracking: float | ho.Tube,
) -> None:
    """Two drones of a cable may each be off by the tracking error, and pull it taut at any time."""
    requirements = Requirements(Limits(tracking=tracking)).with_reserve
    *_, tighten, _ = find_prehitch(PENTAGON, requirements, SwapSettings()).stages(requirements)
    assert tighten.phases[0].name == "tighten"
    layout = PENTAGON.team.layout
    t = np.linspace(0.0, tighten.duration, 2001)
    drones, clasps = tighten.drones.at(t), tighten.vertices.at(t)
    legs = np.linalg.norm(drones - clasps[:, layout.anchors], axis=-1).reshape(len(t), -1, 2)
    edges = np.linalg.norm(clasps[:, layout.ends] - clasps[:, layout.starts], axis=-1)
    slack = np.min(LENGTHS - np.sum(legs, axis=-1) - edges, axis=1)
    is_tight = slack < 2.0 * Tube.of(tracking).level
    speed = np.max(np.linalg.norm(tighten.drones.at(t, 1), axis=-1), axis=1)
    assert np.max(speed[is_tight]) <= 0.1
    assert np.max(speed[~is_tight]) > 0.2


@pytest.mark.parametrize(
    ("team", "mass"),
    [
        (Team(4, 2.9, tension=0.4, cable_density=0.003, load=[0.02, 0.01, 0.0, 0.0]), 0.0237),
        (Team(4, 2.4, tension=0.7, load=0.03), 0.03),
    ],
)
def test_tensions_rise_in_three_periods_of_the_slowest_cable(team: Team, mass: float) -> None:
    """A string of length L, mass m and tension T swings in ``2 √(L m / T)``."""
    period = 2.0 * math.sqrt(team.cable_length[0] * mass / team.tension[0])
    assert rise_seconds(team) == pytest.approx(3.0 * period, rel=1e-12)
    assert 3.0 * period > 1.0  # the shortest rise


def test_moving_and_turning_the_hitch_moves_and_turns_the_plan() -> None:
    turn, polygon = np.array([[0.6, -0.8], [0.8, 0.6]]), PENTAGON.polygon.vertices
    moved = Hitch(PENTAGON.team, polygon @ turn.T + [2.0, 5.0], 2.7, PENTAGON.q_legs)
    for one, other in zip(stages_of(PENTAGON), stages_of(moved), strict=True):
        here, there = sampled(one), sampled(other) - [2.0, 5.0, 1.0]
        np.testing.assert_allclose(there[..., :2], here[..., :2] @ turn.T, atol=1e-7)
        np.testing.assert_allclose(there[..., 2], here[..., 2], atol=1e-7)


def test_heavy_cables_reduce_the_usable_acceleration() -> None:
    """A drone with little thrust that carries half a heavy cable is slower, or infeasible."""
    start = PENTAGON.drones

    def seconds(density: float) -> float:
        team = Team(5, LENGTHS, cable_density=density, quadrotor=ho.Quadrotor(0.12, 1.45))
        return straight_lines(team, Limits(), start, start + [0.0, 1.5, 0.0]).duration

    assert seconds(0.01) > 1.05 * seconds(0.0)
    with pytest.raises(ho.InfeasibleError, match=r"^thrust: .* hovering with a hanging cable"):
        seconds(0.05)


@pytest.mark.parametrize("seed", range(2))
def test_the_assignment_is_the_best_of_all(seed: int) -> None:
    """Against all permutations and orientations of four robots."""
    outline = ho.ConvexPolygon(np.array([[-0.5, 0.5], [0.6, 0.5], [0.5, -0.5], [-0.5, -0.4]]))
    drones = np.random.default_rng(seed).uniform(-2.0, 2.0, (8, 3))
    ends = np.stack([outline.vertices, np.roll(outline.vertices, -1, axis=0)], axis=1)

    def cost(assignment: Assignment) -> float:
        places = drones[assignment.drones].reshape(4, 2, 3)[..., :2]
        return float(np.sum((places - ends) ** 2))

    all_of_them = product(permutations(range(4)), product((False, True), repeat=4))
    best = min(cost(Assignment(*each)) for each in all_of_them)
    chosen = assign_robots(Team(4, 2.0), drones, outline, 0.15)
    assert cost(chosen) == pytest.approx(best, rel=1e-12)


def test_long_edges_go_to_long_cables() -> None:
    team = Team(3, [1.5, 2.6, 2.6])
    outline = ho.ConvexPolygon(np.array([[0.0, 1.8], [0.4, 0.0], [-0.4, 0.0]]))
    found = assign_robots(team, np.arange(6.0)[:, None] * [1.0, 0.0, 0.0], outline, 0.15)
    assert found.team(team).cable_length[1] == 1.5  # the only edge that it can hold


@pytest.mark.parametrize("length", [1.8, pytest.param(2.2, marks=pytest.mark.slow)])
def test_hitches_with_crossing_legs_are_tied_larger(length: float) -> None:
    """Drones of a small hexagon's long legs would meet on the path from the pre-hitch."""
    angles = np.radians([0.0, -60.0, -120.0, -180.0, -240.0, -300.0])
    corners = 0.4 * np.column_stack([np.cos(angles), np.sin(angles)]) + [3.0, -2.0]
    middles = 2.5 * (corners + np.roll(corners, -1, axis=0)) - 4.0 * np.array([3.0, -2.0])
    along = np.roll(corners, -1, axis=0) - corners
    q, r = (np.pad(middles + s * along, ((0, 0), (0, 1))) for s in (-1.0, 1.0))
    team = Team(6, length, tension=1.0, cable_density=0.01)
    plan = ho.form(team, q, r, corners, altitude=1.3)
    assert plan.certificate.certified
    assert plan.phases[-1].name == "morph"
    longer = np.max(plan.motion.legs.at(plan.duration), axis=1)
    assert np.all(longer > 0.4)  # the star's tips are as far away as edges are long


@pytest.mark.parametrize(("length", "apart"), [(1.18, 1.18), (1.2799, 1.18), (2.0, 0.09)])
def test_no_altitude_frees_a_cable_whose_shape_errors_of_position_leave_open(
    length: float, apart: float
) -> None:
    need, lengths = Requirements(position_error=0.05), np.array([2.0, length, 2.0])
    drones = np.zeros((6, 3))
    drones[1::2, 0] = [1.2, apart, 1.1]
    with pytest.raises(ho.InfeasibleError) as refused:
        hover_altitude(Team(3, lengths), drones, need)
    (violation,) = refused.value.violations
    assert (violation.constraint, violation.where) == ("tracking_radius", ("cable 1",))
    assert violation.value < need.position_error
    if violation.value > 0.0:
        smaller = Requirements(position_error=0.999 * violation.value)
        assert math.isfinite(hover_altitude(Team(3, lengths), drones, smaller))
