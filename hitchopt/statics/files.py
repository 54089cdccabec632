"""Files and pictures of what settles, of estimated teams, and of fits."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Polygon

from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.directory import STATICS, STATICS_PICTURE
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Quadrotor, Team
from hitchopt.holding.capacity import Capacity
from hitchopt.holding.grip import Grip
from hitchopt.objects import Section
from hitchopt.statics.calibrate import Calibration, Estimate
from hitchopt.statics.fit import GRIP, REST, Fit
from hitchopt.statics.settle import Settled
from hitchopt.statics.tolerance import Tolerance
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.values import Array
from hitchopt.view.style import COLOURS, DASHES, INK, LIMIT_COLOUR, new_figure, save_figure

STATICS_SIZE = (10.0, 4.8)
"""Width and height [inch]."""

MOST_CURVES = 12
"""Cables whose tensions are drawn one by one; of larger teams all are one band."""

DRAWN_TIMES = 3
"""Times at which vertices are drawn: the first, the middle and the last one."""


def draw_statics(settled: Settled, ranges: Tolerance | None) -> Figure:
    """Return the picture."""
    figure = new_figure(STATICS_SIZE)
    left, right = figure.subplots(1, 2)
    _draw_tensions(left, settled, ranges)
    _draw_vertices(right, settled, ranges)
    return figure


def _draw_tensions(axes: Axes, settled: Settled, ranges: Tolerance | None) -> None:
    t, count = settled.t, settled.tensions.shape[-1]
    marker = "o" if len(t) == 1 else None
    limits = None if ranges is None else ranges.tensions
    if limits is not None:
        low, high = np.min(limits[..., 0], axis=1), np.max(limits[..., 1], axis=1)
        finite = np.where(np.isfinite(high), high, 2.0 * np.max(settled.tensions))
        words = f"any cable, for errors of {_error_words(ranges)}"
        axes.fill_between(t, low, finite, color="0.87", label=words, zorder=1)
    if count <= MOST_CURVES:
        for k in range(count):
            axes.plot(
                t, settled.tensions[:, k], color=COLOURS[k % len(COLOURS)], marker=marker,
                linewidth=1.2, zorder=3, label="at rest" if k == 0 else None,
            )  # fmt: skip
    else:
        spread = np.min(settled.tensions, axis=1), np.max(settled.tensions, axis=1)
        axes.fill_between(t, *spread, color=COLOURS[0], label="at rest", zorder=3)
    axes.plot(t, settled.planned_tensions, color=INK, linestyle=DASHES, linewidth=0.8, zorder=2)
    axes.plot([], [], color=INK, linestyle=DASHES, linewidth=0.8, label="planned")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("t [s]")
    axes.set_ylabel("tension [N]")
    axes.legend(frameon=False, fontsize="small")


def _draw_vertices(axes: Axes, settled: Settled, ranges: Tolerance | None) -> None:
    times = np.unique(np.linspace(0, len(settled.t) - 1, DRAWN_TIMES).round().astype(np.intp))
    layout = settled.team.layout
    for colour, i in zip(COLOURS, times, strict=False):
        ring = np.append(np.arange(layout.points), 0) if layout.closed else np.arange(layout.points)
        planned, found = settled.planned_vertices[i], settled.vertices[i]
        axes.plot(*planned[ring, :2].T, color=INK, linestyle=DASHES, linewidth=0.8)
        words = f"t = {settled.t[i]:.2f} s"
        axes.plot(*found[ring, :2].T, color=colour, marker=".", linewidth=1.2, label=words)
        axes.plot(*settled.drones[i, :, :2].T, color=colour, marker="x", linestyle="none", ms=4)
        band = settled.rests[i, :, :, :2]
        if np.ptp(settled.band[i]) > 0.0:
            for number, ends in enumerate(np.swapaxes(band, 0, 1)):
                label = f"band of rest, t = {settled.t[i]:.2f} s" if number == 0 else None
                axes.plot(*ends.T, color=colour, linewidth=4.0, alpha=0.35, label=label)
        if ranges is not None:
            for centre, shape in zip(found, ranges.ellipsoids[i], strict=True):
                axes.add_patch(_ellipse(centre, shape, colour))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(frameon=False, fontsize="small")


def _ellipse(centre: Array, shape: Array, colour: str) -> Ellipse:
    """Return the outline of an ellipsoid (3, 3) [m²] as seen from above."""
    sizes, directions = np.linalg.eigh(shape[:2, :2])
    width, height = 2.0 * np.sqrt(np.maximum(sizes, 0.0))
    angle = float(np.degrees(np.arctan2(directions[1, 0], directions[0, 0])))
    return Ellipse(
        (centre[0], centre[1]), width, height, angle=angle, facecolor=colour, alpha=0.35,
        edgecolor=colour,
    )  # fmt: skip


def _error_words(ranges: Tolerance | None) -> str:
    """Return the sizes of the errors in words."""
    if ranges is None:
        return ""
    units = {"cable": "m of cable", "position": "m of position", "force": "N"}
    sizes = vars(ranges.errors).items()
    return ", ".join(f"{s.words} {units[name]}" for name, s in sizes if s.bound or s.deviation)


STATICS_FORMAT = "hitchopt-statics/1"


def save_statics(directory: Path, settled: Settled, ranges: Tolerance | None) -> Path:
    """Write what settles, and its ranges if there are any; return the directory.

    Parameters
    ----------
    directory: that of the plan; only files of these two names are replaced.
    settled: samples (S,), one per time.
    ranges: at the same times; None for no errors.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    content = statics_content(settled, ranges)
    writers = {
        STATICS_PICTURE: lambda path: save_figure(draw_statics(settled, ranges), path),
        STATICS: lambda path: write_strict_json(path, content),
    }
    return replace_files(directory, writers, tuple(writers), seal=STATICS)


