"""Files of an evaluation: table, vertices, cable shapes for the viewer, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchopt.errors import FileError
from hitchopt.flights.evaluation import Evaluation
from hitchopt.flights.vertices import through_gaps
from hitchopt.simulation.report import write_table
from hitchopt.storage.archive import PLAN, RECORDING
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.values import Array, check_choice
from hitchopt.view import style
from hitchopt.view.cables import CLASPS, POINTS
from hitchopt.view.pictures import draw_phases
from hitchopt.view.scene import scene_at

FORMAT = "hitchopt-evaluation/1"
SUMMARY, VERTICES = "evaluation.json", "vertices.csv"
LATEX, PICTURE = "evaluation.tex", "evaluation."
FOREIGN = (PLAN, "simulation.json")  # Files of directories with another vertices.csv
PICTURES = ("png", "svg", "pdf")  # Picture formats
# Files in the directory that hitchopt replaces; others are never touched
OWNED = (SUMMARY, VERTICES, LATEX, RECORDING, *(PICTURE + kind for kind in PICTURES))

# Width and height of the picture [inch], and widths of its columns
SIZE, WIDTHS = (13.0, 6.4), (1.35, 1.0)
MAX_NAMED, SNAPSHOT_TIME = 8, 0.05  # Most names in a legend; half width of a snapshot [s]


def save_evaluation(directory: Path, evaluation: Evaluation, format: str = "png") -> Path:
    """Write all files of an evaluation, or none; return the directory.

    Raises FileError if the directory cannot be written to, or holds a plan or a simulation, and
    InputError for an unknown format.
    """
    check_choice("format", format, PICTURES)
    for name in FOREIGN:
        if (directory / name).exists():
            raise FileError(f"{directory}: holds {name}; name a directory of its own for results")
    picture = drawn_evaluation(evaluation)
    writers: dict[str, Writer] = {
        VERTICES: partial(_write_vertices, evaluation),
        LATEX: lambda path: path.write_text(latex_table(evaluation), "utf-8", newline="\n"),
        RECORDING: lambda path: np.savez_compressed(path, **shapes(evaluation)),  # type: ignore[arg-type]
        PICTURE + format: lambda path: style.save_figure(picture, path),
        SUMMARY: lambda path: write_strict_json(path, summary(evaluation)),
    }
    return replace_files(directory, writers, OWNED, seal=SUMMARY)


def summary(evaluation: Evaluation) -> dict[str, Any]:
    """Return alignment, remarks and table, ready for JSON."""
    each = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(evaluation.alignment).items()
    }
    return {
        "format": FORMAT,
        "source": evaluation.flight.source,
        "recorded": evaluation.t[[0, -1]].tolist(),
        "alignment": {"offset": evaluation.alignment.offset, **each},
        "errors_of": "crossings" if evaluation.clasps is None else "clasps",
        "density": evaluation.density.tolist(),
        "remarks": list(evaluation.remarks),
        "table": [asdict(row) for row in evaluation.table],
    }


def _write_vertices(evaluation: Evaluation, path: Path) -> None:
    """Write a row per vertex and time at which the plan's hitch is taut."""
    points = evaluation.task.team.layout.clasps
    taut = np.isfinite(evaluation.planned[:, points[0], 0])
    columns = {"x,y,z": evaluation.vertices, "planned_x,planned_y,planned_z": evaluation.planned}
    columns |= {"error": evaluation.errors, "standard_error": evaluation.standard_errors}
    if evaluation.clasps is not None:
        columns["clasp_x,clasp_y,clasp_z"] = evaluation.clasps
    written = {name: values[taut][:, points] for name, values in columns.items()}
    write_table("vertex", points, evaluation.t[taut], written, path)


def shapes(evaluation: Evaluation) -> dict[str, Array]:
    """Return the cables over time for a ghost in the viewer.

    Shapes are the plan's, displaced with the measured drones and vertices.
    """
    t, task, layout = evaluation.t, evaluation.task, evaluation.task.team.layout
    scene = scene_at(evaluation.motion, np.clip(t, 0.0, task.duration))
    displacements, ends = (
        np.nan_to_num(through_gaps(t, off, t))
        for off in (
            evaluation.measured - evaluation.planned,
            evaluation.drones - evaluation.planned_drones,
        )
    )
    ends = ends.reshape(len(t), -1, 2, 3)
    knots = np.stack([np.interp(range(4), (0, 3), one) for one in np.eye(2)], axis=1) @ ends
    hitched = np.isfinite(evaluation.planned[..., 0]).any(axis=1)
    at_clasps = np.stack([displacements[:, layout.starts], displacements[:, layout.ends]], axis=2)
    knots[hitched, :, 1:3] = at_clasps[hitched]
    shares = [np.interp(range(POINTS), (0, *CLASPS, POINTS - 1), one) for one in np.eye(4)]
    nodes = scene.cables + np.einsum("jp,tkjx->tkpx", shares, knots)
    return {
        "t": t,
        "nodes": nodes.reshape(len(t), -1, 3).astype(np.float32),
        "cables": POINTS * np.arange(layout.robots + 1),
        "poses": scene.objects.astype(np.float32),
    }


