"""Tables of a fit for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hitchopt.cli.console_tables import new_table, rendered
from hitchopt.errors import InfeasibleError

if TYPE_CHECKING:
    from hitchopt.fitting.fit import Fit
    from hitchopt.holding.capacity import Capacity


def fit_tables(fit: Fit) -> str:
    """Return the polygons of a fit, and what each number of robots holds at most."""
    return "\n\n".join([*(f"note: {note}" for note in fit.notes), _polygons(fit), _masses(fit)])


def _polygons(fit: Fit) -> str:
    from hitchopt.holding.grip_statics import Grip

    holding = fit.holding
    title = f"Polygons of {holding.robots} cables of {holding.cable_length:.2f} m"
    wraps = isinstance(holding.grip, Grip)
    numbers = ["enclosing [m]", "gripping [m]", "wrap [°]", "resting [m]"]
    table = new_table(title, ["vertex"], numbers)
    for k in range(holding.robots):
        grip, wrap, rest = "–", "–", "–"
        if wraps and isinstance(holding.grip, Grip):
            grip = _point(holding.grip.vertices[k, :2])
            wrap = f"{np.degrees(holding.grip.wraps.angles[k]):.1f}"
        if not isinstance(holding.rest, InfeasibleError):
            rest = _point(holding.rest.vertices[k])
        table.add_row(f"p{k}", _point(holding.enclosing.vertices[k]), grip, wrap, rest)
    return rendered(table)


def _masses(fit: Fit) -> str:
    words = ["robots", "grip", "limit", "change for more", "rest", "limit", "change for more"]
    table = new_table("Largest mass", words, [])
    grips, rests = fit.capacities("grip"), fit.capacities("rest")
    for n in fit.others:
        cells = [cell for each in (grips[n], rests[n]) for cell in _cells(each)]
        table.add_row(str(n), *cells)
    return rendered(table)


def _cells(found: Capacity | InfeasibleError) -> tuple[str, str, str]:
    if isinstance(found, InfeasibleError):
        broken = found.violations[0]
        return "–", broken.constraint, broken.remedy
    mass = f"{1e3 * found.mass:.0f} g" if found.mass > 0.0 else "–"
    return mass, found.binding, found.suggested


def _point(point: np.ndarray) -> str:
    return ", ".join(f"{x + 0.0:.3f}" for x in np.round(point, 3))
