"""Ranges of tensions and vertices: derivatives, sampled hitches, and what adds up how."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from resting_hitches import random_hitch, regular_hitch, settled, standing

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.statics.settle import conditions_of, energy_of, samples_of
from hitchopt.statics.tolerance import ErrorSize, Tolerance, responses, taut_times
from hitchopt.trajectory import PiecewisePolynomial

seeds = st.integers(0, 2**32 - 1)


def ranges(hitch: ho.Hitch, **given: Any) -> Tolerance:
    return ho.tolerance(standing(hitch), [1.0], **given)


def gradients(hitch: ho.Hitch, **given: Any) -> list[np.ndarray]:
    """Derivatives of tensions and points by lengths, set points and forces."""
    motion, conditions = standing(hitch), conditions_of(hitch.team, **given)
    energy = energy_of(hitch.team, conditions, samples_of(motion, [1.0], conditions)[1])
    found, n = ho.settle(motion, [1.0], **given), hitch.team.robots
    clasps = found.vertices[:, hitch.team.layout.clasps]
    rows = responses(energy, np.concatenate([found.drones, clasps], axis=1))
    return np.split(rows, [n, 3 * n], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("held", [False, True])
def test_gradients_are_those_of_settled_hitches(topology: str, held: bool) -> None:
    hitch = random_hitch(3, 4, topology)
    team, h = hitch.team, 1e-5
    stiffness = team.stiffness.copy()
    if held:
        stiffness[[0, 3]] = np.inf
    base: dict[str, Any] = {"stiffness": stiffness, "cable_density": 0.008, "axial_stiffness": 500}
    by_length, by_place, by_force = gradients(hitch, **base)

    def difference(name: str, middle: Any, step: np.ndarray) -> np.ndarray:
        up, down = (settled(hitch, **(base | {name: middle + s * step})) for s in (h, -h))
        apart = up.tensions - down.tensions, (up.vertices - down.vertices).ravel()
        return np.concatenate(apart) / (2 * h)

    for k in range(team.robots):
        slope = difference("cable_length", team.cable_length, np.eye(team.robots)[k])
        np.testing.assert_allclose(by_length[:, k, 0], slope, rtol=1e-4, atol=2e-5)
    for i in range(0, team.drones, 3):
        for axis in range(3):
            step = np.zeros((team.drones, 3))
            step[i, axis] = 1.0
            for name, rows in (("offsets", by_place), ("forces", by_force)):
                slope = difference(name, 0.0, step)
                np.testing.assert_allclose(rows[:, i, axis], slope, rtol=1e-4, atol=2e-5)


@pytest.mark.slow
@given(seeds, st.integers(3, 6), st.sampled_from(["closed", "open"]), st.sampled_from([0.0, 0.01]))
@settings(max_examples=6)
def test_sampled_hitches_stay_within_bounds(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch, rng = random_hitch(seed, n, topology), np.random.default_rng(seed)
    errors = {"cable_error": 0.01, "position_error": 0.01, "force_error": 0.02}
    found = ranges(hitch, **errors, cable_density=density)
    offsets, forces = unit(rng.normal(size=(2, 150, 2 * n, 3)))  # on the bounds' surface
    lengths = hitch.team.cable_length + 0.01 * rng.choice([-1.0, 1.0], (150, n))
    samples = settled(
        hitch, cable_density=density, cable_length=lengths, offsets=0.01 * offsets,
        forces=0.02 * forces,
    )  # fmt: skip
    low, high = found.tensions[0, :, 0], found.tensions[0, :, 1]
    assert np.all(samples.tensions >= low - 1e-9)
    assert np.all(samples.tensions <= high + 1e-9)
    away = samples.vertices - found.settled.vertices[0]
    most = found.vertex_halves[0] + found.vertex_remainders[0]
    assert np.all(np.abs(away) <= most + 1e-9)
    # Each within its ellipsoid, widened by what is beyond first order.
    shapes = found.ellipsoids[0] + 1e-18 * np.eye(3)
    for k in range(away.shape[1]):
        sizes, axes = np.linalg.eigh(shapes[k])
        wide = np.sqrt(np.maximum(sizes, 0.0)) + found.vertex_remainders[0] + 1e-9
        assert np.all(np.sum((away[:, k] @ axes / wide) ** 2, axis=-1) <= 1.0)
    assert np.all(np.linalg.norm(away, axis=-1) <= found.radii[0] + 1e-9)
    # They are not much wider than what is needed: the worst errors reach their ends.
    assert found.tension_remainders[0] < 0.25 * np.max(found.tension_halves)


def test_ends_of_ranges_are_reached() -> None:
    hitch = random_hitch(21, 4)
    found = ranges(hitch, cable_error=0.004)
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 4)).reshape(4, -1).T
    corners = settled(hitch, cable_length=hitch.team.cable_length + 0.004 * signs)
    most, spare = found.tensions[0], 3.0 * found.tension_remainders[0] + 1e-9
    low, high = np.min(corners.tensions, axis=0), np.max(corners.tensions, axis=0)
    assert np.all((most[:, 0] <= low) & (low <= most[:, 0] + spare))
    assert np.all((most[:, 1] >= high) & (high >= most[:, 1] - spare))


@pytest.mark.slow
def test_standard_deviations_are_those_of_samples() -> None:
    hitch, rng = random_hitch(5, 4), np.random.default_rng(1)
    found = ranges(hitch, cable_error="sd:0.002", position_error="sd:0.003")
    samples = settled(
        hitch,
        cable_length=hitch.team.cable_length + 0.002 * rng.normal(size=(1500, 4)),
        offsets=0.003 * rng.normal(size=(1500, 8, 3)),
    )
    spread = np.std(samples.tensions, axis=0)
    np.testing.assert_allclose(found.tension_halves[0], 3.0 * spread, rtol=0.08)
    spread = np.std(samples.vertices, axis=0)
    np.testing.assert_allclose(found.vertex_halves[0], 3.0 * spread, rtol=0.1, atol=1e-4)
    shapes = [np.cov(samples.vertices[:, k].T) * 9.0 for k in range(4)]
    np.testing.assert_allclose(found.ellipsoids[0], shapes, atol=0.15 * np.max(shapes))


def test_bounds_add_and_no_error_has_no_width() -> None:
    hitch, one, two = random_hitch(9, 5), {"cable_error": 0.003}, {"force_error": 0.01}
    cable, force, both, nothing = (ranges(hitch, **each) for each in (one, two, one | two, {}))
    for name in ("tension_halves", "vertex_halves"):
        total = getattr(cable, name) + getattr(force, name)
        np.testing.assert_allclose(getattr(both, name), total, rtol=1e-9)
        assert not np.any(getattr(nothing, name))
    assert not np.any(nothing.ellipsoids)
    assert np.max(nothing.tension_remainders) < 1e-9
    np.testing.assert_allclose(nothing.tensions[0, :, 0], hitch.team.tension, atol=1e-8)


def test_what_is_beyond_first_order_is_found_at_the_worst_of_three_deviations() -> None:
    """For one cable's error that is where it is three times its deviation, both ways."""
    hitch, step = random_hitch(9, 3, stiffness=2.0), 1e-5 * np.array([[1.0], [-1.0]])
    lengths, made = hitch.team.cable_length, []
    for size in (0.002, 0.004):
        made.append(ranges(hitch, cable_error=f"sd:{size}"))
        assert 0.0 < made[-1].tension_remainders[0] < 0.2 * np.max(made[-1].tension_halves)
    up, down = (settled(hitch, cable_length=lengths + h * np.eye(3)).tensions for h in step)
    slopes = (up - down).T / 2e-5  # of each tension by each length
    worst = 3.0 * 0.004 * unit(slopes)
    beyond = []
    for errors in (worst, -worst):
        found = settled(hitch, cable_length=lengths + errors).tensions
        beyond.append(np.abs(found - hitch.team.tension - errors @ slopes.T))
    assert made[1].tension_remainders[0] >= 2.0 * np.max(beyond) * (1.0 - 1e-3)
    grown = made[1].tension_remainders / made[0].tension_remainders
    np.testing.assert_allclose(grown, 4.0, rtol=0.1)  # as it is of second order


