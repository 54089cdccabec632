"""The command line; a command imports what it needs when it runs."""

from hitchopt.cli import fleet_commands as fleet_commands  # registers its commands
from hitchopt.cli import simulation as simulation  # and so does this
from hitchopt.cli.commands import main

__all__ = ["main"]
