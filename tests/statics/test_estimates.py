"""Estimates from recordings that the laws alone compute: exact without noise, honest with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import RATE, recorded, shaken

import hitchopt as ho
from hitchopt.errors import InputError
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Quadrotor, Team
from hitchopt.statics.calibrate import COSINES, IN_SPACE, TURNS, friction_pulls

POLYGON = np.array([[3.0, -1.1], [2.4, 0.4], [3.5, 0.5]])
DENSITY, MU = 0.012, 0.17
SOFT, HARD = Quadrotor(mass=0.14), Quadrotor(mass=0.2)


def team_of(topology: str = "closed") -> Team:
    kinds, tension = [SOFT, HARD, SOFT], [0.5, 0.6, 0.55]
    return Team(3, [2.6, 2.5, 2.7], topology=topology, tension=tension, quadrotor=kinds)


def hitches(topology: str = "closed") -> tuple[Hitch, Hitch]:
    """The same polygon, cables slid: one drone of a cable comes nearer as the other goes."""
    arc = np.array([[1.0, 0.0], [1.6, 1.0], [2.9, 1.1], [3.6, 0.0]])
    points = POLYGON if topology == "closed" else arc
    team = team_of(topology)
    middle = Hitch.balanced(team, points, 1.3)
    slid = np.array([0.12, -0.1, 0.15]) * team.layout.has_leg.all(axis=1)
    before, after = (Hitch(team, points, 1.3, middle.q_legs + s * slid) for s in (-1.0, 1.0))
    return before, after


K = np.repeat([4.0, 9.0, 4.0], 2)


def moved() -> tuple[Hitch, Hitch]:
    """A vertex moved outward: both cables of its clasp slide alike."""
    outer = POLYGON + [[0.0, -0.25], [0.0, 0.0], [0.0, 0.0]]
    first, second = (Hitch.balanced(team_of(), each, 1.3) for each in (POLYGON, outer))
    return first, second


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "friction", "within", "wind"),
    [
        (hitches(), MU, 0.005, (0.05, -0.08)),  # which is no stiffness
        (moved(), MU, 0.01, (0.0, 0.0)),
        (hitches("open"), 0.0, 1e-5, (0.0, 0.0)),
    ],
)
def test_without_noise_stiffness_and_friction_are_exact(
    pair: tuple[Hitch, Hitch],
    friction: float,
    within: float,
    wind: tuple[float, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hitchopt.statics.calibrate.BLURRED", 1e-4)  # the law alone does not creep
    task, recording = recorded(*pair, K, DENSITY, friction, wind)
    found = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in found.stiffness)
    np.testing.assert_allclose([one.value for one in found.stiffness], K[::2], rtol=0.01)
    assert found.friction.known
    assert found.friction.value == pytest.approx(friction, abs=within)
    assert abs(found.friction.value - friction) < max(found.friction.error, 1e-3)


@pytest.mark.slow
def test_cable_lengths_are_those_of_catenaries() -> None:
    task, recording = recorded(*hitches(), K, DENSITY)
    rows = {name: getattr(recording, name)[:30] for name in ("t", "drones", "vertices")}
    found = ho.calibrate(replace(recording, **rows), task, density=DENSITY)
    layout, drones, points = task.team.layout, recording.drones[0], recording.vertices[0]
    corners = drones[0::2], points[layout.starts], points[layout.ends], drones[1::2]
    spans = np.diff(np.stack(corners, axis=1), axis=1)
    level, chord = np.hypot(spans[..., 0], spans[..., 1]), np.linalg.norm(spans, axis=-1)
    # The horizontal pull over the weight per length, such that the mean tension is right.
    pull = task.team.tension[:, None] * level / chord / (GRAVITY * DENSITY)
    lengths = np.hypot(spans[..., 2], 2.0 * pull * np.sinh(level / (2.0 * pull)))
    values = [one.value for one in found.lengths]
    np.testing.assert_allclose(values, np.sum(lengths, axis=1), atol=1e-4)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_flights() -> None:
    """Over flights with noise of 1.5 mm, deviations are about as large as the stated errors."""
    task, recording = recorded(*hitches(), K, DENSITY, friction=MU)
    scores = []
    for seed in range(6):
        found = ho.calibrate(shaken(recording, 1.5e-3, seed), task, density=DENSITY)
        soft, hard = found.stiffness[0], found.stiffness[1]
        assert abs(found.friction.value - MU) < 0.05
        scores.append([(soft.value - 4.0) / soft.error, (hard.value - 9.0) / hard.error])
    assert np.all(np.sqrt(np.mean(np.square(scores), axis=0)) < 2.5)
    assert np.max(np.abs(scores)) > 0.2  # they are no vacuous bounds


@pytest.mark.slow
def test_what_a_recording_does_not_determine_is_said() -> None:
    first, second = hitches()
    task, recording = recorded(first, second, K, 0.0)
    weightless = ho.calibrate(recording, task, density=0.0)
    assert not any(one.known for one in weightless.stiffness)
    assert "displaced by too little" in weightless.stiffness[0].remark
    assert "neither determined nor stated" in weightless.friction.remark
    task, recording = recorded(first, first, K, DENSITY)
    still = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in still.stiffness)
    assert "slide through clasps by 0.0 cm" in still.friction.remark
    task, recording = recorded(first, second, K, DENSITY)
    wound = replace(recording, integral=np.ones(6, dtype=np.bool_))
    assert "integral action" in ho.calibrate(wound, task, density=DENSITY).stiffness[0].remark
    unseen = replace(recording, vertices=np.full_like(recording.vertices, np.nan))
    with pytest.raises(InputError, match="record the vertices too"):
        ho.calibrate(unseen, task, density=DENSITY)


@pytest.mark.slow
def test_errors_are_distances_to_the_plan_which_stands_still_before_and_after() -> None:
    task, recording = recorded(*hitches(), K, DENSITY)
    places, t = task.setpoints.positions, recording.t + 0.5 / RATE
    early = np.append(t - 2.0 * t[-1], t)
    drones = np.tile(recording.drones + [0.0, 0.3, 0.4], (2, 1, 1))
    vertices = np.tile(task.vertices[-1] + [0.02, 0.0, 0.0], (len(early), 1, 1))
    found = ho.calibrate(replace(recording, t=early, drones=drones, vertices=vertices), task)
    middle = np.vstack([0.5 * (places[1:] + places[:-1]), places[-1:]])
    planned = np.concatenate([np.tile(places[0], (len(t), 1, 1)), middle])
    np.testing.assert_allclose(found.drone_errors, np.linalg.norm(drones - planned, axis=-1))
    assert found.vertex_errors[-1] == pytest.approx(0.02)


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
