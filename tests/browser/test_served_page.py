"""The live view's page from the start: opened before the plan is read, and by the command."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
from browsing import SHARP, drawn, tied_plan, waited
from generators.headless_page import opened_page

from hitchopt.view.live_server import open_server, server_address
from hitchopt.view.live_view import LiveView


def test_a_page_opened_before_the_plan_is_read_shows_it() -> None:
    plan = tied_plan()
    server = open_server(port=8241)
    with opened_page() as page:
        page.goto(server_address(server) + SHARP)
        page.wait_for_selector("canvas")
        waited(page, lambda: len(server.get_clients()) == 1)
        view = LiveView(plan.motion, None, "late", server=server)
        page.get_by_text("being certified").wait_for()
        assert view.wait_for_page(10.0)
        view.show_certificate(plan.certificate)
        page.get_by_text("certified for all t").wait_for()
        drawn(page)
        (client,) = server.get_clients().values()
        wanted = server.initial_camera.position
        np.testing.assert_allclose(client.camera.position, wanted, atol=1e-3)
        page.get_by_role("tab", name="Certificate").click()
        check = plan.certificate["separation"]
        page.get_by_role("button", name="✓ separation:").click()
        waited(page, lambda: abs(view.time - check.time) < 1e-3)
    view.close()


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