def test_slack_is_found_where_a_range_reaches_nothing() -> None:
    assert ranges(regular_hitch(3), cable_error=0.01, stiffness=20.0).slack_cables == ()
    loose = ranges(regular_hitch(3), cable_error=0.01, stiffness=120.0)
    assert loose.slack_cables == ("c0", "c1", "c2")
    assert np.all(loose.tensions[..., 0] == 0.0)


def test_sizes_are_read_and_refused_in_words() -> None:
    assert ErrorSize.of("--x", "0.01") == ErrorSize.of("--x", 0.01) == ErrorSize(0.01)
    assert ErrorSize.of("--x", "sd:0.02") == ErrorSize(deviation=0.02)
    for text in ("", "sd:", "sd:-1", "-1", "nan", "1 cm"):
        with pytest.raises(ho.InputError, match=r"^--x = "):
            ErrorSize.of("--x", text)
    with pytest.raises(ho.InputError, match=r"^cable_error = -1"):
        ErrorSize.of("cable_error", -1.0)


def test_taut_times_leave_out_rising_tensions() -> None:
    motion = standing(regular_hitch(3))
    np.testing.assert_allclose(taut_times(motion, 5), [0.0, 0.5, 1.0, 1.5, 2.0], atol=0.02)
    assert taut_times(motion, 1).tolist() == [0.0]
    rising = PiecewisePolynomial(np.array([0.0, 2.0]), 0.5 * np.outer(np.ones(3), [0.0, 1.0])[None])
    found = taut_times(dataclasses.replace(motion, tensions=rising), 5)
    np.testing.assert_allclose(found[[0, -1]], [1.8, 2.0], atol=0.03)
