"""Files of a simulated flight: a summary, tables over time, the recording and a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from hitchopt.motion.motion import Motion
from hitchopt.simulation.judgement import Simulation, Spread, tracking_errors, warnings
from hitchopt.simulation.settings import Settings
from hitchopt.storage.archive import RECORDING
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.values import Array
from hitchopt.view.painter import FEW, Shot, chosen_shots, draw_storyboard
from hitchopt.view.pictures import draw_phases
from hitchopt.view.scene import Scene, recorded_scene
from hitchopt.view.style import (
    DASHES,
    INK,
    LIMIT_COLOUR,
    cable_colours,
    facts,
    headline,
    new_figure,
    save_figure,
)

FORMAT = "hitchopt-simulation/1"

SUMMARY = "simulation.json"
VERTICES = "vertices.csv"
CABLES = "cables.csv"
DRONES = "drones.csv"
OBJECTS = "objects.csv"
PICTURE = "simulation.png"
CAMPAIGN = "campaign.json"
RUNS = "runs.csv"

OWNED = (SUMMARY, VERTICES, CABLES, DRONES, OBJECTS, RECORDING, PICTURE, CAMPAIGN, RUNS)
"""Names that belong to hitchopt in the directory of results; other files are never touched."""

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


def save_simulation(
    directory: Path | str, simulation: Simulation, motion: Motion, title: str = ""
) -> Path:
    """Write summary, tables, recording and picture, all of them or none; return the directory.

    Parameters
    ----------
    directory: where to.
    simulation: what is written.
    motion, title: the plan that was flown, for the picture.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    flight, errors = simulation.flight, simulation.errors
    record, team, cargo = flight.record, flight.task.team, flight.task.cargo
    rows, t = errors.rows, record.t
    tables: dict[str, tuple[str, Array, Iterable[object], dict[str, Array]]] = {
        VERTICES: ("vertex", errors.t, team.layout.clasps, {
            "x,y,z": record.vertices[rows],
            "planned_x,planned_y,planned_z": errors.planned,
            "height_error": errors.offsets[..., 2],
            "error": errors.errors,
            "error_without_sag": errors.without_sag,
            "bearing": record.bearing[rows],
        }),
        CABLES: ("cable", t, range(team.robots), {
            "tension": record.tensions, "peak": record.peak_tensions,
        }),
        DRONES: ("drone", t, team.drone_names, {
            "x,y,z": record.drones,
            "error": np.linalg.norm(record.drones - record.commanded, axis=-1),
            "thrust": record.thrusts,
            "saturated": record.saturated.astype(np.float64),
        }),
    }  # fmt: skip
    if cargo.objects:
        poses = {"x,y,z,qw,qx,qy,qz": record.poses, "touched": record.touched.astype(np.float64)}
        tables[OBJECTS] = ("object", t, cargo.names, poses)
    writers: dict[str, Writer] = {
        name: partial(_write_table, *parts) for name, parts in tables.items()
    }
    writers[RECORDING] = lambda path: np.savez_compressed(path, **vars(flight.film))
    writers[PICTURE] = lambda path: save_figure(drawn_flight(simulation, motion, title), path)
    writers[SUMMARY] = lambda path: write_strict_json(path, summary(simulation))
    return replace_files(directory, writers, OWNED, seal=SUMMARY)


