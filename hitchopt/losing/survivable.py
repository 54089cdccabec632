"""Report ``survivable``: the share of (drone, time) with a certified reaction to its loss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check
from hitchopt.errors import InfeasibleError
from hitchopt.losing.reaction import Reactions
from hitchopt.motion.motion import Motion
from hitchopt.one_line import OneLine
from hitchopt.time_limit import Progress
from hitchopt.values import Array, positive

EVERY = 1.0
"""[s] Usual distance of the times that are looked at."""

LEAST = 8
"""Smallest number of them."""


@dataclass(frozen=True)
class Lost(OneLine):
    """A span of a plan in which the loss of a drone has no certified reaction.

    Attributes
    ----------
    drone: its name.
    start, end: [s], half-way to the neighbouring times that were looked at.
    reason: why there is none, at its first time.
    """

    drone: str
    start: float
    end: float
    reason: str


@dataclass(frozen=True, eq=False)
class Survivable(OneLine):
    """Reactions over all of a plan, at sampled times.

    Attributes
    ----------
    t: (k,) [s]
    covered: (k, D), whether there is a reaction.
    without: spans without one, by drone and time.
    """

    t: Array
    covered: NDArray[np.bool_]
    without: tuple[Lost, ...]

    @property
    def share(self) -> float:
        """Share of (drone, time) with a reaction."""
        return float(np.mean(self.covered))

    @property
    def check(self) -> Check:
        """The share as a certificate lists it; it is sampled, not a bound for all of the time."""
        worst = self.without[0] if self.without else None
        time = 0.0 if worst is None else worst.start
        where = tuple(dict.fromkeys(lost.drone for lost in self.without))
        return Check("survivable", True, self.share, None, "min", "1", time, where, "sampled")


def survivable(
    motion: Motion, every: float = EVERY, progress: Progress | None = None
) -> Survivable:
    """Return which losses of a drone have a certified reaction, about ``every`` [s].

    Raises
    ------
    InputError: a distance that is not positive.
    """
    reactions, names = Reactions(motion), motion.team.drone_names
    count = max(LEAST, round(motion.duration / positive("every", every)))
    edges = np.linspace(0.0, motion.duration, count + 1)
    t = 0.5 * (edges[1:] + edges[:-1])
    reasons: list[list[str]] = []
    for time in t.tolist():
        if progress is not None:
            progress(f"losses at t = {time:.4g} s")
        reasons.append([_reason(reactions, name, time) for name in names])
    without = []
    for drone, name in enumerate(names):
        begun: tuple[float, str] | None = None
        for i, row in enumerate([*reasons, [""] * len(names)]):
            if row[drone] and begun is None:
                begun = edges[i], row[drone]
            elif not row[drone] and begun is not None:
                without.append(Lost(name, float(begun[0]), float(edges[i]), begun[1]))
                begun = None
    covered = np.array([[not reason for reason in row] for row in reasons])
    return Survivable(t, covered, tuple(without))


def _reason(reactions: Reactions, name: str, time: float) -> str:
    """Return why there is no reaction; nothing where there is one."""
    try:
        reactions.found(name, time)
    except InfeasibleError as error:
        return str(error)
    return ""
