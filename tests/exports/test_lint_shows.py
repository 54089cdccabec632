"""What lint takes from a show itself: its limits, its drones' places, what its samples hold."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, swarm_plan

from hitchopt.errors import FileError
from hitchopt.exports import recording
from hitchopt.exports.formats.mavsdk import COLUMNS
from hitchopt.exports.lint.findings import ERROR, NOTE, WARNING, Report
from hitchopt.exports.lint.joint_flight import Rules
from hitchopt.exports.lint.linting import lint


def report(path: Path, rules: Rules | None = None, *, relative: bool = False) -> Report:
    (found,) = lint(path, rules, relative=relative)
    return found


def rules_of(found: Report, level: str) -> set[str]:
    return {finding.rule for finding in found.findings if finding.level == level}


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
    show = {"swarm": {"drones": drones}, "settings": {"validation": validation}}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("show.json", json.dumps(show))
    return path


WIDE = {"maxAltitude": 10, "maxVelocityXY": 8, "maxVelocityZ": 5, "minDistance": 2}


def test_the_limits_of_a_show_are_its_own(tmp_path: Path) -> None:
    path = two_drones(tmp_path / "show.skyc", WIDE)
    assert rules_of(report(path), ERROR) == set()  # 5 m/s is beyond the usual 3
    assert rules_of(report(path, Rules(speed=3.0)), ERROR) == {"speed"}  # what is asked for holds
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


def test_upwards_its_own_limit_takes_precedence(tmp_path: Path) -> None:
    """D0 climbs at 4 m/s and never descends."""
    limits = {**WIDE, "maxVelocityZ": 1, "maxVelocityZUp": 4.5}
    assert report(two_drones(tmp_path / "show.skyc", limits)).sound


@pytest.mark.parametrize("value", ["fast", -1, 0, 10**400, [], True])
def test_limits_that_are_no_numbers_are_named(value: object, tmp_path: Path) -> None:
    found = report(two_drones(tmp_path / "show.skyc", {**WIDE, "maxVelocityZUp": value}))
    assert rules_of(found, WARNING) >= {"settings"}
    assert any("maxVelocityZUp" in f.message for f in found.findings)


def setpoints(folder: Path, columns: list[str], rates: bool) -> None:
    """Write a drone that moves at 1 m/s for 2 s, and what rates there are as zeros or numbers."""
    folder.mkdir()
    rows = [",".join(columns)]
    for k in range(21):
        row = dict.fromkeys(COLUMNS.split(","), "0")
        row |= {"idx": str(k), "t": f"{0.1 * k:.1f}", "px": f"{0.1 * k:.1f}", "pz": "-1"}
        row["vx"] = "1" if rates else "0"
        rows.append(",".join(row[name] for name in columns))
    (folder / "Drone 1.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("columns", [COLUMNS.split(","), COLUMNS.split(",")[:5]])
def test_positions_alone_are_joined_by_lines(columns: list[str], tmp_path: Path) -> None:
    setpoints(tmp_path / "a", columns, rates=False)
    found = report(tmp_path / "a")
    assert found.flight.speed == pytest.approx(1.0, rel=1e-6)  # 1.5 with a rest at every row
    assert np.isnan(found.flight.acceleration)
    assert "velocities" in rules_of(found, NOTE)
    assert "acceleration" not in rules_of(found, ERROR)


def test_velocities_that_are_told_are_used(tmp_path: Path) -> None:
    setpoints(tmp_path / "a", COLUMNS.split(","), rates=True)
    found = report(tmp_path / "a")
    assert found.flight.speed == pytest.approx(1.0, rel=1e-6)
    assert found.flight.acceleration == pytest.approx(0.0, abs=1e-6)
    assert "velocities" not in rules_of(found, NOTE)


@pytest.mark.parametrize("columns", [("vx", "vy", "vz"), ("ax", "ay", "az")])
def test_tables_without_rates(columns: tuple[str, ...], tmp_path: Path) -> None:
    exported(swarm_plan(), "csv", tmp_path, rate=100.0)
    path = tmp_path / "setpoints_enu.csv"
    whole = report(path)
    header, *rows = (line.split(",") for line in path.read_text().splitlines())
    kept = [i for i, name in enumerate(header) if name not in columns]
    path.write_text("\n".join(",".join(row[i] for i in kept) for row in (header, *rows)) + "\n")
    found = report(path)
    assert found.flight.speed == pytest.approx(whole.flight.speed, rel=0.01)
    missing = "velocities" if "vx" in columns else "accelerations"
    assert rules_of(found, NOTE) == {missing}


def repeated(path: Path, row: int) -> None:
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[: row + 1], *lines[row:]]) + "\n")


def test_repeated_times_are_named_as_that(tmp_path: Path) -> None:
    setpoints(tmp_path / "a", COLUMNS.split(","), rates=True)
    repeated(tmp_path / "a" / "Drone 1.csv", 5)
    with pytest.raises(FileError, match=r"repeats the time t = 0\.4 s"):
        report(tmp_path / "a")
    exported(swarm_plan(), "csv", tmp_path / "b", rate=10.0)
    path = tmp_path / "b" / "setpoints_enu.csv"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[:6], *rows[3:]]) + "\n")
    with pytest.raises(FileError, match=r"repeats the time t = 0\.1 s"):
        report(path)
    path.write_text("\n".join([header, *rows[:6], *rows[:3], *rows[6:]]) + "\n")
    with pytest.raises(FileError, match=r"go back from t = 0\.1 s to 0 s; sort its rows"):
        report(path)


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
    with zipfile.ZipFile(path) as archive:
        show = json.loads(archive.read("show.json"))
    show["swarm"]["drones"][1]["settings"]["home"] = [0.0, 1.5]
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("show.json", json.dumps(show))
    assert rules_of(report(path), WARNING) == {"start", "jump"}  # velocities jump here
    found = report(path, relative=True)
    assert rules_of(found, ERROR) == {"minDistance"}  # 1.5 m instead of 3
    assert rules_of(found, WARNING) == {"jump"}


def test_kinds_that_are_not_read_are_named(tmp_path: Path) -> None:
    exported(swarm_plan(), "compressed", tmp_path / "a")
    (tmp_path / "a" / "show.vviz").write_text("{}")
    found = report(tmp_path / "a")
    assert [f.message for f in found.findings] == ["1 of .vviz (a VVIZ show)"]
    (tmp_path / "b").mkdir()
    for name in ("one.bag", "two.bag", "three.dae"):
        (tmp_path / "b" / name).write_text("")
    told = r"it holds 2 of \.bag \(a ROS 1 bag\), 1 of \.dae"
    with pytest.raises(FileError, match=told):
        lint(tmp_path / "b")
    with pytest.raises(FileError, match=r"is 1 of \.bag \(a ROS 1 bag\), no file of a known"):
        lint(tmp_path / "b" / "one.bag")
