"""Tables in text, as programs of all locales write them, by one reader.

Texts are UTF-8 or UTF-16, with or without a byte order mark. Cells are apart by tabs, semicolons,
commas or blanks, and may be quoted. Decimals have points, or all have commas, which then separate
no cells. Comments begin with ``#`` at a line's start or after a blank; blank lines are left out.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.values import Array

Lines = Callable[[], Iterable[str]]  # Function that reads a text anew, line by line

SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
"""Separators of cells, in the order in which they are tried, and their names."""

MAX_HEAD = 50  # Lines among which that of the columns' names is looked for
COMMENT, MARK = re.compile(r"^\s*#.*|\s#(?!\d).*"), re.compile(r"^\s*#+\s*")
COMMA = re.compile(r"\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*")
SWAP = str.maketrans(",.", ".,")  # Decimal commas become points; points are no number then
ADVICE = "decimal commas need semicolons between cells, and no points in numbers"


def text_lines(path: Path) -> Iterator[str]:
    """Yield a file's lines without their ends; bytes that are no text become U+FFFD."""
    with path.open("rb") as file:
        encoding = _encoding(file.read(2))
    with path.open(encoding=encoding, errors="replace") as file:
        yield from (line.rstrip("\n") for line in file)


def decoded_lines(data: bytes) -> list[str]:
    """Return the lines of a text in bytes, read as ``text_lines`` does."""
    return data.decode(_encoding(data[:2]), "replace").splitlines()


def _encoding(mark: bytes) -> str:
    return "utf-16" if mark in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of cells in a text.

    Methods raise FileError, naming line and column of what is no row, or no number.
    """

    source: str  # its name in messages
    lines: Lines  # of all the text
    separator: str  # of cells, one of SEPARATORS
    labels: tuple[str, ...]  # names of the columns; empty where the text has none
    width: int  # number of columns
    first: int  # number of the line from which rows follow, from 1 on

    def __contains__(self, label: object) -> bool:
        return str(label).casefold() in map(str.casefold, self.labels)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line numbers and cells of all rows that are not blank, each of the whole width."""
        texts: Iterable[str] = map(_uncommented, islice(self.lines(), self.first - 1, None))
        if not self.labels:
            texts = (text.rstrip(",; \t") for text in texts)
        try:
            for number, cells in _split(texts, self.separator):
                if not any(cells):
                    continue
                if len(cells) != self.width:
                    if len(cells) < self.width or any(cells[self.width :]):
                        raise self._fault(number, f"has {len(cells)} cells, not {self.width}")
                    del cells[self.width :]
                yield self.first - 1 + number, cells
        except csv.Error as error:
            raise FileError(f"{self.source}: {error}; check its quotation marks") from None

    def words(self, column: str | int) -> list[str]:
        """Return the cells of a column, by its name or its place from 0 on."""
        (place,) = self._places([column])
        return [cells[place].strip() for _, cells in self.rows()]

    def numbers(
        self, columns: Sequence[str | int], *, blanks: bool = False, least: int = 0
    ) -> Array:
        """Return columns (rows, columns), by names or places, as numbers.

        Blank cells are nan where ``blanks`` are allowed; fewer rows than ``least`` are refused.
        """
        places = self._places(columns)
        try:
            table = self._numbers(places, blanks, commas=False)
        except _NoNumberError as error:
            if not error.comma:
                raise
            table = self._numbers(places, blanks, commas=True)
        if len(table) < least:
            raise FileError(f"{self.source}: has {len(table)} rows; {least} are the least")
        return table

    def _numbers(self, places: Sequence[int], blanks: bool, *, commas: bool) -> Array:
        values = array("d")
        for number, cells in self.rows():
            texts = [cells[place] for place in places]
            if commas:
                texts = [text.translate(SWAP) for text in texts]
            try:
                values.extend(list(map(float, texts)))
            except ValueError:
                for place, text in zip(places, texts, strict=True):
                    blank = blanks and not text.strip()
                    if not (blank or is_number(text)):
                        raise self._no_number(number, place, cells[place], commas=commas) from None
                    values.append(float("nan" if blank else text))
        return np.frombuffer(values, dtype=np.float64).reshape(-1, len(places)).copy()

    def _places(self, columns: Sequence[str | int]) -> list[int]:
        names = [label.casefold() for label in self.labels]
        for column in columns:
            if isinstance(column, str) and column.casefold() not in names:
                head = f"line {self.first - 1}, the columns' names, has no {column!r}"
                raise FileError(f"{self.source}: {head}, but {', '.join(self.labels)[:200]}")
        return [names.index(c.casefold()) if isinstance(c, str) else c for c in columns]

    def _no_number(self, number: int, place: int, cell: str, *, commas: bool) -> _NoNumberError:
        name = self.labels[place] if self.labels else f"column {place + 1}"
        words = f"{self.source}: line {number}: {name} is {cell.strip()[:40]!r}, no number"
        words += " among decimal commas" if commas else ""
        comma = commas or "," in cell
        return _NoNumberError(f"{words}; {ADVICE}" if comma else words, comma=comma)

    def _fault(self, number: int, words: str) -> FileError:
        line = f"{self.source}: line {self.first - 1 + number} {words}"
        return FileError(f"{line}; is it cut off, or are its decimals commas? {ADVICE}")


