"""The hitch from above: how it starts, how it ends, and the drones' ways between."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.view.curves import Curves

Array = NDArray[np.float64]

CABLE_COLOURS = ("#0b3c5d", "#2a8c82", "#e0a526", "#c8414f")
"""Neighbours differ in grey as well: luminance about 20, 45, 70 and 45 per cent, the last one
standing only between the first and the third."""

START_COLOUR = "0.62"
PATH_COLOUR = "0.72"
INK = "0.1"

MOST_LABELS = 12
"""Larger hitches are drawn without their vertices' numbers: they would hide the drawing."""

WIDTH = 430.0
"""[points] About the width of the axes."""

HALO = (withStroke(linewidth=2.5, foreground="white"),)


def draw_plan_view(axes: Axes, motion: Motion, curves: Curves) -> None:
    """Draw both hitches with their cables and drones, and the drones' paths.

    Parameters
    ----------
    axes: to draw on; its aspect becomes equal.
    motion: the plan.
    curves: of that plan.
    """
    states = curves.states
    n = motion.team.robots
    thin = float(np.clip(6.0 / np.sqrt(n), 0.5, 2.0))  # [points]
    axes.add_collection(
        LineCollection(
            list(np.moveaxis(states.positions[..., :2], 0, 1)),
            colors=PATH_COLOUR,
            linewidths=0.5 * thin,
            zorder=1,
        )
    )
    start, end = (_cables(motion.team.layout, states, i) for i in (0, -1))
    moves = bool(np.max(np.abs(end - start)) > 1e-3)
    if moves:
        axes.add_collection(
            LineCollection(
                list(start), colors=START_COLOUR, linewidths=0.6 * thin, linestyles=(0, (4, 2)),
                zorder=2,
            )
        )  # fmt: skip
    axes.add_collection(LineCollection(list(end), colors=_colours(n), linewidths=thin, zorder=3))
    for order, (which, colour) in enumerate(((0, START_COLOUR), (-1, INK)), start=4):
        _draw_drones(axes, states.positions[which], colour, _marker_size(states), order)
    size = 2.0 * motion.requirements.separation.radius
    axes.add_collection(
        EllipseCollection(
            [size], [size], [0.0], units="xy", offsets=states.positions[-1][:, :2],
            offset_transform=axes.transData, facecolors="none", edgecolors="0.45",
            linewidths=0.3 * thin, zorder=4,
        )
    )  # fmt: skip
    if n <= MOST_LABELS and states.formed[-1]:
        _label_vertices(axes, motion.team.layout, states.vertices[-1][:, :2])
    axes.set_aspect("equal", adjustable="datalim")
    _make_room(axes, states.positions[..., :2], motion.requirements.separation.radius)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(
        handles=_legend(moves),
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=3,
        frameon=False,
        fontsize="small",
    )


def _cables(layout: Layout, states: States, i: int) -> Array:
    """Return (n, 4, 2) [m]: cable k from q_k over the ends of its edge to r_k, in state i.

    From above, a cable that hangs free is straight.
    """
    vertices, pairs = states.vertices[i], states.positions[i].reshape(-1, 2, 3)
    edges = [vertices[layout.starts], vertices[layout.ends]]
    if not states.formed[i]:
        edges = [pairs[:, 0], pairs[:, 1]]
    return np.stack([pairs[:, 0], *edges, pairs[:, 1]], axis=1)[..., :2]


def _colours(n: int) -> list[str]:
    """Return a colour for each cable, another than either neighbour's."""
    index = np.arange(n) % 3
    if n % 3 == 1:
        index[-1] = 3
    return [CABLE_COLOURS[i] for i in index]


def _marker_size(states: States) -> float:
    """Return [points] a size that leaves most of the cables between neighbouring drones to see."""
    drones = states.positions[-1][:, :2]
    nearest = np.asarray(cKDTree(drones).query(drones, k=[2])[0])
    extent = float(np.max(np.ptp(states.positions[..., :2], axis=(0, 1))))
    return float(np.clip(0.25 * float(np.median(nearest)) / extent * WIDTH, 1.0, 6.0))


def _draw_drones(axes: Axes, drones: Array, colour: str, size: float, order: int) -> None:
    for first, marker, fill in ((0, "o", colour), (1, "s", "white")):
        axes.plot(
            drones[first::2, 0],
            drones[first::2, 1],
            linestyle="none",
            marker=marker,
            markersize=size,
            markeredgewidth=min(1.0, 0.25 * size),
            markerfacecolor=fill,
            markeredgecolor=colour,
            zorder=order,
        )


def _label_vertices(axes: Axes, layout: Layout, vertices: Array) -> None:
    """Write every vertex's number inside of it, where no leg passes."""
    edges = layout.edges(vertices)
    directions = edges / np.linalg.norm(edges, axis=1)[:, None]
    # Away from the chain where it begins and ends; at clasps of length 2 cos(half the corner).
    inward = np.zeros_like(vertices)
    inward[layout.starts] += directions
    inward[layout.ends] -= directions
    inward[~np.isin(np.arange(len(vertices)), layout.clasps)] *= -1.0
    length = np.linalg.norm(inward, axis=1)[:, None]
    sharpness = np.sqrt(np.maximum(1.0 - 0.25 * length**2, 1e-9))  # sin(half the corner)
    offsets = np.clip(11.0 / sharpness, 13.0, 32.0) * inward / np.maximum(length, 1e-9)  # [points]
    for k, (point, offset) in enumerate(zip(vertices, offsets, strict=True)):
        axes.annotate(
            f"$p_{{{k}}}$",
            point,
            offset,
            textcoords="offset points",
            ha="center",
            va="center",
            path_effects=list(HALO),
            zorder=6,
        )


def _make_room(axes: Axes, points: Array, margin: float) -> None:
    lower, upper = np.min(points, axis=(0, 1)), np.max(points, axis=(0, 1))
    room = margin + 0.05 * float(np.max(upper - lower))
    axes.margins(0.0)
    axes.update_datalim([lower - room, upper + room])
    axes.autoscale_view()


def _legend(moves: bool) -> list[Line2D]:
    start = [Line2D([], [], color=START_COLOUR, linestyle=(0, (4, 2)), label="start")]
    return [
        *(start if moves else []),
        Line2D([], [], color=CABLE_COLOURS[0], linewidth=2, label="end (one colour per cable)"),
        Line2D([], [], color=PATH_COLOUR, label="drones' paths"),
        _sample_marker("o", INK, INK, "drones q"),
        _sample_marker("s", "white", INK, "drones r"),
        _sample_marker("o", "none", "0.45", "a drone's ellipsoid", 11.0),
    ]


def _sample_marker(marker: str, fill: str, edge: str, label: str, size: float = 6.0) -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="none",
        marker=marker,
        markersize=size,
        markerfacecolor=fill,
        markeredgecolor=edge,
        label=label,
    )
