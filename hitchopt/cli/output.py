"""Output of one command: tables and progress for people, or one JSON object."""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

import hitchopt as ho

if TYPE_CHECKING:
    from rich.progress import Progress

KEY = "hitchopt.output"  # Key of a call's Output in click's contexts
# Width of tables that are not written to a terminal [characters], unless COLUMNS says another,
# and what is between columns
DEFAULT_WIDTH, GAP = 100, "  "
NAME = "\xa0"  # Space within a name while a table is made: lines do not break there
BAR, CLOCK = 20, 12  # Widths of a bar, and of the clock with what is between columns [characters]
LINES = 1.0  # Shortest time between lines of percentages [s]
ARGUMENT = re.compile(r"\b([a-z_]+)=(True\b|'?\w*'?)")  # Argument of Python in a message
COUNT = re.compile(r"(\d[\d.]*) of (\d[\d.]*)|(\d[\d.]*)%")  # Count or percentage in a message
RED = re.compile(r"^error:|(?<= )NO$", re.MULTILINE)  # Words that are red on a terminal
# Beginning of a cell that is aligned to the right
NUMBER = re.compile(r"[-+±≤≥–]?\s?\d|–|-?inf|γ|$")


@dataclass
class Output:
    """Verbosity of a call, and its results so far."""

    json: bool = False  # results go to stdout as one object, words do not
    quiet: bool = False  # neither results nor progress are printed; errors are
    verbose: bool = False  # every message of progress is a line on stderr
    content: dict[str, Any] = field(default_factory=dict)  # the results, plain data

    def finish(self, command: str, code: int) -> None:
        """Print the object if ``json`` is set, with the command's name and exit code."""
        if self.json:
            from hitchopt.storage.files import strict_json

            echo(strict_json({"command": command, "exit_code": code, **self.content}))


def output() -> Output:
    """Return the output of the running command."""
    context = click.get_current_context(silent=True)
    if context is None:
        return Output()
    current: Output = context.meta.setdefault(KEY, Output())
    return current


def say(text: str, *, err: bool = False, **results: Any) -> None:
    """Write a line for people, and record the ``results`` that it tells.

    Lines go to stdout unless they are not wanted, or to stderr.
    """
    record(**results)
    if err or not (output().quiet or output().json):
        shown = in_options(text)
        echo(_wrapped(shown) if err and _on_terminal() else shown, err=err)


def _on_terminal() -> bool:
    """Return whether stderr is a terminal; it may be closed by ``2>&-``."""
    return sys.stderr is not None and sys.stderr.isatty()


def _wrapped(text: str) -> str:
    """Return lines of words that fit the terminal: what goes on is indented."""
    look: Any = {"subsequent_indent": "  ", "break_long_words": False, "break_on_hyphens": False}
    return "\n".join("\n".join(wrap(line, across(), **look)) for line in text.split("\n"))


def across() -> int:
    """Return the width of the terminal [characters]."""
    return shutil.get_terminal_size((DEFAULT_WIDTH, 0)).columns


def options() -> dict[str, str]:
    """Return the options of the running command by their names in Python."""
    context = click.get_current_context(silent=True)
    command = context and context.command
    if context is not None and isinstance(command, click.Group):
        command = command.commands.get(str(context.invoked_subcommand))
    given = [each for each in command.params if isinstance(each, click.Option)] if command else []
    return {str(each.name): max(each.opts, key=len) for each in given}


def in_options(text: str) -> str:
    """Return a text with options in place of Python's arguments, which end in ``=``."""
    known = options()

    def option(match: re.Match[str]) -> str:
        name, value = known.get(match[1]), match[2]
        return match[0] if name is None else f"{name} {'' if value == 'True' else value}".strip()

    return ARGUMENT.sub(option, text)


def record(**content: Any) -> None:
    """Add results, plain data, to the object that ``--json`` prints."""
    output().content.update(content)


