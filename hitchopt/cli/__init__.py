"""The command line: the group of all commands, whose modules are imported on demand."""

from __future__ import annotations

import click

import hitchopt
from hitchopt.cli.failures import SafeGroup
from hitchopt.slices import commands

HEADINGS = ("Plan", "Trust", "Look", "Fly", "Study")  # Headings of the help

COMMANDS = {
    "Plan": {"init": "cli.planning", "solve": "cli.planning"},
    "Trust": {"check": "cli.planning"},
}
"""Commands of the core and their modules in hitchopt, by headings of the help."""


def sections() -> dict[str, dict[str, str]]:
    """Return all commands, also those of slices, by headings of the help."""
    of_slices = commands()
    return {each: COMMANDS.get(each, {}) | of_slices.get(each, {}) for each in HEADINGS}


def print_version(context: click.Context, _option: click.Parameter, value: bool) -> None:
    """Print the version and exit if the option is given."""
    if value and not context.resilient_parsing:
        click.echo(f"hitchopt, version {hitchopt.__version__}")
        context.exit()


@click.group(
    cls=SafeGroup,
    sections=sections(),
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=print_version,
    help="Show the version and exit.",
)
def main() -> None:
    """Plan how teams of quadrotors tie, reshape and untie polygonal cable hitches in midair.

    Every plan comes with a certificate that holds for all of continuous time.

    Exit codes: 0 done and certified; 2 the file or the usage is invalid; 3 the problem is valid but
    infeasible, or its certificate fails; 130 and 143 interrupted by Ctrl-C and by SIGTERM, leaving
    no incomplete files.
    """
