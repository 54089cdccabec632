"""Setpoints for PX4, read with csv and put into PX4's own law of thrust."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, swarm_of, swarm_plan, task_of
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError, InputError
from hitchopt.exports.formats import mavsdk
from hitchopt.exports.formats.mavsdk import COLUMNS, read_table, recording_of_tables
from hitchopt.exports.formats.mavsdk_lead_in import SPEED
from hitchopt.exports.formats.mavsdk_receiver import LATE, Receiver
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at

Array = NDArray[np.float64]


def ned(v: Array) -> Array:
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


def plan_begins(folder: Path) -> float:
    return float(json.loads((folder / "export.json").read_text())["receiver"]["plan_begins_s"])


MOTIONS = pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])

DEFAULTS: dict[str, Any] = {
    "INITIAL_CLIMB_ALTITUDE_THRESHOLD": 5.0,
    "INITIAL_CLIMB_TIME_THRESHOLD": 5.0,
    "GROUND_ALTITUDE_THRESHOLD": 1.0,
    "AUTO_GLOBAL_ORIGIN_MODE": True,
    "USE_GLOBAL_SETPOINTS": True,
    "FEEDFORWARD_VELOCITY_ENABLED": False,
    "FEEDFORWARD_ACCELERATION_ENABLED": False,
}


def flown(t: Array, places: Array, settings: Mapping[str, Any], late: float) -> dict[int, Array]:
    """A stand-in for one drone's player, row by row: the places (3,) that it sends, by row."""
    origin = np.zeros(3) if settings["AUTO_GLOBAL_ORIGIN_MODE"] else places[0]
    climbed: float | None = None
    sent = {}
    ends_high = -(places[-1] - origin)[2] > settings["GROUND_ALTITUDE_THRESHOLD"]
    for row, (at, place) in enumerate(zip(t, places - origin, strict=True)):
        if at < late:
            continue  # not armed yet, and the clock runs
        if climbed is None:
            under_alt = -place[2] < settings["INITIAL_CLIMB_ALTITUDE_THRESHOLD"]
            under_time = at - late < settings["INITIAL_CLIMB_TIME_THRESHOLD"]
            if under_alt or under_time:
                continue  # straight up at 1 m/s
            climbed = at
        shared = settings["AUTO_GLOBAL_ORIGIN_MODE"] and settings["USE_GLOBAL_SETPOINTS"]
        blending = shared and at < climbed + 3.0
        if not ends_high and (row + 1) / len(t) >= 0.5 and (t[-1] - at <= 1.0 or -place[2] < 2.0):
            break  # lands from here
        if not blending:
            sent[row] = place
    return sent


def shows() -> list[tuple[str, Array]]:
    """Places (S, 3), north-east-down, at 4 Hz."""
    t = np.arange(0.0, 60.0, 0.25)
    up = np.clip(t, 0.0, 12.0) - np.clip(t - 40.0, 0.0, 12.0)
    across = 0.3 * np.clip(t - 15.0, 0.0, 20.0)
    high = np.stack([across, -across, -up], axis=-1)
    return [
        ("up and down", high),
        ("never down", np.where(t[:, None] < 20.0, high, high[80])),
        ("low", high * [1.0, 1.0, 0.3]),
        ("from the air", high - [0.0, 0.0, 6.0]),
    ]


