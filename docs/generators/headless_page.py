"""A headless Chromium, for pictures of pages and for their tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import sync_playwright

FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
"""WebGL in software: machines for tests have no graphics card."""

NAMES = ("chromium", "chromium-browser", "google-chrome")

SIZE = (1200, 800)
"""Width and height of a page [pixels]."""

LOCAL = ("file:", "data:", "blob:", "http://127.0.0.1:", "ws://127.0.0.1:")
"""Beginnings of addresses that stay on this machine."""


@contextmanager
def opened_page(size: tuple[int, int] = SIZE) -> Iterator[Any]:
    """Yield a page of a size [pixels]; fail if it logs an error or asks another machine."""
    path = next(filter(None, map(shutil.which, NAMES)), None)
    assert path, f"none of {', '.join(NAMES)} is installed; apt-get install chromium"
    wrong: list[str] = []

    def asked(address: str) -> None:
        if not address.startswith(LOCAL):
            wrong.append(f"asked for {address}")

    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=path, args=list(FLAGS))
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.on("request", lambda request: asked(request.url))
        page.on("websocket", lambda socket: asked(socket.url))
        page.on(
            "response",
            lambda answer: wrong.append(f"no {answer.url}") if answer.status >= 400 else None,
        )
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        page.on(
            "console",
            lambda message: wrong.append(message.text) if message.type == "error" else None,
        )
        yield page
        browser.close()
    assert not wrong, "\n".join(wrong)
