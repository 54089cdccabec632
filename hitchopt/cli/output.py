"""Output of one command: tables and progress for people, or one JSON object."""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click

import hitchopt as ho

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.text import Text

KEY = "hitchopt.output"  # Key of a call's Output in click's contexts
# Width of tables that are not written to a terminal [characters], and number of drones, cables or
# vertices that are shown for one check
DEFAULT_WIDTH, MAX_NAMES = 100, 4
LINES = 1.0  # Shortest time between lines of percentages [s]
COUNT = re.compile(r"(\d[\d.]*) of (\d[\d.]*)|(\d[\d.]*)%")  # Count or percentage in a message
# Beginning of a cell that is aligned to the right
NUMBER = re.compile(r"[-+±≤≥–]? ?\d|–|-?inf|γ = |$")


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
        echo(text, err=err)


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
        click.echo(text.encode(encoding, "replace").decode(encoding), err=err)
    except BrokenPipeError:
        # The reader has left (`| head`): the exit code stays the same.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def table(title: str, rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as lines of text that fit the terminal.

    Rows are cells by their columns' heads, plain data: a bool is a verdict, None and nan are
    dashes, numbers have four significant digits. A row of a single cell is a heading.
    """
    from io import StringIO

    from rich import box
    from rich.console import Console
    from rich.table import Table

    listed = [{head: _cell(value) for head, value in row.items()} for row in rows]
    heads = list(dict.fromkeys(head for row in listed for head in row))
    grid = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        cells = [row[head].plain for row in listed if head in row]
        right = head != heads[0] and all(map(NUMBER.match, cells))
        grid.add_column(head, justify="right" if right else "left", overflow="fold")
    for row in listed:
        style = "bold" if len(row) == 1 < len(heads) else None
        grid.add_row(*(row.get(head, "") for head in heads), style=style)
    terminal = sys.stdout is not None and sys.stdout.isatty()  # closed by `>&-`
    width = shutil.get_terminal_size().columns if terminal else DEFAULT_WIDTH
    text = StringIO()
    # No markup: units in brackets are text.
    console = Console(file=text, width=width, force_terminal=terminal, markup=False, emoji=False)
    console.print(grid)
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines())


def _cell(value: object) -> Text:
    from rich.text import Text

    if isinstance(value, bool):
        return Text("yes", "green") if value else Text("NO", "bold red")
    if isinstance(value, list | tuple):
        return Text(", ").join(map(_cell, value)) if value else Text("none")
    if isinstance(value, float) and not math.isnan(value):
        return Text(f"{value:.4g}")
    return Text(str(value) if isinstance(value, str | int) else "–")


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

    Checks stand under the headings of their groups, and those closest to their limits are marked.
    A quantity without a limit has its assumption about the vertices in that column.
    """
    rows: list[dict[str, object]] = []
    closest = certificate.closest
    for heading, checks in certificate.groups.items():
        rows.append({"check": f"{heading}:"})
        rows += [{**_check_row(check), "": "◂" if check in closest else ""} for check in checks]
    shown = table("Certificate", rows)
    return f"{shown}\n\n ◂ closest to its limit" if closest else shown


def _check_row(check: ho.Check) -> dict[str, object]:
    limit = f"{'≥' if check.sense == 'min' else '≤'} {number(check.limit)}"
    if check.limit is None:
        limit = "–" if check.gamma is None else f"γ = {check.gamma:g}"
    where = ", ".join(check.where[:MAX_NAMES])
    if len(check.where) > MAX_NAMES:
        where += f", and {len(check.where) - MAX_NAMES} more"
    timed = check.worst is not None and math.isfinite(check.time)
    return {
        "check": f"  {check.name}",
        "worst": number(check.worst),
        "limit": limit,
        "unit": "" if check.unit == "1" else check.unit,
        "where": where,
        "when": f"{check.time:.3f} s" if timed else "",
        "holds": check.holds,
    }


def number(value: float | None) -> str:
    """Return ``value`` in six significant digits; infinite beyond all numbers, a dash for None."""
    if value is None:
        return "–"
    if abs(value) >= sys.float_info.max:
        return "inf" if value > 0 else "-inf"
    return f"{value:.6g}"


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
        terminal = sys.stderr is not None and sys.stderr.isatty()  # closed by `2>&-`
        if terminal and not (self._verbose or output().quiet):
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            words = TextColumn("{task.description}", markup=False)
            at_most, console = TextColumn(self._at_most, markup=False), Console(stderr=True)
            parts = words, BarColumn(), TimeElapsedColumn(), at_most
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
            self._bar.update(
                self._bar.task_ids[0], description=message, completed=done, total=total
            )
        elif self._verbose and not ("%" in message and now < self._next_line):
            echo(f"{now - self._begun:6.1f} s  {message}", err=True)
            self._next_line = now + LINES
