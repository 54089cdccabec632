"""Slices: the table says all that they are, and the core runs without them."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import hitchopt
from hitchopt.cli import HEADINGS
from hitchopt.errors import UnsupportedError
from hitchopt.hitch import requirements
from hitchopt.slices import SLICES, Slice, hooks, module_of, place_of, provided

PACKAGE = Path(hitchopt.__file__).parent
NAMES = {each.name for each in SLICES}

LOADED_WITH_CERTIFICATES = {"friction", "losses"}  # Slices whose rules every certificate has


def imported(node: ast.AST) -> Iterator[str]:
    """Yield the modules that a syntax tree imports, without those for type checkers only."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
        return
    if isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    for child in ast.iter_child_nodes(node):
        yield from imported(child)


def slices_in(folder: Path) -> set[str]:
    """Return the slices that modules of a folder import."""
    trees = [ast.parse(path.read_text("utf-8")) for path in folder.rglob("*.py")]
    modules = [module.split(".") for tree in trees for module in imported(tree)]
    return {parts[1] for parts in modules if parts[0] == "hitchopt" and len(parts) > 1} & NAMES


@pytest.mark.parametrize("each", SLICES, ids=lambda each: each.name)
def test_records_say_what_slices_have_and_need(each: Slice) -> None:
    folder = PACKAGE / each.name
    assert slices_in(folder) - {each.name} == {*each.needs}
    for place in each.functions.values():
        assert callable(place_of(each, place))
    for names in (each.names, each.room_names, each.steps):
        for module, those in names.items():
            assert all(hasattr(module_of(each, module), name) for name in those)
    for module, those in each.steps.items():
        assert module_of(each, module).__all__ == [*those]
    for heading, commands in each.commands.items():
        assert heading in HEADINGS
        for name, module in commands.items():
            assert getattr(import_module(f"hitchopt.{module}"), name).name == name


def test_slices_need_each_other_in_no_circle() -> None:
    needs = {each.name: {*each.needs} for each in SLICES}
    assert sum(map(len, needs.values())) <= 8
    while needs:
        free = {name for name in needs if not needs[name] & {*needs}}
        assert free, f"a circle among {sorted(needs)}"
        needs = {name: needs[name] for name in {*needs} - free}


def test_what_no_slice_provides_is_refused_by_name() -> None:
    assert hooks("nonsense") == ()
    with pytest.raises(UnsupportedError, match="nonsense: this installation of hitchopt lacks"):
        provided("nonsense")


SCRIPT = """
import sys
import hitchopt as ho
team = ho.Team(3, 2.4)
if len(sys.argv) > 1:
    start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], 1.0)
    ho.solve(start, ho.Morph([[0, -1.1], [-0.4, 0.5], [0.4, 0.5]]))
print(*{name.split(".")[1] for name in sys.modules if name.startswith("hitchopt.")})
"""


@pytest.mark.parametrize("plans", [False, True], ids=["import", "morph"])
def test_slices_are_imported_when_they_are_used(plans: bool) -> None:
    words = [sys.executable, "-c", SCRIPT, *["plan"] * plans]
    run = subprocess.run(words, capture_output=True, text=True, check=True)
    loaded = {*run.stdout.split()} & NAMES
    assert loaded <= (LOADED_WITH_CERTIFICATES | {"live"} if plans else set())


def test_a_limit_without_the_slice_that_certifies_it_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    of_slices = {name for each in SLICES for name in each.limits}
    assert of_slices == {*requirements.OF_SLICES}
    stated: dict[str, Any] = {"rest_shift": 0.05, "survive": "cable"}
    for name in of_slices:
        hitchopt.Limits(**{name: stated[name]})
        kept = tuple(each for each in SLICES if name not in each.limits)
        monkeypatch.setattr(requirements, "SLICES", kept)
        with pytest.raises(hitchopt.InputError, match=f"{name}.*is not installed.*omit it"):
            hitchopt.Limits(**{name: stated[name]})
        hitchopt.Limits()
        monkeypatch.undo()
