"""Read text tables in the formats of all locales.

Texts are UTF-8 or UTF-16, with or without a byte order mark. Cells are separated by tabs,
semicolons, commas or blanks, and may be quoted. Decimals have points; or all have commas, which
then separate no cells. Comments begin with ``#`` at the start of a line or after a blank. Blank
lines are skipped.
"""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from hitchopt.errors import FileError
from hitchopt.storage.files import opened
from hitchopt.values import Array, counted

Lines = Callable[[], Iterable[str]]  # Function that reads a text from its start, line by line

SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
"""Names of separators of cells, in order of preference."""

MAX_HEAD_LINES = 50  # Lines that are searched for the column names
# A comment to the end of a line; a number after the sign is no comment
COMMENT = re.compile(r"^\s*#.*|\s#(?!\d).*")
COMMENT_SIGN = re.compile(r"^\s*#+\s*")  # The sign of a comment at the start of a line
MINUS = "\N{MINUS SIGN}"  # As spreadsheets in Swedish, Norwegian and Finnish write it
SWAP_SIGNS = str.maketrans(",.", ".,")  # A point among decimal commas becomes an invalid comma
COMMA_REMEDY = "decimal commas need semicolons between cells, and no points in numbers"


def text_lines(path: Path) -> Iterator[str]:
    """Yield a file's lines without line breaks; invalid bytes become U+FFFD, U+2212 a hyphen."""
    with opened(path) as file:
        is_utf16 = file.read(2) in (b"\xff\xfe", b"\xfe\xff")
        file.seek(0)
        encoding = "utf-16" if is_utf16 else "utf-8-sig"
        with io.TextIOWrapper(file, encoding, errors="replace") as text:
            yield from (line.rstrip("\n").replace(MINUS, "-") for line in text)


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of cells in a text.

    Methods raise FileError with the line and column of an invalid row or number.
    """

    source: str  # name in messages
    lines: Lines  # of the whole text
    separator: str  # one of SEPARATORS
    labels: tuple[str, ...]  # names of the columns; may be empty
    width: int  # number of columns
    first: int  # line number of the first row, counted from 1

    def __contains__(self, label: object) -> bool:
        return str(label).casefold() in map(str.casefold, self.labels)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line numbers and cells of all rows that are not blank, each of ``width`` cells."""
        lines: Iterable[str] = map(_without_comment, islice(self.lines(), self.first - 1, None))
        if not self.labels:
            lines = (line.rstrip(",; \t") for line in lines)
        try:
            for number, cells in _split(lines, self.separator):
                if not any(cells):
                    continue
                if len(cells) < self.width or any(cells[self.width :]):
                    where = f"{self.source}: line {self.first - 1 + number}"
                    question = "is it cut off, or are its decimals commas?"
                    reason = f"has {len(cells)} cells, not {self.width}; {question} {COMMA_REMEDY}"
                    raise FileError(f"{where} {reason}")
                yield self.first - 1 + number, cells[: self.width]
        except csv.Error as error:
            raise FileError(f"{self.source}: {error}; check its quotation marks") from None

    def words(self, column: str | int) -> list[str]:
        """Return the cells of a column, given by name or index."""
        (index,) = self._indices([column])
        return [cells[index].strip() for _, cells in self.rows()]

    def numbers(
        self, columns: Sequence[str | int], *, blanks: bool = False, min_rows: int = 0
    ) -> Array:
        """Return columns (rows, columns), given by names or indices, as numbers.

        Blank cells are nan if ``blanks`` are allowed. Raises FileError if there are too few rows.
        """
        indices = self._indices(columns)
        try:
            table = self._numbers(indices, blanks, commas=False)
        except _NumberError as error:
            if not error.comma:
                raise
            table = self._numbers(indices, blanks, commas=True)
        if len(table) < min_rows:
            size = counted(len(table), "row")
            raise FileError(f"{self.source}: has {size}; at least {min_rows} are needed")
        return table

    def check_finite(self, numbers: Array, names: Sequence[str]) -> None:
        """Raise FileError if a number (rows, columns) of columns with some names is not finite."""
        for row, column in np.argwhere(~np.isfinite(numbers))[:1].tolist():
            line = next(islice(self.rows(), row, None))[0]
            where = f"{self.source}: line {line}, column {names[column]}"
            raise FileError(f"{where}: not a number ({numbers[row, column]:g})")

    def _numbers(self, indices: Sequence[int], blanks: bool, *, commas: bool) -> Array:
        values = array("d")
        for number, cells in self.rows():
            texts = [cells[index] for index in indices]
            if commas:
                texts = [text.translate(SWAP_SIGNS) for text in texts]
            try:
                values.extend(list(map(float, texts)))
            except ValueError:
                for index, text in zip(indices, texts, strict=True):
                    blank = blanks and not text.strip()
                    if not (blank or _is_number(text)):
                        raise self._no_number(number, index, cells[index], commas=commas) from None
                    values.append(float("nan" if blank else text))
        return np.frombuffer(values, dtype=np.float64).reshape(-1, len(indices)).copy()

    def _indices(self, columns: Sequence[str | int]) -> list[int]:
        names = [label.casefold() for label in self.labels]
        for column in columns:
            if isinstance(column, str) and column.casefold() not in names:
                head = f"line {self.first - 1}, the column names, has no {column!r}"
                raise FileError(f"{self.source}: {head}, but {', '.join(self.labels)[:200]}")
        return [names.index(c.casefold()) if isinstance(c, str) else c for c in columns]

    def _no_number(self, number: int, index: int, cell: str, *, commas: bool) -> _NumberError:
        name = self.labels[index] if self.labels else f"column {index + 1}"
        reason = f"{self.source}: line {number}: {name} is {cell.strip()[:40]!r}, not a number"
        reason += " among decimal commas" if commas else ""
        comma = commas or "," in cell
        return _NumberError(f"{reason}; {COMMA_REMEDY}" if comma else reason, comma=comma)


