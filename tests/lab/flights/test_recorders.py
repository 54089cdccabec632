"""Bags are read as recorders leave them: compressed, split, or not closed as they were killed."""

from __future__ import annotations

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as McapWriter
from rosbags import rosbag2

import hitchopt as ho
from hitchopt.errors import FileError
from hitchopt.lab.flights.recordings import RecordedFlight, Track
from tests.helpers import writers as w

POSE_STAMPED = """std_msgs/Header header
geometry_msgs/Pose pose
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def assert_same(a: RecordedFlight, b: RecordedFlight) -> None:
    assert list(a.tracks) == list(b.tracks)
    for name, track in a.tracks.items():
        np.testing.assert_array_equal(track.t, b.tracks[name].t)
        np.testing.assert_array_equal(track.positions, b.tracks[name].positions)
    np.testing.assert_array_equal(a.markers.positions, b.markers.positions)


def compressed(path: Path, kind: str, mode: rosbag2.CompressionMode) -> Path:
    """Write a compressed copy of a bag, as rosbags' writer compresses it."""
    copy = path.with_name(f"{mode.name.lower()}_{path.name}")
    plugin = rosbag2.StoragePlugin[kind.upper()]
    writer = rosbag2.Writer(copy, version=9, storage_plugin=plugin)
    writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    with rosbag2.Reader(path) as source, writer as target:
        connections = {
            each.id: target.add_connection(
                each.topic,
                each.msgtype,
                msgdef=each.msgdef.data,
                rihs01=each.digest,
                serialization_format="cdr",
            )
            for each in source.connections
        }
        for connection, arrival, data in source.messages():
            target.write(connections[connection.id], arrival, data)
    return copy


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_compressed_bags_are_read(kind: str, tmp_path: Path) -> None:
    """With metadata, and file by file without."""
    bag = w.write_bag(tmp_path / "bag", w.sample(), kind)
    plain = ho.read_flight(bag)
    for mode in (rosbag2.CompressionMode.FILE, rosbag2.CompressionMode.MESSAGE):
        assert_same(ho.read_flight(compressed(bag, kind, mode)), plain)
    (file,) = (path for path in bag.iterdir() if path.suffix != ".yaml")
    lone = tmp_path / f"{file.name}.zstd"
    lone.write_bytes(zstandard.ZstdCompressor().compress(file.read_bytes()))
    assert_same(ho.read_flight(lone), plain)


def parts_of(folder: Path, kind: str, pause: float = 0.0) -> tuple[Path, RecordedFlight]:
    """Write a flight in three parts without metadata, with pauses, and return the whole flight."""
    flight = replace(w.sample(visible_share=1.0), markers=Track(np.zeros(0), np.zeros((0, 3))))
    folder.mkdir()
    for number in range(3):
        rows = slice(20 * number, 20 * (number + 1))
        tracks = {
            name: Track(track.t[rows] + pause * number, track.positions[rows])
            for name, track in flight.tracks.items()
        }
        part = folder.with_name(f"part_{number}{'.bag' * (kind == 'ros1')}")
        w.write_bag(part, replace(flight, tracks=tracks), kind, bodies=("/*/pose", "PoseStamped"))
        files = [part] if kind == "ros1" else [x for x in part.iterdir() if x.suffix != ".yaml"]
        shutil.move(files[0], folder / f"take_{number}{files[0].suffix}")
    return folder, flight


@pytest.mark.parametrize("kind", ["sqlite3", "mcap", "ros1"])
def test_parts_without_metadata_are_one_recording(kind: str, tmp_path: Path) -> None:
    folder, flight = parts_of(tmp_path / "take", kind)
    result = ho.read_flight(folder)
    assert any("read from 3 parts" in note for note in result.notes)
    for name, track in flight.tracks.items():
        np.testing.assert_allclose(result.tracks[name].t, track.t, atol=1e-6)
        np.testing.assert_array_equal(result.tracks[name].positions, track.positions)


@pytest.mark.parametrize("case", ["a minute between them", "one is missing", "no numbers"])
def test_several_recordings_in_a_directory_are_refused(case: str, tmp_path: Path) -> None:
    folder, _ = parts_of(tmp_path / "take", "mcap", 60.0 if "minute" in case else 0.0)
    if case == "one is missing":
        (folder / "take_1.mcap").unlink()
    if case == "no numbers":
        for number in range(3):
            (folder / f"take_{number}.mcap").rename(folder / f"take{number}.mcap")
    with pytest.raises(FileError, match=r"contains [23] recordings, take.*: name one file"):
        ho.read_flight(folder)


