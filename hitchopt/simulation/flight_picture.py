"""Picture of a simulated flight: from above, and errors and tensions over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.simulation.error_measures import tracking_errors
from hitchopt.simulation.object_wires import placed
from hitchopt.simulation.simulate import Simulation
from hitchopt.view.house_colours import cable_colours

SIZE, DOTS = (11.0, 5.0), 110
"""Size of the picture [in], and its resolution [1/in]."""

LABELLED = 6
"""Largest number of vertices for which the legend has space."""


def save_picture(path: Path, simulation: Simulation) -> None:
    """Draw a flight.

    Parameters
    ----------
    path: png file.
    simulation: what is drawn.

    Raises
    ------
    OSError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    flight, errors = simulation.flight, simulation.errors
    record, team = flight.record, flight.task.team
    figure = Figure(SIZE, dpi=DOTS, layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.1))
    _draw_from_above(figure.add_subplot(grid[:, 0]), simulation)
    over_time: list[Any] = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    top, middle, bottom = over_time
    for c, point in enumerate(team.layout.clasps):
        name = team.point_names[point]
        top.plot(errors.t, 100.0 * errors.errors[:, c], lw=1.0, label=name)
    if errors.t.size and len(team.layout.clasps) <= LABELLED:
        top.legend(fontsize=8, ncols=3)
    middle.plot(record.t, record.tensions, lw=1.0)
    tracking = 100.0 * np.max(tracking_errors(flight), axis=-1)
    bottom.plot(record.t[: len(tracking)], tracking, lw=1.0)
    titles = "vertex error,\nsag included [cm]", "tension [N]", "farthest drone\nfrom setpoint [cm]"
    for axes, title in zip(over_time, titles, strict=True):
        axes.set_ylabel(title)
        axes.set_xlim(0.0, float(record.t[-1]) or 1.0)
        axes.axvline(flight.task.duration, color="0.6", lw=0.8, ls="--")
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=axes is bottom)
    bottom.set_xlabel("t [s]; beyond the dashes: rest and pull test")
    figure.savefig(path, format="png")


def _draw_from_above(axes: Any, simulation: Simulation) -> None:
    """Draw the cables as the flight began (pale) and as the plan ended, from above."""
    flight, errors = simulation.flight, simulation.errors
    film = flight.film
    colours = cable_colours(flight.task.team.robots)
    if len(film.t):
        for time, strength in ((0.0, 0.3), (flight.task.duration, 1.0)):
            frame = film.nodes[np.argmin(np.abs(film.t - time))]
            for rings in placed(film.wires, film.poses[np.argmin(np.abs(film.t - time))]):
                axes.plot(rings[..., 0].T, rings[..., 1].T, color="0.5", alpha=strength, lw=0.8)
            for k, cable in enumerate(np.split(frame, film.cables[1:-1])):
                axes.plot(cable[:, 0], cable[:, 1], color=colours[k], alpha=strength, lw=1.4)
                ends = cable[[0, -1]]
                axes.plot(ends[:, 0], ends[:, 1], "o", color="black", alpha=strength, ms=4)
    for c in range(errors.planned.shape[1]):
        planned = errors.planned[:, c]
        found = flight.record.vertices[errors.rows, c]
        axes.plot(planned[:, 0], planned[:, 1], color="black", lw=0.8, ls=":")
        axes.plot(found[:, 0], found[:, 1], color="crimson", lw=0.9)
        axes.plot(planned[-1:, 0], planned[-1:, 1], "x", color="black", ms=6)
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(f"{_ending(simulation)}; ×: the plan's vertices", fontsize=10)


def _ending(simulation: Simulation) -> str:
    """Return in words how a flight ended; a plan that releases its hitch is to end untied."""
    flight = simulation.flight
    if flight.linking is None:
        return "not simulated to its end"
    if flight.task.formed[-1]:
        return "every vertex holds" if simulation.outcome.hitched else "not hitched"
    return "not untied" if flight.linking.any() else "untied, as planned"
