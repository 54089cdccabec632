"""Pages that may connect to the live view: those that its own server has sent.

Browsers let every page open a WebSocket to any address, including this machine's. ``Origin`` states
which server a page comes from, and ``Host`` the name by which it addresses this one. Names of other
domains may resolve to this machine, so the name must be an address or a name of this machine.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from hitchopt.errors import UnsupportedError, optional_module

REFUSAL = "This page is not one of hitchopt's live view.\n"


def is_own_page(headers: Mapping[str, str], host: str) -> bool:
    """Return whether a request for a WebSocket is from a page of the server at ``host``."""
    try:
        addressed = headers["Host"].lower()
        origin = urlsplit(headers["Origin"].lower())
        name = urlsplit(f"//{addressed}").hostname or ""
    except (LookupError, ValueError):  # missing, repeated, or no address
        return False
    return origin.netloc == addressed and _is_of_this_machine(name, host)


def _is_of_this_machine(name: str, host: str) -> bool:
    own = socket.gethostname().lower()
    if name in ("localhost", host.lower(), own, f"{own}.local", socket.getfqdn().lower()):
        return True
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def own_pages_only(host: str) -> Iterator[None]:
    """Refuse other pages' WebSockets (403) in the server that viser starts within the context.

    viser has no option for that. It starts its server by ``websockets.asyncio.server.serve``, which
    is replaced for the time of the context. UnsupportedError if viser does not call it.
    """
    module = optional_module("websockets.asyncio.server", "the live view needs", "view")
    serve = module.serve
    started = []

    def serve_own_pages(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            is_page = request.headers.get("Upgrade") is None
            if not (is_page or is_own_page(request.headers, host)):
                return connection.respond(HTTPStatus.FORBIDDEN, REFUSAL)
            return None if process_request is None else process_request(connection, request)

        started.append(True)
        return serve(*arguments, process_request=process, **options)

    module.serve = serve_own_pages
    try:
        yield
    finally:
        module.serve = serve
    if not started:
        raise UnsupportedError(
            "this version of viser would accept connections from all pages; install viser 1.1"
        )
