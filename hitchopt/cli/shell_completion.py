"""Names that a shell completes on the command line."""

from __future__ import annotations

import click


def complete_format(_: click.Context, __: click.Parameter, begun: str) -> list[str]:
    """Return the names of export formats that begin so."""
    from hitchopt.exports.formats.known_formats import HOMES

    return [name for name in HOMES if name.startswith(begun)]


def complete_example(_: click.Context, __: click.Parameter, begun: str) -> list[str]:
    """Return the names of examples that begin so."""
    from hitchopt.cli.problem_templates import example_files

    return [path.stem for path in example_files() if path.stem.startswith(begun)]
