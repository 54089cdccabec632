"""Scenes: drones, cables, objects and ghosts where the plan has them; paintings and films."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.transforms import Bbox

import hitchopt as ho
from hitchopt.carrying.holding import wraps_around
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.errors import FileError, UnsupportedError
from hitchopt.lab.simulation.ropes import linking_matrix
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import shifted
from hitchopt.motion.states import states_at
from hitchopt.objects.placing import in_world
from hitchopt.view.cables import CLASPS, clasp_senses, wrapped_edges
from hitchopt.view.film import frames, save_film
from hitchopt.view.painter import (
    AZIMUTH,
    ELEVATION,
    GRID_COLOUR,
    Camera,
    Painter,
    choose_shots,
    draw_ground,
    draw_painting,
    draw_plan_storyboard,
)
from hitchopt.view.pictures import draw_summary
from hitchopt.view.scene import (
    Scene,
    ghost_scene,
    highlight_of,
    object_faces,
    scene_at,
    scene_of,
    subdivide,
)
from hitchopt.view.style import OTHERS_COLOUR, cable_colours, new_figure, rgb
from tests.helpers.groups import moved
from tests.helpers.pictured import CORNERS, make_motion, with_box
from tests.helpers.plans import planned


@pytest.fixture(scope="module")
def tied() -> ho.Motion:
    """Return a hitch tied, held and untied."""
    team = ho.Team(robots=3, cable_length=2.4, cable_density=0.004)
    q = np.array([[-0.6, -1.2, 1.0], [-0.6, 0, 1.0], [-0.6, 1.2, 1.0]])
    triangle = [[0.1, 0.7], [0.6, -0.2], [-0.4, -0.3]]
    return ho.form(team, q, q + [1.2, 0.0, 0.0], triangle, altitude=1.5).motion


def linking(motion: ho.Motion, time: float) -> np.ndarray:
    return np.abs(linking_matrix(list(scene_at(ho.Flight.of(motion), np.array([time])).cables[0])))


def test_a_scene_is_the_plan_at_its_times_and_between(tied: ho.Motion) -> None:
    scene = scene_of(ho.Flight.of(tied))
    states = states_at(tied, scene.t)
    np.testing.assert_array_equal(scene.drones, states.positions)
    np.testing.assert_array_equal(scene.cable_forces, states.cable_forces)
    np.testing.assert_allclose(scene.cables[:, :, 0], scene.drones[:, 0::2], atol=1e-9)
    np.testing.assert_allclose(scene.cables[:, :, -1], scene.drones[:, 1::2], atol=1e-9)
    assert all(np.min(np.abs(scene.t - phase.end)) < 1e-5 for phase in tied.phases)
    times = np.linspace(0.0, tied.duration, 57)
    between = np.array([scene.at(time).drones for time in times])
    np.testing.assert_allclose(between, tied.drones.at(times), atol=5e-3)


def test_free_cables_are_as_long_as_they_are_and_hang(tied: ho.Motion) -> None:
    free = next(phase for phase in tied.phases if phase.state.hangs)
    points = scene_at(ho.Flight.of(tied), np.linspace(free.start, free.end, 9)[1:-1]).cables
    length = np.sum(np.linalg.norm(np.diff(points, axis=2), axis=-1), axis=-1)
    np.testing.assert_allclose(length, np.tile(tied.team.cable_length, (7, 1)), rtol=5e-3)
    middles, ends = points[:, :, points.shape[2] // 2, 2], points[:, :, [0, -1], 2]
    assert np.all(middles < np.min(ends, axis=-1) - 0.1)


def test_neighbours_are_linked_in_the_hitch_and_not_before(tied: ho.Motion) -> None:
    assert not np.any(linking(tied, 0.5 * tied.phases[0].end))
    np.testing.assert_array_equal(linking(tied, tied.duration - 0.1), 1 - np.eye(3))
    for n in (4, 12):  # neighbours alone
        distance = (np.arange(n)[:, None] - np.arange(n)) % n
        expected = np.isin(distance, (1, n - 1)).astype(int)
        np.testing.assert_array_equal(linking(make_motion(n), 1.0), expected)
    team = ho.Team(robots=3, cable_length=2.4, topology="open")
    start = ho.Hitch.spread(team, [[-2.0, 0.0], [-0.7, 0.5], [0.7, 0.5], [2.0, 0.0]], altitude=1.0)
    links = linking(ho.solve(start, ho.Hold(1.0)).motion, 0.5)
    np.testing.assert_array_equal(links, [[0, 1, 0], [1, 0, 1], [0, 1, 0]])


def test_turning_the_other_way_links_the_other_way(tied: ho.Motion) -> None:
    flip = np.array([1.0, 1.0, -1.0])[:, None]
    mirrored: dict[str, Any] = {
        name: dataclasses.replace(curves, coefficients=curves.coefficients * flip)
        for name, curves in (("drones", tied.drones), ("vertices", tied.vertices))
    }
    assert clasp_senses(tied).tolist() == [1.0, 1.0, 1.0]  # every q goes up first
    assert clasp_senses(tied.replaced(**mirrored)).tolist() == [-1.0, -1.0, -1.0]


def test_bends_are_at_the_vertices() -> None:
    motion = make_motion(5)
    scene = scene_at(ho.Flight.of(motion), np.array([0.7]))
    vertices = motion.vertices.at(0.7)
    for which, points in zip(CLASPS, (vertices, np.roll(vertices, -1, axis=0)), strict=True):
        distances = np.linalg.norm(scene.cables[0, :, which] - points, axis=-1)
        np.testing.assert_allclose(distances, 2.2 * scene.radius, rtol=1e-6)


def test_edges_around_a_circle_are_its_tangents_and_arc() -> None:
    angles = 0.3 - 2.0 * np.pi * np.arange(3) / 3
    flat = 0.24 * np.column_stack([np.cos(angles), np.sin(angles)])
    wraps = wraps_around(ho.Section(radius=0.2), flat)
    first, contacts = (
        np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, 1)]) for x in (flat, wraps.contacts)
    )
    last = np.roll(first, -1, axis=0)
    lengths, points = wrapped_edges(first, last, contacts)
    np.testing.assert_allclose(lengths, wraps.lengths, atol=1e-12)
    np.testing.assert_allclose(points[:, [0, -1]], np.stack([first, last], axis=1), atol=1e-12)
    np.testing.assert_allclose(points[:, [1, -2]], contacts, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points[:, 1:-1], axis=-1), 0.2, atol=1e-12)
    middle = np.repeat(0.5 * (first + last)[:, None], 2, axis=1)  # no contact: straight
    chords = np.linalg.norm(last - first, axis=1)
    np.testing.assert_allclose(wrapped_edges(first, last, middle)[0], chords, atol=1e-9)


@pytest.mark.parametrize("yaw", [-8.0, 0.7, 3.2])
def test_objects_are_where_they_stand(yaw: float) -> None:
    place = scene_of(ho.Flight.of(with_box(yaw)), 0).at(1.0).objects[0]
    np.testing.assert_allclose(place[:3], [1.5, 2.0, 0.4], atol=1e-12)
    assert np.linalg.norm(place[3:]) == pytest.approx(1.0)
    assert np.cos(2.0 * np.arctan2(place[6], place[3]) - yaw) == pytest.approx(1.0)


def test_what_a_check_names_is_found(tied: ho.Motion) -> None:
    parts = highlight_of(
        ho.Flight.of(tied), ("q1", "r2", "cable 0", "p2", "q-leg 1", "phase 3 (swap 1)", "floor")
    )
    names, robots = tied.team.drone_names, tied.team.labels
    assert parts.drones == tuple(sorted((names.index("q1"), names.index("r2"))))
    assert parts.cables == tuple(sorted((robots.index(0), robots.index(1))))
    assert parts.vertices == (2,)


def recorded(folder: Path, nodes: Any) -> None:
    """Write the recording of a flight of three cables of ten points."""
    t, first, poses = 0.1 * np.arange(-2.0, 4.0), np.array([0, 10, 20, 30]), np.zeros((6, 0, 7))
    folder.mkdir(exist_ok=True)
    np.savez_compressed(folder / "recording.npz", t=t, nodes=nodes, cables=first, poses=poses)


def test_a_recorded_flight_is_a_scene(tmp_path: Path) -> None:
    motion = make_motion(3)
    nodes = np.zeros((6, 30, 3), dtype=np.float32)
    nodes[..., 0] = np.arange(30)
    recorded(tmp_path, nodes)
    ghost = ghost_scene(tmp_path, ho.Flight.of(motion))
    np.testing.assert_allclose(ghost.t, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(ghost.drones[:, :, 0], np.tile([0, 9, 10, 19, 20, 29], (4, 1)))
    with pytest.raises(FileError, match="a flight of 3 cables"):
        ghost_scene(tmp_path, ho.Flight.of(make_motion(4)))
    with pytest.raises(FileError, match="contains neither"):
        ghost_scene(tmp_path.parent, ho.Flight.of(motion))


def short_scene() -> Scene:
    return scene_of(ho.Flight.of(make_motion(3).slowed(0.1)))


@pytest.mark.slow
def test_a_film_is_in_real_time_and_shows_the_motion(tmp_path: Path) -> None:
    progress: list[float] = []
    for ending in ("gif", "mp4"):  # 0.31 s at 50/3 and 30 Hz, both ends
        save_film(tmp_path / f"plan.{ending}", short_scene(), "Three", progress.append)
    assert imageio.imread(tmp_path / "plan.gif").shape == (7, 360, 640, 3)
    assert imageio_ffmpeg.count_frames_and_secs(tmp_path / "plan.mp4")[0] == 11
    assert progress == pytest.approx([*(np.arange(1, 8) / 7), *(np.arange(1, 12) / 11)])
    assert {entry.name for entry in tmp_path.iterdir()} == {"plan.gif", "plan.mp4"}
    long = scene_of(ho.Flight.of(make_motion(3).slowed(3.0)))  # of 9.3 s
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hitchopt.view.film.MAX_GIF_FRAMES", 12)
        save_film(tmp_path / "long.gif", long)
    count = len(imageio.imread(tmp_path / "long.gif"))
    assert count <= 12
    milliseconds = imageio.immeta(tmp_path / "long.gif")["duration"]
    assert 1e-3 * count * milliseconds == pytest.approx(long.t[-1], abs=2e-3 * milliseconds)
    first, again, last = frames(short_scene(), np.array([0.0, 0.0, 0.2]), "", 100)
    np.testing.assert_array_equal(first, again)
    assert 0.001 < np.mean(np.any(first != last, axis=-1)) < 0.3


def test_films_begin_before_the_first_frame_of_a_flight() -> None:
    """Flights are recorded every 40 ms from the middle of their settling, not at their start."""
    late = short_scene()
    late = replace(late, t=late.t + 0.02)
    first, recorded, last = frames(late, np.array([0.0, 0.02, 0.2]), "", 100)
    changed = [np.mean(np.any(first != other, axis=-1)) for other in (recorded, last)]
    assert changed[0] < changed[1]


@pytest.mark.parametrize("times", [0, 2])
@pytest.mark.parametrize("section", [ho.Section(CORNERS), ho.Section(radius=0.2)])
def test_faces_enclose_the_body(section: ho.Section, times: int) -> None:
    """By the divergence theorem, which holds only if all faces are there and look outward."""
    faces = subdivide(object_faces(ho.SolidObject(section, 0.1, 0.4)), times)
    corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.sum(np.linalg.det(corners)) / 6.0
    assert volume == pytest.approx(0.3 * section.area, rel=0.01 if section.radius else 1e-9)
    np.testing.assert_allclose(np.sum(areas, axis=0), 0.0, atol=1e-12)


def test_what_is_nearer_is_painted_later() -> None:
    scene, camera = scene_of(ho.Flight.of(make_motion(4))), Camera.at_angles(-115.0, 32.0)
    moment = scene.at(1.0)
    middles = np.mean(Painter(scene, camera).paint(moment).polygons, axis=1)
    projected = camera.project(moment.drones)
    is_near = np.linalg.norm(middles - projected[:, None, :2], axis=-1) < 0.02
    last = [np.flatnonzero(each)[-1] for each in is_near]
    np.testing.assert_array_equal(np.argsort(last), np.argsort(projected[:, 2]))


def test_objects_are_painted_where_they_stand() -> None:
    """All else is far from the box, whose corners bound what is painted there."""
    scene, camera = scene_of(ho.Flight.of(with_box()), 0), Camera.at_angles(-115.0, 32.0)
    box = scene.flight.requirements.objects["box"]
    corners = np.array([[*corner, z] for corner in CORNERS for z in (box.lower, box.upper)])
    expected = camera.project(in_world(box.pose, corners))
    middle = np.mean(expected[:, :2], axis=0)
    polygons = Painter(scene, camera).paint(scene.at(0.0)).polygons
    body = polygons[np.all(np.abs(np.mean(polygons, axis=1) - middle) < 0.5, axis=1)]
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(body, axis=(0, 1)), end(expected, axis=0)[:2], atol=1e-9)


def test_faces_of_objects_have_no_seams_and_stand_on_a_grid() -> None:
    scene, camera = scene_of(ho.Flight.of(with_box()), 0), Camera.at_angles(AZIMUTH, 90.0)
    box = scene.flight.requirements.objects["box"]
    (place,) = camera.project(in_world(box.pose, np.array([[0.0, 0.0, box.upper]])))[:, :2]
    axes = new_figure((3.0, 3.0), None).add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    draw_ground(axes, scene, camera)
    draw_painting(axes, Painter(scene, camera).paint(scene.at(0.0)))
    pictures = []
    for reach in (0.08, 1.5):  # on the face, and around the box
        axes.set(
            xlim=place[0] + reach * np.array([-1, 1]), ylim=place[1] + reach * np.array([-1, 1])
        )
        canvas: Any = axes.figure.canvas
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3].reshape(-1, 3).copy())
    assert np.max(np.ptp(pictures[0], axis=0)) <= 2
    assert np.any(np.all(pictures[1] == round(255 * float(GRID_COLOUR)), axis=1))


def test_a_film_that_cannot_be_made_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        save_film(tmp_path / "missing" / "flight.gif", short_scene())
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ho.InputError, match="film"):
        save_film(Path("flight.avi"), short_scene())
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UnsupportedError, match=r"flight\.MP4: needs imageio_ffmpeg"):
        save_film(Path("flight.MP4"), short_scene())


@pytest.mark.slow
def test_a_simulated_flight_is_filmed_from_its_directory(tmp_path: Path) -> None:
    motion, flight, film = make_motion(3), tmp_path / "simulation", tmp_path / "flight.gif"
    recorded(flight, np.random.default_rng(1).normal(size=(6, 30, 3)))
    command = ["view", str(flight), "--save"]
    assert "keep the two together" in CliRunner().invoke(main, [*command, str(film)]).output
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion), title="Three")
    assert CliRunner().invoke(main, [*command, str(film)]).exit_code == 0
    save_film(tmp_path / "own.gif", ghost_scene(flight, ho.Flight.of(motion)), "Three (flown)")
    assert film.read_bytes() == (tmp_path / "own.gif").read_bytes()
    assert CliRunner().invoke(main, [*command, str(film.with_suffix(".png"))]).exit_code == 2


def pair(*, others: bool = False) -> Flight:
    """Return a triangle below a square that begins a second later; others have a pillar."""
    first = planned("triangle").motion
    second = shifted(moved(planned("square_quarter_turn").motion, 0.0, 0.0, 4.0), 1.0)
    if others:
        pillar = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.5, at=[6.0, 0.0, 0.0], fixed=True)
        requirements = dataclasses.replace(second.requirements, objects={"pillar": pillar})
        second = second.replaced(requirements=requirements)
        return Flight((TeamMotion("", first),), (TeamMotion("show", second, "digest"),))
    return Flight((TeamMotion("a", first), TeamMotion("b", second)))


def test_a_scene_has_what_each_group_has_alone() -> None:
    """Drones and cables of each are those of its own scene; one that waits is at its start."""
    for flight in (pair(), pair(others=True)):
        t = np.array([0.0, 0.4, 2.0])
        scene, groups = scene_at(flight, t), flight.all_teams
        for group, drones, cables in zip(
            groups,
            np.split(scene.drones, [6], axis=1),
            np.split(scene.cables, [3], axis=1),
            strict=True,
        ):
            since = np.clip(t - group.motion.drones.breaks[0], 0.0, group.motion.duration)
            alone = scene_at(Flight.of(group.motion), since)
            assert np.allclose(drones, alone.drones, atol=1e-9)
            assert cables.shape == alone.cables.shape
            assert np.max(np.abs(cables - alone.cables)) < 0.05  # bends are as wide as cables
        assert np.allclose(scene.drones[0, 6:], scene.drones[1, 6:])


def test_teams_differ_by_colour_and_name() -> None:
    look, beside = (scene_at(pair(others=each), np.zeros(1)).appearance for each in (False, True))
    assert [label.name for label in look.labels] == ["a", "b"]
    assert len(set(look.drone_colours[:6])) == len(set(look.drone_colours[6:])) == 1
    assert look.drone_colours[0] != look.drone_colours[-1]
    assert look.drones[:2] + look.drones[-1:] == ("a.q0", "a.r0", "b.r3")
    assert look.hollow[:2] == (False, True)
    assert [clasp.name for clasp in look.clasps][3] == "b.p0"
    assert [label.name for label in beside.labels] == ["show"]
    assert set(beside.cable_colours[3:]) == {OTHERS_COLOUR}


@pytest.mark.parametrize("n", [*range(2, 13), 17, 33])
def test_neighbours_differ_by_colour_and_grey(n: int) -> None:
    colours = cable_colours(n)
    grey = (rgb(colours, linear=True) @ [0.2126, 0.7152, 0.0722]) ** (1.0 / 2.4)
    assert len(set(colours[:8])) == min(n, 8)
    assert np.min(np.abs(grey - np.roll(grey, -1))) > 0.09


# Linear colours as seen without red and without green cones (Machado et al. 2009)
DICHROMATS = (
    [[0.1523, 1.0526, -0.2049], [0.1145, 0.7863, 0.0992], [-0.0039, -0.0481, 1.0520]],
    [[0.3673, 0.8606, -0.2280], [0.2801, 0.6725, 0.0474], [-0.0118, 0.0429, 0.9689]],
)
# OKLab: cone responses of linear colours, and coordinates of their cube roots
CONES = np.array([[0.4122, 0.5363, 0.0514], [0.2119, 0.6807, 0.1074], [0.0883, 0.2817, 0.6300]])
OKLAB = np.array([[0.2105, 0.7936, -0.0041], [1.9780, -2.4286, 0.4506], [0.0259, 0.7828, -0.8087]])


@pytest.mark.parametrize(("seen", "apart"), [(np.eye(3), 0.14), *((x, 0.06) for x in DICHROMATS)])
def test_eight_colours_stay_apart(seen: object, apart: float) -> None:
    linear = np.clip(rgb(cable_colours(8), linear=True) @ np.array(seen).T, 0.0, 1.0)
    places = np.cbrt(linear @ CONES.T) @ OKLAB.T
    distances = np.linalg.norm(places[:, None] - places, axis=-1)
    assert np.min(distances[np.triu_indices(8, 1)]) > apart


def test_names_of_checks_are_found_in_their_team() -> None:
    parts = highlight_of(pair(), ["b.q1", "a.cable 2", "b.edge 1", "b.p0", "q0"])
    assert (parts.drones, parts.cables, parts.vertices) == ((8,), (2, 4), (3,))


@pytest.mark.parametrize("before", ["", "northern_", "of_northern_halls_"])
def test_names_of_teams_are_apart_and_on_no_drone(before: str) -> None:
    plan = planned("hitch_and_swarm")
    renamed = [dataclasses.replace(x, name=f"{before}{x.name}") for x in plan.flight.teams]
    flight, camera = Flight(tuple(renamed)), Camera.at_angles(AZIMUTH, ELEVATION)
    title = "A title that is as long as a headline " * 4
    figure, shots = draw_summary(flight, plan.certificate, title), choose_shots(plan.flight)
    figure.draw_without_rendering()
    scene = scene_at(flight, np.array([shot.time for shot in shots]))
    for axes, drones in zip(figure.axes, scene.drones, strict=False):
        texts = [t for t in axes.texts if t.get_fontweight() == "bold"]
        first, second = (text.get_window_extent() for text in texts)
        assert Bbox.intersection(first, second) is None
        for place in axes.transData.transform(camera.project(drones)[:, :2]):
            assert not first.contains(*place)
            assert not second.contains(*place)
        panel, written = axes.get_window_extent(), axes.title.get_window_extent()
        assert panel.x0 <= written.x0 < written.x1 <= panel.x1
    head = next(text for text in figure.texts if "limits hold" in text.get_text())
    for text in figure.axes[-3].texts:
        box = text.get_window_extent()
        assert box.y1 < figure.bbox.y1
        assert Bbox.intersection(box, head.get_window_extent()) is None
    names = [line.split()[-1] for phase in flight.phases for line in phase.name.split(", ")]
    drawn = [line for text in figure.axes[-3].texts for line in text.get_text().split("\n")]
    ends = [line.split()[-1] for line in drawn if line.split()[0] not in ("limit", "worst")]
    assert ends == names


def test_a_wall_that_is_passed_is_inside_of_a_panel() -> None:
    team = ho.Team(robots=3, cable_length=2.4)
    start = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.0), 1.5)
    motion = ho.solve(start, ho.Transport([6, 0, 1.5])).motion
    wall = ho.SolidObject(ho.Section(CORNERS), 0.0, 0.8, at=(3.0, 0.2, 0.0), fixed=True)
    requirements = dataclasses.replace(motion.requirements, objects={"wall": wall})
    motion = motion.replaced(requirements=requirements)
    shots = choose_shots(ho.Flight.of(motion))
    assert [shot.words for shot in shots] == ["start", "near wall", "transport"]
    figure, camera = new_figure((9.0, 3.0), None), Camera.at_angles(AZIMUTH, ELEVATION)
    draw_plan_storyboard(figure.add_gridspec(1, 1)[0], ho.Flight.of(motion), shots)
    figure.draw_without_rendering()
    projected = camera.project(
        in_world(wall.pose, np.array([[*c, z] for c in CORNERS for z in (0, 0.8)]))
    )
    pixels = figure.axes[1].transData.transform(projected[:, :2])
    assert all(figure.axes[1].bbox.contains(*place) for place in pixels)


def test_reports_and_pictures_show_all_teams(tmp_path: Path) -> None:
    flight = pair(others=True)
    plan = ho.Plan(flight, certify(flight), "Beside a show")
    plan.view(save=tmp_path / "plan.html")
    text = (tmp_path / "plan.html").read_text(encoding="utf-8")
    data = json.loads(next(iter(re.findall(r"<script[^>]*json[^>]*>(\{.*?)</script>", text, re.S))))
    assert data["names"][-1] == "show.r3"
    assert "next to show" in data["facts"]
    assert len(data["objects"]) == 1
    plan.view(save=tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 20_000
