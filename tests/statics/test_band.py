"""Bands of rest that friction at the clasps leaves to a hitch."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from resting_hitches import random_hitch, regular_hitch, settled, standing
from scipy.optimize import root

import hitchopt as ho

seeds = st.integers(0, 2**32 - 1)
STIFFNESS, TENSION = 4.75, 0.6


def triangle(density: float = 0.0) -> ho.Hitch:
    drones = ho.Quadrotor(stiffness=STIFFNESS)
    return regular_hitch(3, TENSION, quadrotor=drones, cable_density=density)


@pytest.mark.slow
@given(seeds, st.integers(3, 6), st.sampled_from(["closed", "open"]), st.sampled_from([0.0, 0.006]))
@settings(max_examples=10)
def test_bands_hold_the_place_without_friction_and_grow_with_friction(
    seed: int, n: int, topology: str, density: float
) -> None:
    hitch = random_hitch(seed, n, topology, density=density, stiffness=20.0)
    bands = [settled(hitch, friction=friction).band for friction in (0.0, 0.002, 0.004)]
    np.testing.assert_array_equal(bands[0][:, 0], bands[0][:, 1])
    for narrow, wide in itertools.pairwise(bands):
        assert np.all(wide[:, 0] <= narrow[:, 0] + 1e-6)
        assert np.all(wide[:, 1] >= narrow[:, 1] - 1e-6)
    inner = hitch.team.layout.clasps
    assert np.all(np.ptp(bands[1][inner], axis=-1) > 1e-4)


@pytest.mark.parametrize("friction", [0.01, 0.05, 0.1])
def test_the_ends_of_a_triangles_band_are_those_of_its_five_equations(friction: float) -> None:
    """One vertex, one drone, one length: the half turn about a vertex's bisector does the rest."""
    hitch = triangle()
    side, length = 1.2, float(hitch.team.cable_length[0])
    centre = np.mean(hitch.vertices, axis=0)
    place, planned = hitch.drones[0], hitch.vertices[0]
    outward = (planned - centre) / np.linalg.norm(planned - centre)
    edge = (hitch.vertices[1] - planned) / side
    fed = TENSION * (place - planned) / np.linalg.norm(place - planned)

    def missing(unknowns: np.ndarray, friction: float) -> np.ndarray:
        drone, out, tension = unknowns[:3], unknowns[3], unknowns[4]
        leg = drone - (planned + out * outward)
        size = float(np.linalg.norm(leg))
        bend = np.arccos(-(leg / size) @ edge)
        pull = tension * np.exp(friction * bend)
        balance = STIFFNESS * (place - drone) + fed - pull * leg / size
        clasp = pull * (leg @ outward) / size - tension * np.cos(np.pi / 6)
        total = 2.0 * size + side + np.sqrt(3.0) * out - length
        return np.array([*balance, clasp, total])

    found = settled(hitch, friction=friction, axial_stiffness=1e6)
    for column, sense in enumerate((-1.0, 1.0)):
        start = np.array([*place, 0.0, TENSION])
        for share in np.linspace(0.0, 1.0, 41):
            solved = root(missing, start, args=(sense * share * friction,), tol=1e-12)
            assert solved.success
            start = solved.x
        np.testing.assert_allclose(found.band[:, column], start[3], atol=1e-5)


def test_a_per_cent_between_leg_and_edge_moves_a_vertex_by_centimetres() -> None:
    hitch = triangle(0.01)
    leg = hitch.drones[0] - hitch.vertices[0]
    edge = hitch.vertices[1] - hitch.vertices[0]
    bend = np.arccos(-leg @ edge / np.linalg.norm(leg) / np.linalg.norm(edge))
    band = settled(hitch, friction=0.01 / bend).band
    np.testing.assert_allclose(np.abs(band), 0.024, rtol=0.1)


def test_tolerance_has_the_band_of_the_team() -> None:
    kind = ho.Quadrotor(stiffness=STIFFNESS)
    hitch = regular_hitch(3, TENSION, cable_friction=0.05, quadrotor=kind)
    found = ho.tolerance(standing(hitch), [0.5, 1.0])
    np.testing.assert_allclose(found.band, [settled(hitch).band] * 2, atol=1e-7)
    assert np.all(np.sign(found.band) == [-1.0, 1.0])
    assert np.all(np.abs(found.band) > 0.05)


def test_without_rest_the_band_has_no_end() -> None:
    found = settled(triangle(), friction=3.0)
    assert np.all(np.isinf(found.band).any(axis=-1))
