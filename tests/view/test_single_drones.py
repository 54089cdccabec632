"""Pictures of single drones, looked for among what is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Text

from hitchopt.checks import certify
from hitchopt.checks.bounds.closest_pairs import closeness
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion, Phase
from hitchopt.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.view.closeness_picture import draw_closeness
from hitchopt.view.summary import draw_summary, save_summary

PRISM = Prism([[4.0, 1.0], [4.0, 2.0], [5.0, 1.5]], 0.0, 1.0)


def swarm(n: int) -> Motion:
    """Drones side by side, off the origin, that all go by one offset."""
    start = np.column_stack([2.0 + 0.5 * np.arange(n), np.full(n, -1.0), np.full(n, 1.0)])
    share = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    c = start[:, :, None] + np.array([0.3, 1.2, 0.2])[:, None] * share
    curves = PiecewisePolynomial(np.array([0.0, 3.0]), c[None])
    arena = Arena([1, -2, 0], [25, 3, 2])
    phase = (Phase("fly", 0, 0.0, 3.0),)
    return Motion.single(
        Swarm(n), Requirements(Limits(), Separation(), arena, keep_out=(PRISM,)), curves, phase
    )


@pytest.mark.parametrize("n", [1, 5, 40])
def test_the_summary_shows_paths_ends_prisms_and_arena(n: int) -> None:
    motion = swarm(n)
    figure = draw_summary(motion, certify(motion), "Side by side")
    above = figure.axes[0]
    (paths,) = (c for c in above.collections if isinstance(c, LineCollection))
    segments = paths.get_segments()
    assert len(segments) == n
    np.testing.assert_allclose(segments[0][0], [2.0, -1.0])
    np.testing.assert_allclose(segments[-1][-1], [2.0 + 0.5 * (n - 1) + 0.3, 0.2])
    ends = [c for c in above.collections if isinstance(c, EllipseCollection)]
    assert [np.shape(c.get_offsets())[0] for c in ends] == [n, n]
    (prism,) = (p for p in above.patches if isinstance(p, Polygon))
    np.testing.assert_allclose(prism.get_xy()[:3], PRISM.polygon.vertices)
    (arena,) = (p for p in above.patches if isinstance(p, Rectangle))
    assert (arena.get_x(), arena.get_width()) == (1.0, 24.0)
    words = "\n".join(text.get_text() for text in figure.findobj(Text))
    assert f"{n} drones, 3 s; certified for all t" in words
    assert "Side by side" in words
    assert ("d0" in words.split("\n")) is (n <= 30)
    assert len(figure.axes) == (3 if n == 1 else 4)  # a single drone has no separation


def test_it_is_written_as_a_picture(tmp_path: Path) -> None:
    motion = swarm(3)
    save_summary(tmp_path / "summary.png", motion, certify(motion))
    assert (tmp_path / "summary.png").read_bytes()[:4] == b"\x89PNG"


def test_the_closest_pairs_are_drawn_above_their_bounds() -> None:
    motion = swarm(4)
    found = closeness(motion, 6)
    (axes,) = draw_closeness(motion, found).axes
    labels = [line.get_label() for line in axes.get_lines()]
    pair = found.pairs[0]
    label = f"{pair.pair[0]}, {pair.pair[1]} (≥ {pair.bound:.3f})"
    assert label in labels
    (curve,) = (line for line in axes.get_lines() if line.get_label() == label)
    assert np.min(np.asarray(curve.get_ydata())) >= pair.bound - 1e-9
    assert np.asarray(curve.get_xdata())[-1] == 3.0
