"""Crazyflies: memory, packing by cflib, settings, plans that are too long, rounding."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cflib.crazyflie.mem.trajectory_memory import CompressedSegment, CompressedStart, Poly4D
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
from format_readers import polynomials, segments
from ruamel.yaml import YAML

from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError
from hitchopt.exports.exporting import export_plan
from hitchopt.exports.fleet import fleet_from_dict, placeholder_fleet, read_fleet
from hitchopt.exports.format import format_of
from hitchopt.exports.formats.compressed import compressed
from hitchopt.exports.formats.crazyswarm2 import (
    KIND,
    PIECE_BYTES,
    read_poly_csv,
)
from hitchopt.exports.reading import read_manifest
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.mission.problem import SwarmProblem
from hitchopt.mission.solving import solve_swarm
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from problems.swarm import reversed_stack


def test_the_drone_s_memory_holds_what_cflib_packs(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    for path in sorted(tmp_path.glob("*.csv")):
        table = read_poly_csv(path)
        data = b""
        for duration, powers in zip(table.durations, table.powers, strict=True):
            axes = [Poly4D.Poly(axis.tolist()) for axis in powers]
            data += bytes(Poly4D(float(duration), *axes).pack())
        assert len(data) == PIECE_BYTES * len(table.durations) <= 4096
        # In single precision nothing is lost: the numbers have been rounded to it.
        single = np.frombuffer(data, dtype="<f4").reshape(-1, 33).astype(np.float64)
        assert np.array_equal(single[:, 32], table.durations)
        assert np.array_equal(single[:, :32].reshape(-1, 4, 8), table.powers)


def test_cflib_packs_the_same_bytes(tmp_path: Path) -> None:
    exported(hitch_plan(), "compressed", tmp_path, yaw=0.25)
    for path in sorted(tmp_path.glob("*.bin")):
        data = path.read_bytes()
        start, found, rest = segments(data)
        assert rest == b""
        # cflib truncates: half a unit more, away from zero, lands on the integers.
        nudged = [(v + 0.5 * np.sign(v)) / 1000.0 for v in start[:3]]
        packed = bytes(CompressedStart(*nudged, np.radians((start[3] + 0.5) / 10.0)).pack())
        for duration, axes in found:
            near = [[(v + 0.5 * np.sign(v)) / 1000.0 for v in axis] for axis in axes[:3]]
            segment = CompressedSegment((duration + 0.5) / 1000.0, *near, axes[3])
            packed += bytes(segment.pack())
        assert packed + bytes(CompressedSegment(0.0, [], [], [], []).pack()) == data
        assert start[3] == round(np.degrees(0.25) * 10)


def test_what_rests_takes_two_rows_and_no_bytes(tmp_path: Path) -> None:
    places = np.array([[[0.0, 0.0, 1.0]], [[0.4, 0.0, 1.0]]])
    moving, still = (swarm_of(p, np.array([0.0, 3.0])) for p in (places, places[[0, 0]]))
    (data,) = compressed(task_of(moving, "compressed"), 1.0, 2e-3)
    _, found, _ = segments(data)
    assert all(axes[1] == axes[2] == axes[3] == [] for _, axes in found)
    assert len(data) == 8 + len(found) * (3 + 14) + 3
    (part,) = exported(still, "crazyswarm2", tmp_path, frame="nwu")
    table = read_poly_csv(tmp_path / "d0.csv")
    assert (len(table.durations), table.frame) == (2, "nwu")
    assert (tmp_path / "d0.csv").read_text().splitlines()[0].count(",") == 32
    assert part.verdict.duration == pytest.approx(3.0, abs=1e-3)


def test_beyond_the_range_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InfeasibleError, match=r"range: 3.* m is above the limit of 32\.767 m"):
        exported(swarm_plan(), "compressed", tmp_path / "out", origin=[31.0, 0.0, 0.0])
    assert not (tmp_path / "out").exists()


def test_bytes_from_python(tmp_path: Path) -> None:
    motion = hitch_plan()
    plan = Plan(motion, certify(motion), "A plan")
    (files,) = plan.compressed(frame="nwu")
    plan.export("compressed", tmp_path, frame="nwu")
    assert set(files) == set(motion.team.drone_names)
    assert files["q0"] == (tmp_path / "q0_nwu.bin").read_bytes()


def test_settings_name_every_drone_below_its_start(tmp_path: Path) -> None:
    """ROS refuses lists of integers and floats; a loader of YAML 1.1 wants a point in a float."""
    starts = np.array([[1.0, -2.0, 1.0], [1e-5, -1e-9, 1.0], [123456.789, 0.1234567, 1.0]])
    still = swarm_of(starts[None] + np.zeros((2, 1, 1)), np.array([0.0, 3.0]))
    still = replace(still, requirements=replace(still.requirements, arena=None))
    exported(still, "crazyswarm2", tmp_path)
    text = (tmp_path / "crazyflies.yaml").read_text()
    found = re.findall(r"initial_position: \[(.*), (.*), (.*)\]", text)
    for numbers, start in zip(found, starts, strict=True):
        assert all(re.fullmatch(r"-?[0-9]+\.[0-9]+", number) for number in numbers)
        np.testing.assert_allclose([float(x) for x in numbers], [*start[:2], 0.0], atol=1e-6)
    settings = YAML(typ="safe").load(text)
    assert settings["fileversion"] == 3
    assert list(settings["robots"]) == ["d0", "d1", "d2"]
    for robot in settings["robots"].values():
        assert robot["enabled"] is True
        assert robot["uri"].startswith("radio://")
        assert robot["type"] in settings["robot_types"]
    assert settings["all"]["firmware_params"]["commander"]["enHighLevel"] == 1


def test_a_fleet_is_read_from_the_settings_that_were_written(tmp_path: Path) -> None:
    kind, motion = format_of("crazyswarm2"), swarm_plan()
    roles = motion.team.drone_names
    drones = {
        role: {"name": f"cf{i}", "uri": f"radio://0/80/2M/E7E7E7E70{i}", "type": "cf21"}
        for i, role in enumerate(reversed(roles))
    }
    data = {"drones": drones, "types": {"cf21": {"big_quad": True}}, "settings": {"a": {"b": 1}}}
    fleets, texts = [fleet_from_dict(data, roles)], []
    for turn in ("first", "second"):
        task = replace(task_of(motion, "crazyswarm2"), fleet=fleets[-1])
        export_plan(kind, task, certificate_of(motion), tmp_path / turn)
        path = tmp_path / turn / "crazyflies.yaml"
        fleets.append(read_fleet(path, roles))
        texts.append(path.read_text())
    assert fleets[1] == fleets[0]
    assert texts[1] == texts[0]
    exported(motion, "crazyswarm2", tmp_path / "placeholders")
    again = read_fleet(tmp_path / "placeholders" / "crazyflies.yaml", roles)
    assert again.members == placeholder_fleet(roles).members
    assert not again.given


@pytest.mark.slow
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
    end = None
    for part, (begins, ends) in zip(parts, spans, strict=True):
        assert any("cut into" in note and "only then upload" in note for note in part.notes)
        own, path = read_manifest(part.folder), part.folder / "q0.csv"
        assert own is not None
        assert own["plan_span"] == [begins, ends]
        # What is flown lasts as long, rounded up to the format's clock.
        assert 0.0 <= part.verdict.duration - (ends - begins) < KIND.quantum
        if end is not None:
            np.testing.assert_allclose(polynomials(path, np.zeros(1))[0], end, atol=1e-6)
        t = np.array([0.0, 0.7])
        places = states_at(motion, begins + t).positions[:, 0]
        np.testing.assert_allclose(polynomials(path, t), places, atol=1e-3)
        last = np.array([part.verdict.duration])
        end = polynomials(path, last)[0]
        for order in (1, 2):
            for at in (np.zeros(1), last):
                assert np.max(np.abs(polynomials(path, at, order))) < 1e-4
    # A shorter plan in the same folder leaves none of the parts behind.
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    assert [p for p in tmp_path.iterdir() if p.is_dir()] == []


def test_what_never_rests_is_left_to_streaming(tmp_path: Path) -> None:
    with pytest.raises(InfeasibleError, match="above the limit of 31 pieces") as reported:
        exported(restless_plan(), "crazyswarm2", tmp_path / "out")
    assert "stream it: --format ros2bag" in str(reported.value)
    assert not (tmp_path / "out").exists()


def test_drones_that_start_below_one_another_are_told_of(tmp_path: Path) -> None:
    problem = any_problem_from_dict(reversed_stack(3))
    assert isinstance(problem, SwarmProblem)
    (part,) = exported(solve_swarm(None, problem).motion, "crazyswarm2", tmp_path)
    assert any("would take off from one place" in note for note in part.notes)
