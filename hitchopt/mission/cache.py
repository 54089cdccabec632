"""A cache of finished steps, for problems that are planned again after an edit."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hitchopt.errors import OneLine
from hitchopt.planners.task import StepPlan
from hitchopt.values import integer


class Cache(OneLine):
    """Plans of steps, for problems that are planned again after an edit.

    Steps are planned anew only from the first one whose request differs. Requests are compared by
    their contents; steps with a custom cost are not stored, since functions cannot be compared.
    """

    def __init__(self, size: int = 32) -> None:
        """Create an empty cache of up to ``size`` steps; one of 1000 robots takes 76 MB."""
        self.size = integer("size", size, 1)
        self._plans: dict[bytes, StepPlan] = {}  # the least recently used first

    def _parts(self) -> Iterator[str]:
        yield f"{len(self._plans)} of {self.size} steps"

    def take(self, request: bytes) -> StepPlan | None:
        """Return the plan of a request, by its digest, and remove it; None if it is not stored."""
        return self._plans.pop(request, None)

    def store(self, request: bytes, plan: StepPlan) -> None:
        """Store the plan of a request in place of the one that was not used for longest."""
        self._plans[request] = plan
        if len(self._plans) > self.size:
            del self._plans[next(iter(self._plans))]


def digest(request: Any) -> bytes:
    """Return the digest of the contents of a request."""
    return hashlib.sha256(repr(contents(request)).encode()).digest()


def contents(value: Any) -> object:
    """Return the contents of a request in built-in types; their repr is equal only if they are."""
    kind: Any = type(value)
    if kind in _SIMPLE:
        return value
    if kind is np.ndarray:
        return value.dtype.str, value.shape, value.strides, value.tobytes()
    if fields := getattr(kind, "__dataclass_fields__", None):  # Others follow from arguments
        return kind, [contents(getattr(value, name)) for name, each in fields.items() if each.init]
    if isinstance(value, Mapping):
        return [(key, contents(each)) for key, each in value.items()]
    if isinstance(value, (tuple, list)):
        return kind, [contents(each) for each in value]
    return value if isinstance(value, (str, int, float)) else pickle.dumps(value)


_SIMPLE = {str, int, float, bool, type(None)}
