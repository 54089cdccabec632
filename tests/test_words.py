"""The package's names: nothing public is unused, and documents name files that exist."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import hitchopt

PACKAGE = Path(hitchopt.__file__).parent
TREES = {path: ast.parse(path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
NODES = [(path, node) for path, tree in TREES.items() for node in ast.walk(tree)]

# Methods that the package itself does not call: toppra, click, pydantic and pickle do, or users
CALLED = frozenset(
    """compute_constraint_params convert field_title_should_be_set invoke reducer_override
    abort displacements from_dict mirrored pause renumbered resume retarget rotated
    to_dataframe""".split()  # noqa: SIM905
)
CLASS_NAME = r"(?:[\w.]+:)?[A-Z]\w*"  # Strings that name a class, with or without its module


def defined(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """The public names that a module defines, and the public methods of its classes.

    Decorated functions are left out, since a decorator may register them; not so properties and the
    like.
    """
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
    read = [node for _, node in NODES if isinstance(getattr(node, "ctx", None), ast.Load)]
    known = {node.id for node in read if isinstance(node, ast.Name)} | CALLED
    known |= {node.attr for node in read if isinstance(node, ast.Attribute)} | {*hitchopt.__all__}
    texts = (str(node.value) for _, node in NODES if isinstance(node, ast.Constant))
    known |= {text.rpartition(":")[2] for text in texts if re.fullmatch(CLASS_NAME, text)}
    unused = [
        f"{path.relative_to(PACKAGE.parent)}:{getattr(node, 'lineno', 1)}: {name}"
        for path, tree in TREES.items()
        for node, name in defined(tree)
        if name not in known and not name.startswith("_")
    ]
    assert not unused, "\n".join(unused)


def test_documents_name_files_that_exist() -> None:
    root = PACKAGE.parent
    named = {
        (document.name, path)
        for document in (root / "CONTRIBUTING.md", *(root / "docs").rglob("*.md"))
        for path in re.findall(r"`((?:hitchopt|tests|problems)/[\w./]*)`", document.read_text())
    }
    assert len(named) > 10
    missing = [" names ".join(entry) for entry in sorted(named) if not (root / entry[1]).exists()]
    assert not missing, "\n".join(missing)
