"""Single drones from above: where they start and end, their ways, and what they stay out of."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from numpy.typing import NDArray

from hitchopt.motion.motion import Motion
from hitchopt.view.curves import Curves

Array = NDArray[np.float64]

COLOURS = ("#0b3c5d", "#2a8c82", "#e0a526", "#c8414f")

MOST_LABELS = 30
"""Drones of larger swarms are drawn without their names: they would hide the drawing."""


def draw_swarm_view(axes: Axes, motion: Motion, curves: Curves) -> None:
    """Draw starts, goals and ways.

    Parameters
    ----------
    axes: to draw on; its aspect becomes equal.
    motion: the plan.
    curves: of that plan.
    """
    positions = curves.states.positions[..., :2]  # (samples, N, 2)
    n = positions.shape[1]
    thin = float(np.clip(6.0 / np.sqrt(n), 0.4, 1.4))  # [points]
    colours = [COLOURS[i % len(COLOURS)] for i in range(n)]
    for prism in motion.requirements.keep_out:
        axes.add_patch(
            Polygon(
                prism.polygon.vertices, facecolor="0.88", edgecolor="0.4", hatch="////",
                linewidth=0.8, zorder=1,
            )
        )  # fmt: skip
    arena = motion.requirements.arena
    if arena is not None:
        size = arena.upper - arena.lower
        axes.add_patch(
            Rectangle(
                (float(arena.lower[0]), float(arena.lower[1])),
                float(size[0]), float(size[1]), facecolor="none", edgecolor="0.4", linewidth=1.0,
                zorder=1,
            )
        )  # fmt: skip
    axes.add_collection(
        LineCollection(
            list(np.moveaxis(positions, 0, 1)), colors=colours, linewidths=thin, zorder=2
        )
    )
    diameter = 2.0 * motion.requirements.separation.radius
    for which, fill in ((0, "white"), (-1, "face")):
        axes.add_collection(
            EllipseCollection(
                [diameter], [diameter], [0.0], units="xy", offsets=positions[which],
                offset_transform=axes.transData,
                facecolors="white" if fill == "white" else colours, edgecolors=colours,
                linewidths=0.8, alpha=0.9, zorder=3 if which == 0 else 4,
            )
        )  # fmt: skip
    if n <= MOST_LABELS:
        for name, point in zip(motion.team.drone_names, positions[-1], strict=True):
            axes.annotate(
                name, (float(point[0]), float(point[1])), ha="center", va="center", color="white",
                fontsize=6, zorder=5, annotation_clip=True,
            )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    _make_room(axes, positions, motion)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(
        handles=_legend(motion),
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=3,
        frameon=False,
        fontsize="small",
    )


def _make_room(axes: Axes, points: Array, motion: Motion) -> None:
    lower, upper = np.min(points, axis=(0, 1)), np.max(points, axis=(0, 1))
    if motion.requirements.arena is not None:
        lower = np.minimum(lower, motion.requirements.arena.lower[:2])
        upper = np.maximum(upper, motion.requirements.arena.upper[:2])
    room = 2.0 * motion.requirements.separation.radius + 0.02 * float(np.max(upper - lower))
    axes.margins(0.0)
    axes.update_datalim([lower - room, upper + room])
    axes.autoscale_view()


def _legend(motion: Motion) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        _marker("white", "start"),
        _marker(COLOURS[0], "goal, as wide as its ellipsoid"),
        Line2D([], [], color=COLOURS[0], linewidth=1.4, label="ways"),
    ]
    if motion.requirements.keep_out:
        handles.append(Patch(facecolor="0.88", edgecolor="0.4", hatch="////", label="keep out"))
    if motion.requirements.arena is not None:
        handles.append(Patch(facecolor="none", edgecolor="0.4", label="arena"))
    return handles


def _marker(fill: str, label: str) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="none",
        marker="o",
        markersize=9.0,
        markerfacecolor=fill,
        markeredgecolor=COLOURS[0],
        label=label,
    )
