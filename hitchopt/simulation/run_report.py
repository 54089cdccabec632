"""A simulated flight as files: a summary, tables over time, the recording and a picture."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.export.atomic import Writer, replace_files
from hitchopt.export.strict_json import write_strict_json
from hitchopt.simulation.error_measures import Spread, tracking_errors
from hitchopt.simulation.flight_picture import save_picture
from hitchopt.simulation.simulate import Simulation
from hitchopt.simulation.simulation_settings import Settings

Array = NDArray[np.float64]

FORMAT = "hitchopt-simulation/1"

SUMMARY = "simulation.json"
VERTICES = "vertices.csv"
CABLES = "cables.csv"
DRONES = "drones.csv"
RECORDING = "recording.npz"
PICTURE = "simulation.png"
CAMPAIGN = "campaign.json"
RUNS = "runs.csv"

OWNED = (SUMMARY, VERTICES, CABLES, DRONES, RECORDING, PICTURE, CAMPAIGN, RUNS)
"""The names that are ours in the directory of results; nothing else there is touched."""

NUMBER = "%.9g"


def save_simulation(directory: Path | str, simulation: Simulation) -> Path:
    """Write summary, tables, recording and picture, all of them or none; return the directory.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    writers: dict[str, Writer] = {
        VERTICES: lambda path: _write_vertices(path, simulation),
        CABLES: lambda path: _write_cables(path, simulation),
        DRONES: lambda path: _write_drones(path, simulation),
        RECORDING: lambda path: _write_recording(path, simulation),
        PICTURE: lambda path: save_picture(path, simulation),
        SUMMARY: lambda path: write_strict_json(path, summary(simulation)),
    }
    return replace_files(directory, writers, OWNED, seal=SUMMARY)


def summary(simulation: Simulation) -> dict[str, Any]:
    """Return the flight in numbers, ready for JSON."""
    flight, outcome, errors = simulation.flight, simulation.outcome, simulation.errors
    record, team = flight.record, simulation.task.team
    tracking = tracking_errors(flight)
    clasps = [team.point_names[p] for p in team.layout.clasps]
    return {
        "format": FORMAT,
        "setpoints_sha256": simulation.task.digest,
        "settings": settings_summary(simulation.settings),
        "verdict": outcome.verdict,
        "succeeded": outcome.succeeded,
        "hitched": outcome.hitched,
        "failures": [asdict(failure) for failure in outcome.failures],
        "clasps": [{**asdict(clasp), "bears": clasp.bears} for clasp in outcome.clasps],
        "vertex_error": {
            "all": asdict(Spread.of(errors.errors)),
            "all_without_sag": asdict(Spread.of(errors.without_sag)),
            "moving_without_sag": asdict(Spread.of(errors.without_sag[errors.moving])),
            **{name: asdict(Spread.of(errors.errors[:, c])) for c, name in enumerate(clasps)},
            "lost_share": errors.lost,
        },
        "tension": [
            {
                "cable": k,
                "mean": float(np.mean(record.tensions[:, k])),
                "peak": float(np.max(record.peak_tensions[:, k])),
            }
            for k in range(team.robots)
        ],
        "tracking_error": asdict(Spread.of(tracking)),
        "largest_thrust": float(np.max(record.thrusts)),
        "saturated_share": float(np.mean(record.saturated)),
        "duration": flight.duration,
        "processor_seconds": simulation.processor,
        "pace": simulation.pace,
    }


def settings_summary(settings: Settings) -> dict[str, Any]:
    """Return how a flight was simulated, the values that were taken by default among it."""
    return {**asdict(settings), "lag": settings.lag}


def _write_vertices(path: Path, simulation: Simulation) -> None:
    errors, record, team = simulation.errors, simulation.flight.record, simulation.task.team
    names = [str(p) for p in team.layout.clasps]
    columns = (
        record.vertices[errors.rows],
        errors.planned,
        errors.sag[..., None],
        errors.errors[..., None],
        errors.without_sag[..., None],
        record.bearing[errors.rows][..., None],
    )
    header = "t,vertex,x,y,z,planned_x,planned_y,planned_z,sag,error,error_without_sag,bearing"
    write_table(path, header, errors.t, names, np.concatenate(columns, axis=-1))


def _write_cables(path: Path, simulation: Simulation) -> None:
    record = simulation.flight.record
    names = [str(k) for k in range(simulation.task.team.robots)]
    values = np.stack([record.tensions, record.peak_tensions], axis=-1)
    write_table(path, "t,cable,tension,peak", record.t, names, values)


def _write_drones(path: Path, simulation: Simulation) -> None:
    record = simulation.flight.record
    error = np.linalg.norm(record.drones - record.told, axis=-1)
    values = np.concatenate(
        [
            record.drones,
            error[..., None],
            record.thrusts[..., None],
            record.saturated[..., None].astype(np.float64),
        ],
        axis=-1,
    )
    names = list(simulation.task.team.drone_names)
    write_table(path, "t,drone,x,y,z,error,thrust,saturated", record.t, names, values)


def write_table(path: Path, header: str, t: Array, names: list[str], values: Array) -> None:
    """Write a row per time and name: t (times,), values (times, names, columns); nan is empty."""
    line = ",".join(["%s"] * values.shape[-1])
    rows = "".join(f"%s,{name},{line}\n" for name in names)
    stamped = np.concatenate(
        [np.broadcast_to(t[:, None, None], (*values.shape[:2], 1)), values], axis=-1
    )
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(header + "\n")
        for row in stamped.reshape(len(t), len(names) * stamped.shape[-1]):
            file.write(rows % tuple("" if math.isnan(x) else NUMBER % x for x in row.tolist()))


def _write_recording(path: Path, simulation: Simulation) -> None:
    film = simulation.flight.film
    with path.open("wb") as file:
        np.savez_compressed(file, t=film.t, nodes=film.nodes, cables=film.cables)
