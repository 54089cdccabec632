"""Timing of paths: toppra's optimum with a jerk limit, as piecewise polynomials.

toppra's solver of programs with two variables is used without executing the rest of toppra, which
imports matplotlib for plots and scipy.interpolate for paths.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib import import_module
from types import ModuleType

SOLVER = "toppra.solverwrapper.cy_seidel_solverwrapper"
CONSTRAINT = "toppra.constraint"


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


class _ConstraintType:
    """toppra's enumeration of this name, which is imported when a member is read.

    toppra's own solvers read it, this package does not.
    """

    def __getattr__(self, name: str) -> object:
        return getattr(import_module(CONSTRAINT).ConstraintType, name)


def _import_solver() -> None:
    """Import the module SOLVER alone: of its packages as well as of toppra's constraints."""
    for name in ("toppra", "toppra.solverwrapper"):
        if name not in sys.modules and (spec := importlib.util.find_spec(name)) is not None:
            sys.modules[name] = importlib.util.module_from_spec(spec)
            sys.modules[name].__class__ = _Deferred
    if SOLVER in sys.modules or CONSTRAINT in sys.modules:
        return
    placeholder = sys.modules[CONSTRAINT] = ModuleType(CONSTRAINT)
    placeholder.__dict__["ConstraintType"] = _ConstraintType()
    try:
        import_module(SOLVER)
    finally:
        del sys.modules[CONSTRAINT]


_import_solver()
