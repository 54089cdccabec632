"""The smallest roll of legs out of their plane that separates drones and cables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegLengths, LegTask
from hitchopt.values import Array

MARGIN_ERROR = 5e-7
"""Relative error of a margin that a roll suffices for, since programs are solved inexactly."""

CANDIDATES = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0))
"""[rad] Rolls in ascending order, of which the first sufficient one is refined. Simulated clasps
hold up to 60°."""

OTHER_LENGTHS_RATIO = 0.9
"""Roll at which other leg lengths must suffice, over the one that the reference needs."""


@dataclass(frozen=True)
class RollSearch:
    """A search of the smallest roll with which leg lengths keep a task's margins."""

    margin_of: Callable[[LegTask], float]  # Returns the margin of the leg lengths with a roll
    candidates: tuple[float, ...]  # [rad] Rolls in ascending order
    # Number of bisections that refine the first sufficient one, down to the one before
    bisections: int

    def least(self, task: LegTask, sign: float) -> float | None:
        """Return the smallest roll [rad] that suffices, of a sign; None if no candidate does.

        Rolls with which clasps have no balance do not suffice.
        """

        def suffices(angle: float) -> bool:
            """Return whether all margins are kept."""
            rolled = replace(task, roll=sign * angle)
            margin = if_balanced(partial(self.margin_of, rolled), -math.inf)
            return margin >= task.largest_margin * (1.0 - MARGIN_ERROR)

        upper = next((angle for angle in self.candidates if suffices(angle)), None)
        if upper is None:
            return None
        lower = max((angle for angle in self.candidates if angle < upper), default=0.0)
        for _ in range(self.bisections):
            middle = 0.5 * (lower + upper)
            if suffices(middle):
                upper = middle
            else:
                lower = middle
        return sign * upper


OF_REFERENCE = RollSearch(LegTask.reference_margin, CANDIDATES, bisections=7)
"""The search with the task's reference lengths."""

OF_OTHER_LENGTHS = RollSearch(
    LegTask.margin_near_reference, (CANDIDATES[3], CANDIDATES[5]), bisections=3
)
"""The search with other lengths, each of which takes convex programs."""


def least_roll(task: LegTask) -> float | None:
    """Return the smallest roll [rad] with which the reference keeps the margins; None without."""
    return OF_REFERENCE.least(task, 1.0)


def split_with_least_roll(task: LegTask) -> tuple[LegLengths, Array | float]:
    """Return leg lengths on one polygon and their roll [rad].

    The task's initial roll, or none, applies if the limits hold with it. Otherwise the smallest one
    applies that keeps the task's margin, or else the limits, with the reference lengths or others;
    if none does, the initial roll. Rolls have the sign of the initial roll, positive without one.
    """
    initial = 0.0 if task.roll is None else task.roll
    split = task.split()
    if split.margin >= 1.0:
        return split, initial
    sign = -1.0 if np.sum(initial) < 0.0 else 1.0
    for margin in dict.fromkeys((task.largest_margin, LIMIT_MARGIN)):
        with_margin = replace(task, margin=margin)
        roll = _least_of_any_lengths(with_margin, sign)
        if roll is not None:
            return replace(with_margin, roll=roll).split(), roll
    return split, initial


def _least_of_any_lengths(task: LegTask, sign: float) -> float | None:
    """Return the smallest roll [rad] that suffices for the reference or for other leg lengths."""
    of_reference = OF_REFERENCE.least(task, sign)
    search = OF_OTHER_LENGTHS
    if of_reference is not None:
        search = replace(search, candidates=(OTHER_LENGTHS_RATIO * abs(of_reference),))
    of_others = search.least(task, sign)
    return of_reference if of_others is None else of_others
