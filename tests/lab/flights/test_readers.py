"""Recordings of every format are read back; doubtful ones are refused in one line."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import FileError, UnsupportedError
from hitchopt.lab.flights.logs import decompressed
from hitchopt.lab.flights.readers import table_of
from hitchopt.lab.flights.recordings import NO_MARKERS, RecordedFlight, Signal, Track
from hitchopt.lab.flights.stamps import evened
from hitchopt.values import Array
from tests.helpers import writers as w

Write = Callable[[Path, RecordedFlight], Path]

FORMATS: dict[str, Write] = {
    **{
        f"Motive CSV {v}": partial(w.write_motive, version=v)
        for v in ("1.21", "1.22", "1.23", "1.24", "1.25")
    },
    "Motive CSV 1,23": partial(w.write_motive, separator=";"),
    "Vicon CSV": w.write_vicon,
    "C3D": w.write_c3d,
    "Qualisys TSV": w.write_qualisys,
    "Qualisys TSV without titles": partial(w.write_qualisys, titles=False),
    "Qualisys TSV of bodies": partial(w.write_qualisys, bodies=True),
    "Qualisys TSV of bodies without titles": partial(w.write_qualisys, bodies=True, titles=False),
    "table": w.write_csv,
    "table with semicolons": partial(w.write_csv, separator=";"),
    "ROS 2 bag": w.write_bag,
    "ROS 2 bag, mcap": partial(w.write_bag, kind="mcap"),
    "ROS 2 bag, tf": partial(w.write_bag, bodies=("/tf", w.TRANSFORMS)),
    "ROS 2 bag, poses": partial(w.write_bag, bodies=("/*/pose", "PoseStamped")),
    "ROS 2 bag of MAVROS": partial(
        w.write_bag, bodies=("/*/mavros/local_position/pose", "PoseStamped")
    ),
    "ROS 2 bag of Vicon": partial(w.write_bag, bodies=("/vicon/*/*", "TransformStamped")),
    "ROS 2 bag of a subject": partial(w.write_bag, bodies=("/vicon/fleet/*", "TransformStamped")),
    "ROS 2 bag of Gazebo": partial(w.write_bag, bodies=("/model/*/odometry", w.ODOMETRY)),
    "ROS 2 bag with covariance": partial(
        w.write_bag, bodies=("/lab/*/pose", "PoseWithCovarianceStamped")
    ),
    "ROS 2 bag without stamps": partial(w.write_bag, delay=0.0),
    "ROS 1 bag": partial(w.write_bag, kind="ros1"),
    "Crazyflie uSD log": w.write_usd,
    "Crazyflie uSD log, 1": partial(w.write_usd, version=1),
    "Crazyflie uSD log of floats": partial(w.write_usd, group="stateEstimate."),
    "Crazyflie uSD log of motion capture": partial(w.write_usd, group="locSrv."),
    "Crazyflie uSD log of the filter": partial(w.write_usd, group="kalman.state", axes="XYZ"),
    "cfclient log": w.write_cfclient,
    "TUM trajectory": w.write_tum,
    "TUM trajectory without a head": partial(w.write_tum, head=""),
    "PX4 ulog": w.write_ulog,
    "PX4 ulog of motion capture": partial(w.write_ulog, topic="vehicle_mocap_odometry"),
    "PX4 ulog of a simulator": partial(w.write_ulog, topic="vehicle_local_position_groundtruth"),
    "PX4 ulog of positions": partial(w.write_ulog, topic="vehicle_local_position"),
}
VARIANTS = ("Motive CSV 1.22", "Motive CSV 1.24", *(x for x in FORMATS if x[:10] == "ROS 2 bag "))


def path_in(folder: Path, name: str) -> Path:
    return folder / f"take{'.bag' if 'ROS 1' in name else '.c3d' if 'C3D' in name else ''}"


def flight_for(name: str, visible_share: float = 0.9) -> RecordedFlight:
    """Return a flight with what a format stores: logs have setpoints of two drones, no markers."""
    flight: RecordedFlight = w.sample(visible_share=visible_share)
    if "log" not in name:
        return flight
    return replace(flight, markers=NO_MARKERS, setpoints=dict(list(flight.tracks.items())[:2]))


@pytest.mark.parametrize("name", FORMATS)
def test_recordings_are_read_back(name: str, tmp_path: Path) -> None:
    flight = flight_for(name)
    result = ho.read_flight(FORMATS[name](path_in(tmp_path, name), flight))
    assert name.startswith(result.source)
    assert list(result.tracks) == list(flight.tracks)
    assert result.epoch == pytest.approx(w.EPOCH if "bag" in name else 0.0, abs=1e-6)
    assert result.one_clock == ("log" not in name)
    assert list(result.setpoints) == (
        list(flight.setpoints) if "uSD" in name or "cfclient" in name else []
    )
    pairs = [(x, flight.tracks[body]) for body, x in result.tracks.items()]
    pairs += [(x, flight.setpoints[body]) for body, x in result.setpoints.items()]
    clouds = [result.markers, flight.markers]
    if "of bodies" in name or "TUM" in name:
        clouds[1] = NO_MARKERS
    elif name.startswith(("C3D", "Qualisys")):  # their cloud contains all points
        bodies = [np.column_stack([x.t, x.positions]) for x in flight.tracks.values()]
        cloud = np.column_stack([clouds[1].t, clouds[1].positions])
        rows = np.concatenate([cloud, *bodies])
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        clouds[1] = Track(rows[:, 0], rows[:, 1:])
    orders = [np.lexsort((*x.positions.round(4).T, x.t.round(4))) for x in clouds]
    first, second = (Track(x.t[i], x.positions[i]) for x, i in zip(clouds, orders, strict=True))
    for actual, expected in [*pairs, (first, second)]:
        np.testing.assert_allclose(actual.t, expected.t, atol=1e-6)
        np.testing.assert_allclose(actual.positions, expected.positions, atol=1e-6)


def edit(change: Callable[[str], str], write: Write = w.write_motive) -> Write:
    """Return a writer that edits the text of another."""

    def write_changed(path: Path, flight: RecordedFlight) -> Path:
        file = write(path, flight)
        file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")
        return file

    return write_changed


def with_clock(scale: float = 1.0, shift: float = 0.0) -> Write:
    """Return a writer of a table with times in another unit or from another origin."""

    def write_changed(path: Path, flight: RecordedFlight) -> Path:
        tracks = {n: Track(scale * (x.t + shift), x.positions) for n, x in flight.tracks.items()}
        return w.write_csv(path, replace(flight, tracks=tracks, markers=NO_MARKERS))

    return write_changed


def lines(text: str, *ranges: slice) -> str:
    """Return ranges of the lines of a text."""
    return "\n".join(line for each in ranges for line in text.split("\n")[each])


def text_file(text: str) -> Write:
    return edit(lambda _: text, w.write_csv)


def write_two_bags(path: Path, flight: RecordedFlight) -> Path:
    path.mkdir()
    for name in ("a.bag", "b.bag"):
        w.write_bag(path / name, flight, "ros1")
    return path


def write_c3d(**options: Any) -> Write:
    """Return a writer of C3D whose path gets the suffix that ezc3d needs."""
    return lambda path, flight: w.write_c3d(path.with_suffix(".c3d"), flight, **options)


def write_c3d_without_rate(path: Path, flight: RecordedFlight) -> Path:
    file, rate = write_c3d(rate=123.0)(path, flight), struct.pack("<f", 123.0)
    file.write_bytes(file.read_bytes().replace(rate, struct.pack("<f", 0.0)))
    return file


REFUSED: dict[str, tuple[Write, str]] = {
    "no format": (text_file("hello, world\n"), "name a table of Motive with its header, of Vicon"),
    "empty": (text_file(""), "has no line of column names"),
    "another table": (text_file("t,body,x,y,z\n0,q0,0,0,1\n"), "names with t, name, x, y, z"),
    "no bodies": (text_file("t,name,x,y,z\n0,marker,0,0,1\n"), "contains no positions of bodies"),
    "local space": (partial(w.write_motive, space="Local"), "export it in Global space"),
    "Motive without its header": (
        edit(lambda text: lines(text, slice(7, None))), "a table of Motive with its header",
    ),
    "Motive without titles": (
        edit(lambda text: lines(text, slice(2), slice(5, None))), "no column titles above",
    ),
    "Motive in leagues": (
        partial(w.write_motive, unit=("Leagues", 1e-3)), "unknown; state unit='m', 'cm' or 'mm'",
    ),
    "Motive's frames backward": (
        edit(lambda text: lines(text, slice(-1), slice(20, 22))), "1.49 s is followed by 0.13 s",
    ),
    "Vicon without a rate": (
        edit(lambda text: text.replace("\n100\n", "\n0\n"), w.write_vicon), "a rate of 0 Hz",
    ),
    "times backward": (
        edit(lambda text: lines(text, slice(-1), slice(1, 2)), w.write_csv),
        "is followed by 0 s; specify one flight",
    ),
    "dates backward by a microsecond": (
        text_file("t,name,x,y,z\n1700000000.000019,q0,0,0,1\n1700000000.000018,q0,0,0,1\n"),
        "1700000000.000019 s is followed by 1700000000.000018 s",
    ),
    "two bags in a directory": (
        write_two_bags,
        "contains 2 recordings, a.bag, b.bag: name one file",
    ),
    "millimetres": (
        edit(lambda text: text.replace(",1.", ",1000."), w.write_csv),
        "m, over 50 m: millimetres? unit='mm'",
    ),
    "milliseconds": (with_clock(1e3), "step by 10 s: not in seconds; if they are milliseconds"),
    "nanoseconds": (with_clock(1e9, 1.7e9), "if they are nanoseconds, divide by 1e+09"),
    "bag of other messages": (
        lambda path, flight: w.write_bag(path, replace(flight, tracks={})),
        "contains none of motion_capture_tracking_interfaces/msg/NamedPoseArray",
    ),
    "C3D without a unit": (
        write_c3d(units=()), "states no unit of length; state it: unit='mm'",
    ),
    "C3D with a blank unit": (write_c3d(units=("  ",)), "states no unit of length"),
    "C3D without a rate": (write_c3d_without_rate, "states a rate of 0 Hz; export it again"),
    "C3D without points": (
        lambda path, flight: write_c3d()(path, replace(flight, tracks={}, markers=NO_MARKERS)),
        "contains no points; export the markers' or the bodies' positions",
    ),
    "Qualisys without names": (
        edit(lambda text: text.replace("MARKER_NAMES", "NAMES"), w.write_qualisys),
        "has no line MARKER_NAMES or BODY_NAMES; export it with its header",
    ),
    "Qualisys without a frequency": (
        edit(lambda text: text.replace("FREQUENCY\t100", "FREQUENCY\t0"), w.write_qualisys),
        "has a FREQUENCY of 0 Hz",
    ),
    "log of version 3": (partial(w.write_usd, version=3), "has version 3; 1 and 2 are supported"),
    "log without positions": (
        partial(w.write_usd, group="stabilizer."), "logs none of stateEstimate.x, stateEstimateZ.x",
    ),
    "ulog without positions": (
        partial(w.write_ulog, topic="vehicle_gps_odometry"),
        "logs none of vehicle_local_position_groundtruth, vehicle_mocap_odometry",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_doubtful_recordings_are_refused(case: str, tmp_path: Path) -> None:
    write, words = REFUSED[case]
    path = write(tmp_path / "take", w.sample(frames=150))
    with pytest.raises(FileError) as refusal:
        ho.read_flight(path)
    assert words in str(refusal.value)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_other_paths_and_units_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="none: there is no such file; name a recording"):
        ho.read_flight(tmp_path / "none")
    with pytest.raises(FileError, match="contains no file: no recording; name a table of Motive"):
        ho.read_flight(tmp_path)
    with pytest.raises(ho.InputError, match="unit = 'miles': must be m, cm, mm, in or ft"):
        ho.read_flight(tmp_path, unit="miles")
    with pytest.raises(FileError, match="a format with fixed units; omit unit="):
        ho.read_flight(w.write_usd(tmp_path / "logs", flight_for("log")), unit="mm")


@pytest.mark.parametrize(
    ("name", "module"),
    [("ROS 2 bag", "rosbags.highlevel"), ("PX4 ulog", "pyulog"), ("C3D", "ezc3d")],
)
def test_a_missing_library_is_named(
    name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = FORMATS[name](path_in(tmp_path, name), flight_for(name))
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(UnsupportedError, match=r"pip install 'hitchopt\[logs\]'"):
        ho.read_flight(path)


@pytest.mark.parametrize(("name", "factor"), [("table", 1.0), ("ROS 2 bag", 1.0), ("C3D", 1e3)])
def test_a_stated_unit_is_applied(name: str, factor: float, tmp_path: Path) -> None:
    """Numbers in a file in millimetres are 1000 times as large."""
    flight = w.sample()
    result = ho.read_flight(FORMATS[name](path_in(tmp_path, name), flight), "ft")
    for body, track in flight.tracks.items():
        expected = 0.3048 * factor * track.positions
        np.testing.assert_allclose(result.tracks[body].positions, expected, rtol=1e-6)


def test_points_of_c3d_without_labels_are_markers(tmp_path: Path) -> None:
    flight = w.sample()
    whole = w.write_c3d(tmp_path / "take.c3d", flight)
    unlabelled = tmp_path / "unlabelled.c3d"
    unlabelled.write_bytes(whole.read_bytes().replace(b"LABELS", b"NOTHIN"))
    with pytest.raises(FileError, match="contains no positions of bodies; record the drones"):
        ho.read_flight(unlabelled)


def numbered(flight: RecordedFlight, count: int, arm: float, sway: float) -> RecordedFlight:
    """Return a flight with markers ``NAME_1`` … about each drone, which sway to and fro."""
    tracks = dict[str, Track]()
    for name, track in flight.tracks.items():
        for k in range(count):
            angle = 2.0 * np.pi * k / count
            around = arm * np.array([np.cos(angle), np.sin(angle), 0.0])
            off = around * (1.0 + sway * np.sin(5.0 * track.t[:, None] + k))
            tracks[f"{name}_{k + 1}"] = Track(track.t, track.positions + off)
    return replace(flight, tracks=tracks, markers=NO_MARKERS)


@pytest.mark.parametrize(
    ("count", "arm", "sway", "is_body"),
    [
        (4, 0.05, 0.0, True),
        (3, 0.2, 0.01, True),
        (2, 0.05, 0.0, False),  # Two markers are no rigid body
        (4, 0.25, 0.5, False),  # Drones that fly close together
        (4, 0.6, 0.0, False),
    ],
)
@pytest.mark.parametrize("write", [w.write_c3d, w.write_qualisys])
def test_numbered_markers_of_a_rigid_body_are_one(
    write: Write, count: int, arm: float, sway: float, is_body: bool, tmp_path: Path
) -> None:
    flight = w.sample(visible_share=1.0)
    markers = numbered(flight, count, arm, sway)
    result = ho.read_flight(write(tmp_path / "take.c3d", markers))
    assert list(result.tracks) == list(flight.tracks if is_body else markers.tracks)
    expected = flight.tracks if is_body and not sway else {}
    for name, track in expected.items():
        np.testing.assert_allclose(result.tracks[name].positions, track.positions, atol=1e-6)


def test_bodies_of_c3d_are_means_of_subjects(tmp_path: Path) -> None:
    """A body exists while all markers of its subject are visible; unnamed markers are no body."""
    t = np.arange(50) / 100.0
    front, back = np.tile([[0.1, 0.0, 1.0]], (50, 1)), np.tile([[-0.1, 0.2, 1.0]], (50, 1))
    tracks = {"cf1:front": Track(t, front), "cf1:back": Track(t[10:], back[10:])}
    tracks |= {"*7": Track(t, front + 1.0), "Unlabeled 3": Track(t, back + 2.0)}
    result = ho.read_flight(w.write_c3d(tmp_path / "take.c3d", RecordedFlight("", tracks)))
    assert list(result.tracks) == ["cf1"]
    np.testing.assert_allclose(result.tracks["cf1"].t, t[10:])
    np.testing.assert_allclose(result.tracks["cf1"].positions, [[0.0, 0.1, 1.0]] * 40, atol=1e-6)
    assert len(result.markers.t) == 50 + 40 + 50 + 50
    data, truncated = (tmp_path / "take.c3d").read_bytes(), tmp_path / "cut.c3d"
    data_start = 512 * (struct.unpack_from("<H", data, 16)[0] - 1)
    truncated.write_bytes(data[: data_start + 40 * 4 * 16])  # frames of four points
    partial_flight = ho.read_flight(truncated)
    assert partial_flight.notes == ("truncated: read to frame 40 of 50",)
    np.testing.assert_array_equal(partial_flight.tracks["cf1"].t, t[10:40])


def test_repairs_are_notes(tmp_path: Path) -> None:
    """Times since 1970, blank cells, and times that differ from the frame rate are noted."""
    flight = ho.read_flight(with_clock(1.0, 1.7e9)(tmp_path / "dated", w.sample()))
    assert flight.epoch == 1.7e9
    assert "at 1700000000.000 s of the recording's clock" in flight.notes[0]
    np.testing.assert_allclose(flight.tracks["cf3"].t, w.sample().tracks["cf3"].t, atol=1e-6)
    table = "t,name,x,y,z\n0,q0,1,2,3\n0.1,q0,,,\n0.2,q0,1,2,nan\n0.3,q0,4,5,6\n"
    flight = ho.read_flight(text_file(table)(tmp_path / "blank", w.sample()))
    np.testing.assert_array_equal(flight.tracks["q0"].t, [0.0, 0.3])
    assert flight.notes == ("2 of 4 rows omitted: no position, or a repeated time",)
    other = edit(lambda text: text.replace("Export Frame Rate,100.0", "Export Frame Rate,120.0"))
    flight = ho.read_flight(other(tmp_path / "rated", w.sample()))
    assert flight.notes == ("times are as printed: they differ from frames at 120 Hz",)
    assert flight.tracks["cf3"].t[-1] == pytest.approx(0.59)


def at_receipt(t: Array, seed: int, share: float = 0.02) -> Array:
    """Return times of arrival: a share waits up to 150 ms, and those behind arrive with it."""
    rng = np.random.default_rng(seed)
    waits = rng.uniform(0.0, 0.15, len(t)) * (rng.random(len(t)) < share)
    return np.maximum.accumulate(t + waits + rng.uniform(0.0, 5e-4, len(t)))


@pytest.mark.parametrize("rate", [30.0, 50.0, 96.0, 200.0])
@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_times_of_receipt_are_evened_out_where_a_rate_fits(rate: float, lost: float) -> None:
    """Most of the error goes, also with lost samples; these alone change nothing."""
    before, after = [], []
    for seed in range(5):
        rng = np.random.default_rng(50 + seed)
        t = 7.3 + np.arange(int(12.0 * rate)) / rate
        t = t[rng.random(len(t)) >= lost]
        on_time = at_receipt(t, seed, share=0.0)
        assert evened(on_time).t is on_time
        arrived = at_receipt(t, seed)
        stamps = evened(arrived)
        assert stamps.rate == pytest.approx(rate, rel=1e-4)
        assert np.all(np.diff(stamps.t) > 0.0)
        assert np.array_equal(stamps.t[~stamps.late], arrived[~stamps.late])
        before.append(np.sqrt(np.mean((arrived - t) ** 2)))
        after.append(np.sqrt(np.mean((stamps.t - t) ** 2)))
    assert np.mean(after) < 0.35 * np.mean(before)
    if not lost:
        assert np.median(after) < 1e-3


@pytest.mark.parametrize("power", [0.9, 0.98, 1.02, 1.1])
@pytest.mark.parametrize("size", [30, 300, 3000])
def test_a_rate_that_changes_slowly_stays(power: float, size: int) -> None:
    t = 0.1 * np.arange(float(size)) ** power
    assert evened(t).t is t


def test_a_repeated_time_shifts_no_other() -> None:
    t = np.arange(500) / 100.0
    for place in (3, 250, 497):
        repeated = np.insert(t, place, t[place])
        stamps = evened(repeated)
        assert np.sum(stamps.t != repeated) <= (place + 1 if place < 100 else 0)


def test_bodies_stamped_at_receipt_are_where_they_were(tmp_path: Path) -> None:
    flight = w.sample(frames=600)
    frames = np.arange(600) / 100.0
    arrived = at_receipt(frames, 4)

    def stamped(track: Track) -> Track:
        return Track(arrived[np.rint(100.0 * track.t).astype(int)], track.positions)

    late = replace(
        flight,
        tracks={name: stamped(track) for name, track in flight.tracks.items()},
        markers=stamped(flight.markers),
    )
    found = ho.read_flight(w.write_csv(tmp_path / "late.csv", late))
    assert "stamped up to 0.1" in found.notes[0]
    assert "at receipt: evened out to 100 Hz" in found.notes[0]
    assert "omitted" not in str(found.notes)
    for name, track in flight.tracks.items():
        assert len(found.tracks[name].t) == len(track.t)
        errors = np.linalg.norm(found.tracks[name].at(track.t)[0] - track.positions, axis=1)
        wrong = np.linalg.norm(late.tracks[name].at(track.t)[0] - track.positions, axis=1)
        assert np.sqrt(np.mean(errors**2)) < 0.3 * np.sqrt(np.mean(wrong**2))
    usual = found.markers.t[:, None] - np.round(100.0 * found.markers.t[:, None]) / 100.0
    assert np.max(np.abs(usual)) < 0.3 / 100.0  # markers of late frames are omitted
    assert len(found.markers.t) > 0.6 * len(flight.markers.t)


def test_irregular_times_without_a_rate_are_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.exponential(0.02, 400))
    track = Track(t, np.column_stack([t, 0.3 * t, 1.0 + 0.0 * t]))
    flight = RecordedFlight("irregular", {"q0": track})
    found = ho.read_flight(w.write_csv(tmp_path / "a.csv", flight))
    assert "intervals are irregular and no rate fits; times are as stamped" in found.notes[0]
    np.testing.assert_array_equal(found.tracks["q0"].t, t)


@pytest.mark.parametrize("epoch", [0.5, 1.7e9])
@pytest.mark.parametrize("unset", [1, 2, 40])
def test_times_of_zero_before_a_clock_begins_are_left_out(
    unset: int, epoch: float, tmp_path: Path
) -> None:
    """Of bodies and markers; a clock that counts from zero keeps its first sample."""
    flight = w.sample(frames=100, visible_share=1.0)

    def stamped(track: Track) -> Track:
        is_unset = track.t < 0.01 * unset - 1e-6
        return Track(np.where(is_unset, 0.0, track.t + epoch), track.positions)

    late = replace(
        flight,
        tracks={name: stamped(track) for name, track in flight.tracks.items()},
        markers=stamped(flight.markers),
    )
    found = ho.read_flight(w.write_csv(tmp_path / "a.csv", late))
    markers = int(np.sum(flight.markers.t < 0.01 * unset - 1e-6))
    rows = 4 * unset + markers
    assert found.notes[0] == f"{rows} rows omitted: their time is 0, before a clock began"
    for name, track in flight.tracks.items():
        np.testing.assert_array_equal(found.tracks[name].positions, track.positions[unset:])
    assert len(found.markers.t) == len(flight.markers.t) - markers
    whole = ho.read_flight(w.write_csv(tmp_path / "b.csv", flight))
    assert not whole.notes
    assert len(whole.tracks["cf3"].t) == 100


def test_positions_that_px4_does_not_trust_are_left_out(tmp_path: Path) -> None:
    """Before the estimate converges, x and y are 0 and ``xy_valid`` is."""
    flight = w.sample(visible_share=1.0)
    for number, (xy, z) in enumerate([(0, 1), (1, 0), (0, 0)]):
        flags = {name: np.ones((60, 2), np.uint8) for name in flight.tracks}
        for own in flags.values():
            own[:20] = xy, z
        logs = w.write_ulog(tmp_path / f"{number}", flight, "vehicle_local_position", flags)
        result = ho.read_flight(logs)
        for name, track in flight.tracks.items():
            np.testing.assert_allclose(result.tracks[name].t, track.t[20:], atol=1e-6)
            np.testing.assert_allclose(
                result.tracks[name].positions, track.positions[20:], atol=1e-6
            )
        assert any("skipped while it is not valid" in note for note in result.notes)
    never = {name: np.zeros((60, 2), np.uint8) for name in flight.tracks}
    logs = w.write_ulog(tmp_path / "never", flight, "vehicle_local_position", never)
    with pytest.raises(FileError, match="never has a valid position in vehicle_local_position"):
        ho.read_flight(logs)


@pytest.mark.parametrize(
    ("measured", "less"),
    [
        ("vehicle_mocap_odometry", ()),
        ("vehicle_visual_odometry", ()),
        ("vehicle_local_position_groundtruth", ()),
        ("vehicle_mocap_odometry", ("vehicle_visual_odometry",)),
        ("vehicle_local_position_groundtruth", ("vehicle_visual_odometry",)),
    ],
)
def test_px4_positions_are_the_measured_ones(
    measured: str, less: tuple[str, ...], tmp_path: Path
) -> None:
    flight = w.sample(visible_share=1.0)
    others = ("vehicle_local_position", *less)
    moved_topics = {topic: moved(flight, 0.2 * (i + 1)) for i, topic in enumerate(others)}
    logs = w.write_ulog(tmp_path / "logs", flight, measured, others=moved_topics)
    result = ho.read_flight(logs)
    assert_same(result, flight)
    assert any(f"positions come from {measured} (measured)" in note for note in result.notes)
    assert_same(ho.read_flight(logs, topic=others[0]), moved(flight, 0.2))


def test_a_truncated_log_is_read_to_its_last_record(tmp_path: Path) -> None:
    flight, log = flight_for("log", visible_share=1.0), tmp_path / "log00"
    folder = w.write_usd(tmp_path / "logs", flight)
    for missing_bytes in (1, 4, 9, 200, 400):
        log.write_bytes((folder / "cf3.bin").read_bytes()[:-missing_bytes])
        result = ho.read_flight(log)
        samples = len(result.tracks["log00"].t)
        assert samples == 60 if missing_bytes <= 4 else 30 < samples < 60
        note = f"log00: truncated or damaged: read to the record at {0.01 * (samples - 1):.3f} s"
        assert note in result.notes
        assert result.one_clock


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in VARIANTS])
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    """Twenty files of each format are truncated, or have bytes changed, inserted or deleted."""
    whole, refused = FORMATS[name](path_in(tmp_path, name), flight_for(name)), 0
    copy = whole.with_name(f"damaged{whole.suffix}")
    for seed in range(20):
        rng = np.random.default_rng(seed)
        (shutil.copytree if whole.is_dir() else shutil.copy)(whole, copy)
        files = [path for path in (copy, *copy.glob("*")) if path.is_file()]
        file = max(files, key=lambda path: path.stat().st_size)
        data = bytearray(file.read_bytes())
        end = len(data) if seed % 2 else min(len(data), 600)
        at = int(rng.integers(end))
        if seed % 4 == 0:
            del data[at:]
        elif seed % 4 == 1:
            for i in rng.integers(end, size=20):
                data[i] = rng.integers(256)
        elif seed % 4 == 2:
            data[at:at] = rng.bytes(40)
        else:
            del data[at : at + 40]
        file.write_bytes(data)
        words = ""
        try:
            ho.read_flight(copy)
        except FileError as error:
            words, refused = str(error), refused + 1
        assert words == "" or (words.startswith(str(copy)) and "\n" not in words), words
        shutil.rmtree(copy) if copy.is_dir() else copy.unlink()
    assert refused > 1


def moved(flight: RecordedFlight, off: float = 0.6, names: int = 99) -> RecordedFlight:
    """Return the first bodies of a flight, displaced in all axes and late by 4 ms."""
    tracks = list(flight.tracks.items())[:names]
    return replace(flight, tracks={n: Track(x.t + 0.004, x.positions + off) for n, x in tracks})


# Topics and message types: with the drones' positions, and to be ignored
POSES, ODOMETRY, TF = "PoseStamped", w.ODOMETRY, ("/tf", w.TRANSFORMS)
TOPICS: dict[str, tuple[tuple[str, str], tuple[str, str]]] = {
    "commands": (("/*/pose", POSES), ("/*/cmd_position", POSES)),
    "commands of MAVROS": (
        ("/*/mavros/local_position/pose", POSES), ("/*/mavros/setpoint_position/local", POSES),
    ),
    "estimates": (("/*/pose", POSES), ("/*/odom", ODOMETRY)),
    "estimates of MAVROS": (
        ("/vrpn_mocap/*/pose", POSES), ("/*/mavros/local_position/pose", POSES),
    ),
    "poses beside motion capture": (("/vrpn_client_node/*/pose", POSES), ("/*/pose", POSES)),
    "poses beside crazyswarm's": (("/poses", w.POSE_ARRAY), ("/*/pose", POSES)),
    "poses beside frames": (TF, ("/*/pose", POSES)),
    "a goal": (TF, ("/goal_pose", POSES)),
    "goals": (("/*/pose", POSES), ("/*/goalPose", POSES)),
    "a load": (("/*/pose", POSES), ("/payload/pose", POSES)),
    "filtered poses": (("/poses", w.POSE_ARRAY), ("/poses_filtered", w.POSE_ARRAY)),
    "static frames": (TF, ("/tf_static", w.TRANSFORMS)),
    "true positions": (("/*/ground_truth/odometry", ODOMETRY), ("/*/odometry", ODOMETRY)),
}  # fmt: skip


@pytest.mark.parametrize("case", TOPICS)
def test_topics_of_other_kinds_change_nothing(case: str, tmp_path: Path) -> None:
    flight, (bodies, (topic, type_)) = w.sample(), TOPICS[case]
    other = moved(flight, names=99 if "*" in topic or topic.startswith("/poses") else 1)
    alone = ho.read_flight(w.write_bag(tmp_path / "alone", flight, bodies=bodies))
    path = w.write_bag(tmp_path / "both", flight, bodies=bodies, others=[(topic, type_, other)])
    both = ho.read_flight(path)
    assert_same(both, alone)
    assert_same(ho.read_flight(path, topic=bodies[0]), alone)
    if topic != "/tf_static":
        chosen = f"positions come from {bodies[0]} ("
        assert any(note.startswith(chosen) and f"not from {topic}" in note for note in both.notes)
        assert_same(ho.read_flight(path, topic=topic), other)


def assert_same(a: RecordedFlight, b: RecordedFlight) -> None:
    """Compare tracks, on clocks from their starts, and their names if there is more than one."""
    assert list(a.tracks) == list(b.tracks) or len(b.tracks) == 1
    for x, y in zip(a.tracks.values(), b.tracks.values(), strict=True):
        np.testing.assert_allclose(x.t, y.t - y.t[0] + x.t[0], atol=1e-6)
        np.testing.assert_allclose(x.positions, y.positions)


@pytest.mark.parametrize(
    ("topic", "type_"),
    [
        ("/*/mavros/local_position/pose", POSES),
        ("/vicon/*/*", "TransformStamped"),
        ("/vrpn_client_node/*/pose", POSES),
        ("/*/odom", ODOMETRY),
        ("/*", POSES),
    ],
)
def test_names_do_not_depend_on_other_drones(topic: str, type_: str, tmp_path: Path) -> None:
    flight = w.sample()
    for count in (1, 2, 4):
        tracks = dict(list(flight.tracks.items())[:count])
        part, others = replace(flight, tracks=tracks), list[w.Stream]()
        if count == 2:
            others = [("/*/cmd_position", POSES, moved(part)), ("/goal_pose", POSES, moved(part))]
        path = w.write_bag(tmp_path / f"{count}", part, bodies=(topic, type_), others=others)
        assert list(ho.read_flight(path).tracks) == list(tracks)


@pytest.mark.parametrize("kind", ["sqlite3", "ros1"])
@pytest.mark.parametrize(
    ("topics", "request_", "words"),
    [
        (("/*/pose", "/*/pose2"), None, "cf3 has positions in /*/pose and /*/pose2: choose one"),
        (("/*/pose", "/*/cmd_pose"), "*pose", "cf3 has positions in /*/cmd_pose and /*/pose"),
        (("/*/pose", "/*/cmd_pose"), "/tf", "no topic /tf, but /*/pose (measured), /*/cmd_pose"),
    ],
)  # fmt: skip
def test_topics_that_no_rule_decides_are_refused(
    kind: str, topics: tuple[str, str], request_: str | None, words: str, tmp_path: Path
) -> None:
    flight = w.sample()
    others = [(topics[1], POSES, moved(flight))]
    path = w.write_bag(
        tmp_path / f"take{'.bag' * (kind == 'ros1')}", flight, kind, (topics[0], POSES), others
    )
    with pytest.raises(FileError) as refusal:
        ho.read_flight(path, topic=request_)
    assert words in str(refusal.value)
    assert "topic=" in str(refusal.value)
    assert_same(ho.read_flight(path, topic=topics[0]), flight)
    first = next(iter(flight.tracks))
    assert list(ho.read_flight(path, topic=f"/{first}/pose").tracks) == [first]


def test_only_bags_and_logs_have_topics(tmp_path: Path) -> None:
    for name in ("Motive CSV 1.23", "Vicon CSV", "C3D", "table"):
        with pytest.raises(FileError, match="a format without topics; omit topic="):
            ho.read_flight(FORMATS[name](path_in(tmp_path, name), w.sample()), topic="/tf")
    logs = w.write_usd(tmp_path / "logs", flight_for("log"))
    with pytest.raises(FileError, match=r"no topic /tf, but stateEstimateZ \(estimated\)"):
        ho.read_flight(logs, topic="/tf")


def test_frames_that_move_are_no_frames_of_positions(tmp_path: Path) -> None:
    """Cameras on drones have positions in the drones' frames; a fixed frame may have a parent."""
    flight = w.sample()
    cameras = {f"camera_of_{name}": x for name, x in flight.tracks.items()}
    room = {"room": Track(np.arange(100) / 50.0, np.full((100, 3), 0.2))}
    parents = {f"camera_of_{name}": name for name in flight.tracks}
    parents |= dict.fromkeys(flight.tracks, "room")
    mounted = replace(flight, tracks={**flight.tracks, **cameras, **room})
    path = w.write_bag(tmp_path / "bag", mounted, bodies=TF, parents=parents)
    result = ho.read_flight(path)
    assert set(result.tracks) == {*flight.tracks, "room"}
    assert f"{', '.join(cameras)} omitted: positions in moving frames" in result.notes


