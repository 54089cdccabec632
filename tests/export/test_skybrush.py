"""Shows for Skybrush, read with zipfile, json and the formula of a Bézier curve."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, hitch_plan, swarm_plan, task_of
from numpy.typing import NDArray

from hitchopt.certificate import Certificate
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.export.exporting import export_plan
from hitchopt.export.formats.registry import format_of
from hitchopt.export.formats.skybrush_csv import HEADER, lines_of, read_zip
from hitchopt.export.formats.skybrush_show import drones_of_show
from hitchopt.export.judging import flown_checks
from hitchopt.export.sampling import states_at
from hitchopt.hitch import Limits, Separation, Swarm
from hitchopt.model.motion import Flying, Phase
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

MOTIONS = pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])


def nwu(places: Array) -> Array:
    return np.stack([places[..., 1], -places[..., 0], places[..., 2]], axis=-1)


def bezier(points: Any, t: float) -> Array:
    """The curve of a show's trajectory at t."""
    for before, here in pairwise(points):
        if t <= here[0]:
            x = (t - before[0]) / (here[0] - before[0])
            a, (b, c), d = (np.array(p) for p in (before[1], here[2], here[1]))
            curve = (1 - x) ** 3 * a + 3 * (1 - x) ** 2 * x * b + 3 * (1 - x) * x**2 * c + x**3 * d
            return np.asarray(curve)
    return np.array(points[-1][1])


@MOTIONS
def test_a_show_is_the_plan(motion: Flying, tmp_path: Path) -> None:
    (part,) = exported(motion, "skybrush", tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst <= 2e-3
    t = np.linspace(0.0, motion.duration, 120)
    places = nwu(states_at(motion, t).positions)
    with zipfile.ZipFile(tmp_path / "show.skyc") as archive:
        show = json.loads(archive.read("show.json"))
        assert (show["version"], show["meta"]["frame"]) == (1, "nwu")
        assert show["settings"]["validation"]["maxVelocityXY"] == motion.limits.speed
        for i, drone in enumerate(show["swarm"]["drones"]):
            settings = drone["settings"]
            assert (drone["type"], settings["name"]) == ("generic", motion.team.drone_names[i])
            name = settings["trajectory"]["$ref"].removeprefix("./").removesuffix("#")
            trajectory = json.loads(archive.read(name))
            points = trajectory["points"]
            assert points[0][2] == []
            assert all(len(point[2]) == 2 for point in points[1:])
            times = [point[0] for point in points]
            assert all(abs(1e3 * at - round(1e3 * at)) < 1e-6 for at in times)
            assert settings["home"] == points[0][1]
            assert settings["landAt"] == points[-1][1]
            found = np.array([bezier(points, float(at)) for at in t])
            apart = np.max(np.linalg.norm(found - places[:, i], axis=-1))
            assert apart <= part.verdict.position.worst + 1e-9


def test_a_tight_limit_takes_more_points(tmp_path: Path) -> None:
    swarm = swarm_plan()
    (usual,) = exported(swarm, "skybrush", tmp_path / "usual")
    planned = np.radians(flown_checks(swarm)["tilt"].worst)
    tight = replace(swarm, limits=replace(swarm.limits, tilt=planned * 1.05))
    (part,) = exported(tight, "skybrush", tmp_path / "tight")
    points = [int(p.notes[0].split()[0]) for p in (usual, part)]
    assert points[1] > points[0]
    assert part.verdict.lost == ()


@MOTIONS
def test_a_zip_of_csv_is_the_plan(motion: Flying, tmp_path: Path) -> None:
    (part,) = exported(motion, "skybrush_csv", tmp_path)
    assert part.verdict.position.worst <= 2e-3
    with zipfile.ZipFile(tmp_path / "show.zip") as archive:
        assert archive.comment == b"frame: nwu"
        assert archive.namelist() == [f"{name}.csv" for name in motion.team.drone_names]
        for i, name in enumerate(archive.namelist()):
            header, *rows = archive.read(name).decode().splitlines()
            assert header == HEADER
            table = np.array([[float(x) for x in row.split(",")] for row in rows])
            t = table[:, 0] * 1e-3
            places = nwu(states_at(motion, t).positions[:, i])
            np.testing.assert_allclose(table[:, 1:4], places, atol=1e-6)
            assert np.all(np.diff(t) == pytest.approx(0.05))
            assert 0.0 <= t[-1] - motion.duration < 0.05


def test_csv_is_sampled_more_often_where_lines_lose_a_limit(tmp_path: Path) -> None:
    """Two drones on one circle, always opposite, at just their distance: lines cut corners."""
    angles = np.linspace(0.0, 4.0 * np.pi, 200)
    around = 0.1201 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=-1)
    slopes = np.gradient(around, angles, axis=0)
    t = 4.0 * angles / angles[-1]
    ends = np.stack([np.stack([s, -s], axis=1) for s in (around, slopes * np.pi)])
    ends[0] += [0.0, 0.0, 1.0]
    swarm = swarm_plan()
    pair = replace(
        swarm,
        team=Swarm(2),
        limits=Limits(speed=5.0, acceleration=1e3, jerk=1e6),
        separation=Separation(),
        drones=PiecewisePolynomial.hermite(t, ends[:, :-1], ends[:, 1:]),
        phases=(Phase("circle", 0, 0.0, 4.0),),
    )
    certificate = Certificate(4.0, tuple(flown_checks(pair).values()))
    kind = format_of("skybrush_csv")
    (part,) = export_plan(kind, task_of(pair, "skybrush_csv"), certificate, tmp_path)
    assert [note.split(":")[0] for note in part.notes] in (["at 40 Hz"], ["at 100 Hz"])
    asked = replace(task_of(pair, "skybrush_csv"), rate_given=True)
    with pytest.raises(InfeasibleError, match=r"separation: 0\.9"):
        export_plan(kind, asked, certificate, tmp_path / "out", suggest=False)


