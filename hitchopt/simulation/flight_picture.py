"""A simulated flight at a glance: from above, and errors and tensions over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.simulation.error_measures import tracking_errors
from hitchopt.simulation.simulate import Simulation

SIZE = (11.0, 5.0)
"""[in]"""

DOTS = 110


def save_picture(path: Path, simulation: Simulation) -> None:
    """Draw the flight.

    Parameters
    ----------
    path: of the png.
    simulation: of the flight.

    Raises
    ------
    OSError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(SIZE, dpi=DOTS, layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.1))
    _draw_plan(figure.add_subplot(grid[:, 0]), simulation)
    over_time: list[Any] = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    _draw_errors(over_time[0], simulation)
    _draw_tensions(over_time[1], simulation)
    _draw_tracking(over_time[2], simulation)
    for axes in over_time:
        axes.set_xlim(0.0, float(simulation.flight.record.t[-1]) or 1.0)
        axes.axvline(simulation.flight.duration, color="0.6", lw=0.8, ls="--")
        axes.grid(alpha=0.3)
    for axes in over_time[:2]:
        axes.tick_params(labelbottom=False)
    over_time[2].set_xlabel("t [s]; beyond the dashes: rest and pull test")
    figure.savefig(path, format="png")


def _draw_plan(axes: Any, simulation: Simulation) -> None:
    """Draw the cables as the flight began (pale) and as the plan ended, from above."""
    flight, errors = simulation.flight, simulation.errors
    film = flight.film
    if len(film.t):
        end = int(np.argmin(np.abs(film.t - flight.duration)))
        start = int(np.argmin(np.abs(film.t)))
        for frame, strength in ((start, 0.3), (end, 1.0)):
            for k in range(len(film.cables) - 1):
                cable = film.nodes[frame, film.cables[k] : film.cables[k + 1]]
                axes.plot(cable[:, 0], cable[:, 1], color=f"C{k % 10}", alpha=strength, lw=1.4)
                ends = cable[[0, -1]]
                axes.plot(ends[:, 0], ends[:, 1], "o", color="black", alpha=strength, ms=4)
    for c in range(errors.planned.shape[1]):
        told = errors.planned[:, c]
        found = flight.record.vertices[errors.rows, c]
        axes.plot(told[:, 0], told[:, 1], color="black", lw=0.8, ls=":")
        axes.plot(found[:, 0], found[:, 1], color="crimson", lw=0.9)
        axes.plot(told[-1:, 0], told[-1:, 1], "x", color="black", ms=6)
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    held = "every vertex holds" if simulation.outcome.hitched else "not hitched"
    if simulation.flight.linking is None:
        held = "not simulated to its end"
    axes.set_title(f"{held}; ×: the plan's vertices", fontsize=10)


def _draw_errors(axes: Any, simulation: Simulation) -> None:
    errors, team = simulation.errors, simulation.task.team
    for c, point in enumerate(team.layout.clasps):
        name = team.point_names[point]
        axes.plot(errors.t, 100.0 * errors.without_sag[:, c], lw=1.0, label=name)
    axes.set_ylabel("vertex error,\nsag off [cm]")
    if errors.t.size and len(team.layout.clasps) <= LABELLED:
        axes.legend(fontsize=8, ncols=3)


LABELLED = 6
"""Vertices that a legend has room for."""


def _draw_tensions(axes: Any, simulation: Simulation) -> None:
    record = simulation.flight.record
    axes.plot(record.t, record.tensions, lw=1.0)
    axes.set_ylabel("tension [N]")


def _draw_tracking(axes: Any, simulation: Simulation) -> None:
    tracking = 100.0 * tracking_errors(simulation.flight)
    axes.plot(simulation.flight.record.t[: len(tracking)], np.max(tracking, axis=-1), lw=1.0)
    axes.set_ylabel("farthest drone\nfrom setpoint [cm]")
