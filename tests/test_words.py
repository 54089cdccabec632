"""The package's words and names: docstrings, identifiers, file names, and nothing unused."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import hitchopt

PACKAGE = Path(hitchopt.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

PREPOSITIONS = frozenset(
    """about above across after against along among around as at before behind below beneath beside
    besides between beyond by despite during for from in inside into like near of off on onto out
    outside over per since through throughout to toward towards under until up upon via with within
    without""".split()  # noqa: SIM905
)

BANNED = frozenset(
    ("asking", "dear", "honey", "manners", "promise", "promises", "standing")
    + ("urge", "wary", "wish", "wishes")
)
"""Words that identifiers do not use; the field's terms are priority rule, penalty weight, damping,
options, evaluation and estimate."""

HOOKS = frozenset(
    {
        "compute_constraint_params",  # toppra
        "convert",  # click
        "field_title_should_be_set",  # pydantic
        "invoke",  # click
        "reducer_override",  # pickle
    }
)
"""Methods that a library calls by their names."""

METHODS = frozenset(
    {
        "abort",
        "displacements",
        "from_dict",
        "mirrored",
        "pause",
        "renumbered",
        "retarget",
        "resume",
        "rotated",
        "to_dataframe",
    }
)
"""Methods of public classes, ``Certificate``, ``Plan`` and the outlines, that users call."""

CLASS_NAME = r"(?:[\w.]+:)?[A-Z]\w*"
"""Strings that name a class or type, with or without its module."""


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path: Path) -> list[ast.AST]:
    """All nodes of a module."""
    return list(ast.walk(tree(path)))


def place(path: Path, node: ast.AST) -> str:
    return f"{path.relative_to(PACKAGE.parent)}:{getattr(node, 'lineno', 1)}"


def docstrings(path: Path) -> Iterator[ast.Constant]:
    """All strings that stand as statements: docstrings, and descriptions of constants."""
    for node in nodes(path):
        match node:
            case ast.Expr(ast.Constant(str()) as text):
                yield text


def first_word(text: str) -> str:
    """The first word after units and shapes in brackets, such as ``[m]`` or ``(n, 3)``."""
    bare = re.sub(r"^(?:\s*(?:\[[^]]*\]|\([^)]*\))[\s,:;.–-]*)+", "", text)
    found = re.match(r"\W*(\w+)", bare)
    return found[1].lower() if found else ""


def identifiers(path: Path) -> Iterator[tuple[ast.AST, str]]:
    """All names that the code gives or uses, keywords of calls included."""
    for node in nodes(path):
        for field in ("id", "attr", "name", "asname", "arg", "module"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                yield node, value


@cache
def parts(identifier: str) -> set[str]:
    """The words of an identifier in snake case or camel case."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", identifier)
    return set(re.split(r"[_.]+", spaced.lower()))


def test_docstrings_begin_with_no_preposition() -> None:
    found = [
        f"{place(path, node)}: {str(node.value).splitlines()[0]}"
        for path in MODULES
        for node in docstrings(path)
        if first_word(str(node.value)) in PREPOSITIONS
    ]
    assert not found, f"{len(found)} docstrings\n" + "\n".join(found)


def test_identifiers_are_the_field_s_words() -> None:
    found = [
        f"{place(path, node)}: {name}"
        for path in MODULES
        for node, name in identifiers(path)
        if parts(name) & BANNED
    ]
    found += [str(path) for path in MODULES if parts(path.stem) & BANNED]
    assert not found, "\n".join(found)


def defined(path: Path) -> Iterator[tuple[ast.AST, str]]:
    """The public names that a module defines, and the public methods of its classes.

    Decorated functions are left out, since a decorator may register them; not so properties and the
    like.
    """
    for node in tree(path).body:
        if isinstance(node, ast.FunctionDef) and not node.decorator_list:
            yield node, node.name
        elif isinstance(node, ast.Assign):
            yield from ((node, x.id) for target in node.targets for x in _names(target))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node, node.target.id
        elif isinstance(node, ast.ClassDef):
            yield node, node.name
            yield from ((x, x.name) for x in node.body if isinstance(x, ast.FunctionDef))


def _names(target: ast.expr) -> Iterator[ast.Name]:
    return (node for node in ast.walk(target) if isinstance(node, ast.Name))


def used(path: Path) -> Iterator[str]:
    """The names that a module reads, in strings such as ``module:Class`` too; not imports."""
    for node in nodes(path):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            yield node.attr
        elif isinstance(node, ast.Constant) and re.fullmatch(CLASS_NAME, str(node.value)):
            yield str(node.value).rpartition(":")[2]


def test_nothing_public_is_unused_by_the_package() -> None:
    """What only tests or benchmarks use belongs there."""
    known = (
        {name for path in MODULES for name in used(path)} | {*hitchopt.__all__} | HOOKS | METHODS
    )
    unused = [
        f"{place(path, node)}: {name}"
        for path in MODULES
        for node, name in defined(path)
        if name not in known and not name.startswith("_")
    ]
    assert not unused, "\n".join(unused)


def test_documents_name_files_that_exist() -> None:
    root = PACKAGE.parent
    documents = [root / "CONTRIBUTING.md", *(root / "docs").rglob("*.md")]
    named = {
        (document.name, path)
        for document in documents
        for path in re.findall(
            r"`((?:hitchopt|tests|problems)/[\w./]*)`", document.read_text("utf-8")
        )
    }
    assert len(named) > 10
    missing = [" names ".join(entry) for entry in sorted(named) if not (root / entry[1]).exists()]
    assert not missing, "\n".join(missing)
