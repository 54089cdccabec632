"""Fleet files read back: every rule on files that break it; damage is reported or refused."""

from __future__ import annotations

import json
import math
import random
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Writer

from hitchopt.errors import FileError, InputError
from hitchopt.exports import contents
from hitchopt.exports.formats.crazyflie import write_poly_csv
from hitchopt.exports.formats.ros2bag import message_types
from hitchopt.exports.formats.skybrush import MAX_SCALE, read_show, storage_scale
from hitchopt.exports.lint import Report, Rules, lint
from hitchopt.exports.options import HOMES
from hitchopt.hitch.requirements import Separation
from hitchopt.trajectory import PiecewisePolynomial
from tests.helpers.exported_plans import exported, swarm_of, swarm_plan
from tests.helpers.refusals import memory_below

Change = Callable[[Any], Any]
"""Of the text of a file, its bytes if they are no text, or the JSON files of a show by name."""


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a swarm in every format, in a folder each."""
    home = tmp_path_factory.mktemp("exports")
    for name in HOMES:
        exported(swarm_plan(), name, home / name, rate=20.0 if name == "csv" else None)
    return home


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    """The export of a swarm in two parts."""
    places = np.array([[[0.0, 0, 1], [1, 0, 1.2]], [[0.5, 0, 1], [1.5, 0, 1.2]]])
    motion = swarm_of(np.concatenate([places, places[::-1]] * 12), np.arange(48.0) * 2.0)
    exported(motion, "crazyswarm2", tmp_path / "parts")
    return tmp_path / "parts"


def report(path: Path, rules: Rules | None = None) -> Report:
    (found,) = lint(path, rules)
    return found


def said(found: Report) -> str:
    """Levels and rules of what is found, each once."""
    return ", ".join(sorted({f"{f.level} {f.rule}" for f in found.findings}))


def write_zip(path: Path, files: dict[str, Any]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data if isinstance(data, str | bytes) else json.dumps(data))
    return path


def edit(path: Path, change: Change) -> None:
    """Change a file, or remove it where nothing is left of it."""
    if path.suffix == ".skyc":
        with zipfile.ZipFile(path) as archive:
            files = {each: json.loads(archive.read(each)) for each in archive.namelist()}
        change(files)
        write_zip(path, files)
    elif path.suffix in {".csv", ".json"}:
        before = path.read_text()
        path.write_text(after := change(before))
        assert after != before
    elif (data := change(path.read_bytes())) is None:
        path.unlink()
    else:
        path.write_bytes(data)


def text(old: str, new: str) -> Change:
    return lambda before: before.replace(old, new, 1)


def rows(order: Callable[[list[str]], list[str]]) -> Change:
    """Rearrange the lines of a text."""
    return lambda before: "\n".join(order(before.splitlines())) + "\n"


def cell(row: int, column: int, value: str) -> Change:
    def order(lines: list[str]) -> list[str]:
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return rows(order)


def content(data: bytes | None) -> Change:
    return lambda _: data


FIRST = "drones/d0/trajectory.json"


def points_of(files: dict[str, Any]) -> list[Any]:
    found: list[Any] = files[FIRST]["points"]
    return found


def point(place: int, value: object) -> Change:
    """Change a part of the second point of a show's first drone."""
    return lambda files: points_of(files)[1].__setitem__(place, value)


START, END = bytes(8), b"\x00\x00\x00"
MEMORY = struct.pack("<4h", 100, 3000, 1000, 0) + 250 * struct.pack("<BH7h", 0b11, 10, *[100] * 7)
TURNED = struct.pack("<4hBHh", 32767, 0, 1000, 0, 0b01_00_00_00, 500, 900)

DAMAGE: dict[str, list[tuple[Change, str]]] = {
    "crazyswarm2/d0.csv": [
        (rows(lambda s: s[:1]), "has no line of numbers"),
        (rows(lambda s: [*s, "1.0,2.0"]), "has 2 cells, not 33; is it cut off"),
        (cell(2, 3, "1e39"), "exceeds the single precision of drones"),
        (cell(2, 0, "0.0"), "row 2: its duration is 0 s"),
        (cell(2, 0, "3e12"), r"times go from 0 to 3e\+12"),
    ],
    "compressed/d0_enu.bin": [
        (content(b""), "has 0 bytes"),
        (content(START + END), "no segment of nonzero duration"),
        (content(START + b"\x03\x10"), "within a segment's header, at byte 8"),
        (content(START + b"\x03\x10\x00" + bytes(13)), "stops within segment 0"),
        (content(bytes(70_000)), "far larger"),
    ],
    "skybrush/show.skyc": [
        (lambda f: f.pop("show.json"), "show.json"),
        (lambda f: f["show.json"]["swarm"]["drones"].clear(), "names no drones"),
        (lambda f: f.pop(FIRST), FIRST),
        (lambda f: points_of(f).reverse(), "go back from t = "),
        (lambda f: f[FIRST].update(points={"0": 1}), "has 0 points"),
        (point(1, [0.0, 1.0]), "damaged|not"),
        (point(2, [[0, 0, 0]] * 3), "at most cubic"),
        (point(1, [0.0, 1.0, float("nan")]), "finite"),
        (point(1, [0, 0, 1e300]), r"goes 1e\+300 m from"),
    ],
    "mavsdk_drone_show/Drone 2.csv": [
        (text("vx", "wx"), "or columns differ from"),
        (rows(lambda s: [*s[:-1], "0,0"]), "has 2 cells, not 16; is it cut off"),
        (cell(4, 1, "0.123"), "its times or columns differ from those of Drone 1"),
    ],
    "ros2bag/setpoints.mcap": [(content(None), "is not a valid bag")],
    "csv/setpoints_enu.csv": [
        (text("t,drone,x", "t,drone,q"), "has no 'x', but"),
        (text("d1", "d7"), "are not one per drone"),
        (rows(lambda s: [s[i] for i in (0, 4, 5, 6, 1, 2, 3)]), "go back from t = "),
        (rows(lambda s: s[:3]), "has fewer than two samples|ends within"),
        (rows(lambda s: s[:-1]), "ends within the sample"),
        (text(",d2,", ",d2,nonsense"), "line 4: x is 'nonsense.*', not a number"),
        (rows(lambda s: s[:1]), "has no rows"),
        (rows(lambda s: [s[0], "nan,d0" + ",0" * 26]), "line 2, column t: not a number"),
        (rows(lambda s: [*s[:-1], s[-1][:25]]), "cells, not 28; is it cut off"),
    ],
    "gltf/plan.glb": [
        (content(b"glTF" + bytes(60)), "does not begin with the header of a .glb file"),
        (lambda data: data.replace(b'"d1"', b'"d7"', 1), "'d7'"),
    ],
}
"""What is done to a file of an export, and in which words it is refused."""

