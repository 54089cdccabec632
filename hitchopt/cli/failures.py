"""Exit codes and stderr lines of errors; no mistake of a user ends in a traceback."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any, NoReturn

import click

from hitchopt.cli.output import output, record, say
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, UnitWarning
from hitchopt.storage.interrupts import INTERRUPTED, ending_signals

# Exit codes of invalid files and usage, and of valid requests that are infeasible or whose
# certificate fails
EXIT_USAGE, EXIT_INFEASIBLE = 2, 3


class SafeGroup(click.Group):
    """A group of commands whose errors end in a message and an exit code.

    ``modules`` names the module in ``hitchopt.cli`` that registers a command when it is imported.
    """

    def __init__(self, *args: Any, modules: Mapping[str, str] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.modules = modules or {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return sorted({*super().list_commands(ctx), *self.modules})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, its module imported."""
        if cmd_name in self.modules:
            import_module(f"hitchopt.cli.{self.modules[cmd_name]}")
        return super().get_command(ctx, cmd_name)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command and print its results; turn errors into exit codes."""
        code = 0
        with ctx:
            try:
                with ending_signals(), warnings.catch_warnings():
                    warnings.simplefilter("once", UnitWarning)
                    warnings.showwarning = lambda words, *_: say(f"warning: {words}", err=True)
                    super().invoke(ctx)
            except click.exceptions.Exit as end:
                code = end.exit_code
            except HitchoptError as error:
                report_error(error)
                code = exit_code(error)
            except KeyboardInterrupt:  # raised by a solver that has caught the signal
                code = INTERRUPTED
            except SystemExit as end:  # raised by a signal; a library's own may be a message
                if not isinstance(end.code, int):
                    raise
                code = end.code
            except OSError as error:  # a full disk, a directory that may not be written
                place = f"{error.filename}: " if error.filename else ""
                words = f"{place}{error.strerror or error}; check the path and its disk"
                report_error(FileError(words))
                code = EXIT_USAGE
            output().finish(str(ctx.invoked_subcommand), code)
            ctx.exit(code)


def exit_code(error: HitchoptError) -> int:
    """Return the exit code: EXIT_USAGE for a wrong input or file, EXIT_INFEASIBLE otherwise."""
    return EXIT_USAGE if isinstance(error, InputError | FileError) else EXIT_INFEASIBLE


def exit_infeasible() -> NoReturn:
    """End the running command with EXIT_INFEASIBLE."""
    click.get_current_context().exit(EXIT_INFEASIBLE)


def report_error(error: HitchoptError) -> None:
    """Write every line of the error's message to stderr; it is a result too."""
    record(errors=_entries(error))
    for line in str(error).splitlines() or [type(error).__name__]:
        say(f"error: {line}", err=True)


def _entries(error: HitchoptError) -> list[dict[str, Any]]:
    """Return the error's parts: keys and places of wrong values, or the limits that are broken."""
    if isinstance(error, InputError):
        parts = getattr(error, "errors", (error,))
        places = [part._asdict() if part else {} for part in (each.place for each in parts)]
        named = zip(parts, places, strict=True)
        return [{"message": str(part), "key": part.key, **place} for part, place in named]
    if isinstance(error, InfeasibleError) and error.violations:
        return [{"message": str(v), **vars(v)} for v in error.violations]
    return [{"message": str(error)}]
