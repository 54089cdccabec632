"""Pictures of a plan: summary, view from above, and closest neighbours over time."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from io import BytesIO
from itertools import groupby
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec, SubplotSpec
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from scipy.optimize import isotonic_regression
from scipy.spatial import ConvexHull, cKDTree

from hitchopt.checks.certificate import Certificate, html_table
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.separation import Closeness
from hitchopt.errors import InputError
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.requirements import Arena
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Phase
from hitchopt.motion.states import States, flight_states_at
from hitchopt.values import Array, check_choice, sequence, text
from hitchopt.view import painter, style
from hitchopt.view.painter import PATH_OPACITY
from hitchopt.view.scene import Appearance, TeamLabel, scene_at
from hitchopt.view.style import COLOURS, DASHES, INK, LIMIT_COLOUR, draw_lines, write

SIZE = (13.0, 7.2)  # Width and height of the picture [inch]
HEIGHTS = (1.0, 1.7)  # Height ratios of a row of panels and the plan below it
# Edges of the plots, and of a plan or a storyboard on their left, as fractions of the figure
PLOT_EDGES = {"left": 0.585, "right": 0.915, "bottom": 0.15, "top": 0.85, "hspace": 0.1}
PLAN_EDGES = {"left": 0.055, "right": 0.505, "bottom": 0.15, "top": 0.85}
STORYBOARD_EDGES = {"left": 0.012, "right": 0.515, "bottom": 0.03, "top": 0.85}
LEGEND_GAP = 0.17  # Distance of the legend from a plan below panels, as a fraction of its height
PLAN_GAP = 0.1  # Distance of the legend from a plan elsewhere, likewise
GROUND = 0.1  # Depth below the ground that is drawn from the side [m]
VIEW_GAP = 0.22  # Distance of the views from above and from the side, over their mean width
NEAR_WALLS = 1.6  # Largest width of a drawn arena of cables, over that of what flies
ROUND_STEPS = (1, 2, 5, 10)  # Steps of ticks
LABEL_AT = -0.1  # Position of the plots' labels, as a fraction of their width
CARD_RESOLUTION = 65  # Resolution of a notebook's picture [dots per inch]: 850 pixels wide
POINTS = 150_000  # Number of sampled drone positions: more is finer than pixels
SAMPLES = (60, 600)  # Range of the number of sampled times
KEEP_OUT: Any = {"facecolor": "0.88", "edgecolor": "0.4", "hatch": "////"}
FORBIDDEN: Any = {"facecolor": "none", "edgecolor": "0.8", "hatch": "////", "linewidth": 0}

CURVE_WIDTH = 1.4  # Width of a curve [points]
LINE_HEIGHT = 11.0  # Height of a line of text [points]
# Maximum worst value that is drawn: larger ones mean that nothing was counted or bounded
MAX_DRAWN = 1e9
CHARACTER_WIDTH = 4.3  # Width of a character of a phase's name [points]
SLANTED_WIDTH = 13.5  # Width of a line of text at 30° or 45° [points]
STEEP_WIDTH = 11.0  # The same at 60°
DIGITS = " 0123456789"  # Characters of a number that ends a phase's name
MAX_CHARACTERS = 18  # Maximum number of characters of a slanted line
CLOSE_SIZE = (10.0, 4.8)  # Width and height of the figure of the closest neighbours [inch]
CLOSE_SAMPLES = 800  # Number of points of a curve in that figure
CLOSE_TOP = 4.0  # Maximum of the separation's axis in that figure
START_COLOUR = "0.62"

# Maximum height of the plan on a page of a paper [inch], where parts are one below the other
PAGE_PLAN = 4.5
PAGE_SHARE = 0.9  # Height of the plan on a page, as a fraction of its width
PAGE_PLOT = 1.0  # Height of a plot on a page [inch]
PAGE_LEGEND = 1.5  # Height of phases' names and legend together on a page [inch]

# Maximum number of vertices or single drones with names, since more would hide the drawing
MAX_NAMED = 30
NAME_DISTANCE = 18.0  # Distance of a vertex from its name [points]
END_NAME_DISTANCE = 1.9  # Distance of the names of a chain's ends, over that of others
PAGE_DISTANCE = 9.0  # Distance of a vertex from its name on a page [points]
PAGE_HEIGHT = 190.0  # Height of axes [points] below which names are close
LINE_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
# Colours and line styles of pairs, the closest first; they also differ in grey
STYLES = tuple(zip(COLOURS, LINE_STYLES, strict=False))


PLAN = "plan"  # Name of the view from above or storyboard among the parts of a page
PARTS = (PLAN, "separation", "speed", "thrust")  # Parts of a summary on a page, from top to bottom


@dataclass(frozen=True)
class Page:
    """A summary for a paper, whose parts are below each other.

    Attributes
    ----------
    width: [inch]
    height: [inch]; None for a height that follows from the parts.
    panels: names of PARTS.

    Raises InputError for a width or height out of range, or a part that is unknown or missing.
    """

    width: float
    height: float | None = None
    panels: tuple[str, ...] = PARTS

    def __post_init__(self) -> None:
        for name in self.panels:
            check_choice("panels", name, PARTS)
        if not self.panels:
            raise InputError("panels", self.panels, f"some of {', '.join(PARTS)}", "name one")
        if (
            self.height is not None
            and not style.PAGE_WIDTHS[0] <= self.height <= style.PAGE_WIDTHS[1]
        ):
            bound = "from {:g} to {:g} inches".format(*style.PAGE_WIDTHS)
            raise InputError("height", self.height, bound, "a column's figure is some 4 high")

    @classmethod
    def of(
        cls, width: float | None, height: float | None = None, panels: Sequence[str] | None = None
    ) -> Page | None:
        """Return the page of a width; None without one. Raises InputError for other values then."""
        if width is None:
            for name, value in (("height", height), ("panels", panels)):
                if value is not None:
                    raise InputError(
                        name, value, "omitted without a width", "set width, such as 3.5"
                    )
            return None
        names = PARTS if panels is None else sequence("panels", panels)
        return cls(width, height, tuple(text("panels", name) for name in names))


@dataclass(frozen=True, eq=False)
class Panel:
    """A limited quantity over time."""

    name: str  # name of its check
    label: str  # label with unit
    values: Array  # (samples,), in the label's unit
    limit: float  # in the same unit
    share: bool = False  # whether values are fractions of the limit

    def worst_of(self, certificate: Certificate) -> tuple[float, float] | None:
        """Return time and value of the certificate's worst, in the label's unit, if it has one."""
        for check in (check for check in certificate.checks if check.name == self.name):
            value = check.worst / (check.number if self.share else 1.0)
            return (check.time, value) if abs(value) < MAX_DRAWN else None
        return None


def sample_states(flight: Flight) -> States:
    """Return the states of a plan at times that include the joints of its pieces."""
    return flight_states_at(flight, _sample_times(flight))


def _sample_times(flight: Flight) -> Array:
    samples = int(np.clip(POINTS // len(flight.team.drone_names), *SAMPLES))
    even = np.linspace(0.0, flight.duration, samples)
    joints = flight.drones.breaks - flight.drones.breaks[0]
    joints = joints if len(joints) < samples else joints[:0]
    return np.unique(np.minimum(np.concatenate([even, joints]), even[-1]))


def panels(flight: Flight, states: States) -> tuple[Panel, ...]:
    """Return separation, speed and thrust; a single drone has no separation.

    Thrust is a fraction of its limit if limits differ.
    """
    times = states.t + flight.drones.breaks[0]
    requirements = flight.requirements
    team = flight.team
    kinds = np.unique(team.max_thrust)
    thrust = np.max(length(states.thrusts(team)) / team.max_thrust, axis=-1)
    forces = Panel("thrust", "largest thrust\n/ its limit", thrust, 1.0, share=True)
    if len(kinds) == 1:
        limit = float(kinds[0])
        forces = Panel("thrust", "largest\nthrust [N]", limit * thrust, limit)
    speed = np.max(length(states.velocities), axis=-1)
    rates = Panel("speed", "largest\nspeed [m/s]", speed, requirements.limits.speed)
    paths = [other.motion.drones for other in flight.others]
    others = [path.at(np.clip(times, *path.breaks[[0, -1]])) for path in paths]
    scaled = np.concatenate([states.positions, *others], axis=1) * requirements.separation.scale
    if scaled.shape[1] < 2:
        return (rates, forces)
    ratios = np.array([np.min(cKDTree(points).query(points, k=[2])[0]) for points in scaled])
    return (Panel("separation", "minimum\nseparation [–]", ratios, 1.0), rates, forces)


@style.own_style()
def draw_summary(
    flight: Flight, certificate: Certificate, title: str = "", page: Page | None = None
) -> Figure:
    """Return the summary: a storyboard or a view from above, and limited quantities over time.

    The certificate's worst values are marked. On a page it has no headline.
    """
    states = sample_states(flight)
    quantities = panels(flight, states)
    if page is not None:
        return _summary_on_page(flight, certificate, states, quantities, page)
    figure = style.new_figure(SIZE, None)  # automatic layout takes as long as drawing
    grid = figure.add_gridspec(len(quantities), 1, **PLOT_EDGES)
    _draw_plan(figure, flight)
    axes = [figure.add_subplot(grid[row]) for row in range(len(quantities))]
    _draw_panels(axes, flight, certificate, states, quantities)
    for each in axes:
        each.yaxis.set_label_coords(LABEL_AT, 0.5)
    style.legend_below(axes[-1], _panel_handles(), 0.32, 2)
    width = style.NARROW_HEADLINE if len(flight.teams) > 1 else style.HEADLINE_LENGTH
    style.headline(figure, title, f"{style.facts(flight)}; {style.verdict(certificate)}", width)
    return figure


@style.own_style()
def _summary_on_page(
    flight: Flight,
    certificate: Certificate,
    states: States,
    quantities: Sequence[Panel],
    page: Page,
) -> Figure:
    """Return the parts of a summary that a page has, below each other, with a legend below."""
    shown = [panel for panel in quantities if panel.name in page.panels]
    plan_height = min(PAGE_SHARE * page.width, PAGE_PLAN) if PLAN in page.panels else 0.0
    heights = [size for size in (plan_height, PAGE_PLOT * len(shown)) if size]
    figure = style.page_figure(page.width, page.height or sum(heights) + PAGE_LEGEND)
    parts = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    if plan_height:
        _draw_plan(figure, flight, parts[0])
    handles = list[Artist]()
    if shown:
        grid = parts[-1].subgridspec(len(shown), 1)
        axes = [figure.add_subplot(grid[row]) for row in range(len(shown))]
        _draw_panels(axes, flight, certificate, states, shown)
        figure.align_ylabels(axes)
        handles = _panel_handles()
    for legend in filter(None, [each.get_legend() for each in figure.axes]):
        handles = [*filter(None, legend.legend_handles), *handles]
        legend.remove()
    style.legend_on_page(figure, handles)
    return figure


def _draw_panels(
    axes: Sequence[Axes],
    flight: Flight,
    certificate: Certificate,
    states: States,
    quantities: Sequence[Panel],
) -> None:
    """Draw quantities over time, below each other, with the names of phases above."""
    for each, panel in zip(axes, quantities, strict=True):
        _draw_panel(each, states.t, panel, certificate)
        each.tick_params(labelbottom=each is axes[-1])
    draw_phases(axes, flight.phases, flight.duration)
    axes[-1].set_xlabel("t [s]")


def _panel_handles() -> list[Artist]:
    """Return the entries of the panels' legend."""
    return [
        Line2D([], [], color=INK, linewidth=CURVE_WIDTH, label="worst drone or pair"),
        Line2D([], [], color=LIMIT_COLOUR, linestyle=DASHES, label="limit"),
        _worst_marker(),
        Patch(label="forbidden", **FORBIDDEN),
    ]


