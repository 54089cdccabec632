"""Exported files agree with the plan, by independent readers and by lint."""

from __future__ import annotations

import contextlib
import csv
import json
import re
import sqlite3
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.directory import write_setpoints, write_vertices
from hitchopt.errors import FileError, InfeasibleError, InputError, UnsupportedError
from hitchopt.exports.contents import read_manifest
from hitchopt.exports.exporting import export_flight
from hitchopt.exports.format import format_of
from hitchopt.exports.lint import lint
from hitchopt.exports.options import HOMES, ExportOptions
from hitchopt.hitch import GRAVITY
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.flight import Flight, drone_places
from hitchopt.motion.plan_file import SavedPlan
from hitchopt.motion.states import sample_times, states_at
from hitchopt.view.style import drone_colours
from tests.helpers.by_hand import catenary
from tests.helpers.exported_plans import (
    EACH_FORMAT,
    Array,
    exported,
    hitch_plan,
    swarm_plan,
    task_of,
)
from tests.helpers.format_readers import READERS, bag_messages, glb_animation, vector
from tests.helpers.plans import planned

MOTIONS = {"hitch": hitch_plan, "swarm": swarm_plan}

PLACE: dict[str, Any] = {"origin": [2.0, -1.0, 0.5], "yaw": 0.4}

AXES = {
    "enu": lambda x, y, z: (x, y, z),
    "nwu": lambda x, y, z: (y, -x, z),
    "ned": lambda x, y, z: (y, x, -z),
}

FRAMES = [(name, frame) for name in HOMES for frame in format_of(name).frames]
CASES = [
    *((*each, "hitch") for each in FRAMES),
    *((name, format_of(name).frames[0], "swarm") for name in HOMES),
]

RATE = 25.0  # [Hz]


def in_file(frame: str, v: Array) -> Array:
    """Turned by the yaw of PLACE, then along the file's axes."""
    c, s = np.cos(PLACE["yaw"]), np.sin(PLACE["yaw"])
    east, north = c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]
    return np.stack(AXES[frame](east, north, v[..., 2]), axis=-1)


@pytest.mark.parametrize(("name", "frame", "motion"), CASES)
def test_the_file_is_the_plan(name: str, frame: str, motion: str, tmp_path: Path) -> None:
    plan = MOTIONS[motion]()
    kind, team = format_of(name), plan.team
    (part,) = exported(plan, name, tmp_path, frame=frame, **PLACE)
    verdict = part.verdict
    assert verdict.violated == ()
    assert verdict.position.worst <= kind.accuracy <= 2e-3
    read = READERS[name](tmp_path, team.drone_names, np.linspace(0.0, plan.duration, 80))
    assert -1e-8 <= read.t[-1] - plan.duration < 0.05
    if kind.rate:
        single = 1e-6 if name == "gltf" else 1e-9  # whose times have single precision
        np.testing.assert_allclose(np.diff(read.t)[:-1], 1.0 / kind.rate, atol=single)
    states = states_at(plan, read.t)
    origin = np.array(AXES[frame](*PLACE["origin"]))
    apart = np.linalg.norm(read.places - in_file(frame, states.positions) - origin, axis=-1)
    assert np.max(apart) <= verdict.position.worst + 1e-6
    if read.velocities is not None:
        apart = np.linalg.norm(read.velocities - in_file(frame, states.velocities), axis=-1)
        assert np.max(apart) <= verdict.velocity.worst + 1e-6
    if read.forward is not None:  # m (a_ff + g up) is the thrust
        up = np.array([0.0, 0.0, -GRAVITY if frame == "ned" else GRAVITY])
        thrust = in_file(frame, states.thrusts(team))
        np.testing.assert_allclose(team.mass[:, None] * (read.forward + up), thrust, atol=1e-6)
    if read.quaternions is not None and read.rates is not None:
        found = Rotation.from_quat(read.quaternions.reshape(-1, 4), scalar_first=True)
        specific = thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
        upward = [0.0, 0.0, -1.0 if frame == "ned" else 1.0]
        np.testing.assert_allclose(found.apply(upward), specific.reshape(-1, 3), atol=1e-9)
        ahead = found.apply([1.0, 0.0, 0.0])
        east = in_file(frame, np.array([1.0, 0.0, 0.0]))
        np.testing.assert_allclose(ahead[:, 0] * east[1], ahead[:, 1] * east[0], atol=1e-9)
        assert np.all(ahead @ east > 0.0)
        turning = np.linalg.norm(read.rates[..., :2], axis=-1)
        expected = np.linalg.norm(states.body_rates[..., :2], axis=-1)
        np.testing.assert_allclose(turning, expected, atol=1e-8)
    (linted,) = lint(tmp_path)
    noted = {"tension"} | ({"velocities"} if kind.velocity_settings else set())
    noted |= {"start"} if name == "skybrush" else set()  # the plan begins in the air
    assert {finding.rule for finding in linted.findings} <= noted
    assert (linted.kind, linted.frame, len(linted.facts)) == (name, frame, len(team.drone_names))
    receiver = read_manifest(tmp_path).get("receiver", {})
    begin = receiver.get("plan_begins_s", 0.0)
    checks = {check.name: check.worst for check in verdict.checks}
    assert linted.flight.separation == pytest.approx(checks["separation"], rel=2e-3)
    assert linted.flight.speed == pytest.approx(max(checks["speed"], 0.5 * (begin > 0)), rel=2e-3)
    assert linted.flight.duration == pytest.approx(verdict.duration + begin)


