from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from handmade import made_motion, made_swarm

from hitchopt.errors import InputError
from hitchopt.exports import setpoints
from hitchopt.exports.setpoints import lines_of, write_setpoints
from hitchopt.exports.vertices import write_vertices
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.states import sample_times


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


RATE = 37.0


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_setpoints_rows_are_by_time_then_drone(motion: Motion, tmp_path: Path) -> None:
    write_setpoints(tmp_path / "s.csv", motion, RATE)
    lines = (tmp_path / "s.csv").read_text().split("\n")
    assert lines[0] == "t,drone,x,y,z,vx,vy,vz,ax,ay,az,jx,jy,jz,yaw,cable_x,cable_y,cable_z"
    assert lines[-1] == ""
    rows = rows_of(tmp_path / "s.csv")
    times = sample_times(motion.duration, RATE)
    names = ["q0", "r0", "q1", "r1", "q2", "r2", "q3", "r3"]
    assert [row["drone"] for row in rows] == names * len(times)
    t = np.array([float(row["t"]) for row in rows])
    np.testing.assert_allclose(t, np.repeat(times, 8), atol=1e-11, rtol=1e-11)
    assert {row["yaw"] for row in rows} == {"0.0"}


def test_numbers_are_told_from_whole_ones(motion: Motion, tmp_path: Path) -> None:
    """A reader that takes a column for integers by its first rows fails on the first fraction."""
    write_setpoints(tmp_path / "s.csv", motion, RATE)
    write_vertices(tmp_path / "v.csv", motion, RATE)
    for name, label in (("s.csv", "drone"), ("v.csv", "vertex")):
        rows = rows_of(tmp_path / name)
        for column in rows[0]:
            if column != label:
                cells = {row[column] for row in rows} - {""}
                assert all("." in cell for cell in cells), column
                assert all(np.isfinite(float(cell)) for cell in cells), column


def test_zeros_are_short_and_percent_signs_are_themselves() -> None:
    values = np.array(
        [[[0.0, 0.0, 1.0], [0.0, 2.0, 0.0]], [[0.5, 0.0, 1.0 / 3.0], [0.5, 0.0, 0.0]]]
    )
    assert lines_of(("a%d", "b"), values).splitlines() == [
        "0.00000000000,a%d,0.0,1.00000000000",
        "0.00000000000,b,2.00000000000,0.0",
        "0.500000000000,a%d,0.0,0.333333333333",
        "0.500000000000,b,0.00000000000,0.0",
    ]


def test_setpoints_are_the_polynomials_values(motion: Motion, tmp_path: Path) -> None:
    write_setpoints(tmp_path / "s.csv", motion, RATE)
    rows = rows_of(tmp_path / "s.csv")
    times = sample_times(motion.duration, RATE)
    for order, columns in enumerate(("x y z", "vx vy vz", "ax ay az", "jx jy jz")):
        table = np.array([[float(row[c]) for c in columns.split()] for row in rows])
        expected = motion.drones.at(times, order).reshape(-1, 3)
        np.testing.assert_allclose(table, expected, atol=1e-8, rtol=1e-9)


def test_cable_forces_pull_toward_the_vertex(motion: Motion, tmp_path: Path) -> None:
    write_setpoints(tmp_path / "s.csv", motion, RATE)
    rows = [row for row in rows_of(tmp_path / "s.csv") if row["drone"] == "r2"]
    times = sample_times(motion.duration, RATE)
    leg = motion.drones.at(times)[:, 5] - motion.vertices.at(times)[:, 3]  # r2 hangs on p_3
    length, half = np.linalg.norm(leg, axis=1, keepdims=True), 0.5 * 9.81 * 0.004
    expected = -(0.47 + half * leg[:, 2:]) / length * leg - half * length * [0.0, 0.0, 1.0]
    table = np.array([[float(row[f"cable_{axis}"]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(table, expected, atol=1e-9)


def test_vertices_carry_their_cables_tension(motion: Motion, tmp_path: Path) -> None:
    write_vertices(tmp_path / "v.csv", motion, RATE)
    assert (tmp_path / "v.csv").read_text().split("\n")[0] == "t,vertex,x,y,z,tension"
    rows = rows_of(tmp_path / "v.csv")
    times = sample_times(motion.duration, RATE)
    assert [row["vertex"] for row in rows] == ["0", "1", "2", "3"] * len(times)
    table = np.array([[float(row[c]) for c in ("x", "y", "z")] for row in rows])
    expected = motion.vertices.at(times).reshape(-1, 3)
    np.testing.assert_allclose(table, expected, atol=1e-9)
    assert [float(row["tension"]) for row in rows[:4]] == [0.4, 0.55, 0.47, 0.5]


def test_numbers_have_nine_digits_and_no_negative_zero(motion: Motion, tmp_path: Path) -> None:
    write_setpoints(tmp_path / "s.csv", motion, 20.0)
    write_vertices(tmp_path / "v.csv", motion, 20.0)
    cells = [c for name in "sv" for row in rows_of(tmp_path / f"{name}.csv") for c in row.values()]
    assert "-0" not in cells
    assert "nan" not in cells
    digits = [len(c.split("e")[0].replace(".", "").lstrip("-0")) for c in cells]
    assert sum(d >= 9 for d in digits) > 0.4 * len(digits)  # rounding to fewer would leave none


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


def test_a_rate_of_zero_is_refused(motion: Motion, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="rate"):
        write_setpoints(tmp_path / "s.csv", motion, 0.0)
    assert not (tmp_path / "s.csv").exists()


def test_vertices_are_written_while_the_hitch_exists(motion: Motion, tmp_path: Path) -> None:
    first, second = motion.phases
    later = replace(motion, phases=(replace(first, state=CableState.FREE), second))
    write_vertices(tmp_path / "v.csv", later, RATE)
    write_vertices(tmp_path / "all.csv", motion, RATE)
    rows = [row for row in rows_of(tmp_path / "all.csv") if float(row["t"]) >= second.start]
    assert rows
    assert rows_of(tmp_path / "v.csv") == rows


def test_a_swarm_pulls_at_nothing(tmp_path: Path) -> None:
    swarm = made_swarm()
    write_setpoints(tmp_path / "s.csv", swarm, RATE)
    rows = rows_of(tmp_path / "s.csv")
    assert [row["drone"] for row in rows[:9]] == [*(f"d{i}" for i in range(8)), "d0"]
    assert {row[f"cable_{axis}"] for row in rows for axis in "xyz"} == {"0.0"}
    table = np.array([[float(row[c]) for c in ("x", "y", "z")] for row in rows])
    times = sample_times(swarm.duration, RATE)
    np.testing.assert_allclose(table, swarm.drones.at(times).reshape(-1, 3), atol=1e-9)