def plan_card(
    flight: Flight, certificate: Certificate, title: str, notes: Sequence[str] = ()
) -> str:
    """Return the HTML of a plan for notebooks: picture, phases, checks, notes, without links."""
    picture = BytesIO()
    style.save_figure(draw_summary(flight, certificate, title), picture, CARD_RESOLUTION)
    image = b64encode(picture.getvalue()).decode()
    heads = ("phase", "step", "start", "end", "remark")
    phases = [
        (p.name, str(p.step), f"{p.start:.3f} s", f"{p.end:.3f} s", p.remark) for p in flight.phases
    ]
    return (
        f"<p><b>{escape(title or 'Plan')}</b>: {style.facts(flight)}</p>"
        f'<img alt="the plan at a glance" src="data:image/png;base64,{image}"/>'
        f"{html_table(heads, phases)}{certificate._repr_html_()}"
        + "".join(f"<p>{escape(note)}</p>" for note in notes)
    )


def plot_from_above(flight: Flight, axes: Axes | None) -> Axes:
    """Draw the plan from above on axes, by default of a new pyplot figure."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(6.5, 7.0), layout="constrained")[1]
    draw_plan_view(axes, flight)
    return axes


def draw_phases(
    axes: Sequence[Axes], phases: Sequence[Phase], end: float, start: float = 0.0
) -> None:
    """Shade every other phase on all axes, and write their names above the first.

    Phases of a step such as ``swap 1`` and ``swap 2`` are named together. Names of short phases are
    slanted, and moved apart where they would overlap; if they do not fit, those of the longest
    phases are written. Long names of teams are cut. Nothing is drawn before ``start`` and after
    ``end`` [s], between which the axes are.
    """
    figure: Any = axes[0].figure
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)  # sets the width of the axes, which places of names depend on
    flown = [phase for phase in phases if phase.start < end and phase.end > start]
    phases = [phase.retimed(max(phase.start, start), min(phase.end, end)) for phase in flown]
    per_point = (end - start) / (72.0 * figure.get_size_inches()[0] * axes[0].get_position().width)
    character = CHARACTER_WIDTH * per_point
    named = _named_together(phases)
    level = all(p.end - p.start > character * (len(p.name) + 1) for p in named)
    for i, phase in enumerate(phases):
        for each in axes if i else ():
            each.axvline(phase.start, color="0.6", linewidth=0.7, linestyle=":", zorder=1)
            if i % 2:
                each.axvspan(phase.start, phase.end, color="0.93", linewidth=0, zorder=-1)
    look: Any = {"xycoords": axes[0].get_xaxis_transform(), "parse_math": False}
    if level:
        for phase in named:
            middle = 0.5 * (phase.start + phase.end)
            write(axes[0], phase.name, (middle, 1.0), (0, 4), **look)
        return
    angle = 30 if any(", " in phase.name for phase in named) else 45
    placed = _placed_names(named, start, end, SLANTED_WIDTH * per_point)
    if len(placed) < len(named) and angle == 45:
        angle, placed = 60, _placed_names(named, start, end, STEEP_WIDTH * per_point)
    look |= {"rotation": angle, "ha": "left", "rotation_mode": "anchor"}
    for phase, place, lines in placed:
        middle = 0.5 * (phase.start + phase.end)
        stem = axes[0].get_xaxis_transform()
        axes[0].plot(
            [middle, place], [1.0, 1.05], color="0.6", linewidth=0.7, transform=stem, clip_on=False
        )
        write(axes[0], "\n".join(lines), (place, 1.05), (0, 2), **look)


def _named_together(phases: Sequence[Phase]) -> list[Phase]:
    """Return phases of which those of a step in sequence that differ by a number are one."""
    named = list[Phase]()
    for (_, kind), group in groupby(phases, lambda each: (each.step, each.name.rstrip(DIGITS))):
        first, *others = group
        named.append(replace(first, name=kind, end=others[-1].end) if others else first)
    return named


def _placed_names(
    phases: Sequence[Phase], start: float, end: float, line_width: float
) -> list[tuple[Phase, float, list[str]]]:
    """Return phases with the places of their names on the axis [s], and the names' lines.

    Lines are ``line_width`` [s] wide. Places are those next to the middles of the phases that are
    far enough apart: isotonic regression of the middles less the widths before them.
    """
    chosen = sorted(phases, key=lambda phase: phase.start - phase.end)
    while True:
        ordered = sorted(chosen, key=lambda phase: phase.start)
        lines = [_lines(phase.name) for phase in ordered]
        widths = line_width * np.array([len(each) for each in lines])
        if len(chosen) == 1 or np.sum(widths[:-1]) <= end - start:
            break
        chosen.pop()
    before = np.cumsum([0.0, *widths[:-1]])
    middles = np.array([0.5 * (phase.start + phase.end) for phase in ordered])
    apart = isotonic_regression(middles - before).x
    places = np.clip(apart, start, end - before[-1]) + before
    return [*zip(ordered, places.tolist(), lines, strict=True)]


def _lines(name: str) -> list[str]:
    """Return the lines of a phase's name; long names of teams are cut before the last word."""
    lines = []
    for line in name.split(", "):
        team, _, word = line.rpartition(" ")
        room = max(0, MAX_CHARACTERS - len(word) - len("… "))
        lines.append(line if len(line) <= MAX_CHARACTERS else f"{team[:room]}… {word}")
    return lines


