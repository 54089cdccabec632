"""Polynomials for Crazyflies, read by cflib and by numpy, which know nothing of hitchopt."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cflib.crazyflie.mem.trajectory_memory import Poly4D
from exported_plans import (
    certificate_of,
    exported,
    hitch_plan,
    long_plan,
    restless_plan,
    swarm_of,
    swarm_plan,
    task_of,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from ruamel.yaml import YAML

from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.exporting import export_plan
from hitchopt.exports.fleet import fleet_from_dict, placeholder_fleet, read_fleet
from hitchopt.exports.formats.crazyswarm2 import (
    KIND,
    PIECE_BYTES,
    from_powers,
    read_poly_csv,
    to_powers,
    write_poly_csv,
)
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.manifest import read_manifest
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

MEMORY = 4096


def flown(path: Path, t: Array, derivative: int = 0) -> Array:
    """What the usual reader makes of a file: pieces one after the other, powers of seconds."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)
    assert rows.shape[1] == 33
    ends = np.cumsum(rows[:, 0])
    piece = np.minimum(np.searchsorted(ends, t, side="right"), len(rows) - 1)
    tau = t - (ends[piece] - rows[piece, 0])
    values = np.empty((len(t), 3))
    for i in range(len(t)):
        for axis in range(3):
            powers = rows[piece[i], 1 + 8 * axis : 9 + 8 * axis]
            values[i, axis] = np.polynomial.Polynomial(powers).deriv(derivative)(tau[i])
    return values


@pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])
def test_the_usual_reader_sees_the_plan(motion: Motion, tmp_path: Path) -> None:
    (part,) = exported(motion, "crazyswarm2", tmp_path, origin=[0.5, -0.2, 0.1], yaw=0.3)
    assert part.verdict.lost == ()
    t = np.linspace(0.0, motion.duration, 150)
    states = states_at(motion, t)
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for i, name in enumerate(motion.team.drone_names):
        path = tmp_path / f"{name}.csv"
        places = states.positions[:, i] @ turn.T + [0.5, -0.2, 0.1]
        apart = np.linalg.norm(flown(path, t) - places, axis=-1)
        assert np.max(apart) <= part.verdict.position.worst + 1e-9
        assert np.max(apart) < 1e-3
        speed = np.linalg.norm(flown(path, t, 1) - states.velocities[:, i] @ turn.T, axis=-1)
        assert np.max(speed) <= part.verdict.velocity.worst + 1e-9


