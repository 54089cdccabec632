"""Files of a simulated flight: a summary, tables over time, the recording and a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.simulation.error_measures import Spread
from hitchopt.simulation.flight_picture import save_picture
from hitchopt.simulation.simulate import Simulation
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.storage.archive import RECORDING
from hitchopt.storage.atomic import Writer, replace_files
from hitchopt.storage.strict_json import write_strict_json
from hitchopt.values import Array

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
    record, film, team = flight.record, flight.film, flight.task.team
    vertices: dict[str, Array] = {
        "x,y,z": record.vertices[errors.rows],
        "planned_x,planned_y,planned_z": errors.planned,
        "height_error": errors.offsets[..., 2],
        "error": errors.errors,
        "error_without_sag": errors.without_sag,
        "bearing": record.bearing[errors.rows],
    }
    cables: dict[str, Array] = {"tension": record.tensions, "peak": record.peak_tensions}
    drones: dict[str, Array] = {
        "x,y,z": record.drones,
        "error": np.linalg.norm(record.drones - record.commanded, axis=-1),
        "thrust": record.thrusts,
        "saturated": record.saturated.astype(np.float64),
    }
    clasps, robots = team.layout.clasps, range(team.robots)
    writers: dict[str, Writer] = {
        VERTICES: lambda path: write_table(path, "vertex", errors.t, clasps, vertices),
        CABLES: lambda path: write_table(path, "cable", record.t, robots, cables),
        DRONES: lambda path: write_table(path, "drone", record.t, team.drone_names, drones),
        RECORDING: lambda path: np.savez_compressed(path, **vars(film)),
        PICTURE: lambda path: save_picture(path, simulation, motion, title),
        **_object_table(simulation),
        SUMMARY: lambda path: write_strict_json(path, summary(simulation)),
    }
    return replace_files(directory, writers, OWNED, seal=SUMMARY)


def _object_table(simulation: Simulation) -> dict[str, Writer]:
    """Return the writer of the table of objects, if there are any."""
    record, cargo = simulation.flight.record, simulation.flight.task.cargo
    columns: dict[str, Array] = {
        "x,y,z,qw,qx,qy,qz": record.poses,
        "touched": record.touched.astype(np.float64),
    }
    if not cargo.objects:
        return {}
    return {OBJECTS: lambda path: write_table(path, "object", record.t, cargo.names, columns)}


def _drawn(body: SolidObject) -> dict[str, Any]:
    """Return what was perturbed of an object, as it was flown with."""
    return {"mass": body.mass, "friction": body.friction, "stood_at": body.at.tolist()}


def summary(simulation: Simulation) -> dict[str, Any]:
    """Return the figures of a flight, ready for JSON."""
    flight, outcome, errors = simulation.flight, simulation.outcome, simulation.errors
    record, team, run = flight.record, flight.task.team, simulation.run
    clasps = [team.point_names[p] for p in team.layout.clasps]
    return {
        "format": FORMAT,
        "setpoints_sha256": flight.task.digest,
        "settings": settings_summary(simulation.settings),
        "position_loops": {name: gains.tolist() for name, gains in vars(flight.gains).items()},
        "compensation": {"cables_longer": flight.longer},
        "density": {"simulated": flight.density, "planned": team.cable_density},
        "verdict": outcome.verdict,
        "succeeded": outcome.succeeded,
        "hitched": outcome.hitched,
        "failures": [asdict(failure) for failure in outcome.failures],
        "clasps": [asdict(clasp) for clasp in outcome.clasps],
        "objects": [asdict(each) | _drawn(flight.objects[each.name]) for each in outcome.objects],
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


def write_table(
    path: Path, kind: str, t: Array, names: Iterable[object], columns: dict[str, Array]
) -> None:
    """Write a table with one row per time and name.

    Parameters
    ----------
    path: file, replaced if there is one.
    kind: title of the names.
    t: (times,) [s]
    names: of drones, cables or vertices.
    columns: by title, (times, names); for several columns (times, names, columns).
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
