"""Exit codes and stderr lines of errors; no mistake of a user ends in a traceback."""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from hitchopt.errors import FileError, HitchoptError, InputError
from hitchopt.interrupts import INTERRUPTED, ending_signals

WRONG = 2
"""Exit code of a file or usage that is wrong in itself."""

UNMET = 3
"""Exit code of a well-formed request that cannot be met, or whose certificate fails."""


class SafeGroup(click.Group):
    """A group of commands whose errors end in a message and an exit code."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; turn errors of hitchopt and of the file system into exit codes."""
        try:
            with ending_signals():
                return super().invoke(ctx)
        except HitchoptError as error:
            complain(error)
            ctx.exit(exit_code(error))
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)
        except OSError as error:  # a full disk, a directory that may not be written
            place = f"{error.filename}: " if error.filename else ""
            say(f"error: {place}{error.strerror or error}; check the path and its disk", err=True)
            ctx.exit(WRONG)


def exit_code(error: HitchoptError) -> int:
    """Return the exit code: WRONG for a wrong input or file, UNMET otherwise."""
    return WRONG if isinstance(error, InputError | FileError) else UNMET


def complain(error: HitchoptError) -> None:
    """Write every line of the error's message to stderr."""
    for line in str(error).splitlines() or [type(error).__name__]:
        say(f"error: {line}", err=True)


def say(text: str, *, err: bool = False) -> None:
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
