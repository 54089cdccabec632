"""A clasp through which cables slide: forces by hand, derivatives by differences."""

import numpy as np
from clasp_balance import random_hitch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.model import slipping_drones

Array = NDArray[np.float64]


def still(values: Array) -> Array:
    """Jets (1, …, 4) of what does not change."""
    jets = np.zeros((1, *values.shape, 4))
    jets[0, ..., 0] = values
    return jets


def drones_at(h: Hitch, pulls: Array) -> Array:
    """(clasps, 2, 3): r_{k-1} and q_k for pulls (n, 2)."""
    T = h.team.tension
    found = slipping_drones(h.team, still(h.vertices), still(h.legs), still(T), still(pulls))
    return found[0, ..., 0]


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(3, 7))
@settings(max_examples=40)
def test_forces_balance_for_any_pulls_that_can(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    h = random_hitch(seed, n)
    pulls = h.team.tension[:, None] * np.exp(rng.uniform(-0.2, 0.2, (n, 2)))
    places = drones_at(h, pulls)
    corners = h.vertices
    u = np.roll(corners, -1, axis=0) - corners
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    for k in range(n):
        behind, before = (k - 1) % n, u[k - 1]
        V = h.team.tension[behind] * before - h.team.tension[k] * u[k]
        a, b = pulls[k, 0], pulls[behind, 1]
        size = np.linalg.norm(V)
        if not abs(a - b) < size < a + b:
            assert np.all(np.isnan(places[k, :, :2]))
            continue
        legs = places[k] - corners[k]
        np.testing.assert_allclose(
            np.linalg.norm(legs, axis=1), [h.legs[behind, 1], h.legs[k, 0]], rtol=1e-9
        )
        r_hat, q_hat = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        np.testing.assert_allclose(a * q_hat + b * r_hat, V, atol=1e-9)
        right = np.array([V[1], -V[0], 0.0])
        assert right @ r_hat <= 0.0 <= right @ q_hat  # clasped


def test_by_how_much_legs_of_a_regular_hitch_lean() -> None:
    """Both let out alike at every clasp: half of V is ``P cos`` of what they enclose with it."""
    for n in (3, 4, 6):
        team = Team(n, 2.4, tension=0.5)
        h = Hitch.balanced(team, regular_polygon(n, 1.0).translated([3.0, -2.0]), altitude=1.5)
        interior = np.pi - 2.0 * np.pi / n
        for factor in (0.95, 1.1):
            places = drones_at(h, np.full((n, 2), factor * 0.5))
            centre = np.mean(h.vertices, axis=0)
            legs, outward = places - h.vertices[:, None], h.vertices - centre
            cosine = np.einsum("kex,kx->ke", legs, outward)
            cosine /= np.linalg.norm(legs, axis=-1) * np.linalg.norm(outward, axis=-1)[:, None]
            np.testing.assert_allclose(cosine, np.cos(0.5 * interior) / factor, rtol=1e-12)


def test_derivatives_are_those_of_differences() -> None:
    rng = np.random.default_rng(11)
    h = random_hitch(11, 5)
    n, step = 5, 1e-3
    base = [h.vertices, h.legs, h.team.tension, np.repeat(h.team.tension[:, None], 2, axis=1)]
    slopes = [
        scale * rng.normal(size=(3, *value.shape))
        for scale, value in zip((0.1, 0.05, 0.01, 0.02), base, strict=True)
    ]
    slopes[0][..., 2] = 0.0  # level

    def at(t: float) -> Array:
        jets = []
        for value, (a, b, c) in zip(base, slopes, strict=True):
            rows = [
                value + a * t + b * t**2 + c * t**3,
                a + 2 * b * t + 3 * c * t**2,
                2 * b + 6 * c * t,
                6 * c,
            ]
            jets.append(np.stack(rows, axis=-1)[None])
        drones: Array = slipping_drones(h.team, *jets)[0]
        return drones

    before, here, after = at(-step), at(0.0), at(step)
    assert here.shape == (n, 2, 3, 4)
    for order in range(3):
        slope = (after[..., order] - before[..., order]) / (2.0 * step)
        np.testing.assert_allclose(slope, here[..., order + 1], atol=2e-4)
