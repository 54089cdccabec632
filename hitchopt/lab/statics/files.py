"""Files and pictures of hitches at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hitchopt.directory import STATICS, STATICS_PICTURES
from hitchopt.lab.statics.equilibrium import Equilibrium
from hitchopt.lab.statics.tolerance import Tolerance
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.view import style

STATICS_FORMAT = "hitchopt-statics/1"  # Format of files of equilibria

STATICS_SIZE = (12.5, 4.8)  # Width and height of the picture of equilibria [inch]
PAGE_LEGEND = 1.0  # Height of a legend on a page [inch]

# Line style of the plan, and points of a unit circle
PLANNED: dict[str, Any] = {"color": style.INK, "linestyle": style.DASHES, "linewidth": 0.8}
CIRCLE = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 121)).view(np.float64).reshape(-1, 2)

TIME_COLOURS = ("#9ecae1", "#4292c6", "#08306b")  # Colours of the times at which vertices are drawn
MAX_NAMED = 8  # Maximum number of cables in a legend
MAX_DRAWN_RATIO = 3.0  # Largest drawn tension of a range, over the largest at rest


def save_statics(
    directory: Path,
    rest: Equilibrium,
    ranges: Tolerance | None,
    format: str = "png",
    width: float | None = None,
) -> Path:
    """Write a hitch at rest at times (S,), and its ranges if any, to a plan's directory.

    The picture is ``statics.png``, or ``svg`` or ``pdf``; with a ``width`` [inch] it is a figure
    for a paper. Only statics.json and its pictures are replaced; FileError if writing fails.
    """
    content = statics_content(rest, ranges)
    figure = draw_statics(rest, ranges, width)
    writers: dict[str, Writer] = {
        f"statics.{format}": lambda path: style.save_figure(figure, path),
        STATICS: lambda path: write_strict_json(path, content),
    }
    return replace_files(directory, writers, (STATICS, *STATICS_PICTURES), seal=STATICS)


def statics_content(rest: Equilibrium, ranges: Tolerance | None) -> dict[str, Any]:
    """Return the content of statics.json: lists over the times ``t``, in SI units.

    ``band`` of a vertex is the range of its outward displacement with friction; null if unbounded.
    """
    content: dict[str, Any] = {
        "format": STATICS_FORMAT,
        "t": rest.t.tolist(),
        "slack_cables": list(rest.slack_cables),
        "loose_clasps": list(rest.loose_clasps),
        "force_residual": float(rest.force_residual.max()),
        "length_residual": float(rest.length_residual.max()),
    }
    cables = {
        "planned_tension": rest.planned_tensions,
        "tension": rest.tensions,
        "slack": rest.slack,
    }
    vertices = {"planned": rest.planned_vertices, "position": rest.vertices}
    vertices["band"] = rest.band
    drones = {"planned": rest.planned_drones, "position": rest.drones}
    if ranges is not None:
        content["errors"] = {name: vars(size) for name, size in ranges.errors.items()}
        content["may_be_slack"] = list(ranges.slack_cables)
        content["tension_remainder"] = ranges.tension_remainders.tolist()
        content["vertex_remainder"] = ranges.vertex_remainders.tolist()
        cables |= {"smallest": ranges.tensions[..., 0], "largest": ranges.tensions[..., 1]}
        vertices |= {"half_widths": ranges.vertex_halves, "radius": ranges.radii}
    team = rest.team
    for kind, names, order, columns in (
        ("cables", [f"c{k}" for k in range(team.robots)], team.edges, cables),
        ("vertices", team.point_names, range(team.layout.points), vertices),
        ("drones", team.listed_names, team.listed, drones),
    ):
        content[kind] = [
            {"name": name, **{key: values[:, k].tolist() for key, values in columns.items()}}
            for name, k in zip(names, order, strict=True)
        ]
    return content


@style.own_style()
def draw_statics(rest: Equilibrium, ranges: Tolerance | None, width: float | None = None) -> Figure:
    """Return the picture: tensions over time, and vertices from above.

    With a ``width`` [inch] it is a figure for a paper.
    """
    if width is None:
        figure = style.new_figure(STATICS_SIZE)
        left, right = figure.subplots(1, 2)
    else:
        figure = style.page_figure(width, 2.0 * style.PAGE_SHARE * width + PAGE_LEGEND)
        left, right = figure.subplots(2, 1)
    t = rest.t
    layout = rest.team.layout
    cables = rest.team.robots
    if ranges is not None:
        low, high = np.min(ranges.tensions[..., 0], 1), np.max(ranges.tensions[..., 1], 1)
        drawn = np.minimum(high, MAX_DRAWN_RATIO * np.max(rest.tensions))
        beyond = f", up to {np.max(high):.3g} N" if np.any(drawn < high) else ""
        words = f"range{beyond}"
        left.fill_between(t, low, drawn, color="0.87", label=words, zorder=1)
    look: dict[str, Any] = {"marker": "o" if len(t) == 1 else None, "zorder": 3}
    for k, colour in enumerate(style.cable_colours(cables)):  # first ones are visible below others
        label = f"{rest.team.cable_names[k]} at rest" if cables <= MAX_NAMED else ""
        wide = 1.2 + 2.4 * (1.0 - (k + 1) / cables)
        left.plot(t, rest.tensions[:, k], color=colour, lw=wide, label=label, **look)
    left.plot(t, rest.planned_tensions, zorder=4, **PLANNED)[0].set_label("planned")
    left.set(xlabel="t [s]", ylabel="tension [N]")
    style.from_zero(left, 0.1 + 0.06 * min(cables, MAX_NAMED))
    ring = np.arange(layout.points + layout.closed) % layout.points
    times = np.unique(np.linspace(0, len(t) - 1, len(TIME_COLOURS)).round().astype(np.intp))
    lines = dict[str, Any](planned=Line2D([], [], **PLANNED))
    areas = dict[str, Any]()
    areas["drone"] = Line2D([], [], color=style.INK, marker="x", ls="none", ms=4)
    for colour, i in zip(TIME_COLOURS[-len(times) :], times, strict=True):
        path = right.plot(*rest.vertices[i, ring, :2].T, color=colour, marker=".", lw=1.8)
        lines[f"vertices, t = {t[i]:.2f} s"] = path[0]
        right.plot(*rest.planned_vertices[i, ring, :2].T, **PLANNED)
        right.plot(*rest.drones[i, :, :2].T, color=colour, marker="x", linestyle="none", ms=4)
        if np.ptp(rest.band[i]) > 1e-4:  # visible [m]
            for ends in rest.rests[i, ..., :2].swapaxes(0, 1):
                areas["band of rest"] = right.plot(*ends.T, color=colour, lw=5.0, alpha=0.35)[0]
        shapes = () if ranges is None else ranges.ellipsoids[i, :, :2, :2]
        for centre, shape in zip(rest.vertices[i, :, :2], shapes, strict=False):
            squares, directions = np.linalg.eigh(shape)
            ellipse = centre + CIRCLE * np.sqrt(np.maximum(squares, 0.0)) @ directions.T
            areas["range of a vertex"] = right.fill(*ellipse.T, color=colour, alpha=0.35)[0]
    right.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="x [m]", ylabel="y [m]")
    lines |= areas
    if width is not None:
        curves, labels = left.get_legend_handles_labels()
        entries = dict(zip([*labels, *lines], [*curves, *lines.values()], strict=True))
        for label, handle in entries.items():
            handle.set_label(label)
        style.legend_on_page(figure, list(entries.values()))
        return figure
    left.legend(loc="upper right", frameon=False, fontsize="small", ncols=2)
    figure.legend(lines.values(), lines, loc="outside right upper", frameon=False, fontsize="small")
    return figure
