"""Tables of phases and certificates for a terminal or a text file."""

from __future__ import annotations

import math
import shutil
import sys
from collections.abc import Iterable, Sequence
from io import StringIO
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from hitchopt.checks.certificate import Certificate
    from hitchopt.motion.motion import Phase

DEFAULT_WIDTH = 100
"""Width of tables that are not written to a terminal [characters]."""

MAX_NAMES = 4
"""Number of drones, cables or vertices that are shown for one check."""


def phase_table(phases: Iterable[Phase]) -> str:
    """Return the table of a plan's phases, with a column for remarks if there are any."""
    rows = tuple(phases)
    table = new_table("Phases", ["phase"], ["step", "start", "end", "duration"])
    if any(phase.remark for phase in rows):
        table.add_column("remark", overflow="fold")
    for phase in rows:
        times = (phase.start, phase.end, phase.end - phase.start)
        remark = (Text(phase.remark),) if phase.remark else ()
        table.add_row(Text(phase.name), str(phase.step), *(f"{t:.3f} s" for t in times), *remark)
    return rendered(table)


def certificate_table(certificate: Certificate) -> str:
    """Return the table of a certificate's checks, each with its worst value over all of time.

    What is reported without a limit has what it assumes of the vertices in that column.
    """
    table = new_table("Certificate", ["check"], ["worst", "limit"])
    for name in ("unit", "where", "when", "holds"):
        table.add_column(name, overflow="fold")
    for check in certificate.checks:
        relation = "≥" if check.sense == "min" else "≤"
        limit = f"{relation} {number(check.limit)}"
        if check.limit is None:
            limit = "–" if check.gamma is None else f"γ = {check.gamma:g}"
        table.add_row(
            Text(check.name),
            number(check.worst),
            limit,
            Text("" if check.unit == "1" else check.unit),
            Text(_names(check.where)),
            f"{check.time:.3f} s" if check.worst is not None and math.isfinite(check.time) else "",
            Text("yes" if check.holds else "NO", style="green" if check.holds else "bold red"),
        )
    return rendered(table)


def number(value: float | None) -> str:
    """Return ``value`` in six significant digits; infinite beyond all numbers, a dash for None."""
    if value is None:
        return "–"
    if abs(value) >= sys.float_info.max:
        return "inf" if value > 0 else "-inf"
    return f"{value:.6g}"


def _names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:MAX_NAMES])
    return f"{shown}, and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else shown


def new_table(title: str, words: Sequence[str], numbers: Sequence[str]) -> Table:
    """Return an empty table: columns of words, then of numbers."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in words:
        table.add_column(name, overflow="fold")
    for name in numbers:
        table.add_column(name, justify="right", overflow="fold")
    return table


def rendered(table: Table) -> str:
    """Return the table as lines of text that fit the terminal."""
    terminal = sys.stdout is not None and sys.stdout.isatty()  # closed by `>&-`
    width = shutil.get_terminal_size().columns if terminal else DEFAULT_WIDTH
    text = StringIO()
    # No markup: units in brackets are text.
    console = Console(file=text, width=width, force_terminal=terminal, markup=False, emoji=False)
    console.print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines())
