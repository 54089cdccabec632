"""Tables and bags for scripts: what they hold besides the flight, and how large they may be."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from exported_plans import exported, hitch_plan, swarm_plan
from format_readers import bag_messages, vector
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from hitchopt.errors import InputError
from hitchopt.exports.exporting import export_motion
from hitchopt.exports.options import ExportOptions
from hitchopt.motion.states import sample_times, states_at

RATE = 25.0


def test_every_column_is_the_plan_s(tmp_path: Path) -> None:
    """Those that fleets do not fly: the others are in test_formats."""
    motion = hitch_plan()
    exported(motion, "parquet", tmp_path, rate=RATE)
    file = pq.ParquetFile(tmp_path / "setpoints.parquet")
    place = {"frame": "enu", "origin_enu": [0.0, 0.0, 0.0], "yaw_deg": 0.0}
    assert json.loads(file.schema_arrow.metadata[b"hitchopt.room"]) == place
    assert file.num_row_groups == 1
    table = file.read()
    states = states_at(motion, sample_times(motion.duration, RATE))
    for names, values in (
        ("ax ay az", states.accelerations),
        ("jx jy jz", states.jerks),
        ("cable_x cable_y cable_z", states.cable_forces),
    ):
        found = np.stack([table[name].to_numpy() for name in names.split()], axis=-1)
        np.testing.assert_allclose(found, values.reshape(-1, 3), atol=1e-9)
    assert not np.any(table["yaw"].to_numpy())


def test_trajectories_and_paths_of_a_bag_are_those_of_its_setpoints(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "ros2bag", tmp_path, rate=RATE, frame="nwu")
    found = bag_messages(tmp_path / "setpoints.mcap")
    states = states_at(motion, sample_times(motion.duration, RATE))
    for i, name in enumerate(motion.team.drone_names):
        ((_, trajectory),), ((_, path),) = found[f"/{name}/trajectory"], found[f"/{name}/path"]
        assert (trajectory.header.frame_id, trajectory.joint_names) == ("map_nwu", [name])
        setpoints = found[f"/{name}/cmd_full_state"]
        assert len(trajectory.points) == len(path.poses) == len(setpoints) == len(states.t)
        for k, point in enumerate(trajectory.points):
            at, setpoint = setpoints[k]
            now = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            assert now == pytest.approx(at, abs=1e-9)
            for first, second in (
                (point.transforms[0].translation, setpoint.pose.position),
                (path.poses[k].pose.position, setpoint.pose.position),
                (point.transforms[0].rotation, setpoint.pose.orientation),
                (point.velocities[0].linear, setpoint.twist.linear),
            ):
                assert vector(first) == vector(second)
            x, y, z = states.accelerations[k, i]
            own = vector(point.accelerations[0].linear)
            np.testing.assert_allclose(own, [y, -x, z], atol=1e-12)
            # Body rates here, the same about the frame's axes in the trajectory.
            q = setpoint.pose.orientation
            turned = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(vector(setpoint.twist.angular))
            np.testing.assert_allclose(vector(point.velocities[0].angular), turned, atol=1e-12)


def test_sqlite_holds_the_same(tmp_path: Path) -> None:
    (part,) = exported(swarm_plan(), "ros2bag", tmp_path, rate=RATE, storage="sqlite3")
    assert part.verdict.position.worst < 1e-6
    with sqlite3.connect(tmp_path / "setpoints.db3") as database:
        topics = {name for (name,) in database.execute("select name from topics")}
        (count,) = database.execute("select count(*) from messages").fetchone()
    database.close()
    kinds = ("trajectory", "path", "cmd_full_state")
    assert topics == {f"/d{i}/{kind}" for i in range(3) for kind in kinds}
    assert count == 3 * (2 + len(sample_times(swarm_plan().duration, RATE)))


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
    profiles = [topic["offered_qos_profiles"] for topic in topics]
    jazzy = distro == "jazzy"
    expected: tuple[int, list[Any]] = (9, [[]] * 9) if jazzy else (8, [""] * 9)
    assert (bag["version"], profiles) == expected
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
