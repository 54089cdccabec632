"""The package as a whole: its names, of which none is unused, and how light it is to import."""

from __future__ import annotations

import ast
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import hitchopt
from benchmarks.mutations import MUTATIONS
from hitchopt.errors import Violation
from hitchopt.lab.simulation.world import InvalidRunError
from hitchopt.slices import SLICES, by_module
from hitchopt.steps import STEP_KINDS
from tests.helpers.plans import ROOT

ROOMS = hitchopt.ROOM_NAMES | by_module("room_names")  # Names by their modules

PACKAGE = Path(hitchopt.__file__).parent

# Methods that the package itself does not call: toppra, click and pickle do, or users
CALLED = frozenset(
    """compute_constraint_params convert format_commands invoke
    reducer_override abort angle_to displacements mirrored pause renumbered resume retarget rotated
    to_dataframe to_scipy""".split()  # noqa: SIM905
)
CLASS_NAME = r"(?:[\w.]+:)?[A-Z]\w*"  # Strings that name a class, with or without its module


@cache
def syntax(folder: str) -> dict[Path, list[ast.AST]]:
    """Return the nodes of the syntax trees of all files of a folder, modules first."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return {path: [*ast.walk(ast.parse(path.read_text("utf-8")))] for path in paths}


def test_public_names_have_words_and_others_are_refused() -> None:
    assert all(getattr(hitchopt, name).__doc__ for name in hitchopt.__all__)
    assert set(hitchopt.__all__) <= set(dir(hitchopt))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = hitchopt.nonsense  # type: ignore[attr-defined]


def test_every_step_is_a_name_at_the_top() -> None:
    assert [getattr(hitchopt, kind.__name__) for kind in STEP_KINDS.values()] == [
        *STEP_KINDS.values()
    ]


def test_names_in_rooms_are_refused_with_their_place() -> None:
    for room, names in ROOMS.items():
        for name in names:
            assert getattr(import_module(f"hitchopt.{room}"), name).__doc__
            assert name not in hitchopt.__all__
            with pytest.raises(AttributeError, match=f"from hitchopt.{room} import {name}$"):
                getattr(hitchopt, name)


def test_type_checkers_read_the_names_that_are_imported() -> None:
    """The stub has every public name of the table, from its module, and no other."""
    stub = ast.parse(Path(hitchopt.__file__).with_suffix(".pyi").read_text("utf-8"))
    lines = [line for line in stub.body if isinstance(line, ast.ImportFrom)]
    pairs = [(str(line.module), alias.name) for line in lines for alias in line.names]
    declared = [
        (module, each)
        for module, name in pairs
        for each in (import_module(module).__all__ if name == "*" else [name])
    ]
    table = {name: getattr(hitchopt, name) for name in hitchopt.__all__}
    assert sorted(name for _, name in declared) == hitchopt.__all__
    for module, name in declared:
        assert getattr(import_module(module), name) is table[name]


OF_PLANNERS = ("casadi", "matplotlib", "toppra", "scipy")
HEAVY = (*OF_PLANNERS, "ruamel.yaml")
UNUSED = ("mujoco", "osqp")
PLANNED = f"""
import sys, hitchopt as ho
from hitchopt.cli import main
start = ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4),
    ho.regular_polygon(3, 1.3), altitude=1.0)
