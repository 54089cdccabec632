"""Films: refusals before the flight, and written files."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from click.testing import CliRunner, Result
from matplotlib.colors import to_rgba_array
from pictured import make_motion
from scipy.spatial.transform import Rotation

from hitchopt.cli import main
from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.view import film as films
from hitchopt.view.cable_curves import CLASPS
from hitchopt.view.film import check_film, frames, save_film
from hitchopt.view.ghost_scene import ghost_scene, recorded_scene
from hitchopt.view.painter import FRAME, SPECKS, Camera, Painter
from hitchopt.view.scene import scene_of


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


def test_what_is_nearer_is_painted_later() -> None:
    """Seen from above, the strand that is higher at a clasp covers the other."""
    scene = scene_of(make_motion(4))
    camera = Camera.toward(-90.0, 89.0)
    moment = scene.at(1.0)
    painting = Painter(scene, camera).painted(moment)
    assert painting.polygons.shape == (*painting.colours.shape[:1], 4, 2)
    cables = moment.cables
    strands = [(0, CLASPS[0]), (3, CLASPS[1])]
    own = Painter(scene, camera).cables
    order = []
    for cable, point in strands:
        middle = camera.seen(0.5 * (cables[cable, point] + cables[cable, point + 1]))[:2]
        same = np.all(painting.colours == own[cable], axis=1)
        apart = np.linalg.norm(np.mean(painting.polygons, axis=1) - middle, axis=1)
        order.append((int(np.argmin(np.where(same, apart, np.inf))), cables[cable, point, 2]))
    order.sort()
    assert order[0][1] <= order[1][1] + 1e-9


def test_frames_are_painted_on_the_sides_toward_the_viewer() -> None:
    scene, camera = scene_of(short_motion()), Camera.toward(-115.0, 38.0)
    moment = scene.at(0.1)
    painter = Painter(scene, camera)
    frame, rotors, rims = (part for part, *_ in painter.parts)
    turns = Rotation.from_quat(moment.quaternions, scalar_first=True).as_matrix()
    corners = np.einsum("dij,fvj->dfvi", turns, frame.vertices[frame.quads])
    boxes = corners.reshape(len(turns), 3, 6, 4, 3)
    outward = np.mean(boxes, axis=3) - np.mean(boxes, axis=(2, 3))[:, :, None]
    shown = outward @ camera.axes[2] > 0.0
    assert np.all(np.sum(shown, axis=2) == 3)
    expected = camera.seen(boxes[shown] + np.repeat(moment.drones, 9, axis=0)[:, None])[..., :2]
    painting = painter.painted(moment)
    dark = np.all(painting.colours == to_rgba_array(FRAME), axis=1)
    found = painting.polygons[dark]
    assert len(found) == len(expected) == 9 * len(turns)
    apart = np.max(np.abs(found[:, None] - expected[None]), axis=(2, 3))
    assert np.all(np.min(apart, axis=1) < 1e-12)
    assert np.all(np.min(apart, axis=0) < 1e-12)
    drawn = len(turns) * (9 + len(rotors.quads) + len(rims.quads))
    robots, points = moment.cables.shape[:2]
    assert len(painting.polygons) == drawn + 3 * robots * (points - 1)


def test_specks_are_rotors_alone_where_the_drones_are() -> None:
    scene, camera = scene_of(short_motion()), Camera.toward(-115.0, 38.0)
    moment = scene.at(0.1)
    painter = Painter(scene, camera, step=SPECKS)
    assert len(painter.parts) == 1
    rotors, fills, _ = painter.parts[0]
    q, r = fills[0::2], fills[1::2]
    np.testing.assert_allclose(r[:, :3], 0.5 * (q[:, :3] + 1.0))  # q and r of a cable share its hue
    painting = painter.painted(moment)
    places = camera.seen(moment.drones)[:, :2]
    for place, fill in zip(places, fills, strict=True):
        own = np.all(painting.colours == fill, axis=1)
        apart = np.max(np.abs(np.mean(painting.polygons, axis=1) - place), axis=1)
        reach = scene.motion.requirements.separation.radius
        assert np.sum(own & (apart < reach)) >= len(rotors.quads)
    robots, points = moment.cables[:, ::SPECKS].shape[:2]
    drawn = 2 * robots * len(rotors.quads) + 3 * robots * (points - 1)
    assert len(painting.polygons) == drawn


def test_the_camera_s_axes_are_a_rotation() -> None:
    axes = Camera.toward(-115.0, 32.0).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[1, 2] > 0.0


def test_a_film_without_its_packages_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(films, "find_spec", lambda name: name == "imageio" or None)
    check_film(Path("flight.gif"))
    with pytest.raises(UnsupportedError, match=r"flight\.MP4: needs imageio_ffmpeg"):
        check_film(Path("flight.MP4"))
    monkeypatch.setattr(films, "find_spec", lambda _: None)
    with pytest.raises(UnsupportedError, match="needs imageio"):
        check_film(Path("flight.gif"))
    with pytest.raises(InputError, match="film"):
        check_film(Path("flight.avi"))


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        save_film(tmp_path / "missing" / "flight.gif", scene_of(short_motion()))
    assert list(tmp_path.iterdir()) == []


def test_a_recorded_flight_is_a_scene(tmp_path: Path) -> None:
    motion = make_motion(3)
    nodes = np.zeros((6, 30, 3), dtype=np.float32)
    nodes[..., 0] = np.arange(30)
    nodes[..., 2] = np.arange(6)[:, None]
    t, first = 0.1 * np.arange(-2.0, 4.0), np.array([0, 10, 20, 30])
    np.savez_compressed(
        tmp_path / "recording.npz", t=t, nodes=nodes, cables=first, poses=np.zeros((6, 0, 7))
    )
    found = ghost_scene(tmp_path, motion)
    np.testing.assert_allclose(found.t, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(found.drones[:, :, 0], np.tile([0, 9, 10, 19, 20, 29], (4, 1)))
    again = recorded_scene(motion, t, nodes, first, np.zeros((6, 0, 7)))
    np.testing.assert_array_equal(again.cables, found.cables)
    with pytest.raises(FileError, match="a flight of 3 cables"):
        ghost_scene(tmp_path, make_motion(4))
    with pytest.raises(FileError, match="holds neither"):
        ghost_scene(tmp_path.parent, motion)


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
