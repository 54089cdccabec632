"""Every rule of the lint, on files that break it, ours changed or written by hand."""

from __future__ import annotations

import json
import math
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, long_plan, swarm_plan

from hitchopt.errors import FileError
from hitchopt.exports import recording
from hitchopt.exports.formats.crazyswarm2 import write_poly_csv
from hitchopt.exports.formats.known_formats import HOMES, format_of
from hitchopt.exports.formats.mavsdk_lead_in import SPEED
from hitchopt.exports.lint.findings import ERROR, NOTE, WARNING, Report
from hitchopt.exports.lint.joint_flight import Rules
from hitchopt.exports.lint.linting import lint
from hitchopt.requirements import Separation


def report(path: Path, rules: Rules | None = None) -> Report:
    (found,) = lint(path, rules)
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


@pytest.mark.parametrize("name", list(HOMES))
def test_our_exports_have_nothing_to_complain_of(name: str, tmp_path: Path) -> None:
    motion = hitch_plan()
    (part,) = exported(motion, name, tmp_path)
    found = report(tmp_path)
    assert found.sound
    lead = 0.0
    if name == "mavsdk_drone_show":  # which flies nothing of it by its own settings
        assert [(f.level, f.rule) for f in found.findings] == [(NOTE, "settings")]
        lead = json.loads((tmp_path / "export.json").read_text())["receiver"]["plan_begins_s"]
    else:
        assert found.findings == ()
    assert found.kind == name
    assert found.frame == format_of(name).frames[0]
    assert len(found.facts) == 6
    checks = {check.name: check.bound for check in part.verdict.checks}
    assert found.flight.separation == pytest.approx(checks["separation"], rel=2e-3)
    speed = max(checks["speed"], SPEED if lead else 0.0)
    assert found.flight.speed == pytest.approx(speed, rel=2e-3)
    assert found.flight.duration == pytest.approx(part.verdict.duration + lead)


def test_a_cut_export_is_linted_part_by_part(tmp_path: Path) -> None:
    parts = exported(long_plan(), "crazyswarm2", tmp_path)
    found = lint(tmp_path)
    assert [r.path for r in found] == [part.folder for part in parts]
    assert all(r.sound for r in found)
    assert all(fact.size <= 4096 for r in found for fact in r.facts)


def test_one_row(tmp_path: Path) -> None:
    polys(tmp_path / "a", ([2.0], [[0.0, 0.5]]))
    found = report(tmp_path / "a")
    assert rules_of(found, ERROR) == {"one row"}
    assert not found.sound
    polys(tmp_path / "b", ([1.0, 1.0], [[0.0, 0.5], [0.5, 0.5]]))
    assert report(tmp_path / "b").sound


def test_names_that_differ_by_their_ending_alone(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0], [0.0]]))
    (tmp_path / "d0.CSV").write_bytes((tmp_path / "d0.csv").read_bytes())
    assert [fact.name for fact in report(tmp_path).facts] == ["d0", "d0"]


def test_too_many_pieces_for_the_memory_and_a_jump(tmp_path: Path) -> None:
    """As the widely used example with its 32 pieces and a jump of 0.35 m."""
    pieces = [[0.02 * k, 0.2] for k in range(16)] + [[0.35 + 0.02 * k, 0.2] for k in range(16, 32)]
    polys(tmp_path, ([0.1] * 32, pieces))
    found = report(tmp_path)
    assert rules_of(found, ERROR) == {"memory", "jump"}
    assert (found.facts[0].pieces, found.facts[0].size) == (32, 4224)
    assert found.flight.jumps[0] == pytest.approx(0.35, rel=1e-5)
    (jump,) = (f for f in found.findings if f.rule == "jump" and f.level == ERROR)
    assert "0.35 m where pieces join at t = 1.6 s" in jump.message
    polys(tmp_path, ([0.1] * 31, [[0.02 * k, 0.2] for k in range(31)]))
    assert report(tmp_path).sound


def test_velocity_that_jumps_is_a_warning(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0, 0.5], [0.5, -0.5]]))
    found = report(tmp_path)
    assert found.sound
    assert rules_of(found, WARNING) == {"jump", "end"}  # and it ends at -0.5 m/s
    assert found.flight.jumps[1] == pytest.approx(1.0)


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


def test_limits(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0, 0.5, 0.2], [0.7, 0.9, 0.2]]))
    found = report(tmp_path)
    assert found.sound
    assert found.flight.speed == pytest.approx(1.3, rel=1e-3)
    assert found.flight.acceleration == pytest.approx(0.4, rel=1e-3)
    tight = report(tmp_path, Rules(speed=1.2, acceleration=0.3))
    assert rules_of(tight, ERROR) == {"speed", "acceleration"}


def test_separation_between_the_drones_of_a_folder(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0], [0.0]]), ([2.0, 0.5], [[0.0], [0.0]]))
    assert report(tmp_path).sound  # a metre apart
    found = report(tmp_path, Rules(separation=Separation(radius=0.6)))
    assert rules_of(found, ERROR) == {"separation"}
    assert found.flight.separation == pytest.approx(1.0 / 1.2, rel=1e-3)
    assert rules_of(found, WARNING) == {"duration"}  # 2 s and 2.5 s


def test_relative_trajectories_cannot_be_judged_together(tmp_path: Path) -> None:
    polys(tmp_path, ([1.0, 1.0], [[0.0, 0.1], [0.1, 0.1]]))
    (tmp_path / "d1.csv").write_bytes((tmp_path / "d0.csv").read_bytes())
    found = report(tmp_path)
    assert found.sound
    assert rules_of(found, WARNING) == {"separation", "end"}


