"""Pushes of a rim on legs that bend over its edge: enclosures, and clasps, against samples."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.clasp_weights import contact_bound
from hitchopt.checks.bounds.rim_pushes import rim_push
from hitchopt.geometry.vectors import unit
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.values import Array

CELLS, ORDER, SAMPLES = 200, 5, 101
X = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
LEVEL = np.array([1.0, 1.0, 0.0])
SIGNS = np.array([1.0, 1.0, -1.0, 1.0])


def _blocks(turn: float) -> tuple[Array, Array, Array, Array, Array]:
    """Random vectors at clasps, some legs sinking, pulls, and the share that is borne."""
    rng = np.random.default_rng(17)
    middle = rng.normal(size=(CELLS, 6, 3, 1))
    middle[:, :, 2] = rng.uniform(-0.05, 0.4, (CELLS, 6, 1))
    vectors = middle + turn * rng.normal(size=(CELLS, 6, 3, ORDER + 1))
    rows = vectors.reshape(CELLS, 18, -1)
    tensions = rng.uniform(0.5, 1.5, (CELLS, 2, 1)) * (1.0 + turn * rng.random(ORDER + 1))
    # A leg of half weight w per length pulls with T + w z along its chord.
    rises = vectors[:, [0, 2], 2]
    pulls = np.stack([tensions + 0.05 * rises, tensions + 0.0 * rises], axis=2)
    share = np.sort(rng.random((CELLS, 1, ORDER + 1)), axis=-1)
    weights = rng.uniform(0.02, 0.1, (CELLS, 6, 1))
    return rows, pulls.reshape(CELLS, 4, -1), tensions, share, weights


def _pushes(legs: Array, P: Array, T: Array, share: Array) -> Array:
    """Return the pushes (…, 3) on legs (…, 3), whether they sink or not."""
    pushes: Array = share * (T * unit(legs * LEVEL) - P * unit(legs) * LEVEL)
    return pushes


def test_pushes_are_enclosed_and_none_where_a_leg_sinks() -> None:
    sinking = 0
    for turn in (0.0, 0.01, 0.05):
        rows, pulls, tensions, share, _ = _blocks(turn)
        legs = rows.reshape(CELLS, 6, 3, -1)[:, [0, 2]]
        along = enclosure.direction(legs, 1e-9)
        found = rim_push(legs, along, pulls[:, 0::2], tensions, share, 1e-9)
        there = bernstein.evaluate(legs, X[..., None])
        P, T = bernstein.evaluate(pulls[:, 0::2], X), bernstein.evaluate(tensions, X)
        s = bernstein.evaluate(share, X)
        each = _pushes(there, P[..., None], T[..., None], s[..., None])
        each = np.where(there[..., 2:] < 0.0, 0.0, each)
        sinking += int(np.sum(there[..., 2] < 0.0))
        error = np.sum(each, axis=2) - bernstein.evaluate(found.coefficients, X)
        assert np.all(np.linalg.norm(error, axis=-1) <= found.radius + 1e-12)
        tight = np.max(found.radius[np.all(legs[..., 2, :] > 0.05, axis=(1, 2))])
        assert tight < (1e-6 if turn == 0.0 else 2.0)
    assert sinking > 1000


def test_no_product_of_a_clasp_below_a_rim_exceeds_its_bound() -> None:
    for turn in (0.0, 0.01, 0.05):
        rows, pulls, _, share, weights = _blocks(turn)
        load = np.zeros((CELLS, 4, 1))
        load[:, 2] = -0.3
        blocks = rows[:, :12], pulls, rows[:, 12:], weights, load, share
        found = contact_bound(blocks, 1e-9)
        vectors, P, s = (bernstein.evaluate(b, X) for b in (rows, pulls, share))
        vectors = vectors.reshape(SAMPLES, CELLS, 6, 3)
        y = unit(vectors[:, :, :4])
        C = -np.sum(P[..., :2, None] * y[..., :2, :], axis=-2)
        w = weights[..., 0]
        C[..., 2] += w[:, 0] + w[:, 1] - w[:, 2] * np.linalg.norm(vectors[:, :, 4], axis=-1) + 0.15
        C -= _pushes(vectors[:, :, 0], P[..., :1], P[..., 1:2], s)
        products = np.max(np.sum(C[..., None, :] * y, axis=-1) * SIGNS, axis=-1)
        products /= np.min(P[..., 1::2], axis=-1)
        assert np.all(products <= found.bound + 1e-12)
        assert np.all(found.value <= found.bound + 1e-12)
