"""Predicted slip loads: clasps that slide as a grip closes, and stick as it lifts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hitchopt as ho
from benchmarks.grip_history import BOTH_SLIDE, GripHistory, Rounding
from hitchopt.holding.grip_statics import Grip
from hitchopt.values import Array

TENSION, FRICTION, RADIUS, OUT = 1.3, 0.15, 0.2, 0.221
DISC = ho.Section(radius=RADIUS)
BOX = ho.Section([[0.2, 0.15], [0.2, -0.15], [-0.2, -0.15], [-0.2, 0.15]])
RHOMBUS = np.array([[0, 0.27], [0.32, 0], [0, -0.27], [-0.32, 0]])


def triangle(radius: float) -> Array:
    angles = -2.0 * math.pi * np.arange(3) / 3
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def planned(section: ho.Section, vertices: Array, weight: float = 0.0) -> Array:
    return Grip.of(section, vertices, 1.6, TENSION, weight=weight).drones


def lifting(section: ho.Section, vertices: Array, weight: float, parts: int) -> Sequence[Array]:
    return [planned(section, vertices, weight * i / parts) for i in range(1, parts + 1)]


def units(vectors: Array) -> Array:
    found: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return found


def test_a_disc_is_closed_where_friction_balances_legs_and_edges() -> None:
    drones = planned(DISC, triangle(OUT))
    clasps = GripHistory(DISC, TENSION, FRICTION).closed(drones, triangle(OUT))
    out = np.linalg.norm(clasps, axis=1)
    assert np.ptp(out) < 1e-5 < out[0] - OUT
    outward = clasps[0] / out[0]
    legs = units(np.stack([drones[0, 0], drones[2, 1]]) - clasps[0])
    legs_half = math.acos(float(np.mean(legs @ outward)))
    edges_half = 0.5 * math.pi - math.acos(RADIUS / out[0])
    least = math.exp(-FRICTION * (legs_half + edges_half) * math.sqrt(0.5))
    assert math.cos(legs_half) == pytest.approx(least * math.cos(edges_half), rel=1e-4)


def test_clasps_of_a_box_are_in_balance_where_it_is_closed_and_lifted() -> None:
    history = GripHistory(BOX, TENSION, FRICTION, cable_density=0.01)
    clasps = history.closed(planned(BOX, RHOMBUS), RHOMBUS)
    weight = 0.6
    grip = history.lifted(clasps, lifting(BOX, RHOMBUS, weight, 8), weight)
    assert grip.imbalance < 1e-8
    assert grip.level @ np.sum(grip.slopes, axis=1) == pytest.approx(weight, rel=1e-8)


def test_stuck_edges_around_a_box_keep_their_length() -> None:
    history = GripHistory(BOX, TENSION, FRICTION)
    clasps = history.closed(planned(BOX, RHOMBUS), RHOMBUS)
    grip = history.lifted(clasps, lifting(BOX, RHOMBUS, 0.4, 4), 0.4)
    corners = grip.wraps.contacts[:, 0]
    np.testing.assert_allclose(np.abs(corners), np.tile([0.2, 0.15], (4, 1)))
    np.testing.assert_allclose(grip.wraps.contacts[:, 1], corners)  # each turns about one
    ends = np.stack([clasps, np.roll(clasps, -1, axis=0)], axis=1)[..., :2]
    flat = np.linalg.norm(ends - corners[:, None], axis=-1)
    highs = np.stack([grip.vertices, np.roll(grip.vertices, -1, axis=0)], axis=1)
    sloping = np.linalg.norm(highs - np.pad(corners, ((0, 0), (0, 1)))[:, None], axis=-1)
    np.testing.assert_allclose(np.sum(sloping, axis=1), np.sum(flat, axis=1), atol=1e-9)
    assert np.all(np.linalg.norm(grip.vertices[:, :2], axis=1) < np.linalg.norm(clasps, axis=1))


def test_cables_lie_on_a_disc_as_even_upright_friction_bends_them() -> None:
    """The level pull is the same all along, and friction takes the upright one evenly by angle."""
    history = GripHistory(DISC, TENSION, clasp_friction=0.2)
    first = history.closed(planned(DISC, triangle(OUT)), triangle(OUT))
    grip = history.lifted(first, lifting(DISC, triangle(OUT), 1.5, 8), 1.5)
    out = float(np.mean(np.linalg.norm(grip.vertices[:, :2], axis=1)))
    half = math.pi / 3.0 - math.acos(RADIUS / out)
    rise = 1.5 / (6.0 * float(np.mean(grip.level)))  # upright over level pull at both clasps

    def shape(along: float, state: Array) -> list[float]:
        slope = rise * min(along / (RADIUS * half), 1.0)
        on_arc = float(along < RADIUS * half)
        return [slope, math.hypot(1.0, slope), state[0] * on_arc / (RADIUS * half)]

    straight = math.sqrt(out**2 - RADIUS**2)
    span = (0.0, RADIUS * half + straight)
    high, size, mean = solve_ivp(shape, span, [0.0] * 3, rtol=1e-8, max_step=1e-3).y[:, -1]
    assert float(np.mean(grip.vertices[:, 2])) == pytest.approx(high - mean, abs=1e-5)
    before = float(np.mean(np.linalg.norm(first, axis=1)))
    angle = math.acos(RADIUS / before)
    laid = math.sqrt(before**2 - RADIUS**2) + RADIUS * (math.pi / 3.0 - angle)
    assert size == pytest.approx(laid, abs=1e-5)
    assert before - out > 0.005


def test_edges_that_pull_too_hard_slide_at_their_clasps() -> None:
    history = GripHistory(DISC, TENSION, clasp_friction=0.03)
    first = history.closed(planned(DISC, triangle(OUT)), triangle(OUT))
    grip = history.lifted(first, lifting(DISC, triangle(OUT), 1.8, 8), 1.8)
    pulls = grip.level[:, None] * np.hypot(1.0, grip.slopes)
    assert np.all(pulls > 1.03 * TENSION)
    assert np.all(pulls < math.exp(0.03 * math.pi * BOTH_SLIDE) * TENSION)


def test_cables_that_do_not_rub_pull_as_hard_as_legs() -> None:
    history = GripHistory(DISC, TENSION, clasp_friction=0.0)
    clasps = history.closed(planned(DISC, triangle(OUT)), triangle(OUT))
    np.testing.assert_allclose(clasps[:, :2], triangle(OUT), atol=1e-4)
    grip = history.lifted(clasps, lifting(DISC, triangle(OUT), 1.0, 8), 1.0)
    pulls = np.hypot(grip.level[:, None], grip.level[:, None] * grip.slopes)
    np.testing.assert_allclose(pulls, TENSION, rtol=1e-6)
    slope = math.asin(1.0 / (6.0 * TENSION))
    level = TENSION * math.cos(slope) * np.sum(grip.wraps.angles)
    assert grip.slip_load(0.5) == pytest.approx(0.5 * level, rel=1e-4)


def test_thick_cables_are_farther_out_and_bend_round_a_grown_disc() -> None:
    thin, thick = (
        GripHistory(DISC, TENSION, FRICTION, thickness=thickness) for thickness in (0.0, 0.012)
    )
    drones = planned(DISC, triangle(OUT))
    outs = [
        np.linalg.norm(each.closed(drones, triangle(1.1 * OUT)), axis=1) for each in (thin, thick)
    ]
    assert np.all(outs[1] > outs[0] + 0.006)


def test_friction_between_two_sliding_cables_acts_at_half_a_right_angle() -> None:
    """Coulomb friction opposes the relative velocity of two perpendicular, alike fast cables."""
    along, other = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    relative = along - other
    assert units(relative) @ along == pytest.approx(BOTH_SLIDE)


@pytest.mark.parametrize("bend", [0.2, 0.6, 1.1])
@pytest.mark.parametrize(("radius", "segment"), [(0.006, 0.01), (0.026, 0.01), (0.006, 0.0025)])
def test_nodes_of_ropes_press_on_corners_as_forces_balance(
    bend: float, radius: float, segment: float
) -> None:
    """Two nodes without friction, the link between them included, are in balance."""
    sharp = math.asin(0.5 * segment / radius) > 0.25 * math.pi
    away = 0.25 * math.pi if sharp else math.asin(0.5 * segment / radius)
    normals = np.array([[-math.sin(away), math.cos(away)], [math.sin(away), math.cos(away)]])
    pull = np.array([math.cos(0.5 * bend), -math.sin(0.5 * bend)])  # of the right end
    balance = np.zeros((4, 3))  # of both nodes: their normal forces, and the link's tension
    balance[:2, 0], balance[2:, 1] = normals
    balance[0, 2], balance[2, 2] = 1.0, -1.0
    ends = np.concatenate([[-pull[0], pull[1]], pull])
    forces = np.linalg.lstsq(balance, -ends)[0]
    np.testing.assert_allclose(balance @ forces, -ends, atol=1e-12)
    shares = Rounding(radius, segment).pressed(np.array([bend]))
    np.testing.assert_allclose(shares, np.sum(forces[:2]) / bend, rtol=1e-12)
