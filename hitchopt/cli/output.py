"""What one call of a command prints: tables for people, or one JSON object for scripts."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from typing import Any

import click

KEY = "hitchopt.output"
"""Key of a call's Output in click's contexts."""


@dataclass
class Output:
    """How much a call prints, and its results so far.

    Attributes
    ----------
    json: results go to stdout as one object, words do not.
    quiet: neither results nor progress are printed; errors are.
    verbose: every message of progress is a line on stderr.
    content: the results, plain data.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False
    content: dict[str, Any] = field(default_factory=dict)

    def finish(self, command: str, code: int) -> None:
        """Print the object, if one was asked for, with the command's name and exit code."""
        if self.json:
            from hitchopt.storage.strict_json import strict_json

            echo(strict_json({"command": command, "exit_code": code, **self.content}))


def output() -> Output:
    """Return the output of the running command."""
    context = click.get_current_context(silent=True)
    if context is None:
        return Output()
    found: Output = context.meta.setdefault(KEY, Output())
    return found


def say(text: str, *, err: bool = False) -> None:
    """Write a line for people: results to stdout unless they are not wanted, else to stderr."""
    if err or not (output().quiet or output().json):
        echo(text, err=err)


def hint(text: str) -> None:
    """Write a line on stderr that is no error and no result."""
    if not (output().quiet or output().json):
        echo(text, err=True)


def record(**content: Any) -> None:
    """Add results, plain data, to the object that ``--json`` prints."""
    output().content.update(content)


def echo(text: str, *, err: bool = False) -> None:
    """Write a line in any encoding of the stream; a closed stream or pipe is no error."""
    stream = sys.stderr if err else sys.stdout
    if stream is None:  # closed by `>&-`
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        click.echo(text.encode(encoding, "replace").decode(encoding), err=err)
    except BrokenPipeError:
        # The reader has left (`| head`): the exit code stays the same.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


class OutputCommand(click.Command):
    """A command with the options ``--json``, ``-q`` and ``-v``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for flags, name, text in (
            (("--json",), "json", "Print one JSON object to stdout, all else to stderr."),
            (("-q", "--quiet"), "quiet", "Print errors only."),
            (("-v", "--verbose"), "verbose", "Print every message of progress to stderr."),
        ):
            self.params.append(
                click.Option(
                    flags, is_flag=True, help=text, expose_value=False, callback=_setter(name)
                )
            )


def _setter(name: str) -> Any:
    """Return the callback that sets one of an Output's switches."""

    def switch(context: click.Context, _: click.Parameter, value: bool) -> None:
        setattr(context.meta.setdefault(KEY, Output()), name, value)

    return switch
