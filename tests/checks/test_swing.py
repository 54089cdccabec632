"""``swing``: laws of the linear response, and the same response by other methods."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

import hitchopt as ho
from hitchopt.checks import swing
from hitchopt.checks.certifying import certify
from hitchopt.checks.swing import SWING, SwingingHitch, has_inertia, swinging_hitches
from hitchopt.checks.tracking import GAMMA
from hitchopt.geometry.vectors import length
from hitchopt.motion.motion import Motion
from hitchopt.values import Array

CORNERS = np.array([[0.1, 0.7], [0.6, -0.3], [-0.5, -0.35]])
WIDER = CORNERS + [[0.02, 0.1], [0.0, 0.0], [0.0, 0.0]]


def team(density: float = 0.01, load: float | list[float] = 0.0) -> ho.Team:
    """Return a team with unequal cables."""
    return ho.Team(3, [2.4, 2.5, 2.6], cable_density=density, load=load, tension=[0.4, 0.5, 0.45])


def morphed(
    of_team: ho.Team, start: Array, end: Array, altitude: float = 1.5, duration: float = 0.9
) -> Motion:
    """Return a morph of a stated duration between balanced hitches."""
    hitch = ho.Hitch.balanced(of_team, start, altitude)
    limits = ho.Limits(swing=None)
    plan = ho.morph(hitch, end, legs="balanced", duration=duration, limits=limits)
    return plan.motion


@cache
def plan() -> Motion:
    """Return a morph of a triangle."""
    return morphed(team(), CORNERS, WIDER)


@cache
def carried() -> Motion:
    """Return a transport, whose shape does not change."""
    hitch = ho.Hitch.balanced(team(load=0.01), CORNERS, 1.5)
    return ho.solve(hitch, ho.Transport([0.6, 0.2, 1.6]), limits=ho.Limits(swing=None)).motion


def row(motion: Motion) -> float:
    """Return the certified estimate [m]."""
    check = SWING.check(motion, {}, GAMMA)
    assert check is not None
    return check.worst


def rotated(points: Array, angle: float) -> Array:
    """Return points (…, 2) turned about the origin by an angle [rad]."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(points @ turn.T)


@pytest.mark.parametrize(
    "moved",
    [
        morphed(team(), CORNERS + [2.0, -1.0], WIDER + [2.0, -1.0], altitude=2.0),
        morphed(team(), rotated(CORNERS, 1.0), rotated(WIDER, 1.0)),
    ],
    ids=["translated", "rotated"],
)
def test_it_does_not_depend_on_where_a_hitch_is(moved: Motion) -> None:
    assert row(moved) == pytest.approx(row(plan()), rel=1e-4)


def test_it_does_not_depend_on_the_order_of_robots() -> None:
    """Robots are numbered from the next one on, then in a mirror, where edges change places."""
    original = team(load=[0.01, 0.0, 0.005])
    motion = morphed(original, CORNERS, WIDER)
    shifted = replace(
        original,
        cable_length=np.roll(original.cable_length, -1),
        tension=np.roll(original.tension, -1),
        load=np.roll(original.load, -1),
    )
    renumbered = morphed(shifted, np.roll(CORNERS, -1, axis=0), np.roll(WIDER, -1, axis=0))
    assert row(renumbered) == pytest.approx(row(motion), rel=1e-4)
    # In the mirror edge k, from vertex k to k + 1, leads from -k to -k - 1
    mirror = np.array([-1.0, 1.0])
    vertices, edges = np.array([0, 2, 1]), np.array([2, 1, 0])
    reflected = replace(
        original,
        cable_length=original.cable_length[edges],
        tension=original.tension[edges],
        load=original.load[vertices],
    )
    mirrored = morphed(reflected, (mirror * CORNERS)[vertices], (mirror * WIDER)[vertices])
    assert row(mirrored) == pytest.approx(row(motion), rel=1e-3)


