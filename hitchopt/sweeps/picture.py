"""Picture of a sweep: one column of its rows over another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib import colormaps

from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InputError
from hitchopt.view.style import COLOURS, new_figure, save_figure

if TYPE_CHECKING:
    import pandas

SIZE = (7.6, 4.2)  # Width and height [inch]
MOST_LINES = 6  # Largest number of values of another parameter that get a line each


def save_sweep_picture(
    path: Path | str, rows: pandas.DataFrame, x: str, y: str, title: str = ""
) -> None:
    """Write a PNG of column y over column x: a point a row, and a line through the medians.

    Where one other parameter varies, there is a line for each of its values.

    Raises
    ------
    InputError: no such column.
    OSError: the file cannot be written.
    """
    x, y = column_of(rows, x), column_of(rows, y)
    figure = new_figure(SIZE)
    axes = figure.subplots()
    rows = rows[rows[y].notna()]
    others = [n for n in map(str, rows.columns) if n.startswith("parameter.") and n != x]
    others = [n for n in others if rows[n].nunique() > 1]
    groups: list[tuple[str, Any, Any]] = [("median", COLOURS[1], rows)]
    if len(others) == 1 and rows[others[0]].nunique() <= MOST_LINES:  # dark to light, also in grey
        name, shades = others[0].removeprefix("parameter."), colormaps["viridis"]
        groups = [
            (f"{name} = {value}", shades(0.9 * i / (MOST_LINES - 1)), group)
            for i, (value, group) in enumerate(rows.groupby(others[0]))
        ]
    for label, colour, group in groups:
        axes.plot(group[x], group[y], "o", color=colour, alpha=0.5, markersize=4)
        medians = group.groupby(x, sort=rows[x].dtype.kind in "fiu")[y].median()
        axes.plot(medians.index, medians, "-", color=colour, label=label)
    check = RULE_OF.get(y.removeprefix("check."))
    unit = check.unit if check is not None and check.unit != "ratio" else ""
    unit = "s" if y == "duration" or y.startswith("time.") else unit
    name = y.removeprefix("check.").removeprefix("parameter.")
    axes.set(xlabel=x.removeprefix("parameter."), ylabel=f"{name} [{unit}]" if unit else name)
    axes.set_title(title)
    axes.grid(color="0.9")
    axes.legend(frameon=False, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path)


def column_of(rows: pandas.DataFrame, name: str) -> str:
    """Return the column that a name means: itself, or a parameter's, a check's or a flight's."""
    for column in (name, f"parameter.{name}", f"check.{name}", f"simulate.{name}"):
        if column in rows and rows[column].notna().any():
            return column
    known = ", ".join(name for name in map(str, rows.columns) if rows[name].notna().any())
    raise InputError("--plot", name, "a column with values", f"take one of {known}")