@pytest.mark.parametrize("name", ["crazyswarm2", "compressed", "skybrush"])
@pytest.mark.parametrize(
    "stem", ["open_chain", pytest.param("narrow_arena", marks=pytest.mark.slow)]
)
def test_refitted_problems_lose_nothing(stem: str, name: str, tmp_path: Path) -> None:
    (part,) = exported(planned(stem).motion, name, tmp_path)
    assert part.verdict.violated == ()


def test_an_export_that_enters_a_prism_is_refused(tmp_path: Path) -> None:
    """The path keeps 0.12009 m; in whole millimetres it begins at 0.1196 m."""
    y = 0.12049
    prism = [[-3.0, -1.0], [-3.0, 0.0004], [3.0, 0.0004], [3.0, -1.0]]
    problem = {
        "team": {"drones": 1},
        "start": [[-1.5, y, 1.0]],
        "goal": [[1.5, y, 1.0]],
        "keep_out": [{"polygon": prism, "lower": 0.0, "upper": 3.0}],
    }
    motion = ho.solve(problem_from_dict(problem)).motion
    exported(motion, "csv", tmp_path / "csv")
    with pytest.raises(InfeasibleError, match=r"keep_out.*sample at a higher rate="):
        exported(motion, "compressed", tmp_path / "compressed")
    assert not (tmp_path / "compressed").exists()