@style.own_style()
def draw_closeness(flight: Flight, closest: Closeness, width: float | None = None) -> Figure:
    """Return the picture of the spans' bounds as steps and the closest pairs as curves.

    With a ``width`` [inch] it is a figure for a paper.
    """
    figure = style.new_figure(CLOSE_SIZE)
    if width is not None:
        figure = style.page_figure(width, style.PAGE_SHARE * width)
    axes = figure.add_subplot()
    edges = [span.start for span in closest.spans] + [closest.spans[-1].end]
    bounds = np.array([span.bound for span in closest.spans])
    t = np.linspace(edges[0], edges[-1], CLOSE_SAMPLES)
    positions = flight.drones.at(t) * flight.requirements.separation.scale
    index = {name: i for i, name in enumerate(flight.team.drone_names)}
    for pair, (colour, dashes) in zip(closest.pairs, STYLES, strict=False):
        i, j = (index[name] for name in pair.pair)
        ratio = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
        label = f"{pair.pair[0]}, {pair.pair[1]} (≥ {pair.bound:.3f})"
        axes.plot(t, ratio, color=colour, linestyle=dashes, linewidth=1.2, zorder=3, label=label)
    label = "no pair is closer, for all t"
    axes.stairs(bounds, edges, baseline=0.0, fill=True, color="0.87", zorder=1, label=label)
    axes.stairs(bounds, edges, baseline=None, color=INK, linewidth=1.4, zorder=2)
    axes.axhline(1.0, color=LIMIT_COLOUR, linestyle=DASHES, linewidth=1.2, label="limit", zorder=2)
    top = float(min(CLOSE_TOP, 1.35 * max(1.0, float(np.max(bounds)))))
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0.0, top))
    axes.set(xlabel="t [s]", ylabel="separation [–]")
    if width is None:
        axes.set_title("The closest neighbours over time", fontsize="medium")
        figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    else:
        style.legend_on_page(figure, axes.get_legend_handles_labels()[0])
    return figure


