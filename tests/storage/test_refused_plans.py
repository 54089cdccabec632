"""Plans that no command believes: forged ones, and files of another format.

``refused_plans`` has plans that were certified once although they break a limit, each in the
format of plan files.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.certifying import check_of
from hitchopt.checks.registry import RULE_OF
from hitchopt.cli import main as main_command
from hitchopt.motion.plan_file import FORMAT, read_plan, write_plan
from hitchopt.verify import teams
from tests.helpers.plans import planned
from tests.helpers.second_opinions import opinion, violated

FORGED = Path(__file__).parent / "refused_plans"
REFUSED = {
    "through_edge": "cable_clearance",
    "through_edge_fast": "cable_clearance",
    "over_tray": "downwash",
}
"""Forged plans, and the limits that they violate."""

ROWS = {
    "cable_clearance": teams.between_plans,
    "downwash": teams.object_distances,
}
"""Functions of ``verify`` that find it."""

OTHER_FORMATS = [f"hitchopt-plan/{i}" for i in (1, 2, 3)] + ["hitchopt-flight/2", "", "show"]


@pytest.mark.parametrize("name", REFUSED)
def test_forged_plans_are_refused_by_both_opinions(name: str) -> None:
    path, reason = FORGED / f"{name}.npz", REFUSED[name]
    check = check_of(RULE_OF[reason], read_plan(path))
    assert check is not None
    assert not check.holds
    assert reason in violated(opinion(path, ROWS[reason]))


def test_a_plan_with_an_array_twice_is_refused_by_both_commands(tmp_path: Path) -> None:
    shutil.copy(FORGED / "twice.npz", tmp_path / "plan.npz")
    for command in ("check", "verify"):
        result = CliRunner().invoke(main_command, [command, str(tmp_path)])
        assert result.exit_code == 2, (command, result.output)
        assert "'groups/0/drones'" in result.output, (command, result.output)


@pytest.mark.parametrize("other", OTHER_FORMATS)
def test_a_file_of_another_format_is_refused_in_one_line(other: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    write_plan(path, planned("triangle").flight)
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **{**arrays, "format": np.array(other)})
    for command in ("check", "verify", "report"):
        result = CliRunner().invoke(main_command, [command, str(tmp_path)])
        assert result.exit_code == 2
        words = f"error: {path}: its format is {other!r}, not {FORMAT}; solve the problem again"
        assert " ".join(result.output.split()) == words
    with pytest.raises(ho.HitchoptError, match="its format is"):
        ho.load(tmp_path)
    with pytest.raises(second.UnreadableError, match=f"not {FORMAT}"):
        second.read(path)