def summary(simulation: Simulation) -> dict[str, Any]:
    """Return the figures of a flight, ready for JSON."""
    flight, outcome, errors = simulation.flight, simulation.outcome, simulation.errors
    record, team, run = flight.record, flight.task.team, simulation.run
    clasps = [team.point_names[p] for p in team.layout.clasps]
    drawn = {  # what was perturbed of an object, as it was flown with
        name: {"mass": body.mass, "friction": body.friction, "stood_at": body.at.tolist()}
        for name, body in flight.objects.items()
    }
    return {
        "format": FORMAT,
        "setpoints_sha256": flight.task.digest,
        "settings": settings_summary(simulation.settings),
        "warnings": list(warnings(flight.task, simulation.settings)),
        "position_loops": {name: gains.tolist() for name, gains in vars(flight.gains).items()},
        "compensation": {"cables_longer": flight.longer},
        "density": {"simulated": flight.density, "planned": team.cable_density},
        "verdict": outcome.verdict,
        "succeeded": outcome.succeeded,
        "hitched": outcome.hitched,
        "failures": [asdict(failure) for failure in outcome.failures],
        "clasps": [asdict(clasp) for clasp in outcome.clasps],
        "objects": [asdict(each) | drawn[each.name] for each in outcome.objects],
        "vertex_error": {
            "all": asdict(run.vertex_error),
            "resting": asdict(run.resting),
            "moving": asdict(run.moving),
            "all_without_sag": asdict(run.without_sag),
            **{name: asdict(Spread.of(errors.errors[:, c])) for c, name in enumerate(clasps)},
            "lost_share": errors.lost,
        },
        "tension": [
            {"cable": k, "mean": float(np.mean(tension)), "peak": float(np.max(peak))}
            for k, (tension, peak) in enumerate(
                zip(record.tensions.T, record.peak_tensions.T, strict=True)
            )
        ],
        "tracking_error": asdict(run.tracking),
        "largest_thrust": run.peak_thrust,
        "saturated_share": run.saturated,
        "duration": flight.task.duration,
        **({} if simulation.loss is None else {"loss": asdict(simulation.loss)}),
        "processor_seconds": simulation.processor,
        "pace": run.pace,
    }


def settings_summary(settings: Settings) -> dict[str, Any]:
    """Return the settings of a flight, ready for JSON, with the value of a default lag."""
    return {**asdict(settings), "lag": settings.lag}


def _write_table(
    kind: str, t: Array, names: Iterable[object], columns: dict[str, Array], path: Path
) -> None:
    """Write a table with one row per time and name.

    Parameters
    ----------
    kind: title of the names.
    t: (times,) [s]
    names: of drones, cables or vertices.
    columns: by title, (times, names); for several columns (times, names, columns).
    path: file, replaced if there is one.
    """
    values = np.concatenate([np.atleast_3d(column) for column in columns.values()], axis=-1)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["t", kind, *",".join(columns).split(",")])
        labels = [str(name) for name in names]
        for time, rows in zip(t.tolist(), values.tolist(), strict=True):
            for label, row in zip(labels, rows, strict=True):
                table.writerow([number(time), label, *map(number, row)])


def number(value: float, digits: int = 9) -> str:
    """Return a number in some significant digits; nothing for nan."""
    return "" if math.isnan(value) else f"{value:.{digits}g}"


def drawn_flight(simulation: Simulation, motion: Motion, title: str = "") -> Figure:
    """Return the picture of a flight: a storyboard, and errors and tensions over time.

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
    headline(figure, title, f"{facts(motion)}, simulated: {_ending(simulation)}")
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
    scene, shots = flight_scene(simulation, motion), []
    if scene is not None:  # the plan's moments that were reached, and the end of all
        end = float(scene.t[-1])
        shots = [shot for shot in chosen_shots(motion) if shot.time <= end + SAME_FRAME]
        if np.isfinite(simulation.flight.pulled):
            words = "after the pull test" if simulation.flight.task.formed[-1] else "at rest"
            shots = [*shots[: max(1, len(shots) - 1)], Shot(words, end, kept=True)]
    if scene is None or not shots:
        _draw_vertices(figure.add_subplot(place), simulation)
        return
    extent = float(np.linalg.norm(np.ptp(scene.drones, axis=(0, 1))))
    drawn = replace(scene, radius=float(np.clip(THICKNESS * extent, scene.radius, THICKEST)))
    alone = len(shots) > FEW or not simulation.errors.t.size
    parts = place.subgridspec(2 - alone, 1, height_ratios=(1.0,) if alone else (1.0, 1.25))
    draw_storyboard(parts[0], drawn, shots, (scene.t, scene.drones))
    if not alone:
        _draw_vertices(figure.add_subplot(parts[1]), simulation)


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
    first = "vertex error," if simulation.settings.preset.exact else "vertex error ± 1 to 2 cm,"
    titles = f"{first}\nsag included [cm]", "tension [N],\nplanned dashed"
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


def _draw_vertices(axes: Axes, simulation: Simulation) -> None:
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
