"""Pictures of a plan: at a glance (summary.png), from above, over time, closest neighbours."""

from __future__ import annotations

import math
import warnings
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.transforms import blended_transform_factory
from scipy.spatial import cKDTree

from hitchopt.checks.certificate import Certificate, html_table
from hitchopt.checks.closeness import Closeness
from hitchopt.checks.drones import FASTEST, USED_THRUST
from hitchopt.checks.registry import RULE_OF
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import States, states_at
from hitchopt.values import Array
from hitchopt.view.painter import FEW, chosen_shots, draw_plan_storyboard
from hitchopt.view.shapes import outline
from hitchopt.view.style import (
    COLOURS,
    DASHES,
    INK,
    LIMIT_COLOUR,
    cable_colours,
    draw_lines,
    drone_colours,
    facts,
    headline,
    legend_below,
    marker,
    new_figure,
    object_colours,
    verdict,
)

SIZE, WIDTHS, HEIGHTS = (13.0, 7.2), (1.25, 1.0), (1.0, 1.25)
"""Width and height [inch], shares of left and right, and on the left of few panels and what is
below them."""

LEGEND_GAP = 0.17
"""Distance of the legend from a plan below panels, as a share of its height."""

LABEL_AT = -0.1
"""Where the plots' labels stand, as a share of their width: aligning them costs a tenth of all."""

CARD_RESOLUTION = 65
"""Resolution of a notebook's picture [dots per inch]: 850 pixels wide."""

POINTS, SAMPLES = 150_000, (60, 600)
"""Number of drone positions that a picture is drawn from, and bounds on that of times: more are
finer than a picture's pixels."""

FORBIDDEN, HATCH = "0.8", "////"

CURVE = 1.4
"""Width of a curve [points]."""

ENDLESS = 1e9
"""Largest worst value that is drawn: larger ones say that nothing was counted or bounded."""

LINE, HEIGHT = 11.0, 110.0
"""Heights of a line of small text, and approximately of a plot [points]."""

CHARACTER = 0.013
"""Width of a character of a phase's name as a share of the axes' width."""

CLOSE_SIZE, CLOSE_SAMPLES, CLOSE_TOP = (10.0, 4.8), 800, 4.0
"""Figure of the closest neighbours: width and height [inch], points of a curve, and the largest
separation that is shown; larger ones are of no concern."""

START_COLOUR, PATH_COLOUR, ELLIPSOID_COLOUR = "0.62", "0.72", "0.45"
START_DASHES = (0, (4, 2))

MAX_NUMBERED = 12
"""Number of robots up to which vertices are numbered: more numbers hide the drawing."""

MAX_NAMED = 30
"""Number of single drones up to which they are named: more names hide the drawing."""

WIDTH = 430.0
"""Approximate width of the axes [points]."""

LOW_DIGITS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
"""Digits of an index; mathematical text would take a twentieth of the time to draw a plan."""

DASHED = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
STYLES = tuple(zip((*COLOURS, "#6a4c93", "0.45"), DASHED, strict=True))
"""Colour and line style of every pair that is drawn, the closest first; they differ in grey too."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One limited quantity over time.

    Attributes
    ----------
    name, label: of its check; name and unit for people.
    values: the curve (samples,), in the label's unit.
    limit: its limit, in the same unit.
    share: whether values are shares of the limit, in place of the check's unit.
    """

    name: str
    label: str
    values: Array
    limit: float
    share: bool = False

    def worst_of(self, certificate: Certificate) -> tuple[float, float] | None:
        """Return time and value of the certificate's worst, in this unit, if it has one."""
        for check in certificate.checks:
            if check.name == self.name:
                value = check.bound / (check.number if self.share else 1.0)
                return (check.time, value) if abs(value) < ENDLESS else None
        return None


