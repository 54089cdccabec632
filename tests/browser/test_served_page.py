"""The command serves a page that is opened before the plan is read."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from browsing import SHARP, drawn, tied_plan
from generators.headless_page import opened_page


def test_the_command_serves_a_plan_and_its_certificate(tmp_path: Path) -> None:
    tied_plan().save(tmp_path, rate=5.0)
    command = [sys.executable, "-m", "hitchopt", "view", str(tmp_path), "--no-browser"]
    options = ["--port", "8251"]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as served:
        try:
            assert served.stdout is not None
            words = next(line for line in served.stdout if line.startswith("the plan is at "))
            with opened_page() as page:
                page.goto(words.split()[4].rstrip(";") + SHARP)
                page.get_by_text("certified for all t").wait_for()
                drawn(page)
        finally:
            served.send_signal(signal.SIGINT)
            assert served.wait(timeout=30) == 130
