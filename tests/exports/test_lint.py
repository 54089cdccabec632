"""Every rule of the lint, on files that break it, ours changed or written by hand."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, long_plan, swarm_plan
from file_edits import Edit, content, points_of, rows, settings_of, show, write_show

from hitchopt.errors import FileError
from hitchopt.exports import recording
from hitchopt.exports.format import ERROR, NOTE, WARNING
from hitchopt.exports.formats.crazyswarm2 import write_poly_csv
from hitchopt.exports.formats.mavsdk import COLUMNS
from hitchopt.exports.lint import Report, Rules, lint
from hitchopt.hitch.requirements import Separation


def report(path: Path, rules: Rules | None = None, *, relative: bool = False) -> Report:
    (found,) = lint(path, rules, relative=relative)
    return found


def rules_of(found: Report, level: str) -> set[str]:
    return {finding.rule for finding in found.findings if finding.level == level}


def polys(folder: Path, *drones: tuple[list[float], list[list[float]]], frame: str = "enu") -> None:
    """Files d0.csv, …: durations, and per piece the powers of x; y tells the drones apart."""
    folder.mkdir(exist_ok=True)
    for i, (durations, pieces) in enumerate(drones):
        powers = np.zeros((len(durations), 4, 8))
        for k, piece in enumerate(pieces):
            powers[k, 0, : len(piece)] = piece
        powers[:, 1, 0], powers[:, 2, 0] = i, 1.0
        write_poly_csv(folder / f"d{i}.csv", np.array(durations), powers, frame)


@pytest.mark.slow
def test_a_cut_export_is_linted_part_by_part(tmp_path: Path) -> None:
    parts = exported(long_plan(), "crazyswarm2", tmp_path)
    found = lint(tmp_path)
    assert [r.path for r in found] == [part.folder for part in parts]
    assert all(r.sound for r in found)
    assert all(fact.size <= 4096 for r in found for fact in r.facts)


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
    "far away": ([FAR], Rules(), "note duration, note range, warning end"),
    "31 pieces": ([FULL], Rules(), "warning end"),
    "32 pieces and a jump": ([LONG], Rules(), "error jump, error memory, warning end"),
}
"""Drones' pieces, limits, and the rules that they break; 32 pieces as in a widely used example."""


@pytest.mark.parametrize("name", FLAWS)
def test_each_rule_is_broken_by_what_breaks_it(name: str, tmp_path: Path) -> None:
    drones, rules, expected = FLAWS[name]
    polys(tmp_path, *drones)
    found = report(tmp_path, rules)
    assert ", ".join(sorted({f"{f.level} {f.rule}" for f in found.findings})) == expected
    assert found.sound is ("error" not in expected)


def test_figures_and_places_of_what_is_found(tmp_path: Path) -> None:
    polys(tmp_path, LONG)
    found = report(tmp_path)
    assert (found.facts[0].pieces, found.facts[0].size) == (32, 4224)
    assert found.flight.jumps[0] == pytest.approx(0.35, rel=1e-5)
    (jump,) = (f for f in found.findings if f.rule == "jump" and f.level == ERROR)
    assert "0.35 m where pieces join at t = 1.6 s" in jump.message
    polys(tmp_path, MOVING)
    found = report(tmp_path)
    assert found.flight.speed == pytest.approx(1.3, rel=1e-3)
    assert found.flight.acceleration == pytest.approx(0.4, rel=1e-3)
    polys(tmp_path, REST, REST)
    found = report(tmp_path, NEAR)
    assert found.flight.separation == pytest.approx(1.0 / 1.2, rel=1e-3)


def test_jumps_between_windows_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    polys(tmp_path, ([1.0, 1.0, 1.0], [[0.0, 0.5], [0.8, 0.5], [1.3, 0.5]]))
    whole = report(tmp_path)
    monkeypatch.setattr(recording, "WINDOW", 1)
    found = report(tmp_path)
    assert found.flight.jumps == whole.flight.jumps
    assert found.flight.jumps[0] == pytest.approx(0.3)
    (jump,) = (f for f in found.findings if f.rule == "jump")
    assert "t = 1 s" in jump.message