def statics_content(settled: Settled, ranges: Tolerance | None) -> dict[str, Any]:
    """Return what statics.json says: lists over the times ``t``, in SI units.

    ``band`` of a vertex is how far outside of its plan it can rest with friction, least and most;
    an end without rest is null.
    """
    team = settled.team
    cables = {
        "planned_tension": settled.planned_tensions,
        "tension": settled.tensions,
        "slack": settled.slack,
    }
    vertices = {
        "planned": settled.planned_vertices,
        "position": settled.vertices,
        "band": settled.band,
    }
    drones = {"planned": settled.planned_drones, "position": settled.drones}
    content: dict[str, Any] = {
        "format": STATICS_FORMAT,
        "t": settled.t.tolist(),
        "slack_cables": list(settled.slack_cables),
        "loose_clasps": list(settled.loose_clasps),
        "force_residual": float(settled.force_residual.max()),
        "length_residual": float(settled.length_residual.max()),
    }
    if ranges is not None:
        content["errors"] = {name: vars(size) for name, size in vars(ranges.errors).items()}
        content["may_be_slack"] = list(ranges.slack_cables)
        content["tension_remainder"] = ranges.tension_remainders.tolist()
        content["vertex_remainder"] = ranges.vertex_remainders.tolist()
        cables |= {"smallest": ranges.tensions[..., 0], "largest": ranges.tensions[..., 1]}
        vertices |= {"half_widths": ranges.vertex_halves, "radius": ranges.radii}
    names = [f"c{k}" for k in range(team.robots)]
    return {
        **content,
        "cables": _rows(names, cables),
        "vertices": _rows(team.point_names, vertices),
        "drones": _rows(team.drone_names, drones),
    }


