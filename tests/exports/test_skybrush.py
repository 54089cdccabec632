"""Shows for Skybrush, read with zipfile, json and the formula of a Bézier curve."""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_plans import exported, flown_checks, hitch_plan, swarm_plan, task_of
from numpy.typing import NDArray

from hitchopt.checks import Certificate
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.export_options import ExportOptions
from hitchopt.exports.exporting import export_plan
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.formats.skybrush import write_show
from hitchopt.exports.formats.skybrush_csv import HEADER, lines_of, read_zip
from hitchopt.exports.formats.skybrush_show import read_show, storage_scale, stored
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import states_at
from hitchopt.requirements import Limits, Separation
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
def test_a_show_is_the_plan(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "skybrush", tmp_path)
    assert part.verdict.lost == ()
    assert part.verdict.position.worst <= 2e-3
    t = np.linspace(0.0, motion.duration, 120)
    places = nwu(states_at(motion, t).positions)
    with zipfile.ZipFile(tmp_path / "show.skyc") as archive:
        show = json.loads(archive.read("show.json"))
        assert (show["version"], show["meta"]["frame"]) == (1, "nwu")
        assert show["settings"]["validation"]["maxVelocityXY"] == motion.requirements.limits.speed
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
            # Points lie a micrometre beyond what is stored of them, along every axis.
            assert apart <= part.verdict.position.worst + 2e-6


def as_stored(points: Any) -> tuple[Array, Array]:
    """What Skybrush's server keeps of a trajectory: whole milliseconds (pieces,), and control
    points (pieces, 4, 3) of whole multiples of a millimetre, digits beyond cut off."""
    corners = [x for _, place, inner in points for x in np.ravel([place, *inner]).tolist()]
    scale = math.ceil((math.ceil(1000 * max(map(abs, corners))) + 1) / 32768)
    lasting, pieces = [], []
    for before, here in pairwise(points):
        lasting.append(math.floor(round(here[0] - before[0], 3) * 1000))
        cut = [[int(x * (1000 / scale)) for x in p] for p in (before[1], *here[2], here[1])]
        assert np.max(np.abs(cut)) < 32768
        pieces.append(cut)
    return np.array(lasting), scale * 1e-3 * np.array(pieces)


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (40.0, -3.0, 0.0)], ids=["near", "far"])
def test_what_the_server_stores_is_what_was_certified(
    away: tuple[float, float, float], tmp_path: Path
) -> None:
    """Rounded once more by the server nothing changes, and velocity jumps as declared."""
    motion = hitch_plan()
    (part,) = exported(motion, "skybrush", tmp_path, origin=away)
    (declared,) = re.findall(r"jumps by up to ([0-9.e+]+) mm/s", part.notes[1])
    frame = task_of(motion, "skybrush", origin=away).frame
    jumps = []
    with zipfile.ZipFile(tmp_path / "show.skyc") as archive:
        for i, name in enumerate(motion.team.drone_names):
            points = json.loads(archive.read(f"drones/{name}/trajectory.json"))["points"]
            lasting, pieces = as_stored(points)
            times = 1e-3 * np.concatenate([[0], np.cumsum(lasting)])
            np.testing.assert_allclose(times, [point[0] for point in points], atol=1e-8)
            np.testing.assert_allclose(
                pieces[:, 3], [p[1] for p in points[1:]], rtol=0.0, atol=2e-6
            )
            curve = PiecewisePolynomial(times, np.swapaxes(pieces, 1, 2))
            t = np.linspace(0.0, motion.duration, 200)
            wanted = frame.points(states_at(motion, t).positions[:, i])
            for order, worst in ((0, part.verdict.position), (1, part.verdict.velocity)):
                if order:
                    wanted = frame.vectors(states_at(motion, t).velocities[:, i])
                apart = np.linalg.norm(curve.at(t, order) - wanted, axis=-1)
                assert np.max(apart) <= worst.worst + 1e-9
            slopes = 3.0 * np.diff(pieces, axis=1) / (1e-3 * lasting[:, None, None])
            jumps.append(np.max(np.linalg.norm(slopes[1:, 0] - slopes[:-1, 2], axis=-1)))
    assert 1e3 * max(jumps) == pytest.approx(float(declared), rel=6e-3)


def test_millimetres_that_lie_below_themselves_are_not_cut_off(tmp_path: Path) -> None:
    """1.001 m times 1000 is 1000.99… in binary."""
    numbers = np.array([1001, -1003, 2002, 0, 1, 32766, -1023, 1005, 4011, -2006, 999, 1007])
    assert any(int(k / 1000 * 1000) != k for k in numbers.tolist())
    points = 1e-3 * np.broadcast_to(numbers.reshape(1, 1, 3, 4), (1, 3, 3, 4))
    path = tmp_path / "show.skyc"
    write_show(path, task_of(swarm_plan(), "skybrush"), np.array([0.0, 0.7]), points)
    with zipfile.ZipFile(path) as archive:
        _, pieces = as_stored(json.loads(archive.read(FIRST))["points"])
    assert np.array_equal(np.rint(1e3 * pieces[0]).T, numbers.reshape(3, 4))
    curve = stored(read_show(path).curves["d0"])
    assert (storage_scale(curve), storage_scale(curve, 2e-3)) == (1, 2)
    np.testing.assert_allclose(curve.coefficients[0], points[0, 0], rtol=0.0, atol=1e-9)


