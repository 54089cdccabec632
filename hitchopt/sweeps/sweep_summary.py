"""What a sweep comes to: medians, shares with their intervals, what bound most often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hitchopt.errors import InputError
from hitchopt.sweeps.work import PLANNED

if TYPE_CHECKING:
    import pandas

LEVEL = 0.95
"""Confidence of Wilson's intervals."""


@dataclass(frozen=True)
class Share:
    """How many of some rows have a property, and Wilson's interval of the rate (1927)."""

    count: int
    rows: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval."""
        from scipy.stats import binomtest

        found = binomtest(self.count, self.rows).proportion_ci(LEVEL, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.rows} ({100 * low:.0f}–{100 * high:.0f} %)"


@dataclass(frozen=True)
class Summary:
    """A sweep in figures.

    Attributes
    ----------
    cases: number of cases of the study; of rows there may be fewer.
    planned: share of rows with a plan.
    succeeded: share of simulated flights that succeeded; None where none was simulated.
    binding: names of limits that bound, or other reasons, with their counts, the most frequent
        first.
    medians: median, smallest and largest value of every figure, by column.
    """

    cases: int
    planned: Share
    succeeded: Share | None
    binding: tuple[tuple[str, int], ...]
    medians: dict[str, tuple[float, float, float]]


def summary(rows: pandas.DataFrame, cases: int) -> Summary:
    """Return what the rows of a sweep come to.

    Raises
    ------
    InputError: no rows.
    """
    if not len(rows):
        raise InputError("rows", 0, "at least 1", "run the sweep first")
    planned = rows["status"] == PLANNED
    flown = rows.get("simulate.succeeded")
    share = None
    if flown is not None and flown.notna().any():
        share = Share(int(flown.fillna(False).astype(bool).sum()), int(flown.notna().sum()))
    reasons = rows.loc[~planned, "binding"].fillna(rows.loc[~planned, "status"])
    figures = [
        name for name in map(str, rows.columns) if _is_figure(name) and rows[name].dtype.kind == "f"
    ]
    return Summary(
        cases,
        Share(int(planned.sum()), len(rows)),
        share,
        tuple((str(name), int(count)) for name, count in reasons.value_counts().items()),
        {name: _spread(rows[name]) for name in figures if rows[name].notna().any()},
    )


def _is_figure(name: str) -> bool:
    return name == "duration" or name.startswith(("check.", "simulate.", "settle.", "time."))


def _spread(values: Any) -> tuple[float, float, float]:
    known = values.dropna()
    return float(known.median()), float(known.min()), float(known.max())


def column_of(rows: pandas.DataFrame, name: str) -> str:
    """Return the column that a name means: itself, or a parameter's, or a check's.

    Raises
    ------
    InputError: no such column; the remedy names near ones.
    """
    import difflib

    for column in (name, f"parameter.{name}", f"check.{name}", f"simulate.{name}"):
        if column in rows and rows[column].notna().any():
            return column
    near = difflib.get_close_matches(name, list(map(str, rows.columns)), n=3, cutoff=0.3)
    raise InputError("--plot", name, "a column with values", f"such as {', '.join(near)}")
