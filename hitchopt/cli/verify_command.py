"""The command verify: the limits of a plan, proven by another method than the certificate's."""

from __future__ import annotations

from pathlib import Path

import click

from hitchopt.cli.commands import main
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path
from hitchopt.errors import FileError


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
def verify(directory: Path) -> None:
    """Prove the limits of the plan in DIR by sampling and rates, in code of its own.

    Ends with 0 where all are proven, with 3 where one is violated or not proven.
    """
    show_verified(plan_path(directory))


def show_verified(path: Path) -> None:
    """Prove the limits of a plan.npz, report every one, and exit with 3 unless all are proven."""
    from hitchopt.verify import UnreadableError, line, verdict, verify

    rows = []
    try:
        for row in verify(path):
            rows.append(row)
            say(line(row))
    except UnreadableError as error:
        raise FileError(f"{path}: not a plan, or a damaged one: {error}") from error
    record(verified=[row._asdict() for row in rows])
    say(verdict(rows))
    if any(row.verdict != "proven" for row in rows):
        click.get_current_context().exit(3)
