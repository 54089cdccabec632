"""Timing of paths: toppra's optimum, limited in jerk, as piecewise polynomials."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

PACKAGE = "toppra"


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


def defer_toppra() -> None:
    """Let toppra's package run when it is first used, unless it has run already.

    It imports matplotlib to draw with; its modules are imported without it.
    """
    if PACKAGE in sys.modules:
        return
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None:
        return
    module = importlib.util.module_from_spec(spec)
    module.__class__ = _Deferred
    sys.modules[PACKAGE] = module


defer_toppra()
