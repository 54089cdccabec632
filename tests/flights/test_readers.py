"""Recordings of every format are read back, and doubtful ones are refused in a line."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import writers as w

import hitchopt as ho
from hitchopt.flights.readers import points_of, table_of
from hitchopt.flights.recordings import NOTHING

Write = Callable[[Path, ho.RecordedFlight], Path]

# One writer a format: whether it holds markers, and whether drones' own are among these
FORMATS: dict[str, tuple[Write, bool, bool]] = {
    **{
        f"Motive CSV {v}": (partial(w.write_motive, version=v), True, False)
        for v in ("1.21", "1.22", "1.23", "1.24", "1.25")
    },
    "Motive CSV 1,23": (partial(w.write_motive, separator=";"), True, False),
    "Vicon CSV": (w.write_vicon, True, False),
    "C3D": (w.write_c3d, True, True),
    "C3D in integers": (partial(w.write_c3d, real=False), True, True),
    "table": (w.write_csv, True, False),
    "table with semicolons": (partial(w.write_csv, separator=";"), True, False),
    "ROS 2 bag": (w.write_bag, True, False),
    "ROS 2 bag, mcap": (partial(w.write_bag, kind="mcap"), True, False),
    "ROS 2 bag, tf": (partial(w.write_bag, bodies="/tf"), True, False),
    "ROS 2 bag, poses": (partial(w.write_bag, bodies="pose"), True, False),
    "ROS 2 bag without stamps": (partial(w.write_bag, stamped=False), True, False),
    "ROS 1 bag": (partial(w.write_bag, kind="ros1"), True, False),
    "Crazyflie uSD log": (w.write_usd, False, False),
    "Crazyflie uSD log, 1": (partial(w.write_usd, version=1), False, False),
    "Crazyflie uSD log of floats": (partial(w.write_usd, group="stateEstimate"), False, False),
    "PX4 ulog": (w.write_ulog, False, False),
    "PX4 ulog of positions": (
        partial(w.write_ulog, topic="vehicle_local_position"),
        False,
        False,
    ),
}


def suffix(name: str) -> str:
    return ".bag" if "ROS 1" in name else ".c3d" if "C3D" in name else ""


@pytest.mark.parametrize("name", FORMATS)
def test_recordings_are_read_back(name: str, tmp_path: Path) -> None:
    write, with_markers, own = FORMATS[name]
    flight = w.sample()
    if not with_markers:
        commands = dict(list(flight.tracks.items())[:2])
        flight = replace(flight, markers=NOTHING, setpoints=commands)
    result = ho.read_flight(write(tmp_path / f"take{suffix(name)}", flight))
    assert name.startswith(result.source)
    assert list(result.tracks) == list(flight.tracks)
    epoch = w.EPOCH if "bag" in name else 0.0
    assert result.epoch == pytest.approx(epoch, abs=1e-6)
    for body, track in flight.tracks.items():
        np.testing.assert_allclose(result.tracks[body].t, track.t, atol=1e-6)
        np.testing.assert_allclose(result.tracks[body].positions, track.positions, atol=1e-6)
    cloud, seen = result.markers, flight.markers
    every = w.frames_of(flight) if own else np.unique(seen.t)
    for time in every if with_markers else ():
        expected = seen.positions[seen.t == time].tolist()
        if own:
            each = flight.tracks.values()
            expected += [x.positions[x.t == time][0].tolist() for x in each if np.any(x.t == time)]
        points = cloud.positions[np.abs(cloud.t - time) < 1e-6]
        np.testing.assert_allclose(sorted(points.tolist()), sorted(expected), atol=1e-6)
    assert result.one_clock == with_markers
    logged = "uSD" in name
    assert list(result.setpoints) == (list(flight.setpoints) if logged else [])
    for body, track in flight.setpoints.items() if logged else ():
        np.testing.assert_allclose(result.setpoints[body].positions, track.positions, atol=1e-6)


def edited(change: Callable[[str], str], write: Write = w.write_motive) -> Write:
    """Return a writer whose text is changed."""

    def written(path: Path, flight: ho.RecordedFlight) -> Path:
        file = write(path, flight)
        file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")
        return file

    return written


def without(lines: slice) -> Callable[[str], str]:
    """Return a change that takes lines out."""

    def change(text: str) -> str:
        rows = text.split("\n")
        del rows[lines]
        return "\n".join(rows)

    return change


def clocked(scale: float = 1.0, shift: float = 0.0) -> Write:
    """Return a writer of a table whose times are in another unit, or from another origin."""

    def written(path: Path, flight: ho.RecordedFlight) -> Path:
        tracks = {n: ho.Track(scale * (x.t + shift), x.positions) for n, x in flight.tracks.items()}
        return w.write_csv(path, replace(flight, tracks=tracks, markers=NOTHING))

    return written


def text_of(words: str) -> Write:
    def written(path: Path, _: ho.RecordedFlight) -> Path:
        path.write_text(words, encoding="utf-8")
        return path

    return written


def repeated(text: str) -> str:
    """Return a table whose first row stands once more at its end."""
    return text + text.split("\n")[1] + "\n"


REFUSED: dict[str, tuple[Write, str]] = {
    "no format": (
        text_of("hello, world\n"),
        "give a table of Motive with its header, of Vicon, C3D, a ROS",
    ),
    "empty": (text_of(""), "has no line of columns' names"),
    "another table": (text_of("t,drone,x,y,z\n0,q0,0,0,1\n"), "names with t, name, x, y, z"),
    "no bodies": (text_of("t,name,x,y,z\n0,marker,0,0,1\n"), "holds no position of a body"),
    "local space": (partial(w.write_motive, space="Local"), "export it in Global space"),
    "Motive without its header": (
        edited(without(slice(0, 7))),
        "a table of Motive with its header",
    ),
    "Motive without titles": (edited(without(slice(2, 5))), "has no titles above a row 'Frame'"),
    "Motive in leagues": (
        partial(w.write_motive, unit=("Leagues", 1e-3)),
        "'Leagues', is unknown; state unit='m', 'cm' or 'mm'",
    ),
    "Motive's frames backward": (
        edited(lambda text: text + text.split("\n")[20] + "\n"),
        "times do not ascend: 1.49 s is followed by 0.13 s",
    ),
    "Vicon without a rate": (
        edited(lambda text: text.replace("\n100\n", "\n0\n"), w.write_vicon),
        "section Objects: a rate of 0 Hz",
    ),
    "times backward": (edited(repeated, w.write_csv), "is followed by 0 s; give one flight"),
    "millimetres": (
        edited(lambda text: text.replace(",1.", ",1000."), w.write_csv),
        "m from the origin at the median, over 50 m: millimetres? unit='mm'",
    ),
    "milliseconds": (clocked(1e3), "step by 10 s: not in seconds; if they are milliseconds"),
    "nanoseconds": (clocked(1e9, 1.7e9), "if they are nanoseconds, divide by 1e+09"),
    "bag of other messages": (
        lambda path, flight: w.write_bag(path, replace(flight, tracks={}), bodies="pose"),
        "holds none of motion_capture_tracking_interfaces/msg/NamedPoseArray",
    ),
    "log of version 3": (partial(w.write_usd, version=3), "is of version 3; 1 and 2 are known"),
    "log without positions": (
        partial(w.write_usd, group="stabilizer"),
        "logs none of stateEstimate.x, stateEstimateZ.x, locSrv.x, but ",
    ),
    "ulog without positions": (
        partial(w.write_ulog, topic="vehicle_gps_odometry"),
        "logs none of vehicle_visual_odometry, vehicle_local_position",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_doubtful_recordings_are_refused(case: str, tmp_path: Path) -> None:
    write, words = REFUSED[case]
    path = write(tmp_path / "take", w.sample())
    with pytest.raises(ho.FileError) as refusal:
        ho.read_flight(path)
    assert words in str(refusal.value)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_other_paths_and_units_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ho.FileError, match="none: there is no such file; give a recording"):
        ho.read_flight(tmp_path / "none")
    with pytest.raises(ho.FileError, match="holds no file: no recording; give a table of Motive"):
        ho.read_flight(tmp_path)
    with pytest.raises(ho.InputError, match="unit = 'miles': must be one of m, cm, mm"):
        ho.read_flight(tmp_path, unit="miles")
    flight = replace(w.sample(), markers=NOTHING)
    with pytest.raises(ho.FileError, match="units its format fixes; leave unit= out"):
        ho.read_flight(w.write_usd(tmp_path / "logs", flight), unit="mm")


@pytest.mark.parametrize(
    ("name", "module"),
    [("ROS 2 bag", "rosbags.highlevel"), ("PX4 ulog", "pyulog"), ("C3D", "ezc3d")],
)
def test_a_missing_library_is_named(
    name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = replace(w.sample(), markers=NOTHING)
    path = FORMATS[name][0](tmp_path / f"take{suffix(name)}", flight)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(ho.FileError, match=r"pip install 'hitchopt\[logs\]'"):
        ho.read_flight(path)


@pytest.mark.parametrize("unit", ["mm", "ft"])
@pytest.mark.parametrize("name", ["table", "ROS 2 bag", "Vicon CSV", "C3D"])
def test_a_stated_unit_counts(name: str, unit: str, tmp_path: Path) -> None:
    """Files that state millimetres are written by numbers 1000 times as large."""
    flight, scale = w.sample(), {"mm": 1e-3, "ft": 0.3048}[unit]
    large = 1e3 if name in {"Vicon CSV", "C3D"} else 1.0
    result = ho.read_flight(FORMATS[name][0](tmp_path / f"take{suffix(name)}", flight), unit)
    for body, track in flight.tracks.items():
        expected = large * scale * track.positions
        np.testing.assert_allclose(result.tracks[body].positions, expected, rtol=1e-6)
    order = np.argsort(np.linalg.norm(result.markers.positions[:3], axis=1))
    assert len(order) == 3


def test_bodies_are_means_of_subjects_while_all_markers_are_visible(tmp_path: Path) -> None:
    """Of C3D and the like, which know no bodies; markers without a name are none."""
    t = np.arange(50) / 100.0
    front, back = np.tile([[0.1, 0.0, 1.0]], (50, 1)), np.tile([[-0.1, 0.2, 1.0]], (50, 1))
    tracks = {"cf1:front": ho.Track(t, front), "cf1:back": ho.Track(t[10:], back[10:])}
    tracks |= {"*7": ho.Track(t, front + 1.0), "Unlabeled 3": ho.Track(t, back + 2.0)}
    result = ho.read_flight(w.write_c3d(tmp_path / "take.c3d", ho.RecordedFlight("", tracks)))
    assert list(result.tracks) == ["cf1"]
    np.testing.assert_allclose(result.tracks["cf1"].t, t[10:])
    np.testing.assert_allclose(result.tracks["cf1"].positions, [[0.0, 0.1, 1.0]] * 40, atol=1e-6)
    assert len(result.markers.t) == 50 + 40 + 50 + 50
    data, cut = (tmp_path / "take.c3d").read_bytes(), tmp_path / "cut.c3d"
    begin = 512 * (struct.unpack_from("<H", data, 16)[0] - 1)
    cut.write_bytes(data[: begin + 40 * 4 * 16])  # Frames of four points
    short = ho.read_flight(cut)
    assert short.notes == ("is cut off: read to frame 40 of 50",)
    np.testing.assert_array_equal(short.tracks["cf1"].t, t[10:40])


def test_stamps_of_a_date_count_from_the_first_position(tmp_path: Path) -> None:
    flight = ho.read_flight(clocked(1.0, 1.7e9)(tmp_path / "take", w.sample()))
    assert flight.epoch == 1.7e9
    assert "at 1700000000.000 s of the recording's clock" in flight.notes[0]
    for body, track in w.sample().tracks.items():
        np.testing.assert_allclose(flight.tracks[body].t, track.t, atol=1e-6)


def test_blank_cells_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text("t,name,x,y,z\n0,q0,1,2,3\n0.1,q0,,,\n0.2,q0,1,2,nan\n0.3,q0,4,5,6\n", "utf-8")
    flight = ho.read_flight(path)
    np.testing.assert_array_equal(flight.tracks["q0"].t, [0.0, 0.3])
    assert flight.notes == ("2 of 4 rows have no position, or the same time: left out",)


def test_times_are_those_of_frames_unless_others_are_printed(tmp_path: Path) -> None:
    """Motive cuts times to milliseconds; frames at another rate are not believed."""
    path = w.write_motive(tmp_path / "take.csv", w.sample())
    text = path.read_text(encoding="utf-8-sig")
    path.write_text(text.replace("Export Frame Rate,100.0", "Export Frame Rate,120.0"), "utf-8")
    flight = ho.read_flight(path)
    assert flight.notes == ("times are as printed: frames at 120 Hz have others",)
    assert flight.tracks["cf3"].t[-1] == pytest.approx(1.49)


def test_a_cut_log_is_read_to_its_last_record(tmp_path: Path) -> None:
    flight = replace(w.sample(seen=1.0), markers=NOTHING)
    folder = w.write_usd(tmp_path / "logs", flight)
    for cut in (1, 4, 9, 500, 1000):
        log = tmp_path / "log00"
        log.write_bytes((folder / "cf3.bin").read_bytes()[:-cut])
        result = ho.read_flight(log)
        many = len(result.tracks["log00"].t)
        assert many == 150 if cut <= 4 else 90 < many < 150
        note = f"log00: is cut off or damaged: read to its record at {0.01 * (many - 1):.3f} s"
        assert note in result.notes
        assert result.one_clock


# A damaged file is refused with its path, or it is read if values alone were damaged
DAMAGED = [*(n for n in FORMATS if n not in {"Motive CSV 1.22", "Motive CSV 1.24"})]


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_end_in_a_line(name: str, tmp_path: Path) -> None:
    """Twenty a format: cut off, bytes changed, put in or taken out, at the head or anywhere."""
    write, with_markers, _ = FORMATS[name]
    flight = w.sample(frames=60)
    flight = flight if with_markers else replace(flight, markers=NOTHING)
    whole, refused = write(tmp_path / f"whole{suffix(name)}", flight), 0
    for seed in range(20):
        rng, path = np.random.default_rng(seed), tmp_path / f"take{seed}{suffix(name)}"
        if whole.is_dir():
            shutil.copytree(whole, path)
        else:
            shutil.copy(whole, path)
        file = max(
            (p for p in [path, *path.glob("*")] if p.is_file()), key=lambda p: p.stat().st_size
        )
        data = bytearray(file.read_bytes())
        end = len(data) if seed % 2 else min(len(data), 600)
        at = int(rng.integers(end))
        if seed % 4 == 0:
            data = data[:at]
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
            result = ho.read_flight(path)
        except ho.FileError as error:
            words, refused = str(error), refused + 1
        else:
            assert all(np.all(np.isfinite(x.positions)) for x in result.tracks.values())
        assert words == "" or (words.startswith(str(path)) and "\n" not in words), words
    assert refused > 1


def test_records_check_their_fields() -> None:
    places = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    with pytest.raises(ValueError, match="read-only"):
        ho.Track(np.zeros(2), places).t[0] = 5.0
    for t, x, words in (
        (np.array([1.0, 0.0]), places, "t = .*ascending"),
        (np.zeros(1), places, r"of shape \(m, 3\) and finite, .* shape \(1,\)"),
        (np.zeros(2), places * np.nan, "finite"),
    ):
        with pytest.raises(ho.InputError, match=words):
            ho.Track(t, x)


def test_points_are_whole_in_one_row() -> None:
    lines = ["0;1;;;", "1;;;2,5;3", '2;"4"; 5,5;6;7', ";;;", "3;1;1;1;1"]
    head, places = table_of(lines, ";", [2])
    np.testing.assert_array_equal(head, [[0.0, 1.0], [1.0, np.nan], [2.0, 4.0]])
    np.testing.assert_array_equal(places[2], [[5.5, 6.0, 7.0]])
    assert np.isnan(places[:2]).any(axis=2).all()


def test_clouds_of_other_layouts_are_read() -> None:
    """Clouds have more fields, in doubles, or of big-endian numbers."""
    for order, kind, size in ((">", "d", 8), ("<", "f", 4)):
        fields = [
            SimpleNamespace(name=name, offset=size * k, datatype=8 if kind == "d" else 7)
            for k, name in enumerate(("intensity", "z", "y", "x"))
        ]
        data = struct.pack(f"{order}8{kind}", 9, 3, 2, 1, 9, 6, 5, 4)
        given = {"fields": fields, "point_step": 4 * size, "data": data, "width": 2, "height": 1}
        message = SimpleNamespace(is_bigendian=order == ">", **given)
        np.testing.assert_array_equal(points_of(message), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
