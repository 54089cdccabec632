"""Plans that earlier versions stored, in formats 1 and 2, are read, certified and proven.

``stored_plans`` has one of each kind, compressed, as versions of November 2026 wrote them; do not
write them again. The request in ``early`` has no mission. ``stored_plans.json`` has their figures;
where a certificate is meant to change, write these again and say so in the commit:
``PYTHONPATH=.:tests python tests/storage/test_stored_plans.py``.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from second_opinions import opinion, violated

import hitchopt as ho
from benchmarks.corpus import contents
from hitchopt import verify as second
from hitchopt.checks.registry import RULE_OF, check_of
from hitchopt.cli import main as main_command
from hitchopt.motion.plan_file import read_saved_plan, write_plan

FILES = sorted((Path(__file__).parent / "stored_plans").glob("*.npz"))
REFUSED = {
    "through_edge": "cable_clearance",
    "through_edge_fast": "cable_clearance",
    "over_tray": "downwash",
    "past_open": "interlacing",
}
"""Plans that an earlier version certified, and what they violate."""
BELIEVED = Path(__file__).parent / "refused_plans"
ROWS = {
    "cable_clearance": second.between_plans,
    "downwash": second.object_distances,
    "interlacing": second.interlacing,
}
"""Functions of ``verify`` that find it."""
FIGURES = Path(__file__).with_name("stored_plans.json")

SLOW = {"rest", "grip"}  # Plans that take longer to prove than a test should
# Largest difference of a figure, relative and in its unit, and of ``stoppable``, which is searched
# in steps (``tests/cli/baseline.py``)
CLOSE, SEARCHED = 1e-6, 0.25


def figures_of(path: Path, folder: Path) -> dict[str, Any]:
    """What a plan file gives: figures of its certificate, phases, and digests of its curves."""
    shutil.copy(path, folder / "plan.npz")
    plan = ho.load(folder)
    assert plan.certificate.certified
    phases, curves = contents(plan.motion)
    return {
        "title": plan.title,
        "problem": hashlib.sha256(plan.problem.encode()).hexdigest(),
        "duration": plan.duration,
        "worst": {check.name: check.worst for check in plan.certificate.checks},
        "phases": phases,
        "curves": {
            name: [list(curve.shape), hashlib.sha256(curve.tobytes()).hexdigest()[:16]]
            for name, curve in curves.items()
        },
    }


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_stored_plans_are_read_and_certified(path: Path, tmp_path: Path) -> None:
    known = json.loads(FIGURES.read_text(encoding="utf-8"))[path.stem]
    found = json.loads(json.dumps(figures_of(path, tmp_path)))
    worst, known_worst = found.pop("worst"), known.pop("worst")
    curves, known_curves = found.pop("curves"), known.pop("curves")
    assert found == known
    assert known_curves.items() <= curves.items()  # later ones may state defaults
    assert worst.keys() == known_worst.keys()
    for name, value in known_worst.items():
        share = SEARCHED if name == "stoppable" else CLOSE
        close = value if value is None else pytest.approx(value, rel=share, abs=CLOSE)
        assert worst[name] == close, name


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.slow if p.stem in SLOW else (), id=p.stem) for p in FILES],
)
def test_stored_plans_are_proven(path: Path, tmp_path: Path) -> None:
    """As written in this format; `hitchopt verify` does the same."""
    with pytest.raises(second.UnreadableError, match="the command"):
        [*second.verify(path)]
    write_plan(tmp_path / "plan.npz", *read_saved_plan(path))
    rows = [*second.verify(tmp_path)]
    assert len(rows) > 5
    assert {row.verdict for row in rows} <= second.PASSING


@pytest.mark.parametrize("name", REFUSED)
def test_plans_that_were_believed_are_refused_by_both_opinions(name: str, tmp_path: Path) -> None:
    path, reason = tmp_path / "plan.npz", REFUSED[name]
    saved = read_saved_plan(BELIEVED / f"{name}.npz")
    check = check_of(RULE_OF[reason], saved.motion)
    assert check is not None
    assert not check.holds
    write_plan(path, *saved)
    assert reason in violated(opinion(path, ROWS[reason]))


def test_a_plan_with_an_array_twice_is_refused_by_both_commands(tmp_path: Path) -> None:
    shutil.copy(BELIEVED / "twice.npz", tmp_path / "plan.npz")
    for command in ("check", "verify"):
        result = CliRunner().invoke(main_command, [command, str(tmp_path)])
        assert result.exit_code == 2, (command, result.output)
        assert "'a/drones'" in result.output, (command, result.output)


@pytest.mark.parametrize(("name", "folder"), [("single", ""), ("others", "others/single/")])
@pytest.mark.parametrize("value", [0.5, -1.0, np.nan])
def test_stored_switches_are_zero_or_one(
    name: str, folder: str, value: float, tmp_path: Path
) -> None:
    with np.load(FILES[0].with_stem(name)) as stored:
        arrays = dict(stored)
    arrays[folder + "integral"][1] = value
    np.savez(tmp_path / "plan.npz", **arrays)
    with pytest.raises(ho.HitchoptError, match=r"integral.* must be true or false"):
        ho.load(tmp_path)


def test_stored_plans_are_of_both_formats() -> None:
    formats = set()
    for path in FILES:
        with np.load(path) as arrays:
            formats.add(str(arrays["format"]))
    assert formats == {"hitchopt-plan/1", "hitchopt-plan/2"}


def main() -> None:
    """Write the figures of all stored plans."""
    with tempfile.TemporaryDirectory() as folder:
        found = {path.stem: figures_of(path, Path(folder)) for path in FILES}
    FIGURES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(f"{len(found)} plans\n")


if __name__ == "__main__":
    main()
