"""The command line; a command imports what it needs when it runs."""

from hitchopt.cli.commands import main as main
