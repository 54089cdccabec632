"""Recordings as drivers of motion capture and autopilots publish them, and lost bodies in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import typesys
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.errors import FileError
from hitchopt.lab.flights.bags import CAPTURE, MESSAGES, OPTITRACK, POSE
from hitchopt.values import Array
from tests.helpers import writers as w

PX4 = {
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\n"
    "float32[3] position\nfloat32[4] q\nuint8 velocity_frame\nfloat32[3] velocity\n"
    "float32[3] angular_velocity\nuint8 reset_counter\n",
    "px4_msgs/msg/VehicleLocalPosition": "uint64 timestamp\nbool xy_valid\nbool z_valid\n"
    "bool v_xy_valid\nbool v_z_valid\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 vx\nfloat32 vy\n"
    "float32 vz\n",
}
HEADED = "vicon_receiver/msg/Position"  # as newer drivers define it
T = np.arange(80) / 40.0
PATHS: dict[str, Array] = {
    f"cf{k}": np.stack([1.0 + 0.2 * k + 0.3 * np.sin(T + k), 0.4 * T - k, 0.8 + 0.1 * T], axis=1)
    for k in (1, 2, 3)
}
TURN = Rotation.from_euler("zyx", [0.7, 0.2, -0.1])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


class Ros:
    """Messages of ROS 2 by name."""

    def __init__(self, headed: bool = False) -> None:
        self.store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        texts = MESSAGES | PX4
        if headed:
            texts |= {HEADED: f"std_msgs/Header header\n{MESSAGES[HEADED]}"}
        for name, text in texts.items():
            self.store.register(typesys.get_types_from_msg(text, name))

    def __call__(self, name: str, *values: Any) -> Any:
        return self.store.types[name if "/" in name else f"geometry_msgs/msg/{name}"](*values)

    def header(self, t: float) -> Any:
        stamp = self("builtin_interfaces/msg/Time", *divmod(round(1e9 * (w.EPOCH + t)), 10**9))
        return self("std_msgs/msg/Header", stamp, "world")

    def pose(self, place: Array) -> Any:
        turn = TURN.as_quat() if np.any(place) else np.zeros(4)
        return self("Pose", self("Point", *place), self("Quaternion", *turn))


Messages = list[tuple[str, Any]]
"""Topics and messages of one time, from positions by body."""


def named_poses(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    poses = [ros(POSE, name, ros.pose(place)) for name, place in places.items()]
    latencies = [ros(f"{CAPTURE}/msg/LatencyInfo", "camera", 3000)]
    nanoseconds = round(1e9 * t)
    return [("/poses", ros(f"{POSE}ArrayV2", ros.header(t), nanoseconds, latencies, poses))]


def rigid_bodies(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    marker = ros(f"{OPTITRACK}/msg/Marker", 1, 0, "m", ros("Point", 1.0, 2.0, 3.0))
    bodies = [
        ros(f"{OPTITRACK}/msg/RigidBody", name, [marker], ros.pose(place))
        for name, place in places.items()
    ]
    return [("/rigid_bodies", ros(f"{OPTITRACK}/msg/RigidBodies", ros.header(t), 7, bodies))]


def vicon_positions(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    turn = TURN.as_quat()
    values = [ros.header(t)] if "header" in ros.store.types[HEADED].__annotations__ else []
    return [
        (
            f"/vicon/{name}/{name}",
            ros(HEADED, *values, *(1e3 * place), *turn, name, name, 3, "Global"),
        )
        for name, place in places.items()
    ]


def px4_odometry(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    """The first vehicle has no name space."""
    matrix = NED @ TURN.as_matrix() @ np.diag([1.0, -1.0, -1.0])
    x, y, z, scalar = Rotation.from_matrix(matrix).as_quat()
    messages: Messages = []
    for k, place in enumerate(places.values()):
        q = np.array([scalar, x, y, z], np.float32)
        three = (NED @ place).astype(np.float32), np.zeros(3, np.float32)
        microseconds = round(1e6 * (50.0 + t))
        values = microseconds + 900, microseconds, 1, three[0], q, 1, three[1], three[1], 0
        space = f"/px4_{k}" if k else ""
        name = "px4_msgs/msg/VehicleOdometry"
        messages.append((f"{space}/fmu/out/vehicle_odometry", ros(name, *values)))
    return messages


def px4_positions(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    return [
        (
            f"/{name}/fmu/out/vehicle_local_position",
            ros(
                "px4_msgs/msg/VehicleLocalPosition",
                round(1e6 * (50.0 + t)),
                *[True] * 4,
                *(NED @ place),
                0.0,
                0.0,
                0.0,
            ),
        )
        for name, place in places.items()
    ]


def stamped_poses(ros: Ros, t: float, places: dict[str, Array]) -> Messages:
    return [
        (f"/vicon/{name}/{name}/pose", ros("PoseStamped", ros.header(t), ros.pose(place)))
        for name, place in places.items()
    ]


Driver = Callable[[Ros, float, dict[str, Array]], Messages]
DRIVERS: tuple[Driver, ...] = (
    *(named_poses, rigid_bodies, vicon_positions, px4_odometry, px4_positions, stamped_poses),
)


def write(folder: Path, driver: Driver, paths: dict[str, Array], *, headed: bool = False) -> Path:
    ros = Ros(headed)
    messages = [
        (t, topic, message)
        for i, t in enumerate(T.tolist())
        for topic, message in driver(ros, t, {name: path[i] for name, path in paths.items()})
    ]
    kind = "mcap" if headed or "px4" in driver.__name__ else "sqlite3"  # with definitions, without
    return w.write_messages(folder, messages, kind, ros.store)


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("headed", [False, True])
def test_the_messages_of_drivers_are_read(driver: Driver, headed: bool, tmp_path: Path) -> None:
    flight = ho.read_flight(write(tmp_path / "bag", driver, PATHS, headed=headed))
    names = ["fmu", "px4_1", "px4_2"] if driver is px4_odometry else [*PATHS]
    assert sorted(flight.tracks) == sorted(names)
    for name, path in zip(names, PATHS.values(), strict=True):
        track = flight.tracks[name]
        np.testing.assert_allclose(track.positions, path, atol=1e-6)
        np.testing.assert_allclose(track.t - track.t[0], T, atol=1e-3)
        if driver is px4_positions or (driver is px4_odometry):
            continue
        assert "attitude" not in flight.signals.get(name, {})  # it does not change


LOST: dict[str, list[int]] = {
    "single samples": [3, 30, 31, 60],
    "the first": [0, 1, 2],
    "the last": [77, 78, 79],
    "most": list(range(5, 75)),
}


@pytest.mark.parametrize("lost", LOST)
@pytest.mark.parametrize("driver", [d for d in DRIVERS if d is not px4_odometry])
def test_lost_bodies_of_zeros_are_gaps(driver: Driver, lost: str, tmp_path: Path) -> None:
    paths = {name: path.copy() for name, path in PATHS.items()}
    paths["cf2"][LOST[lost]] = 0.0
    flight = ho.read_flight(write(tmp_path / "bag", driver, paths))
    seen = np.delete(PATHS["cf2"], LOST[lost], axis=0)
    np.testing.assert_allclose(flight.tracks["cf2"].positions, seen, atol=1e-6)
    assert all(len(flight.tracks[name].t) == len(T) for name in ("cf1", "cf3"))
    assert f"{len(LOST[lost])} samples omitted: x = y = z = 0" in " ".join(flight.notes)


@pytest.mark.parametrize("owner", ["name", "drone"])
def test_tables_have_gaps_of_zeros_and_our_own_columns(owner: str, tmp_path: Path) -> None:
    """Drones that really begin or end near the origin stay there."""
    near = {"near": np.zeros((len(T), 3))}
    near["near"][25:] = np.linspace([0.0, 0.0, 0.05], [0.0, 0.0, 2.0], len(T) - 25)
    paths = {name: path.copy() for name, path in PATHS.items()}
    paths["cf1"][[10, 11, 40]] = 0.0
    paths |= near | {"never": np.zeros_like(PATHS["cf1"])}
    lines = [f"t,{owner},x,y,z,note"]
    for i, t in enumerate(T.tolist()):
        lines += [
            ",".join([f"{t:.4f}", name, *(f"{x:.6f}" for x in path[i]), "-"])
            for name, path in paths.items()
        ]
    (tmp_path / "flight.csv").write_text("\n".join(lines), "utf-8")
    flight = ho.read_flight(tmp_path / "flight.csv")
    assert sorted(flight.tracks) == ["cf1", "cf2", "cf3", "near"]
    assert {name: len(track.t) for name, track in flight.tracks.items()} == dict.fromkeys(
        ("cf1",), 77
    ) | dict.fromkeys(("cf2", "cf3", "near"), 80)
    assert f"{3 + len(T)} samples omitted" in " ".join(flight.notes)


def test_setpoints_of_a_plan_are_read_as_a_flight(tmp_path: Path) -> None:
    team = ho.Team(3, 2.4)
    start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
    plan = ho.morph(start, [[0, -0.9], [-0.4, 0.5], [0.4, 0.5]])
    plan.save(tmp_path / "plan")
    flight = ho.read_flight(tmp_path / "plan" / "setpoints.csv")
    assert [*flight.tracks] == ["q0", "r0", "q1", "r1", "q2", "r2"]
    track = flight.tracks["r1"]
    for t, place in zip(track.t[::20], track.positions[::20], strict=True):
        np.testing.assert_allclose(place, plan.at(float(t)).positions[3], atol=1e-7)


def qualisys(times: str, cells: Callable[[int], str]) -> str:
    """A table whose frames are triggered by another clock, with one body in millimetres."""
    titles = ["Frame", *(["Time"] if times else []), "q0 X", "q0 Y", "q0 Z"]
    head = "NO_OF_FRAMES\t9\nNO_OF_MARKERS\t1\nFREQUENCY\tEXT\nMARKER_NAMES\tq0\n"
    rows = [[f"{k + 1}", *([f"{0.1 * k**1.1:.5f}"] if times else []), cells(k)] for k in range(30)]
    return head + "\n".join("\t".join(row) for row in [titles, *rows])


def test_frames_of_an_external_clock_have_the_times_of_their_column(tmp_path: Path) -> None:
    """Gaps are written as NULL, blank or zeros."""
    gaps = {4: "NULL\tNULL\tNULL", 7: "\t\t", 9: "0.000\t0.000\t0.000"}
    path = tmp_path / "flight.tsv"
    path.write_text(qualisys("Time", lambda k: gaps.get(k, f"{10.0 * k}\t500.0\t1000.0")), "utf-8")
    track = ho.read_flight(path).tracks["q0"]
    frames = np.delete(np.arange(30), [*gaps])
    np.testing.assert_allclose(track.t, 0.1 * frames**1.1, atol=1e-5)
    np.testing.assert_allclose(track.positions[:, 0], 0.01 * frames, atol=1e-9)
    path.write_text(qualisys("", lambda k: f"{k}\t500.0\t1000.0"), "utf-8")
    with pytest.raises(FileError, match="FREQUENCY of EXT, and no column Time"):
        ho.read_flight(path)