def _draw_plan(figure: Figure, flight: Flight, place: SubplotSpec | None = None) -> None:
    """Draw the storyboard; with few moments also, and without cables only, the views of the plan.

    The position is on the left by default; elsewhere it is a page.
    """
    shots = painter.choose_shots(flight) if _has_cables(flight) else ()
    on_page = place is not None
    if place is None:
        margins = STORYBOARD_EDGES if len(shots) > painter.FEW_PANELS else PLAN_EDGES
        place = figure.add_gridspec(1, 1, **margins)[0]
    with_side = not on_page and _changes_heights(flight)
    if not shots:
        extents = np.ptp(_flown(flight), axis=(0, 1)) + 2.0 * flight.requirements.separation.height
        rows = place.subgridspec(2, 1, height_ratios=extents[1:]) if with_side else None
        _draw_views(figure, place, flight, rows)
    elif len(shots) > painter.FEW_PANELS:
        painter.draw_plan_storyboard(place, flight, shots)
    else:
        parts = place.subgridspec(2, 1, height_ratios=HEIGHTS, hspace=0.04)
        painter.draw_plan_storyboard(parts[0], flight, shots)
        columns = parts[1].subgridspec(1, 2, wspace=VIEW_GAP) if with_side else None
        _draw_views(figure, parts[1], flight, columns, LEGEND_GAP)


