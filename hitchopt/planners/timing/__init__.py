"""Timing of paths: toppra's optimum, limited in jerk, as piecewise polynomials.

toppra imports matplotlib to draw with: its modules are used without running the package itself.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType


class _Deferred(ModuleType):
    """A package that runs when the first of its own attributes is used.

    ``importlib.util.LazyLoader`` of Python 3.11 runs modules already when they are imported twice.
    """

    def __getattr__(self, name: str) -> object:
        spec = self.__spec__
        self.__class__ = ModuleType  # type: ignore[assignment]
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module(self)
        return getattr(self, name)


if "toppra" not in sys.modules and (_found := importlib.util.find_spec("toppra")) is not None:
    sys.modules["toppra"] = importlib.util.module_from_spec(_found)
    sys.modules["toppra"].__class__ = _Deferred
