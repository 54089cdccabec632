"""Rows of ``verify`` by some of its functions alone, which is sooner than all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.verify import cables, consistency, links, objects, teams, tying

Rows = Callable[..., Iterator[second.Row]]
OF_WHOLE: set[Rows] = {consistency.jumps, links.interlacing}
OF_TAUT: set[Rows] = {cables.taut_cables}
OF_BODIES: set[Rows] = {
    *(objects.resting, objects.gripped, objects.steady, objects.clear_objects),
}
OF_PAIRS: set[Rows] = {teams.between_plans, teams.object_distances, teams.arc_distances}

TAUT = (cables.taut_cables,)
ROWS: dict[str, tuple[Rows, ...]] = {
    "interlacing": (links.interlacing,),
    "continuity": (consistency.jumps,),
    "consistency": (consistency.consistency,),
    **dict.fromkeys(("cable_length", "equilibrium", "contact"), TAUT),
    "crossing": (*TAUT, teams.between_plans),
    "tension": (consistency.jumps, cables.taut_cables, tying.free_cables),
    "span": (tying.free_cables,),
    "grip": (objects.gripped,),
    "yaw": (objects.steady,),
    "wrap": (objects.gripped,),
    "bend": (cables.taut_cables,),
}
"""Functions of ``verify`` that have the rows of a limit."""


def opinion_of(flown: Motion | Flight, folder: Path, *functions: Rows) -> Iterator[second.Row]:
    """Write a plan, and yield the rows of functions, or all."""
    write_plan(folder / "plan.npz", Flight.of(flown))
    return opinion(folder / "plan.npz", *functions) if functions else second.verify(folder)


def opinion(path: Path, *functions: Rows) -> Iterator[second.Row]:
    """Yield the rows of functions for what they take: plans, bodies or pairs."""
    own, others = second.read(path)
    for rows in functions:
        if rows in OF_WHOLE:
            yield from chain(*map(rows, own))
        elif rows in OF_TAUT:
            yield from chain(*(rows(p) for p in own if np.any(p.formed)))
        elif rows in OF_BODIES:
            yield from chain(*(rows(p, b) for p in own for b in range(len(p.bodies))))
        elif rows in OF_PAIRS:
            for p, q in combinations([*own, *others], 2):
                if p in own:
                    yield from chain(*map(rows, _pairs(p, q, own, rows)))
        else:
            yield from chain(*map(rows, own))


def _pairs(p: Any, q: Any, own: list[Any], rows: Rows) -> Iterator[teams.Pair]:
    """Yield a pair of plans, for objects in both orders."""
    keys = p.settings["separation"]
    wide = {key: max(each.settings["separation"][key] for each in own) for key in keys}
    off = max(each.tube[0] for each in own), max(each.tube[1] for each in own)
    yield teams.Pair(p, q, wide, off)
    if rows is not teams.between_plans:
        yield teams.Pair(q, p, wide, off)


def violated(rows: Iterable[second.Row]) -> set[str]:
    """Return the limits of rows that are violated."""
    return {row.name for row in rows if row.verdict == "violated"}


def is_proven(plan: ho.Plan, folder: Path) -> bool:
    """Return whether ``hitchopt verify`` proves every limit of a plan."""
    plan.save(folder)
    return all(row.verdict in second.PASSING for row in second.verify(folder))