def _draw_views(
    figure: Figure,
    place: SubplotSpec,
    flight: Flight,
    both: GridSpecFromSubplotSpec | None,
    gap: float = PLAN_GAP,
) -> None:
    """Draw the plan from above, in a place, or from above and from the side in ``both``.

    The legend is below the place, at ``gap`` times its height.
    """
    above = figure.add_subplot(place if both is None else both[0])
    draw_plan_view(above, flight, gap)
    if both is not None:
        draw_side_view(figure.add_subplot(both[1]), flight)
        if both.nrows > 1:
            above.set_aspect("equal", adjustable="box")  # above each other on one scale
            above.set(xlim=above.dataLim.intervalx, ylim=above.dataLim.intervaly)
        box = place.get_position(figure)
        anchor = 0.5 * (box.x0 + box.x1), box.y0 - gap * box.height
        cast("Legend", above.get_legend()).set_bbox_to_anchor(anchor, figure.transFigure)


def _changes_heights(flight: Flight) -> bool:
    """Return whether drones fly above each other, or climb, by half a drone's height or more."""
    heights = _flown(flight)[..., 2]
    return bool(np.ptp(heights) > flight.requirements.separation.height)


def _has_cables(flight: Flight) -> bool:
    """Return whether any team has cables, also one of an external plan."""
    return any(each.motion.team.has_cables for each in flight.all_teams)


