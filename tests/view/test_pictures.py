"""Pictures say what a plan is: looked for among what is drawn, and in pixels."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

import hitchopt as ho
from hitchopt.checks import Certificate, Check
from hitchopt.checks.separation import closeness
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Phase
from hitchopt.motion.retiming import resting
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.view.painter import MAX_PANELS, MIN_TRAVEL, choose_shots, shots_in_motion
from hitchopt.view.pictures import (
    Page,
    draw_closeness,
    draw_phases,
    draw_plan_view,
    draw_summary,
    panels,
    sample_states,
)
from hitchopt.view.report import save_view
from hitchopt.view.style import new_figure, save_figure
from tests.helpers.pictured import made_certificate, make_motion
from tests.helpers.plans import planned

PRISM = ho.Prism([[4.0, 1.0], [4.0, 2.0], [5.0, 1.5]], 0.0, 1.0)


def swarm(n: int) -> ho.Motion:
    """Drones side by side, off the origin, that all go by one offset."""
    start = np.column_stack([2.0 + 0.5 * np.arange(n), np.full(n, -1.0), np.full(n, 1.0)])
    share = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    c = start[:, :, None] + np.array([0.3, 1.2, 0.2])[:, None] * share
    curves = PiecewisePolynomial(np.array([0.0, 3.0]), c[None])
    requirements = Requirements(
        ho.Limits(), ho.Separation(), ho.Arena([1, -2, 0], [25, 3, 2]), keep_out=(PRISM,)
    )
    return ho.Motion.single(ho.Swarm(n), requirements, curves, (Phase("fly", 0, 0.0, 3.0),))


def chain(n: int) -> ho.Motion:
    """An open chain at rest, off the origin."""
    headings = np.radians(np.linspace(60.0, -60.0, n))
    steps = 1.4 * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.array([2.0, -1.0]) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    team = ho.Team(n, 2.1 + 0.05 * np.arange(n), topology="open")
    return ho.solve(ho.Hitch.balanced(team, points), ho.Hold(1.0)).motion


def words(figure: Figure) -> list[str]:
    return [text for text, _ in visible_texts(figure)]


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


@pytest.mark.parametrize(
    ("made", "n"), [*((make_motion, n) for n in (3, 12, 60)), (chain, 2), (chain, 4)]
)
def test_both_ends_are_drawn_from_above_and_vertices_named(
    made: Callable[[int], ho.Motion], n: int
) -> None:
    motion = made(n)
    figure = new_figure((5.0, 5.0))
    axes = figure.add_subplot()
    draw_plan_view(axes, ho.Flight.of(motion))
    ends = motion.drones.at([0.0, motion.duration])
    dashed = [c for c in axes.collections if isinstance(c, LineCollection)][-1].get_segments()
    for k, line in enumerate(dashed):  # at the start, from q to r
        np.testing.assert_allclose(line[[0, -1]], ends[0, 2 * k : 2 * k + 2, :2], atol=1e-6)
    discs = [c for c in axes.collections if isinstance(c, EllipseCollection)]
    centres = np.array([np.asarray(disc.get_offsets()) for disc in discs])
    np.testing.assert_allclose(centres, ends[::-1, :, :2], atol=1e-9)
    names = motion.team.point_names
    assert [text.get_text() for text in axes.texts] == list(names if len(names) <= 30 else ())
    (painted,) = (c for c in axes.collections if isinstance(c, PolyCollection))
    corners = np.concatenate([path.vertices for path in painted.get_paths()])
    for end in ends[-1, :, :2]:  # a drone is drawn at its place
        distances = np.linalg.norm(corners - end, axis=1)
        assert np.min(distances) < 0.5 * motion.requirements.separation.radius
    figure.draw_without_rendering()
    places = axes.transData.transform(motion.vertices.at(motion.duration)[:, :2])
    boxes = [text.get_window_extent().get_points() for text in axes.texts]
    for box, place in zip(boxes, places, strict=False):
        assert 5.0 < np.linalg.norm(np.mean(box, axis=0) - place) < 90.0


@pytest.mark.parametrize("climb", [0.0, 0.8])
def test_climbing_plans_are_also_seen_from_the_side(climb: float) -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 0.8).translated([0.5, -2.0]))
    plan = ho.solve(start, ho.Transport([1.5, -1.0, 1.0 + climb]))
    figure = draw_summary(plan.flight, plan.certificate)
    sides = [axes for axes in figure.axes if axes.get_ylabel() == "z [m]"]
    assert len(sides) == (climb > 0.0)
    for axes in sides:
        end, begin = (each for each in axes.collections if isinstance(each, EllipseCollection))
        for drawn, t in ((begin, 0.0), (end, plan.duration)):
            centres = np.asarray(drawn.get_offsets())
            np.testing.assert_allclose(centres, plan.at(t).positions[:, [0, 2]], atol=1e-9)
            ratios = np.asarray(drawn.get_heights(), float) / np.asarray(drawn.get_widths(), float)
            np.testing.assert_allclose(ratios, 0.30 / 0.12)
        lower, upper = axes.get_ylim()
        assert lower < 0.0 < 1.0 + climb + 0.30 < upper + 1e-9
    figure.draw_without_rendering()
    page = figure.bbox
    for axes in figure.axes:
        tight = axes.get_tightbbox()
        assert tight is not None
        assert page.x0 <= tight.x0 < tight.x1 <= page.x1
    on_page = draw_summary(plan.flight, plan.certificate, page=Page(3.5))
    assert not any(axes.get_ylabel() == "z [m]" for axes in on_page.axes)


def test_single_drones_that_change_heights_are_also_seen_from_the_side() -> None:
    low, high = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], [[0.0, 0.0, 2.0], [1.0, 0.0, 1.0]]
    prism = ho.Prism([[0.3, 1.0], [0.5, 1.4], [0.7, 1.0]], 0.5, 1.5)
    for goal, is_seen in ((high, True), (low[::-1], False)):
        plan = ho.solve(low, ho.Fly(goal), team=ho.Swarm(2), keep_out=[prism])
        figure = draw_summary(plan.flight, plan.certificate)
        sides = [axes for axes in figure.axes if axes.get_ylabel() == "z [m]"]
        assert len(sides) == is_seen
        for axes in sides:
            (wall,) = (each for each in axes.patches if isinstance(each, Rectangle))
            assert wall.get_bbox().extents == pytest.approx([0.3, 0.5, 0.7, 1.5])
        (legend,) = (axes.get_legend() for axes in figure.axes if axes.get_ylabel() == "y [m]")
        assert legend is not None
        figure.draw_without_rendering()
        boxes = [axes.get_tightbbox() for axes in sides]
        assert not any(legend.get_window_extent().overlaps(box) for box in filter(None, boxes))


@pytest.mark.parametrize(
    ("made", "n"), [(partial(make_motion, thrusts=(2.6, 1.9)), 5), (make_motion, 3), (swarm, 4)]
)
def test_curves_are_the_plan_s_worst_values_at_the_joints_too(
    made: Callable[[int], ho.Motion], n: int
) -> None:
    motion = made(n)
    states = sample_states(ho.Flight.of(motion))
    assert (states.t[0], states.t[-1]) == (0.0, motion.duration)
    assert set(motion.drones.breaks) <= set(states.t)
    ratio, speed, thrust = panels(ho.Flight.of(motion), states)
    speeds = np.linalg.norm(motion.drones.at(states.t, 1), axis=-1)
    np.testing.assert_allclose(speed.values, np.max(speeds, axis=1), atol=1e-9)
    shares = np.linalg.norm(states.thrusts(motion.team), axis=-1) / motion.team.max_thrust
    np.testing.assert_allclose(thrust.values, thrust.limit * np.max(shares, axis=1), rtol=1e-8)
    offsets = states.positions[:, :, None] - states.positions[:, None]
    separation, same = motion.requirements.separation, np.eye(offsets.shape[1])
    size = 2.0 * np.array([separation.radius, separation.radius, separation.height])
    ratios = np.linalg.norm(offsets / size, axis=-1) + np.where(same, np.inf, 0)
    np.testing.assert_allclose(ratio.values, np.min(ratios, axis=(1, 2)), rtol=1e-9)


def test_small_worst_values_are_not_cut_off() -> None:
    small = Check("speed", True, 0.003751, 0.8, "max", "m/s", 1.1, ("q0",))
    certificate = Certificate(2.0, (small,))
    figure = draw_summary(ho.Flight.of(make_motion(4)), certificate)
    figure.canvas.draw()
    (label,) = [
        text for axes in figure.axes for text in axes.texts if "0.003751" in text.get_text()
    ]
    assert label.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize("share", [False, True])
def test_limits_and_the_certificate_s_worst_are_marked(share: bool) -> None:
    motion, certificate = make_motion(4, thrusts=(2.6, 2.0 if share else 2.6)), made_certificate()
    figure = draw_summary(ho.Flight.of(motion), certificate, "Four of them")
    limits = [(1.0, 2.345, 0.4), (0.8, 0.6789, 1.1), (2.6, 1.456, 1.7)]
    if share:  # of each drone's own limit
        limits[2] = (1.0, 0.56, 1.7)
    for axes, (limit, worst, time) in zip(figure.axes[-3:], limits, strict=True):
        texts = [text.get_text() for text in axes.texts]
        assert {f"limit {limit:.4g}", f"worst {worst:.4g}"} <= set(texts)
        (mark,) = [line for line in axes.lines if line.get_marker() == "D"]
        np.testing.assert_allclose(np.array(mark.get_xydata()), np.array([[time, worst]]))
        assert axes.get_ylim()[0] == 0.0
        assert axes.get_ylim()[1] > max(limit, worst)
        assert axes.get_xlim() == (0.0, motion.duration)
    head = "Four of them\n4 robots, 8 drones, 3.1 s; certified for all t: 3 of 3 limits hold"
    assert head in words(figure)
    assert {"morph", "hold"} <= {text.get_text() for text in figure.axes[-3].texts}
    low = ho.Check.of("legs", 0.1, 0.15, "min", "m", 0.0, ("q0",))
    figure = draw_summary(ho.Flight.of(motion), ho.Certificate(3.1, (*certificate.checks, low)))
    assert any("NOT CERTIFIED: legs" in text for text in words(figure))


@pytest.mark.parametrize("worst", [math.inf, sys.float_info.max, math.nan])
def test_a_worst_without_bound_is_not_drawn(worst: float) -> None:
    check = ho.Check("separation", True, worst, 1.0, "min", "ratio", 0.0, ())
    axes = draw_summary(ho.Flight.of(make_motion(3)), ho.Certificate(3.1, (check,))).axes[-3]
    assert not any("worst" in text.get_text() for text in axes.texts)
    assert axes.get_ylim()[1] < 100.0


@pytest.mark.parametrize(("n", "gap"), [(3, 0.0), (6, 0.3), (12, -0.01)])
def test_nothing_written_overlaps_or_is_clipped(n: int, gap: float) -> None:
    checks = (
        ho.Check.of("separation", 1.0 + gap, 1.0, "min", "ratio", 0.0, ()),
        ho.Check.of("speed", 0.8 - gap, 0.8, "max", "m/s", 1.1, ()),
        ho.Check.of("thrust", 2.6 - gap, 2.6, "max", "N", 3.1, ()),
    )
    phases = tuple(Phase("follow_vertex", i, 0.31 * i, 0.31 * (i + 1)) for i in range(10))
    motion = replace(make_motion(n), phases=(*phases[:2], Phase("m", 2, 0.62, 3.1)))
    figure = draw_summary(
        ho.Flight.of(motion), ho.Certificate(3.1, checks), "A title of some length " * 8
    )
    texts = visible_texts(figure)
    assert len(texts) > 30
    slanted = [text for text in figure.axes[-3].texts if text.get_rotation() > 0.0]
    assert [text.get_text() for text in slanted] == ["follow_vertex", "follow_vertex", "m"]
    starts = [text.get_window_extent().x0 for text in slanted[:2]]
    assert abs(starts[1] - starts[0]) > math.sqrt(2.0) * 8.0 * 120.0 / 72.0  # high letters' height
    for text, box in texts:
        assert min(box.min) >= 0.0, text
        assert np.all(box.max <= figure.bbox.max), text
    level = [each for each in texts if each[0] not in ("m", "follow_vertex")]
    for (a, first), (b, second) in combinations(level, 2):
        shared = Bbox.intersection(first, second)
        assert shared is None or min(shared.size) < 2.0, (a, b)


@pytest.mark.parametrize("width", [3.5, pytest.param(7.0, marks=pytest.mark.slow)])
def test_figures_for_papers_have_8_point_text_within_their_width(
    width: float, tmp_path: Path
) -> None:
    motion, others = make_motion(4), swarm(9)
    figures = [
        draw_summary(ho.Flight.of(motion), made_certificate(), "A title", Page(width)),
        draw_summary(ho.Flight.of(others), made_certificate(), page=Page(width)),
        draw_closeness(ho.Flight.of(others), closeness(ho.Flight.of(others), 6), width),
    ]
    for figure in figures:
        assert figure.get_size_inches()[0] == width
        for text, box in visible_texts(figure):
            assert -1.0 <= box.x0 < box.x1 <= figure.bbox.x1 + 1.0, text
        assert {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()} == {8.0}
    save_figure(figures[-1], tmp_path / "figure.pdf")
    content = (tmp_path / "figure.pdf").read_bytes()
    assert b"/CIDFontType2" in content  # TrueType, as publishers ask for
    assert b"/Type3" not in content
    save_figure(figures[-1], tmp_path / "figure.png")
    assert imread(tmp_path / "figure.png").shape[1] == round(300 * width)
    assert "A title" not in words(figures[0])
    save_view(tmp_path / "plan.svg", ho.Flight.of(motion), made_certificate(), page=Page(width))
    assert f'width="{72.0 * width:g}pt"' in (tmp_path / "plan.svg").read_text("utf-8")
    with pytest.raises(ho.InputError, match=r"width = .* must be of a picture; save \.png"):
        save_view(
            tmp_path / "plan.html", ho.Flight.of(motion), made_certificate(), page=Page(width)
        )
    for wrong in (0.5, float("nan"), 40.0):
        with pytest.raises(ho.InputError, match=r"width = .* from 2\.5 to 20 inches; .* 3\.5 wide"):
            draw_closeness(ho.Flight.of(others), closeness(ho.Flight.of(others), 6), wrong)


def test_a_page_has_the_height_and_parts_that_are_asked_for(tmp_path: Path) -> None:
    flight = ho.Flight.of(make_motion(4))
    figure = draw_summary(flight, made_certificate(), page=Page(3.5, 3.0, ("separation", "speed")))
    assert figure.get_size_inches().tolist() == [3.5, 3.0]
    labels = [axes.get_ylabel().replace("\n", " ") for axes in figure.axes]
    assert labels == ["minimum separation [–]", "largest speed [m/s]"]
    above = draw_summary(flight, made_certificate(), page=Page(3.5, panels=("plan",)))
    assert not [axes for axes in above.axes if axes.get_xlabel() == "t [s]"]
    assert above.get_size_inches()[1] < 5.0
    for wrong, words in (
        ({"height": 3.0}, "height = 3.0: must be omitted without a width"),
        ({"width": 3.5, "height": 0.1}, "height = 0.1: must be from 2.5 to 20 inches"),
        ({"width": 3.5, "panels": ["seperation"]}, "panels = 'seperation': must be plan"),
        ({"width": 3.5, "panels": []}, "must be some of plan, separation"),
    ):
        with pytest.raises(ho.InputError, match=words):
            planned("triangle").view(tmp_path / "a.png", **wrong)


def test_names_of_many_short_phases_are_all_written_apart() -> None:
    ends = np.concatenate([[0.0], np.linspace(1.0, 1.5, 9), [3.1]])
    names = ["rest", *"abcdefgh", "last"]
    phases = [
        Phase(name, i, *span)
        for i, (name, span) in enumerate(zip(names, pairwise(ends), strict=True))
    ]
    figure = new_figure((3.5, 2.0))
    axes = figure.add_subplot()
    draw_phases([axes], phases, 3.1)
    texts: dict[str, float] = {
        text.get_text(): text.xy[0] for text in axes.texts if isinstance(text, Annotation)
    }
    assert sorted(texts) == sorted(names)
    places = [texts[name] for name in names]
    per_point = 3.1 / (72.0 * 3.5 * axes.get_position().width)
    assert np.min(np.diff(places)) >= 12.0 * per_point
    assert 0.0 <= min(places) <= max(places) <= 3.1


def test_names_that_do_not_fit_are_steeper_before_any_is_omitted() -> None:
    phases = [Phase(f"phase {name}", i, float(i), i + 1.0) for i, name in enumerate("abcdefghijkl")]
    axes = new_figure((2.6, 2.0)).add_subplot()
    draw_phases([axes], phases, 12.0)
    texts = [text for text in axes.texts if isinstance(text, Annotation)]
    assert [text.get_text() for text in texts] == [phase.name for phase in phases]
    assert {text.get_rotation() for text in texts} == {60.0}


def test_phases_that_differ_by_a_number_are_named_together() -> None:
    names = ["approach", "turn", "turn", "turn", "swap 1", "swap 2", "land"]
    phases = [Phase(name, 0, float(i), i + 1.0) for i, name in enumerate(names)]
    for width, is_slanted in ((3.5, True), (30.0, False)):
        axes = new_figure((width, 2.0)).add_subplot()
        draw_phases([axes], phases, 7.0)
        texts = [text for text in axes.texts if isinstance(text, Annotation)]
        assert [text.get_text() for text in texts] == ["approach", "turn", "swap", "land"]
        assert all((text.get_rotation() > 0.0) is is_slanted for text in texts)


def test_the_png_is_written_whatever_the_title(tmp_path: Path) -> None:
    path = tmp_path / "summary.png"
    arguments = ho.Flight.of(make_motion(3)), made_certificate()
    title = "三角 $x_ \\frac{ %s \n second line"
    save_figure(draw_summary(*arguments, title), path)
    picture, first = imread(path), path.read_bytes()
    assert picture.shape[:2] == (864, 1560)
    assert 0.02 < np.mean(picture[..., :3] < 0.5) < 0.3  # ink, and not too much of it
    save_figure(draw_summary(*arguments, title), path)
    assert path.read_bytes() == first


def test_a_storyboard_has_the_moments_that_matter() -> None:
    assert [shot.words for shot in choose_shots(ho.Flight.of(make_motion(3)))] == ["start", "morph"]
    ends = np.linspace(0.0, 2.2, 16)
    phases = [Phase("morph", i, a, b) for i, (a, b) in enumerate(pairwise(ends.tolist()))]
    many = replace(make_motion(3), phases=(*phases, Phase("hold", 15, 2.2, 3.1)))
    times = [shot.time for shot in choose_shots(ho.Flight.of(many))]
    assert times == sorted(times)
    assert (len(times), times[0], times[-1] >= 2.2 - 1e-9) == (MAX_PANELS, 0.0, True)
    assert shots_in_motion(ho.Flight.of(many)) == choose_shots(ho.Flight.of(many))


def test_a_storyboard_of_few_moments_divides_the_paths_between_them() -> None:
    motion = make_motion(3)
    (start, end), shots = (
        choose_shots(ho.Flight.of(motion)),
        shots_in_motion(ho.Flight.of(motion), 5),
    )
    assert (shots[0], shots[-1]) == (start, end)
    assert {shot.words for shot in shots[1:-1]} == {"morph"}
    times = [shot.time for shot in shots]
    places = motion.drones.at(motion.drones.breaks[0] + np.linspace(0.0, times[-1], 2001))
    steps = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=-1)
    middles = np.linspace(0.0, times[-1], 4001)[1::2]
    paths = np.histogram(middles, times, weights=steps)[0]
    np.testing.assert_allclose(paths, np.sum(steps) / 4, rtol=0.03)
    assert paths[0] > MIN_TRAVEL
    still = resting(motion, 3.0)
    assert shots_in_motion(ho.Flight.of(still)) == choose_shots(ho.Flight.of(still)) == (start,)


@pytest.mark.parametrize("n", [1, 5, 40])
def test_single_drones_are_shown_with_paths_ends_prisms_and_arena(n: int) -> None:
    motion = swarm(n)
    figure = draw_summary(ho.Flight.of(motion), ho.certify(motion), "Side by side")
    above = figure.axes[0]
    (paths,) = (c.get_segments() for c in above.collections if isinstance(c, LineCollection))
    assert len(paths) == n
    np.testing.assert_allclose(paths[0][0], [2.0, -1.0])
    np.testing.assert_allclose(paths[-1][-1], [2.0 + 0.5 * (n - 1) + 0.3, 0.2])
    (prism,) = (p for p in above.patches if isinstance(p, Polygon))
    np.testing.assert_allclose(prism.get_xy()[:3], PRISM.polygon.vertices)
    (arena,) = (p for p in above.patches if isinstance(p, Rectangle))
    assert (arena.get_x(), arena.get_width()) == (1.0, 24.0)
    texts = words(figure)
    drones = "1 drone" if n == 1 else f"{n} drones"
    assert any(f"{drones}, 3 s; certified for all t" in text for text in texts)
    assert ("d0" in texts) is (n <= 30)
    assert len(figure.axes) == (3 if n == 1 else 4)  # a single drone has no separation


@pytest.mark.parametrize(("walls", "is_drawn"), [(1.9, True), (6.0, False)])
def test_near_walls_are_drawn_around_cables(walls: float, is_drawn: bool) -> None:
    arena = ho.Arena([2.0 - walls, -1.0 - walls, 0.0], [2.0 + walls, -1.0 + walls, 4.0])
    motion = make_motion(3)
    motion = replace(motion, requirements=replace(motion.requirements, arena=arena))
    axes = new_figure((5.0, 5.0)).add_subplot()
    draw_plan_view(axes, ho.Flight.of(motion))
    drawn = [patch.get_width() for patch in axes.patches if isinstance(patch, Rectangle)]
    assert drawn == pytest.approx([2.0 * walls] * is_drawn)


def test_names_of_a_chain_s_ends_are_on_no_drone() -> None:
    motion = chain(2)
    axes = new_figure((5.0, 5.0)).add_subplot()
    draw_plan_view(axes, ho.Flight.of(motion))
    axes.get_figure().draw_without_rendering()  # type: ignore[union-attr]
    drones = axes.transData.transform(motion.drones.at(motion.duration)[:, :2])
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(box.contains(*drone) for box in boxes for drone in drones)


def test_the_closest_pairs_are_drawn_above_their_bounds() -> None:
    motion = swarm(4)
    closest = closeness(ho.Flight.of(motion), 6)
    (axes,) = draw_closeness(ho.Flight.of(motion), closest).axes
    pair = closest.pairs[0]
    label = f"{pair.pair[0]}, {pair.pair[1]} (≥ {pair.bound:.3f})"
    (curve,) = (line for line in axes.get_lines() if line.get_label() == label)
    assert pair.bound - 1e-9 <= np.min(np.asarray(curve.get_ydata())) <= 1.01 * pair.bound
    assert np.asarray(curve.get_xdata())[-1] == 3.0


@pytest.mark.parametrize("share", [0.15, 0.6])
def test_phases_after_the_end_of_what_was_flown_are_not_drawn(share: float) -> None:
    flight = planned("tie_carry_untie").flight
    figure = new_figure((6.0, 3.0))
    axes, end = figure.add_subplot(), share * flight.duration
    axes.set_xlim(0.0, end)
    draw_phases([axes], flight.phases, end)
    figure.canvas.draw()
    names = [text for text in axes.texts if text.get_text()]
    assert names
    assert all(0.0 <= float(text.xy[0]) <= end for text in names)  # type: ignore[attr-defined]
    assert axes.get_position().width > 0.7


def test_pictures_name_the_worst_of_custom_rules() -> None:
    flight = planned("triangle").flight
    rule = ho.Rule("leg", "m", "min", 0.2, ho.ClaspSpans, lambda clasp: clasp.q_leg.norm)
    certificate = ho.certify(flight, rules=[rule])
    words = f"leg ({certificate['leg'].worst:.4g} m, limit ≥ 0.2 m)"
    figure = draw_summary(flight, certificate, "A rule")
    written = " ".join(text.get_text() for text in figure.findobj(Text))
    assert words in " ".join(written.split())
    plain = draw_summary(flight, ho.certify(flight), "None")
    assert "≥ 0.2" not in " ".join(text.get_text() for text in plain.findobj(Text))
