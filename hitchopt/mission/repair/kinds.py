"""Which changes can mend what binds: constraints to kinds of changes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.mission.problem import DronesStart, Problem
from hitchopt.mission.repair.change import Edited, Kind, Quantity, lowered, raised
from hitchopt.mission.repair.constraints import TIMES, broken_constraints
from hitchopt.mission.repair.editing import (
    with_cables,
    with_outlines_scaled,
    with_robots_apart,
    with_robots_drawn,
    with_separation,
    with_tensions,
)
from hitchopt.mission.repair.least_changes import all_walls, limit_kinds, step_kinds, wall_kinds
from hitchopt.steps.edits import RATES, SPACE

MOST_NAMED = 3
"""Single cables tried, those that the broken limits name first."""


def likely_kinds(problem: Problem, error: InfeasibleError) -> list[Kind]:
    """Return the kinds of changes that can mend everything that binds, safety left as it is."""
    kinds = (
        *_starts(problem),
        *_lengths(problem, error.violations),
        *_tensions(problem, error.violations),
        *limit_kinds(problem, error.violations),
        *step_kinds(problem, error.violations),
        *wall_kinds(problem, error.violations),
    )
    return _covering(kinds, error)


def last_resorts(problem: Problem, error: InfeasibleError) -> list[Kind]:
    """Return the kinds to try where no likely one does.

    All walls at once, and those that give up some of the distances that are there for safety.
    """
    kept = problem.separation
    kinds = list(all_walls(problem, error.violations))
    for name, covers in (
        ("radius", frozenset({"separation"})),
        ("height", frozenset({"separation"})),
        ("cable", frozenset({"cable_clearance"})),
        ("crossing", frozenset({"crossing"})),
    ):
        old = float(getattr(kept, name))
        if old > 0.0:
            quantity = Quantity(
                f"separation.{name}", old, "m", partial(with_separation, problem, name)
            )
            kinds.append(lowered(quantity, covers, relaxes=True))
    return _covering(kinds, error)


def _covering(kinds: Sequence[Kind], error: InfeasibleError) -> list[Kind]:
    broken = broken_constraints(error)
    return [kind for kind in kinds if broken <= kind.covers]


def _lengths(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield changes of all cables, of single ones that are named, and of the outlines' size."""
    lengths = problem.team.cable_length
    tight = frozenset({"crossing", "cable_clearance", "separation", "arena"})
    if np.all(lengths == lengths[0]):
        every = Quantity(
            "team.cable_length",
            float(lengths[0]),
            "m",
            lambda new: with_cables(problem, np.full(len(lengths), new)),
            "all cables",
        )
    else:
        every = Quantity(
            "team.cable_length",
            1.0,
            "times",
            lambda factor: with_cables(problem, lengths * factor),
            "all cables",
        )
    for k in _named(violations, len(lengths)):
        one = Quantity(
            f"team.cable_length[{k}]",
            float(lengths[k]),
            "m",
            partial(_with_cable, problem, k),
            "one cable",
        )
        yield replace(raised(one, SPACE), family="one cable")
    yield raised(every, SPACE)
    yield lowered(every, tight)
    outlines = Quantity(
        "polygon", 1.0, "times", partial(with_outlines_scaled, problem), "scale of all polygons"
    )
    yield lowered(outlines, SPACE | RATES | TIMES | {"arena"})
    yield raised(outlines, frozenset({"crossing", "cable_clearance", "separation"}))


def _starts(problem: Problem) -> Iterator[Kind]:
    """Yield drones on free cables that start farther apart, or closer together."""
    start = problem.start
    if not isinstance(start, DronesStart):
        return
    apart = Quantity(
        "start.drones",
        1.0,
        "times",
        partial(with_robots_apart, problem, start),
        "robots from their middle",
    )
    yield raised(apart, frozenset({"separation", "cable_clearance", "crossing"}))
    drawn = Quantity(
        "start.drones",
        1.0,
        "times",
        partial(with_robots_drawn, problem, start),
        "two drones of a robot",
    )
    yield lowered(drawn, frozenset({"span"}))


def _with_cable(problem: Problem, k: int, length: float) -> Edited:
    lengths = problem.team.cable_length.copy()
    lengths[k] = length
    return with_cables(problem, lengths)


def _named(violations: Sequence[Violation], robots: int) -> list[int]:
    """Return the indices in names such as q0, r-leg 2, cable 1; those of vertices are none."""
    found = [
        int(match[1])
        for violation in violations
        for name in violation.where
        if (match := re.fullmatch(r"(?:q|r|q-leg |r-leg |cable |edge )(\d+)", name))
    ]
    return [k for k in dict.fromkeys(found) if k < robots][:MOST_NAMED]


def _tensions(problem: Problem, violations: Sequence[Violation]) -> Iterator[Kind]:
    """Yield lower tensions: of single cables that are named, where they differ, and of all."""
    covers = frozenset({"thrust", "tilt"})
    tensions = problem.team.tension
    same = bool(np.all(tensions == tensions[0]))
    for k in [] if same else _named(violations, len(tensions)):
        one = Quantity(
            f"team.tension[{k}]",
            float(tensions[k]),
            "N",
            partial(_with_tension, problem, k),
            "one tension",
        )
        # Tensions that differ turn legs, so that an odd one may be what brings drones together.
        yield replace(lowered(one, covers | SPACE | {"crossing"}), family="one tension")
    if same:
        yield lowered(
            Quantity(
                "team.tension",
                float(tensions[0]),
                "N",
                lambda new: with_tensions(problem, np.full(len(tensions), new)),
            ),
            covers,
        )
    else:
        yield lowered(
            Quantity(
                "team.tension",
                1.0,
                "times",
                lambda factor: with_tensions(problem, tensions * factor),
                "all tensions",
            ),
            covers,
        )


def _with_tension(problem: Problem, k: int, tension: float) -> Edited:
    tensions = problem.team.tension.copy()
    tensions[k] = tension
    return with_tensions(problem, tensions)