def _draw_panel(axes: Axes, t: Array, panel: Panel, certificate: Certificate) -> None:
    """Draw a quantity at times [s], its limit, the forbidden range and the certificate's worst."""
    axes.plot(t, panel.values, color=INK, linewidth=CURVE_WIDTH, zorder=3)
    worst = panel.worst_of(certificate)
    is_minimum = RULE_OF[panel.name].sense == "min"
    top = 1.22 * max(panel.limit, float(np.max(panel.values)), worst[1] if worst else 0.0)
    axes.axhline(panel.limit, color=LIMIT_COLOUR, linewidth=1.2, linestyle=DASHES, zorder=2)
    forbidden = (0.0, panel.limit) if is_minimum else (panel.limit, top)
    axes.axhspan(*forbidden, zorder=0, **FORBIDDEN)
    _label(axes, f"limit {panel.limit:.4g}", panel.limit, LIMIT_COLOUR)
    if worst is not None:
        time, value = worst
        axes.plot([time, t[-1]], [value, value], color=INK, linewidth=0.6, linestyle=":", zorder=2)
        mark = _worst_marker()
        mark.set(data=([time], [value]), clip_on=False, zorder=5)
        axes.add_line(mark)
        # A shift keeps the worst value's label off the limit's.
        gap = (value - panel.limit) / top * _height(axes)
        direction = gap or (1.0 if is_minimum else -1.0)
        shift = math.copysign(max(LINE_HEIGHT - abs(gap), 0.0), direction)
        _label(axes, f"worst {value:.4g}", value, INK, shift)
    axes.set(ylabel=panel.label, xlim=(t[0], t[-1]), ylim=(0.0, top))
    axes.locator_params(steps=ROUND_STEPS)
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _height(axes: Axes) -> float:
    """Return the height of axes [points]."""
    figure: Any = axes.figure
    return float(72.0 * figure.get_size_inches()[1] * axes.get_position().height)


def _worst_marker() -> Line2D:
    line = style.marker("D", "white", INK, "certified worst for all t")
    line.set_markeredgewidth(CURVE_WIDTH)
    return line


def _label(axes: Axes, text: str, value: float, colour: str, shift: float = 0.0) -> None:
    """Write a text to the right of the axes."""
    look: Any = {"ha": "left", "va": "center", "color": colour, "annotation_clip": False}
    write(axes, text, (1.0, value), (5.0, shift), xycoords=axes.get_yaxis_transform(), **look)


class View(NamedTuple):
    """A direction from which a whole plan is seen, along one of the world's axes."""

    plane: tuple[int, int]  # axes of the world to the right and up
    camera: painter.Camera
    labels: tuple[str, str]  # of both axes