def edited(folder: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """A show whose first trajectory has been changed."""
    exported(swarm_plan(), "skybrush", folder)
    path = folder / "show.skyc"
    with zipfile.ZipFile(path) as archive:
        files = {name: json.loads(archive.read(name)) for name in archive.namelist()}
    edit(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, json.dumps(content))
    return path


FIRST = "drones/d0/trajectory.json"


def test_lines_parabolas_late_starts_and_inline_trajectories_are_read(tmp_path: Path) -> None:
    points = [[0, [0, 0, 1], []], [2, [2, 0, 1], []], [4, [4, 2, 1], [[4, 0, 1]]]]

    def edit(files: dict[str, Any]) -> None:
        inline = {"version": 1, "takeoffTime": 3.0, "points": points}
        files["show.json"]["swarm"]["drones"][0]["settings"]["trajectory"] = inline

    curve = drones_of_show(edited(tmp_path, edit))["d0"]
    np.testing.assert_allclose(curve.at([0.0, 3.0, 4.0]), [[0, 0, 1], [0, 0, 1], [1, 0, 1]])
    middle = 0.25 * np.array([2, 0, 1]) + 0.5 * np.array([4, 0, 1]) + 0.25 * np.array([4, 2, 1])
    np.testing.assert_allclose(curve.at(6.0), middle)


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda f: f.pop("show.json"), "show.json"),
        (lambda f: f["show.json"].pop("swarm"), "KeyError"),
        (lambda f: f["show.json"]["swarm"]["drones"].clear(), "names no drones"),
        (lambda f: f.pop(FIRST), FIRST),
        (lambda f: f[FIRST]["points"].__delitem__(slice(1, None)), "has 1 points"),
        (lambda f: f[FIRST]["points"].reverse(), "go back from t = "),
        (lambda f: f[FIRST]["points"][1].__setitem__(1, [0.0, 1.0]), "damaged|not"),
        (lambda f: f[FIRST]["points"][1].__setitem__(2, [[0, 0, 0]] * 3), "cubic is the most"),
        (lambda f: f[FIRST]["points"][1].__setitem__(1, [0.0, 1.0, float("nan")]), "finite"),
    ],
)
def test_damaged_shows_are_told(
    edit: Callable[[dict[str, Any]], object], told: str, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match=told):
        drones_of_show(edited(tmp_path, edit))


def test_a_truncated_zip_is_told(tmp_path: Path) -> None:
    exported(swarm_plan(), "skybrush", tmp_path)
    path = tmp_path / "show.skyc"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(FileError, match=r"show\.skyc: is no Skybrush show"):
        drones_of_show(path)
    with pytest.raises(FileError, match="no zip"):
        read_zip(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b,c\n1,2,3\n", "its first line is 'a,b,c'"),
        (f"{HEADER}\n0,0,0,1,0,0,0\n", "has 1 rows"),
        (f"{HEADER}\n0,0,0,1,0,0,0\n50,0,0\n", "truncated"),
        (f"{HEADER}\n50,0,0,1,0,0,0\n0,0,0,1,0,0,0\n", "go back from t = 0.05 s"),
        (f"{HEADER}\n50,0,0,1,0,0,0\n50,0,0,1,0,0,0\n", "repeats the time t = 0.05 s"),
    ],
)
def test_damaged_csv_is_told(text: str, told: str) -> None:
    with pytest.raises(FileError, match=told):
        lines_of(text, "d0.csv")
