"""A slice is added and removed: the example of the recipe in CONTRIBUTING.md."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hitchopt

PACKAGE = Path(hitchopt.__file__).parent
WAVE = Path(__file__).parent / "toy_slice" / "wave"

RECORD = """SLICES = (
    Slice(
        "wave",
        steps={"steps": ("Wave",)},
        checks=("checks",),
        names={"drawing": ("draw_wave",)},
    ),
"""

PROBLEM = """
team: {robots: 3, cable_length: 2.4}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1}}
mission: [{wave: {height: 0.2}}]
"""

SCRIPT = """
import hitchopt as ho
plan = ho.solve("problem.yaml")
assert isinstance(ho.load_problem("problem.yaml").mission[0], ho.Wave)
ho.draw_wave(plan, "wave.png")
print(plan.certificate["wave_height"].worst)
"""


@pytest.fixture(name="folder")
def fixture_folder(tmp_path: Path) -> Path:
    ignored = shutil.ignore_patterns("__pycache__", "*.js", "lab")
    shutil.copytree(PACKAGE, tmp_path / "hitchopt", ignore=ignored)
    (tmp_path / "problem.yaml").write_text(PROBLEM)
    return tmp_path


def run(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the script with the package in a folder."""
    settings = os.environ | {"PYTHONPATH": str(folder)}
    words = [sys.executable, "-c", SCRIPT]
    return subprocess.run(
        words, cwd=folder, env=settings, capture_output=True, text=True, check=False
    )


def test_a_slice_is_a_folder_and_a_record(folder: Path) -> None:
    shutil.copytree(WAVE, folder / "hitchopt" / "wave")
    refused = run(folder)
    assert "mission[0].wave" in refused.stderr
    table = folder / "hitchopt" / "slices.py"
    table.write_text(table.read_text("utf-8").replace("SLICES = (\n", RECORD), "utf-8")
    done = run(folder)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(0.2, abs=1e-6)
    assert (folder / "wave.png").stat().st_size > 0
