"""One record per check: its quantity, when it applies, how it is found, and what eases it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
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
class Found:
    """The check of one span of time, in which cables are in one of ``states``."""

    states: Set[CableState]
    check: Check


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
    far_remedy: the remedy for bodies of a hitch that share no clasp, where it differs.
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
    far_remedy: str = ""

    def limit_of(self, motion: Motion) -> float | None:
        """Return the limit for a motion; None where the rule has nothing to check in it."""
        here = motion.cable_states
        if all(here.isdisjoint(finder.states) for finder in self.finders):
            return None
        return self.limit(motion) if callable(self.limit) else self.limit

    def check(self, motion: Motion, *, exported: bool = False) -> Check | None:
        """Return the worst over all spans of time in which the rule applies; None without any.

        Parameters
        ----------
        motion: the plan.
        exported: apply the finders and the limit for exported curves.
        """
        return most_pressing(found.check for found in self.findings(motion, exported=exported))

    def findings(self, motion: Motion, *, exported: bool = False) -> tuple[Found, ...]:
        """Return what is found on all spans of time in which the rule applies."""
        here = motion.cable_states
        finders = [
            finder
            for finder in self.finders
            if (finder.exported or not exported) and not here.isdisjoint(finder.states)
        ]
        if not finders:
            return ()
        limit = self.limit(motion) if callable(self.limit) else self.limit
        if limit is None:
            return ()
        if exported and self.exported_limit is not None:
            limit = self.exported_limit
        return tuple(
            Found(finder.states, self._check(finder.find(span, limit), limit))
            for finder in finders
            for span in ((motion,) if here <= finder.states else motion.spans(finder.states))
        )

    def _check(self, found: Finding, limit: float) -> Check:
        limit = limit if found.limit is None else found.limit
        given = (found.worst, limit, self.sense, self.unit, found.time, found.where, found.size)
        return Check.of(self.name, *given)


Findings = Mapping[str, Sequence[Found]]
"""What has been found on a motion, by the rules' names."""


@dataclass(frozen=True, eq=False)
class ReportRule:
    """What a certificate reports without a limit, given what its checks have found.

    Attributes
    ----------
    name, unit, sense: as in ``Check``.
    find: returns the worst value of a motion; with the findings and ``gamma`` of ``Check``.
    whole: whether a joined motion has to be looked at anew, its parts not telling of what begins in
        one and ends in the next. Such a value assumes no ``gamma``.
    """

    name: str
    unit: str
    sense: str
    find: Callable[[Motion, Findings, float], Finding]
    whole: bool = False

    def check(self, motion: Motion, found: Findings, gamma: float) -> Check:
        """Return the value as a check that holds."""
        worst = self.find(motion, found, gamma)
        return Check.of(
            self.name,
            worst.worst,
            None,
            self.sense,
            self.unit,
            worst.time,
            worst.where,
            gamma=None if self.whole else gamma,
        )
