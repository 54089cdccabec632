"""Files of a fit: ``fit.json`` and ``fit.png``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.fitting.fit import GRIP, REST, Fit
from hitchopt.fitting.fit_picture import save_fit_picture
from hitchopt.holding.capacity import Capacity
from hitchopt.holding.grip_statics import Grip
from hitchopt.storage.strict_json import write_strict_json

FORMAT = "hitchopt-fit/1"


def save_fit(directory: Path, fit: Fit) -> None:
    """Write ``fit.json`` and ``fit.png`` to a directory, which is made if need be.

    Raises
    ------
    OSError: a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    write_strict_json(directory / "fit.json", fit_as_json(fit))
    save_fit_picture(directory / "fit.png", fit)


def fit_as_json(fit: Fit) -> dict[str, Any]:
    """Return the content of ``fit.json``: polygons in metres, masses with what binds."""
    holding, task = fit.holding, fit.holding.task
    content: dict[str, Any] = {
        "format": FORMAT,
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
