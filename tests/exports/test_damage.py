"""Damaged and hostile fleet files: a report or a FileError, in bounded time and memory."""

from __future__ import annotations

import json
import random
import re
import shutil
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, swarm_plan
from file_edits import Edit, cell, content, points_of, rows, show, text, write_show
from rosbags.rosbag2 import Writer

from hitchopt.errors import FileError
from hitchopt.exports import recording
from hitchopt.exports.formats.mavsdk import COLUMNS
from hitchopt.exports.formats.ros2bag import message_types
from hitchopt.exports.formats.skybrush import read_show
from hitchopt.exports.formats.skybrush_csv import HEADER
from hitchopt.exports.lint import lint
from hitchopt.exports.options import HOMES

ODD = (
    *(b"null", b"[null, null]", b"[]", b"{}", b'"a"', b"true", b"", b",", b"\n", b"\xff", b"\x00"),
    *(b"1" * 400, b"1" * 5000, b"1e400", b"-1e308", b"1e-320", b"nan", b"inf", b"[" * 5000),
    b'{"a":' * 2000,
)
"""What stands in place of a word or number."""


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a swarm in every format, in a folder each."""
    home = tmp_path_factory.mktemp("exports")
    for name in HOMES:
        exported(swarm_plan(), name, home / name, rate=20.0 if name == "csv" else None)
    return home


def damaged(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data))
    match chance.randrange(6):
        case 0:
            return data[:at] + chance.randbytes(1) + data[at + 1 :]
        case 1:
            return data[:at]
        case 2:
            return data[:at] + data[at + chance.randrange(1, 200) :]
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
    members[name] = damaged(members[name], chance)
    with zipfile.ZipFile(path, "w") as archive:
        for member, data in members.items():
            archive.writestr(member, data)


@pytest.mark.parametrize("name", HOMES)
def test_any_damage_is_reported_or_refused(name: str, exports: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(exports / name, tmp_path / name))
    originals = {path: path.read_bytes() for path in sorted(folder.iterdir())}
    chance = random.Random(7)
    refused: list[str] = []
    for _ in range(10 if name == "ros2bag" else 40):
        path = chance.choice(list(originals))
        damage(path, chance)
        try:
            lint(folder, relative=chance.random() < 0.3)
        except FileError as error:
            refused.append(str(error))
        path.write_bytes(originals[path])
    assert len(refused) > 3
    assert all(text.startswith(str(folder)) for text in refused)
    stems = {"d0", "d0_enu", "Drone 1", "show", "setpoints", "setpoints_enu", "plan"}
    data = next(path for path in originals if path.stem in stems)
    for other in (b"", b"no such file\n", originals[data][: len(originals[data]) // 3]):
        data.write_bytes(other)
        with pytest.raises(FileError) as caught:
            lint(folder)
        assert len(str(caught.value)) < 800


def zipped(data: str) -> Edit:
    def edit(folder: Path) -> None:
        with zipfile.ZipFile(folder / "show.zip", "w") as archive:
            archive.writestr("d0.csv", data)

    return edit


def scene(old: str, new: str) -> Edit:
    """Exchange the first words of a .glb by others of the same length."""

    def edit(folder: Path) -> None:
        before = (folder / "plan.glb").read_bytes()
        at = before.index(old.encode(), before.index(b'"asset"'))
        after = before[:at] + new.encode() + before[at + len(old) :]
        (folder / "plan.glb").write_bytes(after[: len(before)])

    return edit


CSV, START, FIRST = "setpoints_enu.csv", bytes(8), "drones/d0/trajectory.json"
DAMAGE: dict[str, list[tuple[Edit, str]]] = {
    "crazyswarm2": [
        (rows("d0.csv", lambda s: s[:1]), "has 0 rows; 1 are the least"),
        (rows("d0.csv", lambda s: [*s, "1.0,2.0"]), "truncated or damaged"),
        (cell("d0.csv", 2, 3, "nan"), "beyond single precision"),
        (cell("d0.csv", 2, 3, "1e39"), "beyond single precision"),
        (cell("d0.csv", 2, 0, "0.0"), "row 2: its duration is 0 s"),
        (cell("d0.csv", 2, 3, "half"), "could not convert"),
    ],
    "compressed": [
        (content("d0_enu.bin", b""), "has 0 bytes"),
        (content("d0_enu.bin", START + b"\x00\x00\x00"), "no segment that lasts"),
        (content("d0_enu.bin", START + b"\x03\x10"), "within a segment's header, at byte 8"),
        (content("d0_enu.bin", START + b"\x03\x10\x00" + bytes(13)), "stops within segment 0"),
        (content("d0_enu.bin", bytes(70_000)), "far larger"),
    ],
    "skybrush": [
        (show(lambda f: f.pop("show.json")), "show.json"),
        (show(lambda f: f["show.json"].pop("swarm")), "KeyError"),
        (show(lambda f: f["show.json"]["swarm"]["drones"].clear()), "names no drones"),
        (show(lambda f: f.pop(FIRST)), FIRST),
        (show(lambda f: points_of(f).__delitem__(slice(1, None))), "has 1 points"),
        (show(lambda f: points_of(f).reverse()), "go back from t = "),
        (show(lambda f: points_of(f)[1].__setitem__(1, [0.0, 1.0])), "damaged|not"),
        (show(lambda f: points_of(f)[1].__setitem__(2, [[0, 0, 0]] * 3)), "cubic is the most"),
        (show(lambda f: points_of(f)[1].__setitem__(1, [0.0, 1.0, float("nan")])), "finite"),
        (show(lambda f: points_of(f)[1].__setitem__(0, 10**400)), "show.skyc"),
        (show(lambda f: points_of(f)[1].__setitem__(1, [0, 0, 1e300])), r"goes 1e\+300 m from"),
        (show(lambda f: points_of(f)[1].__setitem__(2, [[0, None, 0]])), "show.skyc"),
        (show(lambda f: points_of(f)[1].__setitem__(2, 5)), "show.skyc"),
        (show(lambda f: f[FIRST].update(points={"0": 1})), "has 0 points"),
        (content("show.skyc", b"PK\x03\x04" + bytes(200)), "is no Skybrush show"),
    ],
    "skybrush_csv": [
        (zipped("a,b,c\n1,2,3\n"), "its first line is 'a,b,c'"),
        (zipped(f"{HEADER}\n0,0,0,1,0,0,0\n"), "has 1 rows"),
        (zipped(f"{HEADER}\n0,0,0,1,0,0,0\n50,0,0\n"), "truncated"),
        (zipped(f"{HEADER}\n50,0,0,1,0,0,0\n0,0,0,1,0,0,0\n"), "go back from t = 0.05 s"),
        (zipped(f"{HEADER}\n50,0,0,1,0,0,0\n50,0,0,1,0,0,0\n"), "repeats the time t = 0.05 s"),
        (content("show.zip", b"PK\x03\x04" + bytes(200)), "no zip"),
    ],
    "mavsdk_drone_show": [
        (text("Drone 1.csv", "vx", "wx"), "no column 'vx'"),
        (rows("Drone 1.csv", lambda s: [*s[:-1], "0,0"]), "truncated or damaged"),
        (rows("Drone 1.csv", lambda s: s[:2]), "has 1 rows"),
        (cell("Drone 1.csv", 4, 3, "zero"), "could not convert"),
        (cell("Drone 2.csv", 4, 1, "0.123"), "its times are not those of Drone 1"),
    ],
    "ros2bag": [
        (lambda folder: (folder / "setpoints.mcap").unlink(), "is no bag, or a damaged one"),
        (content("setpoints.mcap", b"no bag"), "is no bag, or a damaged one"),
    ],
    "csv": [
        (text(CSV, "t,drone,x", "t,drone,q"), "no column 'x'"),
        (text(CSV, "d1", "d7"), "are not one per drone"),
        (rows(CSV, lambda s: [s[i] for i in (0, 4, 5, 6, 1, 2, 3)]), "go back from t = "),
        (rows(CSV, lambda s: [*s[:7], *s[4:]]), r"repeats the time t = 0\.05 s"),
        (rows(CSV, lambda s: s[:3]), "has fewer than two samples|ends within"),
        (rows(CSV, lambda s: s[:-1]), "ends within the sample"),
        (text(CSV, ",d2,", ",d2,nonsense"), "could not convert"),
        (rows(CSV, lambda s: s[:1]), "holds no rows"),
        (rows(CSV, lambda s: [s[0], "nan,d0" + ",0" * 26]), "a time is nan or infinite"),
        (rows(CSV, lambda s: [*s[:4], "", *s[4:]]), "a line is empty"),
    ],
    "gltf": [
        (content("plan.glb", b"glTF" + bytes(60)), "does not begin as a .glb does"),
        (scene('"d1"', '"d7"'), "'d7'"),
        (scene('"path": "translation"', '"path": "weights____"'), "KeyError"),
    ],
    "json": [
        (text("setpoints.json", "hitchopt-setpoints/1", "others/1"), "its format is not"),
        (text("setpoints.json", '"rows": [[', '"rows": [[], ['), "setpoints.json"),
        (text("setpoints.json", '"t": 0', '"t": ' + "[" * 100_000), "nested too deeply"),
    ],
}
"""What is done to an export, and what is said of it."""


@pytest.mark.parametrize(
    ("name", "edit", "words"),
    [(name, *each) for name, table in DAMAGE.items() for each in table],
    ids=[f"{name}-{i}" for name, table in DAMAGE.items() for i in range(len(table))],
)
def test_damage_is_named(name: str, edit: Edit, words: str, exports: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(exports / name, tmp_path / name))
    edit(folder)
    with pytest.raises(FileError, match=words):
        lint(folder)


def test_a_bag_of_other_messages_is_reported(tmp_path: Path) -> None:
    store = message_types()
    with Writer(tmp_path / "bag", version=9) as bag:
        topic = bag.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("hello")
        bag.write(topic, 0, store.serialize_cdr(message, "std_msgs/msg/String"))
    with pytest.raises(FileError, match=r"holds no trajectory_msgs.* but std_msgs/msg/String"):
        lint(tmp_path / "bag")


def show_file(path: Path, **changes: Any) -> Path:
    """Write a show of one drone, with other settings of the drone."""
    points = [[0, [0, 0, 1], []], [1, [0, 0, 1], []]]
    settings = {"name": "d0", "home": [0, 0, 0], "trajectory": {"points": points}, **changes}
    swarm = {"drones": [{"settings": settings}]}
    return write_show(path, {"show.json": {"version": 1, "swarm": swarm}})


@pytest.mark.parametrize("home", [None, [None, None], [10**400, 0], ["a", 0], [0], {}, [[0], 1], 3])
def test_homes_that_are_no_places(home: object, tmp_path: Path) -> None:
    (found,) = lint(show_file(tmp_path / "show.skyc", home=home))
    assert "start" in {finding.rule for finding in found.findings}


def shared(path: Path, member: str, drones: int = 300) -> Path:
    """Write a show whose drones all refer to one member."""
    refer = {"$ref": "./one.json#"}
    names = [{"settings": {"name": f"d{i}", "trajectory": refer}} for i in range(drones)]
    return write_show(path, {"one.json": member, "show.json": {"swarm": {"drones": names}}})


def test_spans_of_many_drones_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = [[k, [0, 0, 1], []] for k in range(100)]
    path = shared(tmp_path / "show.skyc", json.dumps({"points": points}))
    monkeypatch.setattr(recording, "MAX_SPANS", 99 * 300)
    assert lint(path)
    monkeypatch.setattr(recording, "MAX_SPANS", 99 * 300 - 1)
    with pytest.raises(FileError, match="300 drones with 99 spans"):
        lint(path)


def test_small_files_that_unpack_to_very_much(tmp_path: Path) -> None:
    bomb = shared(tmp_path / "show.skyc", '{"points": [' + " " * 100_000_000)
    assert bomb.stat().st_size < 120_000
    many = tmp_path / "show.zip"
    with zipfile.ZipFile(many, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(8):
            archive.writestr(f"d{i}.csv", " " * 10_000_000)
    for path, words in ((bomb, "would unpack to 1e"), (many, "would unpack to 8e")):
        tracemalloc.start()
        with pytest.raises(FileError, match=words):
            lint(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 5e6


def test_lines_parabolas_cubics_and_late_starts_are_read(tmp_path: Path) -> None:
    chance = np.random.default_rng(3)
    places = chance.normal(size=(7, 3)).tolist()
    inner = [chance.normal(size=(k % 3, 3)).tolist() for k in range(6)]
    points = [[0, places[0], []]] + [
        [k + 1, place, controls]
        for k, (place, controls) in enumerate(zip(places[1:], inner, strict=True))
    ]
    trajectory = {"takeoffTime": 3.0, "points": points}
    curve = read_show(show_file(tmp_path / "a.skyc", trajectory=trajectory)).curves["d0"]
    np.testing.assert_allclose(curve.at(1.7), places[0], atol=1e-12)
    for k, controls in enumerate(inner):
        row = np.array([places[k], *controls, places[k + 1]])
        while len(row) > 1:  # de Casteljau at 0.3
            row = 0.7 * row[:-1] + 0.3 * row[1:]
        np.testing.assert_allclose(curve.at(k + 3.3), row[0], atol=1e-12)


@pytest.mark.parametrize("columns", [COLUMNS.split(","), COLUMNS.split(",")[:5]])
def test_positions_alone_are_joined_by_lines(columns: list[str], tmp_path: Path) -> None:
    rows = [",".join(columns)]
    for k in range(21):
        row = dict.fromkeys(COLUMNS.split(","), "0")
        row |= {"idx": str(k), "t": f"{0.1 * k:.1f}", "px": f"{0.1 * k:.1f}", "pz": "-1"}
        rows.append(",".join(row[name] for name in columns))
    (tmp_path / "Drone 1.csv").write_text("\n".join(rows) + "\n")
    (found,) = lint(tmp_path)
    assert found.flight.speed == pytest.approx(1.0, rel=1e-6)  # 1.5 with a rest at every row
    assert np.isnan(found.flight.acceleration)
    assert "velocities" in {f.rule for f in found.findings if f.level == "note"}
    assert "acceleration" not in {f.rule for f in found.findings if f.level == "error"}


@pytest.mark.parametrize("columns", [("vx", "vy", "vz"), ("ax", "ay", "az")])
def test_tables_without_rates(columns: tuple[str, ...], exports: Path, tmp_path: Path) -> None:
    (whole,) = lint(exports / "csv")
    header, *rows = (line.split(",") for line in (exports / "csv" / CSV).read_text().splitlines())
    kept = [i for i, name in enumerate(header) if name not in columns]
    path = tmp_path / CSV
    path.write_text("\n".join(",".join(row[i] for i in kept) for row in (header, *rows)) + "\n")
    (found,) = lint(path)
    assert found.flight.speed == pytest.approx(whole.flight.speed, rel=0.01)
    missing = "velocities" if "vx" in columns else "accelerations"
    assert {f.rule for f in found.findings} == {missing}
