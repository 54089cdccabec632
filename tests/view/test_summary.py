"""The picture says what the plan is: looked for among what is drawn, and in its pixels."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from pictured import made_certificate, make_motion

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.motion.motion import Phase
from hitchopt.view.curves import sampled_curves
from hitchopt.view.house_colours import COLOURS, cable_colours
from hitchopt.view.plan_view import draw_plan_view
from hitchopt.view.style import new_figure
from hitchopt.view.summary import draw_summary, save_summary


@pytest.fixture
def certificate() -> Certificate:
    return made_certificate()


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text) if text.get_visible())


def visible_texts(figure: Figure) -> list[tuple[str, Bbox]]:
    """Return what is written, with the box of pixels that it takes."""
    figure.draw_without_rendering()
    beyond = set()  # ticks that lie outside of the axes exist and are not drawn
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            lower, upper = sorted(axis.get_view_interval())
            ticks = [t for t in axis.get_major_ticks() if not lower <= t.get_loc() <= upper]
            beyond |= {label for tick in ticks for label in (tick.label1, tick.label2)}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text not in beyond]
    return [(t.get_text(), t.get_window_extent()) for t in texts if t.get_text().strip()]


def cables(axes: Axes) -> list[LineCollection]:
    found = [c for c in axes.collections if isinstance(c, LineCollection)]
    return [c for c in found if len(c.get_segments()[0]) == 4]


def limits(figure: Figure) -> list[Axes]:
    """Return the axes over time, from top to bottom."""
    return figure.axes[-3:]


@pytest.mark.parametrize("n", [3, 4, 12, 60])
def test_both_hitches_are_drawn_cable_by_cable(n: int) -> None:
    motion = make_motion(n)
    axes = new_figure((5.0, 5.0)).add_subplot()
    draw_plan_view(axes, motion, sampled_curves(motion))
    start, end = cables(axes)
    for lines, t in ((start, 0.0), (end, motion.duration)):
        drones, vertices = motion.drones.at(t), motion.vertices.at(t)
        for k, line in enumerate(lines.get_segments()):
            path = [drones[2 * k], vertices[k], vertices[(k + 1) % n], drones[2 * k + 1]]
            np.testing.assert_allclose(line, np.array(path)[:, :2], atol=1e-9)
    assert axes.get_aspect() == 1.0
    circles, squares = ([x for x in axes.lines if x.get_marker() == m] for m in "os")
    for markers, first in ((circles, 0), (squares, 1)):
        shown = np.array([line.get_xydata() for line in markers])
        expected = motion.drones.at([0.0, motion.duration])[:, first::2, :2]
        np.testing.assert_allclose(shown, expected, atol=1e-9)


def test_a_hitch_that_rests_is_drawn_once(certificate: Certificate) -> None:
    figure = draw_summary(make_motion(5, shift=0.0), certificate)
    assert len(cables(figure.axes[0])) == 1
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "start" not in [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("n", range(3, 14))
def test_neighbouring_cables_differ_in_grey(n: int) -> None:
    def grey(colour: str) -> float:
        red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
        return 0.299 * red + 0.587 * green + 0.114 * blue

    shades = [grey(colour) for colour in cable_colours(n)]
    assert set(cable_colours(n)) <= set(COLOURS)
    assert min(abs(a - b) for a, b in zip(shades, shades[1:] + shades[:1], strict=True)) > 0.15


@pytest.mark.parametrize(("n", "labelled"), [(3, True), (12, True), (13, False)])
def test_vertices_are_numbered_while_there_is_room(
    certificate: Certificate, n: int, labelled: bool
) -> None:
    text = words(draw_summary(make_motion(n), certificate))
    assert ("p₀" in text, {3: "p₂", 12: "p₁₁", 13: "p₁₂"}[n] in text) == (labelled, labelled)


def test_limits_and_the_certificate_s_worst_are_marked(certificate: Certificate) -> None:
    motion = make_motion(4)
    figure = draw_summary(motion, certificate, "Four of them")
    for axes, limit, worst, time in zip(
        limits(figure), (1.0, 0.8, 2.6), (2.345, 0.6789, 1.456), (0.4, 1.1, 1.7), strict=True
    ):
        texts = [text.get_text() for text in axes.texts]
        assert f"limit {limit:.4g}" in texts
        assert f"worst {worst:.4g}" in texts
        (mark,) = [line for line in axes.lines if line.get_marker() == "D"]
        np.testing.assert_allclose(np.array(mark.get_xydata()), np.array([[time, worst]]))
        assert axes.get_ylim()[0] == 0.0
        assert axes.get_ylim()[1] > max(limit, worst)
        assert axes.get_xlim() == (0.0, motion.duration)
    assert "Four of them\n4 robots, 8 drones, 3.1 s; certified for all t: 3 of 3" in words(figure)
    assert {"morph", "hold"} <= {text.get_text() for text in limits(figure)[0].texts}


def test_the_curves_are_the_plan_s(certificate: Certificate) -> None:
    motion = make_motion(4)
    axes = limits(draw_summary(motion, certificate))[1]
    t, speed = np.asarray(axes.lines[0].get_xydata()).T
    expected = np.max(np.linalg.norm(motion.drones.at(t, 1), axis=-1), axis=1)
    np.testing.assert_allclose(speed, expected, atol=1e-9)


def test_thrust_is_a_share_where_drones_differ() -> None:
    check = Check.of("thrust", 1.2, 2.0, "max", "N", 0.3, ("q0",))
    figure = draw_summary(make_motion(4, thrusts=(2.6, 2.0)), Certificate(3.1, (check,)))
    axes = limits(figure)[2]
    assert {"limit 1", "worst 0.6"} <= {text.get_text() for text in axes.texts}


@pytest.mark.parametrize("worst", [None, float("inf"), sys.float_info.max, float("nan")])
def test_a_worst_without_bound_is_not_drawn(worst: float | None) -> None:
    check = Check("separation", True, worst, 1.0, "min", "ratio", 0.0, ())
    axes = limits(draw_summary(make_motion(3), Certificate(3.1, (check,))))[0]
    assert not any("worst" in text.get_text() for text in axes.texts)
    assert axes.get_ylim()[1] < 100.0


def test_a_plan_that_is_not_certified_says_so(certificate: Certificate) -> None:
    low = Check.of("legs", 0.1, 0.15, "min", "m", 0.0, ("q0",))
    figure = draw_summary(make_motion(3), Certificate(3.1, (*certificate.checks, low)))
    assert "NOT CERTIFIED: legs" in words(figure)


@pytest.mark.parametrize("gap", [0.0, 0.01, -0.01, 0.3])
@pytest.mark.parametrize("n", [3, 6, 12])
def test_nothing_written_overlaps_or_is_clipped(n: int, gap: float) -> None:
    checks = (
        Check.of("separation", 1.0 + gap, 1.0, "min", "ratio", 0.0, ()),
        Check.of("speed", 0.8 - gap, 0.8, "max", "m/s", 1.1, ()),
        Check.of("thrust", 2.6 - gap, 2.6, "max", "N", 3.1, ()),
    )
    phases = tuple(Phase("follow_vertex", i, 0.31 * i, 0.31 * (i + 1)) for i in range(10))
    motion = dataclasses.replace(make_motion(n), phases=(*phases[:2], Phase("m", 2, 0.62, 3.1)))
    figure = draw_summary(motion, Certificate(3.1, checks), "A title of some length " * 8)
    texts = visible_texts(figure)
    assert len(texts) > 30
    named = {text.get_text() for text in limits(figure)[0].texts}
    assert "follow_vertex" not in named  # no room for it
    whole = figure.bbox
    for text, box in texts:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= whole.x1 and box.y1 <= whole.y1
        assert inside, text
    for i, (a, first) in enumerate(texts):
        for b, second in texts[i + 1 :]:
            width = min(first.x1, second.x1) - max(first.x0, second.x0)
            height = min(first.y1, second.y1) - max(first.y0, second.y0)
            assert width < 2.0 or height < 2.0, (a, b)


def test_the_png_is_written_whatever_the_title(certificate: Certificate, tmp_path: Path) -> None:
    path = tmp_path / "summary.png"
    save_summary(path, make_motion(3), certificate, "三角 $x_ \\frac{ %s \n second line")
    picture = imread(path)
    assert picture.shape[0] > 700
    assert picture.shape[1] > 1200
    assert picture.shape[2] == 3  # a channel of opacity takes time and says nothing
    assert 0.02 < np.mean(picture < 0.5) < 0.3  # ink, and not too much of it
    first = path.read_bytes()
    save_summary(path, make_motion(3), certificate, "三角 $x_ \\frac{ %s \n second line")
    assert path.read_bytes() == first


def test_a_large_team_takes_no_longer_than_a_small_one_by_much(certificate: Certificate) -> None:
    figure = draw_summary(make_motion(300), certificate)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["3 of the cables, 3.1 s", "start, 0.0 s", "morph, 2.2 s", "", "", ""]
    lower, upper = np.sort(figure.axes[0].get_xlim())
    assert upper - lower < 0.1 * np.ptp(figure.axes[1].get_xlim())


def test_pyplot_is_never_imported() -> None:
    code = "import sys, hitchopt.view.summary; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
