"""One method for every kind of step, with the signature and the words of its record.

``step_methods.pyi`` lists them for type checkers and completion; a test compares the two.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from typing import Any

from hitchopt.steps import STEPS, Step


class StepMethods:
    """Methods that add a step: ``then`` with its record."""

    def then(self, step: Step) -> Any:
        """Return the same with one more step."""
        raise NotImplementedError


def _method(kind: type[Step]) -> Callable[..., Any]:
    """Return the method that adds a step of a kind, with the signature of its record."""

    def add(self: StepMethods, *args: Any, **kwargs: Any) -> Any:
        return self.then(kind(*args, **kwargs))

    each = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    given = [
        inspect.Parameter(
            item.name,
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
            default=_default(item.default, item.default_factory),
        )
        for item in fields(kind)
    ]
    record = inspect.cleandoc(kind.__doc__ or "").split("\n", 1)
    add.__name__ = kind.name
    add.__qualname__ = f"Mission.{kind.name}"
    add.__doc__ = f"Return the mission with this step: {record[0]}\n{''.join(record[1:])}"
    vars(add)["__signature__"] = inspect.Signature([each, *given])
    return add


def _default(default: Any, factory: Any) -> Any:
    if factory is not MISSING:
        return factory()
    return inspect.Parameter.empty if default is MISSING else default


for _kind in STEPS:
    setattr(StepMethods, _kind.name, _method(_kind))
