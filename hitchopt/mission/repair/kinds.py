"""Which kinds of changes can repair the constraints that bind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.holding.capacity import EASED
from hitchopt.mission.problem import DronesStart, Problem
from hitchopt.mission.repair.change import (
    TIMES,
    Edited,
    Kind,
    Quantity,
    broken_constraints,
    lowered,
    needed,
)
from hitchopt.mission.repair.editing import (
    team_values,
    with_friction,
    with_mass,
    with_outlines_scaled,
    with_robots_apart,
    with_robots_drawn,
    with_team_values,
)
from hitchopt.mission.repair.least_changes import (
    all_walls,
    bound_quantity,
    limit_kinds,
    step_kinds,
    wall_kinds,
)
from hitchopt.steps.edits import FORCES, RATES, SPACE
from hitchopt.values import Array

TOO_CLOSE = frozenset({"crossing", "cable_clearance", "separation"})
"""Constraints that more distance repairs."""

SAFETY = (
    ("radius", frozenset({"separation"})),
    ("height", frozenset({"separation"})),
    ("cable", frozenset({"cable_clearance"})),
    ("crossing", frozenset({"crossing"})),
)
"""Distances that are there for safety, and the constraints that smaller ones repair."""

HEAVY = frozenset({"load"})
"""What tensions are too low for."""

HELD = frozenset({"grip"})
"""What lighter objects, and rougher ones, repair."""

ROUGHEST = 1.0
"""Largest coefficient of friction suggested."""

MOST_NAMED = 3
"""Most single cables tried, those that the broken limits name first."""


def likely_kinds(problem: Problem, error: InfeasibleError) -> list[Kind]:
    """Return the kinds of changes that can repair everything that binds, safety left as it is."""
    kinds = (
        *_starts(problem),
        *_lengths(problem, error.violations),
        *_forces(problem, error.violations),
        *_objects(problem, error.violations),
        *limit_kinds(problem, error.violations),
        *step_kinds(problem, error.violations),
        *wall_kinds(problem, error.violations),
    )
    return _covering(kinds, error)


def last_resorts(problem: Problem, error: InfeasibleError) -> list[Kind]:
    """Return the kinds to try where no likely one does.

    All walls at once, and those that give up some of the distances that are there for safety.
    """
    kinds = list(all_walls(problem, error.violations))
    for name, covers in SAFETY:
        quantity = bound_quantity(problem, f"separation.{name}", "m")
        if quantity.old > 0.0:
            kinds.append(lowered(quantity, covers, relaxes=True))
    return _covering(kinds, error)


def _covering(kinds: Sequence[Kind], error: InfeasibleError) -> list[Kind]:
    broken = broken_constraints(error)
    return [kind for kind in kinds if broken <= kind.covers]


def _lengths(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield changes of all cables, of single ones that are named, and of the outlines' size."""
    for one in _single(problem, "cable_length", "m", "one cable", violations):
        yield Kind(one, 1, SPACE, family="one cable")
    every = _every(problem, "cable_length", "m", "all cables")
    yield Kind(every, 1, SPACE)
    yield lowered(every, TOO_CLOSE | {"arena"})
    put = partial(with_outlines_scaled, problem)
    outlines = Quantity("polygon", 1.0, "times", put, "scale of all polygons")
    yield lowered(outlines, SPACE | RATES | TIMES | {"arena"})
    yield Kind(outlines, 1, TOO_CLOSE)


def _forces(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield lower tensions, of single cables that are named and of all, and more thrust."""
    same = _same(problem.team.tension)
    if not same:
        for one in _single(problem, "tension", "N", "one tension", violations):
            # Tensions that differ turn legs, so that an odd one may be what brings drones together.
            yield lowered(one, FORCES | SPACE | {"crossing"}, family="one tension")
    every = _every(problem, "tension", "N", "" if same else "all tensions")
    yield lowered(every, FORCES)
    yield Kind(every, 1, HEAVY, needed(violations, "load"))
    if np.any(problem.team.load > 0.0):
        words = "" if _same(problem.team.load) else "all loads"
        yield lowered(_every(problem, "load", "kg", words), HEAVY | FORCES | TOO_CLOSE)
    thrust = _every(problem, "max_thrust", "N", "every max_thrust")
    same = thrust.unit == "N"
    key = "team.quadrotor.max_thrust" if same else "team.quadrotor"
    thrust = replace(thrust, key=key, words="" if same else thrust.words)
    yield Kind(thrust, 1, TIMES | {"thrust"}, relaxes=True)


def _objects(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield objects that are lighter or rougher, where a refused hold names them."""
    shares = [v.value / v.limit for v in violations if v.constraint == "grip" and v.limit > 0.0]
    shares += [v.limit / v.value for v in violations if v.constraint == "load" and v.value > 0.0]
    share = EASED * min((each for each in shares if 0.0 < each < 1.0), default=1.0 / EASED)
    for name, body in problem.objects.items():
        told = (f"objects.{name}" in v.when or name in v.where for v in violations)
        if body.fixed or not any(told):
            continue
        mass = Quantity(f"objects.{name}.mass", body.mass, "kg", partial(with_mass, problem, name))
        yield replace(lowered(mass, HELD | HEAVY | FORCES | TOO_CLOSE), least=1.0 - share)
        if 0.0 < body.friction <= share * ROUGHEST:
            key, most = f"objects.{name}.friction", ROUGHEST / body.friction - 1.0
            rough = Quantity(key, body.friction, "", partial(with_friction, problem, name))
            yield Kind(rough, 1, HELD, 1.0 / share - 1.0, most)


def _every(problem: Problem, name: str, unit: str, words: str) -> Quantity:
    """Return the team's values (n,) as one quantity: the value that all have, or a factor."""
    values = team_values(problem, name)
    same = _same(values)
    ratios = np.ones(len(values)) if same else values

    def put(new: float) -> Edited:
        return with_team_values(problem, name, new * ratios)

    old = float(values[0]) if same else 1.0
    return Quantity(f"team.{name}", old, unit if same else "times", put, words)


def _same(values: Array) -> bool:
    return bool(np.all(values == values[0]))


def _single(
    problem: Problem, name: str, unit: str, words: str, violations: Sequence[Violation]
) -> Iterator[Quantity]:
    """Yield the values of single robots that are named."""
    values = team_values(problem, name)
    for k in _named(violations, len(values)):

        def put(new: float, k: int = k) -> Edited:
            changed = np.where(np.arange(len(values)) == k, new, values)
            return with_team_values(problem, name, changed)

        yield Quantity(f"team.{name}[{k}]", float(values[k]), unit, put, words)


def _starts(problem: Problem) -> Iterator[Kind]:
    """Yield drones on free cables that start farther apart, or closer together."""
    start = problem.start
    if not isinstance(start, DronesStart):
        return
    apart, drawn = (partial(put, problem, start) for put in (with_robots_apart, with_robots_drawn))
    key, unit = "start.drones", "times"
    yield Kind(Quantity(key, 1.0, unit, apart, "robots from their middle"), 1, TOO_CLOSE)
    pairs = Quantity(key, 1.0, unit, drawn, "two drones of a robot")
    yield lowered(pairs, frozenset({"span"}))


def _named(violations: Sequence[Violation], robots: int) -> list[int]:
    """Return the indices in names such as q0, r-leg 2, cable 1; those of vertices are none."""
    found = [
        int(match[1])
        for violation in violations
        for name in violation.where
        if (match := re.fullmatch(r"(?:q|r|q-leg |r-leg |cable |edge )(\d+)", name))
    ]
    return [k for k in dict.fromkeys(found) if k < robots][:MOST_NAMED]
