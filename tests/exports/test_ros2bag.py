"""Bags written with rosbags, read with mcap-ros2-support and with sqlite3."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import certificate_of, exported, hitch_plan, swarm_plan, task_of
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray
from rosbags.rosbag2 import Writer
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError, InputError
from hitchopt.exports.export_options import ExportOptions
from hitchopt.exports.exporting import export_plan
from hitchopt.exports.formats.attitude_in_frame import attitudes_of
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.formats.ros2_messages import Messages, bag_recording
from hitchopt.exports.plan_export import export_motion
from hitchopt.exports.verification import verify
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import sample_times, states_at

Array = NDArray[np.float64]

RATE = 25.0


def messages(path: Path) -> dict[str, list[tuple[float, Any]]]:
    found: dict[str, list[tuple[float, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((1e-9 * message.log_time, decoded))
    return found


def vector(message: Any) -> Array:
    return np.array([message.x, message.y, message.z])


def test_an_independent_reader_sees_the_plan(tmp_path: Path) -> None:
    motion = hitch_plan()
    (part,) = exported(motion, "ros2bag", tmp_path, rate=RATE, frame="nwu")
    assert part.verdict.lost == ()
    found = messages(tmp_path / "setpoints.mcap")
    kinds = ("trajectory", "path", "cmd_full_state")
    names = motion.team.drone_names
    assert set(found) == {f"/{name}/{kind}" for name in names for kind in kinds}
    t = sample_times(motion.duration, RATE)
    states = states_at(motion, t)

    def nwu(v: Array) -> Array:
        return np.stack([v[..., 1], -v[..., 0], v[..., 2]], axis=-1)

    for i, name in enumerate(names):
        ((_, trajectory),) = found[f"/{name}/trajectory"]
        assert trajectory.header.frame_id == "map_nwu"
        assert trajectory.joint_names == [name]
        times = [
            p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in trajectory.points
        ]
        np.testing.assert_allclose(times, t, atol=1e-9)
        place = np.array([vector(p.transforms[0].translation) for p in trajectory.points])
        speed = np.array([vector(p.velocities[0].linear) for p in trajectory.points])
        own = np.array([vector(p.accelerations[0].linear) for p in trajectory.points])
        np.testing.assert_allclose(place, nwu(states.positions[:, i]), atol=1e-12)
        np.testing.assert_allclose(speed, nwu(states.velocities[:, i]), atol=1e-12)
        np.testing.assert_allclose(own, nwu(states.accelerations[:, i]), atol=1e-12)
        ((_, path),) = found[f"/{name}/path"]
        assert np.array_equal([vector(p.pose.position) for p in path.poses], place)
        setpoints = found[f"/{name}/cmd_full_state"]
        np.testing.assert_allclose([at for at, _ in setpoints], t, atol=1e-9)
        for k, (_, setpoint) in enumerate(setpoints):
            assert np.array_equal(vector(setpoint.pose.position), place[k])
            assert np.array_equal(vector(setpoint.twist.linear), speed[k])
            thrust = nwu(states.thrusts(motion.team)[k, i])
            specific = vector(setpoint.acc) + np.array([0.0, 0.0, GRAVITY])
            np.testing.assert_allclose(motion.team.mass[i] * specific, thrust, atol=1e-9)
            q = setpoint.pose.orientation
            turned = Rotation.from_quat([q.x, q.y, q.z, q.w])
            upward = turned.apply([0.0, 0.0, 1.0])
            np.testing.assert_allclose(upward, thrust / np.linalg.norm(thrust), atol=1e-9)
            # Body rates here, the same about the frame's axes in the trajectory.
            point = trajectory.points[k]
            same = point.transforms[0].rotation
            assert (same.x, same.y, same.z, same.w) == (q.x, q.y, q.z, q.w)
            turning = vector(point.velocities[0].angular)
            rates = vector(setpoint.twist.angular)
            np.testing.assert_allclose(turned.apply(rates), turning, atol=1e-12)
            np.testing.assert_allclose(
                np.linalg.norm(rates[:2]), np.linalg.norm(states.body_rates[k, i, :2]), atol=1e-9
            )


def test_sqlite_holds_the_same(tmp_path: Path) -> None:
    motion = swarm_plan()
    options = ExportOptions("ros2bag", storage="sqlite3")
    task = task_of(motion, "ros2bag", RATE)
    kind = format_of("ros2bag")
    export_plan(kind, replace(task, options=options), certificate_of(motion), tmp_path)
    with sqlite3.connect(tmp_path / "setpoints.db3") as database:
        topics = {name for (name,) in database.execute("select name from topics")}
        (count,) = database.execute("select count(*) from messages").fetchone()
    database.close()
    assert topics == {
        f"/d{i}/{kind}" for i in range(3) for kind in ("trajectory", "path", "cmd_full_state")
    }
    assert count == 3 * (2 + len(sample_times(motion.duration, RATE)))
    verdict = verify(motion, bag_recording(tmp_path), task.frame, task.names)
    assert verdict.position.worst < 1e-6


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("distro", [None, "humble", "iron", "jazzy"])
def test_metadata_are_what_a_release_reads(
    distro: str | None, storage: str, tmp_path: Path
) -> None:
    """Humble and Iron read profiles of quality of service as text: a list stops them. What is
    written if nobody says which release is read by all of them."""
    asked: dict[str, Any] = {} if distro is None else {"ros_distro": distro}
    options = ExportOptions("ros2bag", rate=RATE, storage=storage, **asked)
    export_motion(swarm_plan(), "A plan", options, tmp_path / "bag")
    content = YAML(typ="safe").load(tmp_path / "bag" / "metadata.yaml")
    bag = content["rosbag2_bagfile_information"]
    topics = [topic["topic_metadata"] for topic in bag["topics_with_message_count"]]
    assert len(topics) == 9
    profiles = [topic["offered_qos_profiles"] for topic in topics]
    if distro == "jazzy":
        assert (bag["version"], profiles) == (9, [[]] * 9)
    else:
        assert (bag["version"], profiles) == (8, [""] * 9)
    # What the readers of all three convert to numbers, text, lists and maps, without asking.
    for topic in topics:
        assert all(isinstance(topic[key], str) for key in ("name", "type", "type_description_hash"))
        assert topic["serialization_format"] == "cdr"
    assert bag["storage_identifier"] == storage
    assert bag["relative_file_paths"] == [file["path"] for file in bag["files"]]
    assert all((tmp_path / "bag" / file).exists() for file in bag["relative_file_paths"])
    assert sum(file["message_count"] for file in bag["files"]) == bag["message_count"]
    assert bag["duration"]["nanoseconds"] >= 0
    assert bag["starting_time"]["nanoseconds_since_epoch"] == 0
    assert (bag["compression_format"], bag["compression_mode"]) == ("", "")
    assert isinstance(bag["custom_data"], dict | None)
    assert isinstance(bag["ros_distro"], str)


def test_another_release_is_refused() -> None:
    with pytest.raises(InputError, match="--ros-distro = 'foxy': must be humble, iron, jazzy"):
        ExportOptions("ros2bag", ros_distro="foxy")
    with pytest.raises(InputError, match="--storage = 'tape': must be mcap or sqlite3"):
        ExportOptions("ros2bag", storage="tape")


def test_attitudes_turn_as_their_rates_say() -> None:
    """Differentiated numerically: the body's rates are those of the quaternions."""
    motion = hitch_plan()
    task = task_of(motion, "ros2bag", frame="nwu", yaw=0.4)
    t, h = np.array([0.21, 0.4, 1.9]), 1e-5
    now = attitudes_of(task, states_at(motion, t))
    before, after = (attitudes_of(task, states_at(motion, t + d)) for d in (-h, h))
    flat = [
        Rotation.from_quat(a.quaternions.reshape(-1, 4), scalar_first=True) for a in (before, after)
    ]
    turned = (flat[0].inv() * flat[1]).as_rotvec() / (2 * h)
    np.testing.assert_allclose(turned, now.body_rates.reshape(-1, 3), atol=2e-4)
    assert np.max(np.abs(now.body_rates)) > 0.05
    turned_now = Rotation.from_quat(now.quaternions.reshape(-1, 4), scalar_first=True)
    ahead = turned_now.apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.arctan2(ahead[:, 1], ahead[:, 0]), task.frame.heading, atol=1e-9)


def test_a_bag_of_other_messages_is_reported(tmp_path: Path) -> None:
    store = Messages().store
    with Writer(tmp_path / "bag", version=9) as bag:
        topic = bag.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("hello")
        bag.write(topic, 0, store.serialize_cdr(message, "std_msgs/msg/String"))
    with pytest.raises(FileError, match=r"holds no trajectory_msgs.* but std_msgs/msg/String"):
        bag_recording(tmp_path / "bag")


@pytest.mark.parametrize("how", ["truncated", "text", "missing"])
def test_damaged_bags_are_reported(how: str, tmp_path: Path) -> None:
    exported(swarm_plan(), "ros2bag", tmp_path, rate=RATE)
    path = tmp_path / "setpoints.mcap"
    if how == "truncated":
        path.write_bytes(path.read_bytes()[:2000])
    elif how == "text":
        path.write_text("no bag")
    else:
        path.unlink()
    with pytest.raises(FileError, match="is no bag, or a damaged one"):
        bag_recording(tmp_path)
