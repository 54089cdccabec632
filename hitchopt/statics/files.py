"""Files and pictures of hitches at rest, of calibrated teams, and of fits."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from hitchopt.errors import InfeasibleError
from hitchopt.exports.directory import STATICS, STATICS_PICTURE
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Team
from hitchopt.hitch.holding import Grip
from hitchopt.statics.calibrate import Calibration
from hitchopt.statics.fit import GRIP, REST, Fit
from hitchopt.statics.settle import Settled
from hitchopt.statics.tolerance import Tolerance
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.view.style import COLOURS, DASHES, INK, LIMIT_COLOUR, new_figure, save_figure

STATICS_FORMAT, FIT_FORMAT = "hitchopt-statics/1", "hitchopt-fit/1"

# Widths and heights [inch]
STATICS_SIZE, FIT_SIZE = (10.0, 4.8), (12.0, 4.6)

# Lines of the plan, and points of a circle
PLANNED: dict[str, Any] = {"color": INK, "linestyle": DASHES, "linewidth": 0.8}
CIRCLE = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 121)).view(np.float64).reshape(-1, 2)

DRAWN_TIMES = 3  # Times at which vertices are drawn


def save_statics(directory: Path, settled: Settled, ranges: Tolerance | None) -> Path:
    """Write a hitch at rest at times (S,), and its ranges if any, to a plan's directory.

    Only files of these two names are replaced; FileError if it cannot be written to.
    """
    content = statics_content(settled, ranges)
    writers = {
        STATICS_PICTURE: lambda path: save_figure(draw_statics(settled, ranges), path),
        STATICS: lambda path: write_strict_json(path, content),
    }
    return replace_files(directory, writers, tuple(writers), seal=STATICS)


def statics_content(settled: Settled, ranges: Tolerance | None) -> dict[str, Any]:
    """Return the content of statics.json: lists over the times ``t``, in SI units.

    ``band`` of a vertex is the range of its rest outside of its plan with friction; an end without
    rest is null.
    """
    content: dict[str, Any] = {
        "format": STATICS_FORMAT,
        "t": settled.t.tolist(),
        "slack_cables": list(settled.slack_cables),
        "loose_clasps": list(settled.loose_clasps),
        "force_residual": float(settled.force_residual.max()),
        "length_residual": float(settled.length_residual.max()),
    }
    cables = {
        "planned_tension": settled.planned_tensions,
        "tension": settled.tensions,
        "slack": settled.slack,
    }
    vertices = {"planned": settled.planned_vertices, "position": settled.vertices}
    vertices["band"] = settled.band
    drones = {"planned": settled.planned_drones, "position": settled.drones}
    if ranges is not None:
        content["errors"] = {name: vars(size) for name, size in ranges.errors.items()}
        content["may_be_slack"] = list(ranges.slack_cables)
        content["tension_remainder"] = ranges.tension_remainders.tolist()
        content["vertex_remainder"] = ranges.vertex_remainders.tolist()
        cables |= {"smallest": ranges.tensions[..., 0], "largest": ranges.tensions[..., 1]}
        vertices |= {"half_widths": ranges.vertex_halves, "radius": ranges.radii}
    team = settled.team
    for kind, names, columns in (
        ("cables", [f"c{k}" for k in range(team.robots)], cables),
        ("vertices", team.point_names, vertices),
        ("drones", team.drone_names, drones),
    ):
        content[kind] = [
            {"name": name, **{key: values[:, k].tolist() for key, values in columns.items()}}
            for k, name in enumerate(names)
        ]
    return content


def draw_statics(settled: Settled, ranges: Tolerance | None) -> Figure:
    """Return the picture: tensions over time, and vertices from above."""
    figure = new_figure(STATICS_SIZE)
    left, right = figure.subplots(1, 2)
    t, layout = settled.t, settled.team.layout
    if ranges is not None:
        low, high = np.min(ranges.tensions[..., 0], 1), np.max(ranges.tensions[..., 1], 1)
        finite = np.where(np.isfinite(high), high, 2.0 * np.max(settled.tensions))
        left.fill_between(t, low, finite, color="0.87", label="range of any cable", zorder=1)
    left.set_prop_cycle(color=COLOURS)
    marker = "o" if len(t) == 1 else None
    left.plot(t, settled.tensions, marker=marker, linewidth=1.2, zorder=3)[0].set_label("at rest")
    left.plot(t, settled.planned_tensions, **PLANNED)[0].set_label("planned")
    left.set(ylim=(0.0, None), xlabel="t [s]", ylabel="tension [N]")
    ring = np.append(np.arange(layout.points), [0] * layout.closed)
    times = np.unique(np.linspace(0, len(t) - 1, DRAWN_TIMES).round().astype(np.intp))
    for colour, i in zip(COLOURS, times, strict=False):
        when = f"t = {t[i]:.2f} s"
        right.plot(*settled.planned_vertices[i, ring, :2].T, **PLANNED)
        right.plot(*settled.vertices[i, ring, :2].T, color=colour, marker=".", lw=1.2, label=when)
        right.plot(*settled.drones[i, :, :2].T, color=colour, marker="x", linestyle="none", ms=4)
        if np.ptp(settled.band[i]) > 0.0:
            bands = settled.rests[i, ..., :2].swapaxes(0, 1)
            lines = [right.plot(*ends.T, color=colour, lw=4.0, alpha=0.35) for ends in bands]
            lines[0][0].set_label(f"band of rest, {when}")
        shapes = () if ranges is None else ranges.ellipsoids[i, :, :2, :2]
        for centre, shape in zip(settled.vertices[i, :, :2], shapes, strict=False):
            squares, directions = np.linalg.eigh(shape)
            ellipse = centre + CIRCLE * np.sqrt(np.maximum(squares, 0.0)) @ directions.T
            right.fill(*ellipse.T, color=colour, alpha=0.35)
    right.set_aspect("equal", adjustable="datalim")
    right.set(xlabel="x [m]", ylabel="y [m]")
    for axes in (left, right):
        axes.legend(frameon=False, fontsize="small")
    return figure


def save_team(path: Path, calibration: Calibration) -> None:
    """Write the block ``team:`` with the estimates; comments state their standard errors.

    Values that the recording does not determine are the plan's.
    """
    path.write_text(team_text(calibration), encoding="utf-8")


def team_text(calibration: Calibration) -> str:
    """Return the block ``team:`` in YAML."""
    team, friction, lengths = calibration.task.team, calibration.friction, calibration.lengths
    names = [field.name for field in fields(Team) if field.name != "quadrotor"]
    values = {name: _yaml(getattr(team, name)) for name in names}
    errors = ", ".join(f"{one.error:.1g}" for one in lengths)
    values["cable_length"] = f"{_yaml([round(one.value, 4) for one in lengths])}  # ± {errors} m"
    values["cable_density"] = f"{_yaml(calibration.density)}  # as assumed"
    values["cable_friction"] += "  # of the plan: not determined"
    if friction.known:
        values["cable_friction"] = f"{friction.value:.3f}  # ± {friction.error:.1g}"
    lines = ["team:", *(f"  {name}: {text}" for name, text in values.items()), "  quadrotor:"]
    for kind, stiffness in zip(team.quadrotor, calibration.stiffness, strict=True):
        entries = {name: _yaml(value) for name, value in vars(kind).items()}
        known = "of the plan: not determined"
        if stiffness.known:
            entries["stiffness"] = f"{stiffness.value:.3g}"
            known = f"± {stiffness.error:.1g} N/m"
        flow = ", ".join(f"{name}: {text}" for name, text in entries.items())
        lines.append(f"    - {{{flow}}}  # stiffness {known}")
    return "\n".join(lines) + "\n"


def _yaml(value: object) -> str:
    """Return a value in YAML."""
    return json.dumps(value, default=lambda array: np.round(array, 9).tolist())


def save_fit(directory: Path, fit: Fit) -> None:
    """Write ``fit.json`` and ``fit.png`` to a directory, created if missing."""
    directory.mkdir(parents=True, exist_ok=True)
    write_strict_json(directory / "fit.json", fit_as_json(fit))
    save_figure(draw_fit(fit), directory / "fit.png")


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """Return the content of ``fit.json``: polygons in metres, masses with binding limits."""
    holding, task, grip, rest = fit.holding, fit.holding.task, fit.holding.grip, fit.holding.rest
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
        "largest_mass": {GRIP: {}, REST: {}},
    }
    if isinstance(grip, Grip):
        content["grip"] = {
            "polygon": grip.vertices[:, :2].tolist(),
            "wraps_deg": np.degrees(grip.wraps.angles).tolist(),
            "legs": grip.legs[:, 0].tolist(),
            "slip_load": float(grip.slip_load(task.friction)),
        }
    if isinstance(rest, ConvexPolygon):
        content["rest"] = {"polygon": rest.vertices.tolist()}
    for by, masses in content["largest_mass"].items():
        for n, capacity in fit.capacities(by).items():
            masses[str(n)] = {"mass": capacity.mass, "limit": capacity.binding}
            masses[str(n)]["suggested change"] = capacity.suggested
    return content


def draw_fit(fit: Fit) -> Figure:
    """Return the picture: the object with the polygons that enclose it, grip it and support it."""
    figure, holding, section = new_figure(FIT_SIZE), fit.holding, fit.section
    outline = (section.core[:, None] + section.rounding * CIRCLE).reshape(-1, 2)
    titles = [f"enclose: n = {holding.robots}, L = {holding.cable_length:.2f} m"]
    for by in (GRIP, REST):
        capacity = holding.capacity(by)
        mass = f"{1e3 * capacity.mass:.0f} g" if capacity.mass > 0.0 else "nothing"
        titles.append(f"{by}: {mass} ({capacity.binding} binds)")
    polygons = holding.enclosing, holding.grip, holding.rest
    for axes, polygon, title in zip(figure.subplots(1, 3), polygons, titles, strict=True):
        axes.add_patch(Polygon(outline[ConvexHull(outline).vertices], fc="0.88", ec="0.55", lw=0.8))
        axes.set_aspect("equal")
        axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
        if isinstance(polygon, InfeasibleError):
            continue
        vertices = polygon.vertices[:, :2]
        # Cables are drawn tight around the section where it is within the polygon.
        inside = polygon is not holding.rest
        places = np.vstack([vertices, outline]) if inside else vertices
        axes.add_patch(Polygon(places[ConvexHull(places).vertices], fill=False, ec=COLOURS[0]))
        axes.plot(*vertices.T, "o", color=LIMIT_COLOUR, markersize=3)
        if isinstance(polygon, Grip):
            ends = np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)
            legs = np.stack([ends, polygon.drones[..., :2]], axis=-2).reshape(-1, 2, 2)
            axes.plot(*legs.T, color=COLOURS[0], marker="o", markevery=[1])
    return figure
