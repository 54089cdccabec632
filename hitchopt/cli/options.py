"""Declare commands by a line of text for each option; paths are never empty."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click

from hitchopt.cli import main
from hitchopt.cli.output import output
from hitchopt.errors import InputError

# An option: ``--rate HZ (100.0): help``; in brackets its default, or its type without one
LINE = re.compile(
    r"(?P<flags>-[^\s,:]+(?:, -[^\s,:]+)*)(?: (?P<metavar>[^(]+?))?(?: \((?P<value>.*?)\))?: "
    r"(?P<help>.*)"
)
# Options of every command
OUTPUT = """
--json: Print one JSON object to stdout, all else to stderr.
-q, --quiet: Print errors only.
-v, --verbose: Print every message of progress to stderr.
"""


class GivenPath(click.Path):
    """A path; an empty one is an InputError: an unset shell variable is not this directory."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if value == "" and param is not None:
            key = param.opts[0] if isinstance(param, click.Option) else param.human_readable_name
            raise InputError(key, "", "a path that is not empty", "name one; . is this directory")
        return super().convert(value, param, ctx)


# Types of options that have no default, as they are written in brackets
TYPES: dict[str, Any] = {"path": GivenPath(), "float": float, "int": int, "text": str}


def command(
    argument: str = "", options: str = "", **more: dict[str, Any]
) -> Callable[[Callable[..., None]], click.Command]:
    """Return the decorator that makes a function a command of the function's name.

    ``argument`` is the parameter's name and how usage calls it, ``directory DIR``: a path. Options
    follow one another, each as LINE has it; a value such as ``fast|accurate`` is a choice, one
    without a value a flag. ``more`` is what click is given besides, such as ``multiple``, by name.
    """
    name, metavar = argument.split()
    settings = {"type": GivenPath(), **more.pop(name, {})}
    parameters: list[click.Parameter] = [click.Argument([name], metavar=metavar, **settings)]
    parameters += [_option(entry, more) for entry in _entries(options)]
    switch = {"expose_value": False, "callback": _switch}
    switches = {name: dict(switch) for name in ("json", "quiet", "verbose")}
    parameters += [_option(entry, switches) for entry in _entries(OUTPUT)]
    return main.command(params=parameters)


def _switch(_: click.Context, option: click.Parameter, value: bool) -> None:
    setattr(output(), str(option.name), value)


def _entries(options: str) -> list[str]:
    lines = re.split(r"\n(?=-)", textwrap.dedent(options).strip())
    return [" ".join(line.split()) for line in lines if line]


def _option(entry: str, more: dict[str, dict[str, Any]]) -> click.Option:
    match = LINE.fullmatch(entry)
    if match is None:
        raise ValueError(f"no option: {entry}")
    flags, metavar, value = match["flags"].split(", "), match["metavar"], match["value"]
    settings: dict[str, Any] = {"help": match["help"]}
    if metavar is None:
        settings.update({"default": ast.literal_eval(value)} if value else {"is_flag": True})
    elif "|" in metavar:
        settings.update(type=click.Choice(metavar.split("|")), default=value)
    elif value in TYPES:
        settings.update(metavar=metavar, type=TYPES[value])
    elif value is not None:
        default = ast.literal_eval(value)
        count = len(default) if isinstance(default, tuple) else 1
        settings.update(metavar=metavar, default=default, nargs=count)
    else:
        settings.update(metavar=metavar)
    name = flags[-1].partition("/")[0].lstrip("-").replace("-", "_")
    settings.update(more.get(name, {}))
    return click.Option([*flags, settings.pop("name", name)], **settings)


def completing(names: Callable[[], Iterable[str]]) -> dict[str, Any]:
    """Return settings of click's option that complete names in the shell."""
    return {"shell_complete": lambda _, __, prefix: [x for x in names() if x.startswith(prefix)]}


def plan_path(given: Path) -> Path:
    """Return the path of the plan in a directory; the path of a plan is returned unchanged."""
    from hitchopt.storage.archive import PLAN

    own = given.name == PLAN and not given.is_dir()
    return given if own or given.is_file() else given / PLAN