def sampled_states(motion: Motion) -> States:
    """Return the states of a plan at times that include the joints of its pieces."""
    samples = int(np.clip(POINTS // len(motion.team.drone_names), *SAMPLES))
    even = np.linspace(0.0, motion.duration, samples)
    joints = motion.drones.breaks - motion.drones.breaks[0]
    few = joints if len(joints) < samples else joints[:0]
    return states_at(motion, np.unique(np.minimum(np.concatenate([even, few]), even[-1])))


def panels(motion: Motion, states: States) -> tuple[Panel, ...]:
    """Return the quantities from top to bottom; thrust is a share of its limit if drones differ.

    A single drone has no separation.
    """
    times, requirements = states.t + motion.drones.breaks[0], motion.requirements
    thrust, kinds = USED_THRUST.curve(motion, times), np.unique(motion.team.max_thrust)
    forces = Panel("thrust", "largest thrust\n/ its limit", thrust, 1.0, share=True)
    if len(kinds) == 1:
        limit = float(kinds[0])
        forces = Panel("thrust", "largest\nthrust [N]", limit * thrust, limit)
    speed = FASTEST.curve(motion, times)
    rates = Panel("speed", "largest\nspeed [m/s]", speed, requirements.limits.speed)
    if len(motion.team.drone_names) < 2:
        return (rates, forces)
    scaled = states.positions * requirements.separation.scale
    apart = np.array([np.min(cKDTree(at).query(at, k=[2])[0]) for at in scaled])
    return (Panel("separation", "smallest\nseparation [–]", apart, 1.0), rates, forces)


def draw_summary(motion: Motion, certificate: Certificate, title: str = "") -> Figure:
    """Return the picture: a storyboard, or single drones from above; what is limited over time.

    Parameters
    ----------
    motion: the plan.
    certificate: its certificate, whose worst values are marked.
    title: the problem's title.
    """
    figure = new_figure(SIZE)
    states = sampled_states(motion)
    shown = panels(motion, states)
    grid = figure.add_gridspec(len(shown), 2, width_ratios=WIDTHS)
    _draw_left(figure, grid[:, 0], motion, states)
    axes = [figure.add_subplot(grid[row, 1]) for row in range(len(shown))]
    for each, panel in zip(axes, shown, strict=True):
        _draw_panel(each, states.t, panel, certificate)
        each.yaxis.set_label_coords(LABEL_AT, 0.5)
        each.tick_params(labelbottom=each is axes[-1])
    draw_phases(axes, motion.phases, motion.duration)
    axes[-1].set_xlabel("t [s]")
    handles = [
        Line2D([], [], color=INK, linewidth=CURVE, label="worst drone or pair"),
        Line2D([], [], color=LIMIT_COLOUR, linestyle=DASHES, label="limit"),
        _worst_marker(),
        Patch(facecolor="none", edgecolor=FORBIDDEN, hatch=HATCH, linewidth=0, label="forbidden"),
    ]
    legend_below(axes[-1], handles, 0.32, 2)
    headline(figure, title, f"{facts(motion)}; {verdict(certificate)}")
    return figure


def plan_card(motion: Motion, certificate: Certificate, title: str) -> str:
    """Return what notebooks show, as HTML without an outside address: picture, phases, checks."""
    picture = BytesIO()
    with warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        draw_summary(motion, certificate, title).savefig(picture, dpi=CARD_RESOLUTION)
    image = b64encode(picture.getvalue()).decode()
    phases = html_table(
        ("phase", "step", "start", "end", "remark"),
        [
            (p.name, str(p.step), f"{p.start:.3f} s", f"{p.end:.3f} s", p.remark)
            for p in motion.phases
        ],
    )
    drones = f"{len(motion.team.drone_names)} drones, {motion.duration:.4g} s"
    return (
        f"<p><b>{escape(title or 'Plan')}</b>: {drones}</p>"
        f'<img alt="the plan at a glance" src="data:image/png;base64,{image}"/>'
        f"{phases}{certificate._repr_html_()}"
    )


def plot_from_above(motion: Motion, axes: Axes | None) -> Axes:
    """Draw the plan from above on axes, by default on those of a new figure of pyplot's."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=(6.5, 7.0), layout="constrained")[1]
    draw_plan_view(axes, motion, sampled_states(motion))
    return axes


def draw_phases(axes: Sequence[Axes], phases: Sequence[Phase], duration: float) -> None:
    """Shade every other phase on all axes, and name the phases whose names fit on the first.

    Parameters
    ----------
    axes: the plots' axes from top to bottom.
    phases, duration: of the plan [s].
    """
    for i, phase in enumerate(phases):
        for each in axes:
            if i % 2:
                each.axvspan(phase.start, phase.end, color="0.93", linewidth=0, zorder=-1)
            if i > 0:
                each.axvline(phase.start, color="0.6", linewidth=0.7, linestyle=":", zorder=1)
        if (phase.end - phase.start) / duration > CHARACTER * (len(phase.name) + 1):
            middle = (0.5 * (phase.start + phase.end), 1.0)
            axes[0].annotate(
                phase.name, middle, (0, 4), xycoords=axes[0].get_xaxis_transform(),
                textcoords="offset points", ha="center", fontsize="small", parse_math=False,
            )  # fmt: skip


def draw_closeness(motion: Motion, closest: Closeness) -> Figure:
    """Return the picture: bounds of every span as steps, the closest pairs as curves."""
    figure = new_figure(CLOSE_SIZE)
    axes = figure.add_subplot()
    edges = [span.start for span in closest.spans] + [closest.spans[-1].end]
    bounds = np.array([span.bound for span in closest.spans])
    t = np.linspace(edges[0], edges[-1], CLOSE_SAMPLES)
    positions = motion.drones.at(t) * motion.requirements.separation.scale
    index = {name: i for i, name in enumerate(motion.team.drone_names)}
    for pair, (colour, style) in zip(closest.pairs, STYLES, strict=False):
        i, j = (index[name] for name in pair.pair)
        ratio = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
        words = f"{pair.pair[0]}, {pair.pair[1]} (≥ {pair.bound:.3f})"
        axes.plot(t, ratio, color=colour, linestyle=style, linewidth=1.2, zorder=3, label=words)
    axes.stairs(
        bounds, edges, baseline=0.0, fill=True, color="0.87", zorder=1,
        label="no pair is closer, for all t",
    )  # fmt: skip
    axes.stairs(bounds, edges, baseline=None, color=INK, linewidth=1.4, zorder=2)
    axes.axhline(1.0, color=LIMIT_COLOUR, linestyle=DASHES, linewidth=1.2, label="limit", zorder=2)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, float(min(CLOSE_TOP, 1.35 * max(1.0, float(np.max(bounds))))))
    axes.set_xlabel("t [s]")
    axes.set_ylabel("separation [–]")
    axes.set_title("The closest neighbours over time", fontsize="medium")
    figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    return figure


def _draw_left(figure: Figure, place: SubplotSpec, motion: Motion, states: States) -> None:
    """Draw what is left of the limits.

    Few moments leave room for the plan from above, or for a few cables where there are many.
    """
    shots = chosen_shots(motion) if motion.team.has_cables else ()
    if not shots:
        draw_plan_view(figure.add_subplot(place), motion, states)
    elif len(shots) > FEW:
        draw_plan_storyboard(place, motion, shots)
    else:
        parts = place.subgridspec(2, 1, height_ratios=HEIGHTS)
        near = [shot for shot in shots if shot.near]
        if near:
            draw_plan_storyboard(parts[1], motion, near)
        else:
            draw_plan_view(figure.add_subplot(parts[1]), motion, states, LEGEND_GAP)
        draw_plan_storyboard(parts[0], motion, [shot for shot in shots if not shot.near])


def _draw_panel(axes: Axes, t: Array, panel: Panel, certificate: Certificate) -> None:
    """Draw one quantity at times [s], its limit, the forbidden side, the certificate's worst."""
    axes.plot(t, panel.values, color=INK, linewidth=CURVE, zorder=3)
    worst, lowest = panel.worst_of(certificate), RULE_OF[panel.name].sense == "min"
    top = 1.22 * max(panel.limit, float(np.max(panel.values)), worst[1] if worst else 0.0)
    axes.set_ylim(0.0, top)
    axes.axhline(panel.limit, color=LIMIT_COLOUR, linewidth=1.2, linestyle=DASHES, zorder=2)
    forbidden = (0.0, panel.limit) if lowest else (panel.limit, top)
    axes.axhspan(
        *forbidden, facecolor="none", edgecolor=FORBIDDEN, hatch=HATCH, linewidth=0, zorder=0
    )
    _label(axes, f"limit {panel.limit:.4g}", panel.limit, LIMIT_COLOUR)
    if worst is not None:
        time, value = worst
        axes.plot([time, t[-1]], [value, value], color=INK, linewidth=0.6, linestyle=":", zorder=2)
        mark = _worst_marker()
        mark.set(data=([time], [value]), clip_on=False, zorder=5)
        axes.add_line(mark)
        # The worst value's label is shifted as far from the limit's as they would overlap.
        gap = (value - panel.limit) / top * HEIGHT
        shift = math.copysign(max(LINE - abs(gap), 0.0), gap or (1.0 if lowest else -1.0))
        _label(axes, f"worst {value:.4g}", value, INK, shift)
    axes.set_ylabel(panel.label)
    axes.set_xlim(float(t[0]), float(t[-1]))
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _worst_marker() -> Line2D:
    line = marker("D", "white", INK, "worst for all t, from the certificate")
    line.set_markeredgewidth(CURVE)
    return line


def _label(axes: Axes, text: str, value: float, colour: str, shift: float = 0.0) -> None:
    """Write a text on the right of the axes, where no curve can be."""
    transform = blended_transform_factory(axes.transAxes, axes.transData)
    axes.annotate(
        text, (1.0, value), (5.0, shift), xycoords=transform, textcoords="offset points",
        va="center", fontsize="small", color=colour, annotation_clip=False,
    )  # fmt: skip


def draw_plan_view(axes: Axes, motion: Motion, states: States, gap: float = 0.1) -> None:
    """Draw hitches or single drones at start and end, the drones' paths, and what bounds them.

    Parameters
    ----------
    axes: what to draw on; its aspect becomes equal.
    motion, states: the plan, and its states (samples,) from the start to the end.
    gap: between the axes and the legend below, as a share of the axes' height.
    """
    draw = _draw_hitches if motion.team.has_cables else _draw_single_drones
    handles = [*draw(axes, motion, states), *_draw_objects(axes, motion)]
    axes.set_aspect("equal", adjustable="datalim")
    shown = states.positions[..., :2].reshape(-1, 2)
    arena = motion.requirements.arena
    if arena is not None and not motion.team.has_cables:
        shown = np.vstack([shown, arena.lower[:2], arena.upper[:2]])
    lower, upper = np.min(shown, axis=0), np.max(shown, axis=0)
    margin = motion.requirements.separation.radius + 0.05 * float(np.max(upper - lower))
    axes.margins(0.0)
    axes.update_datalim([lower - margin, upper + margin])
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    legend_below(axes, handles, gap, 3)


def _draw_hitches(axes: Axes, motion: Motion, states: States) -> list[Artist]:
    """Draw the cables and drones of both ends; return the legend's entries."""
    n, layout = motion.team.robots, motion.team.layout
    points = states.positions[..., :2]
    thin = float(np.clip(6.0 / np.sqrt(n), 0.5, 2.0))  # [points]
    draw_lines(axes, np.moveaxis(points, 0, 1), PATH_COLOUR, 0.5 * thin, 1)
    start, end = (_cables(layout, states, i) for i in (0, -1))
    moves = bool(np.max(np.abs(end - start)) > 1e-3)
    if moves:
        draw_lines(axes, start, START_COLOUR, 0.6 * thin, 2, linestyles=START_DASHES)
    draw_lines(axes, end, cable_colours(n), thin, 3)
    # Markers of a size that leaves most of the cables between neighbours visible.
    nearest = float(np.median(np.asarray(cKDTree(points[-1]).query(points[-1], k=[2])[0])))
    extent = float(np.max(np.ptp(points, axis=(0, 1))))
    size = float(np.clip(0.25 * nearest / extent * WIDTH, 1.0, 6.0))
    for order, (which, colour) in enumerate(((0, START_COLOUR), (-1, INK)), start=4):
        for first, shape, fill in ((0, "o", colour), (1, "s", "white")):
            line = marker(shape, fill, colour, "", size)
            width = min(1.0, 0.25 * size)
            line.set(data=points[which, first::2].T, markeredgewidth=width, zorder=order)
            axes.add_line(line)
    radius = motion.requirements.separation.radius
    _draw_ellipsoids(axes, radius, points[-1], "none", ELLIPSOID_COLOUR, 0.3 * thin, 4)
    if n <= MAX_NUMBERED and states.formed[-1]:
        _number_vertices(axes, layout, states.vertices[-1][:, :2])
    begin = [Line2D([], [], color=START_COLOUR, linestyle=START_DASHES, label="start")]
    return [
        *(begin if moves else []),
        Line2D([], [], color=COLOURS[0], linewidth=2, label="end (one colour per cable)"),
        Line2D([], [], color=PATH_COLOUR, label="drones' paths"),
        marker("o", INK, INK, "drones q"),
        marker("s", "white", INK, "drones r"),
        marker("o", "none", ELLIPSOID_COLOUR, "a drone's ellipsoid", 11.0),
    ]


def _draw_single_drones(axes: Axes, motion: Motion, states: States) -> list[Artist]:
    """Draw starts, goals, paths, keep-outs and the arena; return the legend's entries."""
    requirements, points = motion.requirements, states.positions[..., :2]
    names, colours = motion.team.drone_names, drone_colours(motion.team)
    radius, thin = requirements.separation.radius, 6.0 / np.sqrt(len(names))  # [points]
    draw_lines(axes, np.moveaxis(points, 0, 1), colours, float(np.clip(thin, 0.4, 1.4)), 2)
    _draw_ellipsoids(axes, radius, points[0], "white", colours, 0.8, 3)
    _draw_ellipsoids(axes, radius, points[-1], colours, colours, 0.8, 4)
    for name, (x, y) in zip(names, points[-1], strict=True) if len(names) <= MAX_NAMED else ():
        axes.annotate(
            name, (float(x), float(y)), ha="center", va="center", color="white", fontsize=6,
            zorder=5, annotation_clip=True,
        )  # fmt: skip
    handles: list[Artist] = [
        marker("o", "white", COLOURS[0], "start", 9.0),
        marker("o", COLOURS[0], COLOURS[0], "goal, as wide as its ellipsoid", 9.0),
        Line2D([], [], color=COLOURS[0], linewidth=1.4, label="paths"),
    ]
    bounds: list[Artist] = [
        Polygon(
            prism.polygon.vertices, facecolor="0.88", edgecolor="0.4", hatch="////", linewidth=0.8,
            zorder=1, label="keep out",
        )
        for prism in requirements.keep_out
    ]  # fmt: skip
    handles += bounds[:1]
    if requirements.arena is not None:
        (x, y), (right, back) = requirements.arena.lower[:2], requirements.arena.upper[:2]
        box = Rectangle((x, y), right - x, back - y, fill=False, ec="0.4", zorder=1, label="arena")
        bounds.append(box)
        handles.append(box)
    for bound in bounds:
        axes.add_artist(bound)
    return handles


def _draw_objects(axes: Axes, motion: Motion) -> list[Artist]:
    """Draw all objects where they end, and dashed where they have stood; return the legend's."""
    poses = motion.object_poses
    first, last = poses.coefficients[0, ..., 0], poses.coefficients[-1, ..., -1]
    kinds = set()
    bodies = motion.requirements.objects.values()
    for before, after, body, fill in zip(first, last, bodies, object_colours(motion), strict=True):
        kinds.add((fill, "table" if body.fixed else "object"))
        places = [(after, fill, "-")]
        if np.any(before != after):
            places.insert(0, (before, "none", "--"))
        for slab in reversed(body.slabs):
            for (x, y, _, cosine, sine), colour, line in places:
                turn = np.array([[cosine, sine], [-sine, cosine]])
                style: dict[str, Any] = {"fc": colour, "ec": "0.5", "ls": line}
                corners = outline(slab.section) @ turn + [x, y]
                axes.add_patch(Polygon(corners, lw=0.8, zorder=0.5, **style))
    return [Patch(fc=fill, ec="0.5", label=label) for fill, label in sorted(kinds)]


def _draw_ellipsoids(
    axes: Axes, radius: float, points: Array, fill: Any, edge: Any, width: float, order: int
) -> None:
    """Draw the drones' ellipsoids about ``points`` (N, 2)."""
    diameter = [2.0 * radius]
    axes.add_collection(
        EllipseCollection(
            diameter, diameter, [0.0], units="xy", offsets=points,
            offset_transform=axes.transData, facecolors=fill, edgecolors=edge, linewidths=width,
            zorder=order,
        )
    )  # fmt: skip


def _cables(layout: Layout, states: States, i: int) -> Array:
    """Return (n, 4, 2) [m]: cable k from q_k over the ends of its edge to r_k, in state i.

    A cable that hangs free is straight when seen from above.
    """
    vertices, (q, r) = states.vertices[i], np.moveaxis(states.positions[i].reshape(-1, 2, 3), 1, 0)
    edges = (vertices[layout.starts], vertices[layout.ends]) if states.formed[i] else (q, r)
    return np.stack([q, *edges, r], axis=1)[..., :2]


def _number_vertices(axes: Axes, layout: Layout, vertices: Array) -> None:
    """Write every vertex's number on the inner side, where no leg passes."""
    directions = unit(layout.edges(vertices))
    # Away from the chain where it begins and ends; at clasps of length 2 cos(half the corner).
    inward = np.zeros_like(vertices)
    inward[layout.starts] += directions
    inward[layout.ends] -= directions
    inward[~np.isin(np.arange(len(vertices)), layout.clasps)] *= -1.0
    length = np.linalg.norm(inward, axis=1)[:, None]
    sharpness = np.sqrt(np.maximum(1.0 - 0.25 * length**2, 1e-9))  # sin(half the corner)
    offsets = np.clip(11.0 / sharpness, 13.0, 32.0) * inward / np.maximum(length, 1e-9)  # [points]
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for k, (point, offset) in enumerate(zip(vertices, offsets, strict=True)):
        axes.annotate(
            f"p{k}".translate(LOW_DIGITS), point, offset, textcoords="offset points", ha="center",
            va="center", path_effects=halo, zorder=6,
        )  # fmt: skip
