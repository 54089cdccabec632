"""The picture of the closest neighbours over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hitchopt.checks.bounds.closest_pairs import Closeness
from hitchopt.motion.motion import Motion
from hitchopt.view.time_plots import DASHES, LIMIT_COLOUR

SIZE = (10.0, 4.8)
"""[inch]"""

RESOLUTION = 120
"""[dots per inch]"""

SAMPLES = 800
"""Of a pair's curve."""

DRAWN = 6
"""Pairs that are drawn."""

TOP = 4.0
"""Separation that the picture ends at, at the most: beyond, nobody is near."""

STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
"""Pairs differ in grey as well."""

COLOURS = ("#0b3c5d", "#2a8c82", "#e0a526", "#c8414f", "#6a4c93", "0.45")


def draw_closeness(motion: Motion, closest: Closeness) -> Figure:
    """Return the picture: bounds of every span as steps, the closest pairs as curves."""
    figure = Figure(figsize=SIZE, dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    edges = [span.start for span in closest.spans] + [closest.spans[-1].end]
    bounds = np.array([span.bound for span in closest.spans])
    t = np.linspace(edges[0], edges[-1], SAMPLES)
    positions = motion.drones.at(t) * motion.requirements.separation.scale
    index = {name: i for i, name in enumerate(motion.team.drone_names)}
    for k, pair in enumerate(closest.pairs[:DRAWN]):
        i, j = (index[name] for name in pair.pair)
        ratio = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
        axes.plot(
            t, ratio, color=COLOURS[k], linestyle=STYLES[k], linewidth=1.2, zorder=3,
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
    figure = draw_closeness(motion, closest)
    figure.savefig(path, format="png", dpi=RESOLUTION, metadata={"Software": None})
