"""Exit codes and stderr lines of errors; no mistake of a user ends in a traceback."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any, NoReturn

import click

from hitchopt.cli.output import in_options, options, output, record, say
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError, UnitWarning
from hitchopt.storage.interrupts import INTERRUPTED, ending_signals

# Exit codes of invalid files and usage, and of valid requests that are infeasible or whose
# certificate fails
EXIT_USAGE, EXIT_INFEASIBLE = 2, 3
MAX_SUMMARY = 200  # Characters of a command's summary in the help


class SafeGroup(click.Group):
    """A group of commands whose errors end in a message and an exit code.

    ``sections`` are the headings of the help, each with its commands and the modules in
    ``hitchopt.cli`` that register them when they are imported.
    """

    def __init__(
        self, *args: Any, sections: Mapping[str, Mapping[str, str]] | None = None, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections or {}
        self.modules = {k: v for each in self.sections.values() for k, v in each.items()}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return [*dict.fromkeys((*self.modules, *super().list_commands(ctx)))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, its module imported; all of them for a word that is no command."""
        for module in {self.modules.get(cmd_name)} - {None} or {*self.modules.values()}:
            import_module(f"hitchopt.cli.{module}")
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands and their whole summaries under their headings."""
        for heading, names in self.sections.items():
            found = [(name, self.get_command(ctx, name)) for name in names]
            rows = [(name, each.get_short_help_str(MAX_SUMMARY)) for name, each in found if each]
            with formatter.section(heading):
                formatter.write_dl(rows)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Return the arguments; a wrong option of the group itself ends like all wrong usage."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            report_usage(error)
            ctx.exit(EXIT_USAGE)

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
            except click.UsageError as error:
                report_usage(error)
                ctx.exit(EXIT_USAGE)
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


def report_usage(error: click.UsageError) -> None:
    """Write the usage of the command and what is wrong to stderr."""
    if error.ctx is not None:
        say(f"{error.ctx.get_usage()}\nTry '{error.ctx.command_path} --help'.\n", err=True)
    say(f"error: {error.format_message()}", err=True)


def report_error(error: HitchoptError) -> None:
    """Write every line of the error's message to stderr; it is a result too."""
    from hitchopt.values.fields import Missing

    if isinstance(error, InputError) and error.key in (known := options()):
        value = Missing() if error.value is None or error.value is False else error.value
        error = InputError(known[error.key], value, error.bound, error.remedy)
    record(errors=_entries(error))
    for line in str(error).splitlines() or [type(error).__name__]:
        say(f"error: {line}", err=True)


def _entries(error: HitchoptError) -> list[dict[str, Any]]:
    """Return the error's parts: keys and places of wrong values, or the limits that are broken."""
    if isinstance(error, InputError):
        parts = getattr(error, "errors", (error,))
        places = [part._asdict() if part else {} for part in (each.place for each in parts)]
        named = zip(parts, places, strict=True)
        return [
            {"message": in_options(str(part)), "key": part.key, **place} for part, place in named
        ]
    if isinstance(error, InfeasibleError) and error.violations:
        return [{"message": in_options(str(v)), **vars(v)} for v in error.violations]
    return [{"message": in_options(str(error))}]