FROM_ABOVE = View((0, 1), painter.Camera.at_angles(-90.0, 90.0), ("x [m]", "y [m]"))
FROM_THE_SIDE = View((0, 2), painter.Camera.at_angles(-90.0, 0.0), ("x [m]", "z [m]"))


def draw_plan_view(axes: Axes, flight: Flight, gap: float = PLAN_GAP) -> None:
    """Draw a plan from above: start, paths, end and surroundings.

    ``gap`` is the distance of the legend below, as a fraction of the axes' height.
    """
    requirements = flight.requirements
    cables = _has_cables(flight)
    look = Appearance.of(flight)
    ends = scene_at(flight, np.array([0.0, flight.duration]))
    flown = _flown(flight)[..., :2]
    _draw_flight(axes, flight, FROM_ABOVE)
    handles: list[Artist] = [
        Line2D([], [], color=COLOURS[0], alpha=PATH_OPACITY if cables else 1.0, label="paths"),
        style.marker("o", "white", START_COLOUR, "start", 9.0 if cables else 4.5),
    ]
    fill = "white" if cables else INK
    handles.append(style.marker("o", fill, INK, "end, with its ellipsoid", 9.0))
    if cables:
        kinds = (INK, "drones q"), ("white", "drones r")
        handles += [style.marker("o", colour, INK, name) for colour, name in kinds]
    extent = flown.reshape(-1, 2)
    for prism in requirements.keep_out:
        handles.append(
            axes.add_artist(Polygon(prism.polygon.vertices, label="keep out", **KEEP_OUT))
        )
    for solid, (x, y, *_) in zip(look.objects, ends.objects[-1], strict=True):
        corners = solid.faces.reshape(-1, 3)[:, :2] + [x, y]
        outline = corners[ConvexHull(corners).vertices]
        extent = np.vstack([extent, outline])
        if not cables:  # else the painting shows it
            axes.add_artist(Polygon(outline, fc=solid.colours[0], ec="0.4", zorder=0))
            handles.append(Patch(fc=solid.colours[0], ec="0.4", label=solid.name))
    if (arena := requirements.arena) is not None and (not cables or _is_near(arena, extent)):
        extent = np.vstack([extent, arena.lower[:2], arena.upper[:2]])
        x, y = arena.lower[:2]
        width, depth = arena.upper[:2] - arena.lower[:2]
        box = Rectangle((x, y), width, depth, fill=False, ec="0.4", label="arena")
        handles.append(axes.add_artist(box))
    _show_extent(axes, extent, requirements.separation.radius)
    _write_names(axes, flight, flown[-1])
    style.legend_below(axes, handles, gap, 3)


def _is_near(arena: Arena, points: Array) -> bool:
    """Return whether walls are near points (m, 2) [m]."""
    size = arena.upper[:2] - arena.lower[:2]
    return bool(np.all(size < NEAR_WALLS * np.ptp(points, axis=0)))


def draw_side_view(axes: Axes, flight: Flight) -> None:
    """Draw a plan from the side, along y: start, paths, end and the ground."""
    separation = flight.requirements.separation
    _draw_flight(axes, flight, FROM_THE_SIDE)
    for prism in flight.requirements.keep_out:
        x = prism.polygon.vertices[:, 0]
        corner = (np.min(x), prism.lower)
        size = (np.ptp(x), prism.upper - prism.lower)
        axes.add_artist(Rectangle(corner, *size, **KEEP_OUT))
    flown = _flown(flight)[..., [0, 2]].reshape(-1, 2)
    floor = flight.requirements.ground_or(float(np.min(flown[:, 1])))
    axes.axhline(floor, color="0.4", linewidth=0.8)
    _show_extent(axes, flown, separation.radius)
    axes.set_ylim(floor - GROUND, axes.dataLim.y1 + separation.height)
    axes.set_aspect("equal", adjustable="box", anchor="S")


