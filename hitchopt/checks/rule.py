"""One record per check: its quantity, when it applies, how it is found, and what eases it."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass
from enum import Enum, auto

from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.motion.motion import CableState, Motion


class Ease(Enum):
    """Kinds of change that ease checks."""

    NOTHING = auto()
    TIME = auto()
    """Slower or shorter motion."""
    LENGTH = auto()
    """Longer legs."""
    TENSION = auto()
    """Lower tensions, or less weight."""


@dataclass(frozen=True)
class Finding:
    """The worst value that a finder has found.

    Attributes
    ----------
    worst: bounds the quantity for all t, rounding included.
    time: [s], when the quantity is about at its worst.
    where: names of the drones, cables or vertices.
    size: the largest length that enters the quantity, in its unit, as in ``within``.
    limit: where it is not the rule's, as drones have limits of their own.
    """

    worst: float
    time: float
    where: tuple[str, ...] = ()
    size: float = 1.0
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class Finder:
    """A function that finds a check's quantity while cables are in certain states.

    Attributes
    ----------
    find: returns the worst value of a motion, given the limit that it is held against.
    states: of the cables; ``find`` looks at each run of pieces in these.
    exported: whether curves in exported files are held against the limit as well.
    """

    find: Callable[[Motion, float], Finding]
    states: Set[CableState] = frozenset(CableState)
    exported: bool = False


@dataclass(frozen=True, eq=False)
class CheckRule:
    """What the certificate checks, and all that others have to know of it.

    Attributes
    ----------
    name, unit, sense: as in ``Check``.
    limit: the limit, or the function that returns a motion's; None where nothing is to be checked.
    finders: for cables in different states.
    remedy: what a user can change.
    free_remedy: the same while there is no hitch, where it differs.
    ease: which kind of change repairs try.
    derivative: the highest derivative of positions by time that enters the quantity. It means
        nothing where the one below jumps, and slower motion eases whatever has one.
    whole: whether a joined motion has to be checked anew, its parts not telling of the joints.
    exported_limit: holds for exported curves in place of the limit.
    """

    name: str
    unit: str
    sense: str
    limit: float | Callable[[Motion], float | None]
    finders: tuple[Finder, ...]
    remedy: str = "this plan must not be flown; please report it"
    free_remedy: str = ""
    ease: Ease = Ease.NOTHING
    derivative: int = 0
    whole: bool = False
    exported_limit: float | None = None

    def limit_of(self, motion: Motion) -> float | None:
        """Return the limit for a motion; None where the rule has nothing to check in it."""
        if all(motion.cable_states.isdisjoint(finder.states) for finder in self.finders):
            return None
        return self.limit(motion) if callable(self.limit) else self.limit

    def check(self, motion: Motion, *, exported: bool = False) -> Check | None:
        """Return the worst over all spans of time in which the rule applies; None without any.

        Parameters
        ----------
        motion: the plan.
        exported: apply the finders and the limit for exported curves.
        """
        limit = self.limit_of(motion)
        if limit is None:
            return None
        if exported and self.exported_limit is not None:
            limit = self.exported_limit
        found = [
            finder.find(span, limit)
            for finder in self.finders
            if finder.exported or not exported
            for span in motion.spans(finder.states)
        ]
        return most_pressing([self._check(finding, limit) for finding in found])

    def _check(self, found: Finding, limit: float) -> Check:
        limit = limit if found.limit is None else found.limit
        given = (found.worst, limit, self.sense, self.unit, found.time, found.where, found.size)
        return Check.of(self.name, *given)
