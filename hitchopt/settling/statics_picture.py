"""Picture of a settled hitch: tensions and their ranges over time, vertices and their ellipses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from hitchopt.settling.settled_hitch import Settled
from hitchopt.settling.tolerance import Tolerance
from hitchopt.values import Array
from hitchopt.view.house_colours import COLOURS
from hitchopt.view.style import DASHES, INK, new_figure, save_figure

SIZE = (10.0, 4.8)
"""Width and height [inch]."""

MOST_CURVES = 12
"""Cables whose tensions are drawn one by one; of larger teams all are one band."""

DRAWN_TIMES = 3
"""Times at which vertices are drawn: the first, the middle and the last one."""


def draw_statics(settled: Settled, ranges: Tolerance | None) -> Figure:
    """Return the picture."""
    figure = new_figure(SIZE)
    left, right = figure.subplots(1, 2)
    _draw_tensions(left, settled, ranges)
    _draw_vertices(right, settled, ranges)
    return figure


def save_statics_picture(path: Path, settled: Settled, ranges: Tolerance | None) -> None:
    """Draw the picture and write it as a PNG.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_figure(draw_statics(settled, ranges), path)


def _draw_tensions(axes: Axes, settled: Settled, ranges: Tolerance | None) -> None:
    t, count = settled.t, settled.tensions.shape[-1]
    marker = "o" if len(t) == 1 else None
    limits = None if ranges is None else ranges.tensions
    if limits is not None:
        low, high = np.min(limits[..., 0], axis=1), np.max(limits[..., 1], axis=1)
        finite = np.where(np.isfinite(high), high, 2.0 * np.max(settled.tensions))
        words = f"any cable, for errors of {_words(ranges)}"
        axes.fill_between(t, low, finite, color="0.87", label=words, zorder=1)
    if count <= MOST_CURVES:
        for k in range(count):
            axes.plot(
                t, settled.tensions[:, k], color=COLOURS[k % len(COLOURS)], marker=marker,
                linewidth=1.2, zorder=3, label="at rest" if k == 0 else None,
            )  # fmt: skip
    else:
        spread = np.min(settled.tensions, axis=1), np.max(settled.tensions, axis=1)
        axes.fill_between(t, *spread, color=COLOURS[0], label="at rest", zorder=3)
    axes.plot(t, settled.planned_tensions, color=INK, linestyle=DASHES, linewidth=0.8, zorder=2)
    axes.plot([], [], color=INK, linestyle=DASHES, linewidth=0.8, label="planned")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("t [s]")
    axes.set_ylabel("tension [N]")
    axes.legend(frameon=False, fontsize="small")


def _draw_vertices(axes: Axes, settled: Settled, ranges: Tolerance | None) -> None:
    times = np.unique(np.linspace(0, len(settled.t) - 1, DRAWN_TIMES).round().astype(np.intp))
    layout = settled.team.layout
    for colour, i in zip(COLOURS, times, strict=False):
        ring = np.append(np.arange(layout.points), 0) if layout.closed else np.arange(layout.points)
        planned, found = settled.planned_vertices[i], settled.vertices[i]
        axes.plot(*planned[ring, :2].T, color=INK, linestyle=DASHES, linewidth=0.8)
        words = f"t = {settled.t[i]:.2f} s"
        axes.plot(*found[ring, :2].T, color=colour, marker=".", linewidth=1.2, label=words)
        axes.plot(*settled.drones[i, :, :2].T, color=colour, marker="x", linestyle="none", ms=4)
        if ranges is not None:
            for centre, shape in zip(found, ranges.ellipsoids[i], strict=True):
                axes.add_patch(_ellipse(centre, shape, colour))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(frameon=False, fontsize="small")


def _ellipse(centre: Array, shape: Array, colour: str) -> Ellipse:
    """Return the outline of an ellipsoid (3, 3) [m²] as seen from above."""
    sizes, directions = np.linalg.eigh(shape[:2, :2])
    width, height = 2.0 * np.sqrt(np.maximum(sizes, 0.0))
    angle = float(np.degrees(np.arctan2(directions[1, 0], directions[0, 0])))
    return Ellipse(
        (centre[0], centre[1]), width, height, angle=angle, facecolor=colour, alpha=0.35,
        edgecolor=colour,
    )  # fmt: skip


def _words(ranges: Tolerance | None) -> str:
    """Return the sizes of the errors in words."""
    if ranges is None:
        return ""
    units = {"cable": "m of cable", "position": "m of position", "force": "N"}
    sizes = vars(ranges.errors).items()
    return ", ".join(f"{s.words} {units[name]}" for name, s in sizes if s.bound or s.deviation)