@pytest.mark.parametrize("late", [0.0, 4.0])
@pytest.mark.parametrize("origin", [True, False])
@pytest.mark.parametrize("world", [True, False])
@pytest.mark.parametrize(("climb", "ground"), [(5.0, 1.0), (-1.0, -1.0), (8.0, 4.0)])
def test_the_rules_are_the_player_s(
    late: float, origin: bool, world: bool, climb: float, ground: float
) -> None:
    settings = DEFAULTS | {
        "AUTO_GLOBAL_ORIGIN_MODE": origin,
        "USE_GLOBAL_SETPOINTS": world,
        "INITIAL_CLIMB_ALTITUDE_THRESHOLD": climb,
        "GROUND_ALTITUDE_THRESHOLD": ground,
    }
    t = np.arange(0.0, 60.0, 0.25)
    places = np.stack([place for _, place in shows()], axis=1)
    receiver = Receiver.of(settings)
    assert receiver.settings() == settings
    followed = receiver.followed(t, places, late)
    for i, (name, place) in enumerate(shows()):
        sent = flown(t, place, settings, late)
        assert np.flatnonzero(followed[:, i]).tolist() == list(sent), name
        lower = 0.0 if origin else float(-place[0, 2])
        assert receiver.lowered(places)[i] == pytest.approx(lower)


@MOTIONS
@pytest.mark.parametrize("late", [0.0, LATE])
def test_all_of_the_plan_is_flown_with_the_settings_that_are_stated(
    late: float, motion: Motion, tmp_path: Path
) -> None:
    """By its own settings the player sends no row of these plans."""
    exported(motion, "mavsdk_drone_show", tmp_path)
    stated = json.loads((tmp_path / "export.json").read_text())["receiver"]["settings"]
    assert set(stated) == set(DEFAULTS)
    assert stated["FEEDFORWARD_VELOCITY_ENABLED"] is True
    assert stated["FEEDFORWARD_ACCELERATION_ENABLED"] is True
    begin = plan_begins(tmp_path)
    for i in range(len(motion.team.drone_names)):
        table = read_table(tmp_path / f"Drone {i + 1}.csv")
        t, places = table[:, 0], table[:, 1:4]
        assert flown(t, places, DEFAULTS, late) == {}
        sent = flown(t, places, stated, late)
        rows = np.flatnonzero(t >= begin - 1e-9)
        assert set(rows) <= set(sent)
        # Launched on the ground below the first place, each counts from there.
        launched = np.array([*places[0, :2], 0.0])
        wanted = ned(motion.drones.at(np.minimum(t[rows] - begin, motion.duration))[:, i])
        found = launched + np.array([sent[row] for row in rows.tolist()])
        np.testing.assert_allclose(found, wanted, atol=1e-7)


@MOTIONS
def test_drones_rise_straight_up_from_the_ground(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "mavsdk_drone_show", tmp_path)
    begin = plan_begins(tmp_path)
    first = ned(states_at(motion, np.zeros(1)).positions[0])
    stated = json.loads((tmp_path / "export.json").read_text())["receiver"]
    apart = []
    for i in range(len(motion.team.drone_names)):
        table = read_table(tmp_path / f"Drone {i + 1}.csv")
        before = table[table[:, 0] < begin - 1e-9]
        np.testing.assert_allclose(before[:, 1:3], np.broadcast_to(first[i, :2], (len(before), 2)))
        assert before[0, 3] == 0.0
        waiting = before[before[:, 0] <= LATE + 3.0]
        assert np.all(waiting[:, 3:] == 0.0)  # no pull either: nobody leans on the ground
        np.testing.assert_allclose(before[-1, 3], first[i, 2], atol=1e-9)
        assert np.all(np.diff(before[:, 3]) <= 1e-12)
        assert np.max(np.abs(before[:, 6])) <= SPEED + 1e-9
        slopes = np.gradient(before[:, 3], before[:, 0])
        np.testing.assert_allclose(slopes, before[:, 6], atol=5e-3)
        # What is fed forward goes over into the plan's without a jump.
        at = len(before)
        np.testing.assert_allclose(table[at - 1, 7:], table[at, 7:], atol=1e-6)
        apart.append(before[:, 1:4])
    scaled = np.stack(apart, axis=1) * motion.requirements.separation.scale
    pairs = np.linalg.norm(scaled[:, :, None] - scaled[:, None], axis=-1)
    closest = np.min(pairs[:, *np.triu_indices(pairs.shape[1], 1)])
    assert stated["separation_before"] <= closest + 1e-9
    assert closest - stated["separation_before"] < 1e-3
    assert f"the plan begins {begin:g} s after the show" in part.notes[0]


