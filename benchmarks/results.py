"""Measurements as tables and pictures."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from benchmarks.measure import OURS, RIVALS, Measurement
from benchmarks.morph import cable_clearance
from benchmarks.relaxed_clearance import HEADING, NOTE, clearance_text

COLUMNS = {
    "solver": "",
    "kind": "",
    "robots": "d",
    "status": "",
    "imports": ".2f",
    "cold": ".2f",
    "first": ".2f",
    "second": ".2f",
    "again": ".4f",
    "certify": ".2f",
    "sharing": ".2f",
    "write": ".2f",
    "csv": ".2f",
    "flight": ".3f",
    "kept": ".3f",
    "peak": ".0f",
    "excess": ".2%",
    "rate": ".0f",
}
"""Shown, and how; a None stays empty."""


def best_time(measurement: Measurement) -> float | None:
    """Return the time of a solve without what is done once in a process [s]."""
    return measurement.first if measurement.second is None else measurement.second


def slope(measurements: Sequence[Measurement], name: str) -> float:
    """Return the log-log slope of a column over n, by least squares."""
    points = [(m.robots, getattr(m, name)) for m in measurements if getattr(m, name) is not None]
    if len(points) < 2:
        return float("nan")
    x, y = np.log(np.array(points, dtype=np.float64)).T
    return float(np.polyfit(x, y, 1)[0])


def row(measurement: Measurement) -> list[str]:
    """Return the shown columns of a measurement, and the clearance that its plan keeps."""
    values = asdict(measurement)
    shown = [
        "" if values[name] is None else format(values[name], how) for name, how in COLUMNS.items()
    ]
    return [*shown, clearance_text(cable_clearance(measurement.robots))]


def markdown(measurements: Sequence[Measurement]) -> list[str]:
    """Return the lines of a table."""
    heads = [*COLUMNS, HEADING]
    lines = [" | ".join(heads), " | ".join(["---"] * len(heads))]
    lines += [" | ".join(row(measurement)) for measurement in measurements]
    return [*(f"| {line} |" for line in lines), "", f"{NOTE}."]


def write_csv(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write all that was measured."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Measurement)])
        writer.writeheader()
        writer.writerows(asdict(measurement) for measurement in measurements)


def draw(path: Path, measurements: Sequence[Measurement]) -> None:
    """Draw the times of all solves over n; those that broke a limit or failed hollow."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for solver in (*OURS, *RIVALS):
        timed = [(m, best_time(m)) for m in measurements if m.solver == solver]
        points = sorted(
            (m.robots, seconds, m.status == "solved") for m, seconds in timed if seconds is not None
        )
        if not points:
            continue
        n, seconds, solved = (np.array(column) for column in zip(*points, strict=True))
        (line,) = axes.loglog(n, seconds, "-" if solver in OURS else ":", label=solver)
        axes.plot(n[solved], seconds[solved], "o", color=line.get_color())
        axes.plot(n[~solved], seconds[~solved], "o", color=line.get_color(), fillstyle="none")
    axes.set_xlabel("robots n")
    axes.set_ylabel("time of a solve [s]")
    axes.set_title("filled: every limit kept at all samples; hollow: broken, or failed by then")
    axes.title.set_fontsize(9)
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)
