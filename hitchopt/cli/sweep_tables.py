"""Tables of a sweep for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hitchopt.cli.console_tables import new_table, rendered

if TYPE_CHECKING:
    from hitchopt.sweeps.sweep_summary import Summary

MOST_ROWS = 8
"""Reasons that are listed."""


def sweep_tables(found: Summary) -> str:
    """Return what a sweep comes to."""
    lines = [f"{found.planned.rows} of {found.cases} rows; planned: {found.planned}"]
    if found.succeeded is not None:
        lines.append(f"simulated flights that succeeded: {found.succeeded}")
    tables = []
    if found.binding:
        reasons = new_table("What bound", ["limit"], ["rows"])
        for name, count in found.binding[:MOST_ROWS]:
            reasons.add_row(name, str(count))
        tables.append(rendered(reasons))
    figures = new_table("Figures", ["column"], ["median", "smallest", "largest"])
    for name, values in found.medians.items():
        figures.add_row(name, *(f"{value:.4g}" for value in values))
    return "\n\n".join([*tables, rendered(figures), "\n".join(lines)])
