"""csv, parquet, npz, json: written, read back, and read by libraries of their own."""

from __future__ import annotations

import csv
import json
import shutil
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from exported_plans import exported, hitch_plan, swarm_of, swarm_plan, task_of
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.exports.formats.csv_table import read_csv, write_csv
from hitchopt.exports.formats.json_table import read_json, write_json
from hitchopt.exports.formats.long_table import COLUMNS, GROUPS, ROWS, blocks_of
from hitchopt.exports.formats.npz_table import read_npz, write_npz
from hitchopt.exports.formats.parquet_table import read_parquet, write_parquet
from hitchopt.exports.manifest import read_manifest
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import sample_times, states_at

Array = NDArray[np.float64]

NAMES = ("csv", "parquet", "npz", "json")

PLACE = {"frame": "ned", "origin": [2.0, -1.0, 0.5], "yaw": 0.4}


def table(name: str, folder: Path) -> tuple[Array, list[str], Array]:
    """t (S,), drones, values (S, D, C), by other means than the package's readers."""
    if name == "npz":
        with np.load(folder / "setpoints.npz") as arrays:
            assert str(arrays["frame"]) == "ned"
            parts = [arrays[group] for group in GROUPS]
            return arrays["t"], arrays["drones"].tolist(), np.concatenate(parts, axis=-1)
    if name == "json":
        content = json.loads((folder / "setpoints.json").read_text())
        assert content["frame"] == "ned"
        assert content["columns"] == list(COLUMNS)
        t = np.array([sample["t"] for sample in content["samples"]])
        values = np.array([sample["rows"] for sample in content["samples"]])
        return t, content["drones"], values
    if name == "parquet":
        arrow = pq.read_table(folder / "setpoints.parquet")
        assert arrow.schema.metadata[b"hitchopt.frame"] == b"ned"
        rows = arrow.to_pylist()
    else:
        with (folder / "setpoints_ned.csv").open() as file:
            rows = list(csv.DictReader(file))
    t = np.array(sorted({float(row["t"]) for row in rows}))
    drones = list(dict.fromkeys(row["drone"] for row in rows))
    values = np.array([[float(row[c]) for c in COLUMNS] for row in rows])
    return t, drones, values.reshape(len(t), len(drones), -1)