def test_segments_are_long_enough_for_whole_millimetres(tmp_path: Path) -> None:
    """A unit of a control point is 3 mm over the duration of velocity: 150 mm/s at 20 ms."""
    (part,) = exported(hitch_plan(), "skybrush", tmp_path)
    drones = read_show(tmp_path / "show.skyc").curves
    assert min(float(np.min(curve.durations)) for curve in drones.values()) >= 0.05
    assert part.verdict.velocity.worst <= 0.04


def test_a_tight_limit_takes_more_points(tmp_path: Path) -> None:
    swarm = swarm_plan()
    (usual,) = exported(swarm, "skybrush", tmp_path / "usual")
    planned = np.radians(flown_checks(swarm)["tilt"].bound)
    tight = replace(
        swarm,
        requirements=replace(
            swarm.requirements, limits=replace(swarm.requirements.limits, tilt=planned * 1.05)
        ),
    )
    (part,) = exported(tight, "skybrush", tmp_path / "tight")
    points = [int(p.notes[0].split()[0]) for p in (usual, part)]
    assert points[1] > points[0]
    assert part.verdict.lost == ()


@MOTIONS
def test_a_zip_of_csv_is_the_plan(motion: Motion, tmp_path: Path) -> None:
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


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_csv_is_sampled_more_often_where_lines_lose_a_limit(tmp_path: Path) -> None:
    """Two drones on one circle, always opposite, at just their distance: lines cut corners."""
    angles = np.linspace(0.0, 4.0 * np.pi, 200)
    around = 0.1201 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=-1)
    slopes = np.gradient(around, angles, axis=0)
    t = 4.0 * angles / angles[-1]
    ends = np.stack([np.stack([s, -s], axis=1) for s in (around, slopes * np.pi)])
    ends[0] += [0.0, 0.0, 1.0]
    limits = Limits(speed=5.0, acceleration=1e3, jerk=1e6)
    pair = Motion.single(
        Swarm(2),
        replace(swarm_plan().requirements, limits=limits, separation=Separation()),
        PiecewisePolynomial.hermite(t, ends[:, :-1], ends[:, 1:]),
        (Phase("circle", 0, 0.0, 4.0),),
    )
    certificate = Certificate(4.0, tuple(flown_checks(pair).values()))
    kind = format_of("skybrush_csv")
    (part,) = export_plan(kind, task_of(pair, "skybrush_csv"), certificate, tmp_path)
    assert [note.split(":")[0] for note in part.notes] in (["at 40 Hz"], ["at 100 Hz"])
    asked = replace(task_of(pair, "skybrush_csv"), options=ExportOptions("skybrush_csv", rate=20.0))
    with pytest.raises(InfeasibleError, match=r"separation: 0\.9"):
        export_plan(kind, asked, certificate, tmp_path / "out")


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

    curve = read_show(edited(tmp_path, edit)).curves["d0"]
    np.testing.assert_allclose(curve.at([0.0, 3.0, 4.0]), [[0, 0, 1], [0, 0, 1], [1, 0, 1]])
    middle = 0.25 * np.array([2, 0, 1]) + 0.5 * np.array([4, 0, 1]) + 0.25 * np.array([4, 2, 1])
    np.testing.assert_allclose(curve.at(6.0), middle)


@pytest.mark.parametrize(
    ("edit", "reported"),
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
def test_damaged_shows_are_reported(
    edit: Callable[[dict[str, Any]], object], reported: str, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match=reported):
        read_show(edited(tmp_path, edit))


def test_a_truncated_zip_is_reported(tmp_path: Path) -> None:
    exported(swarm_plan(), "skybrush", tmp_path)
    path = tmp_path / "show.skyc"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(FileError, match=r"show\.skyc: is no Skybrush show"):
        read_show(path)
    with pytest.raises(FileError, match="no zip"):
        read_zip(path)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("a,b,c\n1,2,3\n", "its first line is 'a,b,c'"),
        (f"{HEADER}\n0,0,0,1,0,0,0\n", "has 1 rows"),
        (f"{HEADER}\n0,0,0,1,0,0,0\n50,0,0\n", "truncated"),
        (f"{HEADER}\n50,0,0,1,0,0,0\n0,0,0,1,0,0,0\n", "go back from t = 0.05 s"),
        (f"{HEADER}\n50,0,0,1,0,0,0\n50,0,0,1,0,0,0\n", "repeats the time t = 0.05 s"),
    ],
)
def test_damaged_csv_is_reported(text: str, reported: str) -> None:
    with pytest.raises(FileError, match=reported):
        lines_of(text, "d0.csv")