FLAWED: dict[str, list[tuple[Change, str]]] = {
    "crazyswarm2/d1.csv": [
        (text("frame: enu", "frame: nwu"), "error frame"),
        (rows(lambda s: s[1:]), "error header"),
    ],
    "compressed/d1_enu.bin": [
        (content(None), "error missing"),
        (lambda data: data[:-3], "error end marker"),
        (content(MEMORY + END), "error memory, warning duration"),
        (content(TURNED + END), "error range, warning duration, warning yaw"),
    ],
    "skybrush/show.skyc": [
        (lambda f: points_of(f).insert(1, [1e-4, points_of(f)[0][1], []]), "error duration")
    ],
    "mavsdk_drone_show/*.csv": [(rows(lambda s: s[:10] + s[25:]), "error rate")],
    "csv/setpoints_enu.csv": [
        (
            rows(lambda s: [s[0], *(f"2{r[1:]}" for r in s[1:31])]),
            "error changed, warning start",
        )
    ],
}
"""What is done to an export, and the rules that it breaks then, of errors and warnings of some."""

CASES = [
    pytest.param(name, change, words, table is FLAWED, id=f"{name}-{i}")
    for table in (DAMAGE, FLAWED)
    for name, found in table.items()
    for i, (change, words) in enumerate(found)
]


@pytest.mark.parametrize(("name", "change", "words", "readable"), CASES)
def test_damaged_files_are_refused_and_flaws_are_named(
    name: str, change: Change, words: str, readable: bool, exports: Path, tmp_path: Path
) -> None:
    kind, file = name.split("/")
    folder = Path(shutil.copytree(exports / kind, tmp_path / kind))
    for path in folder.glob(file):
        edit(path, change)
    if readable:
        found = report(folder)
        assert set(words.split(", ")) <= set(said(found).split(", "))
        assert found.sound is ("error" not in words)
    else:
        with pytest.raises(FileError, match=words):
            lint(folder)


ODD = (*b'null [] {} "a" nan 1e400 ,'.split(), b"", b"\xff", b"1" * 5000, b"[" * 5000)
"""What stands in place of a word or number."""


def damaged(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data))
    if chance.random() < 0.3:
        return data[:at] + chance.randbytes(1) + data[at + chance.randrange(200) :]
    words = [m.span() for m in re.finditer(rb"[-\w.+]+|\[[^][]*\]", data[:100_000])] or [(0, at)]
    start, end = chance.choice(words)
    return data[:start] + chance.choice(ODD) + data[end:]


def damage(path: Path, chance: random.Random) -> None:
    """Damage the file, or mostly what is in it if it is a zip."""
    if not zipfile.is_zipfile(path) or chance.random() < 0.2:
        path.write_bytes(damaged(path.read_bytes(), chance))
        return
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(list(members))
    write_zip(path, members | {name: damaged(members[name], chance)})


@pytest.mark.parametrize("name", HOMES)
def test_any_damage_is_reported_or_refused(name: str, exports: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(exports / name, tmp_path / name))
    originals = {path: path.read_bytes() for path in sorted(folder.iterdir())}
    chance = random.Random(7)
    refused: list[str] = []
    for _ in range(14):
        path = chance.choice(list(originals))
        damage(path, chance)
        try:
            lint(folder)
        except FileError as error:
            refused.append(str(error))
        path.write_bytes(originals[path])
    assert refused
    assert all(text.startswith(str(folder)) and len(text) < 800 for text in refused)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, "are read; it contains nothing"),
        ({"a.csv": "x,y\n1,2\n"}, "is not in a known format"),
        ({"a.csv": "duration,x\n1,2\n", "b.bin": ""}, "more than one flight"),
        ({"a.csv": "duration,x\n1,2\n", "b.csv": "idx,t,px\n"}, "more than one flight"),
        ({"a.csv": "t,drone,x\n", "b.csv": "t,drone,x\n"}, "2 of csv.; name one"),
        ({"a.skyc": "", "b.skyc": ""}, "2 of skybrush.; name one"),
        ({"one.bag": "", "two.bag": "", "c.dae": ""}, r"it contains \.bag, \.dae"),
        ({"plan.npz": ""}, "hitchopt check"),
        ({"metadata.yaml": "no bag"}, "is not a valid bag"),
        ({"export.json": "{"}, "is not a valid manifest"),
    ],
)
def test_unknown_files_are_refused(files: dict[str, str], told: str, tmp_path: Path) -> None:
    for name, text_of_file in files.items():
        (tmp_path / name).write_text(text_of_file)
    with pytest.raises(FileError, match=told):
        lint(tmp_path)