def write_mcap(path: Path, flight: RecordedFlight, compression: CompressionType) -> Path:
    """Write a file with the library of mcap, in chunks of some messages."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=2000, compression=compression)
        schema = writer.register_msgdef("geometry_msgs/msg/PoseStamped", POSE_STAMPED)
        for i in range(60):
            for name, track in flight.tracks.items():
                nanoseconds = round(1e9 * (w.EPOCH + track.t[i]))
                seconds, rest = divmod(nanoseconds, 10**9)
                x, y, z = track.positions[i].tolist()
                message = {
                    "header": {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "world"},
                    "pose": {
                        "position": {"x": x, "y": y, "z": z},
                        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                    },
                }
                writer.write_message(f"/{name}/pose", schema, message, nanoseconds, nanoseconds)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_killed_recorder_leaves_whole_chunks(
    compression: CompressionType, tmp_path: Path
) -> None:
    """Files of any length are read to the last whole chunk, and a note says so."""
    flight = w.sample(visible_share=1.0)
    whole = write_mcap(tmp_path / "whole.mcap", flight, compression)
    data, cut = whole.read_bytes(), tmp_path / "cut.mcap"
    counts = list[int]()
    for share in (0.2, 0.35, 0.5, 0.65, 0.8, 1.0):
        cut.write_bytes(data[: int(share * (len(data) - 1))])
        result = ho.read_flight(cut)
        assert any("cut.mcap is truncated" in note for note in result.notes)
        counts.append(sum(len(track.t) for track in result.tracks.values()))
        assert counts[-1] == messages_in(cut)
        for name, track in result.tracks.items():
            positions = flight.tracks[name].positions[: len(track.t)]
            np.testing.assert_array_equal(track.positions, positions)
    assert counts == sorted(counts)
    assert counts[-1] == 60 * len(flight.tracks)


def messages_in(path: Path) -> int:
    """Return the number of messages that the library of mcap finds in a file that is cut."""
    count = 0
    with path.open("rb") as file:
        records = StreamReader(file).records
        while True:
            try:
                record = next(records)
            except Exception:  # Exceptions of the library have no common base
                return count
            count += type(record).__name__ == "Message"


def test_the_last_part_of_a_killed_recorder_is_read(tmp_path: Path) -> None:
    """Also if the metadata was written, and lists the parts before."""
    folder, flight = parts_of(tmp_path / "take", "mcap")
    last = folder / "take_2.mcap"
    last.write_bytes(last.read_bytes()[:-8])
    for metadata in (None, "", "rosbag2_bagfile_information: {version: 5}"):
        if metadata is not None:
            (folder / "metadata.yaml").write_text(metadata)
        result = ho.read_flight(folder)
        assert any("take_2.mcap is truncated" in note for note in result.notes)
        for name, track in flight.tracks.items():
            np.testing.assert_array_equal(result.tracks[name].positions, track.positions)


def test_a_database_is_completed_by_its_log(tmp_path: Path) -> None:
    """A killed recorder leaves transactions in a log beside the database."""
    bag = w.write_bag(tmp_path / "bag", w.sample(), "sqlite3")
    plain = ho.read_flight(bag)
    file, killed = bag / "bag.db3", tmp_path / "killed"
    with sqlite3.connect(file) as database:
        rows = database.execute("SELECT * FROM messages").fetchall()
        database.execute("DELETE FROM messages WHERE id > 40")
    database.close()
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows[40:])
    database.commit()
    killed.mkdir()
    for name in ("bag.db3", "bag.db3-wal"):
        shutil.copy(bag / name, killed / name)
    database.close()
    before = {path.name: path.read_bytes() for path in killed.iterdir()}
    result = ho.read_flight(killed)
    assert_same(result, plain)
    assert any("read to the last transaction" in note for note in result.notes)
    assert before == {path.name: path.read_bytes() for path in killed.iterdir()}


def test_a_bag_of_ros_1_that_is_not_closed_names_its_remedy(tmp_path: Path) -> None:
    w.write_bag(tmp_path / "take.bag", w.sample(), "ros1")
    (tmp_path / "take.bag").rename(tmp_path / "take.bag.active")
    with pytest.raises(FileError, match="was not closed; run `rosbag reindex` on it"):
        ho.read_flight(tmp_path / "take.bag.active")