def test_a_body_of_two_sources_in_one_topic_is_omitted(tmp_path: Path) -> None:
    flight = w.sample()
    others = [(*TF, moved(flight, names=1))]
    result = ho.read_flight(w.write_bag(tmp_path / "bag", flight, bodies=TF, others=others))
    first, *rest = flight.tracks
    assert set(result.tracks) == set(rest)
    assert any(note.startswith(f"{first} omitted: ") for note in result.notes)
    others = [(*TF, moved(flight))]
    with pytest.raises(FileError, match="jump back and forth by 1 m, as if from two sources"):
        ho.read_flight(w.write_bag(tmp_path / "all", flight, bodies=TF, others=others))


@pytest.mark.parametrize("group", ["stateEstimateZ.", "stateEstimate.", "locSrv."])
def test_targets_of_loads_are_no_setpoints(group: str, tmp_path: Path) -> None:
    """Targets belong to the drone or to its load, whichever is nearer."""
    flight: RecordedFlight = w.sample(visible_share=1.0)
    load, near_load = moved(flight, -0.3), moved(flight, -0.28)
    for targets, of_load in ((near_load, True), (moved(flight, 0.02), False)):
        commanded = replace(flight, setpoints=targets.tracks)
        folder = tmp_path / f"{of_load}"
        w.write_usd(folder, commanded, group=group, others={"stateEstimateZ.p": load})
        result = ho.read_flight(folder)
        assert list(result.tracks) == list(flight.tracks)
        for name, track in flight.tracks.items():
            np.testing.assert_allclose(result.tracks[name].positions, track.positions, atol=1e-6)
        assert list(result.setpoints) == ([] if of_load else list(flight.tracks))
        noted = "ctrltargetZ is the target of the load" in str(result.notes)
        assert noted == of_load
        assert "stateEstimateZ.p (load)" in str(result.notes)