@pytest.mark.parametrize("head", ["duration,x^0\n", ""])
@pytest.mark.parametrize(
    ("degree", "told"),
    [
        (8, "has polynomials of degree 8, 37 numbers in a line; drones take degree 7: fit"),
        (5, "not 33"),
    ],
)
def test_trajectories_of_other_degrees_are_named(
    degree: int, told: str, head: str, tmp_path: Path
) -> None:
    line = ",".join(["1.0", *["0.0"] * (4 * (degree + 1))])
    (tmp_path / "d0.csv").write_text(f"{head}{line}\n{line}\n")
    with pytest.raises(FileError, match=told if head or degree == 8 else "not in a known format"):
        lint(tmp_path)


def test_bags_of_other_messages_and_slow_ones(tmp_path: Path) -> None:
    store, kind = message_types(), "std_msgs/msg/String"
    with Writer(tmp_path / "bag", version=9) as bag:
        topic = bag.add_connection("/chatter", kind, typestore=store)
        bag.write(topic, 0, store.serialize_cdr(store.types[kind]("hello"), kind))
    with pytest.raises(FileError, match=r"contains no trajectory_msgs.* but std_msgs/msg/String"):
        lint(tmp_path / "bag")
    for rate, words in ((25.0, "warning rate"), (30.0, "")):
        exported(swarm_plan(), "ros2bag", tmp_path / words, rate=rate)
        assert said(report(tmp_path / words)) == words


def referring(path: Path, members: dict[str, str], drones: int = 300) -> Path:
    """Write a show whose drones refer to its files in turn."""
    refer = [{"$ref": f"./{i % len(members)}.json#"} for i in range(drones)]
    names = [{"settings": {"name": f"d{i}", "trajectory": each}} for i, each in enumerate(refer)]
    return write_zip(path, members | {"show.json": {"swarm": {"drones": names}}})


def test_small_files_that_unpack_to_very_much(tmp_path: Path) -> None:
    # Each drone has times of its own, on whose breaks all curves would be stored.
    members = {
        f"{i}.json": json.dumps({"points": [[k + 0.001 * i, [0, 0, 1], []] for k in range(22)]})
        for i in range(1000)
    }
    path = referring(tmp_path / "show.skyc", members, drones=1000)
    with pytest.raises(FileError, match=r"1000 drones with 2\d{4} spans of time exceed 2"):
        lint(path)
    # What follows needs no memory: the reader has been imported.
    bomb = referring(tmp_path / "bomb.skyc", {"0.json": '{"points": [' + " " * 100_000_000})
    assert bomb.stat().st_size < 120_000
    spaces = {f"{i}.json": " " * 10_000_000 for i in range(8)}
    many = referring(tmp_path / "many.skyc", spaces)
    for path, words in ((bomb, "would unpack to 1e"), (many, "would unpack to 8e")):
        with memory_below(5e6), pytest.raises(FileError, match=words):
            lint(path)


def polys(folder: Path, *drones: tuple[list[float], list[list[float]]]) -> None:
    """Files d0.csv, …: durations, and per piece the powers of x; y tells the drones apart."""
    for i, (durations, pieces) in enumerate(drones):
        powers = np.zeros((len(durations), 4, 8))
        for k, piece in enumerate(pieces):
            powers[k, 0, : len(piece)] = piece
        powers[:, 1, 0], powers[:, 2, 0] = i, 1.0
        write_poly_csv(folder / f"d{i}.csv", np.array(durations), powers, "enu")


REST = ([1.0, 1.0], [[0.0], [0.0]])
MOVING = ([1.0, 1.0], [[0.0, 0.5, 0.2], [0.7, 0.9, 0.2]])
JUMPING = ([1.0, 1.0], [[0.0, 0.5], [0.5, -0.5]])
LATE = ([2.0, 0.5], [[0.0], [0.0]])
FAR = ([70.0, 70.0], [[0.0, 0.3], [21.0, 0.3]])
FULL = ([0.1] * 31, [[0.02 * k, 0.2] for k in range(31)])
LONG = ([0.1] * 32, [[0.02 * k + (0.35 if k >= 16 else 0.0), 0.2] for k in range(32)])
NEAR = Rules(separation=Separation(radius=0.6))
FLAWS: dict[str, tuple[list[Any], Rules, str]] = {
    "two rows": ([REST], Rules(), ""),
    "one row": ([([2.0], [[0.0, 0.5]])], Rules(), "error one row, warning end"),
    "velocity jumps": ([JUMPING], Rules(), "warning end, warning jump"),
    "fast": ([MOVING], Rules(), "warning end"),
    "too fast": ([MOVING], Rules(1.2, 0.3), "error acceleration, error speed, warning end"),
    "apart, but not as long": ([REST, LATE], Rules(), "warning duration"),
    "near": ([REST, REST], NEAR, "error separation"),
    "far away": ([FAR], Rules(), "note range, warning end"),
    "31 pieces": ([FULL], Rules(), "warning end"),
    "32 pieces and a jump": ([LONG], Rules(), "error jump, error memory, warning end"),
}
"""Drones' pieces, limits, and the rules that they break; 32 pieces as in a widely used example."""


@pytest.mark.parametrize("name", FLAWS)
def test_each_rule_detects_its_violation(name: str, tmp_path: Path) -> None:
    drones, rules, expected = FLAWS[name]
    polys(tmp_path, *drones)
    found = report(tmp_path, rules)
    assert said(found) == expected
    assert found.sound is ("error" not in expected)


def test_jumps_between_windows_are_found(tmp_path: Path) -> None:
    """Files of more than WINDOW pieces are read in parts."""
    pieces = [[0.1 * (k >= contents.WINDOW)] for k in range(contents.WINDOW + 3)]
    polys(tmp_path, ([0.1] * len(pieces), pieces))
    found = report(tmp_path)
    assert found.flight.jumps[0] == pytest.approx(0.1, rel=1e-5)
    assert "0.1 m where pieces join at t = 2000 s" in str(found.findings)


