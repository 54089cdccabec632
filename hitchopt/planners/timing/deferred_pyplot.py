"""Matplotlib's pyplot, deferred: toppra imports it and only draws with it."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

PACKAGE, NAME = "matplotlib", "pyplot"


class _Deferred(ModuleType):
    """A module that runs when the first of its own attributes is used.

    ``importlib.util.LazyLoader`` of Python 3.11 runs modules already when they are imported twice.
    """

    def __getattr__(self, name: str) -> object:
        spec = self.__spec__
        self.__class__ = ModuleType  # type: ignore[assignment]
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module(self)
        return getattr(self, name)


def defer_pyplot() -> None:
    """Let pyplot run when it is first used, unless it has run already or is not installed.

    Running it takes a tenth of what ``hitchopt solve`` needs for a small problem.
    """
    whole = f"{PACKAGE}.{NAME}"
    if whole in sys.modules or importlib.util.find_spec(PACKAGE) is None:
        return
    spec = importlib.util.find_spec(whole)
    if spec is None:
        return
    module = importlib.util.module_from_spec(spec)
    module.__class__ = _Deferred
    sys.modules[whole] = module
    setattr(sys.modules[PACKAGE], NAME, module)
