"""Declare commands and their options; paths are never empty."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from hitchopt.cli import main
from hitchopt.cli.output import output
from hitchopt.errors import InputError


class GivenPath(click.Path):
    """A path; an empty one is an InputError: an unset shell variable is not this directory."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if value == "" and param is not None:
            key = param.opts[-1] if isinstance(param, click.Option) else param.human_readable_name
            raise InputError(key, "", "a path that is not empty", "name one; . is this directory")
        return super().convert(value, param, ctx)


PATH = GivenPath()


def option(
    names: str,
    words: str,
    value: Any = False,
    metavar: str | None = None,
    *,
    choices: Sequence[str] = (),
    **more: Any,
) -> click.Option:
    """Return an option by its names and help.

    ``value`` is its default, or its type if it has none; False is the default of a flag. ``more``
    are further arguments of ``click.Option``.
    """
    settings: dict[str, Any] = {"help": words, "metavar": metavar}
    if isinstance(value, type | click.ParamType):
        settings["type"] = value
    else:
        settings |= {"default": value, "nargs": len(value) if isinstance(value, tuple) else 1}
    if choices:
        settings["type"] = click.Choice(choices)
    elif value is False:
        settings["is_flag"] = True
    return click.Option(names.split(), **settings, **more)


def command(
    argument: str, *options: click.Option, **more: Any
) -> Callable[[Callable[..., None]], click.Command]:
    """Return the decorator that makes a function a command of the function's name.

    ``argument`` is the parameter's name and how usage calls it, ``directory DIR``: a path, unless
    ``more``, further arguments of ``click.Argument``, give another type.
    """
    name, metavar = argument.split()
    given = click.Argument([name], metavar=metavar, **{"type": PATH, **more})
    switch: Any = {"expose_value": False, "callback": _switch}
    switches = (
        option("--json", "Print one JSON object to stdout, all else to stderr.", **switch),
        option("-q --quiet", "Print errors only.", **switch),
        option("-v --verbose", "Print every message of progress to stderr.", **switch),
    )
    return main.command(params=[given, *options, *switches])


def _switch(_: click.Context, option: click.Parameter, value: bool) -> None:
    setattr(output(), str(option.name), value)


def completing(names: Callable[[], Iterable[str]]) -> dict[str, Any]:
    """Return settings of click's option that complete names in the shell."""
    return {"shell_complete": lambda _, __, prefix: [x for x in names() if x.startswith(prefix)]}


def plan_path(given: Path) -> Path:
    """Return the path of the plan in a directory; the path of a plan is returned unchanged."""
    from hitchopt.storage.archive import PLAN

    own = given.name == PLAN and not given.is_dir()
    return given if own or given.is_file() else given / PLAN