@pytest.mark.parametrize("pieces", range(1, 14))
def test_windows_are_the_whole_flight(pieces: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of curves with breaks of their own and of samples, of any number of pieces."""
    monkeypatch.setattr(contents, "WINDOW", 8)
    rng = np.random.default_rng(pieces)
    t = np.cumsum(rng.uniform(0.1, 0.4, pieces + 1)) - 0.05
    places = rng.normal(size=(2, pieces + 1, 3))
    curves = [
        PiecewisePolynomial(t + 0.03 * k, np.stack([each[:-1], each[1:]], axis=-1))
        for k, each in enumerate(places)
    ]
    drones = [contents.Trajectory(f"d{k}", curve) for k, curve in enumerate(curves)]
    samples = contents.FileContents.of_samples(("d0", "d1"), t, np.swapaxes(places, 0, 1), "", 0)
    for found, own in (
        (contents.FileContents.of_curves(drones[:1], "enu", 0), curves[:1]),
        (samples, [curves[0], curves[0].replaced(curves[1].coefficients)]),
    ):
        windows = list(found.windows())
        assert all(window.pieces * len(own) <= 8 for window in windows)
        assert all(x.breaks[-1] == y.breaks[0] for x, y in pairwise(windows))
        assert sum(window.pieces for window in windows) == pieces
        for window in windows:
            middles = 0.5 * (window.breaks[1:] + window.breaks[:-1])
            expected = np.stack([curve.at(middles) for curve in own], axis=1)
            np.testing.assert_allclose(window.at(middles), expected, atol=1e-12)


def test_figures_and_places_of_findings(tmp_path: Path) -> None:
    polys(tmp_path, LONG)
    found = report(tmp_path)
    assert (found.facts[0].pieces, found.facts[0].size) == (32, 4224)
    assert found.flight.jumps[0] == pytest.approx(0.35, rel=1e-5)
    assert "0.35 m where pieces join at t = 1.6 s" in str(found.findings[1])
    polys(tmp_path, MOVING)
    found = report(tmp_path)
    assert found.flight.speed == pytest.approx(1.3, rel=1e-3)
    assert found.flight.acceleration == pytest.approx(0.4, rel=1e-3)
    polys(tmp_path, REST, REST)
    assert report(tmp_path, NEAR).flight.separation == pytest.approx(1.0 / 1.2, rel=1e-3)
    (tmp_path / "d1.csv").write_bytes((tmp_path / "d0.csv").read_bytes())
    assert said(report(tmp_path)) == "warning separation"  # perhaps relative trajectories
    polys(tmp_path, ([1.0] * 3, [[0.0]] * 3))
    (tmp_path / "d1.csv").unlink()
    yaw = 25  # of its constants, a whole turn and a jump
    edit(tmp_path / "d0.csv", cell(2, yaw, str(2.0 * math.pi)))
    edit(tmp_path / "d0.csv", cell(3, yaw, "0.5"))
    (finding,) = report(tmp_path).findings
    assert str(finding).startswith("warning: jump: d0: yaw jumps by 28.6° at t = 2 s")


WITHOUT = [
    ("csv", "setpoints_enu.csv", ("vx", "vy", "vz"), "velocities"),
    ("csv", "setpoints_enu.csv", ("ax", "ay", "az"), "accelerations"),
    ("mavsdk_drone_show", "Drone 1.csv", ("vx", "vy", "vz", "ax", "ay", "az"), "velocities"),
]


@pytest.mark.parametrize(("name", "file", "columns", "missing"), WITHOUT)
def test_tables_without_rates(
    name: str, file: str, columns: tuple[str, ...], missing: str, exports: Path, tmp_path: Path
) -> None:
    """They are joined by lines or cubics: at most as fast, without a rest at every row."""
    whole = report(exports / name / file)
    lines = [line.split(",") for line in (exports / name / file).read_text().splitlines()]
    kept = [i for i, label in enumerate(lines[0]) if label not in columns]
    (tmp_path / file).write_text("\n".join(",".join(row[i] for i in kept) for row in lines))
    found = report(tmp_path / file)
    assert found.flight.speed == pytest.approx(whole.flight.speed, rel=0.01)
    assert math.isnan(found.flight.acceleration) is (missing == "velocities")
    assert missing in {finding.rule for finding in found.findings if finding.level == "note"}


def show_of(path: Path, validation: dict[str, Any], late: float, **routes: list[Any]) -> Path:
    each = {name: {"points": points, "takeoffTime": late} for name, points in routes.items()}
    drones = [{"settings": {"name": name, "trajectory": route}} for name, route in each.items()]
    content = {"swarm": {"drones": drones}, "settings": {"validation": validation}}
    return write_zip(path, {"show.json": content})


def test_lines_parabolas_cubics_and_late_starts_are_read(tmp_path: Path) -> None:
    chance = np.random.default_rng(3)
    places = chance.normal(size=(7, 3)).tolist()
    inner = [[], *(chance.normal(size=(k % 3, 3)).tolist() for k in range(6))]
    points = [[k, place, each] for k, (place, each) in enumerate(zip(places, inner, strict=True))]
    path = show_of(tmp_path / "a.skyc", {}, 3.0, d0=points)
    curve = read_show(path).curves["d0"]
    np.testing.assert_allclose(curve.at(1.7), places[0], atol=1e-12)
    for k, controls in enumerate(inner[1:]):
        row = np.array([places[k], *controls, places[k + 1]])
        while len(row) > 1:  # de Casteljau at 0.3
            row = 0.7 * row[:-1] + 0.3 * row[1:]
        np.testing.assert_allclose(curve.at(k + 3.3), row[0], atol=1e-12)


def two_drones(path: Path, **validation: Any) -> Path:
    """Write a show: d0 climbs at 4 m/s to 9 m and rests, d1 moves across at 5 m/s, 3 m from it."""
    d0 = [[0, [0, 0, 1], []], [2, [0, 0, 9], []], [4, [0, 0, 9], []]]
    d1 = [[0, [0, 3, 1], []], [2, [10, 3, 1], []], [4, [10, 3, 1], []]]
    usual = {"maxAltitude": 10, "maxVelocityXY": 8, "maxVelocityZ": 5, "minDistance": 2}
    return show_of(path, usual | validation if validation else {}, 0.0, d0=d0, d1=d1)


@pytest.mark.parametrize(
    ("key", "held", "broken", "where"),
    [
        ("maxAltitude", 9.1, 8.9, "d0"),
        ("maxVelocityXY", 5.1, 4.9, "d1"),
        ("maxVelocityZ", 4.1, 3.9, "d0"),
        ("maxVelocityZUp", 4.1, 3.9, "d0"),
        ("minDistance", 2.9, 3.1, "d0, d1"),
    ],
)
def test_each_limit_of_a_show(
    key: str, held: float, broken: float, where: str, tmp_path: Path
) -> None:
    path = two_drones(tmp_path / "a.skyc", **{key: held})
    assert report(path).sound  # 5 m/s is beyond the usual 3
    assert "error speed" in said(report(path, Rules(speed=3.0)))  # what is asked for holds
    found = report(two_drones(tmp_path / "b.skyc", **{key: broken}))
    (finding,) = (f for f in found.findings if f.level == "error")
    assert (finding.rule, finding.where) == (key, where)
    remedies = {"maxAltitude": "fly lower", "minDistance": "move them apart"}
    assert finding.message.endswith(remedies.get(key, "fly it more slowly"))


AT_HOME: list[Any] = [[0, [5, -7, 0], []], [4, [5, -7, 3], []], [9, [5, -7, 0.5], []]]


def lifted(points: list[Any], height: float) -> list[Any]:
    return [[t, [x, y, z + height], controls] for t, (x, y, z), controls in points]


@pytest.mark.parametrize(
    ("home", "points", "told"),
    [
        ([5, -7, 0], AT_HOME, ""),
        ([5.05, -7, 0.05], lifted(AT_HOME, 0.05), ""),
        ([5, -7], AT_HOME, ""),
        (None, AT_HOME, ""),
        ([5, -7, -20], lifted(AT_HOME, -20), ""),  # in a valley
        ([5, -7, 0], lifted(AT_HOME, 40), "warning: start: b: begins 40 m above the ground"),
        ([5, -7, 40], lifted(AT_HOME, 40), "warning: start: b: begins 40 m above the ground"),
        (None, lifted(AT_HOME, 0.3), "warning: start: b: begins 0.3 m above the ground"),
        ([5, -7, -20], lifted(AT_HOME, -8), "warning: start: b: begins 12 m above the ground"),
        ([8, -11, 0], AT_HOME, "warning: start: b: begins 5 m away from its home; place it"),
        ([5, -7, 0], lifted(AT_HOME, -5), "error: ground: b: flies 5 m below the ground"),
        (  # between its points only: a parabola
            [5, -7, 0],
            [*AT_HOME[:2], [9, [5, -7, 3], [[5, -7, -9]]]],
            "error: ground: b: flies 3 m below the ground; fly higher",
        ),
        ([5, -7, 0], [*AT_HOME[:2], [9, [5, -7, 3], [[5, -7, -2]]]], ""),  # not the parabola
        (["5", "-7"], AT_HOME, "warning: settings: b: its home is not a point [x, y, z]"),
        ([10**400, -7, 0], AT_HOME, "warning: settings: b: its home is not a point"),
    ],
)
def test_shows_begin_at_their_homes_and_stay_above_the_ground(
    home: Any, points: list[Any], told: str, tmp_path: Path
) -> None:
    """Of two drones the second; where both are wrong, one line names the worse one."""

    def found(first_home: Any, first: list[Any]) -> list[str]:
        drones = [
            {"settings": {"name": name, "trajectory": {"points": route}, "home": place}}
            for name, route, place in (("a", first, first_home), ("b", points, home))
        ]
        path = write_zip(tmp_path / "a.skyc", {"show.json": {"swarm": {"drones": drones}}})
        rules = ("start", "ground", "settings")
        return [str(each) for each in report(path).findings if each.rule in rules]

    east = [[t, [x + 30, y, z], []] for t, (x, y, z), _ in AT_HOME]
    lines = found([35, -7, 0], east)
    assert len(lines) == (told != "")
    assert all(line.startswith(told) for line in lines)
    (line, *others) = found([35, -7, 0], lifted(east, 0.2))
    if "above the ground" in told:
        assert line == f"{lines[0]} (2 drones do so)"
    else:
        assert "start: a: begins 0.2 m above the ground" in " ".join([line, *others])


def test_a_show_is_stored_in_multiples_of_millimetres(tmp_path: Path) -> None:
    """16 bits with a scale of up to 127 hold 4161 m."""
    for height, is_noted in ((55.0, False), (4160.0, False), (4163.0, True)):
        points = [[0, [0, 0, 0], []], [900, [0, 0, height], []], [1800, [0, 0, height], []]]
        found = report(show_of(tmp_path / "a.skyc", {}, 0.0, d0=points))
        assert ("note range" in said(found)) is is_noted
        scale = storage_scale(read_show(tmp_path / "a.skyc").curves["d0"])
        assert (scale > MAX_SCALE) is is_noted


def test_several_paths_are_several_flights(tmp_path: Path, parts: Path) -> None:
    """Their reports follow each other, each as if it were linted alone."""
    for folder, drone in (("one", MOVING), ("two", JUMPING)):
        (tmp_path / folder).mkdir()
        polys(tmp_path / folder, drone)
    paths: list[Path | str] = [tmp_path / "one", str(parts), tmp_path / "two"]
    found = lint(paths)
    assert found == tuple(each for path in paths for each in lint(path))
    assert [each.path for each in found] == [
        *(tmp_path / "one", parts / "part1", parts / "part2", tmp_path / "two")
    ]
    with pytest.raises(FileError, match="nowhere"):
        lint([tmp_path / "one", tmp_path / "nowhere"])
    with pytest.raises(InputError, match="at least one path; name a file or a folder"):
        lint([])


OLDER_KEYS = {
    "max_altitude": ("maxAltitude", 8.9),
    "max_velocity_xy": ("maxVelocityXY", 4.9),
    "max_velocity_z": ("maxVelocityZ", 3.9),
    "max_velocity_z_up": ("maxVelocityZUp", 3.9),
    "min_distance": ("minDistance", 3.1),
}
"""Keys of older shows, those of today, and a limit that ``two_drones`` breaks."""


@pytest.mark.parametrize("older", OLDER_KEYS)
def test_limits_under_older_keys_are_those_of_today(older: str, tmp_path: Path) -> None:
    """Where a show has both, today's counts."""
    key, limit = OLDER_KEYS[older]
    usual = {"max_altitude": 10, "max_velocity_xy": 8, "max_velocity_z": 5, "min_distance": 2}

    def found(**validation: Any) -> list[str]:
        curves = read_show(two_drones(tmp_path / "a.skyc")).curves.items()
        points = {
            name: [[t, curve.at(t).tolist(), []] for t in (0.0, 2.0, 4.0)] for name, curve in curves
        }
        path = show_of(tmp_path / "b.skyc", usual | validation, 0.0, **points)
        return [f.rule for f in report(path).findings if f.level == "error"]

    assert found() == []
    assert found(**{older: limit}) == [key]
    assert found(**{older: limit, key: 2.0 if key == "minDistance" else 10.0}) == []
    settings = [
        str(f)
        for f in report(two_drones(tmp_path / "c.skyc", **{older: "x"})).findings
        if f.rule == "settings"
    ]
    assert len(settings) == (key == "maxVelocityZUp")  # the only one without today's key


@pytest.mark.parametrize("value", ["fast", -1, 0, 10**400, [], True, 4.5])
def test_limits_of_shows_that_are_none_or_overruled(value: object, tmp_path: Path) -> None:
    found = report(two_drones(tmp_path / "show.skyc", maxVelocityZUp=value, maxVelocityZ=1))
    if value == 4.5:  # upward alone, and d0 never descends
        assert found.sound
    else:
        assert "warning settings" in said(found)
        assert any("maxVelocityZUp" in f.message for f in found.findings)
    bare = report(two_drones(tmp_path / "bare.skyc"))
    (finding,) = (f for f in bare.findings if f.rule == "speed")  # no limit that anybody set
    assert finding.level == "warning"
    assert "5 m/s at t = 2 s is above 3 m/s, a default limit" in str(finding)
    assert "error speed" in said(report(tmp_path / "bare.skyc", Rules(speed=3.0)))


def localised(line: str) -> str:
    return line.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "file",
    ["crazyswarm2/d0.csv", "mavsdk_drone_show/Drone 2.csv", "csv/setpoints_enu.csv"],
)
def test_tables_of_other_locales_are_equal(file: str, exports: Path, tmp_path: Path) -> None:
    """Receivers of such files read commas alone, and their readers are told apart."""
    kind = file.partition("/")[0]
    shutil.copytree(exports / kind, tmp_path / kind)
    path = tmp_path / file
    before, lines = report(path), path.read_text().splitlines()
    for change, plain in (
        (lambda s: "\ufeff" + s, True),
        (lambda s: s.replace(",", ", ").replace("\n", "\r\n\r\n"), True),
        (localised, False),
        (lambda s: s.replace(",", "\t"), False),
    ):
        path.write_text(change("\n".join(lines)), encoding="utf-8")
        found = report(path)
        assert found.flight == before.flight
        assert ("error separator" in said(found)) is not (plain or kind == "csv")


