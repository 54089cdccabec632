"""The second opinion agrees with the certificate, and needs nothing but numpy."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plans import PROBLEMS, planned

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.cli import main

QUICK = (
    *("triangle", "open_chain", "friction", "weight_hexagon", "form_square", "lay_triangle"),
    "join_a_fourth",
    "swarms/circle_6",
)
GROUPS = ("two_teams", "two_layers", "beside_a_show", "hitch_and_swarm")
SLOW = ("carry_tray", "grip_drum", "tie_carry_untie", "roll_32_gon", "form_triangle", "open_arc")
OWN = {"story", "strands", "contact", "enters", "rim", "ground", "laid"}
"""Limits that the certificate counts to others, or to infinity where they are broken."""

PROVEN = "proven: every limit holds at all times"


def saved(name: str, folder: Path) -> ho.Plan:
    plan = planned(name)
    plan.save(folder, rate=10.0)
    return plan


@pytest.mark.parametrize(
    "name", [*QUICK, *GROUPS, *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW)]
)
def test_it_agrees_with_the_certificate(name: str, tmp_path: Path) -> None:
    plan = saved(name, tmp_path)
    rows = [row for row in second.verify(tmp_path) if row.unit not in ("turn", "wrap", "bend")]
    assert {row.verdict for row in rows} == {"proven"}
    found = {row.name: row for row in rows}
    for check in plan.certificate.checks:
        if check.name in {"tracking_radius", "stoppable"} or check.worst is None:
            continue
        row = found.pop(check.name)
        worst = row.worst * (check.limit or 1.0) if row.unit == "share" else row.worst
        if (name, check.name) == ("join_a_fourth", "crossing"):  # boxes of tilted cables: lower
            assert check.worst < worst < 1.2 * check.worst
            continue
        share = 0.002 if name in GROUPS else 0.02
        assert worst == pytest.approx(check.worst, rel=share, abs=share * (check.limit or 1e-3))
    assert found.keys() <= OWN


@pytest.mark.slow
def test_the_script_needs_numpy_alone(tmp_path: Path) -> None:
    saved("triangle", tmp_path)
    script = tmp_path / "second_opinion.py"
    script.write_bytes(Path(second.__file__).read_bytes())
    code = (
        "import runpy, sys; sys.modules['hitchopt'] = None; sys.modules['scipy'] = None; "
        f"sys.argv = ['x', {str(tmp_path)!r}]; runpy.run_path({str(script)!r}, run_name='__main__')"
    )
    for status, words in ((0, PROVEN), (2, "not a plan")):
        told = subprocess.run(
            [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=False
        )
        assert told.returncode == status, told.stderr
        assert words in told.stdout + told.stderr
        (tmp_path / "plan.npz").write_bytes(b"PK")


def test_the_command_ends_with_3_where_a_limit_is_broken(tmp_path: Path) -> None:
    saved("triangle", tmp_path)
    path, command = tmp_path / "plan.npz", ["verify", str(tmp_path)]
    assert CliRunner().invoke(main, command).exit_code == 0
    with np.load(path) as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    settings["limits"]["jerk"] = settings["asked"]["limits"]["jerk"] = 10.0
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})
    run = CliRunner().invoke(main, command)
    assert run.exit_code == 3
    assert "jerk              violated" in run.output
    path.write_bytes(b"PK")
    assert CliRunner().invoke(main, command).exit_code == 2


@pytest.mark.slow
def test_solve_verifies_where_asked(tmp_path: Path) -> None:
    problem = str(PROBLEMS / "triangle.yaml")
    run = CliRunner().invoke(main, ["solve", problem, "-o", str(tmp_path / "out"), "--verify"])
    assert run.exit_code == 0, run.output
    assert PROVEN in run.output


@pytest.mark.slow
def test_a_spent_budget_proves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved("triangle", tmp_path)
    monkeypatch.setattr(second, "BUDGET", 100)
    verdicts = {row.name: row.verdict for row in second.verify(tmp_path)}
    assert verdicts["cable_length"] == "not proven"