def test_drones_above_one_another_cannot_take_off(tmp_path: Path) -> None:
    places = np.array([[[0.0, 0.0, 1.0], [0.1, 0.0, 2.0]], [[0.0, 0.0, 1.5], [0.1, 0.0, 2.5]]])
    stacked = swarm_of(places, np.array([0.0, 3.0]))
    with pytest.raises(InfeasibleError, match=r"separation: 0\.41.*while the drones rise straight"):
        exported(stacked, "mavsdk_drone_show", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_rows_that_would_not_be_flown_are_not_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(mavsdk, "receiver_for", lambda task: Receiver())  # noqa: ARG005
    with pytest.raises(FileError, match=r"Drone 1\.csv: mavsdk_drone_show does not fly its row"):
        exported(swarm_plan(), "mavsdk_drone_show", tmp_path / "out")
    assert not (tmp_path / "out" / "Drone 1.csv").exists()


def test_altitudes_that_are_counted_from_the_air_are_not_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without the rise from the ground every drone would fly lower by its first altitude."""

    def hovering(task: Any, lead: Any) -> Any:
        rise = replace(lead, ground=lead.ground.copy(), height=0.0 * lead.height)
        rise.ground[:, 2] += lead.height
        return real(task, rise)

    real = mavsdk.rows_of
    monkeypatch.setattr(mavsdk, "rows_of", hovering)
    with pytest.raises(InfeasibleError, match="position_error: 1"):
        exported(swarm_plan(), "mavsdk_drone_show", tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("INITIAL_CLIMB_TIME_THRESHOLD", "5"),
        ("INITIAL_CLIMB_TIME_THRESHOLD", True),
        ("GROUND_ALTITUDE_THRESHOLD", float("nan")),
        ("USE_GLOBAL_SETPOINTS", 1),
    ],
)
def test_settings_of_another_type_are_reported(name: str, value: object) -> None:
    with pytest.raises(FileError, match=name):
        Receiver.of({name: value})


@MOTIONS
def test_rows_are_the_plan_in_north_east_down(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "mavsdk_drone_show", tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst < 1e-4
    begin = plan_begins(tmp_path)
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
        assert 0.0 <= t[-1] - begin - motion.duration < 0.05
        assert all("." in row[key] for row in rows for key in COLUMNS.split(",")[1:12])
        (first,) = np.flatnonzero(np.abs(t - begin) < 1e-9)
        assert first > 0
        assert set(table["mode"]) == {70.0}
        assert set(table["yaw"]) == {90.0}  # along the plan's x axis, which is east
        table = {key: column[first:] for key, column in table.items()}
        states = states_at(motion, t[first:] - begin)
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
    t += plan_begins(tmp_path)
    np.testing.assert_allclose(window.at(t), expected, atol=2e-5)
    with pytest.raises(FileError, match="Drone 2: its times are not those of Drone 1"):
        recording_of_tables(names[:2], [tables[0], tables[1] * 1.1], task_of(motion))


def test_another_frame_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--frame = 'enu': must be one of ned"):
        exported(swarm_plan(), "mavsdk_drone_show", tmp_path, frame="enu")


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("", "no column 't'"),
        (COLUMNS.replace("vx", "wx"), "no column 'vx'"),
        (f"{COLUMNS}\n0,0\n", "truncated or damaged"),
        (f"{COLUMNS}\n{','.join(['0'] * 16)}\n", "has 1 rows"),
        (f"{COLUMNS}\n{','.join(['zero'] * 16)}\n", "could not convert"),
    ],
)
def test_damaged_files_are_reported(text: str, reported: str, tmp_path: Path) -> None:
    path = tmp_path / "Drone 1.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=reported):
        read_table(path)