@pytest.mark.parametrize(
    ("first", "fault"),
    [
        (["# {}"], False),
        ([""], False),
        (["# made by hand on a Monday"], False),
        (["a,b"], False),
        (["{}", "# for figure 8", ""], False),
        (["# made by hand", "{}"], True),
        (["", "{}"], True),
    ],
)
def test_polynomials_begin_after_one_line_of_whatever(
    first: list[str], fault: bool, tmp_path: Path
) -> None:
    polys(tmp_path, REST)
    path = tmp_path / "d0.csv"
    edit(path, rows(lambda s: [*(line.format(s[0]) for line in first), *s[1:]]))
    found = report(path)
    assert (found.kind, found.flight.duration) == ("crazyswarm2", 2.0)
    frame = "" if "frame" in path.read_text().splitlines()[0] else "note frame"
    assert said(found) == ", ".join(filter(None, ["error header" if fault else "", frame]))
    edit(path, rows(lambda s: s[-2:] + s[-1:]))
    assert report(path).facts[0].pieces == 2  # the first is skipped


@pytest.mark.parametrize(("unit", "is_told"), [(1.0, False), (1e-3, True), (3600.0, True)])
def test_times_in_other_units_than_seconds_are_told(unit: float, is_told: bool) -> None:
    """A flight of 20 s at 50 Hz, by its times since their start."""
    times = np.arange(0.0, 20.0, 0.02) / unit
    with pytest.raises(FileError, match="not seconds of a flight") if is_told else nullcontext():
        contents.check_times(times)


