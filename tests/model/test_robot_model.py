"""The casadi model: derivatives by finite differences, values by the hitch's own formulas."""

from typing import Any, Literal

import casadi as ca
import numpy as np
import pytest
from clasp_balance import clasp_residuals
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.model import array_machine
from hitchopt.model.evaluation import FlatJets, drone_jets
from hitchopt.model.loaded_clasp import loaded_clasp_function, loaded_planar_function
from hitchopt.model.robot import planar_function, robot_function
from hitchopt.model.slipping import slipping_clasp_function
from hitchopt.model.straight_legs import straight_legs
from problems.random_morph import random_convex_polygon


def hitch(seed: int, n: int, *, equal: bool) -> Hitch:
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 1.2, rng).translated(rng.normal(size=2))
    tension = 0.5 if equal else rng.uniform(0.4, 0.6, n)
    lengths = float(np.max(polygon.edge_lengths)) + rng.uniform(0.5, 1.0, n)
    team = Team(n, lengths, tension=tension)
    slack = team.cable_length - polygon.edge_lengths
    return Hitch(team, polygon, 0.8, slack * rng.uniform(0.3, 0.7, n))


def curve(h: Hitch, seed: int, t: np.ndarray, *, tensions_move: bool) -> FlatJets:
    """Flat outputs on random cubics in time through the hitch, as jets at times t (J,)."""
    rng = np.random.default_rng(seed)
    powers = np.stack(
        [
            np.stack([t**3, 3 * t**2, 6 * t, np.full_like(t, 6.0)], axis=-1),
            np.stack([t**2, 2 * t, np.full_like(t, 2.0), 0 * t], axis=-1),
            np.stack([t, np.ones_like(t), 0 * t, 0 * t], axis=-1),
        ]
    )

    def moving(value: np.ndarray, size: float) -> np.ndarray:
        jet = np.zeros((len(t), *value.shape, 4))
        jet[..., 0] = value
        coefficients = size * rng.normal(size=(3, *value.shape))
        jet += np.einsum("c...,ctk->t...k", coefficients, powers)
        return jet

    tensions = moving(h.team.tension, 0.02 if tensions_move else 0.0)
    return FlatJets(moving(h.vertices, 0.1), moving(h.q_legs, 0.05), tensions)


def functions() -> list[ca.Function]:
    found = [f(equal) for f in (robot_function, planar_function) for equal in (True, False)]
    found += [loaded_clasp_function(weighty, True) for weighty in (True, False)]
    found += [loaded_planar_function(weighty) for weighty in (True, False)]
    return [*found, slipping_clasp_function()]


NAMES = [
    *("equal tensions", "any tensions", "from above, equal", "from above, any"),
    *("heavy cables", "loads alone", "heavy, from above", "loads, from above", "slipping"),
]


@pytest.mark.slow
@pytest.mark.parametrize("function", functions(), ids=NAMES)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=5)
def test_every_derivative_of_every_output_by_finite_differences(
    function: ca.Function, seed: int
) -> None:
    """By every input entry, through casadi's own Jacobian."""
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(5, 1.2, rng)
    points = np.column_stack([polygon.vertices, rng.normal(scale=0.05, size=5)])
    jets = rng.normal(scale=0.3, size=(12, 4))
    jets[:, 0] = points[:4].ravel()
    legs = np.array([[0.4, 0.1, -0.2, 0.3], [0.35, 0.0, 0.1, 0.2], [0.45, 0.2, 0.1, -0.1]])
    tensions = rng.normal(scale=0.05, size=(3, 4))
    tensions[:, 0] = [0.8, 0.9, 0.85]
    roll = np.array([[0.3, 0.1, -0.2, 0.1], [-0.4, 0.2, 0.1, 0.0]])
    loads = [0.01, 0.02, -0.06, -0.01, 0.0, -0.05]
    level = polygon.vertices[:4].ravel()
    sides = rng.normal(scale=0.02, size=(3, 4))
    sides[:, 0] = points[2] - points[0]
    weights = rng.normal(scale=0.02, size=(3, 4))
    inputs: dict[str, list[Any]] = {
        "planar": [level, 0.4, tensions[:, 0], 2.2],
        "robot": [jets, legs[:1], tensions, 2.2, 0.13],
        "loaded_clasp": [jets[:9], legs[:2], tensions[:2], roll[:1], 2.1, loads[:3], 0.1],
        "loaded_planar": [level, legs[:, 0], tensions[:, 0], [2.1, 2.2], roll[:, 0], loads, 0.1],
        "slipping_clasp": [
            *(jets[:9], legs[:2], tensions[:2], 1.02 * tensions[:2], sides, weights),
            0.05 * legs[:2],
        ],
    }
    given_values = inputs[function.name()]
    flat = np.concatenate([np.asarray(v, dtype=float).ravel(order="F") for v in given_values])
    shapes = [function.size_in(i) for i in range(function.n_in())]
    symbol = ca.MX.sym("x", len(flat))
    parts, first = [], 0
    for rows, columns in shapes:
        parts.append(ca.reshape(symbol[first : first + rows * columns], rows, columns))
        first += rows * columns
    stacked = ca.vertcat(*(ca.vec(output) for output in function.call(parts)))
    value = ca.Function("value", [symbol], [stacked])
    exact = np.asarray(ca.Function("jacobian", [symbol], [ca.jacobian(stacked, symbol)])(flat))
    step = 1e-5
    for i in range(len(flat)):
        shifted = np.zeros(len(flat))
        shifted[i] = step
        # Fourth-order central differences.
        around = [np.asarray(value(flat + k * shifted)).ravel() for k in (-2.0, -1.0, 1.0, 2.0)]
        difference = (around[0] - 8 * around[1] + 8 * around[2] - around[3]) / (12 * step)
        scale = 1.0 + np.max(np.abs(exact[:, i]))
        np.testing.assert_allclose(difference, exact[:, i], atol=2e-7 * scale)


