"""Remove every slice by itself, with what needs it, and run what is left: ``make slices``.

In a copy of the project, the folders, the records and the commands of a slice and of the slices
that need it are removed; then the core's tests run (``make test-core``), and one job of every slice
that is left. Arguments name the slices to remove; by default all.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from hitchopt.slices import SLICES  # noqa: E402

COPIED = ("hitchopt", "problems", "tests", "benchmarks", "pyproject.toml")

JOBS = {
    "friction": "solve problems/friction.yaml -o out/friction -q",
    "forming": "solve problems/form_triangle.yaml -o out/forming -q",
    "carrying": "fit circle:0.2 --robots 3 -q",
    "swarms": "solve problems/swarms/circle_6.yaml -o out/swarms -q",
    "teams": "solve problems/two_layers.yaml -o out/teams -q",
    "repairs": "solve problems/infeasible/tilt_too_small.yaml -o out/repairs -q",
    "verify": "verify out/core -q",
    "exports": "export out/core --format csv -q",
    "view": "report out/core -q",
    "live": "abort out/core --how hold --every 1 -q",
    "losses": "solve problems/survive_a_loss.yaml -o out/losses -q",
    "lab": "statics out/core -q",
}
"""One job of every slice, on the plan of the core's problem."""

CORE_JOB = "solve problems/triangle.yaml -o out/core -q --no-repair"

EXIT_CODES = {"repairs": 3}  # Exit codes of jobs that are not 0

CORE_TESTS = next(
    line.partition(":=")[2]
    for line in (ROOT / "Makefile").read_text("utf-8").replace("\\\n", " ").splitlines()
    if line.startswith("CORE_TESTS")
)
"""Files of ``make test-core``."""

KEPT: dict[str, str] = {}
"""Slices that cannot be removed yet, and what the core would have to learn."""


def removed_with(name: str) -> set[str]:
    """Return a slice and the slices that need it, directly or through others."""
    gone = {name}
    while more := {each.name for each in SLICES if gone & {*each.needs}} - gone:
        gone |= more
    return gone


def copy_without(gone: set[str], folder: Path) -> None:
    """Copy the project to a folder without some slices: their folders, records and commands."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, folder / name, ignore=ignored)
        else:
            shutil.copy(source, folder / name)
    for each in SLICES:
        if each.name not in gone:
            continue
        shutil.rmtree(folder / "hitchopt" / each.name)
        for commands in each.commands.values():
            for module in commands.values():
                path = folder / "hitchopt" / (module.replace(".", "/") + ".py")
                path.unlink(missing_ok=True)
    table = folder / "hitchopt" / "slices.py"
    text = table.read_text("utf-8")
    lines = text.splitlines(keepends=True)
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "Slice" and node.args):
            continue
        name = node.args[0]
        if isinstance(name, ast.Constant) and name.value in gone:
            for k in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[k] = ""
    table.write_text("".join(lines), "utf-8")


def failures_without(gone: set[str]) -> list[str]:
    """Return what fails without some slices."""
    failed = list[str]()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        copy_without(gone, folder)
        settings = os.environ | {
            "PYTHONPATH": str(folder),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

        def run(words: list[str], code: int = 0) -> None:
            """Run a module of Python in the copy, and note a failure."""
            done = subprocess.run(
                [sys.executable, "-m", *words],
                cwd=folder, env=settings, capture_output=True, text=True, check=False,
            )  # fmt: skip
            if done.returncode != code:
                failed.append(f"{' '.join(words)}: {(done.stdout + done.stderr)[-1500:]}")

        run(["pytest", "-x", *CORE_TESTS.split()])
        run(["hitchopt", *CORE_JOB.split()])
        for each in SLICES:
            if each.name not in gone:
                run(["hitchopt", *JOBS[each.name].split()], EXIT_CODES.get(each.name, 0))
    return failed


def main(names: list[str]) -> int:
    """Remove the named slices, or all, two at a time; return the exit code."""
    removals = [
        removed_with(name)
        for name in names or [each.name for each in SLICES if each.name not in KEPT]
    ]
    is_broken = False
    with ThreadPoolExecutor(2) as threads:  # Each waits for processes of its own
        for gone, failed in zip(removals, threads.map(failures_without, removals), strict=True):
            state = "fails" if failed else "runs"
            lines = "\n  ".join([f"without {', '.join(sorted(gone))}: {state}", *failed])
            sys.stdout.write(f"{lines}\n")
            sys.stdout.flush()
            is_broken |= bool(failed)
    return int(is_broken)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
