"""Live view, films and editing: how long a user waits.

Usage: python -m benchmarks.views [--drags N] [--output FILE]

Needs Chromium, Playwright (``pip install -e .[browser]``) and an otherwise idle machine.
"""

from __future__ import annotations

import argparse
import datetime
import io
import math
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.image import imread

import hitchopt as ho
from benchmarks.environment import busy, environment
from hitchopt.mission.memory import VARIABLE
from hitchopt.steps.certified_motions import Certified
from hitchopt.view.editing_session import Editing, Stage

if TYPE_CHECKING:
    from playwright.sync_api import FloatRect, Page

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"

COMMAND = (sys.executable, "-m", "hitchopt")

DRAWN = 0.002
"""Part of the picture that is coloured once the scene is there."""

SCENE: FloatRect = {"x": 340, "y": 100, "width": 470, "height": 320}
"""Part of a page that shows the scene alone, in live views and reports [pixels]."""

CIRCLE = 0.02
"""Radius of the circle on which a vertex is dragged about [m]."""

LONGEST = 120_000
"""Time after which Chromium is given up [ms]: machines may be busy."""

LIMITATIONS = (
    "one machine, whose cores others may use as well (see load); WebGL in software, on the same "
    "cores; the browser is open before the command is given; seconds of the clock on the wall, and "
    "processor seconds of the command and its children where they are told"
)

EDITED = (
    ("triangle.yaml", 0, "a morph, n = 3"),
    ("twelve_gon.yaml", 0, "a morph, n = 12"),
    ("tie_carry_untie.yaml", 1, "the second of five steps, n = 3"),
)
"""Problem files, the step whose vertex is dragged, and words."""


@dataclass(frozen=True)
class Row:
    """One figure of the table: what it is of, its value, the goal, and the load meanwhile."""

    what: str
    value: str
    goal: str
    load: float