@given(st.integers(0, 2**32 - 1), st.integers(3, 9), st.booleans())
@settings(max_examples=20)
def test_jets_are_the_derivatives_along_a_curve(seed: int, n: int, equal: bool) -> None:
    h = hitch(seed, n, equal=equal)
    step = 1e-3
    t = step * np.arange(-2.0, 3.0)
    jets = drone_jets(h.team, curve(h, seed, t, tensions_move=not equal))
    for values in (jets.positions, jets.legs):
        for order in range(3):
            f = values[..., order]
            difference = (f[0] - 8 * f[1] + 8 * f[3] - f[4]) / (12 * step)
            scale = 1.0 + np.max(np.abs(values[2, ..., order + 1]))
            np.testing.assert_allclose(difference, values[2, ..., order + 1], atol=1e-5 * scale)


@given(st.integers(0, 2**32 - 1), st.integers(3, 12), st.booleans())
@settings(max_examples=20)
def test_values_are_the_hitchs_own(seed: int, n: int, equal: bool) -> None:
    h = hitch(seed, n, equal=equal)
    flat = curve(h, seed, np.array([0.0, 0.3]), tensions_move=False)
    jets = drone_jets(h.team, flat)
    np.testing.assert_allclose(jets.positions[0, ..., 0], h.drones, atol=1e-12)
    np.testing.assert_allclose(jets.cable_forces[0], h.cable_forces, atol=1e-12)
    np.testing.assert_allclose(jets.legs[0, :, :, 0], h.legs, atol=1e-12)
    p, x = flat.vertices[..., 0], jets.positions[..., 0]
    ends = np.roll(p, -1, axis=1)
    pieces = x[:, 0::2] - p, ends - p, x[:, 1::2] - ends
    used = np.sum([np.linalg.norm(piece, axis=-1) for piece in pieces], axis=0)
    np.testing.assert_allclose(used, np.tile(h.team.cable_length, (2, 1)), atol=1e-12)
    weight = h.team.mass[:, None] * (jets.positions[..., 2] + [0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(jets.thrusts, weight - jets.cable_forces, atol=1e-12)
    residuals = clasp_residuals(p, x[:, 0::2], x[:, 1::2], flat.tensions[..., 0])
    np.testing.assert_allclose(residuals, 0.0, atol=1e-9)


@pytest.mark.parametrize("topology", ["closed", "open"])
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(3, 7))
@settings(max_examples=10)
def test_straight_legs_are_the_robots_of_equal_tensions(
    topology: Literal["closed", "open"], seed: int, n: int
) -> None:
    """Vectors of any robots at once, against casadi's robots one by one."""
    rng = np.random.default_rng(seed)
    team = Team(n, 4.0, topology=topology, tension=0.7)
    layout, count = team.layout, 3
    vertices = rng.normal(size=(count, layout.points, 3, 4))
    vertices[..., 0] += 3.0 * np.arange(layout.points)[:, None] ** [1.0, 0.5, 0.0]
    q_legs = rng.normal(size=(count, n, 4))
    drones, along, r_legs = straight_legs(team, vertices, q_legs)
    robot, tensions = robot_function(True), np.zeros((3, 4))
    tensions[:, 0] = 0.7
    for j in range(count):
        for k in range(n):
            points = vertices[j, layout.stencil[k]].reshape(12, 4)
            found = robot(points, q_legs[j, k][None], tensions, 4.0, 0.1)
            q, r, q_force, r_force, _, _, r_leg = map(np.asarray, found)
            np.testing.assert_allclose(drones[j, k], [q, r], rtol=1e-10, atol=1e-10)
            np.testing.assert_allclose(0.7 * along[j, k], [*q_force.T, *r_force.T], atol=1e-12)
            np.testing.assert_allclose(r_legs[j, k], r_leg[0], rtol=1e-10, atol=1e-10)


def test_batches_and_their_padding_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    h = hitch(4, 7, equal=False)
    flat = curve(h, 4, np.linspace(0.0, 0.1, 5), tensions_move=False)
    whole = drone_jets(h.team, flat)
    monkeypatch.setattr(array_machine, "BATCH", 8)  # 35 columns in five batches, the last padded
    parts = drone_jets(h.team, flat)
    np.testing.assert_array_equal(parts.positions, whole.positions)
    np.testing.assert_array_equal(parts.thrusts, whole.thrusts)
