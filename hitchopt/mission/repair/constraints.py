"""What binds, by name, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.steps.edits import PLAN_DURATION

TIMES = frozenset({"duration", PLAN_DURATION})
"""Constraints that a faster plan, or more time, repairs."""


def broken_constraints(error: InfeasibleError) -> frozenset[str]:
    """Return the names of all constraints that bind."""
    return frozenset(name_of(violation) for violation in error.violations)


def name_of(violation: Violation) -> str:
    """Return the name of the constraint, a step's duration and the plan's told apart."""
    whole_plan = violation.constraint == "duration" and violation.sense == "max"
    return PLAN_DURATION if whole_plan else violation.constraint


def needed(violations: Sequence[Violation], name: str) -> float:
    """Return the size by which a limit has to be raised at the least."""
    return _largest(v.value / v.limit - 1.0 for v in violations if name_of(v) == name)


def short(violations: Sequence[Violation]) -> float:
    """Return the size by which a step has to be longer at the least."""
    return _largest(v.limit / v.value - 1.0 for v in violations if name_of(v) == "duration")


def _largest(sizes: Iterable[float]) -> float:
    """Return the largest finite one; a bound that is not finite tells no size."""
    return max((size for size in sizes if math.isfinite(size)), default=0.0)


def beyond(violations: Sequence[Violation]) -> float:
    """Return how far drones are beyond walls [m]."""
    return max((-v.value for v in violations if v.constraint == "arena"), default=0.0)