def test_the_drone_s_memory_holds_what_cflib_packs(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    for path in sorted(tmp_path.glob("*.csv")):
        table = read_poly_csv(path)
        data = b""
        for duration, powers in zip(table.durations, table.powers, strict=True):
            axes = [Poly4D.Poly(axis.tolist()) for axis in powers]
            data += bytes(Poly4D(float(duration), *axes).pack())
        assert len(data) == PIECE_BYTES * len(table.durations) <= MEMORY
        # In single precision nothing is lost: the numbers have been rounded to it.
        single = np.frombuffer(data, dtype="<f4").reshape(-1, 33).astype(np.float64)
        assert np.array_equal(single[:, 32], table.durations)
        assert np.array_equal(single[:, :32].reshape(-1, 4, 8), table.powers)


def test_every_file_has_two_rows_and_a_frame(tmp_path: Path) -> None:
    still = swarm_of(np.array([[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]), np.array([0.0, 3.0]))
    (part,) = exported(still, "crazyswarm2", tmp_path, frame="nwu")
    table = read_poly_csv(tmp_path / "d0.csv")
    assert len(table.durations) >= 2
    assert table.frame == "nwu"
    assert (tmp_path / "d0.csv").read_text().splitlines()[0].count(",") == 32
    assert part.verdict.duration == pytest.approx(3.0, abs=1e-3)


def test_settings_name_every_drone_below_its_start(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    settings = YAML(typ="safe").load(tmp_path / "crazyflies.yaml")
    assert settings["fileversion"] == 3
    names = hitch_plan().team.drone_names
    assert tuple(settings["robots"]) == names
    for name in names:
        robot = settings["robots"][name]
        assert robot["enabled"] is True
        assert robot["uri"].startswith("radio://")
        assert robot["type"] in settings["robot_types"]
        start = flown(tmp_path / f"{name}.csv", np.array([0.0]))[0]
        np.testing.assert_allclose(robot["initial_position"][:2], start[:2], atol=1e-5)
    assert settings["all"]["firmware_params"]["commander"]["enHighLevel"] == 1


def test_every_number_of_an_initial_position_is_a_float(tmp_path: Path) -> None:
    """ROS refuses lists of integers and floats; a loader of YAML 1.1 wants a point in a float."""
    starts = np.array([[1.0, -2.0, 1.0], [1e-5, -1e-9, 1.0], [123456.789, 0.1234567, 1.0]])
    still = swarm_of(starts[None] + np.zeros((2, 1, 1)), np.array([0.0, 3.0]))
    still = replace(still, requirements=replace(still.requirements, arena=None))
    exported(still, "crazyswarm2", tmp_path)
    text = (tmp_path / "crazyflies.yaml").read_text()
    found = re.findall(r"initial_position: \[(.*), (.*), (.*)\]", text)
    assert len(found) == len(starts)
    for numbers, start in zip(found, starts, strict=True):
        assert all(re.fullmatch(r"-?[0-9]+\.[0-9]+", number) for number in numbers)
        np.testing.assert_allclose([float(x) for x in numbers], [*start[:2], 0.0], atol=1e-6)


def test_a_fleet_is_read_from_the_settings_that_were_written(tmp_path: Path) -> None:
    kind = format_of("crazyswarm2")
    motion = swarm_plan()
    drones = {
        role: {"name": f"cf{i}", "uri": f"radio://0/80/2M/E7E7E7E70{i}", "type": "cf21"}
        for i, role in enumerate(reversed(motion.team.drone_names))
    }
    data = {"drones": drones, "types": {"cf21": {"big_quad": True}}, "settings": {"a": {"b": 1}}}
    fleets = [fleet_from_dict(data, motion.team.drone_names)]
    texts = []
    for turn in ("first", "second"):
        task = replace(task_of(motion, "crazyswarm2"), fleet=fleets[-1])
        export_plan(kind, task, certificate_of(motion), tmp_path / turn)
        path = tmp_path / turn / "crazyflies.yaml"
        fleets.append(read_fleet(path, motion.team.drone_names))
        texts.append(path.read_text())
    assert fleets[1] == fleets[0]
    assert texts[1] == texts[0]
    exported(motion, "crazyswarm2", tmp_path / "placeholders")
    again = read_fleet(tmp_path / "placeholders" / "crazyflies.yaml", motion.team.drone_names)
    assert again.members == placeholder_fleet(motion.team.drone_names).members
    assert not again.given


def test_what_is_too_long_is_cut_at_rests(tmp_path: Path) -> None:
    motion = long_plan()
    parts = exported(motion, "crazyswarm2", tmp_path)
    assert len(parts) > 1
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert manifest["parts"] == [part.folder.name for part in parts]
    spans = manifest["plan_spans"]
    assert [begins for begins, _ in spans] == [part.begins for part in parts]
    assert [0.0, *(end for _, end in spans)] == [*(begins for begins, _ in spans), motion.duration]
    assert manifest["duration"] == motion.duration
    end = None
    for part, (begins, ends) in zip(parts, spans, strict=True):
        assert any("cut into" in note and "only then upload" in note for note in part.notes)
        own = read_manifest(part.folder)
        assert own is not None
        assert own["plan_span"] == [begins, ends]
        # What is flown lasts as long, rounded up to the format's clock.
        assert 0.0 <= part.verdict.duration - (ends - begins) < KIND.quantum
        first = flown(part.folder / "q0.csv", np.zeros(1))[0]
        if end is not None:
            np.testing.assert_allclose(first, end, atol=1e-6)
        t = np.array([0.0, 0.7])
        places = states_at(motion, begins + t).positions[:, 0]
        np.testing.assert_allclose(flown(part.folder / "q0.csv", t), places, atol=1e-3)
        end = flown(part.folder / "q0.csv", np.array([part.verdict.duration]))[0]
        for order in (1, 2):
            for at in (0.0, part.verdict.duration):
                assert np.max(np.abs(flown(part.folder / "q0.csv", np.array([at]), order))) < 1e-4
    # A shorter plan in the same folder leaves none of the parts behind.
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    assert [p for p in tmp_path.iterdir() if p.is_dir()] == []


def test_what_never_rests_is_left_to_streaming(tmp_path: Path) -> None:
    with pytest.raises(InfeasibleError, match="above the limit of 31 pieces") as reported:
        exported(restless_plan(), "crazyswarm2", tmp_path / "out")
    assert "stream it: --format ros2bag" in str(reported.value)
    assert not (tmp_path / "out").exists()


@given(st.integers(0, 30), st.floats(0.01, 20.0))
def test_powers_and_back(seed: int, h: float) -> None:
    rng = np.random.default_rng(seed)
    c = rng.normal(size=(2, 3, 8))
    durations = np.array([h, 0.3])
    powers = to_powers(c, durations)
    np.testing.assert_allclose(from_powers(powers, durations), c, atol=1e-7)
    curve = PiecewisePolynomial(np.concatenate([[0.0], np.cumsum(durations)]), c)
    value = np.polynomial.Polynomial(powers[0, 1])(0.4 * h)
    assert value == pytest.approx(curve.at(0.4 * h)[1], abs=1e-8)


def rows(count: int) -> list[str]:
    row = ["1.0", *["0.5"] * 32]
    return ["duration,...", *[",".join(row)] * count]


@pytest.mark.parametrize(
    ("lines", "reported"),
    [
        (rows(0), "no row of numbers"),
        ([*rows(2), "1.0,2.0"], "line 4 has 2 numbers, not 33"),
        ([*rows(1), rows(1)[1].replace("0.5", "nan", 1)], "beyond single precision"),
        ([*rows(1), rows(1)[1].replace("0.5", "1e39", 1)], "beyond single precision"),
        ([*rows(1), rows(1)[1].replace("1.0", "0.0", 1)], "row 2: its duration is 0 s"),
        ([*rows(1), rows(1)[1].replace("0.5", "half", 1)], "line 3: could not convert"),
    ],
)
def test_damaged_files_are_reported(lines: list[str], reported: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(FileError, match=reported):
        read_poly_csv(path)


def test_single_precision_survives_the_text(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    powers = rng.normal(size=(3, 4, 8)) * 10.0 ** rng.integers(-9, 9, size=(3, 4, 8))
    durations = rng.uniform(0.1, 3.0, 3)
    write_poly_csv(tmp_path / "a.csv", durations, powers, "enu")
    table = read_poly_csv(tmp_path / "a.csv")
    assert np.array_equal(table.powers, powers.astype(np.float32).astype(np.float64))
    assert np.array_equal(table.durations, durations.astype(np.float32).astype(np.float64))