def test_yaw_that_jumps_is_a_warning(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0, 1.0], [[0.0], [0.0], [0.0]]))
    assert report(tmp_path).sound
    assert rules_of(report(tmp_path), WARNING) == set()
    path = tmp_path / "d0.csv"
    header, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    column = len(cells[0]) - 8  # yaw^0
    cells[1][column], cells[2][column] = str(2.0 * math.pi), "0.5"  # a whole turn, then a jump
    path.write_text("\n".join([header, *(",".join(row) for row in cells)]) + "\n")
    found = report(tmp_path)
    assert rules_of(found, WARNING) == {"jump"}
    (finding,) = (f for f in found.findings if f.level == WARNING)
    assert "28.6°" in str(finding)
    assert "t = 2 s" in str(finding)


def test_relative_trajectories_cannot_be_judged_together(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0, 0.1], [0.1, 0.1]]))
    (tmp_path / "d1.csv").write_bytes((tmp_path / "d0.csv").read_bytes())
    found = report(tmp_path)
    assert found.sound
    assert rules_of(found, WARNING) == {"separation", "end"}


def test_a_missing_header_and_frames_that_differ(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0], [0.0]]), ([1.0, 1.0], [[0.0], [0.0]]))
    text = (tmp_path / "d0.csv").read_text()
    (tmp_path / "d1.csv").write_text(
        (tmp_path / "d1.csv").read_text().replace("frame: enu", "frame: nwu")
    )
    assert rules_of(report(tmp_path), ERROR) == {"frame"}
    (tmp_path / "d0.csv").write_text("\n".join([*text.splitlines()[1:], *text.splitlines()[1:]]))
    assert "header" in rules_of(report(tmp_path / "d0.csv"), ERROR)


def test_settings_that_contradict_the_trajectories(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    path = tmp_path / "crazyflies.yaml"
    text = path.read_text()
    line = next(line for line in text.splitlines() if "initial_position" in line)
    path.write_text(text.replace(line, "    initial_position: [9, 9, 0]", 1))
    found = report(tmp_path)
    assert rules_of(found, WARNING) == {"start"}
    assert "away from where its trajectory begins" in found.findings[0].message
    together = re.sub(r"initial_position: \[[^]]*\]", "initial_position: [9.0, 9.0, 0.0]", text)
    path.write_text(together)
    assert "start" in rules_of(report(tmp_path), ERROR)
    path.write_text(text.replace("  q0:", "  q9:", 1))
    messages = [str(finding) for finding in report(tmp_path).findings]
    assert messages == [
        "warning: settings: q0: has no entry in crazyflies.yaml",
        "warning: settings: q9: has no trajectory",
    ]


MEMORY = struct.pack("<4h", 100, 3000, 1000, 0) + 250 * struct.pack("<BH7h", 0b11, 10, *[100] * 7)
WIDE_AND_TURNED = struct.pack("<4hBHh", 32767, 0, 1000, 0, 0b01_00_00_00, 500, 900)
END = b"\x00\x00\x00"


EDITED: list[tuple[str, Edit, str]] = [
    ("crazyswarm2", lambda f: (f / "d1.csv").unlink(), "error missing d1.csv, warning settings d1"),
    ("compressed", content("d1_enu.bin", lambda data: data[:-3]), "error end marker d1"),
    ("compressed", content("d1_enu.bin", MEMORY + END), "error memory d1, warning duration d1"),
    (
        "compressed",
        content("d1_enu.bin", WIDE_AND_TURNED + END),
        "error range d1, warning duration d1, warning yaw d1",
    ),
    ("skybrush", show(lambda f: settings_of(f).update(home=[0.0, 0.0, 0.0])), "warning start d0"),
    (
        "skybrush",
        show(lambda f: points_of(f).insert(1, [1e-4, points_of(f)[0][1], []])),
        "error duration d0",
    ),
    ("mavsdk_drone_show", rows("*.csv", lambda s: s[:10] + s[25:]), "error rate"),
    ("mavsdk_drone_show", rows("* 2.csv", lambda s: s[:-5]), "warning duration Drone 2"),
]
"""What is done to an export, and what the lint finds then, of some rules."""


@pytest.mark.parametrize(("name", "edit", "expected"), EDITED)
def test_exports_that_were_edited(name: str, edit: Edit, expected: str, tmp_path: Path) -> None:
    exported(swarm_plan(), name, tmp_path)
    edit(tmp_path)
    found = {f"{f.level} {f.rule} {f.where}".strip() for f in report(tmp_path).findings}
    told = set(expected.split(", "))
    assert told <= found | {" ".join(each.split()[:2]) for each in found}, found
    if "error" not in expected or name == "compressed":
        assert {each for each in found if not each.startswith("note")} == told


def test_bags_that_are_too_slow_to_stream(tmp_path: Path) -> None:
    exported(swarm_plan(), "ros2bag", tmp_path / "slow", rate=25.0)
    assert rules_of(report(tmp_path / "slow"), WARNING) == {"rate"}
    exported(swarm_plan(), "ros2bag", tmp_path / "fast", rate=30.0)
    assert report(tmp_path / "fast").findings == ()


def test_time_that_begins_late_and_tables_without_a_frame(tmp_path: Path) -> None:
    exported(swarm_plan(), "csv", tmp_path, rate=20.0)
    header, *rows = (tmp_path / "setpoints_enu.csv").read_text().splitlines()
    late = [f"{float(row.partition(',')[0]) + 2.0:.9g},{row.partition(',')[2]}" for row in rows]
    (tmp_path / "table.csv").write_text("\n".join([header, *late]))
    found = report(tmp_path / "table.csv")
    assert rules_of(found, WARNING) == {"start"}
    assert rules_of(found, NOTE) == {"frame"}


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, "holds no file that ends in"),
        ({"a.csv": "x,y\n1,2\n"}, "is of no known format"),
        ({"a.csv": "duration,x\n1,2\n", "b.bin": ""}, "several kinds"),
        ({"a.csv": "duration,x\n1,2\n", "b.csv": "idx,t,px\n"}, "several kinds"),
        ({"a.csv": "t,drone,x\n", "b.csv": "t,drone,x\n"}, "2 files of the kind csv; name one"),
        ({"a.skyc": "", "b.skyc": ""}, "2 files of the kind skybrush; name one"),
        ({"plan.npz": ""}, "hitchopt check"),
        ({"metadata.yaml": "no bag"}, "is no bag"),
        ({"export.json": "{"}, "cannot be read"),
    ],
)
def test_unknown_files_are_refused_in_words(
    files: dict[str, str], told: str, tmp_path: Path
) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(FileError, match=told):
        lint(tmp_path)


