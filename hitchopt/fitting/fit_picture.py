"""Picture of a fit: what encloses the object, what grips it, and what it rests on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from hitchopt.errors import InfeasibleError
from hitchopt.fitting.fit import Fit
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.holding.capacity import Capacity
from hitchopt.holding.grip_statics import Grip
from hitchopt.objects import Section
from hitchopt.values import Array
from hitchopt.view.house_colours import COLOURS
from hitchopt.view.style import LIMIT_COLOUR, new_figure, save_figure

SIZE = (12.0, 4.6)
"""Width and height [inch]."""

ARC_POINTS = 40
"""Points of a drawn arc."""


def draw_fit(fit: Fit) -> Figure:
    """Return the picture."""
    figure = new_figure(SIZE)
    axes = figure.subplots(1, 3)
    holding = fit.holding
    for each in axes:
        _draw_section(each, fit.section)
        each.set_aspect("equal")
        each.set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    _draw_hitch(axes[0], fit, fit.enclosing)
    axes[0].set_title(f"enclose: n = {holding.robots}, L = {holding.cable_length:.2f} m")
    if isinstance(holding.grip, Grip):
        _draw_grip(axes[1], holding.grip)
    axes[1].set_title(_held("grip", holding.grip_capacity))
    if not isinstance(holding.rest, InfeasibleError):
        _draw_hitch(axes[2], fit, holding.rest)
    axes[2].set_title(_held("rest", holding.rest_capacity))
    return figure


def save_fit_picture(path: Path, fit: Fit) -> None:
    """Draw the picture and write it as a PNG.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_figure(draw_fit(fit), path)


def _held(by: str, capacity: Capacity) -> str:
    if capacity.mass == 0.0:
        return f"{by}: nothing ({capacity.binding})"
    return f"{by}: {1e3 * capacity.mass:.0f} g ({capacity.binding} binds)"


def _draw_section(axes: Axes, section: Section) -> None:
    style: dict[str, Any] = {"facecolor": "0.88", "edgecolor": "0.55", "linewidth": 0.8}
    if section.radius is not None:
        axes.add_patch(Circle((0.0, 0.0), section.radius, **style))
    else:
        axes.add_patch(Polygon(section.core, **style))


def _draw_hitch(axes: Axes, fit: Fit, polygon: ConvexPolygon) -> None:
    """Draw the hitch of a polygon with the legs that keep drones well apart."""
    holding, task = fit.holding, fit.holding.task
    team = Team(holding.robots, holding.cable_length, tension=task.tension, quadrotor=task.kind)
    limits, separation = task.requirements.limits, task.requirements.separation
    try:
        hitch = Hitch.spread(team, polygon, limits=limits, separation=separation)
    except InfeasibleError:
        return
    p = hitch.vertices
    drones = hitch.drones.reshape(-1, 2, 3)
    ends = np.stack([p, np.roll(p, -1, axis=0)], axis=1)
    paths = [np.stack([drones[k, 0], *ends[k], drones[k, 1]])[:, :2] for k in range(holding.robots)]
    _draw_cables(axes, paths, p[:, :2])


def _draw_grip(axes: Axes, grip: Grip) -> None:
    paths = []
    for k in range(len(grip.vertices)):
        onward = grip.vertices[(k + 1) % len(grip.vertices)]
        ends = grip.drones[k, 0, :2], grip.drones[k, 1, :2]
        path = [ends[0][None], grip.vertices[k, None, :2], _arc(grip, k), onward[None, :2]]
        paths.append(np.concatenate([*path, ends[1][None]]))
    _draw_cables(axes, paths, grip.vertices[:, :2])


def _arc(grip: Grip, k: int) -> Array:
    """Return points (points, 2) [m] along the arc of cable k on the section."""
    a = grip.wraps.leaving[k]
    turns = grip.wraps.angles[k] * np.linspace(0.0, 1.0, ARC_POINTS)
    normals = np.arctan2(a[0], -a[1]) - turns  # outward, on the left of the cable
    out = np.column_stack([np.cos(normals), np.sin(normals)])
    core = grip.section.core
    touched = core[np.argmax(out @ core.T, axis=1)] + grip.section.rounding * out
    first, last = grip.wraps.contacts[k]
    return np.concatenate([first[None], touched, last[None]])


def _draw_cables(axes: Axes, paths: list[Array], vertices: Array) -> None:
    for k, path in enumerate(paths):
        axes.plot(*path.T, color=COLOURS[k % len(COLOURS)], linewidth=1.4)
        axes.plot(*path[[0, -1]].T, "o", color=COLOURS[k % len(COLOURS)], markersize=7)
    axes.plot(*vertices.T, "o", color=LIMIT_COLOUR, markersize=3)
