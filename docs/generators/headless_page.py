"""A headless Chromium for pictures and tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

from playwright.sync_api import sync_playwright

FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
"""Options for WebGL with software rendering."""

NAMES = ("chromium", "chromium-browser", "google-chrome")

SIZE = (1200, 800)
"""Width and height of a page [pixels]."""

LOCAL = ("file:", "data:", "blob:", "http://127.0.0.1:", "ws://127.0.0.1:")
"""Prefixes of addresses on this machine."""


@contextmanager
def opened_page(size: tuple[int, int] = SIZE) -> Iterator[Any]:
    """Yield a page of a size [pixels]; fail if it logs an error or accesses another machine."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    assert path, f"none of {', '.join(NAMES)} is installed; apt-get install chromium"
    errors: list[str] = []

    def check(address: str, status: int = 200) -> None:
        if status >= 400 or not address.startswith(LOCAL):
            errors.append(f"{address}: {status}")

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.on("request", lambda request: check(request.url))
        page.on("websocket", lambda socket: check(socket.url))
        page.on("response", lambda response: check(response.url, response.status))
        page.on("pageerror", lambda error: errors.append(f"error: {error}"))
        page.on(
            "console", lambda message: errors.extend([message.text] * (message.type == "error"))
        )
        yield page
        browser.close()
    assert not errors, "\n".join(errors)


class _SilentHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder; yield its address."""
    with ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(_SilentHandler, directory=str(folder))
    ) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