def first_frame(file: str) -> Row:
    """Return the time from ``hitchopt view`` to the scene's picture in a browser that is open."""
    sys.path.insert(0, str(PROBLEMS.parent / "docs"))
    from generators.headless_page import opened_page

    with tempfile.TemporaryDirectory() as place, opened_page() as page:
        run("solve", "-q", PROBLEMS / file, "-o", place)
        page.set_default_timeout(LONGEST)
        page.goto("about:blank")
        used, before = children(), time.monotonic()
        others = running_children()
        served = subprocess.Popen(
            [*COMMAND, "view", place, "--no-browser", "--port", "8470"],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            assert served.stdout is not None
            words = next(line for line in served.stdout if "http://" in line and "plan is" in line)
            ready = time.monotonic() - before
            open_until_drawn(page, re.findall(r"http://\S+?(?=;)", words)[0])
            shown = time.monotonic() - before
            everything = running_children() - others
        finally:
            served.terminate()
            served.wait()
    processor = children() - used
    value = (
        f"{shown:.2f} s (served after {ready:.2f} s; until then {everything:.2f} s of processor, "
        f"Chromium's included; {processor:.2f} s for the command with its certificate)"
    )
    return Row(f"first frame of {file} in Chromium", value, "3 s", busy())


def one_box(*, lit_by_photograph: bool) -> Row:
    """Return the time from a page's opening to the picture of one box, by viser alone."""
    import viser
    from generators.headless_page import opened_page

    server = viser.ViserServer(port=8471, verbose=False)
    try:
        if not lit_by_photograph:
            server.scene.configure_environment_map(None)
            server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_box("/box", dimensions=(2.0, 2.0, 2.0), color=(255, 0, 0))
        with opened_page() as page:
            page.set_default_timeout(LONGEST)
            before = time.monotonic()
            open_until_drawn(page, "http://127.0.0.1:8471")
            shown = time.monotonic() - before
    finally:
        server.stop()
    light = "as it is" if lit_by_photograph else "without its environment map and shadows"
    what = f"one box in the same Chromium, viser {light}, its server's start not counted"
    return Row(what, f"{shown:.2f} s", "-", busy())


def report_frame(file: str) -> Row:
    """Return the time from a report's opening to its picture."""
    from generators.headless_page import opened_page

    with tempfile.TemporaryDirectory() as place, opened_page() as page:
        run("solve", "-q", PROBLEMS / file, "-o", place, "--report")
        page.set_default_timeout(LONGEST)
        page.goto("about:blank")
        before = time.monotonic()
        open_until_drawn(page, (Path(place) / "report.html").as_uri())
        shown = time.monotonic() - before
    return Row(
        f"first frame of the report of {file} in the same Chromium", f"{shown:.2f} s", "-", busy()
    )


def open_until_drawn(page: Page, address: str) -> None:
    """Open an address and wait until colours are seen there."""
    page.goto(address, wait_until="commit")
    page.wait_for_selector("canvas")
    while coloured(page.screenshot(clip=SCENE)) < DRAWN:
        page.wait_for_timeout(20)


def film(file: str) -> Row:
    """Return the time of a film over the duration of the flight."""
    with tempfile.TemporaryDirectory() as place:
        run("solve", "-q", PROBLEMS / file, "-o", place)
        duration = ho.load(place).duration
        used, before = children(), time.monotonic()
        run("view", place, "--save", Path(place) / "film.mp4")
        wall, processor = time.monotonic() - before, children() - used
    value = (
        f"{wall / duration:.2f} ({wall:.0f} s for {duration:.1f} s; {processor:.0f} s of processor)"
    )
    return Row(f"film of {file} in mp4, over the flight's duration", value, "2", busy())


def drags(file: str, step: int, words: str, count: int) -> Row:
    """Return the median time from a dragged vertex to its certified plan."""
    text = (PROBLEMS / file).read_text(encoding="utf-8")
    os.environ.pop(VARIABLE, None)  # steps before the one that is dragged are remembered in a view
    plan = ho.solve(PROBLEMS / file)
    editing = Editing(text, PROBLEMS / file, Certified(plan.motion, plan.certificate))
    at = np.array(editing.problem.mission[step].polygon.vertices[0])  # type: ignore[attr-defined]
    times, used = [], []
    for k in range(count):
        angle = 2.0 * math.pi * k / count
        place = np.array([*(at + CIRCLE * np.array([math.cos(angle), math.sin(angle)])), 0.0])
        begun, before = time.process_time(), time.monotonic()
        editing.drag(step, "vertex 0", place)
        editing.wait()
        if editing.status.stage is Stage.CURRENT:
            times.append(time.monotonic() - before)
            used.append(time.process_time() - begun)
    editing.close()
    goal = {3: "0.5 s", 12: "1.5 s"}[plan.motion.team.robots]
    processor = statistics.median(used)
    more = f"slowest {max(times):.2f} s, {len(times)} of {count} drags certified"
    value = f"{statistics.median(times):.2f} s ({more}; {processor:.2f} s of processor)"
    return Row(f"dragged vertex to certified plan: {words} (median)", value, goal, busy())


def run(*words: object) -> None:
    """Run a command of hitchopt."""
    subprocess.run([*COMMAND, *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def children() -> float:
    """Return the processor seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def running_children() -> float:
    """Return the processor seconds of all processes that run below this one, as Linux has them."""
    parents: dict[int, int] = {}
    used: dict[int, float] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        parents[int(path.parent.name)] = int(fields[1])
        used[int(path.parent.name)] = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    below = {os.getpid()}
    while more := {process for process, parent in parents.items() if parent in below} - below:
        below |= more
    return sum(used[process] for process in below - {os.getpid()})


def coloured(png: bytes) -> float:
    """Return the share of pixels that are not grey."""
    levels = np.asarray(imread(io.BytesIO(png), format="png"))[..., :3]
    return float(np.mean(np.ptp(levels, axis=-1) > 0.2))


def main() -> None:
    """Measure everything, print it, and write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drags", type=int, default=15)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    rows = [
        first_frame("form_twelve_gon.yaml"), one_box(lit_by_photograph=False),
        one_box(lit_by_photograph=True), report_frame("form_twelve_gon.yaml"),
        film("tie_carry_untie.yaml"),
    ]  # fmt: skip
    rows += [drags(*case, given.drags) for case in EDITED]
    table = [f"| {row.what} | {row.value} | {row.goal} | {row.load:.1f} |" for row in rows]
    lines = [
        "# Live view, films and editing\n",
        f"Measured on {datetime.date.today()}: {environment()}.\n",
        f"Limitations: {LIMITATIONS}.\n",
        "| what | measured | goal | load |\n|---|---|---|---|",
        *table,
        "",
    ]
    print("\n".join(lines))
    if given.output is not None:
        given.output.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
