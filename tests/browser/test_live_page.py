"""The live view in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from browsing import (
    NEAR,
    SHARP,
    changed_place,
    drawn,
    projected,
    settled,
    tied_plan,
    vividness,
    waited,
)
from generators.headless_page import opened_page

from hitchopt.view.live import LiveView
from hitchopt.view.scene import Concerned


@pytest.fixture(scope="module")
def live() -> Iterator[LiveView]:
    view = tied_plan().view(browser=False, port=8231)
    assert view is not None
    yield view
    view.close()


@pytest.fixture(scope="module")
def page(live: LiveView) -> Iterator[Any]:
    with opened_page() as page:
        page.goto(live.url + SHARP)
        page.wait_for_selector("canvas")
        page.get_by_text("certified for all t").wait_for()
        drawn(page)
        yield page


@pytest.mark.parametrize("share", [0.08, 0.52, 0.97])
def test_q0_is_seen_where_the_plan_has_it(page: Any, live: LiveView, share: float) -> None:
    plan = tied_plan()
    time = share * plan.duration
    live.live.mark(Concerned())
    live.seek(time)
    settled(page)
    (camera,) = (client.camera for client in live.server.get_clients().values())
    box = page.locator("canvas").first.bounding_box()
    size = (box["width"], box["height"])
    point = plan.at(time).positions[0]
    expected = projected(point, camera.position, camera.look_at, camera.fov, size)

    def mark() -> None:
        live.live.mark(Concerned(drones=(0,)))
        settled(page)

    seen = changed_place(lambda: page.screenshot(clip=box), mark)
    assert np.linalg.norm(seen - expected) < NEAR


def test_a_click_on_a_phase_and_a_typed_time_show_it(page: Any, live: LiveView) -> None:
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


def test_a_click_on_a_check_jumps_to_its_worst_moment(page: Any, live: LiveView) -> None:
    plan = tied_plan()
    page.get_by_role("tab", name="Certificate").click()
    for name in ("separation", "speed"):
        check = plan.certificate[name]
        page.get_by_role("button", name=f"✓ {name}:").click()
        waited(page, lambda check=check: abs(live.time - check.time) < 1e-3)  # type: ignore[misc]
        page.get_by_text(f"{name}: {', '.join(check.where)} at {check.time:.2f} s").wait_for()


def test_it_plays(page: Any, live: LiveView) -> None:
    live.seek(0.0)
    page.get_by_role("button", name="Play").click()
    waited(page, lambda: live.time > 0.3)
    page.get_by_role("button", name="Pause").click()
    waited(page, lambda: not live.playing)


def test_an_old_plan_is_pale_until_it_is_the_plan_again(page: Any, live: LiveView) -> None:
    live.live.mark(Concerned())
    live.seek(0.6 * tied_plan().duration)
    box = page.locator("canvas").first.bounding_box()

    def colour() -> float:
        settled(page)
        return vividness(page.screenshot(clip=box))

    before = colour()
    live.note("an OLD plan")
    page.get_by_text("an OLD plan").wait_for()
    assert colour() < 0.5 * before
    live.note("")
    assert colour() == pytest.approx(before, rel=0.05)
