"""Paths on the command line: never empty; a plan is named by its directory or its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hitchopt.errors import InputError


class GivenPath(click.Path):
    """A path that is not empty: an unset shell variable must not mean this directory.

    Raises
    ------
    InputError: the path is empty.
    """

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if value == "" and param is not None:
            key = param.opts[0] if isinstance(param, click.Option) else param.human_readable_name
            raise InputError(key, "", "a path that is not empty", "name one; . is this directory")
        return super().convert(value, param, ctx)


def plan_path(given: Path) -> Path:
    """Return the path of the plan in a directory; the path of a plan is returned unchanged."""
    from hitchopt.storage.archive import PLAN

    own = given.name == PLAN and not given.is_dir()
    return given if own or given.is_file() else given / PLAN
