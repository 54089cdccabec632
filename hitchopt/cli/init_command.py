"""The command ``init``: a problem file to start from, or an example."""

from __future__ import annotations

import click

from hitchopt.cli.commands import main
from hitchopt.cli.output import record, say
from hitchopt.cli.shell_completion import complete_example


@main.command()
@click.argument("name", required=False)
@click.option(
    "--example", metavar="EXAMPLE", shell_complete=complete_example, help="Write this example."
)
@click.option("--list", "listing", is_flag=True, help="List the examples.")
def init(name: str | None, example: str | None, listing: bool) -> None:
    """Write a commented problem file to start from, or an example.

    NAME is problem.yaml by default, or the example's name.
    """
    from hitchopt.cli.problem_templates import (
        all_examples,
        example_text,
        template_text,
        write_problem,
    )

    if listing:
        found = {path.stem: title for path, title in all_examples()}
        record(examples=[{"name": stem, "title": title} for stem, title in found.items()])
        width = max(map(len, found))
        say("\n".join(f"{stem:{width}}  {found[stem]}" for stem in found))
        return
    text = template_text() if example is None else example_text(example)
    path = write_problem(name if name is not None else example or "problem", text)
    record(file=str(path))
    say(f"wrote {path}; try: hitchopt solve {path}")
