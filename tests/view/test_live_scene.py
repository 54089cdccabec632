"""The live view's scene, without a browser: what is sent to it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pictured import made_certificate, make_motion

from hitchopt.values import Array
from hitchopt.view.live_view import NARROW_ASPECT, LiveView
from hitchopt.view.scene import Concerned
from hitchopt.view.viser_arrays import faded


@pytest.fixture(scope="module")
def live() -> Iterator[LiveView]:
    view = LiveView(make_motion(4), made_certificate(), "A picture", port=8391)
    yield view
    view.close()


def colours(live: LiveView) -> list[Any]:
    scene = live.live
    parts = [*scene._drones, scene._cables]
    return [
        np.array(getattr(each, "batched_colors", getattr(each, "colors", None))) for each in parts
    ]


def test_an_old_plan_is_faded_and_comes_back(live: LiveView) -> None:
    before = colours(live)
    live.note("an OLD plan")
    pale = colours(live)
    for bright, dim in zip(before, pale, strict=True):
        vivid, dull = (np.ptp(each.astype(int), axis=-1).max() for each in (bright, dim))
        assert dull <= 0.3 * vivid + 6  # the grey's own
        assert dim.min() > 80
    assert not live.live._paths.visible
    live.note("")
    for bright, again in zip(before, colours(live), strict=True):
        np.testing.assert_array_equal(again, bright)
    assert live.live._paths.visible


def test_marks_stay_in_their_colour_while_a_plan_is_old(live: LiveView) -> None:
    live.live.mark(Concerned(cables=(2,)))
    live.note("an OLD plan")
    cables = live.live._cables.colors.reshape(4, -1, 3)
    assert np.ptp(cables[2][0].astype(int)) > 100
    assert np.ptp(cables[1][0].astype(int)) < 60
    live.note("")
    live.live.mark(Concerned())


def test_the_camera_sees_all_paths_from_near(live: LiveView) -> None:
    camera, drones = live.server.initial_camera, live.live.scene.drones.reshape(-1, 3)
    eye, target = np.array(camera.position), np.array(camera.look_at)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    depth = (drones - eye) @ forward
    up = np.abs((drones - eye) @ np.cross(right, forward)) / depth / np.tan(0.5 * camera.fov)
    assert np.all(depth > 0.0)
    assert 0.3 < np.max(up) < 1.0


def seen_places(live: LiveView) -> Array:
    """Return where the camera sees all drones (m, 2), as shares of the picture's height."""
    camera, drones = live.server.initial_camera, live.live.scene.drones.reshape(-1, 3)
    eye, target = np.array(camera.position), np.array(camera.look_at)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    depth = (drones - eye) @ forward * 2.0 * np.tan(0.5 * camera.fov)
    aside = (drones - eye) @ np.stack([right, np.cross(right, forward)], axis=1)
    found: Array = aside / depth[:, None]
    return found


def test_the_camera_sees_all_paths_in_a_narrow_picture() -> None:
    view = LiveView(make_motion(5), None, port=8395, aspect=NARROW_ASPECT)
    places = seen_places(view)
    view.close()
    assert np.max(np.abs(places[:, 0])) < 0.5 * NARROW_ASPECT
    assert np.max(np.abs(places[:, 1])) < 0.5


def test_a_certificate_that_is_late_keeps_the_panel() -> None:
    view = LiveView(make_motion(3), None, port=8396)
    assert "being certified" in view.head.content
    assert view.checks.labels == []
    assert not view.wait_for_page(0.0)  # nobody has opened it
    view.show_certificate(made_certificate())
    assert "certified for all t" in view.head.content
    assert len(view.checks.labels) == len(made_certificate().checks)
    view.close()


def test_another_plan_keeps_panel_and_switches() -> None:
    view = LiveView(make_motion(3), made_certificate(), port=8397)
    view.live.switch("thrusts", on=True)
    view.play(on=True)
    head = view.head
    view.show_plan(make_motion(4), None, "another")
    assert view.head is head
    assert "another" in head.content
    assert view.live.shown["thrusts"]
    assert view.player.label == "Pause"
    assert view.checks.labels == []
    assert [label.split(":")[0] for label in view.phases.labels] == [
        phase.name for phase in view.motion.phases
    ]
    assert view.scrub.max >= view.motion.duration
    view.close()


def test_faded_colours_are_pale_greys() -> None:
    given = np.array([[0, 0, 0], [255, 0, 0], [11, 60, 93]], np.uint8)
    assert faded(given).min() >= 160
    assert np.ptp(faded(given).astype(int), axis=-1).max() <= 60