def test_settings_of_drones_that_stand_too_close(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    assert "start" not in rules_of(report(tmp_path), ERROR)
    path = tmp_path / "crazyflies.yaml"
    place = "initial_position: [9.0, 9.0, 0.0]"
    path.write_text(re.sub(r"initial_position: \[[^]]*\]", place, path.read_text()))
    assert "start" in rules_of(report(tmp_path), ERROR)


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
    path.write_text(text.replace("  q0:", "  q9:", 1))
    messages = [str(finding) for finding in report(tmp_path).findings]
    assert messages == [
        "warning: settings: q0: has no entry in crazyflies.yaml",
        "warning: settings: q9: has no trajectory",
    ]


def test_a_file_that_is_gone(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    (tmp_path / "r1.csv").unlink()
    found = report(tmp_path)
    assert rules_of(found, ERROR) == {"missing"}
    assert [f.where for f in found.findings if f.level == ERROR] == ["r1.csv"]


def byte_file(folder: Path, edit: Callable[[bytes], bytes]) -> Report:
    exported(swarm_plan(), "compressed", folder)
    path = folder / "d1_enu.bin"
    path.write_bytes(edit(path.read_bytes()))
    return report(folder)


def test_a_missing_end_marker(tmp_path: Path) -> None:
    found = byte_file(tmp_path, lambda data: data[:-3])
    assert rules_of(found, ERROR) == {"end marker"}
    assert found.findings[0].where == "d1"


def test_too_many_bytes(tmp_path: Path) -> None:
    still = struct.pack("<BH7h", 0b11, 10, *[100] * 7)  # at x = 0.1 m, where d1 is not
    long = struct.pack("<4h", 100, 3000, 1000, 0) + 250 * still + b"\x00\x00\x00"
    found = byte_file(tmp_path, lambda _: long)
    assert rules_of(found, ERROR) == {"memory"}
    assert found.facts[1].size == 8 + 250 * 17 + 3
    assert "duration" in rules_of(found, WARNING)


def test_control_points_at_the_end_of_their_range_and_yaw(tmp_path: Path) -> None:
    data = struct.pack("<4h", 32767, 0, 1000, 0) + struct.pack("<BH", 0b01_00_00_00, 500)
    data += struct.pack("<h", 900) + b"\x00\x00\x00"
    found = byte_file(tmp_path, lambda _: data)
    assert "range" in rules_of(found, ERROR)
    assert "yaw" in rules_of(found, WARNING)


def test_far_away_polynomials_are_noted(tmp_path: Path) -> None:
    polys(tmp_path, ([70.0, 70.0], [[0.0, 0.3], [21.0, 0.3]]))
    found = report(tmp_path)
    assert found.sound
    assert rules_of(found, NOTE) == {"range", "duration"}


def show(folder: Path, edit: Callable[[dict[str, Any], list[Any]], object]) -> Report:
    exported(swarm_plan(), "skybrush", folder)
    path = folder / "show.skyc"
    with zipfile.ZipFile(path) as archive:
        files = {name: json.loads(archive.read(name)) for name in archive.namelist()}
    settings = files["show.json"]["swarm"]["drones"][0]["settings"]
    edit(settings, files["drones/d0/trajectory.json"]["points"])
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, json.dumps(content))
    return report(folder)


def test_shows_away_from_home_or_finer_than_a_millisecond(tmp_path: Path) -> None:
    found = show(tmp_path / "a", lambda settings, _: settings.update(home=[0.0, 0.0, 0.0]))
    assert rules_of(found, WARNING) == {"start"}

    def split(_: object, points: list[Any]) -> None:
        t, place, _controls = points[0]
        points.insert(1, [t + 1e-4, place, []])

    assert "duration" in rules_of(show(tmp_path / "b", split), ERROR)


def test_gaps_between_streamed_setpoints(tmp_path: Path) -> None:
    exported(swarm_plan(), "mavsdk_drone_show", tmp_path)
    for path in tmp_path.glob("*.csv"):
        lines = path.read_text().splitlines()
        path.write_text("\n".join(lines[:10] + lines[25:]))
    assert "rate" in rules_of(report(tmp_path), ERROR)


def test_bags_that_are_too_slow_to_stream(tmp_path: Path) -> None:
    exported(swarm_plan(), "ros2bag", tmp_path / "slow", rate=25.0)
    found = report(tmp_path / "slow")
    assert rules_of(found, WARNING) == {"rate"}
    exported(swarm_plan(), "ros2bag", tmp_path / "fast", rate=30.0)
    assert report(tmp_path / "fast").findings == ()


def test_setpoints_of_different_lengths(tmp_path: Path) -> None:
    exported(swarm_plan(), "mavsdk_drone_show", tmp_path)
    path = tmp_path / "Drone 2.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-5]))
    found = report(tmp_path)
    assert rules_of(found, WARNING) == {"duration"}
    assert [f.where for f in found.findings if f.level == WARNING] == ["Drone 2"]


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
        ({"a.csv": "t,drone,x\n", "b.csv": "t,drone,x\n"}, "2 files of the kind table; name one"),
        ({"a.skyc": "", "b.skyc": ""}, "2 files of the kind .skyc; name one"),
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


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="there is no such file or folder"):
        lint(tmp_path / "nowhere")
    (tmp_path / "a.txt").write_text("text")
    with pytest.raises(FileError, match="no file of a known format"):
        lint(tmp_path / "a.txt")