@pytest.mark.parametrize(
    ("columns", "factor", "start"),
    [
        *(
            (("x", "y", "z"), *times)
            for times in ((1e9, 1.7e18), (1e6, 0), (1e3, 0), (1 / 60, 0), (1 / 3600, 0))
        ),
        *((("x", "y", "z", "vx", "vy", "vz"), *times) for times in ((1e3, 1.7e12), (1 / 400, 0))),
    ],
)
def test_times_that_are_no_seconds(
    factor: float, start: float, columns: tuple[str, ...], tmp_path: Path
) -> None:
    t = np.arange(0.0, 8.0, 0.05)
    path = tmp_path / "flight.csv"

    def write(factor: float, start: float) -> None:
        lines = [f"t,drone,{','.join(columns)}"]
        for s in t.tolist():
            values = [math.sin(s), 2.0, 1.0, math.cos(s), 0.0, 0.0][: len(columns)]
            lines.append(f"{start + factor * s:.9f},a,{','.join(f'{v:.9f}' for v in values)}")
        path.write_text("\n".join(lines))

    write(factor, start)
    if len(columns) == 3 and start == 0 and 0.01 < factor < 1e6:  # it may be slow, or fast
        assert report(path).flight.speed == pytest.approx(1.0 / factor, rel=1e-2)
        assert ("note times" in said(report(path))) is (factor > 1.0)
    else:
        with pytest.raises(
            FileError, match=r"not seconds of a flight|times are not in seconds|sound"
        ):
            lint(path)
    write(1.0, 1.7e9)  # seconds of 1970
    assert "warning start" in said(report(path))
    assert report(path).flight.speed == pytest.approx(1.0, rel=1e-2)