def _flown(flight: Flight) -> Array:
    """Return the positions (samples, drones, 3) [m] of all drones, also of external plans."""
    times = flight.drones.breaks[0] + _sample_times(flight)
    curves = [flight.drones, *(other.motion.drones for other in flight.others)]
    paths = [curve.at(np.clip(times, *curve.breaks[[0, -1]])) for curve in curves]
    return np.concatenate(paths, axis=1)


def _draw_flight(axes: Axes, flight: Flight, view: View) -> None:
    """Draw paths, and cables and ellipsoids at the start and at the end."""
    plane = [*view.plane]
    cables = _has_cables(flight)
    colours = Appearance.of(flight).drone_colours
    ends = scene_at(flight, np.array([0.0, flight.duration]))
    flown = _flown(flight)[..., plane]
    opacity = PATH_OPACITY if cables else 1.0
    draw_lines(axes, np.moveaxis(flown, 1, 0), colours, 0.8, 1, alpha=opacity)
    if cables:
        draw_lines(axes, ends.cables[0][..., plane], START_COLOUR, 1.0, 2, linestyles="--")
        step = painter.corner_step(ends.cables.shape[1])
        at_end = painter.Painter(ends, view.camera, step=step).paint(ends.at(flight.duration))
        painter.draw_painting(axes, at_end)
    separation = flight.requirements.separation
    sizes = np.array([separation.radius, separation.radius, separation.height])[plane]
    end = ("none", START_COLOUR) if cables else (colours, colours)
    _draw_ellipsoids(axes, sizes, flown[-1], *end)
    # Single drones may end where others start: starts are smaller discs on top.
    start = (sizes, "none") if cables else (0.5 * sizes, "white")
    _draw_ellipsoids(axes, start[0], flown[0], start[1], START_COLOUR)
    axes.set(xlabel=view.labels[0], ylabel=view.labels[1])


def _show_extent(axes: Axes, points: Array, radius: float) -> None:
    """Set the axes' limits around points (m, 2) [m] and drones of a radius, at one scale."""
    lower, upper = np.min(points, axis=0), np.max(points, axis=0)
    margin = radius + 0.05 * float(np.max(upper - lower))
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.0)
    axes.locator_params(steps=ROUND_STEPS)
    axes.update_datalim([lower - margin, upper + margin])
    axes.autoscale_view()


def _draw_ellipsoids(axes: Axes, sizes: Array, points: Array, fill: Any, edge: Any) -> None:
    """Draw the drones' ellipsoids with semi-axes (2,) about ``points`` (N, 2) [m]."""
    width, height = 2.0 * sizes
    look = {"facecolors": fill, "edgecolors": edge, "linewidths": 0.8}
    placed: Any = {"units": "xy", "offsets": points, "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection([width], [height], [0.0], zorder=3, **placed, **look))


def _write_names(axes: Axes, flight: Flight, ends: Array) -> None:
    """Write names of teams or single drones next to ``ends`` (N, 2), or of vertices."""
    team = flight.team
    drawn = Appearance.of(flight)
    labels = drawn.labels
    if not (labels or team.has_cables) and len(ends) <= MAX_NAMED:
        each = zip(drawn.drones, drawn.drone_colours, range(len(ends)), strict=True)
        labels = tuple(TeamLabel(name, colour, slice(i, i + 1)) for name, colour, i in each)
    painter.write_labels(axes, labels, ends, flight.requirements.separation.radius)
    names = team.point_names
    motion = flight.alone
    if labels or motion is None or len(names) > MAX_NAMED:
        return
    if not (team.has_cables and motion.formed[-1]):
        return
    look: Any = {"va": "center", "zorder": 6}
    look["path_effects"] = [withStroke(linewidth=2.0, foreground="white")]
    places = motion.vertices.at(motion.vertices.breaks[-1])[: len(names), :2]
    is_page = _height(axes) < PAGE_HEIGHT
    offsets = (PAGE_DISTANCE if is_page else NAME_DISTANCE) * unit(np.mean(places, axis=0) - places)
    if not team.layout.closed:  # drones are at the ends, and their cables inward
        offsets[[0, -1]] *= -END_NAME_DISTANCE
    for name, place, offset in zip(names, places, offsets, strict=True):
        write(axes, name, place, offset, **look)
