"""Editing by hand in a browser: typed numbers, a dragged vertex, undo and save."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsing import SHARP, drawn, projected, settled, waited
from generators.headless_page import opened_page

import hitchopt as ho
from hitchopt.steps.certified_motions import Certified
from hitchopt.view.editing import Editing, Stage
from hitchopt.view.live import NARROW_ASPECT, LiveView
from hitchopt.view.panel import REACH, EditingPanel

TEXT = """\
# A triangle off the origin.
team: {robots: 3, cable_length: 2.4}
start:
  hitch: {polygon: [[1.0, -0.5], [0.6, 1.0], [1.4, 1.0]], altitude: 1.2}
mission:
  - morph: {polygon: [[1.0, -0.3], [0.6, 1.0], [1.4, 1.0]]}  # one vertex
  - hold: {seconds: 1.0}
"""


@pytest.fixture(scope="module")
def panel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EditingPanel]:
    path: Path = tmp_path_factory.mktemp("edited") / "problem.yaml"
    path.write_text(TEXT)
    plan = ho.solve(path)
    live = LiveView(plan.motion, plan.certificate, port=8261, aspect=NARROW_ASPECT)
    editing = Editing(TEXT, path, Certified(plan.motion, plan.certificate))
    yield EditingPanel(live, editing)
    editing.close()
    live.close()


@pytest.fixture(scope="module")
def page(panel: EditingPanel) -> Iterator[Any]:
    with opened_page() as page:
        page.goto(panel.live.url + SHARP)
        page.wait_for_selector("canvas")
        page.get_by_text("the plan of this problem").wait_for()
        drawn(page)
        yield page


def planned(page: Any, editing: Editing) -> None:
    """Wait until the newest text is planned."""
    waited(page, lambda: editing.status.stage is Stage.CURRENT)


def test_a_typed_number_is_planned_undone_and_saved(page: Any, panel: EditingPanel) -> None:
    editing = panel.editing
    panel.choose(1)
    settled(page)
    page.locator("input.mantine-TextInput-input[value='1.0']").fill("1.5")
    settled(page)
    page.get_by_role("button", name="Plan with these values").click()
    waited(page, lambda: "1.5" in editing.text)
    planned(page, editing)
    page.get_by_text("not saved").wait_for()
    page.get_by_text("Save", exact=True).click()
    waited(page, lambda: editing.path.read_text() == TEXT.replace("1.0}\n", "1.5}\n"))
    page.get_by_text("Undo", exact=True).click()
    waited(page, lambda: editing.text == TEXT)
    planned(page, editing)


def test_a_vertex_is_dragged(page: Any, panel: EditingPanel) -> None:
    panel.choose(0, "vertex 0")
    settled(page)
    (camera,) = (client.camera for client in panel.live.server.get_clients().values())
    box = page.locator("canvas").first.bounding_box()

    def seen(point: list[float]) -> Any:
        size = (box["width"], box["height"])
        where = projected(np.array(point), camera.position, camera.look_at, camera.fov, size)
        return where + [box["x"], box["y"]]

    page.mouse.move(*seen([1.0 + 0.6 * REACH, -0.3, 1.2]))
    page.mouse.down()
    page.mouse.move(*seen([1.05 + 0.6 * REACH, -0.3, 1.2]), steps=8)
    settled(page)
    page.mouse.up()
    waited(page, lambda: panel.editing.text != TEXT)
    planned(page, panel.editing)
    (vertex,) = (panel.editing.problem.mission[0].polygon.vertices[:1],)  # type: ignore[attr-defined]
    np.testing.assert_allclose(vertex[0], [1.05, -0.3], atol=0.02)
    assert panel.editing.planned.certificate.certified


def test_changes_in_quick_succession_are_shown_in_one_panel(page: Any, panel: EditingPanel) -> None:
    """Pages report updates of what is gone as errors, which the fixture refuses."""
    editing = panel.editing
    first = editing.text
    for k in range(6):
        editing.drag(0, "vertex 1", np.array([0.6 - 0.01 * k, 1.0, 1.2]))
        editing.wait(0.3 * (k % 2))
    assert editing.text != first
    planned(page, editing)
    page.get_by_text("the plan of this problem").wait_for()
    settled(page)
    (head,) = page.get_by_text("certified for all t").all()
    assert head.is_visible()
