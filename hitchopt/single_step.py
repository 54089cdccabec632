"""Plans of one step alone, from what the functions of ``actions`` are given."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hitchopt import steps
from hitchopt.hitch import Hitch, Team
from hitchopt.mission.problem import DronesStart, Problem, Start
from hitchopt.mission.solving import solve_problem
from hitchopt.plan import Plan
from hitchopt.requirements import Arena, Limits, Separation
from hitchopt.values import instance

Legs = str | Sequence[float] | ArrayLike | Mapping[str, Any]


F = TypeVar("F", bound=Callable[..., Plan])


class Required(TypedDict, total=False):
    """Keywords of every function: what the plan must satisfy."""

    limits: Limits | None
    separation: Separation | None
    arena: Arena | None


def explicit(function: F) -> F:
    """Let ``help`` and completion show the keywords of ``Required`` in place of ``**``."""
    signature = inspect.signature(function)
    own = list(signature.parameters.values())[:-1]
    kind = inspect.Parameter.KEYWORD_ONLY
    shared = [
        inspect.Parameter(name, kind, default=None, annotation=annotation)
        for name, annotation in Required.__annotations__.items()
    ]
    vars(function)["__signature__"] = signature.replace(parameters=[*own, *shared])
    return function


def free_drones(q: ArrayLike, r: ArrayLike) -> DronesStart:
    """Return the start of drones (n, 3) [m] on free cables."""
    return DronesStart(np.asarray(q, dtype=object), np.asarray(r, dtype=object))  # checked there


def moved(
    start: Hitch, requirements: Required, step: Callable[..., steps.Step], *values: Any
) -> Plan:
    """Return the plan of a step that begins with a hitch."""
    instance("start", start, Hitch)
    return planned(start.team, start, requirements, step, *values)


def planned(
    team: Team, start: Start, requirements: Required, step: Callable[..., steps.Step], *values: Any
) -> Plan:
    """Return the plan of a step, made of values as a user writes them."""
    instance("team", team, Team)
    if unknown := requirements.keys() - Required.__annotations__.keys():
        raise TypeError(f"unexpected keyword argument '{min(unknown)}'")
    fitting = step(*values).fitting(team)  # what is wrong in itself is said first
    fitting.polygon_left(team, start.polygon if isinstance(start, Hitch) else None)
    given: dict[str, Any] = {name: part for name, part in requirements.items() if part is not None}
    found = solve_problem(Problem(team, start, (fitting,), **given))
    return Plan(found.motion, found.certificate)
