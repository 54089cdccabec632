"""Output of commands: tables and progress as text, or one JSON object."""

from __future__ import annotations

import math
import os
import re
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

import hitchopt as ho
from hitchopt.tables import table, terminal_width

if TYPE_CHECKING:
    from hitchopt.motion.motion import Phase

if TYPE_CHECKING:
    from rich.progress import Progress

KEY = "hitchopt.output"  # Key of the Output in click's contexts
BAR_WIDTH = 20  # Width of a progress bar [characters]
CLOCK_WIDTH = 12  # Width of its clock with gaps [characters]
LINE_INTERVAL = 1.0  # Minimum time between lines of percentages [s]
FIRST_NOTICE = 20.0  # Time after which progress is printed without a terminal [s]
NOTICE_INTERVAL = 60.0  # Minimum time between further lines without a terminal [s]
ARGUMENT = re.compile(r"\b([a-z_]+)=(True\b|'?\w*'?)")  # Python argument in a message
COUNT = re.compile(r"(\d[\d.]*) of (\d[\d.]*)|(\d[\d.]*)%")  # Count or percentage in a message
# Control characters except line breaks and tabs, and those that change the direction of text
CONTROL = re.compile(r"\r(?!\n)|[^\r\n\t\x20-\x7e\xa0-\U0010ffff]|[\u202a-\u202e\u2066-\u2069]")
# Styles of text on a terminal
STYLES: tuple[tuple[re.Pattern[str], dict[str, Any]], ...] = (
    (re.compile(r"^error:|(?<= )NO$", re.MULTILINE), {"fg": "red", "bold": True}),
    (re.compile(r"^warning:", re.MULTILINE), {"fg": "yellow", "bold": True}),
    (re.compile(r"^(certified|proven)(?=[;:])", re.MULTILINE), {"fg": "green", "bold": True}),
    (re.compile(r"^.+(?=\n.+\n─)", re.MULTILINE), {"bold": True}),  # titles of tables
    (re.compile(r"^─+$", re.MULTILINE), {"dim": True}),
)


@dataclass
class Output:
    """Verbosity of a command, and its results."""

    json: bool = False  # print results as one JSON object instead of text
    quiet: bool = False  # print errors only
    verbose: bool = False  # print progress messages as lines on stderr
    content: dict[str, Any] = field(default_factory=dict)  # results as plain data

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
    """Print text to stdout, unless output is disabled, or to stderr; record the ``results``."""
    record(**results)
    if err or not (output().quiet or output().json):
        text = in_options(text)
        echo(_wrapped(text) if err and _on_terminal() else text, err=err)


def _on_terminal() -> bool:
    """Return whether stderr is a terminal; it may be closed by ``2>&-``."""
    return sys.stderr is not None and sys.stderr.isatty()


def _wrapped(text: str) -> str:
    """Wrap lines to the width of the terminal, with continuation lines indented."""
    style: Any = {"subsequent_indent": "  ", "break_long_words": False, "break_on_hyphens": False}
    return "\n".join("\n".join(wrap(line, terminal_width(), **style)) for line in text.split("\n"))


def options() -> dict[str, str]:
    """Return the options of the running command by Python names."""
    return {str(option.name): max(option.opts, key=len) for option in _declared_options()}


def negations() -> dict[str, str]:
    """Return the options of the running command that set a flag to False, by Python names."""
    return {
        str(option.name): max(option.secondary_opts, key=len)
        for option in _declared_options()
        if option.secondary_opts
    }


def _declared_options() -> list[click.Option]:
    """Return the options of the running command; none outside of one."""
    context = click.get_current_context(silent=True)
    command = context and context.command
    if context is not None and isinstance(command, click.Group):
        command = command.commands.get(str(context.invoked_subcommand))
    parameters = command.params if command else []
    return [each for each in parameters if isinstance(each, click.Option)]


def in_options(text: str) -> str:
    """Replace Python arguments such as ``rate=`` in a text by options of the running command."""
    names = options()

    def option(match: re.Match[str]) -> str:
        name, value = names.get(match[1]), match[2]
        return match[0] if name is None else f"{name} {'' if value == 'True' else value}".strip()

    return ARGUMENT.sub(option, text)


def record(**content: Any) -> None:
    """Add results, plain data, to the object printed by ``--json``."""
    output().content.update(content)


def echo(text: str, *, err: bool = False) -> None:
    """Write text in the stream's encoding; closed streams and pipes are ignored.

    Control characters, which names and files may have, are replaced: they would move the cursor or
    change the terminal's settings.
    """
    stream = sys.stderr if err else sys.stdout
    if stream is None:  # closed by `>&-`
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        text = CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)
        text = text.encode(encoding, "replace").decode(encoding)
        for pattern, style in STYLES:
            text = pattern.sub(partial(_styled, style), text)
        click.echo(text, err=err)
    except BrokenPipeError:
        # The reader has exited (`| head`); the exit code must not change.
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)


def _styled(style: Mapping[str, Any], match: re.Match[str]) -> str:
    return click.style(match[0], **style)


