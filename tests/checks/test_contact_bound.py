"""The bound on what a clasp's contact force does, against its samples."""

from __future__ import annotations

import numpy as np

from hitchopt.checks.bounds.clasp_weights import contact_bound
from hitchopt.geometry.vectors import unit
from hitchopt.trajectory import bernstein
from hitchopt.values import Array

CELLS, ORDER, SAMPLES = 200, 5, 101
SIGNS = np.array([1.0, 1.0, -1.0, 1.0])


def _blocks(turn: float) -> tuple[Array, ...]:
    """Random clasps of equal tensions; vectors turn by about ``turn`` [rad], pulls vary with it."""
    rng = np.random.default_rng(7)
    vectors = rng.normal(size=(CELLS, 6, 3, 1)) + turn * rng.normal(size=(CELLS, 6, 3, ORDER + 1))
    rows = vectors.reshape(CELLS, 18, -1)
    pulls = rng.uniform(0.3, 0.6, (CELLS, 4, 1)) * (1.0 + turn * rng.random(ORDER + 1))
    pulls[:, 3] = pulls[:, 1]
    shares = rng.uniform(0.02, 0.1, (CELLS, 6, 1))
    return rows[:, :12], pulls, rows[:, 12:], shares


def _samples(blocks: tuple[Array, ...]) -> Array:
    """Return (cells, samples): the largest product that should be negative, over its tension."""
    x = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    rows, pulls, others, shares = (bernstein.evaluate(block, x) for block in blocks)
    y = unit(rows.reshape(SAMPLES, CELLS, 4, 3))
    C = -np.sum(pulls[..., :2, None] * y[..., :2, :], axis=-2)
    carried = shares[..., 2] * np.linalg.norm(others[..., :3], axis=-1)
    C[..., 2] += shares[..., 0] + shares[..., 1] - carried
    products = np.max(np.sum(C[..., None, :] * y, axis=-1) * SIGNS, axis=-1)
    found: Array = (products / np.min(pulls[..., 1::2], axis=-1)).T
    return found


def test_no_sample_exceeds_the_bound() -> None:
    for turn in (0.0, 0.01, 0.1, 0.5):
        blocks = _blocks(turn)
        found = contact_bound(blocks, 1e-9)
        assert np.all(_samples(blocks) <= found.bound[:, None])
        assert np.all(found.value <= found.bound)


def test_lengths_of_other_legs_count_by_themselves() -> None:
    """Nothing turns: only what a leg of changing length carries differs."""
    rows, pulls, others, shares = _blocks(0.0)
    longer = 1.0 + np.random.default_rng(8).random((CELLS, 1, ORDER + 1))
    blocks = rows, pulls, others * longer, shares
    assert np.all(_samples(blocks) <= contact_bound(blocks, 1e-9).bound[:, None])


def test_the_bound_is_tight_where_nothing_turns() -> None:
    found = contact_bound(_blocks(0.0), 0.0)
    assert np.allclose(found.bound, found.value, rtol=0.0, atol=1e-9)


def test_noise_widens_the_bound() -> None:
    blocks = _blocks(0.01)
    assert np.all(contact_bound(blocks, 1e-3).bound > contact_bound(blocks, 0.0).bound)
