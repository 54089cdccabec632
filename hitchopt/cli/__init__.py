"""The command line: the group of all commands; a command's module is imported when it runs."""

from __future__ import annotations

import click

from hitchopt.cli.failures import SafeGroup

# Commands by the headings of the help, and the modules that they are in
COMMANDS = {
    "Plan": {"init": "planning", "solve": "planning", "fit": "estimates"},
    "Trust": {
        "check": "planning",
        "verify": "planning",
        "simulate": "simulating",
        "statics": "estimates",
    },
    "Look": {"report": "pictures", "view": "pictures"},
    "Fly": {"export": "fleet", "lint": "fleet", "abort": "fleet", "fly": "fleet"},
    "Study": {"evaluate": "measuring", "calibrate": "estimates", "sweep": "simulating"},
}


@click.group(
    cls=SafeGroup,
    sections=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
)
@click.version_option(package_name="hitchopt", message="hitchopt, version %(version)s")
def main() -> None:
    """Plan how teams of quadrotors tie, reshape and untie polygonal cable hitches in midair.

    Every plan comes with a certificate that holds for all of continuous time.

    Exit codes: 0 done and certified; 2 the file or the usage is wrong in itself;
    3 well-formed, but it cannot be met, or its certificate fails; 130 and 143 ended by Ctrl-C and
    by SIGTERM, with no file half-written.
    """
