"""A UDP socket that never waits, and addresses as users write them."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from hitchopt.errors import InputError, UnsupportedError

Address = tuple[str, int]

LARGEST = 65536
"""[B] No datagram is larger."""

MOST = 1000
"""Datagrams that are read at once: a flood must not stop the stream."""


def address(key: str, text: str) -> Address:
    """Return the numeric address that ``HOST:PORT`` names.

    Raises
    ------
    InputError: it is none, or the host is unknown.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise InputError(key, text, "HOST:PORT", "such as 127.0.0.1:14540")
    try:
        found = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(key, text, "a known host", f"write its address ({error})") from None
    return str(found[0][4][0]), int(port)


class Datagrams:
    """A UDP socket.

    Parameters
    ----------
    listen: where it receives; port 0 is any free one.

    Raises
    ------
    UnsupportedError: the address is taken, or not this machine's.
    """

    def __init__(self, listen: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(listen)
        except OSError as error:
            self._socket.close()
            words = f"{listen[0]}:{listen[1]} cannot be listened on: {error.strerror or error}"
            raise UnsupportedError(words) from None

    @property
    def port(self) -> int:
        """Port that it listens on."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; one that the network does not take is lost like any other."""
        with suppress(OSError):
            self._socket.sendto(data, to)

    def received(self) -> Iterator[tuple[bytes, Address]]:
        """Yield what has arrived, with its senders."""
        for _ in range(MOST):
            try:
                data, sender = self._socket.recvfrom(LARGEST)
            except BlockingIOError:
                return
            except OSError:  # an answer that a port is closed
                continue
            yield data, sender

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def json_object(data: bytes) -> dict[str, Any]:
    """Return the JSON object in a datagram; an empty one where there is none."""
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
