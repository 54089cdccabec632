"""Picture of a sweep: one column of its rows over another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib import colormaps
from matplotlib.figure import Figure

from hitchopt.checks.registry import RULE_OF
from hitchopt.view.style import COLOURS, new_figure, save_figure

if TYPE_CHECKING:
    import pandas

SIZE = (7.6, 4.2)
"""Width and height [inch]."""

MOST_LINES = 6
"""Largest number of values of another parameter that get a line each."""


def draw_sweep(rows: pandas.DataFrame, x: str, y: str, title: str = "") -> Figure:
    """Return the picture: a point a row, and a line through the medians.

    Where one other parameter varies, there is a line for each of its values.

    Parameters
    ----------
    rows: those of a sweep.
    x, y: names of columns.
    title: title.
    """
    figure = new_figure(SIZE)
    axes = figure.subplots()
    rows = rows[rows[y].notna()]
    numeric = rows[x].dtype.kind in "fiu"
    across, values = rows[x] if numeric else rows[x].astype(str), rows[y].astype(float)
    others = [n for n in map(str, rows.columns) if n.startswith("parameter.") and n != x]
    others = [n for n in others if rows[n].nunique() > 1]
    groups: list[tuple[str, Any, Any]] = [("median", COLOURS[1], rows.index)]
    if len(others) == 1 and rows[others[0]].nunique() <= MOST_LINES:  # dark to light, also in grey
        name, shades = others[0].removeprefix("parameter."), colormaps["viridis"]
        groups = [
            (f"{name} = {value}", shades(0.9 * i / (MOST_LINES - 1)), group.index)
            for i, (value, group) in enumerate(rows.groupby(others[0]))
        ]
    for label, colour, index in groups:
        axes.plot(across[index], values[index], "o", color=colour, alpha=0.5, markersize=4)
        medians = values[index].groupby(across[index], sort=numeric).median()
        axes.plot(medians.index, medians, "-", color=colour, label=label)
    check = RULE_OF.get(y.removeprefix("check."))
    unit = check.unit if check is not None and check.unit != "ratio" else ""
    unit = "s" if y == "duration" or y.startswith("time.") else unit
    name = y.removeprefix("check.").removeprefix("parameter.")
    axes.set(xlabel=x.removeprefix("parameter."), ylabel=f"{name} [{unit}]" if unit else name)
    axes.set_title(title)
    axes.grid(color="0.9")
    axes.legend(frameon=False, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def save_sweep_picture(
    path: Path | str, rows: pandas.DataFrame, x: str, y: str, title: str = ""
) -> None:
    """Draw the picture and write it as a PNG; raises OSError where it cannot be written."""
    save_figure(draw_sweep(rows, x, y, title), path)