def quantities(title: str, values: Mapping[str, object]) -> str:
    """Return a table with one quantity per row."""
    return table(title, [{"quantity": name, "value": value} for name, value in values.items()])


def show_plan(title: str, flight: ho.Flight, certificate: ho.Certificate) -> None:
    """Report the phases and the certificate of a plan."""
    columns = ("name", "step", "start", "end", "remark")
    phases = [{name: getattr(phase, name) for name in columns} for phase in flight.phases]
    message = f"{phase_table(flight.phases)}\n\n{certificate}\n"
    message = f"{title}\n{message}" if title else message
    say(message, title=title, phases=phases, certificate=certificate.to_dict())


def show_notes(plan: ho.Plan) -> None:
    """Report the notes on a plan, one line each."""
    notes = plan.notes
    for note in notes:
        say(f"note: {note}")
    record(notes=notes)


MAX_PLACES = 40  # Drones whose positions are printed; all are in the JSON output


def show_places(flight: ho.Flight, addresses: Mapping[str, str] | None = None) -> None:
    """Report where drones of the problem are on the hitch, unless robot k holds edge k.

    ``addresses`` are those of drones by name.
    """
    from hitchopt.motion.flight import drone_places

    moved = {
        each.label(name)
        for each in flight.teams
        if (assignment := each.motion.team.assignment) and not assignment.is_identity
        for name in each.motion.team.listed_names
    }
    rows = [row for row in drone_places(flight) if row["drone"] in moved]
    if addresses:
        rows = [{**row, "address": addresses[row["drone"]]} for row in rows]
    if rows:
        more = f"… and {len(rows) - MAX_PLACES} more\n" if len(rows) > MAX_PLACES else ""
        say(f"{table('Positions on the hitch', rows[:MAX_PLACES])}\n{more}", places=rows)


def phase_table(phases: Sequence[Phase]) -> str:
    """Return the table of a plan's phases, with a column for remarks if there are any."""
    rows = []
    for p in phases:
        times = {"start": p.start, "end": p.end, "duration": p.end - p.start}
        cells = {name: f"{t:.3f} s" for name, t in times.items()}
        rows.append({"phase": p.name, "step": p.step, **cells})
        rows[-1] |= {"remark": p.remark} if p.remark else {}
    return table("Phases", rows)


def span_text(values: Iterable[Any], digits: str = ".3f") -> str:
    """Return the range of some values, as one number if they are equal."""
    numbers = [float(value) for value in values]
    low, high = (f"{value:z{digits}}" for value in (min(numbers), max(numbers)))  # no -0.0
    return low if low == high else f"{low} to {high}"


def known_text(*numbers: float, digits: str = ".1f") -> str:
    """Return numbers as text, or a dash if there is none or one is nan."""
    known = numbers and not any(map(math.isnan, numbers))
    return ", ".join(f"{x:z{digits}}" for x in numbers) if known else "–"  # z: no -0.0


def progress_in(message: str) -> tuple[float | None, float | None]:
    """Return the progress and total in a message; None for both if there is no count."""
    match = COUNT.search(message)
    if match is None:
        return None, None
    count, total, percent = match.groups()
    if percent:
        return float(percent), 100.0
    return (float(count), float(total)) if float(total) > 0.0 else (None, None)


class ProgressBar:
    """Context manager and status callback that shows a progress bar on a terminal.

    The bar shows the count in a message, such as ``speed, 4 of 18``, or its percentage, and a time
    limit [s] next to the elapsed time. With ``--verbose`` messages are printed as lines. Without a
    terminal, work of more than FIRST_NOTICE prints a line now and then.
    """

    def __init__(self, message: str, limit: float | None = None) -> None:
        self._message, self._start = message, time.monotonic()
        self._limit = "" if limit is None else f"of at most {limit:.0f} s"
        self._verbose, self._next_line = output().verbose, self._start
        self._next_notice = math.inf if output().quiet else self._start + FIRST_NOTICE
        self._bar: Progress | None = None

    def __enter__(self) -> ProgressBar:
        if _on_terminal() and not (self._verbose or output().quiet):
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            message = TextColumn("{task.description}", markup=False)
            limit, console = TextColumn(self._limit, markup=False), Console(stderr=True)
            columns = message, BarColumn(BAR_WIDTH), TimeElapsedColumn(), limit
            self._bar = Progress(*columns, console=console, transient=True)
            self._bar.add_task(self._message, total=None)
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
            count, total = progress_in(message)
            width = self._bar.console.width - BAR_WIDTH - CLOCK_WIDTH - len(self._limit)
            text = message if len(message) <= width else f"{message[: width - 1]}…"
            self._bar.update(self._bar.task_ids[0], description=text, completed=count, total=total)
        elif self._verbose and not ("%" in message and now < self._next_line):
            echo(f"{now - self._start:6.1f} s  {message}", err=True)
            self._next_line = now + LINE_INTERVAL
        elif not self._verbose and now >= self._next_notice:
            echo(f"{now - self._start:.0f} s: {message}", err=True)
            self._next_notice = now + NOTICE_INTERVAL