def echo(text: str, *, err: bool = False) -> None:
    """Write a line in any encoding of the stream; a closed stream or pipe is no error."""
    stream = sys.stderr if err else sys.stdout
    if stream is None:  # closed by `>&-`
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        shown = text.encode(encoding, "replace").decode(encoding)
        click.echo(RED.sub(lambda word: click.style(word[0], fg="red", bold=True), shown), err=err)
    except BrokenPipeError:
        # The reader has left (`| head`): the exit code stays the same.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def table(title: str, rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as lines of text that fit the terminal.

    Rows are cells by their columns' heads, plain data: a bool is a verdict, None, nan and inf are
    dashes, numbers have four significant digits. Where the table is too wide its widest column of
    words wraps at words, and columns move together; numbers and names, such as cable 0, never wrap.
    """
    listed = [{head: _cell(value) for head, value in row.items()} for row in rows]
    heads = list(dict.fromkeys(head for row in listed for head in row))
    cells = {head: [row[head] for row in listed if head in row] for head in heads}
    widths = {head: max(map(len, (head, *cells[head]))) for head in heads}
    right = {h for h in heads[1:] if all(map(NUMBER.match, cells[h]))}
    excess = sum(widths.values()) + len(GAP) * (len(heads) - 1) - across()
    if excess > 0 and (texts := [head for head in heads if head not in right]):
        longest = max(texts, key=lambda head: widths[head])
        words = " ".join((longest, *cells[longest])).split(" ")
        widths[longest] = max(widths[longest] - excess, *map(len, words))
    gap = GAP if sum(widths.values()) + len(GAP) * (len(heads) - 1) <= across() else GAP[:1]
    rule = "─" * (sum(widths.values()) + len(gap) * (len(heads) - 1))
    first = {head: head for head in heads}
    lines = [line for row in (first, *listed) for line in _lines(row, widths, right, gap)]
    return "\n".join([title, lines[0], rule, *lines[1:]]).replace(NAME, " ")


def _lines(
    row: Mapping[str, str], widths: Mapping[str, int], right: Collection[str], gap: str
) -> Iterator[str]:
    """Yield the lines of a row, in which cells wrap at words if their columns are narrower."""
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
    return re.sub(r" (?=\d)", NAME, str(value)) if isinstance(value, str | int) else "–"


def quantities(title: str, values: Mapping[str, object]) -> str:
    """Return the table of some quantities, one a row."""
    return table(title, [{"quantity": name, "value": value} for name, value in values.items()])


def show_plan(title: str, motion: ho.Motion, certificate: ho.Certificate) -> None:
    """Report the phases and the certificate of a plan."""
    columns = ("name", "step", "start", "end", "remark")
    phases = [{name: getattr(phase, name) for name in columns} for phase in motion.phases]
    message = f"{phase_table(motion.phases)}\n\n{certificate_table(certificate)}\n"
    message = f"{title}\n{message}" if title else message
    say(message, title=title, phases=phases, certificate=certificate.to_dict())
    from hitchopt.checks.clearance import below_ground

    low = below_ground(motion)
    if low is not None:
        words = f"{', '.join(low.where)} is {-low.bound:.4g} m below z = 0 at t = {low.time:.4g} s"
        say(f"warning: {words}; give an arena, whose floor is the ground", err=True)


def phase_table(phases: Sequence[ho.Phase]) -> str:
    """Return the table of a plan's phases, with a column for remarks if there are any."""
    rows = []
    for p in phases:
        times = {"start": p.start, "end": p.end, "duration": p.end - p.start}
        cells = {name: f"{t:.3f} s" for name, t in times.items()}
        rows.append({"phase": p.name, "step": p.step, **cells})
        rows[-1] |= {"remark": p.remark} if p.remark else {}
    return table("Phases", rows)


def certificate_table(certificate: ho.Certificate) -> str:
    """Return the table of a certificate's checks, each with its worst value over all of time.

    Checks stand under the headings of their groups; a column says which hold unless all do. A line
    below says what binds.
    """
    rows: list[dict[str, object]] = []
    for heading, checks in certificate.groups.items():
        rows.append({"check": f"{heading}:"})
        for check in checks:
            rows.append({**check.row, "check": f" {check.name}"})
            rows[-1] |= {} if certificate.certified else {"holds": check.holds}
    shown = table("Certificate", rows)
    if not (certificate.certified and certificate.binding):
        return shown
    *names, last = certificate.binding
    words = f"{', '.join(names)} and {last} allow" if names else f"{last} allows"
    return f"{shown}\n\nas fast as {words}"


def span_text(values: Iterable[Any], digits: str = ".3f") -> str:
    """Return the smallest and largest of some values, or the one that all are."""
    listed = [float(value) for value in values]
    low, high = (f"{value + 0.0:{digits}}" for value in (min(listed), max(listed)))
    return low if low == high else f"{low} to {high}"


def done_of(message: str) -> tuple[float | None, float | None]:
    """Return progress and total in a message; None for both without a count."""
    match = COUNT.search(message)
    if match is None:
        return None, None
    done, total, percent = match.groups()
    if percent:
        return float(percent), 100.0
    return (float(done), float(total)) if float(total) > 0.0 else (None, None)


class ProgressBar:
    """Context manager and callback: shows what is being done, on a terminal, until it is done.

    The bar is filled by the count in a message, such as ``speed, 4 of 18``, or by its percentage;
    a time limit [s] is shown next to the elapsed time. With ``--verbose`` messages are lines.
    """

    def __init__(self, message: str, limit: float | None = None) -> None:
        self._message, self._begun = message, time.monotonic()
        self._at_most = "" if limit is None else f"of at most {limit:.0f} s"
        self._verbose, self._next_line = output().verbose, self._begun
        self._bar: Progress | None = None

    def __enter__(self) -> ProgressBar:
        if _on_terminal() and not (self._verbose or output().quiet):
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            words = TextColumn("{task.description}", markup=False)
            at_most, console = TextColumn(self._at_most, markup=False), Console(stderr=True)
            parts = words, BarColumn(BAR), TimeElapsedColumn(), at_most
            self._bar = Progress(*parts, console=console, transient=True)
            self._bar.add_task(self._message, total=None)  # until there is a count
            self._bar.start()
        self(self._message)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, message: str) -> None:
        """Show a message about the current work."""
        now = time.monotonic()
        if self._bar is not None:
            done, total = done_of(message)
            room = self._bar.console.width - BAR - CLOCK - len(self._at_most)
            words = message if len(message) <= room else f"{message[: room - 1]}…"
            self._bar.update(self._bar.task_ids[0], description=words, completed=done, total=total)
        elif self._verbose and not ("%" in message and now < self._next_line):
            echo(f"{now - self._begun:6.1f} s  {message}", err=True)
            self._next_line = now + LINES
