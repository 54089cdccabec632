"""One record per check: its quantity, when it applies, how it is found, and what eases it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.certificate import Check, most_pressing, within
from hitchopt.checks.spans import MotionSpans
from hitchopt.motion.motion import CableState, Motion
from hitchopt.trajectory.enclosed import Bound
from hitchopt.trajectory.search import batches, worst
from hitchopt.values import Array

S = TypeVar("S", bound=MotionSpans)


@dataclass(frozen=True)
class Finding:
    """The worst value that a finder has found; it bounds the quantity for all t.

    The quantity is about at its worst at ``time`` [s] and ``where``: the names of drones, cables or
    vertices. ``size`` is the largest length that enters it, as in ``within``, and ``limit`` that of
    whoever is worst where it is not the rule's, as drones have limits of their own.
    """

    worst: float
    time: float
    where: tuple[str, ...] = ()
    size: float = 1.0
    limit: float | None = None

    def check(
        self, rule: CheckRule | ReportRule, limit: float | None, gamma: float | None = None
    ) -> Check:
        """Return the check of a rule."""
        limit = limit if self.limit is None else self.limit
        found = (self.worst, limit, rule.sense, rule.unit, self.time, self.where, self.size, gamma)
        return Check.of(rule.name, *found)


@dataclass(frozen=True, eq=False)
class Searched(Generic[S]):
    """A finder of a formula's worst value over spans of a motion.

    On spans of no length the ``formula`` is the quantity's value. ``sense`` and ``size`` are as in
    ``Check`` and ``Finding``. The items may have limits of their own (items,), of which the formula
    is the ``share``.
    """

    over: type[S]
    formula: Callable[[S], Bound]
    sense: str
    size: float | Callable[[Motion], float] = 1.0
    share: Callable[[Motion], Array] | None = None

    def __call__(self, motion: Motion, limit: float) -> Finding:
        """Return the worst value of a motion."""
        limits = None if self.share is None else self.share(motion)
        size = self.size(motion) if callable(self.size) else self.size
        aim = within(limit if limits is None else 1.0, self.sense, size, 0.5)
        found = worst(self.over.of(motion), self.formula, self.sense, target=aim)
        if found.item < 0:
            return Finding(found.worst, 0.0)
        own = None if limits is None else float(limits[found.item])
        value = found.worst * (1.0 if own is None else own)
        return Finding(value, found.time, (self.over.names(motion)[found.item],), size, own)

    def curve(self, motion: Motion, times: Array) -> Array:
        """Return the formula's worst value over all items at times (samples,) [s]."""
        breaks, items = motion.drones.breaks, len(self.over.names(motion))
        piece = np.clip(np.searchsorted(breaks, times, side="right") - 1, 0, len(breaks) - 2)
        x = np.clip((times - breaks[piece]) / motion.drones.durations[piece], 0.0, 1.0)
        every = np.tile(np.arange(items), len(times))
        spans = self.over(motion, breaks, np.repeat(piece, items), every)
        points = batches(spans.at(np.repeat(x, items)))
        values = np.concatenate([self.formula(batch).value for batch in points])
        worst_of = np.max if self.sense == "max" else np.min
        return np.asarray(worst_of(values.reshape(-1, items), axis=1))


@dataclass(frozen=True, eq=False)
class Finder:
    """Finds a check's quantity, against a limit, on each run of pieces with cables in some states.

    Where ``exported``, curves in exported files are held against the limit as well. ``shown`` is
    what the documentation shows of the code besides a formula that is searched.
    """

    find: Callable[[Motion, float], Finding]
    states: Set[CableState] = frozenset(CableState)
    exported: bool = False
    shown: tuple[object, ...] = ()


class Found(NamedTuple):
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
    ease: the kind of change that repairs try: ``time`` (slower or shorter motion), ``length`` (of
        legs) or ``tension`` (lower, or less weight); empty for none.
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
    ease: str = ""
    derivative: int = 0
    whole: bool = False
    exported_limit: float | None = None

    def limit_of(self, motion: Motion) -> float | None:
        """Return the limit for a motion; None where the rule has nothing to check in it."""
        here = motion.cable_states
        if all(here.isdisjoint(finder.states) for finder in self.finders):
            return None
        return self.limit(motion) if callable(self.limit) else self.limit

    def check(self, motion: Motion, *, exported: bool = False) -> Check | None:
        """Return the worst over all spans of time in which the rule applies; None without any.

        Where ``exported``, the finders and the limit for exported curves are applied.
        """
        return most_pressing(found.check for found in self.findings(motion, exported=exported))

    def findings(self, motion: Motion, *, exported: bool = False) -> tuple[Found, ...]:
        """Return what is found on all spans of time in which the rule applies."""
        limit, here = self.limit_of(motion), motion.cable_states
        if limit is None:
            return ()
        limit = self.exported_limit if exported and self.exported_limit is not None else limit
        return tuple(
            Found(finder.states, finder.find(span, limit).check(self, limit))
            for finder in self.finders
            if (finder.exported or not exported) and not here.isdisjoint(finder.states)
            for span in ((motion,) if here <= finder.states else motion.spans(finder.states))
        )


Findings = Mapping[str, Sequence[Found]]
"""What has been found on a motion, by the rules' names."""


@dataclass(frozen=True, eq=False)
class ReportRule:
    """What a certificate reports: a motion, its findings and ``gamma`` tell it.

    There is no limit unless a motion's requirements state one, which is always checked then, and
    has remedies.

    A joined motion has to be looked at anew as a ``whole`` where its parts do not tell of what
    begins in one and ends in the next. Such a value assumes no ``gamma``.
    """

    name: str
    unit: str
    sense: str
    find: Callable[[Motion, Findings, float], Finding]
    whole: bool = False
    limit: Callable[[Motion], float | None] = lambda _: None
    remedy: str = ""
    free_remedy: str = ""

    def check(self, motion: Motion, found: Findings, gamma: float) -> Check:
        """Return the value as a check, which holds if it is only reported."""
        limit, told = self.limit(motion), None if self.whole else gamma
        return self.find(motion, found, gamma).check(self, limit, told)
