"""The morphs that every solver of a benchmark gets, both of their hitches given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import hitchopt as ho
from benchmarks.morph import problem

TURN = 0.3
"""[rad] Of the turned morph, or less where its vertices would go farther than TRAVEL."""

TRAVEL = 0.6
"""[m]"""

KINDS = ("scaled", "turned")


@dataclass(frozen=True, eq=False)
class Task:
    """One morph of a regular n-gon at an altitude of 1 m.

    Attributes
    ----------
    start, end: hitches at rest.
    limits, separation: what is kept on the way.
    """

    start: ho.Hitch
    end: ho.Hitch
    limits: ho.Limits
    separation: ho.Separation

    @property
    def robots(self) -> int:
        """How many cables, n."""
        return self.start.team.robots


def make_task(kind: str, n: int) -> Task:
    """Return the task of a kind: ``scaled`` and shifted (``morph.problem``), or ``turned``.

    The end's legs are those that ``ho.morph`` chooses where it is told nothing.
    """
    start, goal, separation = problem(n)
    if kind == "turned":
        radius = 0.65 / np.sin(np.pi / n)
        goal = ho.regular_polygon(n, 1.3).rotated(min(TURN, TRAVEL / radius))
    limits = ho.Limits()
    end = ho.Hitch.nearest(
        start.team, goal, 1.0, start.fractions, limits=limits, separation=separation
    )
    return Task(start, end, limits, separation)
