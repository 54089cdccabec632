"""Tables of a settled hitch for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from hitchopt.cli.console_tables import new_table, rendered

if TYPE_CHECKING:
    from hitchopt.settling.settled_hitch import Settled
    from hitchopt.settling.tolerance import Tolerance

MOST_ROWS = 24
"""Cables or vertices that a table shows; the others are in statics.json."""


def statics_tables(settled: Settled, ranges: Tolerance | None) -> str:
    """Return the tables of cables and vertices, each with its extremes over the times."""
    numbers = ["planned [N]", "at rest [N]"] + (["range [N]"] if ranges is not None else [])
    cables = new_table(_title("Cables", settled.team.robots), ["cable"], numbers)
    cables.add_column("slack", overflow="fold")
    limits = None if ranges is None else ranges.tensions
    for k in range(min(settled.team.robots, MOST_ROWS)):
        row = [_span(settled.planned_tensions[:, k]), _span(settled.tensions[:, k])]
        slack = "yes" if settled.slack[:, k].any() else "no"
        if limits is not None and ranges is not None:
            row.append(_span(limits[:, k]))
            slack = "may be" if slack == "no" and ranges.slack[:, k].any() else slack
        cables.add_row(f"c{k}", *row, Text(slack, style="green" if slack == "no" else "bold red"))
    numbers = ["from the plan [mm]", "lower by [mm]"]
    numbers += ["range around it [mm]"] if ranges is not None else []
    names = settled.team.point_names
    vertices = new_table(_title("Vertices", len(names)), ["vertex"], numbers)
    lower = settled.planned_vertices[..., 2] - settled.vertices[..., 2]
    for k, name in enumerate(names[:MOST_ROWS]):
        row = [f"{1e3 * np.max(settled.displacements[:, k]):.1f}", _span(1e3 * lower[:, k], 1)]
        if ranges is not None:
            row.append(f"±{1e3 * np.max(ranges.radii[:, k]):.1f}")
        vertices.add_row(name, *row)
    t = settled.t
    when = f"at t = {t[0]:g} s" if len(t) == 1 else f"at {len(t)} times, {t[0]:g} to {t[-1]:g} s"
    rest = (
        f"{when}; forces balance to {np.max(settled.force_residual):.1e} N, lengths to "
        f"{np.max(settled.length_residual):.1e} m"
    )
    lines = [rendered(cables), rendered(vertices), rest]
    if ranges is not None:
        lines.append(
            f"ranges include {np.max(ranges.tension_remainders):.3g} N and "
            f"{1e3 * np.max(ranges.vertex_remainders):.3g} mm beyond first order"
        )
    return "\n\n".join(lines[:2]) + "\n\n" + "\n".join(lines[2:])


def _title(what: str, count: int) -> str:
    more = f" (the first {MOST_ROWS} of {count})" if count > MOST_ROWS else ""
    return f"{what}: smallest to largest value over the times{more}"


def _span(values: np.ndarray, digits: int = 3) -> str:
    """Return the smallest and the largest value, or the only one."""
    low, high = (f"{value + 0.0:.{digits}f}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
