"""Paintings and films: what is drawn where, refusals before the flight, and written files."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from click.testing import CliRunner, Result
from pictured import make_motion, with_box

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.objects import Rim, Section, SolidObject
from hitchopt.values import Array
from hitchopt.view import film as films
from hitchopt.view.cables import CLASPS
from hitchopt.view.film import check_film, frames, save_film
from hitchopt.view.painter import Camera, Painter
from hitchopt.view.scene import ghost_scene, scene_of
from hitchopt.view.shapes import drone_faces, normals, object_faces, sphere_faces, split
from problems.forming_steps import save_forming_steps

CORNERS = [[-0.3, -0.1], [0.2, -0.2], [0.3, 0.15], [-0.1, 0.25]]


def short_motion(n: int = 3) -> Motion:
    return make_motion(n).slowed(0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("ending", "count"), [("gif", 7), ("mp4", 11)])
def test_a_film_is_in_real_time(tmp_path: Path, ending: str, count: int) -> None:
    path = tmp_path / f"plan.{ending}"
    done: list[float] = []
    save_film(path, scene_of(short_motion()), "Three", done.append)
    # 0.31 s at 50/3 and 30 Hz, both ends
    if ending == "gif":
        assert imageio.imread(path).shape == (count, 720, 1280, 3)
    else:
        assert imageio_ffmpeg.count_frames_and_secs(path)[0] == count
    assert done == pytest.approx(np.arange(1, count + 1) / count)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_frames_show_the_motion() -> None:
    scene = scene_of(short_motion())
    first, again, last = frames(scene, np.array([0.0, 0.0, 0.2]), "")
    assert first.shape == (720, 1280, 3)
    np.testing.assert_array_equal(first, again)
    assert 0.001 < np.mean(np.any(first != last, axis=-1)) < 0.3


def volume_and_area(faces: Array) -> tuple[float, Array]:
    """Return the volume that faces enclose, and their areas summed as vectors."""
    corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.sum(np.linalg.det(corners)) / 6.0), 0.5 * np.sum(areas, axis=0)


@pytest.mark.parametrize("times", [0, 2])
@pytest.mark.parametrize("section", [Section(CORNERS), Section(radius=0.2)])
def test_faces_enclose_the_body(section: Section, times: int) -> None:
    """By the divergence theorem, which holds only if all faces are there and look outward."""
    volume, area = volume_and_area(split(object_faces(SolidObject(section, 0.1, 0.4)), times))
    assert volume == pytest.approx(0.3 * section.area, rel=0.01 if section.radius else 1e-9)
    np.testing.assert_allclose(area, 0.0, atol=1e-12)


def test_drones_spheres_and_rims_have_their_sizes() -> None:
    frame, rotors, rims = drone_faces(0.1)
    np.testing.assert_allclose(volume_and_area(frame)[1], 0.0, atol=1e-12)
    assert np.all(normals(rotors)[:, 2] > 0.999)
    assert 0.07 < np.max(np.linalg.norm(rims[..., :2], axis=-1)) < 0.1
    volume, _ = volume_and_area(sphere_faces([0.1, 0.1, 0.3]))
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.1 * 0.1 * 0.3, rel=0.1)
    rim = Rim(Section(radius=0.5), 0.25)
    points = object_faces(SolidObject(Section(CORNERS), 0.0, 0.3, rim=rim)).reshape(-1, 3)
    assert np.max(points[np.linalg.norm(points[:, :2], axis=1) > 0.49, 2]) == 0.25


def test_what_is_nearer_is_painted_later() -> None:
    """Seen from above, the strand that is higher at a clasp covers the other."""
    scene, camera = scene_of(make_motion(4)), Camera.toward(-90.0, 89.0)
    moment, painter = scene.at(1.0), Painter(scene, camera)
    painting, order = painter.painted(moment), []
    for cable, point in ((0, CLASPS[0]), (3, CLASPS[1])):
        strand = moment.cables[cable, point : point + 2]
        middle = camera.seen(np.mean(strand, axis=0))[:2]
        own = np.all(painting.colours == painter.cables[cable], axis=1)
        apart = np.linalg.norm(np.mean(painting.polygons, axis=1) - middle, axis=1)
        order.append((int(np.argmin(np.where(own, apart, np.inf))), strand[0, 2]))
    order.sort()
    assert order[0][1] <= order[1][1] + 1e-9


def test_objects_are_painted_where_they_stand() -> None:
    """All else is far from the box, whose corners bound what is painted there."""
    scene, camera = scene_of(with_box(), 0), Camera.toward(-115.0, 32.0)
    box = scene.motion.requirements.objects["box"]
    outline = box.section.placed(box.at[:2], box.yaw)
    expected = camera.seen(np.array([[*corner, z] for corner in outline for z in (0.4, 0.7)]))
    middle = np.mean(expected[:, :2], axis=0)
    polygons = Painter(scene, camera).painted(scene.at(0.0)).polygons
    seen = polygons[np.all(np.abs(np.mean(polygons, axis=1) - middle) < 0.5, axis=1)]
    flat = seen.reshape(-1, 2)
    np.testing.assert_allclose(np.min(flat, axis=0), np.min(expected[:, :2], axis=0), atol=1e-9)
    np.testing.assert_allclose(np.max(flat, axis=0), np.max(expected[:, :2], axis=0), atol=1e-9)


def test_a_film_that_cannot_be_made_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        save_film(tmp_path / "missing" / "flight.gif", scene_of(short_motion()))
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(films, "find_spec", lambda name: name == "imageio" or None)
    check_film(Path("flight.gif"))
    with pytest.raises(UnsupportedError, match=r"flight\.MP4: needs imageio_ffmpeg"):
        check_film(Path("flight.MP4"))
    with pytest.raises(InputError, match="film"):
        check_film(Path("flight.avi"))


@pytest.mark.slow
def test_a_simulated_flight_is_filmed_from_its_directory(tmp_path: Path) -> None:
    motion = make_motion(3)
    flight = tmp_path / "simulation"
    flight.mkdir()
    nodes = np.random.default_rng(1).normal(size=(11, 30, 3))
    t, first, poses = 0.1 * np.arange(11.0), np.array([0, 10, 20, 30]), np.zeros((11, 0, 7))
    np.savez_compressed(flight / "recording.npz", t=t, nodes=nodes, cables=first, poses=poses)

    def saved(name: str) -> Result:
        return CliRunner().invoke(main, ["view", str(flight), "--save", str(tmp_path / name)])

    lost = saved("flight.gif")
    assert lost.exit_code == 2
    assert "keep the two together" in lost.output.replace("\n", " ")
    write_plan(tmp_path / "plan.npz", motion, title="Three")
    done = saved("flight.gif")
    assert done.exit_code == 0
    assert f"the film is {tmp_path / 'flight.gif'}" in done.output
    save_film(tmp_path / "own.gif", ghost_scene(flight, motion), "Three (simulated)")
    assert (tmp_path / "flight.gif").read_bytes() == (tmp_path / "own.gif").read_bytes()
    picture = saved("flight.png")
    assert picture.exit_code == 2
    assert "such as flight.mp4" in picture.output.replace("\n", " ")


@pytest.mark.slow
def test_the_steps_of_forming_are_four_panels(tmp_path: Path) -> None:
    hitch = ho.Hitch.spread(ho.Team(3, 2.4), [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], 1.5)
    high = np.array([[-0.6, -1.2, 2.2], [-0.6, 0, 2.2], [-0.6, 1.2, 2.2]])
    plan = ho.form(hitch.team, high, high * [-1, 1, 1], hitch.polygon, 1.5)
    save_forming_steps(tmp_path / "steps.png", plan.motion)
    picture = imageio.imread(tmp_path / "steps.png")[..., :3]
    for panel in np.array_split(picture, 4, axis=1):
        colours = np.unique((panel[60:-60] // 32).reshape(-1, 3), axis=0)
        assert len(colours) > 20  # three cables, drones and paths, not an empty frame
    with pytest.raises(InputError, match=r"motion = 'no swap': must be a plan that forms"):
        save_forming_steps(tmp_path / "none.png", ho.hold(hitch, 1.0).motion)