def test_logs_prefer_motion_capture_to_estimates(tmp_path: Path) -> None:
    """Held positions and those before the first one are no measurements."""
    flight: RecordedFlight = w.sample(visible_share=1.0)
    held = {}
    for name, track in flight.tracks.items():
        i = np.arange(len(track.t)) // 4 * 4
        positions = np.where(i[:, None] < 20, 0.0, track.positions[i])
        held[name] = Track(track.t, positions)
    received = replace(flight, tracks=held)
    folder = w.write_usd(tmp_path / "logs", moved(flight), others={"locSrv.": received})
    result = ho.read_flight(folder)
    for name, track in flight.tracks.items():
        np.testing.assert_allclose(result.tracks[name].t, track.t[20::4], atol=0.005)
        np.testing.assert_allclose(result.tracks[name].positions, track.positions[20::4], atol=1e-6)
    assert "locSrv (measured), not from stateEstimateZ (estimated)" in result.notes[0]
    estimates = ho.read_flight(folder, topic="stateEstimateZ")
    assert_same(estimates, moved(flight))


@pytest.mark.parametrize("write", [w.write_c3d, w.write_vicon])
def test_drones_in_one_subject_are_bodies(write: Write, tmp_path: Path) -> None:
    flight = w.sample()
    fleet = {f"fleet:{name}": track for name, track in flight.tracks.items()}
    result = ho.read_flight(write(tmp_path / "take.c3d", replace(flight, tracks=fleet)))
    assert "markers of fleet are separate bodies" in str(result.notes) or write is w.write_vicon
    assert list(result.tracks) == list(flight.tracks)
    for name, track in flight.tracks.items():
        np.testing.assert_allclose(result.tracks[name].positions, track.positions, atol=1e-6)


