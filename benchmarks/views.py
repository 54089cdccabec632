"""Waiting times of live view, reports and films.

Usage: python -m benchmarks views

Needs Chromium, Playwright (``pip install -e .[browser]``) and an otherwise idle machine.
"""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.image import imread

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, ROOT, Table, parser

if TYPE_CHECKING:
    from playwright.sync_api import FloatRect, Page

COMMAND = (sys.executable, "-m", "hitchopt")

DRAWN = 0.002
"""Share of coloured pixels of a complete scene."""

SCENE: FloatRect = {"x": 340, "y": 100, "width": 470, "height": 320}
"""Part of a page with only the scene, in live views and reports [pixels]."""

LIMITATIONS = (
    "one machine; WebGL in software on the same cores; the browser is open before the command is "
    "given; seconds by the clock"
)


def live_frame(page: Page, place: str) -> float:
    """Return the time from ``hitchopt view`` to the scene's picture [s]."""
    start_time = time.monotonic()
    command = [*COMMAND, "view", place, "--no-browser", "--port", "8470"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert served.stdout is not None
        words = next(line for line in served.stdout if "http://" in line and "plan is" in line)
        open_until_drawn(page, re.findall(r"http://\S+?(?=;)", words)[0])
        return time.monotonic() - start_time
    finally:
        served.terminate()
        served.wait()


def report_frame(page: Page, place: str) -> float:
    """Return the time from a report's opening to its picture [s]."""
    start_time = time.monotonic()
    open_until_drawn(page, (Path(place) / "report.html").as_uri())
    return time.monotonic() - start_time


def open_until_drawn(page: Page, address: str) -> None:
    """Open an address and wait until the scene is drawn."""
    page.goto(address, wait_until="commit")
    page.wait_for_selector("canvas")
    while coloured(page.screenshot(clip=SCENE)) < DRAWN:
        page.wait_for_timeout(20)


def coloured(png: bytes) -> float:
    """Return the share of pixels that are not grey."""
    levels = np.asarray(imread(io.BytesIO(png), format="png"))[..., :3]
    return float(np.mean(np.ptp(levels, axis=-1) > 0.2))


def film(place: str) -> tuple[float, float]:
    """Return the time of a film over the duration of the flight, by the clock and of processors."""
    start_time, duration = os.times(), ho.load(place).duration
    run("view", place, "--save", Path(place) / "film.mp4")
    ended = os.times()
    used = sum(ended[2:4]) - sum(start_time[2:4])  # of finished processes
    return (ended.elapsed - start_time.elapsed) / duration, used / duration


def run(*words: object) -> None:
    """Run a command of hitchopt."""
    subprocess.run([*COMMAND, *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    """Print and write the table."""
    options = parser(__doc__).parse_args()
    sys.path.insert(0, str(ROOT / "docs"))
    from generators.headless_page import opened_page

    table = Table(options.output / "views.md", "Live view, reports and films", LIMITATIONS)
    table.section("", "what", "measured", "goal")
    with tempfile.TemporaryDirectory() as place:
        run("solve", "-q", PROBLEMS / "form_twelve_gon.yaml", "-o", place, "--report")
        with opened_page() as page:
            page.set_default_timeout(120_000)
            page.goto("about:blank")
            table.row("first frame of the live view, n = 12 [s]", live_frame(page, place), "3")
            table.row("first frame of the report, n = 12 [s]", report_frame(page, place), "")
        clock, processor = film(place)
        table.row("film over the flight's duration", clock, "2")
        table.row("processor time of the film over the flight's duration", processor, "")
