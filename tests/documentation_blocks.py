"""Code blocks of a page, executed one after the other in one directory and one namespace.

Blocks of Python share their names; what one prints is shown in the block after it. Blocks of YAML
that begin with a comment ``# name.yaml`` are written to files. In ``console`` blocks lines after
``$`` are commands, and what they print follows, unless nothing is shown.
"""

from __future__ import annotations

import io
import re
import shlex
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

import click
from click.testing import CliRunner

from hitchopt.cli import main

FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TINY = 1e-6  # Numbers below this are rounding, and differ between processors


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str  # or directive
    text: str


class Shown(NamedTuple):
    """What a block or command prints, what the page shows of it, and a command's exit code."""

    code: str
    printed: str
    shown: str
    status: int = 0


def blocks(text: str) -> list[Block]:
    """Return all fenced blocks of a page, without the indentation of lists."""
    found = []
    for indent, language, body in FENCE.findall(text):
        lines = [line.removeprefix(indent) for line in body.splitlines(keepends=True)]
        found.append(Block(language.strip(), "".join(lines)))
    return found


def executed(text: str) -> Iterator[Shown]:
    """Yield what the blocks of a page print, in the working directory."""
    page, status = blocks(text), 0
    names: dict[str, object] = {"__name__": "__main__"}
    for block, following in zip(page, [*page[1:], Block("", "")], strict=True):
        if block.language == "python":
            stream = io.StringIO()
            with redirect_stdout(stream):
                exec(compile(block.text, "<page>", "exec"), names)
            shown = following.text if following.language in {"", "text"} else ""
            yield Shown(block.text, stream.getvalue(), shown)
        elif block.language == "yaml" and (name := file_name(block)):
            Path(name).write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
                command, _, shown = part.partition("\n")
                if command == "echo $?":
                    yield Shown(command, f"{status}\n", shown)
                    continue
                status, printed = run(command)
                yield Shown(command, printed, shown, status)


def file_name(block: Block) -> str:
    """Return the name in the first comment of a block of YAML, or nothing."""
    found = re.match(r"# ([\w-]+\.yaml)\n", block.text)
    return found[1] if found else ""


def run(command: str) -> tuple[int, str]:
    """Return the exit code of a command of hitchopt, and all that it prints."""
    program, *arguments = shlex.split(command, comments=True)
    assert program == "hitchopt", f"{command}: only hitchopt is run"
    done = CliRunner().invoke(main, arguments, catch_exceptions=False, prog_name="hitchopt")
    return done.exit_code, click.unstyle(done.output)


def same(printed: str, shown: str) -> bool:
    """Return whether two texts agree: words exactly, numbers to the last digit but one shown.

    An ellipsis at the end of a line stands for the rest of it.
    """
    ours, theirs = printed.split("\n"), shown.split("\n")
    return len(ours) == len(theirs) and all(map(_same_line, ours, theirs))


def _same_line(printed: str, shown: str) -> bool:
    if shown.endswith("…"):
        return printed.startswith(shown.removesuffix("…").rstrip())
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", shown).split():
        return False
    return all(map(_same_number, NUMBER.findall(printed), NUMBER.findall(shown)))


def _same_number(printed: str, shown: str) -> bool:
    a, b = printed.replace("−", "-"), shown.replace("−", "-")
    x, y = float(a), float(b)
    if "." not in a + b and "e" not in a + b:
        return x == y
    places = max(len(each.partition("e")[0].partition(".")[2]) for each in (a, b))
    unit = 10.0 ** (float(b.partition("e")[2] or 0) - places)
    return abs(x - y) <= 1.5 * unit or max(abs(x), abs(y)) < TINY
