"""Proofs of the row ``floor``: against samples, and of forged plans that fly below it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.registry import RULE_OF
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_saved_plan, write_plan
from hitchopt.plan import read_requested_plan
from hitchopt.verify import driver
from tests.helpers.by_hand import sampled
from tests.helpers.carried_plans import plan as carried_plan
from tests.helpers.motions import loaded_motion, random_chain, replaced
from tests.helpers.plans import PROBLEMS, planned

MOTIONS = {
    "ring": lambda: planned("triangle").motion,
    "heavy ring": lambda: planned("weight_hexagon").motion,
    "loaded": lambda: replaced(loaded_motion(3, 4), tracking=0.0),
    "chain": lambda: random_chain(3, 2),
    "single drones": lambda: planned("swarms/circle_6").motion,
}


def floor_rows(motion: Motion, folder: Path) -> list[second.Row]:
    """Return the rows of the floor, of drones and of cables."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    (own,), _ = second.read(folder / "plan.npz")
    return [row for row in driver.plan_rows(own) if row.name == "floor"]


@pytest.mark.parametrize("kind", MOTIONS)
def test_heights_are_those_of_samples_and_decide(kind: str, tmp_path: Path) -> None:
    motion = MOTIONS[kind]()
    start, end = motion.drones.breaks[[0, -1]].tolist()
    times = np.linspace(start, end, 2001)
    lowest = sampled(motion, times, {"floor"})["floor"]
    for above, verdict in ((0.02, "proven"), (-0.02, "violated")):
        floor = lowest - above
        rows = floor_rows(replaced(motion, floor=floor), tmp_path)
        assert min(row.worst for row in rows) == pytest.approx(lowest, abs=5e-3)
        assert ("violated" in {row.verdict for row in rows}) is (verdict == "violated")
        assert {row.limit for row in rows} == {floor}
        check = RULE_OF["floor"].check(replaced(motion, floor=floor))
        assert check is not None
        assert check.holds is (verdict == "proven")
    assert floor_rows(replaced(motion, floor=None), tmp_path) == []


def forged(name: str, folder: Path, down: float, **limits: Any) -> None:
    """Save a plan whose curves are lower [m], with limits and a certificate as of the plan."""
    planned(name).save(folder, rate=10.0)
    with np.load(folder / "plan.npz") as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    settings["groups"][0]["records"]["requirements"]["limits"] |= limits
    arrays["settings"] = np.array(json.dumps(settings))
    for curve in ("drones", "vertices"):
        if f"groups/0/{curve}" in arrays:
            arrays[f"groups/0/{curve}"][:, :, 2] -= down
    np.savez(folder / "plan.npz", **arrays)


def refused_by_both(folder: Path) -> tuple[str, str]:
    """Return what ``check`` and ``verify`` print of a plan that they refuse."""
    outputs = []
    for command in ("check", "verify"):
        run = CliRunner().invoke(main, [command, str(folder)])
        assert run.exit_code != 0, run.output
        outputs.append(run.output)
    return outputs[0], outputs[1]


@pytest.mark.parametrize("name", ["triangle", "open_pair", "weight_hexagon", "swarms/circle_6"])
def test_plans_below_the_floor_are_refused_by_both(name: str, tmp_path: Path) -> None:
    """Their certificate states that they are above it."""
    forged(name, tmp_path, 3.0)
    certificate = json.loads((tmp_path / "certificate.json").read_text())
    assert {each["name"]: each["holds"] for each in certificate["checks"]}["floor"]
    refused_by_both(tmp_path)
    rows = {row.name: row for row in second.verify(tmp_path)}
    assert rows["floor"].verdict == "violated"
    assert not ho.certify(read_motion(tmp_path))["floor"].holds


def read_motion(folder: Path) -> Motion:
    """Return the motion of a plan file, whatever its request."""
    return read_saved_plan(folder / "plan.npz").flight.teams[0].motion


@pytest.mark.parametrize("floor", [-9.0, None])
def test_a_floor_that_nobody_asked_for_is_refused_by_both(
    floor: float | None, tmp_path: Path
) -> None:
    """The problem of the file states none, so that it is 0."""
    text = (PROBLEMS / "triangle.yaml").read_text()
    assert "floor:" not in text
    write_plan(tmp_path / "plan.npz", planned("triangle").flight, "", text)
    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    settings["groups"][0]["records"]["requirements"]["limits"]["floor"] = floor
    np.savez(tmp_path / "plan.npz", **{**arrays, "settings": np.array(json.dumps(settings))})
    with pytest.raises(FileError, match=r"floor"):
        read_requested_plan(tmp_path / "plan.npz")
    rows = {row.name: row for row in second.verify(tmp_path)}
    assert rows["request"].verdict == "violated"
    assert rows["request"].where == "limits.floor is not as requested"


def test_a_forged_row_of_a_certificate_is_refused(tmp_path: Path) -> None:
    """The verifier prints its own row, whatever a certificate states."""
    planned("open_pair").save(tmp_path, rate=10.0)
    path = tmp_path / "certificate.json"
    content = json.loads(path.read_text())
    (floor,) = (each for each in content["checks"] if each["name"] == "floor")
    true_height = floor["worst"]
    floor["worst"] = true_height + 5.0
    path.write_text(json.dumps(content))
    run = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert run.exit_code != 0
    assert "floor is not as recomputed" in run.output
    (row,) = (each for each in second.verify(tmp_path) if each.name == "floor")
    assert row.worst == pytest.approx(true_height, abs=1e-3)


@pytest.mark.slow
def test_bodies_may_stand_on_the_floor_but_not_sink_into_it(tmp_path: Path) -> None:
    motion = carried_plan("drum").motion
    assert {row.verdict for row in floor_rows(motion, tmp_path)} == {"proven"}
    sunk = replaced(motion, floor=1e-5)
    check = RULE_OF["floor"].check(sunk)
    assert check is not None
    assert not check.holds
    assert "violated" in {row.verdict for row in floor_rows(sunk, tmp_path)}
