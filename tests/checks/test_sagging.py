"""Bounds of sagging cables over spans of time: no sample exceeds them."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.checks.sagging import CURVATURE, LARGEST, sagging_part
from hitchopt.hitch.taut import closed_sag
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Enclosed
from tests.helpers.by_hand import catenary


@pytest.mark.parametrize("change", [0.0, 0.01, 0.1, 0.4])
def test_no_sample_exceeds_the_bounds_of_a_part(change: float) -> None:
    rng = np.random.default_rng(4)
    spans, degree = 40, 5
    chords = rng.uniform(-0.8, 0.8, (spans, 3, 1)) + [[0.9], [0.0], [0.0]]
    chords = chords + change * rng.uniform(-1.0, 1.0, (spans, 3, degree + 1))
    ratios = rng.uniform(0.02, 0.2, (spans, 1, 1)) * (1.0 + change * rng.uniform(size=degree + 1))
    part = sagging_part(Enclosed(chords), Enclosed(ratios))
    x = np.linspace(0.0, 1.0, 21)

    def sampled(coefficients: np.ndarray) -> np.ndarray:
        basis = bernstein.basis(x, bernstein.degree(coefficients)).T
        return np.asarray(np.moveaxis(coefficients @ basis, -1, 0))

    at, half = sampled(chords), sampled(ratios)[..., 0]
    start, end, size = catenary(at, np.ones(half.shape), half)
    for bound, exact in (
        (part.length, size[..., None]),
        (part.force(), start),
        (part.force(second=True), end),
    ):
        error = np.linalg.norm(sampled(bound.c) - exact, axis=-1)
        assert np.all(error <= np.asarray(bound.r) + 5e-6)  # of the series
    if change <= 0.01:
        assert np.max(part.length.r) < 1e-3


def test_second_derivatives_are_within_their_bound() -> None:
    level, rise = np.meshgrid(np.linspace(1e-4, LARGEST, 41), np.linspace(1e-4, LARGEST, 41))
    level, rise = (each[level + rise < LARGEST] for each in (level, rise))
    step = 1e-5
    for along in ((1.0, 0.0), (0.0, 1.0), (0.7, 0.3), (0.5, -0.5)):
        places = [
            closed_sag(level + k * step * along[0], rise + k * step * along[1]) for k in (-1, 0, 1)
        ]
        for name in ("stretch", "bulge"):
            before, here, after = (getattr(sag, name) for sag in places)
            second = np.abs(before - 2.0 * here + after) / step**2
            limit = CURVATURE / (1.0 - level - rise) ** 6
            assert np.all(second <= limit)
