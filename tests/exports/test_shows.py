"""Shows: curves of Skybrush's server, coordinated returns, rows of mavsdk_drone_show."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hitchopt.errors import FileError, InfeasibleError, InputError
from hitchopt.exports.format import format_of
from hitchopt.exports.formats.mavsdk import ARMING_TIME, read_tables
from hitchopt.exports.formats.skybrush import read_show, storage_scale, stored_curve, write_show
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from tests.helpers.exported_plans import Array, exported, hitch_plan, swarm_of, swarm_plan, task_of
from tests.helpers.format_readers import as_stored


def files_of(folder: Path) -> dict[str, Any]:
    """What is in a show, by the names in its zip."""
    with zipfile.ZipFile(folder / "show.skyc") as archive:
        return {name: json.loads(archive.read(name)) for name in archive.namelist()}


def settings_of(files: dict[str, Any]) -> list[dict[str, Any]]:
    return [drone["settings"] for drone in files["show.json"]["swarm"]["drones"]]


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (40.0, -3.0, 0.0)], ids=["near", "far"])
def test_the_stored_curves_are_those_certified(
    away: tuple[float, float, float], tmp_path: Path
) -> None:
    """Rounded once more by the server nothing changes, and velocity jumps as declared."""
    (part,) = exported(hitch_plan(), "skybrush", tmp_path, origin=away)
    (declared,) = re.findall(r"jumps by up to ([0-9.e+]+) mm/s", part.notes[1])
    assert part.verdict.velocity.worst <= 0.04  # segments are long enough for millimetres
    jumps = []
    for file, content in files_of(tmp_path).items():
        if "points" in content:
            points, (lasting, pieces) = content["points"], as_stored(content["points"])
            times = np.cumsum([0, *lasting]) * 1e-3
            np.testing.assert_allclose(times, [point[0] for point in points], atol=1e-8)
            ends = [p[1] for p in points[1:]]
            np.testing.assert_allclose(pieces[:, 3], ends, rtol=0.0, atol=2e-6, err_msg=file)
            slopes = 3.0 * np.diff(pieces, axis=1) / (1e-3 * lasting[:, None, None])
            jumps.append(np.max(np.linalg.norm(slopes[1:, 0] - slopes[:-1, 2], axis=-1)))
    assert 1e3 * max(jumps) == pytest.approx(float(declared), rel=6e-3)


def test_millimetres_that_lie_below_themselves_are_not_cut_off(tmp_path: Path) -> None:
    """1.001 m times 1000 is 1000.99… in binary."""
    numbers = np.array([1001, -1003, 2002, 0, 1, 32766, -1023, 1005, 4011, -2006, 999, 1007])
    assert any(int(k / 1000 * 1000) != k for k in numbers.tolist())
    points = 1e-3 * np.broadcast_to(numbers.reshape(1, 1, 3, 4), (1, 3, 3, 4))
    path, shown = tmp_path / "show.skyc", PiecewisePolynomial(np.array([0.0, 0.7]), points)
    write_show(path, task_of(swarm_plan(), "skybrush"), shown, [None] * 3)
    _, pieces = as_stored(files_of(tmp_path)["drones/d0/trajectory.json"]["points"])
    assert np.array_equal(np.rint(1e3 * pieces[0]).T, numbers.reshape(3, 4))
    curve = stored_curve(read_show(path).curves["d0"])
    assert (storage_scale(curve), storage_scale(curve, 2e-3)) == (1, 2)
    np.testing.assert_allclose(curve.coefficients[0], points[0, 0], rtol=0.0, atol=1e-9)


def crossing() -> Motion:
    """Two drones that fly one over the other at half time, and a third one beside them."""
    there = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 2.0], [2.0, 1.0, 1.5]])
    back = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 2.0], [2.5, 1.0, 1.5]])
    return swarm_of(np.stack([there, back]), np.array([0.0, 8.0]))


def place(entry: dict[str, Any], landing: float, start: Array, t: float) -> Array:
    """Where a drone is t after the entry's time, as the receiver's lines have it; nwu."""
    goal = np.array(entry["target"]) if entry["action"] == "goToKeepAlt" else start
    goal = np.array([*goal[:2], start[2]])
    lasts = entry["duration"] if entry["action"] == "goToKeepAlt" else 0
    share = np.clip((t - entry["preDelay"]) / max(lasts, 1e-9), 0.0, 1.0)
    here = start + share * (goal - start)
    here[2] -= landing * max(0.0, t - entry["preDelay"] - lasts - entry["postDelay"])
    return np.asarray(np.maximum(here, [-np.inf, -np.inf, 0.0]))


@pytest.mark.slow
@pytest.mark.parametrize("made", [swarm_plan, crossing])
def test_returns_keep_drones_apart(made: Callable[[], Motion], tmp_path: Path) -> None:
    motion = made()
    exported(motion, "skybrush", tmp_path)
    plans = [drone["rthPlan"] for drone in settings_of(files_of(tmp_path))]
    times = [[entry["time"] for entry in plan["entries"]] for plan in plans]
    assert all(each == times[0] for each in times)
    assert times[0] == sorted(set(times[0]))
    assert times[0][-1] >= motion.duration
    scale, landing = motion.requirements.separation.scale, plans[0]["landingSpeed"]
    for entries in zip(*(plan["entries"] for plan in plans), strict=True):
        east = motion.drones.at(min(entries[0]["time"], motion.duration))
        starts = np.stack([east[:, 1], -east[:, 0], east[:, 2]], axis=-1)
        flown = np.array(
            [
                [place(e, landing, s, t) for e, s in zip(entries, starts, strict=True)]
                for t in np.linspace(0.0, 60.0, 3001)
            ]
        )
        i, j = np.triu_indices(len(entries), 1)
        assert np.min(np.linalg.norm((flown[:, i] - flown[:, j]) * scale, axis=-1)) >= 1.0
        assert np.all(flown[-1, :, 2] == 0.0)
        steps = np.linalg.norm(np.diff(flown, axis=0), axis=-1) / 0.02
        assert np.max(steps) <= motion.requirements.limits.speed


def test_returns_are_read_back_and_certified(tmp_path: Path) -> None:
    """Another target in the file than was planned is found."""
    motion = swarm_plan()
    exported(motion, "skybrush", tmp_path)
    kind, task = format_of("skybrush"), task_of(motion, "skybrush")
    kind.read(tmp_path, task)

    def together(drones: list[dict[str, Any]]) -> None:
        for drone in drones:
            entry = drone["rthPlan"]["entries"][1]
            entry |= {"action": "goToKeepAlt", "target": [0.0, 0.0, 1.0], "duration": 9}

    damages: list[tuple[Any, type[Exception], str]] = [
        (together, InfeasibleError, "in the return from t = 1 s"),
        (lambda drones: drones[0]["rthPlan"]["entries"].pop(), FileError, "with an rthPlan"),
        (lambda drones: drones[0].pop("rthPlan"), FileError, "with an rthPlan"),
    ]
    for damage, error, words in damages:
        files = files_of(tmp_path)
        damage(settings_of(files))
        (tmp_path / "damaged").mkdir(exist_ok=True)
        with zipfile.ZipFile(tmp_path / "damaged" / "show.skyc", "w") as archive:
            for name, data in files.items():
                archive.writestr(name, json.dumps(data))
        with pytest.raises(error, match=words):
            kind.read(tmp_path / "damaged", task)


DEFAULTS: dict[str, Any] = {
    "INITIAL_CLIMB_ALTITUDE_THRESHOLD": 5.0,
    "INITIAL_CLIMB_TIME_THRESHOLD": 5.0,
    "GROUND_ALTITUDE_THRESHOLD": 1.0,
    "AUTO_GLOBAL_ORIGIN_MODE": True,
    "USE_GLOBAL_SETPOINTS": True,
    "FEEDFORWARD_VELOCITY_ENABLED": False,
    "FEEDFORWARD_ACCELERATION_ENABLED": False,
}


def played(t: Array, places: Array, settings: Mapping[str, Any], late: float) -> dict[int, Array]:
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
        if not ends_high and (row + 1) / len(t) >= 0.5 and (t[-1] - at <= 1.0 or -place[2] < 2.0):
            break  # lands from here
        if not (shared and at < climbed + 3.0):  # else on its line to the row
            sent[row] = place
    return sent


def ned(v: Array) -> Array:
    return np.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)


@pytest.mark.parametrize("made", [hitch_plan, swarm_plan])
def test_drones_rise_from_the_ground_and_all_of_the_plan_is_flown(
    made: Callable[[], Motion], tmp_path: Path
) -> None:
    """With the settings that are stated; by its own the player sends no row of these plans."""
    motion = made()
    (part,) = exported(motion, "mavsdk_drone_show", tmp_path)
    stated = json.loads((tmp_path / "export.json").read_text())["receiver"]
    begin, settings = stated["plan_begins_s"], stated["settings"]
    assert f"the plan starts {begin:g} s into the show" in part.notes[0]
    assert set(settings) == set(DEFAULTS)
    assert settings["FEEDFORWARD_VELOCITY_ENABLED"] is True
    assert settings["FEEDFORWARD_ACCELERATION_ENABLED"] is True
    first = ned(motion.drones.at(0.0))
    for i in range(len(motion.team.drone_names)):
        table = read_tables([tmp_path / f"Drone {i + 1}.csv"])[:, 0]
        t, places = table[:, 0], table[:, 1:4]
        rows = np.flatnonzero(t >= begin - 1e-9)
        # Launched on the ground below the first place, each counts from there.
        wanted = ned(motion.drones.at(np.minimum(t[rows] - begin, motion.duration))[:, i])
        for late in (0.0, ARMING_TIME):
            assert played(t, places, DEFAULTS, late) == {}
            sent = played(t, places, settings, late)
            assert set(rows) <= set(sent)
            found = [*places[0, :2], 0.0] + np.array([sent[row] for row in rows.tolist()])
            np.testing.assert_allclose(found, wanted, atol=1e-7)
        before = table[: rows[0]]
        np.testing.assert_allclose(before[:, 1:3], np.broadcast_to(first[i, :2], (len(before), 2)))
        assert before[0, 3] == 0.0
        waiting = before[before[:, 0] <= ARMING_TIME + 3.0]
        assert np.all(waiting[:, 3:] == 0.0)  # no pull either: nobody leans on the ground
        np.testing.assert_allclose(before[-1, 3], first[i, 2], atol=1e-9)
        assert np.all(np.diff(before[:, 3]) <= 1e-12)
        assert np.max(np.abs(before[:, 6])) <= 0.5 + 1e-9
        np.testing.assert_allclose(np.gradient(before[:, 3], before[:, 0]), before[:, 6], atol=5e-3)
        # What is fed forward goes over into the plan's without a jump.
        np.testing.assert_allclose(before[-1, 7:], table[rows[0], 7:], atol=1e-6)


def test_drones_above_one_another_cannot_take_off(tmp_path: Path) -> None:
    places = np.array([[[0.0, 0.0, 1.0], [0.1, 0.0, 2.0]], [[0.0, 0.0, 1.5], [0.1, 0.0, 2.5]]])
    stacked = swarm_of(places, np.array([0.0, 3.0]))
    with pytest.raises(InfeasibleError, match=r"separation: 0\.41.*while the drones rise straight"):
        exported(stacked, "mavsdk_drone_show", tmp_path / "out")
    with pytest.raises(InputError, match="frame = 'enu': must be ned"):
        exported(swarm_plan(), "mavsdk_drone_show", tmp_path / "out", frame="enu")
    assert not (tmp_path / "out").exists()