def test_it_is_linear_in_small_motions() -> None:
    """Twice the distance in the same time swings twice as far; a longer time less."""
    half = morphed(team(), CORNERS, CORNERS + 0.1 * (WIDER - CORNERS))
    whole = morphed(team(), CORNERS, CORNERS + 0.2 * (WIDER - CORNERS))
    assert row(whole) == pytest.approx(2.0 * row(half), rel=0.02)
    assert row(morphed(team(), CORNERS, WIDER, duration=4.0)) < 0.1 * row(plan())


def test_steps_converge_with_the_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error decreases by about four where steps are halved."""
    duration = carried().duration

    def at_steps(count: int) -> Array:
        """Return the distances (41, points) [m] at the same times while it moves."""
        monkeypatch.setattr(swing, "STEP", 1.0001 * duration / count)
        (hitch,) = swinging_hitches(carried())
        return hitch.distances()[: count + 1 : count // 40]

    exact = at_steps(1280)
    coarse, fine = (np.max(np.abs(at_steps(count) - exact)) for count in (80, 160))
    assert 3.0 < coarse / fine < 5.0
    assert coarse < 0.02 * np.max(exact)


def test_shapes_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate is within a few percent of one that is linear about many more rests."""
    estimate = SWING.evaluate(plan(), {}, 1.0)
    monkeypatch.setattr(swing, "MAX_CHANGE", 0.1 * swing.MAX_CHANGE)
    distances = np.concatenate([hitch.distances() for hitch in swinging_hitches(plan())])
    assert estimate is not None
    assert estimate.worst == pytest.approx(np.max(distances), rel=0.05)


def test_a_rigid_motion_has_the_response_of_a_linear_system() -> None:
    """A matrix exponential integrates the first-order system of one rest exactly."""
    (swinging,) = swinging_hitches(carried())
    linear = swinging.hitch
    size = linear.stiffness.shape[1]
    inverse = np.linalg.inv(linear.masses[0])
    matrix = np.zeros((2 * size, 2 * size))
    matrix[:size, size:] = np.eye(size)
    matrix[size:, :size] = -inverse @ linear.stiffness[0]
    matrix[size:, size:] = -inverse * linear.damping[0]
    # Accelerations are linear between samples: state, force and its slope have one exponential
    inertia = inverse @ np.kron(linear.inertia[0], np.eye(3))
    system = np.zeros((4 * size, 4 * size))
    system[: 2 * size, : 2 * size] = matrix
    system[size : 2 * size, 2 * size : 3 * size] = -inertia
    system[2 * size : 3 * size, 3 * size :] = np.eye(size) / swinging.step
    flow = expm(swinging.step * system)[: 2 * size]
    accelerations = swinging.accelerations.reshape(-1, size)
    states = np.zeros((len(accelerations), 2 * size))
    for k in range(1, len(states)):
        before, after = accelerations[k - 1 : k + 1]
        states[k] = flow @ np.concatenate([states[k - 1], before, after - before])
    places = states[:, :size]
    expected = length(places.reshape(-1, size // 3, 3)[:, linear.points])
    distances = swinging.distances()
    assert np.max(np.abs(distances - expected)) < 0.02 * np.max(expected)


def test_slower_clocks_have_the_response_of_slower_motions() -> None:
    (hitch,) = swinging_hitches(plan())
    (slow,) = swinging_hitches(plan().slowed(1.7))
    assert np.max(hitch.distances(1.7)) == pytest.approx(np.max(slow.distances()), rel=0.01)


def test_heavier_loads_swing_farther() -> None:
    rows = [row(morphed(team(load=load), CORNERS, WIDER, duration=2.0)) for load in (0.0, 0.02)]
    assert rows[1] > 1.2 * rows[0]


def test_cables_without_weight_do_not_swing() -> None:
    motion = morphed(team(density=0.0), CORNERS, WIDER)
    assert not has_inertia(motion)
    assert "swing" not in [check.name for check in certify(motion).checks]
    assert swinging_hitches(motion) == []


def test_it_is_sampled_and_named() -> None:
    check = certify(plan())["swing"]
    assert check.method == "sampled"
    assert check.where == ("p0",)
    assert 0.0 < check.time < plan().duration + swing.AFTER
    assert isinstance(swinging_hitches(plan())[0], SwingingHitch)
