"""Objects in scenes, flat pictures and storyboards."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pictured import make_motion

from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import Phase
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.view.object_shape import normals, object_shape, split
from hitchopt.view.painter import Camera, Painter
from hitchopt.view.scene import scene_of
from hitchopt.view.storyboard import MOST, chosen_shots

CORNERS = [[-0.3, -0.1], [0.2, -0.2], [0.3, 0.15], [-0.1, 0.25]]


def with_box(yaw: float = 0.7) -> Motion:
    motion = make_motion(3)
    box = SolidObject(Section(CORNERS), 0.0, 0.3, at=(1.5, 2.0, 0.4), yaw=yaw)
    requirements = dataclasses.replace(motion.requirements, objects={"box": box})
    return dataclasses.replace(motion, requirements=requirements)


@pytest.mark.parametrize("times", [0, 2])
@pytest.mark.parametrize("section", [Section(CORNERS), Section(radius=0.2)])
def test_triangles_enclose_the_body(section: Section, times: int) -> None:
    """By the divergence theorem, which holds only if all faces are there and look outward."""
    mesh = object_shape(SolidObject(section, 0.1, 0.4))
    corners = split(mesh.vertices[mesh.faces], times)
    volume = np.sum(np.linalg.det(corners)) / 6.0
    assert volume == pytest.approx(0.3 * section.area, rel=0.01 if section.radius else 1e-9)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    np.testing.assert_allclose(areas @ normals(corners), 0.0, atol=1e-12)


def test_a_rim_is_as_high_as_it_is() -> None:
    rim = Rim(Section(radius=0.5), 0.25)
    points = object_shape(SolidObject(Section(CORNERS), 0.0, 0.3, rim=rim)).vertices
    wide = points[np.linalg.norm(points[:, :2], axis=1) > 0.49]
    assert np.max(wide[:, 2]) == 0.25
    assert np.min(points[:, 2]) == 0.0


@given(st.floats(-9.0, 9.0))
def test_scenes_have_objects_where_they_stand(yaw: float) -> None:
    scene = scene_of(with_box(yaw), 0)
    place = scene.at(1.0).objects[0]
    np.testing.assert_allclose(place[:3], [1.5, 2.0, 0.4], atol=1e-12)
    assert np.linalg.norm(place[3:]) == pytest.approx(1.0)
    assert np.cos(2.0 * np.arctan2(place[6], place[3]) - yaw) == pytest.approx(1.0)


def test_objects_are_painted_where_they_stand() -> None:
    scene = scene_of(with_box(), 0)
    camera = Camera.toward(-115.0, 32.0)
    painter = Painter(scene, camera)
    painting = painter.painted(scene.at(0.0))
    tint = painting.colours[:, :3] / np.max(painting.colours[:, :3], axis=1, keepdims=True)
    own = np.all(np.abs(tint - painter.fills[0, :3] / np.max(painter.fills[0, :3])) < 1e-9, axis=1)
    seen = painting.polygons[own].reshape(-1, 2)
    box = scene.motion.requirements.objects["box"]
    outline = box.section.placed(box.at[:2], box.yaw)
    corners = [[*corner, z] for corner in outline for z in (0.4, 0.7)]
    expected = camera.seen(np.array(corners))[:, :2]
    np.testing.assert_allclose(np.min(seen, axis=0), np.min(expected, axis=0), atol=1e-9)
    np.testing.assert_allclose(np.max(seen, axis=0), np.max(expected, axis=0), atol=1e-9)


def test_a_storyboard_has_the_moments_that_matter() -> None:
    assert [shot.words for shot in chosen_shots(make_motion(3))] == ["start", "morph"]
    ends = np.linspace(0.0, 2.2, 16)
    phases = [Phase("morph", i, a, b) for i, (a, b) in enumerate(pairwise(ends.tolist()))]
    many = dataclasses.replace(make_motion(3), phases=(*phases, Phase("hold", 15, 2.2, 3.1)))
    shots = chosen_shots(many)
    assert len(shots) == MOST
    assert shots[0].words == "start"
    times = [shot.time for shot in shots]
    assert times == sorted(times)
    assert times[-1] >= 2.2 - 1e-9
