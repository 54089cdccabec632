"""The report in a browser, opened from the disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsing import NEAR, changed_place, projected, tied_plan, waited
from generators.headless_page import opened_page

NOTHING = "{drones: [], cables: [], vertices: []}"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    path: Path = tied_plan().report(tmp_path_factory.mktemp("report"))
    with opened_page() as page:
        page.goto(path.as_uri())
        waited(page, lambda: bool(page.evaluate("Boolean(window.hitchopt)")))
        yield page


@pytest.mark.parametrize("share", [0.08, 0.52, 0.97])
def test_q0_is_seen_where_the_plan_has_it(page: Any, share: float) -> None:
    plan = tied_plan()
    time = share * plan.duration
    page.evaluate(f"hitchopt.stage.on.names = false; hitchopt.stage.mark({NOTHING})")
    page.evaluate(f"hitchopt.seek({time})")
    stage = page.locator("#stage")
    eye, target, view, size = page.evaluate(
        "(({ camera, controls, place }) => [camera.position.toArray(), controls.target.toArray(), "
        "camera.fov * Math.PI / 180, [place.clientWidth, place.clientHeight]])(hitchopt.stage)"
    )
    expected = projected(plan.at(time).positions[0], np.array(eye), np.array(target), view, size)
    mark = "hitchopt.stage.mark({drones: [0], cables: [], vertices: []})"
    # Marked drones are named: what is compared is the scene alone.
    page.add_style_tag(content="#labels, #switches { display: none }")
    seen = changed_place(stage.screenshot, lambda: page.evaluate(mark))
    assert np.linalg.norm(seen - expected) < NEAR


def test_a_click_on_a_phase_and_scrubbing_show_it(page: Any) -> None:
    plan = tied_plan()
    for i, phase in enumerate(plan.phases):
        page.locator(f"#strip button[data-phase='{i}']").click(force=True)
        assert page.evaluate("hitchopt.time") == pytest.approx(phase.start, abs=1e-3)
        assert phase.name in page.locator("#phases tr.now").inner_text()
        assert phase.name in page.locator("#clock").inner_text()
        middle = 0.5 * (phase.start + phase.end)
        page.locator("#scrub").fill(str(middle))
        assert page.evaluate("hitchopt.time") == pytest.approx(middle, abs=1e-3)
        assert phase.name in page.locator("#phases tr.now").inner_text()


def test_a_click_on_a_check_jumps_to_its_worst_moment(page: Any) -> None:
    plan = tied_plan()
    for check in plan.certificate.checks:
        page.locator(f"#checks tr[data-check='{check.name}']").click()
        assert page.evaluate("hitchopt.time") == pytest.approx(check.time, abs=1e-3)
        assert check.name in page.locator("#checks tr.shown").inner_text()
        assert check.name in page.locator("#concerned").inner_text()
    page.locator("#checks tr[data-check='separation']").click()
    names = plan.motion.team.drone_names
    marked = page.evaluate("hitchopt.stage.marked.drones")
    assert {names[i] for i in marked} == set(plan.certificate["separation"].where)


def test_it_plays(page: Any) -> None:
    page.evaluate("hitchopt.seek(0)")
    page.locator("#play").click()
    waited(page, lambda: bool(page.evaluate("hitchopt.time > 0.2")))
    page.locator("#play").click()
    assert not page.evaluate("hitchopt.playing")