def test_records_check_their_fields() -> None:
    places = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    with pytest.raises(ValueError, match="read-only"):
        Track(np.zeros(2), places).t[0] = 5.0
    for t, x, words in (
        (np.array([1.0, 0.0]), places, "t = .*ascending"),
        (np.zeros(1), places, r"of shape \(m, 3\) and finite, .* shape \(1,\)"),
        (np.zeros(2), places * np.nan, "finite"),
    ):
        with pytest.raises(ho.InputError, match=words):
            Track(t, x)


def test_blank_cells_of_wide_tables_are_missing() -> None:
    rows = ["0;1;;;", "1;;;2,5;3", '2;"4"; 5,5;6;7', ";;;", "3;1;1;1;1"]
    head, points = table_of(rows, ";", [2])
    np.testing.assert_array_equal(head, [[0.0, 1.0], [1.0, np.nan], [2.0, 4.0]])
    np.testing.assert_array_equal(points[0], [[2.0, 5.5, 6.0, 7.0]])


ON_BOARD = ("estimated_position", "motors")  # Quantities of crazyswarm's logs
RICH: dict[str, tuple[Write, tuple[str, ...], float]] = {
    "crazyswarm": (
        w.write_crazyswarm,
        ("attitude", "commanded_velocity", "commanded_acceleration", *ON_BOARD), 5e-3,
    ),
    "crazyswarm2": (
        partial(w.write_crazyswarm, kind="sqlite3"),
        ("attitude", "commanded_velocity", "commanded_acceleration", *ON_BOARD), 5e-3,
    ),
    "uSD": (w.write_rich_usd, tuple(w.USD_VARIABLES), 1e-6),
    "uSD, on clocks of their own": (
        partial(w.write_rich_usd, clocks=(0.0, 7.3, 210.5)), tuple(w.USD_VARIABLES), 5e-3,
    ),
    "ulog": (
        w.write_rich_ulog,
        tuple(x for x in w.rich_sample(1).signals["cf3"] if x not in ("commanded_yaw", "thrust")),
        1e-6,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", RICH)
def test_every_quantity_is_read_back(case: str, tmp_path: Path) -> None:
    """Quantities of logs that are stamped by other clocks are on the flight's clock."""
    write, quantities, tolerance = RICH[case]
    flight = w.rich_sample()
    result = ho.read_flight(write(tmp_path / ("b.bag" if case == "crazyswarm" else "b"), flight))
    assert set(result.tracks) == set(flight.tracks)
    assert set(result.loads) == ({"load"} if case != "ulog" else set())
    for name, track in flight.tracks.items():
        np.testing.assert_allclose(result.tracks[name].positions, track.positions, atol=1e-6)
        start = result.tracks[name].t[0]
        assert set(result.signals[name]) == set(quantities)
        pairs = [(result, dict(result.signals[name])), (flight, dict(flight.signals[name]))]
        for each, own in pairs:
            own["commanded_position"] = Signal(
                each.setpoints[name].t, each.setpoints[name].positions
            )
        (_, signals), (_, expected) = pairs
        for quantity, signal in signals.items():
            t = signal.t - start
            inside = (t >= 0.0) & (t <= track.t[-1])
            assert np.mean(inside) > 0.99
            at, values = expected[quantity].at(t[inside]), signal.values[inside]
            if "attitude" in quantity:  # q and -q are one attitude
                at = at * np.sign(np.sum(at * values, axis=1, keepdims=True))
            np.testing.assert_allclose(values, at, atol=tolerance, err_msg=quantity)
    if "load" in result.loads:
        load, start = result.loads["load"], result.tracks["cf3"].t[0]
        at = flight.loads["load"].at(load.t - start)[0]
        np.testing.assert_allclose(load.positions, at, atol=tolerance)


def test_the_contents_of_a_recording_are_listed(tmp_path: Path) -> None:
    flight = w.rich_sample()
    result = ho.read_flight(w.write_crazyswarm(tmp_path / "b.bag", flight))
    contents = result.contents
    assert set(contents) == {*flight.tracks, "load"}
    assert contents["cf3"]["position"]["topic"] == "/tf"
    assert contents["cf3"]["motors"]["topic"] == "/*/pwm"
    assert contents["cf3"]["commanded_velocity"]["topic"] == "/*/cmd_full_state"
    assert contents["cf3"]["position"]["rate"] == pytest.approx(100.0, rel=1e-3)
    assert contents["cf3"]["position"]["largest_gap"] == pytest.approx(0.01, abs=1e-6)
    shifts = [w.EPOCH - 100.0 * (k + 1) for k in range(3)]
    assert list(result.clock_shifts.values()) == pytest.approx(shifts, abs=5e-3)


def test_clocks_that_are_minutes_apart_are_set_by_positions(tmp_path: Path) -> None:
    """Also if the clock of the recording begins at a boot, as those of logs do."""
    bag = w.write_crazyswarm(tmp_path / "b.bag", w.rich_sample(), epoch=450.0)
    result = ho.read_flight(bag)
    assert list(result.clock_shifts.values()) == pytest.approx([350.0, 250.0, 150.0], abs=5e-3)


def test_all_logs_of_a_drone_are_on_the_clock_that_positions_set(tmp_path: Path) -> None:
    """Also those whose topics come before the one with positions."""
    flight = w.rich_sample(1)
    bag = w.write_crazyswarm(tmp_path / "b.bag", flight, logs=w.LOGS[::-1])
    result = ho.read_flight(bag)
    own, motors = flight.signals["cf3"]["motors"], result.signals["cf3"]["motors"]
    start = result.tracks["cf3"].t[0] - flight.tracks["cf3"].t[0]
    np.testing.assert_allclose(motors.t - start, own.t, atol=5e-3)


def test_positions_and_yaws_are_commands(tmp_path: Path) -> None:
    """Commands of crazyswarm's type Position have a yaw and no velocity; one marker no attitude."""
    flight = w.rich_sample(1)
    own = {"commanded_yaw": flight.signals["cf3"]["commanded_yaw"]}
    plain = replace(flight, signals={"cf3": own}, loads={})
    result = ho.read_flight(w.write_crazyswarm(tmp_path / "b.bag", plain))
    assert set(result.signals["cf3"]) == {"commanded_yaw"}
    yaw = result.signals["cf3"]["commanded_yaw"].values
    np.testing.assert_allclose(yaw, own["commanded_yaw"].values, atol=1e-6)
    places = flight.setpoints["cf3"].positions
    np.testing.assert_allclose(result.setpoints["cf3"].positions, places, atol=1e-6)


def test_clocks_that_nothing_ties_stay_apart(tmp_path: Path) -> None:
    """Without a load each log has its clock; without positions logs are as late as they arrive."""
    flight = w.rich_sample()
    logs = w.write_rich_usd(tmp_path / "logs", replace(flight, loads={}), (0.0, 7.3, 210.5))
    assert not ho.read_flight(logs).one_clock
    own = {"cf3": {"motors": flight.signals["cf3"]["motors"]}}
    bag = ho.read_flight(w.write_crazyswarm(tmp_path / "b.bag", replace(flight, signals=own)))
    assert bag.clock_shifts["cf3"] == pytest.approx(w.EPOCH - 100.0 + 1.65, abs=0.01)
    assert any("smallest delay of arrival" in note for note in bag.notes)


def compressed(quaternion: Array) -> int:
    """Return a quaternion as the firmware sends it: the three smallest components in 30 bits."""
    largest = int(np.argmax(np.abs(quaternion)))
    word, positive = largest, np.sign(quaternion[largest]) * quaternion
    for i in range(4):
        if i != largest:
            size = int(511 * abs(positive[i]) / np.sqrt(0.5) + 0.5)
            word = word << 10 | int(positive[i] < 0.0) << 9 | size
    return word


def test_compressed_attitudes_are_read() -> None:
    """Nine bits of each component leave an error of a quarter of a degree at most."""
    rng = np.random.default_rng(3)
    quaternions = rng.standard_normal((200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    result = decompressed(np.array([compressed(q) for q in quaternions], np.float64))
    errors = 1.0 - np.abs(np.sum(result * quaternions, axis=1))
    assert np.degrees(2.0 * np.arccos(1.0 - np.max(errors))) < 0.25
