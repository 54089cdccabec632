"""Files and pictures of fits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from scipy.spatial import ConvexHull

from hitchopt.carrying.holding import Grip
from hitchopt.carrying.outline_fit import GRIP, REST, Fit
from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Hitch, Team
from hitchopt.storage.files import write_strict_json
from hitchopt.view import style

FIT_FORMAT = "hitchopt-fit/1"  # Format of files of fits

FIT_SIZE = (12.0, 5.0)  # Width and height of the picture of a fit [inch]
PAGE_LEGEND = 1.0  # Height of a legend on a page [inch]
FIT_SHARE = 0.8  # Height of a polygon on a page over its width

# Points of a unit circle
CIRCLE = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 121)).view(np.float64).reshape(-1, 2)


def save_fit(
    directory: Path,
    fit: Fit,
    mass: float | None = None,
    by: str = GRIP,
    format: str = "png",
    width: float | None = None,
) -> None:
    """Write ``fit.json`` and its picture to a directory, which is created if missing.

    ``mass`` [kg] is to be held by ``grip`` or ``rest``. The picture is ``fit.png``, or ``svg`` or
    ``pdf``; with a ``width`` [inch] it is a figure for a paper.
    """
    figure = draw_fit(fit, mass, by, width)
    directory.mkdir(parents=True, exist_ok=True)
    write_strict_json(directory / "fit.json", fit_as_json(fit))
    style.save_figure(figure, directory / f"fit.{format}")


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """Return the content of ``fit.json``: polygons in metres, masses with binding limits."""
    holding = fit.holding
    task = fit.holding.task
    grip = fit.holding.grip
    rest = fit.holding.rest
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


@style.own_style()
def draw_fit(
    fit: Fit, mass: float | None = None, by: str = GRIP, width: float | None = None
) -> Figure:
    """Return the picture: the object with the polygons that enclose it, grip it and support it.

    Drones of the enclosing and supporting polygons are drawn without a load; ``mass`` [kg] is to be
    held. With a ``width`` [inch] it is a figure for a paper, with the polygons below each other.
    """
    holding, section = fit.holding, fit.section
    outline = (section.core[:, None] + section.rounding * CIRCLE).reshape(-1, 2)
    titles = [f"enclose: {holding.robots} cables of {holding.cable_length:.2f} m"]
    for each in (GRIP, REST):
        capacity = holding.capacity(each)
        mass_in_words = f"at most {1e3 * capacity.mass:.0f} g" if capacity.mass > 0.0 else "nothing"
        titles.append(f"{each}: {mass_in_words}, {capacity.binding} binds")
        if mass is not None and each == by:
            titles[-1] += f", {1e3 * mass:.0f} g {'' if mass <= capacity.mass else 'NOT '}held"
    polygons = holding.enclosing, holding.grip, holding.rest
    requirements, blue, red = holding.task.requirements, style.COLOURS[0], style.LIMIT_COLOUR
    limits, separation = requirements.limits, requirements.separation
    drawn: dict[str, Any] = {"tension": holding.task.tension, "quadrotor": holding.task.kind}
    team = Team(holding.robots, holding.cable_length, **drawn)
    if width is None:
        figure = style.new_figure(FIT_SIZE)
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
    else:
        figure = style.page_figure(width, 3.0 * FIT_SHARE * width + PAGE_LEGEND)
        panels = figure.subplots(3, 1, sharex=True, sharey=True)
    for axes, polygon, title in zip(panels, polygons, titles, strict=True):
        axes.add_patch(Polygon(outline[ConvexHull(outline).vertices], fc="0.88", ec="0.55", lw=0.8))
        axes.set_aspect("equal")
        axes.set_title(title, fontsize="medium")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.label_outer()
        if isinstance(polygon, InfeasibleError):
            continue
        vertices = polygon.vertices[:, :2]
        # Cables are taut around a section within the polygon
        corners = vertices if polygon is holding.rest else np.vstack([vertices, outline])
        axes.add_patch(Polygon(corners[ConvexHull(corners).vertices], fill=False, ec=blue))
        axes.plot(*vertices.T, "o", color=red, markersize=3, zorder=3)
        if isinstance(polygon, Grip):
            drones = polygon.drones[..., :2]
        else:
            try:
                hitch = Hitch.spread(team, polygon, limits=limits, separation=separation)
            except InfeasibleError:
                continue
            drones = hitch.drones.reshape(-1, 2, 3)[..., :2]
        ends = np.stack([vertices, np.roll(vertices, -1, axis=0)], axis=1)
        legs = np.stack([ends, drones], axis=-2).reshape(-1, 2, 2)
        axes.plot(*legs.T, color=blue, lw=1.2)
        axes.plot(*drones.reshape(-1, 2).T, "o", color=blue, markersize=4)
        for x, y in drones.reshape(-1, 2):
            axes.add_patch(Circle((x, y), separation.radius, fill=False, ec=blue))
    panels[0].locator_params(nbins=5)
    if width is None:
        legend = "object grey, cables and drones blue, as wide as their ellipsoids, clasps red"
        figure.suptitle(legend, fontsize="medium")
        return figure
    handles = (
        Patch(fc="0.88", ec="0.55", label="object"),
        Line2D([], [], color=blue, label="cables"),
        style.marker("o", red, red, "clasps", 3.0),
        style.marker("o", blue, blue, "drones", 4.0),
        style.marker("o", "none", blue, "their ellipsoids", 8.0),
    )
    style.legend_on_page(figure, handles)
    return figure
