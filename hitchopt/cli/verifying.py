"""The command verify: proofs by the independent verifier."""

from __future__ import annotations

from pathlib import Path

from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import command, plan_path
from hitchopt.cli.output import ProgressBar, say
from hitchopt.errors import FileError
from hitchopt.tables import table


@command("directory DIR")
def verify(directory: Path) -> None:
    """Prove the limits of the plan in DIR with an independent verifier.

    Exits with code 0 if all are proven, and 3 if one is violated or not proven.
    """
    from hitchopt.plan import read_requested_plan
    from hitchopt.verify import PASSING, UnreadableError, cells, verdict, verify

    path = plan_path(directory)
    read_requested_plan(path)
    rows = []
    try:
        with ProgressBar("proving") as progress:
            for row in verify(path):
                rows.append(row)
                progress(f"checked: {row.name}")
    except UnreadableError as error:
        raise FileError(f"{path}: not a plan, or a damaged one: {error}") from error
    heads = ["check", "worst", "with errors", "limit", "unit", "where", "when", "verdict"]
    content = [dict(zip(heads, cells(row), strict=True)) for row in rows]
    for head, is_shown in (
        ("with errors", any(row["with errors"] for row in content)),
        ("verdict", any(row.verdict != "proven" for row in rows)),
    ):
        if not is_shown:
            content = [{key: row[key] for key in row if key != head} for row in content]
    say(f"{table('Limits', content)}\n\n{verdict(rows)}", verified=[row._asdict() for row in rows])
    if any(row.verdict not in PASSING for row in rows):
        exit_infeasible()