@pytest.mark.parametrize("name", ["parquet", "ros2bag"])
def test_a_missing_library_is_named_with_its_installation(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("pyarrow", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UnsupportedError, match=r"pip install 'hitchopt\[export\]'"):
        exported(swarm_plan(), name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_manifest_says_frame_drones_errors_and_checks(tmp_path: Path) -> None:
    (part,) = exported(hitch_plan(), "csv", tmp_path, frame="ned", **PLACE)
    told = read_manifest(tmp_path)
    assert (told["frame"], told["origin_enu"]) == ("ned", [2.0, -1.0, 0.5])
    assert told["yaw_deg"] == pytest.approx(np.degrees(0.4))
    assert told["drones"] == {name: name for name in hitch_plan().team.drone_names}
    assert told["position_error_m"]["worst"] == part.verdict.position.worst
    assert [c["name"] for c in told["checks"]] == [c.name for c in part.verdict.checks]


@pytest.mark.parametrize("name", HOMES)
def test_equal_plans_give_equal_files_at_any_time(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for day, folder in enumerate(("one", "other")):
        now = time.struct_time((2026, 1, 1 + day, 12, 0, 0, 0, 1, 0))
        monkeypatch.setattr(time, "localtime", lambda *_, now=now: now)
        exported(swarm_plan(), name, tmp_path / folder)
    files = [path for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert files
    for path in files:
        assert (
            path.read_bytes()
            == (tmp_path / "other" / path.relative_to(tmp_path / "one")).read_bytes()
        )


@pytest.mark.parametrize("name", EACH_FORMAT)
def test_every_folder_says_which_drone_holds_which_edge(name: str, tmp_path: Path) -> None:
    plan = hitch_plan()
    exported(plan, name, tmp_path)
    note = (tmp_path / "README.txt").read_text("utf-8")
    names = read_manifest(tmp_path)["drones"]
    for row in drone_places(Flight.of(plan)):
        cells = (names[row["drone"]], *row.values())
        assert re.search(" +".join(map(re.escape, cells)) + "\n", note), note


def test_only_files_of_exports_are_replaced(tmp_path: Path) -> None:
    folder, other = tmp_path / "out", tmp_path / "other"
    exported(swarm_plan(), "csv", folder)
    (folder / "mine.txt").write_text("mine")
    exported(swarm_plan(), "parquet", folder)
    names = {"export.json", "exported_plan.npz", "mine.txt", "setpoints.parquet"}
    assert {p.name for p in folder.iterdir()} == names
    other.mkdir()
    (other / "setpoints.parquet").write_text("somebody's")
    with pytest.raises(FileError, match="is not an export"):
        exported(swarm_plan(), "parquet", other)
    assert (other / "setpoints.parquet").read_text() == "somebody's"


@pytest.mark.parametrize("frame", AXES)
def test_attitudes_turn_as_their_rates_say(frame: str) -> None:
    """Differentiated numerically: the body's rates are those of the quaternions."""
    task = task_of(hitch_plan(), "csv", frame=frame, yaw=0.4)
    t, h = np.array([0.21, 0.4, 1.9]), 1e-5
    before, now, after = (task.samples(t + d) for d in (-h, 0.0, h))
    turned = [
        Rotation.from_quat(each["quaternions"].reshape(-1, 4), scalar_first=True)
        for each in (before, after)
    ]
    rates = (turned[0].inv() * turned[1]).as_rotvec() / (2 * h)
    np.testing.assert_allclose(rates, now["body_rates"].reshape(-1, 3), atol=2e-4)
    assert np.max(np.abs(now["body_rates"])) > 0.05


def numbers(path: Path, columns: str, **wanted: str) -> Array:
    """Columns of a table."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if wanted.items() <= row.items()]
    cells = [[row[name] for name in columns.split()] for row in rows]
    return np.array(cells, dtype=np.float64)


def test_the_tables_of_a_solve_and_of_an_export_are_the_plan(tmp_path: Path) -> None:
    motion, rate = hitch_plan(), 37.0
    t, done = sample_times(motion.duration, rate), list[float]()
    write_setpoints(tmp_path / "s.csv", ho.Flight.of(motion), rate, done.append)
    assert done == sorted(done)
    assert done[-1] == 1.0
    exported(motion, "csv", tmp_path / "out", rate=rate)
    header, *rows, end = (tmp_path / "s.csv").read_text().split("\n")
    assert header == "t,drone,x,y,z,vx,vy,vz,ax,ay,az,jx,jy,jz,yaw,cable_x,cable_y,cable_z"
    assert end == ""
    assert [row.split(",")[1] for row in rows] == list(motion.team.drone_names) * len(t)
    leg = motion.drones.at(t)[:, 5] - motion.vertices.at(t)[:, 0]  # r2 hangs on p_0
    _, end_of_leg, _ = catenary(leg, np.full(len(leg), 0.42), np.full(len(leg), 0.5 * 9.81 * 0.002))
    pull = -end_of_leg
    for file, rounding in (
        (tmp_path / "s.csv", 5e-9),  # nine significant digits
        (tmp_path / "out" / "setpoints_enu.csv", 5e-12),
    ):
        times = np.repeat(t, 6)[:, None] * [1.0, 0.0]
        np.testing.assert_allclose(numbers(file, "t yaw"), times, atol=1e-11, rtol=rounding)
        for order, columns in enumerate(("x y z", "vx vy vz", "ax ay az", "jx jy jz")):
            expected = motion.drones.at(t, order).reshape(-1, 3)
            np.testing.assert_allclose(numbers(file, columns), expected, atol=1e-8, rtol=5e-9)
        found = numbers(file, "cable_x cable_y cable_z", drone="r2")
        np.testing.assert_allclose(found, pull, atol=1e-9)
    write_vertices(tmp_path / "v.csv", ho.Flight.of(motion), rate)
    assert (tmp_path / "v.csv").read_text().split("\n")[0] == "t,vertex,x,y,z,tension,balanced"
    for k, tension in enumerate(motion.team.tension):
        found = numbers(tmp_path / "v.csv", "t x y z tension", vertex=str(k))
        expected = np.column_stack([t, motion.vertices.at(t)[:, k], np.full(len(t), tension)])
        np.testing.assert_allclose(found, expected, atol=1e-9, rtol=5e-9)
    first, *others = motion.phases  # vertices are written while the hitch exists
    later = replace(motion, phases=(replace(first, state=CableState.FREE), *others))
    write_vertices(tmp_path / "later.csv", ho.Flight.of(later), rate)
    found = numbers(tmp_path / "later.csv", "t", vertex="0")[:, 0]
    np.testing.assert_allclose(found, t[t >= first.end], rtol=5e-9)


def test_trajectories_and_paths_of_a_bag_are_those_of_its_setpoints(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "ros2bag", tmp_path, rate=RATE, frame="nwu")
    found = bag_messages(tmp_path / "setpoints.mcap")
    states = states_at(motion, sample_times(motion.duration, RATE))
    for i, name in enumerate(motion.team.drone_names):
        ((_, trajectory),), ((_, path),) = found[f"/{name}/trajectory"], found[f"/{name}/path"]
        assert (trajectory.header.frame_id, trajectory.joint_names) == ("map_nwu", [name])
        sent = found[f"/{name}/cmd_full_state"]
        for k, (point, pose, (at, now)) in enumerate(
            zip(trajectory.points, path.poses, sent, strict=True)
        ):
            assert point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec == (
                pytest.approx(at, abs=1e-9)
            )
            place, velocity = point.transforms[0], point.velocities[0]
            assert vector(place.translation) == vector(now.pose.position)
            assert vector(pose.pose.position) == vector(now.pose.position)
            assert vector(place.rotation) == vector(now.pose.orientation)
            assert vector(velocity.linear) == vector(now.twist.linear)
            x, y, z = states.accelerations[k, i]
            own = vector(point.accelerations[0].linear)
            np.testing.assert_allclose(own, [y, -x, z], atol=1e-12)
            # Body rates here, the same about the frame's axes in the trajectory.
            q = now.pose.orientation
            turned = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(vector(now.twist.angular))
            np.testing.assert_allclose(vector(velocity.angular), turned, atol=1e-12)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("distro", [None, "humble", "iron", "jazzy"])
def test_bags_are_readable_by_releases(distro: str | None, storage: str, tmp_path: Path) -> None:
    """Humble and Iron read profiles of quality of service as text: a list stops them. What is
    written if nobody says which release is read by all of them."""
    asked: dict[str, Any] = {} if distro is None else {"ros_distro": distro}
    options = ExportOptions("ros2bag", rate=RATE, storage=storage, **asked)
    (part,) = export_flight(SavedPlan(ho.Flight.of(swarm_plan()), "A plan"), options, tmp_path)
    assert part.verdict.position.worst < 1e-6
    bag = YAML(typ="safe").load(tmp_path / "metadata.yaml")["rosbag2_bagfile_information"]
    topics = [topic["topic_metadata"] for topic in bag["topics_with_message_count"]]
    profiles = [topic["offered_qos_profiles"] for topic in topics]
    expected: tuple[int, list[Any]] = (9, [[]] * 9) if distro == "jazzy" else (8, [""] * 9)
    assert (bag["version"], profiles) == expected
    assert {topic["serialization_format"] for topic in topics} == {"cdr"}
    assert bag["storage_identifier"] == storage
    assert bag["relative_file_paths"] == [file["path"] for file in bag["files"]]
    assert all((tmp_path / file).exists() for file in bag["relative_file_paths"])
    count = 3 * (2 + len(sample_times(swarm_plan().duration, RATE)))
    assert sum(file["message_count"] for file in bag["files"]) == bag["message_count"] == count
    assert bag["starting_time"]["nanoseconds_since_epoch"] == 0
    if storage == "sqlite3":
        with contextlib.closing(sqlite3.connect(tmp_path / "setpoints.db3")) as database:
            assert database.execute("select count(*) from messages").fetchone() == (count,)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("ros_distro", "foxy", "ros_distro = 'foxy': must be humble, iron or jazzy"),
        ("storage", "tape", "storage = 'tape': must be mcap or sqlite3"),
    ],
)
def test_wrong_options_are_refused(option: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ExportOptions("ros2bag", **{option: value})  # type: ignore[arg-type]


def y_up(points: Array) -> Array:
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def shades(path: Path, names: Sequence[str]) -> list[list[list[float]]]:
    """Return linear red, green and blue of the parts of nodes in a .glb."""
    data = path.read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    nodes = {node["name"]: node for node in content["nodes"]}
    materials = [each["pbrMetallicRoughness"]["baseColorFactor"] for each in content["materials"]]
    parts = (content["meshes"][nodes[name]["mesh"]]["primitives"] for name in names)
    return [[materials[part["material"]][:3] for part in each] for each in parts]


def srgb_to_linear(colour: str) -> list[float]:
    """Return the intensities of a colour's light, by a power law that is close to sRGB's."""
    return [((float(x) + 0.055) / 1.055) ** 2.4 for x in to_rgb(colour)]


@pytest.mark.parametrize("stem", ["", pytest.param("carry_tray", marks=pytest.mark.slow)])
def test_nodes_of_a_scene_are_where_the_plan_has_them(stem: str, tmp_path: Path) -> None:
    """Loaded by trimesh; spans of a cable lead from drone to drone and turn smoothly."""
    import trimesh

    motion = planned(stem).motion if stem else hitch_plan()
    exported(motion, "gltf", tmp_path)
    graph = trimesh.load_scene(tmp_path / "plan.glb").graph
    objects, team = list(motion.requirements.objects), motion.team
    cables = [f"cable {k}" for k in range(3)]
    assert {*team.drone_names, *objects, *cables} <= set(graph.nodes)
    moved = glb_animation(tmp_path / "plan.glb")
    shown = [rim for _, _, rim in shades(tmp_path / "plan.glb", team.drone_names)]
    expected = [srgb_to_linear(colour) for colour in drone_colours(team)]
    np.testing.assert_allclose(shown, expected, atol=2e-3)  # the colours of pictures
    t, _ = moved["q0"]["translation"]
    states = states_at(motion, np.minimum(t, motion.duration))
    for i, name in enumerate(team.drone_names):
        places = y_up(states.positions[:, i])
        np.testing.assert_allclose(moved[name]["translation"][1], places, atol=1e-5)
        np.testing.assert_allclose(graph[name][0][:3, 3], places[0], atol=1e-5)
        upward = Rotation.from_quat(moved[name]["rotation"][1]).apply([0.0, 1.0, 0.0])
        thrust = y_up(states.thrusts(team)[:, i])
        across = np.cross(upward, thrust / np.linalg.norm(thrust, axis=-1, keepdims=True))
        assert np.max(np.abs(across)) < 1e-5  # single precision
    for i, name in enumerate(objects):
        places = y_up(states.object_poses[:, i, :3])
        np.testing.assert_allclose(moved[name]["translation"][1], places, atol=1e-5)
    for k in range(0 if stem else 3):
        ends = []
        for name in (name for name in moved if name.startswith(f"cable {k} span")):
            paths = (moved[name][path][1] for path in ("translation", "rotation", "scale"))
            middle, turned, scale = paths
            half = Rotation.from_quat(turned).apply([0.0, 0.5, 0.0]) * scale[:, 1:2]
            ends.append((middle - half, middle + half))
            assert np.min(np.sum(turned[1:] * turned[:-1], axis=1)) > 0.9
        for (_, before), (after, _) in pairwise(ends):
            np.testing.assert_allclose(before, after, atol=1e-5)
        np.testing.assert_allclose(ends[0][0], moved[f"q{k}"]["translation"][1], atol=1e-5)
        np.testing.assert_allclose(ends[-1][1], moved[f"r{k}"]["translation"][1], atol=1e-5)
        lengths = sum(np.linalg.norm(b - a, axis=-1) for a, b in ends)
        # Drawn hooks are larger than real ones, so that drawn cables are a little longer.
        np.testing.assert_allclose(lengths, team.cable_length[k], rtol=0.04)


def test_vertices_are_marked_while_tensions_rise_or_fall(tmp_path: Path) -> None:
    plan = planned("form_triangle")
    write_vertices(tmp_path / "v.csv", plan.flight, 20.0)
    t, balanced = numbers(tmp_path / "v.csv", "t balanced", vertex="0").T
    ramps = [phase for phase in plan.motion.phases if phase.name in ("tension", "relax")]
    assert ramps
    inside = np.zeros(len(t), dtype=np.bool_)
    for phase in ramps:
        inside |= (t > phase.start + 1e-6) & (t < phase.end - 1e-6)
    assert np.all(balanced[inside] == 0.0)
    ends = [end for phase in ramps for end in (phase.start, phase.end)]
    at_ends = np.any(np.abs(t[:, None] - ends) <= 1e-6, axis=1)
    assert np.all(balanced[~inside & ~at_ends] == 1.0)
