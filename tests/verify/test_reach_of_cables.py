"""No point of a hanging or loose cable is beyond what ``verify`` takes for its reach."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hitchopt import verify as second
from hitchopt.geometry.vectors import unit
from hitchopt.motion.plan_file import write_plan
from hitchopt.values import Array
from hitchopt.verify import catenary
from hitchopt.verify.arithmetic import Curve, Effort
from hitchopt.verify.plan import HANGING, LOOSE
from hitchopt.verify.spans import Spans
from tests.helpers.plans import planned


def hanging(ends: Array, length: float, tracking: float = 0.0, ratio: float = 1.0) -> Spans:
    """Return cables at rest between ends (m, 2, 3) [m]."""
    m = len(ends)
    plan: Any = SimpleNamespace(h=np.ones(1), breaks=np.arange(2.0), effort=Effort(10**6))
    plan.length, plan.tracking, plan.ratio = np.full((m, 1), length), tracking, ratio
    plan.state, plan.points = np.array([HANGING]), Curve(ends.reshape(1, -1, 3, 1), plan.h)
    piece = np.zeros(m, dtype=int)
    return Spans(plan, piece, np.arange(m)[:, None], np.full(m, 0.5), np.full(m, 1e-9))


@pytest.mark.parametrize("ratio", [1.0, 2.5])
@pytest.mark.parametrize("share", [0.3, 0.9, 0.99, 0.9999])
def test_errors_of_ends_move_no_point_of_a_cable_farther_than_told(
    share: float, ratio: float
) -> None:
    """Both ends err by up to the tracking error, upright by that times the ratio.

    ``share`` is that of the longest horizontal span of ends that err.
    """
    rng = np.random.default_rng(5)
    m, length, tracking = 200, 2.4, 0.015
    ends = np.zeros((m, 2, 3))
    ends[4:, 1, 2] = rng.uniform(-0.3, 0.3, m - 4) * length
    highest = np.abs(ends[:, 1, 2]) + 2.0 * tracking * ratio
    ends[:, 1, 0] = share * np.sqrt(length**2 - highest**2) - 2.0 * tracking
    errors = rng.normal(size=(m, 2, 3))
    errors[::2, 1] = -errors[::2, 0]  # most effect
    errors[:4] = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]  # apart
    erring = ends + tracking * unit(errors) * [1.0, 1.0, ratio]
    still, flown = (hanging(x, length, tracking, ratio) for x in (ends, erring))
    k = np.arange(m)
    told = tracking + catenary.shift(still, k).v[:, 0]
    sigma = [catenary.catenary(s, 2 * k)[1].v[:, 0] for s in (still, flown)]
    farthest = np.zeros(m)
    for mu in np.linspace(-1.0, 1.0, 41):
        points = []
        for x, g in zip((ends, erring), sigma, strict=True):
            chord = x[:, 1] - x[:, 0]
            depth = catenary.catenary_depth(np.full(m, length), chord[:, 2], g, mu)
            points.append(x[:, 0] + 0.5 * (1.0 + mu) * chord - depth[:, None] * [0.0, 0.0, 1.0])
        off = (points[1] - points[0]) / [1.0, 1.0, ratio]
        farthest = np.maximum(farthest, np.linalg.norm(off, axis=-1))
    assert np.all(farthest <= told)
    assert np.max(farthest / told) > 0.12


def test_hanging_cables_stay_above_the_lowest_corner_of_their_regions() -> None:
    rng = np.random.default_rng(3)
    m, length = 200, 2.4
    k = np.arange(m)
    ways = unit(rng.normal(size=(m, 3)) * [1.0, 1.0, 0.5])
    ends = np.zeros((m, 2, 3))
    ends[:, 1] = (rng.uniform(0.1, 0.99, m) * length)[:, None] * ways
    s = hanging(ends, length)
    q, r, lowest = (corner.v for corner in s.sheet(k))
    assert np.all(r == ends[:, 1])
    sigma = catenary.catenary(s, 2 * k)[1].v[:, 0]
    for mu in np.linspace(-1.0, 1.0, 41):
        share = 0.5 * (1.0 + mu)
        depth = catenary.catenary_depth(np.full(m, length), r[:, 2] - q[:, 2], sigma, mu)
        assert np.all(lowest[:, 2] <= (q + share * (r - q))[:, 2] - depth + 1e-9)
    np.testing.assert_allclose(lowest[:, :2], 0.5 * (q + r)[:, :2], atol=1e-12)


@pytest.mark.parametrize("state", [None, LOOSE])
def test_loose_cables_end_above_their_hulls(state: str | None, tmp_path: Path) -> None:
    """A cable of any shape is within an ellipsoid about its ends."""
    write_plan(tmp_path / "plan.npz", planned("form_square").flight)
    (own,), _ = second.read(tmp_path / "plan.npz")
    rng = np.random.default_rng(2)
    piece, k = np.repeat(np.flatnonzero(own.clasping), own.n), np.arange(own.n)
    k = np.resize(k, len(piece))
    if state is not None:
        own.state = np.where(own.clasping, state, own.state)
    s = Spans(own, piece, k[:, None], rng.uniform(size=len(k)), np.zeros(len(k)))
    q, r = (x.v for x in s.ends(k))
    lowest = np.full(len(k), np.inf)
    for way in unit(rng.normal(size=(4000, 3)) - [0.0, 0.0, 1.0]):
        chord, length = r - q, own.length[k, 0]
        square = length**2 - np.sum(chord**2, axis=-1)
        straight = 0.5 * square / (length - chord @ way)  # from q, then straight to r
        lowest = np.minimum(lowest, q[:, 2] + straight * way[2])
    told = s.hull(k)[-1].v[:, 2]
    assert np.all(told <= lowest + 1e-9)
    if state is LOOSE:
        np.testing.assert_allclose(told, lowest, atol=0.01)
