"""Pictures of open chains: every cable and point, and numbers that lie on no cable."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.text import Annotation

import hitchopt as ho
from hitchopt.view.summary import draw_summary


def drawn(n: int) -> tuple[ho.Plan, Figure, Axes]:
    headings = np.radians(np.linspace(60.0, -60.0, n))
    steps = 1.4 * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.array([2.0, -1.0]) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    team = ho.Team(n, 2.1 + 0.05 * np.arange(n), topology="open")
    plan = ho.hold(ho.Hitch.balanced(team, points), 1.0)
    figure = draw_summary(plan.motion, plan.certificate, "A chain")
    return plan, figure, figure.axes[0]


@pytest.mark.parametrize("n", [2, 4])
def test_every_cable_is_drawn_over_its_own_points(n: int) -> None:
    plan, _, axes = drawn(n)
    state = plan.at(0.5)
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    (cables,) = [c for c in lines if len(c.get_segments()[0]) == 4]
    assert len(cables.get_segments()) == n
    for k, line in enumerate(cables.get_segments()):
        ends = [state.positions[2 * k], state.vertices[k], state.vertices[k + 1]]
        expected = np.array([*ends, state.positions[2 * k + 1]])[:, :2]
        np.testing.assert_allclose(line, expected, atol=1e-9)


@pytest.mark.parametrize("n", [2, 4])
def test_every_point_is_numbered_off_the_cables(n: int) -> None:
    plan, figure, axes = drawn(n)
    figure.draw_without_rendering()
    labels = [t for t in axes.texts if isinstance(t, Annotation) and t.get_text().startswith("p")]
    assert [label.get_text() for label in labels] == ["p₀", "p₁", "p₂", "p₃", "p₄"][: n + 1]
    p = plan.at(0.5).vertices[:, :2]
    screen = axes.transData.transform(p)
    for k, label in enumerate(labels):
        box = label.get_window_extent()
        middle = np.array([0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1)])
        assert 5.0 < math.dist(middle, screen[k]) < 90.0
        for a, b in pairwise(screen):
            along = (b - a) / math.dist(a, b)
            foot = float(np.clip(np.dot(middle - a, along), 0.0, math.dist(a, b)))
            assert math.dist(middle, a + foot * along) > 5.0


def test_the_picture_of_the_smallest_chain_is_written(tmp_path: Path) -> None:
    plan, _, _ = drawn(2)
    plan.save(tmp_path / "pair", rate=5.0)
    assert (tmp_path / "pair" / "summary.png").stat().st_size > 10_000
