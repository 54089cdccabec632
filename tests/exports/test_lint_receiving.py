"""What mavsdk_drone_show makes of its files: shows by hand, and ours with other settings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from exported_plans import exported, swarm_plan

from hitchopt.errors import FileError
from hitchopt.exports.formats.mavsdk import COLUMNS
from hitchopt.exports.lint.findings import ERROR, WARNING, Report
from hitchopt.exports.lint.linting import lint


def report(path: Path) -> Report:
    (found,) = lint(path)
    return found


def rules_of(found: Report, level: str) -> set[str]:
    return {finding.rule for finding in found.findings if finding.level == level}


def drone_show(folder: Path, *drones: Callable[[float], tuple[float, float, float]]) -> Report:
    """Shows of 60 s at 10 Hz, of north, east and altitude by time, as somebody else has them."""
    folder.mkdir()
    h = 1e-4
    for i, place in enumerate(drones, 1):
        rows = [COLUMNS]
        for k in range(601):
            t = 0.1 * k
            before, after = np.array(place(t - h)), np.array(place(t + h))
            p, v = (np.array(place(t)), (after - before) / (2.0 * h))
            signs = np.array([1.0, 1.0, -1.0])
            numbers = ",".join(f"{x:.6f}" for x in (*(p * signs), *(v * signs), 0.0, 0.0, 0.0, 0.0))
            rows.append(f"{k},{t:.1f},{numbers},70,255,255,255")
        (folder / f"Drone {i}.csv").write_text("\n".join(rows))
    return report(folder)


def smooth(t: float, start: float, end: float) -> float:
    x = min(max((t - start) / (end - start), 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def arch(top: float, across: float = 20.0) -> Callable[[float], tuple[float, float, float]]:
    """Up from the ground, 4 m east from a time on, and down."""
    return lambda t: (
        0.0,
        4.0 * smooth(t, across, across + 10.0),
        top * (smooth(t, 0.0, 15.0) - smooth(t, 42.0, 57.0)),
    )


def test_shows_that_a_receiver_flies_as_they_stand(tmp_path: Path) -> None:
    found = drone_show(tmp_path / "high", arch(12.0), lambda t: (3.0, *arch(12.0)(t)[1:]))
    assert found.findings == ()


def test_shows_below_the_altitude_at_which_the_climb_ends(tmp_path: Path) -> None:
    found = drone_show(tmp_path / "low", arch(4.0), lambda t: (3.0, *arch(12.0)(t)[1:]))
    assert rules_of(found, ERROR) == {"climb"}
    assert [f.where for f in found.findings] == ["Drone 1"]
    assert "flies none of its rows" in found.findings[0].message
    assert "up to 4 m" in found.findings[0].message


def test_shows_that_move_while_the_climb_replaces_them(tmp_path: Path) -> None:
    found = drone_show(tmp_path / "moving", arch(12.0, 3.0))
    assert [(f.level, f.rule) for f in found.findings] == [(WARNING, "climb")]
    assert "by a climb" in found.findings[0].message


def test_shows_that_begin_in_the_air(tmp_path: Path) -> None:
    found = drone_show(tmp_path / "air", lambda t: (0.0, 4.0 * smooth(t, 20.0, 30.0), 8.0))
    assert [(f.level, f.rule) for f in found.findings] == [(WARNING, "launch")]
    assert "its first row is at 8 m" in found.findings[0].message


def test_shows_that_a_landing_cuts_off(tmp_path: Path) -> None:
    def low_flight_home(t: float) -> tuple[float, float, float]:
        height = 12.0 * smooth(t, 0.0, 15.0) - 10.5 * smooth(t, 20.0, 30.0)
        return (4.0 * smooth(t, 40.0, 50.0), 0.0, height - 1.5 * smooth(t, 50.0, 60.0))

    found = drone_show(tmp_path / "home", low_flight_home)
    assert [(f.level, f.rule) for f in found.findings] == [(WARNING, "landing")]
    assert "move it by 4 m across" in found.findings[0].message


def test_settings_that_do_not_fly_an_export(tmp_path: Path) -> None:
    """The manifest is taken at its word only as to what is set; what follows is computed."""
    exported(swarm_plan(), "mavsdk_drone_show", tmp_path)
    path = tmp_path / "export.json"
    content = json.loads(path.read_text())
    content["receiver"]["settings"]["INITIAL_CLIMB_ALTITUDE_THRESHOLD"] = 5.0
    path.write_text(json.dumps(content))
    assert rules_of(report(tmp_path), ERROR) == {"climb"}
    del content["receiver"]
    path.write_text(json.dumps(content))
    assert rules_of(report(tmp_path), ERROR) == {"climb"}
    content["receiver"] = {"settings": [1]}
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match="settings of the receiver are no map"):
        report(tmp_path)