def _rows(names: Sequence[str], columns: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what is said of each item, from arrays (S, items, …)."""
    return [
        {"name": name, **{key: values[:, k].tolist() for key, values in columns.items()}}
        for k, name in enumerate(names)
    ]


def save_team(path: Path, calibration: Calibration) -> None:
    """Write the block ``team:`` with the estimates; comments state their standard errors.

    What the recording does not determine is as in the plan.

    Raises
    ------
    FileError: the file cannot be written.
    """
    try:
        path.write_text(team_text(calibration), encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error}") from error


def team_text(calibration: Calibration) -> str:
    """Return the block ``team:`` in YAML."""
    team, friction = calibration.task.team, calibration.friction
    names = [field.name for field in fields(Team) if field.name != "quadrotor"]
    values = {name: _yaml(getattr(team, name)) for name in names}
    errors = ", ".join(f"{one.error:.1g}" for one in calibration.lengths)
    lengths = ", ".join(f"{one.value:.4f}" for one in calibration.lengths)
    values["cable_length"] = f"[{lengths}]  # ± {errors} m"
    values["cable_density"] = f"{_yaml(calibration.density)}  # as assumed"
    values["cable_friction"] = f"{_yaml(team.cable_friction)}  # of the plan: not determined"
    if friction.known:
        values["cable_friction"] = f"{friction.value:.3f}  # ± {friction.error:.1g}"
    values["quadrotor"] = _quadrotors(team.quadrotor, calibration.stiffness)
    return "\n".join(["team:", *(f"  {name}: {text}" for name, text in values.items())]) + "\n"


def _quadrotors(kinds: Sequence[Quadrotor], stiffness: Sequence[Estimate]) -> str:
    """Return one kind where all robots have the same, else a list."""
    texts, remarks = [], []
    for kind, estimate in zip(kinds, stiffness, strict=True):
        entries = {field.name: _yaml(getattr(kind, field.name)) for field in fields(Quadrotor)}
        if estimate.known:
            entries["stiffness"] = f"{estimate.value:.3g}"
        texts.append("{" + ", ".join(f"{name}: {text}" for name, text in entries.items()) + "}")
        known = f"± {estimate.error:.1g} N/m" if estimate.known else "of the plan: not determined"
        remarks.append(f"  # stiffness {known}")
    if len(set(texts)) == 1:
        return texts[0] + remarks[0]
    return "".join(f"\n    - {a}{b}" for a, b in zip(texts, remarks, strict=True))


def _yaml(value: object) -> str:
    """Return a value in YAML."""
    return json.dumps(value, default=lambda array: np.round(array, 9).tolist())


FLIGHT_SIZE = (11.0, 5.0)
"""Width and height [inch]."""

LABELLED = 12
"""Largest number of curves for which a legend has space."""


def save_calibration_picture(path: Path, calibration: Calibration) -> None:
    """Draw where drones and vertices were and should have been, and how far they were off.

    Raises
    ------
    FileError: the file cannot be written.
    """
    task, recording, found = calibration.task, calibration.recording, calibration.comparison
    figure = new_figure(FLIGHT_SIZE)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.1))
    above = figure.add_subplot(grid[:, 0])
    for k in range(task.team.drones):
        above.plot(*task.setpoints.positions[:, k, :2].T, color="0.75", lw=0.8)
        above.plot(*recording.drones[:, k, :2].T, color="0.35", lw=0.8)
    seen = np.isfinite(found.vertices)
    layout, last = task.team.layout, np.flatnonzero(seen.all(axis=1))[-1:]
    for i in last:
        for k in range(task.team.robots):
            ends = recording.vertices[i, [layout.starts[k], layout.ends[k]]]
            line = np.vstack([recording.drones[i, 2 * k], ends, recording.drones[i, 2 * k + 1]])
            above.plot(line[:, 0], line[:, 1], "o-", color=f"C{k % 10}", lw=0.8, ms=3, alpha=0.5)
    for p, name in enumerate(task.team.point_names):
        planned = task.vertices[task.formed][:, p]
        above.plot(planned[:, 0], planned[:, 1], color="black", lw=0.9, ls=":")
        above.plot(*recording.vertices[seen[:, p], p, :2].T, color=f"C{p % 10}", lw=1.2)
        above.text(float(planned[-1, 0]), float(planned[-1, 1]), name, fontsize=8)
    above.set(
        xlabel="x [m]",
        ylabel="y [m]",
        title="recorded, cables at the end; dotted and pale: the plan",
    )
    above.set_aspect("equal", "datalim")
    for row, errors, title in (
        (0, found.vertices, "vertex error [cm]"),
        (1, found.drones, "drone to set point [cm]"),
    ):
        axes = figure.add_subplot(grid[row, 1])
        names = task.team.drone_names if row else task.team.point_names
        axes.plot(found.t, 100.0 * errors, lw=0.9, label=names)
        if len(names) <= LABELLED:
            axes.legend(fontsize=7, ncols=3)
        axes.set(ylabel=title, xlabel="t [s]" if row else "")
        axes.grid(alpha=0.3)
    try:
        save_figure(figure, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error}") from error


FIT_SIZE = (12.0, 4.6)
"""Width and height [inch]."""

ARC_POINTS = 40
"""Points of a drawn arc."""


def draw_fit(fit: Fit) -> Figure:
    """Return the picture."""
    figure = new_figure(FIT_SIZE)
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


FIT_FORMAT = "hitchopt-fit/1"


def save_fit(directory: Path, fit: Fit) -> None:
    """Write ``fit.json`` and ``fit.png`` to a directory, which is made if need be.

    Raises
    ------
    OSError: a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    write_strict_json(directory / "fit.json", fit_as_json(fit))
    save_figure(draw_fit(fit), directory / "fit.png")


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """Return the content of ``fit.json``: polygons in metres, masses with what binds."""
    holding, task = fit.holding, fit.holding.task
    content: dict[str, Any] = {
        "format": FIT_FORMAT,
        "notes": list(fit.notes),
        "robots": holding.robots,
        "cable_length": holding.cable_length,
        "tension": task.tension,
        "clearance": task.clearance,
        "friction": task.friction,
        "enclosing": holding.enclosing.vertices.tolist(),
        "grip": None,
        "rest": None,
    }
    if isinstance(holding.grip, Grip):
        grip = holding.grip
        content["grip"] = {
            "polygon": grip.vertices[:, :2].tolist(),
            "wraps_deg": np.degrees(grip.wraps.angles).tolist(),
            "legs": grip.legs[:, 0].tolist(),
            "slip_load": float(grip.slip_load(task.friction)),
        }
    if not isinstance(holding.rest, InfeasibleError):
        content["rest"] = {"polygon": holding.rest.vertices.tolist()}
    content["largest_mass"] = {
        by: {str(n): _capacity(each) for n, each in fit.capacities(by).items()}
        for by in (GRIP, REST)
    }
    return content


def _capacity(found: Capacity | InfeasibleError) -> dict[str, Any]:
    if isinstance(found, InfeasibleError):
        broken = found.violations[0]
        return {"mass": 0.0, "limit": broken.constraint, "suggested change": broken.remedy}
    return {"mass": found.mass, "limit": found.binding, "suggested change": found.suggested}
