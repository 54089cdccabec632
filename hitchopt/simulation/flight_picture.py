"""Picture of a simulated flight: a storyboard, and errors and tensions over time."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from hitchopt.motion.motion import Motion
from hitchopt.simulation.error_measures import tracking_errors
from hitchopt.simulation.simulate import Simulation
from hitchopt.view.ghost_scene import recorded_scene
from hitchopt.view.house_colours import cable_colours, facts
from hitchopt.view.scene import Scene
from hitchopt.view.storyboard import FEW, Shot, chosen_shots, draw_storyboard
from hitchopt.view.style import DASHES, INK, LIMIT_COLOUR, new_figure, save_figure
from hitchopt.view.time_plots import draw_phases

SIZE, WIDTHS = (13.0, 7.2), (1.25, 1.0)
"""Width and height [inch], and widths of storyboard and plots: those of a plan's summary."""

LABELLED = 6
"""Largest number of vertices for which the legend has space."""

THICKNESS, THICKEST = 0.005, 0.02
"""Radius of a drawn rope as a share of the flight's extent, and the largest one [m]."""

ELSE_WRONG = ("touch", "dropped", "misplaced", "caught")
"""Kinds of failures of flights that may end hitched, or untied, as planned."""

SAME_FRAME = 0.1
"""Largest distance in time from a shot to a frame that shows it [s]."""


def save_picture(path: Path, simulation: Simulation, motion: Motion, title: str = "") -> None:
    """Write the picture of a flight to a png file; arguments are those of ``drawn_flight``.

    Raises
    ------
    OSError: the file cannot be written.
    """
    save_figure(drawn_flight(simulation, motion, title), path)


def drawn_flight(simulation: Simulation, motion: Motion, title: str = "") -> Figure:
    """Return the picture of a flight.

    Parameters
    ----------
    simulation: what is drawn.
    motion, title: the plan that was flown.
    """
    figure = new_figure(SIZE)
    grid = figure.add_gridspec(3, 2, width_ratios=WIDTHS)
    _draw_left(figure, grid[:, 0], simulation, motion)
    plots = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    _draw_over_time(plots, simulation, motion)
    name = textwrap.shorten(title, 100, placeholder=" …")
    said = f"{facts(motion)}, simulated: {_ending(simulation)}"
    figure.suptitle(f"{name}\n{said}".strip(), fontsize="large", parse_math=False)
    return figure


def flight_scene(simulation: Simulation, motion: Motion) -> Scene | None:
    """Return the scene of a flight of a plan; None if it ended before there was one."""
    film = simulation.flight.film
    if np.sum(film.t >= 0.0) < 2:
        return None
    return recorded_scene(motion, film.t, film.nodes, film.cables, film.poses)


def _draw_left(
    figure: Figure, place: SubplotSpec, simulation: Simulation, motion: Motion
) -> None:  # fmt: skip
    """Draw the storyboard, and the vertices from above where few moments leave space."""
    scene = flight_scene(simulation, motion)
    shots = () if scene is None else _shots(simulation, motion, float(scene.t[-1]))
    if scene is None or not shots:
        _draw_vertices(figure.add_subplot(place), simulation)
        return
    extent = float(np.linalg.norm(np.ptp(scene.drones, axis=(0, 1))))
    drawn = replace(scene, radius=float(np.clip(THICKNESS * extent, scene.radius, THICKEST)))
    flown = scene.t, scene.drones
    if len(shots) > FEW or not simulation.errors.t.size:
        draw_storyboard(place, drawn, shots, flown)
        return
    parts = place.subgridspec(2, 1, height_ratios=(1.0, 1.25))
    draw_storyboard(parts[0], drawn, shots, flown)
    _draw_vertices(figure.add_subplot(parts[1]), simulation)


def _shots(simulation: Simulation, motion: Motion, end: float) -> Sequence[Shot]:
    """Return the plan's moments that were reached, and the end of all."""
    shots = [shot for shot in chosen_shots(motion) if shot.time <= end + SAME_FRAME]
    if np.isfinite(simulation.flight.pulled):
        words = "after the pull test" if simulation.flight.task.formed[-1] else "at rest"
        shots = [*shots[: max(1, len(shots) - 1)], Shot(words, end, kept=True)]
    return shots


def _draw_over_time(plots: Sequence[Axes], simulation: Simulation, motion: Motion) -> None:
    """Draw errors of vertices, tensions and errors of drones."""
    flight, errors = simulation.flight, simulation.errors
    record, task = flight.record, flight.task
    team, end = task.team, float(record.t[-1]) or 1.0
    colours = cable_colours(team.robots)
    top, middle, bottom = plots
    for c, point in enumerate(team.layout.clasps):
        colour = colours[int(point) % team.robots]
        values = 100.0 * errors.errors[:, c]
        top.plot(errors.t, values, color=colour, lw=1.2, label=team.point_names[point])
    if errors.t.size and len(team.layout.clasps) <= LABELLED:
        top.legend(fontsize="small", ncols=3, frameon=False)
    for k, colour in enumerate(colours):
        middle.plot(record.t, record.tensions[:, k], color=colour, lw=1.2)
    planned = np.where(task.formed[:, None], task.tensions, np.nan)
    for tension in np.unique(planned.T, axis=0):
        middle.plot(task.t - task.t[0], tension, color=LIMIT_COLOUR, lw=1.2, ls=DASHES)
    tracking = 100.0 * np.max(tracking_errors(flight), axis=-1)
    bottom.plot(record.t[: len(tracking)], tracking, color=INK, lw=1.2)
    titles = "vertex error,\nsag included [cm]", "tension [N],\nplanned dashed"
    for axes, words in zip(plots, (*titles, "farthest drone\nfrom setpoint [cm]"), strict=True):
        axes.set_ylabel(words)
        axes.set_xlim(0.0, end)
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="y", color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(labelbottom=axes is bottom)
        if end > task.duration:
            axes.axvspan(task.duration, end, facecolor="none", edgecolor="0.8", hatch="////", lw=0)
    draw_phases(plots, motion.phases, end)
    bottom.set_xlabel("t [s]; hatched: rest and pull test")


def _draw_vertices(axes: Any, simulation: Simulation) -> None:
    """Draw the vertices from above: as planned and as they were."""
    flight, errors = simulation.flight, simulation.errors
    colours = cable_colours(flight.task.team.robots)
    for c, point in enumerate(flight.task.team.layout.clasps):
        planned = errors.planned[:, c]
        found = flight.record.vertices[errors.rows, c]
        axes.plot(found[:, 0], found[:, 1], color=colours[int(point) % len(colours)], lw=1.4)
        axes.plot(planned[:, 0], planned[:, 1], color=INK, lw=0.9, ls=":")
        axes.plot(planned[-1:, 0], planned[-1:, 1], "x", color=INK, ms=6)
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title("vertices from above; dotted: planned, ×: the end of the plan", fontsize="small")


def _ending(simulation: Simulation) -> str:
    """Return in words how a flight ended; a plan that releases its hitch is to end untied."""
    flight = simulation.flight
    if flight.linking is None:
        return "not simulated to its end"
    if flight.task.formed[-1]:
        words = "every vertex holds" if simulation.outcome.hitched else "not hitched"
    else:
        words = "not untied" if flight.linking.any() else "untied, as planned"
    wrong = [each.words for each in simulation.outcome.failures if each.kind in ELSE_WRONG]
    return f"{words}, but {wrong[0]}" if wrong else words
