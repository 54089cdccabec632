"""Setpoints for PX4, read with csv and put into PX4's own law of thrust."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, swarm_plan, task_of
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.export.formats.mavsdk import COLUMNS, read_table, recording_of_tables
from hitchopt.export.sampling import states_at
from hitchopt.hitch import GRAVITY
from hitchopt.model.motion import Motion

Array = NDArray[np.float64]


def ned(v: Array) -> Array:
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


@pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])
def test_rows_are_the_plan_in_north_east_down(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "mavsdk_drone_show", tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst < 1e-4
    drones = len(motion.team.drone_names)
    assert sorted(part.files) == sorted(f"Drone {i + 1}.csv" for i in range(drones))
    for i in range(drones):
        with (tmp_path / f"Drone {i + 1}.csv").open() as file:
            assert file.readline().strip() == COLUMNS
            file.seek(0)
            rows = list(csv.DictReader(file))
        table = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
        t = table["t"]
        assert np.array_equal(table["idx"], np.arange(len(rows)))
        np.testing.assert_allclose(t, np.arange(len(rows)) / 20.0, atol=1e-9)
        assert 0.0 <= t[-1] - motion.duration < 0.05
        assert set(table["mode"]) == {70.0}
        assert set(table["yaw"]) == {90.0}  # along the plan's x axis, which is east
        states = states_at(motion, t)
        place, speed, forward = (
            np.stack([table[f"{kind}{axis}"] for axis in "xyz"], axis=-1) for kind in "pva"
        )
        np.testing.assert_allclose(place, ned(states.positions[:, i]), atol=1e-7)
        np.testing.assert_allclose(speed, ned(states.velocities[:, i]), atol=1e-7)
        # PX4's thrust over mass is a setpoint less gravity, which points down.
        thrust = motion.team.mass[i] * (forward - np.array([0.0, 0.0, GRAVITY]))
        planned = ned(states.thrusts(motion.team)[:, i])
        np.testing.assert_allclose(thrust, planned, atol=1e-6)


def test_without_the_plan_nobody_knows_the_pull(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "mavsdk_drone_show", tmp_path)
    names = tuple(f"Drone {i + 1}" for i in range(6))
    tables = [read_table(tmp_path / f"{name}.csv") for name in names]
    without = recording_of_tables(names, tables, None)
    assert (without.smooth, without.frame) == (1, "ned")
    (window,) = without.windows()
    t = np.array([0.123, 1.02])
    expected = ned(motion.drones.at(t))
    np.testing.assert_allclose(window.at(t), expected, atol=2e-5)
    with pytest.raises(FileError, match="Drone 2: its times are not those of Drone 1"):
        recording_of_tables(names[:2], [tables[0], tables[1] * 1.1], task_of(motion))


def test_another_frame_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--frame = 'enu': must be one of ned"):
        exported(swarm_plan(), "mavsdk_drone_show", tmp_path, frame="enu")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no column 't'"),
        (COLUMNS.replace("vx", "wx"), "no column 'vx'"),
        (f"{COLUMNS}\n0,0\n", "truncated or damaged"),
        (f"{COLUMNS}\n{','.join(['0'] * 16)}\n", "has 1 rows"),
        (f"{COLUMNS}\n{','.join(['zero'] * 16)}\n", "could not convert"),
    ],
)
def test_damaged_files_are_told(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "Drone 1.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=told):
        read_table(path)