@pytest.mark.parametrize("name", NAMES)
def test_what_other_libraries_read_is_the_plan(name: str, tmp_path: Path) -> None:
    motion = hitch_plan()
    (part,) = exported(motion, name, tmp_path / "out", rate=40.0, **PLACE)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst < 1e-6
    t, drones, values = table(name, part.folder)
    assert drones == list(motion.team.drone_names)
    expected = sample_times(motion.duration, 40.0)
    np.testing.assert_allclose(t, expected, rtol=1e-11)
    states = states_at(motion, expected)
    c, s = np.cos(0.4), np.sin(0.4)

    def ned(v: Array) -> Array:
        """Turned by the yaw, then (y, x, -z)."""
        east, north = c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]
        return np.stack([north, east, -v[..., 2]], axis=-1)

    def column(first: str) -> Array:
        i = COLUMNS.index(first)
        return np.asarray(values[..., i : i + 3])

    place = ned(states.positions) + np.array([-1.0, 2.0, -0.5])
    np.testing.assert_allclose(column("x"), place, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(column("vx"), ned(states.velocities), atol=1e-9)
    np.testing.assert_allclose(column("ax"), ned(states.accelerations), atol=1e-8)
    np.testing.assert_allclose(column("jx"), ned(states.jerks), atol=1e-7)
    np.testing.assert_allclose(column("cable_x"), ned(states.cable_forces), atol=1e-9)
    np.testing.assert_allclose(values[..., COLUMNS.index("yaw")], np.pi / 2 - 0.4, rtol=1e-10)
    # The feed-forward: m (a_ff + g up) is the thrust, with up = -z here.
    thrust = motion.team.mass[:, None] * (column("ff_x") - np.array([0.0, 0.0, GRAVITY]))
    np.testing.assert_allclose(thrust, ned(states.thrusts(motion.team)), atol=1e-8)
    # Attitudes from forward, right, down to north, east, down: of the plan's axes, turned by the
    # yaw, then exchanged; so are the rates.
    first = COLUMNS.index("qw")
    found = Rotation.from_quat(values[..., first : first + 4].reshape(-1, 4), scalar_first=True)
    planned = Rotation.from_quat(states.quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
    expected = np.stack([ned(planned[..., i]) for i in range(3)], axis=-1) * [1.0, -1.0, -1.0]
    np.testing.assert_allclose(found.as_matrix(), expected, atol=1e-9)
    rates = states.body_rates * [1.0, -1.0, -1.0]
    np.testing.assert_allclose(column("rate_x"), rates, atol=1e-8)
    assert np.max(np.abs(rates)) > 0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_swarm_feels_no_cable(name: str, tmp_path: Path) -> None:
    exported(swarm_plan(), name, tmp_path, rate=20.0, frame="ned")
    _, _, values = table(name, tmp_path)
    own, forward = COLUMNS.index("ax"), COLUMNS.index("ff_x")
    np.testing.assert_array_equal(values[..., own : own + 3], values[..., forward : forward + 3])


WRITERS = {"csv": write_csv, "parquet": write_parquet, "npz": write_npz, "json": write_json}
READERS = {"csv": read_csv, "parquet": read_parquet, "npz": read_npz, "json": read_json}


def many_drones() -> Motion:
    side = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), axis=-1).reshape(-1, 2)
    start = np.concatenate([side, np.ones((1200, 1))], axis=-1)
    return swarm_of(np.stack([start, start + 0.1]), np.array([0.0, 1.4]))


@pytest.mark.slow
def test_nobody_holds_the_whole_table(tmp_path: Path) -> None:
    """1200 drones for 1400 samples: 255 MB of numbers."""
    task = task_of(many_drones(), "npz", 1000.0)
    path = tmp_path / "setpoints.npz"
    tracemalloc.start()
    try:
        write_npz(path, task)
        for window in read_npz(path).windows():
            assert window.shape == (1200, 3)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert path.stat().st_size > 250e6
    assert peak < 100e6


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_tables_are_read_in_windows(name: str, tmp_path: Path) -> None:
    task = task_of(many_drones(), name, 100.0)
    path = tmp_path / f"setpoints.{name}"
    assert max(block.values.size for block in blocks_of(task)) <= ROWS * len(COLUMNS)
    WRITERS[name](path, task)
    pieces = [window.pieces for window in READERS[name](path).windows()]
    assert sum(pieces) == 140
    assert max(pieces) <= 100


def test_row_groups_are_for_readers_that_work_by_groups(tmp_path: Path) -> None:
    """168,000 rows of two pieces in blocks of at most 100,000: one group, not one a block."""
    path = tmp_path / "setpoints.parquet"
    write_parquet(path, task_of(many_drones(), "parquet", 100.0))
    file = pq.ParquetFile(path)
    groups = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
    assert groups == [141 * 1200]
    write_parquet(path, task_of(many_drones(), "parquet", 500.0))
    file = pq.ParquetFile(path)
    groups = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
    assert sum(groups) == 701 * 1200
    assert all(100_000 <= rows <= 200_000 for rows in groups[:-1])
    assert all(rows % 1200 == 0 for rows in groups)


def test_few_samples_of_many_pieces_are_one_group(tmp_path: Path) -> None:
    exported(hitch_plan(), "parquet", tmp_path, **PLACE)
    file = pq.ParquetFile(tmp_path / "setpoints.parquet")
    assert file.num_row_groups == 1
    place = json.loads(file.schema_arrow.metadata[b"hitchopt.room"])
    assert place == {
        "frame": "ned",
        "origin_enu": [2.0, -1.0, 0.5],
        "yaw_deg": pytest.approx(np.degrees(0.4)),
    }


