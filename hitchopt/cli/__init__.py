"""The command line; a command imports what it needs when it runs."""

from hitchopt.cli import abort_command as abort_command  # registers a command
from hitchopt.cli import calibrate_command as calibrate_command  # registers a command
from hitchopt.cli import fit_command as fit_command  # registers its command
from hitchopt.cli import fleet_commands as fleet_commands  # registers its commands
from hitchopt.cli import fly_command as fly_command  # registers its command
from hitchopt.cli import init_command as init_command  # and this
from hitchopt.cli import simulate_command as simulate_command  # and so does this
from hitchopt.cli import statics_command as statics_command  # and this
from hitchopt.cli import view_commands as view_commands  # and these
from hitchopt.cli.commands import main

__all__ = ["main"]
from hitchopt.cli import sweep_command as sweep_command  # and this