def drone_show(folder: Path, *drones: Callable[[float], tuple[float, float, float]]) -> Report:
    """Shows of 60 s at 10 Hz, of north, east and altitude by time, as somebody else has them."""
    folder.mkdir()
    h = 1e-4
    for i, place in enumerate(drones, 1):
        rows = [COLUMNS]
        for k in range(601):
            t = 0.1 * k
            before, after = np.array(place(t - h)), np.array(place(t + h))
            p, v = (np.array(place(t)), (after - before) / (2.0 * h))
            signs = np.array([1.0, 1.0, -1.0])
            numbers = ",".join(f"{x:.6f}" for x in (*(p * signs), *(v * signs), 0.0, 0.0, 0.0, 0.0))
            rows.append(f"{k},{t:.1f},{numbers},70,255,255,255")
        (folder / f"Drone {i}.csv").write_text("\n".join(rows))
    return report(folder)


def smooth(t: float, start: float, end: float) -> float:
    x = min(max((t - start) / (end - start), 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def arch(top: float, across: float = 20.0) -> Callable[[float], tuple[float, float, float]]:
    """Up from the ground, 4 m east from a time on, and down."""
    return lambda t: (
        0.0,
        4.0 * smooth(t, across, across + 10.0),
        top * (smooth(t, 0.0, 15.0) - smooth(t, 42.0, 57.0)),
    )


def low_flight_home(t: float) -> tuple[float, float, float]:
    height = 12.0 * smooth(t, 0.0, 15.0) - 10.5 * smooth(t, 20.0, 30.0)
    return (4.0 * smooth(t, 40.0, 50.0), 0.0, height - 1.5 * smooth(t, 50.0, 60.0))


def beside(t: float) -> tuple[float, float, float]:
    return (3.0, *arch(12.0)(t)[1:])


def hovering(t: float) -> tuple[float, float, float]:
    return (0.0, 4.0 * smooth(t, 20.0, 30.0), 8.0)


@pytest.mark.parametrize(
    ("drones", "expected", "words"),
    [
        ((arch(12.0), beside), "", ""),
        ((arch(4.0), beside), "error climb", "flies none of its rows.* up to 4 m"),
        ((arch(12.0, 3.0),), "warning climb", "by a climb"),
        ((hovering,), "warning launch", "its first row is at 8 m"),
        ((low_flight_home,), "warning landing", "move it by 4 m across"),
    ],
    ids=["as it stands", "low", "moving", "in the air", "home"],
)
def test_rows_that_the_receiver_replaces(
    drones: Any, expected: str, words: str, tmp_path: Path
) -> None:
    found = drone_show(tmp_path / "show", *drones)
    assert ", ".join(f"{f.level} {f.rule}" for f in found.findings) == expected
    assert all(re.search(words, f.message) and f.where == "Drone 1" for f in found.findings)


def test_settings_that_do_not_fly_an_export(tmp_path: Path) -> None:
    """The manifest is taken at its word only as to what is set; what follows is computed."""
    exported(swarm_plan(), "mavsdk_drone_show", tmp_path)
    path = tmp_path / "export.json"
    content = json.loads(path.read_text())
    content["receiver"]["settings"]["INITIAL_CLIMB_ALTITUDE_THRESHOLD"] = 5.0
    path.write_text(json.dumps(content))
    assert rules_of(report(tmp_path), ERROR) == {"climb"}
    del content["receiver"]
    path.write_text(json.dumps(content))
    assert rules_of(report(tmp_path), ERROR) == {"climb"}
    content["receiver"] = {"settings": [1]}
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match="settings of the receiver are no map"):
        report(tmp_path)
    for value in ("5", True, float("nan")):
        content["receiver"] = {"settings": {"GROUND_ALTITUDE_THRESHOLD": value}}
        path.write_text(json.dumps(content))
        with pytest.raises(FileError, match="GROUND_ALTITUDE_THRESHOLD: is "):
            report(tmp_path)


def two_drones(path: Path, validation: dict[str, Any]) -> Path:
    """Write a show: d0 climbs at 4 m/s to 9 m and rests, d1 moves across at 5 m/s, 3 m from it."""
    routes: dict[str, list[list[Any]]] = {
        "d0": [[0, [0, 0, 1], []], [2, [0, 0, 9], []], [4, [0, 0, 9], []]],
        "d1": [[0, [0, 3, 1], []], [2, [10, 3, 1], []], [4, [10, 3, 1], []]],
    }
    drones = [
        {"settings": {"name": name, "home": points[0][1][:2], "trajectory": {"points": points}}}
        for name, points in routes.items()
    ]
    content = {"swarm": {"drones": drones}, "settings": {"validation": validation}}
    return write_show(path, {"show.json": content})


WIDE = {"maxAltitude": 10, "maxVelocityXY": 8, "maxVelocityZ": 5, "minDistance": 2}


def test_the_limits_of_a_show_are_its_own(tmp_path: Path) -> None:
    path = two_drones(tmp_path / "show.skyc", WIDE)
    assert rules_of(report(path), ERROR) == set()  # 5 m/s is beyond the usual 3
    assert rules_of(report(path, Rules(speed=3.0)), ERROR) == {"speed"}  # what is asked for holds
    upward = {**WIDE, "maxVelocityZ": 1, "maxVelocityZUp": 4.5}  # d0 never descends
    assert report(two_drones(tmp_path / "up.skyc", upward)).sound
    bare = two_drones(tmp_path / "bare.skyc", {})
    assert rules_of(report(bare), ERROR) == {"speed"}


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
    assert report(two_drones(tmp_path / "a.skyc", {**WIDE, key: held})).sound
    found = report(two_drones(tmp_path / "b.skyc", {**WIDE, key: broken}))
    (finding,) = (f for f in found.findings if f.level == ERROR)
    assert (finding.rule, finding.where) == (key, where)
    remedies = {"maxAltitude": "fly lower", "minDistance": "move them apart"}
    assert finding.message.endswith(remedies.get(key, "fly it more slowly"))


@pytest.mark.parametrize("value", ["fast", -1, 0, 10**400, [], True])
def test_limits_that_are_no_numbers_are_named(value: object, tmp_path: Path) -> None:
    found = report(two_drones(tmp_path / "show.skyc", {**WIDE, "maxVelocityZUp": value}))
    assert rules_of(found, WARNING) >= {"settings"}
    assert any("maxVelocityZUp" in f.message for f in found.findings)


def settled(folder: Path, offsets: dict[str, float]) -> None:
    """Export, all trajectories moved to one origin, the settings' places moved along x."""
    exported(swarm_plan(), "crazyswarm2", folder)
    rows = {path.stem: path.read_text().splitlines() for path in folder.glob("d*.csv")}
    text = (folder / "crazyflies.yaml").read_text()
    for name, lines in rows.items():
        cells = [line.split(",") for line in lines[1:]]
        for axis in (1, 9):
            first = float(cells[0][axis])
            for row in cells:
                row[axis] = f"{float(row[axis]) - first:.9g}"
        (folder / f"{name}.csv").write_text("\n".join([lines[0], *map(",".join, cells)]) + "\n")
        place = f"initial_position: [{offsets[name]}, 0.0, 0.0]"
        entry = re.compile(rf"({name}:.*?)initial_position: \[[^]]*\]", re.DOTALL)
        text = entry.sub(rf"\g<1>{place}", text, count=1)
    (folder / "crazyflies.yaml").write_text(text)


@pytest.mark.parametrize("window", [6, 20_000])
def test_relative_trajectories_are_flown_from_their_places(
    window: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a flight is looked at in several windows, of two pieces each."""
    monkeypatch.setattr(recording, "WINDOW", window)
    settled(tmp_path / "a", {"d0": 0.0, "d1": 2.0, "d2": 4.0})
    assert "start" in rules_of(report(tmp_path / "a"), WARNING)
    found = report(tmp_path / "a", relative=True)
    assert found.sound
    assert rules_of(found, WARNING) == set()
    # d1 and d0 start 2 m apart: 0.24 m are a ratio of 1, and neither goes further than 0.5 m.
    assert 1.0 / 0.24 < found.flight.separation < 2.5 / 0.24
    settled(tmp_path / "b", {"d0": 0.0, "d1": 0.3, "d2": 4.0})
    assert rules_of(report(tmp_path / "b", relative=True), ERROR) == {"separation"}


def test_without_places_nothing_is_judged_together(tmp_path: Path) -> None:
    settled(tmp_path, {"d0": 0.0, "d1": 0.3, "d2": 4.0})
    (tmp_path / "crazyflies.yaml").unlink()
    (tmp_path / "export.json").unlink()
    found = report(tmp_path, relative=True)
    assert np.isnan(found.flight.separation)
    assert rules_of(found, WARNING) == {"separation"}
    assert any("no place is known" in f.message for f in found.findings)


def test_shows_relative_to_homes(tmp_path: Path) -> None:
    path = two_drones(tmp_path / "show.skyc", WIDE)
    show(lambda f: settings_of(f, 1).update(home=[0.0, 1.5]))(tmp_path)
    assert rules_of(report(path), WARNING) == {"start", "jump"}  # velocities jump here
    found = report(path, relative=True)
    assert rules_of(found, ERROR) == {"minDistance"}  # 1.5 m instead of 3
    assert rules_of(found, WARNING) == {"jump"}


def test_kinds_that_are_not_read_are_named(tmp_path: Path) -> None:
    exported(swarm_plan(), "compressed", tmp_path / "a")
    (tmp_path / "a" / "show.vviz").write_text("{}")
    found = report(tmp_path / "a")
    assert [f.message for f in found.findings] == ["1 of .vviz"]
    (tmp_path / "b").mkdir()
    for name in ("one.bag", "two.bag", "three.dae"):
        (tmp_path / "b" / name).write_text("")
    told = r"it holds 2 of \.bag, 1 of \.dae"
    with pytest.raises(FileError, match=told):
        lint(tmp_path / "b")
    with pytest.raises(FileError, match=r"is 1 of \.bag, no file of a known"):
        lint(tmp_path / "b" / "one.bag")