def latex_table(evaluation: Evaluation) -> str:
    """Return the short table as a LaTeX tabular [mm], with dashes for missing values."""
    heads = ("mean", "std.", "max.", "std. error")
    lines = ["% Distances from the plan [mm]", r"\begin{tabular}{llrrrrr}"]
    lines.append(" & ".join(("of", "phase", *heads, "found")) + r" \\ \hline")
    for row in evaluation.short_table:
        lengths = [1e3 * x for x in (row.mean, row.std, row.max, row.standard_error)]
        cells = [f"{x:.1f}" if np.isfinite(x) else "--" for x in lengths]
        words = row.name, row.phase.replace("_", r"\_"), *cells, f"{row.found:.2f}"
        lines.append(" & ".join(words) + r" \\")
    return "\n".join([*lines, r"\end{tabular}", ""])


def drawn_evaluation(evaluation: Evaluation) -> Figure:
    """Return the picture: errors over time with their means, and the hitch from above."""
    figure = style.new_figure(SIZE)
    grid = figure.add_gridspec(2, 2, width_ratios=WIDTHS, height_ratios=(1.6, 1.0))
    top, bottom = (figure.add_subplot(grid[i, 0]) for i in range(2))
    team, t, points = evaluation.task.team, evaluation.t, evaluation.task.team.layout.clasps
    colours, summaries = style.cable_colours(team.robots), {}
    for row in evaluation.short_table:
        if row.phase == "all" and np.isfinite(row.mean):
            summaries[row.name] = f"{1e3 * row.mean:.0f} ± {1e3 * row.std:.0f} mm"
    for point in points.tolist():
        colour, name = colours[point % team.robots], team.point_names[point]
        off, error = (
            1e3 * each[:, point] for each in (evaluation.errors, evaluation.standard_errors)
        )
        top.fill_between(t, off - error, off + error, color=colour, alpha=0.25, lw=0)
        top.plot(
            t, off, color=colour, lw=1.2, label=f"{name}: {summaries.get(name, 'not measured')}"
        )
    for i, name in enumerate(team.drone_names):
        look: Any = {"ls": "-" if i % 2 == 0 else "--", "lw": 0.9, "color": colours[i // 2]}
        bottom.plot(t, 1e3 * evaluation.drone_errors[:, i], label=name, **look)
    kind = "crossing" if evaluation.clasps is None else "clasp"
    for axes, words in (
        (top, f"vertices to the plan [mm]\n({kind}s, ± standard error)"),
        (bottom, "drones to their\nsetpoints [mm]"),
    ):
        axes.set(ylabel=words, xlim=(t[0], t[-1]))
        style.from_zero(axes, 0.3)
        if len(points) <= MAX_NAMED:
            axes.legend(fontsize="small", ncols=4, frameon=False)
    top.tick_params(labelbottom=False)
    bottom.set_xlabel("t [s]")
    start, end = float(t[0]), float(t[-1])
    phases = [
        each.retimed(max(each.start, start), min(each.end, end))
        for each in evaluation.motion.overlapping(start, end)
    ]
    draw_phases([top, bottom], phases, end - start)
    _draw_from_above(figure.add_subplot(grid[:, 1]), evaluation, colours)
    words = f"vertices to the plan: {summaries.get('vertices', 'not measured')}"
    style.headline(figure, evaluation.flight.source, words)
    return figure


def _draw_from_above(axes: Axes, evaluation: Evaluation, colours: Sequence[str]) -> None:
    """Draw paths, and at the last time of a complete polygon both polygons and the markers."""
    team, measured = evaluation.task.team, evaluation.measured
    points, cloud = team.layout.clasps, evaluation.cloud
    for i in range(team.drones):
        axes.plot(*evaluation.drones[:, i, :2].T, color=colours[i // 2], lw=0.6, alpha=0.5)
    for point in points.tolist():
        axes.plot(*measured[:, point, :2].T, color=colours[point % team.robots], lw=0.8)
    complete = np.flatnonzero(np.isfinite(measured[:, points, 0]).all(axis=1))
    if len(complete):
        i, order = complete[-1], np.append(points, points[: team.layout.closed])
        plan, polygon = (x[i, order, :2].T for x in (evaluation.planned, measured))
        axes.plot(*plan, "--", color=style.LIMIT_COLOUR, label="planned")
        axes.plot(*polygon, color=style.INK, lw=1.4, label="measured")
        near = np.abs(cloud.t - evaluation.t[i]) < SNAPSHOT_TIME
        look: Any = {"s": 6, "color": "0.45", "zorder": 3, "label": "markers"}
        axes.scatter(*cloud.positions[near, :2].T, **look)
        axes.set_title(f"from above, t = {evaluation.t[i]:.2f} s", fontsize="medium")
        axes.legend(fontsize="small", frameon=False)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
