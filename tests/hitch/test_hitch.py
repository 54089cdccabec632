"""Hitches at rest: balance at the clasps, lengths, loads and roll, open ends, closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.forces import (
    ClaspLoads,
    contact_forces,
    leg_directions,
)
from tests.helpers.by_hand import catenary
from tests.helpers.clasp_balance import KINDS, random_hitch

seeds = st.integers(0, 2**32 - 1)
topologies = st.sampled_from(["closed", "open"])


@given(seeds, st.integers(3, 9), topologies, st.sampled_from(KINDS))
@settings(max_examples=120)
def test_clasps_are_balanced_and_parts_add_up_to_the_cables(
    seed: int, n: int, topology: str, kind: str
) -> None:
    """Written out by catenaries: forces at every clasp, and the arc of every span."""
    h = random_hitch(seed, n, topology, kind)
    T, layout, rho = h.team.tension, h.team.layout, 9.81 * h.team.cable_density
    p, x = h.vertices, h.drones.reshape(-1, 2, 3)
    here, following = p[layout.starts], p[layout.ends]
    spans = np.stack([x[:, 0] - here, following - here, x[:, 1] - following], axis=1)
    length = np.linalg.norm(spans, axis=-1)
    half = np.full(length.shape, 0.5 * rho)
    start, end, arcs = catenary(spans, np.repeat(T[:, None], 3, axis=1), half)
    tolerance = 2e-7 if rho else 1e-12
    np.testing.assert_allclose(np.sum(arcs, axis=1), h.team.cable_length, rtol=tolerance)
    np.testing.assert_allclose(h.legs, length[:, ::2], atol=1e-15)
    if kind in KINDS[:2]:
        np.testing.assert_allclose(x[..., 2], 0.8)
    if topology == "open":
        np.testing.assert_allclose([x[0, 0], x[-1, 1]], p[[0, -1]], atol=1e-15)
    on_drones = -end[:, ::2]
    if topology == "open":  # the edge pulls where a chain's end has no leg
        on_drones[0, 0] = start[0, 1]
        on_drones[-1, 1] = -end[-1, 1]
    np.testing.assert_allclose(
        h.cable_forces.reshape(n, 2, 3), on_drones, atol=1e-6 if rho else 1e-12
    )
    tolerance = {"loaded": 1e-12, "heavy": 1e-6}.get(kind, 1e-9)
    for k, (a, b) in enumerate(zip(layout.ahead, layout.behind, strict=True)):
        force = start[a, 0] + start[a, 1] + start[b, 2] - end[b, 1]
        force[2] -= 9.81 * h.team.load[k]
        assert np.linalg.norm(force) < tolerance * T[a], k


@given(seeds, st.integers(3, 30))
@settings(max_examples=30)
def test_equal_tensions_give_the_papers_positions(seed: int, n: int) -> None:
    """Its eq. (4)."""
    h = random_hitch(seed, n, kind="equal")
    p, u, (d, e) = h.polygon.vertices, h.polygon.edge_directions, h.legs.T[..., None]
    np.testing.assert_allclose(h.drones[0::2, :2], p + d * np.roll(u, 1, axis=0), atol=1e-12)
    r = np.roll(p, -1, axis=0) - e * np.roll(u, -1, axis=0)
    np.testing.assert_allclose(h.drones[1::2, :2], r, atol=1e-12)


@given(seeds, st.integers(3, 12), topologies)
@settings(max_examples=60)
def test_contact_forces_follow_the_closed_form_and_press(seed: int, n: int, topology: str) -> None:
    h = random_hitch(seed, n, topology)
    layout, u, T = h.team.layout, h.polygon.edge_directions, h.team.tension
    a, b = layout.ahead, layout.behind
    V = T[b, None] * u[b] - T[a, None] * u[a]
    sine = u[b, 1] * u[a, 0] - u[b, 0] * u[a, 1]
    forces = contact_forces(u, T, topology)
    expected = 2.0 * T[a] * T[b] * sine / np.linalg.norm(V, axis=1)
    np.testing.assert_allclose(forces, expected, rtol=1e-9)
    assert np.all(forces > 0.0)


def test_a_positive_roll_raises_q_and_lowers_the_other_drone_of_its_clasp() -> None:
    """Half of the interior angle is between legs and V, about which they turn."""
    roll = np.array([0.0, 0.3, 0.0, -0.2, 0.0])
    h = Hitch.balanced(Team(5, 2.0), regular_polygon(5, 1.0), roll=roll)
    raised = 0.5 * math.sin(0.5 * math.radians(108.0)) * np.sin(roll)
    np.testing.assert_allclose(h.drones[0::2, 2] - 1.0, raised, atol=1e-12)
    np.testing.assert_allclose(np.roll(h.drones[1::2, 2], 1) - 1.0, -raised, atol=1e-12)


@pytest.mark.parametrize("n", [3, 4, 6, 12])
def test_the_largest_weight_of_regular_hitches(n: int) -> None:
    """``W < 2 n T cos(π/n)`` of all clasps together; legs rise by ``sin α = W / 2nT``."""
    polygon, most = regular_polygon(n, 1.0), 2.0 * 0.6 * math.cos(math.pi / n)

    def tied(share: float, tension: float = 0.6) -> Hitch:
        return Hitch.balanced(Team(n, 2.0, tension=tension, load=share * most / 9.81), polygon)

    for share in (0.5, 0.999):
        rise = (tied(share).drones[:, 2] - 1.0) / 0.5
        np.testing.assert_allclose(rise, share * most / 1.2, rtol=1e-9)
    with pytest.raises(InfeasibleError, match=r"load: .* above the limit of .* at p\d") as told:
        tied(1.25)
    (violation,) = told.value.violations
    assert (violation.value, violation.limit) == pytest.approx((1.25 * most, most), rel=1e-9)
    assert "multiply team.tension by 1.26 or more" in violation.remedy
    tied(1.25, 0.6 * 1.26)


def test_refused_clasps_exceed_their_limits() -> None:
    """Nearly straight cables of unlike tensions, whose legs pull harder the higher they rise."""
    rng = np.random.default_rng(5)
    told: list[Violation] = []
    for _ in range(300):
        angles = np.cumsum(rng.uniform(0.0, 0.2, 2))
        u = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(2)])
        forces = np.append(rng.choice([0.0, 0.3]) * rng.normal(size=2), -rng.uniform(0.0, 0.6))
        loads = ClaspLoads(forces[None], np.zeros(1), np.zeros((1, 2)))
        try:
            leg_directions(u, rng.uniform(0.3, 0.5, 2), "open", loads)
        except InfeasibleError as error:
            told += error.violations
    assert {violation.constraint for violation in told} == {"load", "tension"}
    assert all(violation.value > violation.limit for violation in told)


def test_legs_at_a_chains_ends_are_fixed() -> None:
    team = Team(2, [2.0, 2.2], topology="open", tension=[0.4, 0.45])
    points = [[-0.6, -0.3], [0.5, 0.5], [1.7, -0.3]]
    slack = 2.2 - math.hypot(1.2, 0.8)
    h = Hitch(team, points, 1.2, [0.0, round(slack, 5)])  # to within 1e-4 of the cable: as meant
    assert h.q_legs[1] == pytest.approx(slack, abs=1e-15)
    with pytest.raises(InfeasibleError, match=r"above the limit of 0 m at q0; q0 is at the ch"):
        Hitch(team, points, 1.2, [0.1, slack])
    with pytest.raises(InfeasibleError, match=r"at q1; r1 is at the chain's end, .* 0\.75777"):
        Hitch(team, points, 1.2, [0.0, slack - 0.01])
