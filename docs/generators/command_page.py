"""The reference of the command line, from the commands themselves."""

from __future__ import annotations

import click

from hitchopt.cli import main

INTRODUCTION = """# Command line

`hitchopt COMMAND --help` prints what this page says. {doc}`../exit_codes` lists what commands end with.
"""


def write_command_page() -> str:
    """Return the page: one section for every command, with its options in a table."""
    with click.Context(main, info_name="hitchopt") as parent:
        sections = [
            _section(command, click.Context(command, parent, info_name=name))
            for name in main.list_commands(parent)
            if (command := main.get_command(parent, name))
        ]
    return "\n".join([INTRODUCTION, _paragraphs(main.help), *sections])


def _section(command: click.Command, context: click.Context) -> str:
    usage = " ".join(command.collect_usage_pieces(context))
    name = context.info_name
    lines = [
        f"(command-{name})=",
        f"## `hitchopt {name}`",
        "",
        "```text",
        f"hitchopt {name} {usage}",
        "```",
        "",
        _paragraphs(command.help),
    ]
    records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
    rows = [f"| `{_cell(left)}` | {_cell(right)} |" for left, right in filter(None, records)]
    return "\n".join([*lines, "| option | meaning |", "|---|---|", *rows, ""])


def _paragraphs(text: str | None) -> str:
    lines = (text or "").replace("\b", "").splitlines()
    return "\n".join(line.strip() for line in lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", r"\|")