@pytest.mark.parametrize(
    ("lowest", "kind"), [(None, "indoor"), (None, "outdoor"), (4.0, "indoor"), (-1.0, "outdoor")]
)
def test_distances_count_above_the_lowest_altitude(
    lowest: float | None, kind: str, tmp_path: Path
) -> None:
    """They climb one after the other, apart from each other the more the higher they are."""

    def climb(x: float, y: float, t: float) -> list[Any]:
        rise = [[0, [x, y, 0], []], [t, [x, y, 0], []], [t + 10, [3 * x, 3 * y, 10], []]]
        return [*rise, [30, [3 * x, 3 * y, 10 + t], []]]

    validation: dict[str, Any] = {"minDistance": 0.5, "maxVelocityXY": 8, "maxVelocityZ": 8}
    validation |= {} if lowest is None else {"minNavAltitude": lowest}
    path = show_of(
        tmp_path / "a.skyc", validation, 0.0, a=climb(0, 0, 1), b=climb(1, 0, 3), c=climb(1, 1, 9)
    )
    edit(path, lambda files: files["show.json"].update(environment={"type": kind}))
    found = report(path)
    (check,) = (own for own in found.flight.own if own.name == "minDistance")
    t = np.linspace(0.0, 30.0, 30001)
    places = np.stack([curve.at(t) for curve in read_show(path).curves.values()], axis=1)
    i, j = np.triu_indices(3, 1)
    apart = np.linalg.norm(places[:, i] - places[:, j], axis=-1)
    least = lowest if lowest is not None else 2.5 if kind == "outdoor" else -math.inf
    counted = (places[..., 2] > least)[:, i] & (places[..., 2] > least)[:, j]
    assert check.worst == pytest.approx(np.min(apart[counted]), abs=0.02)
    told = [f.message for f in found.findings if f.rule == "minDistance"]
    assert told == (
        [] if least == -math.inf else [f"applies where both drones are above {least:g} m"]
    )


def test_parts_of_one_drone_are_distinguished_from_a_fleet(tmp_path: Path) -> None:
    """Their names count up: 10 comes after 9."""
    parts = [([1.0, 1.0], [[0.1 * k, 0.05], [0.1 * k + 0.05, 0.05]]) for k in range(10)]
    for i, part in enumerate(parts, 1):
        polys(tmp_path, part)
        (tmp_path / "d0.csv").rename(tmp_path / f"part{i}.csv")
    found = report(tmp_path)
    assert said(found) == "error separation, note sequence"
    assert "part1, part2, part3, … each begin where" in "".join(f.message for f in found.findings)
    (tmp_path / "part4.csv").unlink()
    assert "sequence" not in said(report(tmp_path))


def test_files_that_are_not_as_exported(exports: Path, tmp_path: Path) -> None:
    """Two exchanged ones, another place of a drone, and words in a note, which nobody flies."""
    folder = Path(shutil.copytree(exports / "crazyswarm2", tmp_path / "a"))
    assert "changed" not in said(report(folder))
    edit(folder / "README.txt", lambda data: data + b"Mind the dog.")
    assert report(folder).sound
    assert "note changed" in said(report(folder))
    (folder / "d0.csv").rename(folder / "d")
    (folder / "d1.csv").rename(folder / "d0.csv")
    (folder / "d").rename(folder / "d1.csv")
    found = [(f.rule, f.where) for f in report(folder).findings if f.level == "error"]
    assert {("changed", "d0.csv"), ("changed", "d1.csv"), ("start", "d0"), ("start", "d1")} == set(
        found
    )
    assert "error changed" in said(report(folder / "d0.csv"))
    assert "changed" not in said(report(folder / "d2.csv"))
    again = Path(shutil.copytree(exports / "crazyswarm2", tmp_path / "b"))
    fleet = again / "crazyflies.yaml"
    before = fleet.read_text()
    x, y = (float(v) for v in re.findall(r"initial_position: \[(\S+), (\S+),", before)[0])
    for place, level in (
        (f"[{x + 0.09}, {y}, 0.0]", ""),
        (f"[{x}, {y - 12.0}, 0.0]", "error start"),
    ):
        fleet.write_text(
            re.sub(r"initial_position: \[[^]]*\]", f"initial_position: {place}", before, count=1)
        )
        assert ("start" in said(report(again))) is bool(level)
    exported(swarm_plan(), "skybrush", tmp_path / "one.skyc")
    assert "changed" not in said(report(tmp_path / "one.skyc"))
    edit(tmp_path / "one.skyc", lambda f: f["show.json"]["meta"].clear())
    assert "error changed" in said(report(tmp_path / "one.skyc"))


