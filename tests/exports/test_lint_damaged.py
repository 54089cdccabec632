"""Damaged and hostile fleet files: a report or a FileError, in bounded time and memory."""

from __future__ import annotations

import json
import random
import re
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, swarm_plan

from hitchopt.errors import FileError
from hitchopt.exports import recording
from hitchopt.exports.formats.known_formats import HOMES
from hitchopt.exports.formats.skybrush_show import read_show
from hitchopt.exports.lint.linting import lint

ODD = (
    *(b"null", b"[null, null]", b"[]", b"{}", b'"a"', b"true", b"", b",", b"\n", b"\xff", b"\x00"),
    *(b"1" * 400, b"1" * 5000, b"1e400", b"-1e308", b"1e-320", b"nan", b"inf", b"[" * 5000),
    b'{"a":' * 2000,
)
"""What stands in place of a word or number."""


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


@pytest.mark.parametrize("name", list(HOMES))
def test_damaged_exports_are_reported_or_refused(name: str, tmp_path: Path) -> None:
    exported(swarm_plan(), name, tmp_path)
    originals = {path: path.read_bytes() for path in sorted(tmp_path.iterdir())}
    chance = random.Random(7)
    refused: list[str] = []
    for _ in range(10 if name == "ros2bag" else 40):
        path = chance.choice(list(originals))
        damage(path, chance)
        try:
            lint(tmp_path, relative=chance.random() < 0.3)
        except FileError as error:
            refused.append(str(error))
        path.write_bytes(originals[path])
    assert len(refused) > 3
    assert all(text.startswith(str(tmp_path)) for text in refused)


def show(path: Path, **changes: Any) -> Path:
    """Write a show of one drone, with other settings of the drone."""
    points = [[0, [0, 0, 1], []], [1, [0, 0, 1], []]]
    settings = {"name": "d0", "home": [0, 0, 0], "trajectory": {"points": points}, **changes}
    content = json.dumps({"version": 1, "swarm": {"drones": [{"settings": settings}]}})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("show.json", content)
    return path


@pytest.mark.parametrize("home", [None, [None, None], [10**400, 0], ["a", 0], [0], {}, [[0], 1], 3])
def test_homes_that_are_no_places(home: object, tmp_path: Path) -> None:
    (found,) = lint(show(tmp_path / "show.skyc", home=home))
    assert "start" in {finding.rule for finding in found.findings}


@pytest.mark.parametrize(
    "points",
    [
        [[0, [0, 0, 1], []], [10**400, [0, 0, 1], []]],
        [[0, [0, 0, 1], []], [1, [0, 0, 10**400], []]],
        [[0, [0, 0, 1], []], [1, [0, 0, 1e300], []]],
        [[0, [0, 0, 1], []], [1, [0, 0, 1], [[0, None, 0]]]],
        [[0, [0, 0, 1], []], [1, [0, 0, 1], 5]],
        {"0": 1},
    ],
)
def test_points_that_are_no_places(points: object, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"show\.skyc"):
        lint(show(tmp_path / "show.skyc", trajectory={"points": points}))


@pytest.mark.parametrize("name", ["skybrush", "json"])
def test_deep_nesting(name: str, tmp_path: Path) -> None:
    exported(swarm_plan(), name, tmp_path)
    deep = "[" * 100_000 + "]" * 100_000
    path = next(tmp_path / f for f in ("show.skyc", "setpoints.json") if (tmp_path / f).exists())
    if path.suffix == ".json":
        lines = path.read_text().splitlines()
        path.write_text("\n".join([lines[0], lines[1], f'{{"t": 0, "rows": {deep}}},', *lines[3:]]))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("show.json", deep)
    with pytest.raises(FileError, match="nested too deeply"):
        lint(path)


def shared(path: Path, member: str, drones: int = 300) -> Path:
    """Write a show whose drones all refer to one member."""
    refer = {"$ref": "./one.json#"}
    names = [{"settings": {"name": f"d{i}", "trajectory": refer}} for i in range(drones)]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("one.json", member)
        archive.writestr("show.json", json.dumps({"swarm": {"drones": names}}))
    return path


def test_a_small_show_that_unpacks_to_very_much(tmp_path: Path) -> None:
    path = shared(tmp_path / "show.skyc", '{"points": [' + " " * 100_000_000)
    assert path.stat().st_size < 120_000
    tracemalloc.start()
    with pytest.raises(FileError, match="would unpack to 1e"):
        lint(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6


def test_many_small_csv_files_that_unpack_to_very_much(tmp_path: Path) -> None:
    path = tmp_path / "show.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(8):
            archive.writestr(f"d{i}.csv", " " * 10_000_000)
    with pytest.raises(FileError, match="would unpack to 8e"):
        lint(path)


def test_a_member_that_all_refer_to_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [[k, [0, 0, 1], []] for k in range(100)]
    path = shared(tmp_path / "show.skyc", json.dumps({"points": points}))
    read: list[str] = []
    opened = zipfile.ZipFile.open

    def counted(self: zipfile.ZipFile, name: Any, *rest: Any, **more: Any) -> Any:
        read.append(getattr(name, "filename", name))
        return opened(self, name, *rest, **more)

    monkeypatch.setattr(zipfile.ZipFile, "open", counted)
    curves = read_show(path).curves
    assert len(curves) == 300
    assert sorted(read) == ["one.json", "show.json"]


def test_spans_are_bounded_in_sum_over_drones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [[k, [0, 0, 1], []] for k in range(100)]
    path = shared(tmp_path / "show.skyc", json.dumps({"points": points}))
    monkeypatch.setattr(recording, "MAX_SPANS", 99 * 300)
    assert lint(path)
    monkeypatch.setattr(recording, "MAX_SPANS", 99 * 300 - 1)
    with pytest.raises(FileError, match="300 drones with 99 spans"):
        lint(path)


def test_cubics_are_those_of_their_control_points(tmp_path: Path) -> None:
    """Lines, parabolas and cubics in one trajectory, made together by their kinds."""
    chance = np.random.default_rng(3)
    places = chance.normal(size=(7, 3)).tolist()
    inner = [chance.normal(size=(k % 3, 3)).tolist() for k in range(6)]
    points = [[0, places[0], []]] + [
        [k + 1, place, controls]
        for k, (place, controls) in enumerate(zip(places[1:], inner, strict=True))
    ]
    curve = read_show(show(tmp_path / "a.skyc", trajectory={"points": points})).curves["d0"]
    for k, controls in enumerate(inner):
        row = np.array([places[k], *controls, places[k + 1]])
        while len(row) > 1:  # de Casteljau at 0.3
            row = 0.7 * row[:-1] + 0.3 * row[1:]
        np.testing.assert_allclose(curve.at(k + 0.3), row[0], atol=1e-12)


def test_settings_with_numbers_beyond_all_bounds(tmp_path: Path) -> None:
    exported(swarm_plan(), "crazyswarm2", tmp_path)
    path = tmp_path / "crazyflies.yaml"
    place = f"initial_position: [{'9' * 400}, 0, 0]"
    path.write_text(re.sub(r"initial_position: \[[^]]*\]", place, path.read_text(), count=1))
    (found,) = lint(tmp_path)
    assert [(f.level, f.rule) for f in found.findings] == [("warning", "settings")]
