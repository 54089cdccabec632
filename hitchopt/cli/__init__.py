"""The command line; a command imports what it needs when it runs."""

from hitchopt.cli import calibrate_command as calibrate_command  # registers a command
from hitchopt.cli import fleet_commands as fleet_commands  # registers its commands
from hitchopt.cli import simulate_command as simulate_command  # and so does this
from hitchopt.cli import statics_command as statics_command  # and this
from hitchopt.cli.commands import main

__all__ = ["main"]
