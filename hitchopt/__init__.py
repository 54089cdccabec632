"""hitchopt plans how teams of quadrotors tie and reshape polygonal cable hitches in midair.

``__init__.pyi`` lists the public names. They are imported when they are first used: ``import
hitchopt`` stays light.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body

_MODULES = {
    name.name: str(line.module)
    for line in _STUB
    if isinstance(line, ast.ImportFrom) and str(line.module).startswith("hitchopt.")
    for name in line.names
    if name.asname == name.name
} | {
    line.name: "hitchopt.api" for line in _STUB if isinstance(line, ast.ClassDef | ast.FunctionDef)
}
"""Module of every public name."""

__all__ = sorted(_MODULES)  # noqa: PLE0605, there is one list of names


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("importlib.metadata").version("hitchopt")
    if name not in _MODULES:
        raise AttributeError(f"module 'hitchopt' has no attribute '{name}'")
    value: object = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