ho.morph(start, ho.regular_polygon(3, 1.2), optimize=False)
main(["solve", "-q", {str(ROOT / "problems" / "triangle.yaml")!r}], standalone_mode=False)
print(*{{*{UNUSED!r}}} & {{*sys.modules}})
"""


@pytest.mark.parametrize(
    "code",
    [
        f"import hitchopt, sys; print(*{{*{HEAVY!r}}} & {{*sys.modules}})",
        f"import hitchopt.steps, sys; print(*{{*{OF_PLANNERS!r}}} & {{*sys.modules}})",
        pytest.param(PLANNED, marks=pytest.mark.slow),
    ],
)
def test_imports_load_nothing_heavy_and_plans_nothing_unused(code: str, tmp_path: Path) -> None:
    command, environment = [sys.executable, "-c", code], {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, cwd=tmp_path
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_modules_import_one_another_in_no_circle() -> None:
    """Late imports and those of type checkers count: they say that a boundary is wrong."""
    modules = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): nodes
        for path, nodes in syntax("hitchopt").items()
    }
    arrows = {name: _imported(nodes, set(modules)) - {name} for name, nodes in modules.items()}
    while leaves := {name for name, ahead in arrows.items() if not ahead & arrows.keys()}:
        arrows = {name: ahead for name, ahead in arrows.items() if name not in leaves}
    assert sorted(arrows) == []


def _imported(nodes: list[ast.AST], names: set[str]) -> set[str]:
    """Return the modules that one imports, also within functions."""
    lines = (x for x in nodes if isinstance(x, ast.ImportFrom) and x.module)
    pairs = ((str(x.module), f"{x.module}.{alias.name}") for x in lines for alias in x.names)
    return {name if name in names else module for module, name in pairs} & names


def defined(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """The public names that a module defines, and the public methods of its classes.

    Decorated functions are omitted, since a decorator may register them; not so properties and the
    like.
    """
    assert isinstance(tree, ast.Module)
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.decorator_list:
            yield node, node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (x for target in targets for x in ast.walk(target) if isinstance(x, ast.Name))
            yield from ((node, name.id) for name in names)
        elif isinstance(node, ast.ClassDef):
            yield node, node.name
            yield from ((x, x.name) for x in node.body if isinstance(x, ast.FunctionDef))


def test_nothing_public_is_unused_by_the_package() -> None:
    """What only tests or benchmarks use belongs there; strings such as ``module:Class`` count."""
    nodes = [node for each in syntax("hitchopt").values() for node in each]
    read = [node for node in nodes if isinstance(getattr(node, "ctx", None), ast.Load)]
    known = {node.id for node in read if isinstance(node, ast.Name)} | CALLED
    known |= {node.attr for node in read if isinstance(node, ast.Attribute)} | {*hitchopt.__all__}
    known |= {name for names in ROOMS.values() for name in names}
    texts = (str(node.value) for node in nodes if isinstance(node, ast.Constant))
    known |= {kind.name for kind in STEP_KINDS.values()}  # functions of planners/morph/actions.py
    known |= {text.rpartition(":")[2] for text in texts if re.fullmatch(CLASS_NAME, text)}
    known |= {place.rpartition(":")[2] for each in SLICES for place in each.functions.values()}
    unused = [
        f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {name}"
        for path, each in syntax("hitchopt").items()
        for node, name in defined(each[0])
        if name not in known and not name.startswith("_")
    ]
    assert not unused, "\n".join(unused)


@pytest.mark.parametrize(
    "error",
    [
        hitchopt.InputError("team.robots", 2, "at least 3", "add one"),
        hitchopt.InfeasibleError([Violation("gap", 0.0, 1.0, "min", "m", (), "", "widen")], "cut"),
        InvalidRunError("strain", "it strains", 1.5, "cable 0", "use thicker ropes"),
    ],
)
def test_errors_come_whole_from_other_processes(error: hitchopt.HitchoptError) -> None:
    there = pickle.loads(pickle.dumps(error))
    assert (type(there), str(there), vars(there)) == (type(error), str(error), vars(error))


def test_documents_name_files_that_exist() -> None:
    named = {
        (document.name, path)
        for document in (ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"))
        for path in re.findall(r"`((?:hitchopt|tests|problems)/[\w./]*)`", document.read_text())
    }
    assert len(named) > 10
    missing = [" names ".join(entry) for entry in sorted(named) if not (ROOT / entry[1]).exists()]
    assert not missing, "\n".join(missing)


DEFINITIONS = (
    ast.Import,
    ast.ImportFrom,
    ast.FunctionDef,
    ast.ClassDef,
    ast.Assign,
    ast.AnnAssign,
    ast.AugAssign,
)
CONDITIONS = ("TYPE_CHECKING", "__name__ == '__main__'", "sys.platform != 'win32'")
WRITING_CODE = {"globals", "locals", "exec", "eval", "compile", "__import__"}


@pytest.mark.parametrize("folder", ["hitchopt", "benchmarks", "problems"])
def test_modules_define_things_and_do_nothing_else(folder: str) -> None:
    """No module acts on import, writes code, or imports a private name of another package.

    Private attributes and settings of the process are refused by ruff.
    """
    own, faults = ("hitchopt", "benchmarks", "problems"), list[str]()
    for path, nodes in syntax(folder).items():
        tree = nodes[0]
        assert isinstance(tree, ast.Module)
        is_script = "scripts" in path.parts  # as users write them
        for node in tree.body:
            is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            is_choice = isinstance(node, ast.If) and ast.unparse(node.test) in CONDITIONS
            if not (is_script or is_text or is_choice or isinstance(node, DEFINITIONS)):
                faults.append(f"{path}:{node.lineno}: acts on import")
        for part in nodes:
            if isinstance(part, ast.Name) and part.id in WRITING_CODE:
                faults.append(f"{path}:{part.lineno}: {part.id}")
            elif isinstance(part, ast.Import | ast.ImportFrom):
                module = str(getattr(part, "module", None) or "")
                names = [f"{module}.{name.name}".lstrip(".") for name in part.names]
                faults += [
                    f"{path}:{part.lineno}: {name} is private"
                    for name in names
                    if re.search(r"(^|\.)_(?!_)", name) and name.partition(".")[0] not in own
                ]
    assert not faults, "\n".join(faults)


def test_mutations_are_of_lines_that_stand() -> None:
    for each in MUTATIONS:
        assert each.old in (PACKAGE / each.path).read_text("utf-8"), each
