"""Friction of cables that slide through their clasps: the law, and what counts how much."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from synthetic_flight import recorded, turns

from hitchopt.calibration.clasp_sliding import (
    COSINES,
    DIRECTION_ERROR,
    IN_SPACE,
    TURNS,
    SlidingClasps,
    friction_pulls,
    sliding_clasps,
)
from hitchopt.calibration.flight_windows import SPAN, WINDOW, Windows, windows_of
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.calibration.friction_fit import fit_friction
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import Hitch, Team

DENSITY = 0.012


def test_friction_acts_along_the_cables_relative_velocity() -> None:
    turns = np.full(2, np.radians(60.0))
    c, space = np.interp(turns[0], TURNS, COSINES), np.interp(turns[0], TURNS, IN_SPACE)
    capstan = turns[0] * space
    for rates, expected in (
        ([0.02, 0.0], [1.0, -c]),  # the other cable is dragged along
        ([0.0, -0.5], [c, -1.0]),
        ([0.03, 0.03], np.full(2, np.sqrt(0.5 * (1.0 - c)))),
        ([-0.03, -0.03], np.full(2, -np.sqrt(0.5 * (1.0 - c)))),
        ([0.01, -0.01], np.array([1.0, -1.0]) * np.sqrt(0.5 * (1.0 + c))),
        ([0.0, 0.0], [0.0, 0.0]),
    ):
        found = friction_pulls(turns, np.array(rates))
        np.testing.assert_allclose(found, capstan * np.asarray(expected), atol=1e-12)
    slow = friction_pulls(turns, np.array([5e-3, 0.0]), blurred=5e-3)
    np.testing.assert_allclose(slow, capstan * np.array([1.0, -c]) / np.sqrt(2.0))


def test_friction_is_coulombs_in_space() -> None:
    """Against vectors: it opposes one surface's velocity over the other's, swapped or reversed."""
    random = np.random.default_rng(7)
    for turn in np.radians([20.0, 52.0, 88.0, 119.0]):
        c, space = np.interp(turn, TURNS, COSINES), np.interp(turn, TURNS, IN_SPACE)
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        along_a, along_b = frame[0], c * frame[0] + np.sqrt(1.0 - c**2) * frame[1]
        assert along_a @ along_b == pytest.approx(c)
        for rates in random.normal(size=(20, 2)):
            over = unit(rates[0] * along_a - rates[1] * along_b)
            on_a, on_b = -turn * space * over, turn * space * over
            # Where friction pulls a cable back, its leg is pulled the harder by as much.
            expected = [-on_a @ along_a, -on_b @ along_b]
            turns = np.full(2, turn)
            np.testing.assert_allclose(friction_pulls(turns, rates), expected)
            np.testing.assert_allclose(friction_pulls(turns, rates[::-1]), expected[::-1])
            np.testing.assert_allclose(friction_pulls(turns, -rates), np.negative(expected))
            np.testing.assert_allclose(friction_pulls(turns, 7.0 * rates), expected)


def test_pulls_are_unsure_where_friction_acts_across_a_cable() -> None:
    team = Team(3, [2.6, 2.5, 2.7], tension=[0.5, 0.6, 0.55])
    points = np.array([[3.0, -1.1], [2.4, 0.4], [3.5, 0.5]])
    middle, slid = Hitch.balanced(team, points, 1.3), np.array([0.12, -0.1, 0.15])
    before, after = (Hitch(team, points, 1.3, middle.q_legs + s * slid) for s in (-1.0, 1.0))
    task, recording = recorded(before, after, np.full(6, 5.0), DENSITY, 0.17)
    balance = ForceBalance.of(task.team, windows_of(recording, task), DENSITY)
    tensions = np.ones((len(balance.windows.t), balance.per_window))
    found = sliding_clasps(task.team, recording, balance, tensions)
    assert len(found.windows) > 20
    windows, layout = balance.windows, task.team.layout
    for w, c, pulls, unsure in zip(
        found.windows, found.clasps, found.pulls, found.unsure, strict=True
    ):
        pair = [2 * layout.ahead[c], 2 * layout.behind[c] + 1]
        angles = turns(task.team, windows.drones[w], windows.vertices[w])[pair]
        whole = angles * np.interp(np.mean(angles), TURNS, IN_SPACE)
        across = whole * np.sin(np.arccos(pulls / whole))
        np.testing.assert_allclose(unsure, DIRECTION_ERROR * across)


def test_clasps_that_slide_alike_count_less_than_cables_that_slide_alone() -> None:
    """Ratios of the former are 0.6 of the law's here, as in a flight whose contacts vibrated."""
    counts, estimates = [16, 5], []
    rates = np.repeat([[-0.03, 0.0], [0.03, 0.03]], counts, axis=0)
    pulls = friction_pulls(np.full(rates.shape, np.radians(60.0)), rates)
    whole = np.radians(60.0) * np.interp(np.radians(60.0), TURNS, IN_SPACE)
    unsure = DIRECTION_ERROR * np.sqrt(np.maximum(whole**2 - pulls**2, 0.0))
    true = 0.3 * np.repeat([1.0, 0.6], counts)[:, None] * pulls
    window, slid = np.arange(len(rates)), np.full(len(rates), 0.01)
    for seed in range(6):
        random = np.random.default_rng(seed)
        common, apart = random.normal(scale=[[0.02], [0.1]], size=(2, len(rates)))
        ratios = true + np.stack([common + apart, common - apart], axis=-1)
        clasps = SlidingClasps(window, window % 3, ratios, pulls, unsure, slid)
        alike = replace(clasps, unsure=np.zeros_like(unsure))
        estimates.append([fit_friction(clasps).value, fit_friction(alike).value])
    weighed, unweighed = np.mean(estimates, axis=0)
    assert abs(weighed - 0.3) < 0.05
    assert weighed > unweighed + 0.03


def test_spans_are_even_and_hold_no_gap() -> None:
    t = WINDOW * (np.arange(61, dtype=np.float64) + 0.5)
    t[29:] += 20.0  # untied meanwhile
    drones = np.random.default_rng(1).normal(size=(61, 6, 3))
    points = drones[:, :3]
    spans = Windows(t, drones, points, drones, points, drones, np.ones((61, 3))).spans()
    assert SPAN == 12 * WINDOW  # 29 windows are two spans, 32 are three
    bounds = [0, 15, 29, 40, 51, 61]
    for k, (first, last) in enumerate(pairwise(bounds)):
        assert spans.t[k] == pytest.approx(np.mean(t[first:last]))
        np.testing.assert_allclose(spans.drones[k], np.mean(drones[first:last], axis=0))
    assert len(spans.t) == 5
