from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from handmade import made_motion

from hitchopt.exports import setpoints
from hitchopt.exports.setpoints import write_setpoints, write_vertices
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import sample_times
from hitchopt.values import Array


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


RATE = 37.0


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def numbers_of(rows: list[dict[str, str]], columns: str) -> Array:
    """Numbers, each with a point: readers take columns for integers by their first rows."""
    cells = [[row[name] for name in columns.split()] for row in rows]
    assert all("." in cell for row in cells for cell in row)
    return np.array(cells, dtype=np.float64)


def test_setpoints_are_the_plan_by_time_then_drone(motion: Motion, tmp_path: Path) -> None:
    write_setpoints(tmp_path / "s.csv", motion, RATE)
    lines = (tmp_path / "s.csv").read_text().split("\n")
    assert lines[0] == "t,drone,x,y,z,vx,vy,vz,ax,ay,az,jx,jy,jz,yaw,cable_x,cable_y,cable_z"
    assert lines[-1] == ""
    rows, times = rows_of(tmp_path / "s.csv"), sample_times(motion.duration, RATE)
    names = ["q0", "r0", "q1", "r1", "q2", "r2", "q3", "r3"]
    assert [row["drone"] for row in rows] == names * len(times)
    t = numbers_of(rows, "t")[:, 0]
    np.testing.assert_allclose(t, np.repeat(times, 8), atol=1e-11, rtol=1e-11)
    assert not np.any(numbers_of(rows, "yaw"))
    for order, columns in enumerate(("x y z", "vx vy vz", "ax ay az", "jx jy jz")):
        expected = motion.drones.at(times, order).reshape(-1, 3)
        np.testing.assert_allclose(numbers_of(rows, columns), expected, atol=1e-8, rtol=1e-9)
    leg = motion.drones.at(times)[:, 5] - motion.vertices.at(times)[:, 3]  # r2 hangs on p_3
    length, half = np.linalg.norm(leg, axis=1, keepdims=True), 0.5 * 9.81 * 0.004
    along = np.sqrt(0.47**2 - half**2 * np.sum(leg[:, :2] ** 2, axis=1, keepdims=True))
    expected = -(along + half * leg[:, 2:]) / length * leg - half * length * [0.0, 0.0, 1.0]
    forces = numbers_of(rows, "cable_x cable_y cable_z")
    assert np.all(np.isfinite(forces))
    np.testing.assert_allclose(forces[5::8], expected, atol=1e-9)


def test_vertices_carry_their_cables_tension(motion: Motion, tmp_path: Path) -> None:
    write_vertices(tmp_path / "v.csv", motion, RATE)
    assert (tmp_path / "v.csv").read_text().split("\n")[0] == "t,vertex,x,y,z,tension"
    rows, times = rows_of(tmp_path / "v.csv"), sample_times(motion.duration, RATE)
    assert [row["vertex"] for row in rows] == ["0", "1", "2", "3"] * len(times)
    expected = motion.vertices.at(times).reshape(-1, 3)
    np.testing.assert_allclose(numbers_of(rows, "x y z"), expected, atol=1e-9)
    tensions = numbers_of(rows, "tension")[:, 0]
    np.testing.assert_array_equal(tensions, np.tile([0.4, 0.55, 0.47, 0.5], len(times)))


def test_chunks_do_not_show(
    motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_setpoints(tmp_path / "whole.csv", motion, RATE)
    monkeypatch.setattr(setpoints, "ROWS", 1)
    done: list[float] = []
    write_setpoints(tmp_path / "chunks.csv", motion, RATE, done.append)
    whole, chunks = (tmp_path / "whole.csv").read_text(), (tmp_path / "chunks.csv").read_text()
    assert len(done) == len(sample_times(motion.duration, RATE))
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0.0, 1.0)
    a, b = (np.array([row.split(",")[2:] for row in s.split()[1:]], float) for s in (whole, chunks))
    np.testing.assert_allclose(a, b, atol=1e-9)


def test_vertices_are_written_while_the_hitch_exists(motion: Motion, tmp_path: Path) -> None:
    first, second = motion.phases
    later = replace(motion, phases=(replace(first, state=CableState.FREE), second))
    write_vertices(tmp_path / "v.csv", later, RATE)
    write_vertices(tmp_path / "all.csv", motion, RATE)
    rows = [row for row in rows_of(tmp_path / "all.csv") if float(row["t"]) >= second.start]
    assert rows
    assert rows_of(tmp_path / "v.csv") == rows