class _NoNumberError(FileError):
    """A cell that is no number; it has a comma, or not."""

    def __init__(self, message: str, *, comma: bool) -> None:
        super().__init__(message)
        self.comma = comma


def labelled_table(lines: Lines, names: Sequence[str], source: str) -> Table:
    """Return the table under the first line that has certain names of columns among others.

    That line may be a comment. FileError tells that there is none.
    """
    wanted = {name.casefold() for name in names}
    head = [MARK.sub("", line) for line in islice(lines(), MAX_HEAD)]
    for number, line in enumerate(head, 1):
        for separator in SEPARATORS:
            labels = [label.strip() for label in _cells(_uncommented(line), separator)]
            if wanted <= set(map(str.casefold, labels)):
                return Table(source, lines, separator, tuple(labels), len(labels), number + 1)
    begin = next((line for line in head if line.strip()), "")
    words = f"has no line of columns' names with {', '.join(names)}; it begins {begin[:60]!r}"
    raise FileError(f"{source}: {words}")


def numeric_table(lines: Lines, source: str, first: int = 1) -> Table:
    """Return the table from the first line on, not before line ``first``, that has a number.

    FileError tells that there is none.
    """
    for number, line in enumerate(lines(), 1):
        if number < first:
            continue
        each = {s: _cells(_uncommented(line).rstrip(",; \t"), s) for s in SEPARATORS}
        counts = {s: sum(map(_is_either, cells)) for s, cells in each.items()}
        if any(counts.values()):
            whole = [s for s, cells in each.items() if counts[s] == len(cells)]
            separator = whole[0] if whole else max(counts, key=lambda s: counts[s])
            return Table(source, lines, separator, (), len(each[separator]), number)
    raise FileError(f"{source}: has no line of numbers")


def headings(lines: Lines) -> Iterator[str]:
    """Yield the first lines in lower case, their cells apart by commas, comment signs left out."""
    for line in islice(lines(), MAX_HEAD):
        text = MARK.sub("", line[:100_000]).partition("#")[0].strip().lower()
        separator = next((each for each in SEPARATORS if each in text), ",")
        yield ",".join(x.strip().replace(",", ".") for x in _cells(text, separator)).lstrip(",")


def with_points(text: str) -> str:
    """Return a number with a point in place of its decimal comma, any other text as it is."""
    return text.replace(",", ".") if COMMA.fullmatch(text) else text


def _split(texts: Iterable[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield numbers of lines, from 1 on, and their cells."""
    if separator == " ":
        yield from enumerate(map(str.split, texts), 1)
    else:
        reader = csv.reader(texts, delimiter=separator, skipinitialspace=True)
        yield from ((reader.line_num, cells) for cells in reader)


def _cells(text: str, separator: str) -> list[str]:
    """Return the cells of one line, without blank ones at its end."""
    try:
        _, cells = next(_split([text], separator))
    except csv.Error:
        return []
    while cells and not cells[-1].strip():
        cells.pop()
    return cells


def _uncommented(line: str) -> str:
    return COMMENT.sub("", line) if "#" in line else line


def is_number(text: str) -> bool:
    """Return whether a text is a number with a point, or without."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_either(text: str) -> bool:
    """Return whether a text is a number with a point, or with a comma."""
    return is_number(text) or is_number(text.translate(SWAP))