class _NumberError(FileError):
    """An invalid number, which may have a decimal comma."""

    def __init__(self, message: str, *, comma: bool) -> None:
        super().__init__(message)
        self.comma = comma


def labelled_table(lines: Lines, names: Sequence[str], source: str) -> Table:
    """Return the table under the first line that contains all ``names`` of columns.

    That line may be a comment. Raises FileError if there is none.
    """
    required = {name.casefold() for name in names}
    head = [COMMENT_SIGN.sub("", line) for line in islice(lines(), MAX_HEAD_LINES)]
    for number, line in enumerate(head, 1):
        for separator in SEPARATORS:
            labels = [label.strip() for label in _cells(_without_comment(line), separator)]
            if required <= set(map(str.casefold, labels)):
                return Table(source, lines, separator, tuple(labels), len(labels), number + 1)
    start = next((line for line in head if line.strip()), "")
    reason = f"has no line of column names with {', '.join(names)}; it begins {start[:60]!r}"
    raise FileError(f"{source}: {reason}")


def numeric_table(lines: Lines, source: str, first: int = 1) -> Table:
    """Return the table that starts at the first line with a number, not before line ``first``.

    Raises FileError if there is none.
    """
    for number, line in enumerate(lines(), 1):
        if number < first:
            continue
        rows = {s: _cells(_without_comment(line).rstrip(",; \t"), s) for s in SEPARATORS}
        if any(any(map(_is_any_number, cells)) for cells in rows.values()):
            separator = _separator_of(islice(lines(), number - 1, number - 1 + MAX_HEAD_LINES))
            return Table(source, lines, separator, (), len(rows[separator]), number)
    raise FileError(f"{source}: has no line of numbers")


def _separator_of(lines: Iterable[str]) -> str:
    """Return the separator by which most lines have the width of the first and only numbers.

    Of several, it is the one by which the first line has the most: 0,0 are two whole numbers rather
    than one with a decimal comma.
    """
    texts = [_without_comment(line).rstrip(",; \t") for line in lines]

    def numbers(separator: str) -> tuple[int, int]:
        """Return the number of such lines, and of numbers in the first one."""
        first, *rest = ([*map(_is_any_number, _cells(text, separator))] for text in texts)
        return sum(len(row) == len(first) and all(row) for row in [first, *rest]), sum(first)

    return max(SEPARATORS, key=numbers)


def headings(lines: Lines) -> Iterator[str]:
    """Yield the first lines in lower case, with comma-separated cells and no comment signs."""
    for line in islice(lines(), MAX_HEAD_LINES):
        text = COMMENT_SIGN.sub("", line[:100_000]).partition("#")[0].strip().lower()
        separator = next((each for each in SEPARATORS if each in text), ",")
        yield ",".join(x.strip().replace(",", ".") for x in _cells(text, separator)).lstrip(",")


def _split(lines: Iterable[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line numbers, counted from 1, and cells."""
    if separator == " ":
        yield from enumerate(map(str.split, lines), 1)
    else:
        reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
        yield from ((reader.line_num, cells) for cells in reader)


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of one line without blank trailing cells."""
    try:
        _, cells = next(_split([line], separator))
    except csv.Error:
        return []
    while cells and not cells[-1].strip():
        cells.pop()
    return cells


def _without_comment(line: str) -> str:
    return COMMENT.sub("", line) if "#" in line else line


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_any_number(text: str) -> bool:
    """Return whether a text is a number with a decimal point or comma."""
    return _is_number(text) or _is_number(text.translate(SWAP_SIGNS))
