"""Who steers: keys of a terminal, or datagrams that are a heartbeat as well."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from hitchopt.flying.datagrams import Datagrams, json_object

KEYS = {
    " ": "toggle",
    "p": "pause",
    "r": "resume",
    "b": "back",
    "a": "abort",
    "l": "land",
    "q": "quit",
}
"""What keys ask for; ``toggle`` is pause or resume, ``quit`` ends what has not left its start. Of
signals there is ``end`` as well: land, or quit."""

WORDS = frozenset(KEYS.values())

KEYS_HELP = "space pause/resume, b back, a abort, l land, q quit before the start"


class OperatorLink:
    """Commands of an operator, and whether there still is one.

    Parameters
    ----------
    keys: reads the keys pressed since the last call, None where the terminal has gone.
    datagrams: socket for commands of another machine, whose heartbeats are then required:
        ``{"command": "pause"}``, or ``{}`` as a heartbeat alone.
    """

    def __init__(self, keys: Callable[[], str | None], datagrams: Datagrams | None = None) -> None:
        self._keys = keys
        self._datagrams = datagrams
        self._added: list[str] = []

    def add(self, command: str) -> None:
        """Give a command as if a key were pressed: signals do."""
        self._added.append(command)

    def commands(self) -> tuple[list[str], bool]:
        """Return the commands since the last call, and whether the operator was heard of."""
        found, self._added = self._added, []
        pressed = self._keys()
        found += [KEYS[key] for key in (pressed or "").lower() if key in KEYS]
        if self._datagrams is None:
            return found, pressed is not None
        heard = False
        for data, _ in self._datagrams.received():
            given = json_object(data).get("command")
            heard = heard or data.lstrip()[:1] == b"{"
            if given in WORDS:
                found.append(str(given))
        return found, heard


@contextmanager
def terminal_keys() -> Iterator[Callable[[], str | None]]:
    """Give a function that returns the keys pressed on standard input, None at its end.

    A terminal gives each key at once within the context, and shows none.
    """
    try:
        number = sys.stdin.fileno()
    except (AttributeError, ValueError, OSError):  # closed, or replaced by an object
        yield lambda: None
        return
    ended = False

    def pressed() -> str | None:
        nonlocal ended
        if ended:
            return None
        if not select.select([number], [], [], 0.0)[0]:
            return ""
        try:
            data = os.read(number, 1024)
        except OSError:  # the terminal has gone
            data = b""
        ended = not data
        return None if ended else data.decode("utf-8", "ignore")

    if not sys.stdin.isatty():
        yield pressed
        return
    import termios
    import tty

    before = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield pressed
    finally:
        with suppress(termios.error):  # the terminal may have gone
            termios.tcsetattr(number, termios.TCSADRAIN, before)
