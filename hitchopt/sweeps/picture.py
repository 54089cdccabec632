"""Picture of a sweep: one column of its rows over another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchopt.checks.registry import RULE_OF
from hitchopt.view.style import COLOURS, LIMIT_COLOUR, new_figure, save_figure

if TYPE_CHECKING:
    import pandas


SIZE = (7.6, 4.2)
"""Width and height [inch]."""

MOST_LINES = 6
"""Largest number of values of another parameter that get a line each."""


def draw_sweep(rows: pandas.DataFrame, x: str, y: str, title: str = "") -> Figure:
    """Return the picture: a point a row, crosses where y has no value, a line through medians.

    Where one other parameter varies, there is a line for each of its values.

    Parameters
    ----------
    rows: those of a sweep.
    x, y: names of columns.
    title: title.
    """
    figure = new_figure(SIZE)
    axes = figure.subplots()
    across, labels = rows[x], None
    if across.dtype.kind not in "fiu":
        names = across.astype(str)
        labels = list(dict.fromkeys(names))
        across = names.map({name: i for i, name in enumerate(labels)})
    other = _other_parameter(rows, x)
    values = rows[y].astype(float)
    if other is None:
        several = values.notna().sum() > across[values.notna()].nunique()
        _draw_group(axes, across, values, COLOURS[1], "median" if several else "")
    else:
        for i, (value, group) in enumerate(rows.groupby(other)):
            label = f"{other.removeprefix('parameter.')} = {value:g}"
            shade = colormaps["viridis"](0.9 * i / (MOST_LINES - 1))  # dark to light, also in grey
            _draw_group(axes, across[group.index], values[group.index], shade, label)
    without = across[rows[y].isna()]
    if len(without):
        axes.plot(
            without, np.ones(len(without)), "x", color=LIMIT_COLOUR, clip_on=False,
            transform=axes.get_xaxis_transform(), label="no value",
        )  # fmt: skip
    if labels is not None:
        axes.set_xticks(range(len(labels)), labels)
    axes.set(xlabel=x.removeprefix("parameter."), ylabel=_named(y), title=title)
    axes.grid(color="0.9")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _other_parameter(rows: pandas.DataFrame, x: str) -> str | None:
    """Return the only other parameter that varies, if it is a number of few values."""
    names = map(str, rows.columns)
    varying = [n for n in names if n.startswith("parameter.") and n != x and rows[n].nunique() > 1]
    if len(varying) != 1 or rows[varying[0]].dtype.kind not in "fi":
        return None
    return varying[0] if rows[varying[0]].nunique() <= MOST_LINES else None


def _draw_group(
    axes: Axes, across: pandas.Series[Any], values: pandas.Series[Any], colour: Any, label: str
) -> None:
    """Draw rows as points, and a line through their medians where there is a label."""
    axes.plot(across, values, "o", color=colour, alpha=0.5, markersize=4)
    medians = values.groupby(across).median().dropna()
    if label and len(medians) > 1:
        axes.plot(medians.index, medians, "-", color=colour, label=label)


def _named(column: str) -> str:
    """Return a column's name with its unit where it is known."""
    name = column.removeprefix("check.")
    if name != column and name in RULE_OF and RULE_OF[name].unit != "ratio":
        return f"{name} [{RULE_OF[name].unit}]"
    seconds = column == "duration" or column.startswith("time.")
    return f"{column} [s]" if seconds else column


def save_sweep_picture(
    path: Path | str, rows: pandas.DataFrame, x: str, y: str, title: str = ""
) -> None:
    """Draw the picture and write it as a PNG; raises OSError where it cannot be written."""
    save_figure(draw_sweep(rows, x, y, title), path)
