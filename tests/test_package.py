"""The package as a whole: its public names, and how light it is to import."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import hitchopt


def test_public_names_have_words_and_others_are_refused() -> None:
    assert all(getattr(hitchopt, name).__doc__ for name in hitchopt.__all__)
    assert set(hitchopt.__all__) <= set(dir(hitchopt))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = hitchopt.nonsense  # type: ignore[attr-defined]


HEAVY = ("casadi", "matplotlib", "toppra", "scipy", "pydantic", "ruamel.yaml")
PLANNED = """
import sys, hitchopt as ho
ho.morph(ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4),
    ho.regular_polygon(3, 1.3), altitude=1.0), ho.regular_polygon(3, 1.2))
drawn = "matplotlib" in sys.modules
import toppra
from toppra import algorithm, constraint
from toppra.algorithm import TOPPRA
from toppra.solverwrapper import seidelWrapper
line = toppra.SplineInterpolator([0.0, 1.0], [[0.0], [1.0]])
limit = constraint.JointVelocityConstraint([[-1.0, 1.0]])
found = algorithm.TOPPRA([limit], line, solver_wrapper="seidel")
print(drawn, toppra.algorithm.TOPPRA is TOPPRA, toppra.solverwrapper.seidelWrapper is seidelWrapper)
"""


@pytest.mark.parametrize(
    ("code", "printed"),
    [
        (f"import hitchopt, sys; print(*{{*{HEAVY!r}}} & {{*sys.modules}})", ""),
        pytest.param(PLANNED, "False True True", marks=pytest.mark.slow),
    ],
)
def test_imports_load_nothing_heavy_and_users_get_toppra_whole(code: str, printed: str) -> None:
    command, environment = [sys.executable, "-c", code], {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stdout.strip()) == (0, printed), done.stderr


def test_modules_import_one_another_in_no_circle() -> None:
    """Those that only type checkers see count: needing one says that a boundary is wrong."""
    paths = {
        ".".join(path.with_suffix("").parts).removesuffix(".__init__"): path
        for path in Path("hitchopt").rglob("*.py")
    }
    arrows = {name: _imported(path, set(paths)) - {name} for name, path in paths.items()}
    while leaves := {name for name, ahead in arrows.items() if not ahead & arrows.keys()}:
        arrows = {name: ahead for name, ahead in arrows.items() if name not in leaves}
    assert sorted(arrows) == []


def _imported(path: Path, names: set[str]) -> set[str]:
    """Return the modules that one imports, but within functions, where imports are late."""
    found = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.ImportFrom) and node.module:
            each = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in names else node.module for name in each}
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            waiting.extend(ast.iter_child_nodes(node))
    return found & names