def test_csv_numbers_are_told_from_whole_ones(tmp_path: Path) -> None:
    """Readers such as polars take a column that begins with 0 for integers."""
    exported(swarm_plan(), "csv", tmp_path, rate=10.0)
    with (tmp_path / "setpoints_enu.csv").open() as file:
        for row in csv.DictReader(file):
            row.pop("drone")
            assert all("." in cell for cell in row.values())


def damaged(name: str, folder: Path, how: str) -> Path:
    exported(swarm_plan(), name, folder, rate=20.0)
    path = next(p for p in folder.iterdir() if p.name != "export.json")
    data = path.read_bytes()
    if how == "empty":
        path.write_bytes(b"")
    elif how == "text":
        path.write_text("these are no setpoints\n")
    else:
        path.write_bytes(data[: int(0.7 * len(data))])
    return path


@pytest.mark.parametrize("how", ["truncated", "empty", "text"])
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_reported(name: str, how: str, tmp_path: Path) -> None:
    path = damaged(name, tmp_path, how)
    with pytest.raises(FileError) as reported:
        for _ in READERS[name](path).windows():
            pass
    assert len(str(reported.value)) < 600


@pytest.mark.parametrize(
    ("edit", "reported"),
    [
        (lambda s: s.replace("t,drone,x", "t,drone,q"), "no column 'x'"),
        (lambda s: s.replace("d1", "d7", 1), "are not one per drone"),
        (
            lambda s: "\n".join([s.splitlines()[i] for i in (0, 4, 5, 6, 1, 2, 3)]),
            "go back from t = ",
        ),
        (lambda s: s.replace(",d2,", ",d2,nonsense", 1), "could not convert"),
        (lambda s: s.partition("\n")[0], "holds no rows"),
        (lambda s: s.partition("\n")[0] + "\nnan,d0" + ",0" * 26, "a time is nan or infinite"),
        (lambda s: s.replace("\n", "\n\n"), "a line is empty"),
    ],
)
def test_csv_of_others(edit: object, reported: str, tmp_path: Path) -> None:
    exported(swarm_plan(), "csv", tmp_path, rate=20.0)
    path = tmp_path / "setpoints_enu.csv"
    path.write_text(edit(path.read_text()))  # type: ignore[operator]
    with pytest.raises(FileError, match=reported):
        for _ in read_csv(path).windows():
            pass


def test_a_missing_library_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in [m for m in sys.modules if m.partition(".")[0] == "pyarrow"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UnsupportedError, match=r"pip install 'hitchopt\[export\]'"):
        exported(swarm_plan(), "parquet", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_manifest_says_frame_drones_errors_and_checks(tmp_path: Path) -> None:
    (part,) = exported(hitch_plan(), "csv", tmp_path, **PLACE)
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert (manifest["frame"], manifest["origin_enu"]) == ("ned", [2.0, -1.0, 0.5])
    assert manifest["yaw_deg"] == pytest.approx(np.degrees(0.4))
    assert manifest["drones"] == {name: name for name in hitch_plan().team.drone_names}
    assert manifest["position_error_m"]["worst"] == part.verdict.position.worst
    assert [c["name"] for c in manifest["checks"]] == [c.name for c in part.verdict.checks]
    assert all(c["holds"] for c in manifest["checks"])


def test_only_files_of_exports_are_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    exported(swarm_plan(), "csv", folder)
    (folder / "mine.txt").write_text("mine")
    exported(swarm_plan(), "npz", folder)
    assert sorted(p.name for p in folder.iterdir()) == ["export.json", "mine.txt", "setpoints.npz"]
    other = tmp_path / "other"
    other.mkdir()
    (other / "setpoints.npz").write_text("somebody's")
    with pytest.raises(FileError, match="not from an export"):
        exported(swarm_plan(), "npz", other)
    assert (other / "setpoints.npz").read_text() == "somebody's"
    shutil.rmtree(other)
