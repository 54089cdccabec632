"""Tables as text, as wide as the terminal."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import zip_longest
from textwrap import wrap

DEFAULT_WIDTH = 100  # Default width of tables, if there is no terminal and no COLUMNS [characters]
GAP = "  "  # Column separator
NO_BREAK = "\xa0"  # Space at which lines are not wrapped, within names
NUMBER = re.compile(r"[-+±≤≥–]?\s?\d|–|-?inf|γ|$")  # Prefix of a right-aligned cell


def terminal_width() -> int:
    """Return the width of the terminal [characters]."""
    return shutil.get_terminal_size((DEFAULT_WIDTH, 0)).columns


def table(title: str, rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as lines of text that fit the terminal.

    Rows are plain data by column heads: a bool is a verdict; None, nan and inf are dashes; numbers
    have four significant digits. If the table is too wide, its widest text column is wrapped, and
    gaps are reduced; numbers and names, such as cable 0, are not wrapped.
    """
    formatted = [{head: _cell(value) for head, value in row.items()} for row in rows]
    heads = list(dict.fromkeys(head for row in formatted for head in row))
    columns = {head: [row[head] for row in formatted if head in row] for head in heads}
    right_aligned = {head for head in heads[1:] if all(map(NUMBER.match, columns[head]))}
    widths = {head: max(map(len, (head, *cells))) for head, cells in columns.items()}
    excess = _width(widths, GAP) - terminal_width()
    wrappable = [head for head in heads if head not in right_aligned]
    if excess > 0 and wrappable:
        widest = max(wrappable, key=lambda head: widths[head])
        words = " ".join((widest, *columns[widest])).split(" ")
        widths[widest] = max(widths[widest] - excess, *map(len, words))
    gap = GAP if _width(widths, GAP) <= terminal_width() else GAP[:1]
    header = _lines({head: head for head in heads}, widths, right_aligned, gap)
    rule = "─" * _width(widths, gap)
    lines = [line for row in formatted for line in _lines(row, widths, right_aligned, gap)]
    return "\n".join([title, *header, rule, *lines]).replace(NO_BREAK, " ")


def _width(widths: Mapping[str, int], gap: str) -> int:
    """Return the width of a table of columns of some widths [characters]."""
    return sum(widths.values()) + len(gap) * (len(widths) - 1)


def _lines(
    row: Mapping[str, str], widths: Mapping[str, int], right: Collection[str], gap: str
) -> Iterator[str]:
    """Yield the lines of a row, with cells wrapped to the widths of their columns."""
    parts = [
        wrap(row.get(head, ""), width, break_on_hyphens=False) or [""]
        for head, width in widths.items()
    ]
    for line in zip_longest(*parts, fillvalue=""):
        cells = zip(line, widths.items(), strict=True)
        padded = (x.rjust(width) if head in right else x.ljust(width) for x, (head, width) in cells)
        yield gap.join(padded).rstrip()


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, list | tuple):
        return ", ".join(map(_cell, value)) or "none"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:.4g}"
    return re.sub(r" (?=\d)", NO_BREAK, str(value)) if isinstance(value, str | int) else "–"