MANIFEST_EDITS: dict[str, Any] = {
    "plan_digest": "0" * 64,
    "yaw_deg": 90.0,
    "duration": 3.5,
    "origin_enu": [0.1, 0.0, 0.0],
    "stretch": 2.0,
    "plan_span": [0.0, 1.0],
}


@pytest.mark.parametrize("key", MANIFEST_EDITS)
@pytest.mark.parametrize("name", ["crazyswarm2", "csv"])
def test_a_manifest_that_was_edited_is_an_error(
    name: str, key: str, exports: Path, tmp_path: Path
) -> None:
    """Whatever its layout: only values count."""
    folder = Path(shutil.copytree(exports / name, tmp_path / "a"))
    content = json.loads((folder / "export.json").read_text("utf-8"))
    (folder / "export.json").write_text(json.dumps(dict(reversed(content.items()))), "utf-8")
    assert report(folder).sound
    (folder / "export.json").write_text(json.dumps(content | {key: MANIFEST_EDITS[key]}), "utf-8")
    found = {(f.rule, f.where) for f in report(folder).findings if f.level == "error"}
    copies = {("changed", "exported_plan.npz")} if key == "plan_digest" else set()
    assert found == {("changed", "export.json"), *copies}


def test_the_plan_of_an_export_is_that_of_its_manifest(exports: Path, tmp_path: Path) -> None:
    """Also for one file of the folder; a single exported file has no plan beside it."""
    folder = Path(shutil.copytree(exports / "crazyswarm2", tmp_path / "a"))
    copy = folder / "exported_plan.npz"
    copy.write_bytes((exports / "csv" / "exported_plan.npz").read_bytes())
    assert report(folder).sound  # the same plan
    copy.write_bytes(copy.read_bytes() + b"\0")
    for path in (folder, folder / "d1.csv"):
        assert "error changed" in said(report(path))
    copy.unlink()
    for path in (folder, folder / "d1.csv"):
        assert "error missing" in said(report(path))
    exported(swarm_plan(), "csv", tmp_path / "one.csv")
    assert report(tmp_path / "one.csv").sound


def test_parts_share_the_plan_in_their_folder(parts: Path) -> None:
    assert all(found.sound for found in lint(parts))
    manifest = parts / "export.json"
    content = json.loads(manifest.read_text("utf-8"))
    manifest.write_text(json.dumps(content | {"duration": 1.0}), "utf-8")
    for found in lint(parts):
        assert {f.where for f in found.findings if f.level == "error"} == {"parts/export.json"}
    (parts / "exported_plan.npz").unlink()
    assert all("error missing" in said(found) for found in lint(parts))


def test_line_ends_of_windows_are_noted_alone(exports: Path, tmp_path: Path) -> None:
    """As Git and editors write them, in tables and all other texts."""
    for name in ("crazyswarm2", "csv", "skybrush", "compressed"):
        folder = Path(shutil.copytree(exports / name, tmp_path / name))
        before = report(folder)
        texts = [
            x for x in folder.iterdir() if x.suffix in {".csv", ".yaml", ".py", ".txt", ".json"}
        ]
        for path in texts:
            path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
        found = report(folder)
        assert (found.flight, found.sound) == (before.flight, before.sound)
        added = [f for f in found.findings if f not in before.findings]
        listed = json.loads((folder / "export.json").read_text("utf-8"))["files"]
        are_noted = any(path.name in listed for path in texts)
        assert [(f.level, f.rule) for f in added] == [("note", "line ends")] * are_noted


@pytest.mark.parametrize("number", ["NaN", "nan", "inf", "-inf"])
@pytest.mark.parametrize(("name", "column"), [("d1.csv", "y^3"), ("setpoints_enu.csv", "vy")])
def test_numbers_that_are_none_are_located(
    name: str, column: str, number: str, exports: Path, tmp_path: Path
) -> None:
    source = exports / ("crazyswarm2" if name == "d1.csv" else "csv") / name
    lines = source.read_text().splitlines()
    index = lines[0].split(",").index(column)
    cells = lines[3].split(",")
    cells[index] = number
    lines[3] = ",".join(cells)
    (tmp_path / name).write_text("\n".join(lines))
    with pytest.raises(FileError, match=rf"line 4, column {re.escape(column)}: not a number"):
        lint(tmp_path / name)


IDENTITIES: dict[str, tuple[tuple[str, str], ...]] = {
    "roles": (("role: d0", "role: x"), ("role: d1", "role: d0"), ("role: x", "role: d1")),
    "one role": (("role: d1", "role: d2"),),
    "addresses": (("E701", "E7FF"), ("E702", "E701"), ("E7FF", "E702")),
    "one address": (("E702", "E701"),),
    "other addresses": (("E701", "E7A1"), ("E702", "E7A2"), ("E703", "E7A3")),
}


@pytest.mark.parametrize("edits", IDENTITIES)
def test_robots_keep_their_trajectories(edits: str, exports: Path, tmp_path: Path) -> None:
    """Their radio addresses may become those of real drones."""
    folder = Path(shutil.copytree(exports / "crazyswarm2", tmp_path / "a"))
    fleet = folder / "crazyflies.yaml"
    text = fleet.read_text("utf-8")
    for old, new in IDENTITIES[edits]:
        assert old in text
        text = text.replace(old, new)
    fleet.write_text(text, "utf-8")
    assert said(report(folder)).count("error") == (edits != "other addresses")
    assert ("error identity" in said(report(folder))) is (edits != "other addresses")
