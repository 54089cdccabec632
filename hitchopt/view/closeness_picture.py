"""The picture of the closest neighbours over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hitchopt.checks.bounds.closest_pairs import Closeness
from hitchopt.motion.motion import Motion
from hitchopt.view.house_colours import COLOURS
from hitchopt.view.style import DASHES, LIMIT_COLOUR, new_figure, save_figure

SIZE = (10.0, 4.8)
"""Width and height [inch]."""

SAMPLES = 800
"""Number of points of a pair's curve."""

TOP = 4.0
"""Largest separation that is shown: larger ones are of no concern."""

DASHED = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
STYLES = tuple(zip((*COLOURS, "#6a4c93", "0.45"), DASHED, strict=True))
"""Colour and line style of every pair that is drawn, the closest first; they differ in grey too."""


def draw_closeness(motion: Motion, closest: Closeness) -> Figure:
    """Return the picture: bounds of every span as steps, the closest pairs as curves."""
    figure = new_figure(SIZE)
    axes = figure.add_subplot()
    edges = [span.start for span in closest.spans] + [closest.spans[-1].end]
    bounds = np.array([span.bound for span in closest.spans])
    t = np.linspace(edges[0], edges[-1], SAMPLES)
    positions = motion.drones.at(t) * motion.requirements.separation.scale
    index = {name: i for i, name in enumerate(motion.team.drone_names)}
    for pair, (colour, style) in zip(closest.pairs, STYLES, strict=False):
        i, j = (index[name] for name in pair.pair)
        ratio = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
        axes.plot(
            t, ratio, color=colour, linestyle=style, linewidth=1.2, zorder=3,
            label=f"{pair.pair[0]}, {pair.pair[1]} (≥ {pair.bound:.3f})",
        )  # fmt: skip
    axes.stairs(
        bounds, edges, baseline=0.0, fill=True, color="0.87", zorder=1,
        label="no pair is closer, for all t",
    )  # fmt: skip
    axes.stairs(bounds, edges, baseline=None, color="0.1", linewidth=1.4, zorder=2)
    axes.axhline(1.0, color=LIMIT_COLOUR, linestyle=DASHES, linewidth=1.2, label="limit", zorder=2)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, float(min(TOP, 1.35 * max(1.0, float(np.max(bounds))))))
    axes.set_xlabel("t [s]")
    axes.set_ylabel("separation [–]")
    axes.set_title("The closest neighbours over time", fontsize="medium")
    figure.legend(loc="outside right upper", frameon=False, fontsize="small")
    return figure


def save_closeness(path: Path | str, motion: Motion, closest: Closeness) -> None:
    """Draw the picture and write it as a PNG.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_figure(draw_closeness(motion, closest), path)
