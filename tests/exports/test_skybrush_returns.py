"""Coordinated returns of a show: read with zipfile and json, flown here and measured."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, swarm_of, swarm_plan, task_of
from numpy.typing import NDArray

from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.returns import planned_returns
from hitchopt.motion.motion import Motion

Array = NDArray[np.float64]


def crossing() -> Motion:
    """Two drones that fly one over the other at half time, and a third one beside them."""
    there = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 2.0], [2.0, 1.0, 1.5]])
    back = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 2.0], [2.5, 1.0, 1.5]])
    return swarm_of(np.stack([there, back]), np.array([0.0, 8.0]))


def shown(folder: Path) -> list[dict[str, Any]]:
    with zipfile.ZipFile(folder / "show.skyc") as archive:
        drones = json.loads(archive.read("show.json"))["swarm"]["drones"]
    return [drone["settings"] for drone in drones]


def place(entry: dict[str, Any], landing: float, start: Array, t: float) -> Array:
    """Where a drone is t after the entry's time, as the receiver's lines have it; nwu."""
    goal = np.array(entry["target"]) if entry["action"] == "goToKeepAlt" else start
    goal = np.array([*goal[:2], start[2]])
    lasts = entry["duration"] if entry["action"] == "goToKeepAlt" else 0
    share = np.clip((t - entry["preDelay"]) / max(lasts, 1e-9), 0.0, 1.0)
    here = start + share * (goal - start)
    here[2] -= landing * max(0.0, t - entry["preDelay"] - lasts - entry["postDelay"])
    return np.asarray(np.maximum(here, [-np.inf, -np.inf, 0.0]))


@pytest.mark.parametrize("motion", [swarm_plan(), crossing()], ids=["swarm", "crossing"])
def test_returns_keep_drones_apart(motion: Motion, tmp_path: Path) -> None:
    exported(motion, "skybrush", tmp_path)
    drones = shown(tmp_path)
    plans = [drone["rthPlan"] for drone in drones]
    times = [[entry["time"] for entry in plan["entries"]] for plan in plans]
    assert all(each == times[0] for each in times)
    assert times[0] == sorted(set(times[0]))
    assert times[0][-1] >= motion.duration
    scale = motion.requirements.separation.scale
    for entries in zip(*(plan["entries"] for plan in plans), strict=True):
        at = min(entries[0]["time"], motion.duration)
        east = motion.drones.at(at)
        starts = np.stack([east[:, 1], -east[:, 0], east[:, 2]], axis=-1)
        landing = plans[0]["landingSpeed"]
        flown = np.array(
            [
                [place(e, landing, s, t) for e, s in zip(entries, starts, strict=True)]
                for t in np.linspace(0.0, 60.0, 3001)
            ]
        )
        i, j = np.triu_indices(len(entries), 1)
        apart = np.linalg.norm((flown[:, i] - flown[:, j]) * scale, axis=-1)
        assert np.min(apart) >= 1.0
        assert np.all(flown[-1, :, 2] == 0.0)
        steps = np.linalg.norm(np.diff(flown, axis=0), axis=-1) / 0.02
        assert np.max(steps) <= motion.requirements.limits.speed


def test_drones_one_over_the_other_do_not_land_on_each_other() -> None:
    motion = crossing()
    (middle,) = (each for each in planned_returns(motion) if each.time == 4.0)
    level = motion.drones.at(4.0)[:, :2]
    assert np.linalg.norm(level[0] - level[1]) < 1e-9
    assert np.linalg.norm(middle.targets[0] - middle.targets[1]) > 0.24


def test_a_hitch_has_no_returns(tmp_path: Path) -> None:
    exported(hitch_plan(), "skybrush", tmp_path)
    assert all("rthPlan" not in drone for drone in shown(tmp_path))


def changed(folder: Path, change: Any) -> None:
    path = folder / "show.skyc"
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    show = json.loads(files["show.json"])
    change([drone["settings"] for drone in show["swarm"]["drones"]])
    files["show.json"] = json.dumps(show).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def test_what_is_read_back_is_what_is_certified(tmp_path: Path) -> None:
    """Another target in the file than was planned is found."""
    motion = swarm_plan()
    exported(motion, "skybrush", tmp_path)
    kind, task = format_of("skybrush"), task_of(motion, "skybrush")
    kind.certify(tmp_path, task)

    def together(drones: list[dict[str, Any]]) -> None:
        for drone in drones:
            entry = drone["rthPlan"]["entries"][1]
            entry |= {"action": "goToKeepAlt", "target": [0.0, 0.0, 1.0], "duration": 9}

    changed(tmp_path, together)
    with pytest.raises(InfeasibleError, match="in the return from t = 1 s"):
        kind.certify(tmp_path, task)
    changed(tmp_path, lambda drones: drones[0]["rthPlan"]["entries"].pop())
    with pytest.raises(FileError, match="rthPlan is damaged"):
        kind.certify(tmp_path, task)
    changed(tmp_path, lambda drones: drones[0].pop("rthPlan"))
    with pytest.raises(FileError, match="rthPlan is damaged"):
        kind.certify(tmp_path, task)
