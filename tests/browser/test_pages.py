"""Report and live view in a headless Chromium: what is seen, and what clicks do."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from generators.headless_page import opened_page
from matplotlib.image import imread

import hitchopt as ho
from hitchopt.geometry.vectors import unit
from hitchopt.values import Array
from hitchopt.view.live import LiveView
from hitchopt.view.scene import Highlight

SETTLE = 1500  # Least time for which a page draws what it was sent [ms]; software draws slowly
# End of a live view's address: slow graphics do not lower its resolution, which alters all
SHARP = "/?fixedDpr=1"
NEAR = 5.0  # Largest distance of a drawn drone to its place in the plan [pixels]
NOTHING = "{drones: [], cables: [], vertices: []}"


@cache
def tied_plan() -> ho.Plan:
    """Return the plan that the pages show: a hitch tied off the origin."""
    team = ho.Team(robots=3, cable_length=[2.4, 2.5, 2.4])
    q = np.array([[0.4, -2.2, 1.0], [0.4, -1.0, 1.0], [0.4, 0.2, 1.0]])
    triangle = [[1.1, -0.3], [1.6, -1.2], [0.6, -1.3]]
    return ho.form(team, q, q + [1.2, 0.0, 0.0], triangle, altitude=1.5)


def place_of_q0() -> int:
    """Return where q0 is along the hitch, which is the order of drawn drones."""
    return tied_plan().motion.team.drone_names.index("q0")


def projected(point: Any, eye: Any, target: Any, view: float, size: tuple[float, float]) -> Array:
    """Return where a camera sees a point (3,), (2,) [pixels] from the upper left corner.

    ``view`` is its vertical field of view [rad], ``size`` the picture's width and height [pixels].
    """
    forward, away = unit(np.subtract(target, eye)), np.subtract(point, eye)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    scale = 0.5 * size[1] / np.tan(0.5 * view) / (away @ forward)
    seen = np.array([away @ right, -away @ np.cross(right, forward)])
    return np.asarray(0.5 * np.array(size) + scale * seen)


def levels(png: bytes) -> Array:
    return np.asarray(imread(io.BytesIO(png), format="png")[..., :3], dtype=np.float64)


def changed_place(picture: Callable[[], bytes], change: Callable[[], None]) -> Array:
    """Return the middle of what a change alters in a picture (2,) [pixels]."""
    before = levels(picture())
    change()
    altered = np.max(np.abs(levels(picture()) - before), axis=-1) > 0.1
    rows, columns = np.nonzero(altered)
    assert len(rows) > 20, "nothing has changed"
    return np.array([np.mean(columns) + 0.5, np.mean(rows) + 0.5])


def waited(page: Any, holds: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    for _ in range(100):
        if holds():
            return
        page.wait_for_timeout(100)
    raise AssertionError("the page has not answered")


def settled(page: Any) -> None:
    """Wait until a page has shown the same picture three times; busy machines draw late."""
    page.wait_for_timeout(SETTLE)
    shown = [b"", page.screenshot()]
    while len(set(shown[-3:])) > 1 and len(shown) < 30:
        page.wait_for_timeout(300)
        shown.append(page.screenshot())


def opened(page: Any, address: str, words: str) -> None:
    """Open a live view, and wait until its scene is there, its camera too."""
    page.goto(address + SHARP)
    page.wait_for_selector("canvas")
    page.get_by_text(words).wait_for()
    clip = {"x": 0, "y": 200, "width": 800, "height": 600}
    waited(page, lambda: coloured(page, clip) > 0.002)
    settled(page)


def coloured(page: Any, clip: Any) -> float:
    """Return the share of a part of a page that is neither white nor grey."""
    return float(np.mean(np.ptp(levels(page.screenshot(clip=clip)), axis=-1) > 0.2))


def seen_at(page: Any, live: LiveView, point: Any) -> Array:
    """Return where a live view's page shows a point (3,), (2,) [pixels] from its canvas' corner."""
    (camera,) = (client.camera for client in live.server.get_clients().values())
    box = page.locator("canvas").first.bounding_box()
    size = (box["width"], box["height"])
    return projected(point, camera.position, camera.look_at, camera.fov, size)


@pytest.fixture(scope="class")  # one page at a time
def report(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    path: Path = tied_plan().report(tmp_path_factory.mktemp("report"))
    with opened_page() as page:
        page.goto(path.as_uri())
        waited(page, lambda: bool(page.evaluate("Boolean(window.hitchopt)")))
        yield page


@pytest.fixture(scope="module")
def live() -> Iterator[LiveView]:
    view = tied_plan().view(browser=False, port=8231)
    assert view is not None
    yield view
    view.close()


@pytest.fixture(scope="class")  # one page at a time
def page(live: LiveView) -> Iterator[Any]:
    with opened_page() as page:
        opened(page, live.url, "certified for all t")
        yield page


class TestReport:
    """The report, opened from the disk."""

    @pytest.mark.parametrize("share", [0.08, 0.52, 0.97])
    def test_a_report_shows_q0_where_the_plan_has_it(self, report: Any, share: float) -> None:
        time = share * tied_plan().duration
        report.evaluate(f"hitchopt.stage.on.names = false; hitchopt.stage.mark({NOTHING})")
        report.evaluate(f"hitchopt.seek({time})")
        seen_by = report.evaluate(
            "(({ camera, controls, place }) => [camera.position.toArray(), "
            "controls.target.toArray(), camera.fov * Math.PI / 180, "
            "[place.clientWidth, place.clientHeight]])(hitchopt.stage)"
        )
        expected = projected(tied_plan().at(time).positions[0], *seen_by)
        marked = f"{{drones: [{place_of_q0()}], cables: [], vertices: []}}"
        mark = f"hitchopt.stage.mark({marked})"
        # Marked drones are named: what is compared is the scene alone.
        report.add_style_tag(content="#labels, #switches { display: none }")
        stage = report.locator("#stage")
        seen = changed_place(stage.screenshot, lambda: report.evaluate(mark))
        assert np.linalg.norm(seen - expected) < NEAR

    def test_clicks_on_a_report_s_phases_and_checks_and_scrubbing(self, report: Any) -> None:
        plan = tied_plan()

        def shows(time: float, name: str) -> None:
            assert report.evaluate("hitchopt.time") == pytest.approx(time, abs=1e-3)
            assert name in report.locator("#phases tr.now").inner_text()

        for i, phase in enumerate(plan.phases):
            report.locator(f"#strip button[data-phase='{i}']").click(force=True)
            shows(phase.start, phase.name)
            assert phase.name in report.locator("#clock").inner_text()
            middle = 0.5 * (phase.start + phase.end)
            report.locator("#scrub").fill(str(middle))
            shows(middle, phase.name)
        for check in plan.certificate.checks:
            report.locator(f"#checks tr[data-check='{check.name}']").click()
            assert report.evaluate("hitchopt.time") == pytest.approx(check.time, abs=1e-3)
            assert check.name in report.locator("#checks tr.shown").inner_text()
            assert check.name in report.locator("#concerned").inner_text()
        report.locator("#checks tr[data-check='separation']").click()
        names = plan.motion.team.drone_names
        marked = report.evaluate("hitchopt.stage.highlight.drones")
        assert {names[i] for i in marked} == set(plan.certificate["separation"].where)
        report.evaluate("hitchopt.seek(0)")
        report.locator("#play").click()
        waited(report, lambda: bool(report.evaluate("hitchopt.time > 0.2")))
        report.locator("#play").click()
        assert not report.evaluate("hitchopt.playing")

    def test_space_plays_whatever_was_clicked_and_follow_keeps_the_drones_in_the_middle(
        self, report: Any
    ) -> None:
        report.locator("#strip button").first.click(force=True)
        report.keyboard.press("Space")
        waited(report, lambda: bool(report.evaluate("hitchopt.playing && hitchopt.time > 0.2")))
        report.locator("#scrub").click()
        report.keyboard.press("Space")
        assert not report.evaluate("hitchopt.playing")
        report.evaluate("hitchopt.stage.switch('follow', true)")
        for share in (0.2, 0.9):
            time = share * tied_plan().duration
            report.evaluate(f"hitchopt.seek({time})")
            middle = np.mean(tied_plan().at(time).positions, axis=0)
            target = report.evaluate("hitchopt.stage.controls.target.toArray()")
            np.testing.assert_allclose(target, middle, atol=0.01)
        report.evaluate("hitchopt.stage.switch('follow', false)")

    def test_plots_say_the_value_at_the_cursor_and_trails_last_5_s(self, report: Any) -> None:
        time = 0.6 * tied_plan().duration
        report.evaluate(f"hitchopt.seek({time})")
        (speed,) = report.evaluate(
            "[...document.querySelectorAll('#plots .value')].slice(1, 2).map((e) => e.textContent)"
        )
        fastest = np.max(np.linalg.norm(tied_plan().at(time).velocities, axis=-1))
        assert float(speed) == pytest.approx(fastest, abs=0.01)
        first, count = report.evaluate(
            "(({ start, count }) => [start, count])(hitchopt.stage.paths.geometry.drawRange)"
        )
        drones, times = 2 * tied_plan().motion.team.drones, report.evaluate("hitchopt.data.t")
        assert times[first // drones] == pytest.approx(time - 5.0, abs=0.1)
        assert times[(first + count) // drones] == pytest.approx(time, abs=0.1)

    def test_phases_slider_and_plots_have_one_axis_of_time_and_bars_show_used_limits(
        self, report: Any
    ) -> None:
        strip = report.locator("#strip").bounding_box()
        slider = report.locator("#scrub").bounding_box()
        plot = report.locator("#plots rect.axis").first.bounding_box()
        for name in ("x", "width"):
            assert strip[name] == pytest.approx(plot[name], abs=1.5)
        assert slider["x"] + 8 == pytest.approx(strip["x"], abs=1.5)  # a thumb's half width
        table = report.locator("#checks").bounding_box()  # with its verdicts within the page
        assert table["x"] + table["width"] <= 1190
        speed = tied_plan().certificate["speed"]
        share = report.evaluate(
            "getComputedStyle(document.querySelector(\"#checks [data-check='speed'] .used\"))"
            ".getPropertyValue('--share')"
        )
        assert float(share.strip("%")) == pytest.approx(100 * speed.worst / speed.number)

    def test_panels_leave_the_scene_its_space_and_fold_on_small_pages(self, report: Any) -> None:
        def width() -> float:
            return float(report.locator("#stage").bounding_box()["width"])

        report.set_viewport_size({"width": 1280, "height": 480})
        assert width() >= 0.7 * 1280
        assert report.locator("#strip").is_visible()
        strip = report.locator("#strip").bounding_box()
        assert strip["y"] + strip["height"] <= 480
        report.set_viewport_size({"width": 400, "height": 800})
        report.reload()
        waited(report, lambda: bool(report.evaluate("Boolean(window.hitchopt)")))
        assert width() == 400
        assert not report.locator("#checks").is_visible()
        strip = report.locator("#strip").bounding_box()
        assert strip["y"] + strip["height"] <= 800
        blocks = "[...document.querySelectorAll('#strip button')]"
        names = report.evaluate(f"{blocks}.map((block) => block.textContent)")
        whole = [phase.name for phase in tied_plan().phases]
        assert all(name in ("", phase) for name, phase in zip(names, whole, strict=True))
        assert not any(report.evaluate(f"{blocks}.map((b) => b.scrollWidth > b.clientWidth)"))
        report.set_viewport_size({"width": 1200, "height": 800})
        report.reload()
        waited(report, lambda: bool(report.evaluate("Boolean(window.hitchopt)")))


class TestLiveView:
    """The live view of a plan."""

    @pytest.mark.parametrize("share", [0.08, 0.52, 0.97])
    def test_a_live_view_shows_q0_where_the_plan_has_it(
        self, page: Any, live: LiveView, share: float
    ) -> None:
        plan = tied_plan()
        time = share * plan.duration
        live.live.highlight(Highlight())
        live.seek(time)
        settled(page)
        box = page.locator("canvas").first.bounding_box()

        def mark() -> None:
            live.live.highlight(Highlight(drones=(place_of_q0(),)))
            settled(page)

        seen = changed_place(lambda: page.screenshot(clip=box), mark)
        assert np.linalg.norm(seen - seen_at(page, live, plan.at(time).positions[0])) < NEAR

    def test_clicks_on_a_live_view_s_phases_and_checks_and_a_typed_time(
        self, page: Any, live: LiveView
    ) -> None:
        plan = tied_plan()
        phase = plan.phases[2]
        page.get_by_text(f"{phase.name}: {phase.start:.2f}").click()
        waited(page, lambda: abs(live.time - phase.start) < 1e-3)
        page.get_by_text(f"{phase.start:.2f} s").first.wait_for()
        middle = round(0.5 * (phase.start + phase.end), 3)
        live.seek(0.0)
        settled(page)
        number = page.locator("input.mantine-NumberInput-input").first
        number.fill(str(middle))
        number.press("Tab")
        waited(page, lambda: abs(live.time - middle) < 1e-3)
        now = page.get_by_text(f"{middle:.2f} s").first
        now.wait_for()
        assert phase.name in now.locator("..").inner_text()
        page.get_by_role("tab", name="Certificate").click()
        for name in ("separation", "speed"):
            check = plan.certificate[name]
            page.get_by_role("button", name=f"✓ {name}:").click()
            waited(page, lambda check=check: abs(live.time - check.time) < 1e-3)  # type: ignore[misc]
            page.get_by_text(f"{name}: {', '.join(check.where)} at {check.time:.2f} s").wait_for()
        page.get_by_role("button", name="no highlight").click()
        waited(page, lambda: not live.shown_check.visible)

    def test_a_live_view_plays(self, page: Any, live: LiveView) -> None:
        live.seek(0.0)
        page.get_by_role("button", name="Play").click()
        waited(page, lambda: live.time > 0.3)
        page.get_by_role("button", name="Pause").click()
        waited(page, lambda: not live.playing)
        for playing in (True, False):
            page.keyboard.press("Space")
            waited(page, lambda playing=playing: live.playing is playing)  # type: ignore[misc]
        assert page.locator("canvas").first.bounding_box()["width"] >= 1200 - 385

    def test_a_narrow_page_shows_the_scene_with_its_tabs_folded(
        self, page: Any, live: LiveView
    ) -> None:
        live.seek(0.0)
        page.set_viewport_size({"width": 400, "height": 800})
        page.goto(live.url + SHARP)
        tabs = page.get_by_role("button", name="Expand panel Phases")
        tabs.wait_for()
        settled(page)
        sheet = page.locator("div[style*='position: fixed'][style*='bottom: 0']").bounding_box()
        assert sheet["height"] <= 0.35 * 800
        places = [seen_at(page, live, point) for point in live.live.scene.drones.reshape(-1, 3)]
        assert np.min(places) > 0.0
        assert np.max(places, axis=0)[0] < 400
        assert np.mean(places, axis=0)[1] < sheet["y"]
        tabs.click()
        page.get_by_text(f"{tied_plan().phases[1].name}: ").wait_for()
        page.set_viewport_size({"width": 1200, "height": 800})
        opened(page, live.url, "certified for all t")


def test_the_command_serves_a_plan_and_its_certificate(tmp_path: Path) -> None:
    """Its page is opened before the plan is read."""
    tied_plan().save(tmp_path, rate=5.0)
    command = [sys.executable, "-m", "hitchopt", "view", str(tmp_path), "--no-browser"]
    options = ["--port", "8251"]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as served:
        try:
            assert served.stdout is not None
            words = next(line for line in served.stdout if line.startswith("the plan is at "))
            with opened_page() as page:
                opened(page, words.split()[4].rstrip(";"), "certified for all t")
        finally:
            served.send_signal(signal.SIGINT)
            assert served.wait(timeout=30) == 130
