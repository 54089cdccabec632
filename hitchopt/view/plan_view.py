"""The plan from above: where hitch or drones start and end, and the drones' paths between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from scipy.spatial import cKDTree

from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.requirements import Arena, Requirements
from hitchopt.values import Array
from hitchopt.view.curves import Curves
from hitchopt.view.house_colours import COLOURS, cable_colours
from hitchopt.view.object_patches import draw_objects
from hitchopt.view.style import INK, legend_below, marker

START_COLOUR = "0.62"
PATH_COLOUR = "0.72"
START_DASHES = (0, (4, 2))

MAX_NUMBERED = 12
"""Number of robots up to which vertices are numbered: more numbers hide the drawing."""

MAX_NAMED = 30
"""Number of single drones up to which they are named: more names hide the drawing."""

WIDTH = 430.0
"""Approximate width of the axes [points]."""

Colours = str | list[str]

LOW_DIGITS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
"""Digits of an index; mathematical text would take a twentieth of the time to draw a plan."""

HALO = (withStroke(linewidth=2.5, foreground="white"),)


def draw_plan_view(axes: Axes, motion: Motion, curves: Curves, gap: float = 0.1) -> None:
    """Draw hitches or single drones at start and end, the drones' paths, and what bounds them.

    Parameters
    ----------
    axes: what to draw on; its aspect becomes equal.
    motion: the plan.
    curves: samples of that plan.
    gap: between the axes and the legend below, as a share of the axes' height.
    """
    states, requirements = curves.states, motion.requirements
    points = states.positions[..., :2]  # (samples, drones, 2)
    arena = None if motion.team.has_cables else requirements.arena
    if motion.team.has_cables:
        handles = _draw_hitches(axes, motion, states)
    else:
        handles = _draw_single_drones(axes, motion.team.drone_names, points, requirements)
    handles += draw_objects(axes, motion)
    axes.set_aspect("equal", adjustable="datalim")
    _fit(axes, points, requirements.separation.radius, arena)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    legend_below(axes, handles, gap, 3)


def _draw_hitches(axes: Axes, motion: Motion, states: States) -> list[Artist]:
    """Draw the cables and drones of both ends; return the legend's entries."""
    n, layout = motion.team.robots, motion.team.layout
    points = states.positions[..., :2]
    thin = float(np.clip(6.0 / np.sqrt(n), 0.5, 2.0))  # [points]
    _draw_lines(axes, np.moveaxis(points, 0, 1), PATH_COLOUR, 0.5 * thin, 1)
    start, end = (_cables(layout, states, i) for i in (0, -1))
    moves = bool(np.max(np.abs(end - start)) > 1e-3)
    if moves:
        _draw_lines(axes, start, START_COLOUR, 0.6 * thin, 2, linestyles=START_DASHES)
    _draw_lines(axes, end, list(cable_colours(n)), thin, 3)
    for order, (which, colour) in enumerate(((0, START_COLOUR), (-1, INK)), start=4):
        _draw_drones(axes, points[which], colour, _marker_size(states), order)
    radius = motion.requirements.separation.radius
    _draw_ellipsoids(axes, radius, points[-1], "none", "0.45", 0.3 * thin, 4)
    if n <= MAX_NUMBERED and states.formed[-1]:
        _number_vertices(axes, layout, states.vertices[-1][:, :2])
    begin = [Line2D([], [], color=START_COLOUR, linestyle=START_DASHES, label="start")]
    return [
        *(begin if moves else []),
        Line2D([], [], color=COLOURS[0], linewidth=2, label="end (one colour per cable)"),
        Line2D([], [], color=PATH_COLOUR, label="drones' paths"),
        marker("o", INK, INK, "drones q"),
        marker("s", "white", INK, "drones r"),
        marker("o", "none", "0.45", "a drone's ellipsoid", 11.0),
    ]


def _draw_single_drones(
    axes: Axes, names: Sequence[str], points: Array, requirements: Requirements
) -> list[Artist]:
    """Draw starts, goals, paths, keep-outs and the arena; return the legend's entries."""
    n = len(names)
    thin = float(np.clip(6.0 / np.sqrt(n), 0.4, 1.4))  # [points]
    colours = [COLOURS[i % len(COLOURS)] for i in range(n)]
    _draw_lines(axes, np.moveaxis(points, 0, 1), colours, thin, 2)
    _draw_ellipsoids(axes, requirements.separation.radius, points[0], "white", colours, 0.8, 3)
    _draw_ellipsoids(axes, requirements.separation.radius, points[-1], colours, colours, 0.8, 4)
    for name, (x, y) in zip(names, points[-1], strict=True) if n <= MAX_NAMED else ():
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
        (x, y), (right, back) = _corners(requirements.arena)
        bounds.append(
            Rectangle((x, y), right - x, back - y, fill=False, ec="0.4", zorder=1, label="arena")
        )
        handles.append(bounds[-1])
    for bound in bounds:
        axes.add_artist(bound)
    return handles


def _draw_lines(
    axes: Axes, lines: Array, colours: Colours, width: float, order: int, **style: Any
) -> None:
    """Draw lines (m, points, 2)."""
    axes.add_collection(
        LineCollection(list(lines), colors=colours, linewidths=width, zorder=order, **style)
    )


def _draw_ellipsoids(
    axes: Axes, radius: float, points: Array, fill: Colours, edge: Colours, width: float, order: int
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
    vertices, pairs = states.vertices[i], states.positions[i].reshape(-1, 2, 3)
    edges = [vertices[layout.starts], vertices[layout.ends]]
    if not states.formed[i]:
        edges = [pairs[:, 0], pairs[:, 1]]
    return np.stack([pairs[:, 0], *edges, pairs[:, 1]], axis=1)[..., :2]


def _marker_size(states: States) -> float:
    """Return the size [points] that leaves most of the cables between neighbours visible."""
    drones = states.positions[-1][:, :2]
    nearest = np.asarray(cKDTree(drones).query(drones, k=[2])[0])
    extent = float(np.max(np.ptp(states.positions[..., :2], axis=(0, 1))))
    return float(np.clip(0.25 * float(np.median(nearest)) / extent * WIDTH, 1.0, 6.0))


def _draw_drones(axes: Axes, drones: Array, colour: str, size: float, order: int) -> None:
    for first, shape, fill in ((0, "o", colour), (1, "s", "white")):
        line = marker(shape, fill, colour, "", size)
        line.set(data=drones[first::2].T, markeredgewidth=min(1.0, 0.25 * size), zorder=order)
        axes.add_line(line)


def _number_vertices(axes: Axes, layout: Layout, vertices: Array) -> None:
    """Write every vertex's number on the inner side, where no leg passes."""
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
            f"p{k}".translate(LOW_DIGITS), point, offset, textcoords="offset points", ha="center",
            va="center", path_effects=list(HALO), zorder=6,
        )  # fmt: skip


def _corners(arena: Arena) -> Array:
    """Return the lower and the upper corner of an arena from above (2, 2) [m]."""
    return np.stack([arena.lower[:2], arena.upper[:2]])


def _fit(axes: Axes, points: Array, radius: float, arena: Arena | None) -> None:
    """Show all points (…, 2) and the arena, with a margin for the drones' ellipsoids."""
    shown = points.reshape(-1, 2)
    if arena is not None:
        shown = np.vstack([shown, _corners(arena)])
    lower, upper = np.min(shown, axis=0), np.max(shown, axis=0)
    margin = radius + 0.05 * float(np.max(upper - lower))
    axes.margins(0.0)
    axes.update_datalim([lower - margin, upper + margin])
    axes.autoscale_view()
