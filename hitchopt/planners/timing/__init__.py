"""Timing of paths: toppra's optimum with a jerk limit, as piecewise polynomials.

Since toppra imports matplotlib for plots, its modules are used without executing the package.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType


class _Deferred(ModuleType):
    """A package that is executed at the first use of its own attributes.

    ``importlib.util.LazyLoader`` of Python 3.11 executes modules at their second import.
    """

    def __getattr__(self, name: str) -> object:
        spec = self.__spec__
        self.__class__ = ModuleType  # type: ignore[assignment]
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module(self)
        return getattr(self, name)


if "toppra" not in sys.modules and (_spec := importlib.util.find_spec("toppra")) is not None:
    sys.modules["toppra"] = importlib.util.module_from_spec(_spec)
    sys.modules["toppra"].__class__ = _Deferred
