"""Exit codes and stderr lines of errors; user errors never end in a traceback."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NoReturn

import click

from hitchopt.cli.output import in_options, negations, options, output, record, say
from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    Missing,
    UnitWarning,
)
from hitchopt.retired import gone
from hitchopt.storage.interrupts import EXIT_INTERRUPTED, exit_on_signals

EXIT_USAGE = 2  # Exit code of invalid files and usage
EXIT_INFEASIBLE = 3  # Exit code of valid requests that are infeasible or whose certificate fails
MAX_SUMMARY = 200  # Characters of a command's summary in the help


class SafeGroup(click.Group):
    """A group of commands that turns errors into messages and exit codes.

    ``sections`` are the commands and their modules in ``hitchopt``, by headings of the help.
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
        """Return a command after importing its module, or all modules for an unknown name."""
        for module in {self.modules.get(cmd_name)} - {None} or {*self.modules.values()}:
            import_module(f"hitchopt.{module}")
        return super().get_command(ctx, cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command, or raise UsageError for an unknown name."""
        if sentence := gone(f"hitchopt {args[0]}"):
            raise click.UsageError(sentence, ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands and their full summaries under their headings."""
        if self.help is None:
            with formatter.indentation():
                formatter.write_paragraph()
                formatter.write_text("python -OO strips all descriptions: run it without -OO.")
        for heading, names in self.sections.items():
            commands = [(name, self.get_command(ctx, name)) for name in names]
            rows = [(name, each.get_short_help_str(MAX_SUMMARY)) for name, each in commands if each]
            with formatter.section(heading):
                formatter.write_dl(rows)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; an unknown option of the group is a usage error."""
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
                with exit_on_signals(), warnings.catch_warnings():
                    warnings.simplefilter("once", UnitWarning)
                    warnings.showwarning = _reporter()
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
                code = EXIT_INTERRUPTED
            except SystemExit as end:  # raised by a signal, or by a library with a message
                if not isinstance(end.code, int):
                    raise
                code = end.code
            except OSError as error:  # a full disk, a directory that is not writable
                file = f"{error.filename}: " if error.filename else ""
                reason = f"{error.strerror or error}; check the path and its disk"
                report_error(FileError(f"{file}{reason}"))
                code = EXIT_USAGE
            output().finish(str(ctx.invoked_subcommand), code)
            ctx.exit(code)


def _reporter() -> Callable[..., None]:
    """Return a function that reports warnings, once for copies of a value under shorter keys."""
    shown = set[tuple[str, str]]()

    def report(warning: Warning, *_: object) -> None:
        if isinstance(warning, UnitWarning):
            keys = warning.key.split(".")
            names = {(".".join(keys[i:]), warning.words) for i in range(len(keys))}
            is_copy = (warning.key, warning.words) in shown
            shown.update(names)
            if is_copy:
                return
        say(f"warning: {warning}", err=True)

    return report


def exit_code(error: HitchoptError) -> int:
    """Return the exit code: EXIT_USAGE for invalid inputs and files, EXIT_INFEASIBLE otherwise."""
    return EXIT_USAGE if isinstance(error, InputError | FileError) else EXIT_INFEASIBLE


def exit_infeasible() -> NoReturn:
    """End the running command with EXIT_INFEASIBLE."""
    click.get_current_context().exit(EXIT_INFEASIBLE)


def report_usage(error: click.UsageError) -> None:
    """Write the usage of the command and the error to stderr."""
    if error.ctx is not None:
        say(f"{error.ctx.get_usage()}\nTry '{error.ctx.command_path} --help'.\n", err=True)
    sentence = ""
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        sentence = gone(f"{error.ctx.info_name} {error.option_name}")
    say(f"error: {sentence or error.format_message()}", err=True)


def report_error(error: HitchoptError) -> None:
    """Write every line of the error's message to stderr, and record the error as a result.

    Lines on attempts are notes, unless nothing else says what is wrong.
    """
    names = options()
    if isinstance(error, InputError) and error.place is None and error.key in names:
        name, value = names[error.key], error.value
        if value is False and error.key in (negated := negations()):
            name, value = negated[error.key], True
        elif value is None or value is False:
            value = Missing()
        error = InputError(name, value, error.bound, error.remedy)
    record(errors=_entries(error))
    notes = list[str]()
    if isinstance(error, InfeasibleError) and error.violations:
        notes = error.notes
    lines = str(error).splitlines() or [type(error).__name__]
    for index, line in enumerate(lines):
        kind = "note" if index >= len(lines) - len(notes) else "error"
        say(f"{kind}: {line}", err=True)


def _entries(error: HitchoptError) -> list[dict[str, Any]]:
    """Return an error as plain data: keys and positions of invalid values, or violated limits."""
    if isinstance(error, InputError):
        parts = getattr(error, "errors", (error,))
        places = [part.place._asdict() if part.place else {} for part in parts]
        return [
            {"message": in_options(str(part)), "key": part.key, **place}
            for part, place in zip(parts, places, strict=True)
        ]
    if isinstance(error, InfeasibleError) and error.violations:
        return [{"message": in_options(str(v)), **v.to_dict()} for v in error.violations]
    return [{"message": in_options(str(error))}]
