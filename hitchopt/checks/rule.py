"""One record per check: its quantity, when it applies, how it is evaluated, and its remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.certificate import (
    BINDING,
    CONTINUOUS,
    OTHER,
    Check,
    empty_value,
    with_tolerance,
    worst_of,
)
from hitchopt.checks.spans import MotionSpans, runs_of
from hitchopt.hitch.pairs import Bodies
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import StateTest
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.enclosed import Bound
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

S = TypeVar("S", bound=MotionSpans)


@dataclass(frozen=True)
class WorstCase:
    """The worst value of a quantity, a bound for all t, with its time and location.

    The quantity is close to it at ``time`` [s] and ``where``, names of drones, cables or vertices.
    ``size`` is the largest length that enters, as in ``with_tolerance``. ``limit`` replaces the
    rule's limit if items such as drones have their own limits. ``binding`` is the name of the check
    that determines the quantity, if it follows from several. ``unit`` replaces the rule's unit.
    ``binds_within`` is as in ``Check``.
    """

    worst: float
    time: float
    where: tuple[str, ...] = ()
    size: float = 1.0
    limit: float | None = None
    binding: str = ""
    unit: str = ""
    binds_within: float = BINDING

    def check(self, quantity: Quantity, limit: float | None, gamma: float | None = None) -> Check:
        """Return the check of a quantity."""
        return Check.of(
            quantity.name,
            self.worst,
            limit if self.limit is None else self.limit,
            quantity.sense,
            self.unit or quantity.unit,
            self.time,
            self.where,
            self.size,
            gamma,
            self.binding,
            group=quantity.group,
            is_error=quantity.is_error,
            derivative=quantity.derivative,
            binds_within=self.binds_within,
            method=quantity.method,
        )


def worst_at_joint(values: Array, times: Array, names: Sequence[str]) -> WorstCase:
    """Return the largest of values (joints, items) at times (joints or more,) [s].

    Without any, it is minus infinity: there is nothing to check.
    """
    if values.size == 0:
        return WorstCase(-math.inf, float(times[0]))
    joint, item = np.unravel_index(int(np.argmax(values)), values.shape)
    largest = float(values[joint, item])
    where = (names[int(item)],) if largest > 0.0 else ()
    return WorstCase(largest, float(times[joint]), where)


def accumulated(jumps: Array, rounding: float) -> Array:
    """Return jumps (…, joints, items), with the largest one of every item replaced by their sum.

    Jumps up to ``rounding`` are rounding and do not add up.
    """
    if jumps.size == 0:
        return jumps
    largest = np.arange(jumps.shape[-2])[:, None] == jumps.argmax(axis=-2, keepdims=True)
    total = np.add.reduce(np.where(jumps > rounding, jumps, 0.0), axis=-2, keepdims=True)
    return np.asarray(np.where(largest, np.maximum(total, jumps), jumps))


@dataclass(frozen=True, eq=False)
class WorstOverSpans(Generic[S]):
    """Evaluate a formula's worst value over spans of a motion.

    On spans of no length, the ``formula`` gives the quantity's value. ``sense`` and ``size`` are as
    in ``Check`` and ``WorstCase``. If items have their own limits, ``item_limits`` (items,), the
    formula gives the utilization of these.
    """

    spans: type[S]
    formula: Callable[[S], Bound]
    sense: str
    size: float | Callable[[Motion], float] = 1.0
    item_limits: Callable[[Motion], Array] | None = None

    def shares(self, spans: S, limit: float) -> Array:
        """Return the largest values on spans (spans,) over the limit."""
        return self.formula(spans).value / (limit if self.item_limits is None else 1.0)

    def __call__(self, motion: Motion, limit: float) -> WorstCase:
        """Return the worst value of a motion."""
        limits = None if self.item_limits is None else self.item_limits(motion)
        size = self.size(motion) if callable(self.size) else self.size
        target = with_tolerance(limit if limits is None else 1.0, self.sense, size, 0.5)
        extremum = worst(self.spans.of(motion), self.formula, self.sense, target=target)
        if extremum.item < 0:
            return WorstCase(extremum.worst, 0.0)
        item_limit = None if limits is None else float(limits[extremum.item])
        value = extremum.worst * (1.0 if item_limit is None else item_limit)
        where = (self.spans.names(motion)[extremum.item],)
        return WorstCase(value, extremum.time, where, size, item_limit)


@dataclass(frozen=True, eq=False)
class Evaluator:
    """Evaluate a check's quantity on each run of pieces with cables in states to which it applies.

    ``evaluate`` takes the motion and the limit. If ``exported``, curves in exported files are
    checked as well. ``formulas`` is the code printed in the documentation, in addition to a formula
    of ``WorstOverSpans``. ``bodies`` are kinds of bodies as in ``CheckRule``, if it does not
    evaluate all of the rule's.
    """

    evaluate: Callable[[Motion, float], WorstCase]
    applies: StateTest = lambda _state: True
    exported: bool = False
    formulas: tuple[object, ...] = ()
    bodies: tuple[Bodies, ...] = ()


def largest_error(gamma: float) -> float:
    """Return the largest error of a body per radius of tracking errors."""
    return max(1.0, gamma)


class SpanResult(NamedTuple):
    """The check of a time span, of kinds of bodies; an evaluator ``applies`` to its states."""

    applies: StateTest
    check: Check
    bodies: tuple[Bodies, ...] = ()


def approach(bodies: Sequence[Bodies], gamma: float, *, hitched: bool) -> float:
    """Return the largest approach of two bodies per radius of tracking errors.

    Drones are within the radius of their plan, vertices and what they hold within ``gamma`` times
    the radius. Taut cables of a hitch end at both; without a hitch, cables have the errors of their
    drones.
    """
    of_hitch = largest_error(gamma)
    errors = {"drones": 1.0, "vertices": gamma, "held": of_hitch}
    errors["cables"] = of_hitch if hitched else 1.0
    pairs = [kinds for kinds in bodies if len(kinds) == 2]
    return max(sum(errors.get(kind, 0.0) for kind in pair) for pair in pairs)


REPORT_IT = "do not fly this plan; please report it"
"""Remedy of checks that plans violate only by a fault, or because they violate another one."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """What certificates, tables and the documentation say of a quantity."""

    name: str  # The name, as in ``Check``
    unit: str  # The unit, as in ``Check``
    sense: str  # ``min`` or ``max``, as in ``Check``
    _: KW_ONLY

    group: str = OTHER  # The heading in tables, as in ``Check``
    proves: str = ""  # What it bounds for all t, in the documentation
    unproven: str = ""  # What it does not prove, in the documentation
    key: str = ""  # The key of its limit in problem files; empty if the limit is fixed
    is_error: bool = False  # True if tables title it as an error
    derivative: int = 0
    """The highest time derivative of positions that enters the quantity; 0 for none. The quantity
    is undefined where the next lower derivative jumps, and decreases in slow motion."""

    method: str = CONTINUOUS  # The method, as in ``Check``


@dataclass(frozen=True, eq=False)
class CheckRule(Quantity):
    """A check of the certificate."""

    # The limit, or a function of a motion that returns it; None if there is nothing to check
    limit: float | Callable[[Motion], float | None]
    evaluators: tuple[Evaluator, ...]  # Evaluators for cables in different states
    remedy: str = REPORT_IT  # The suggested change
    free_remedy: str = ""  # The suggested change without a hitch, if different
    ease: str = ""
    """The kind of change that repairs try: ``time`` (slower or shorter motion, to which planners
    slow down by themselves), ``length`` (of legs) or ``tension`` (lower, or less weight); empty for
    none."""

    bodies: tuple[Bodies, ...] = ()
    """Kinds of the bodies that it limits, alone or in pairs that keep a distance. Tables of
    distances, tracking errors and repairs follow from them."""

    # True if a joined motion is checked as a whole, since its parts do not cover the joints
    whole: bool = False
    exported_share: float = 1.0  # The limit for exported curves, over that for planned ones
    exported_slack: float = 0.0  # By how much these may pass a lower limit
    # The suggested change at the start without a hitch, where users place drones, if different
    start_remedy: str = ""
    remedy_at: Callable[[Motion, Check], str] = lambda _motion, _check: ""
    """A function that returns the suggested change at a violated check of a hitch, if its geometry
    decides; empty for ``remedy``."""

    @property
    def pairs(self) -> tuple[Bodies, ...]:
        """Pairs of kinds of bodies that keep a distance."""
        return tuple(bodies for bodies in self.bodies if len(bodies) == 2)

    @property
    def limits_single_bodies(self) -> bool:
        """Return whether it limits bodies, and each of them alone."""
        return bool(self.bodies) and not self.pairs

    def limit_of(self, motion: Motion) -> float | None:
        """Return the limit for a motion; None if the rule does not apply to it."""
        for evaluator in self.evaluators:
            if any(map(evaluator.applies, motion.cable_states)):
                return self.limit(motion) if callable(self.limit) else self.limit
        return None

    def check(self, motion: Motion, *, exported: bool = False) -> Check | None:
        """Return the worst check over all time spans in which the rule applies; None without any.

        If ``exported``, only the evaluators and the limit for exported curves are used.
        """
        return worst_of(result.check for result in self.span_results(motion, exported=exported))

    def span_results(self, motion: Motion, *, exported: bool = False) -> tuple[SpanResult, ...]:
        """Return the check of every time span in which the rule applies."""
        limit = self.limit_of(motion)
        if limit is None:
            return ()
        if exported:
            limit = self.exported_share * limit - self.exported_slack
        results = list[SpanResult]()
        with np.errstate(all="ignore"):  # coefficients may have any value: nan fails a check
            for evaluator in self.evaluators:
                if exported and not evaluator.exported:
                    continue
                states = frozenset(filter(evaluator.applies, motion.cable_states))
                for span in runs_of(motion, states):
                    check = evaluator.evaluate(span, limit).check(self, limit)
                    bodies = evaluator.bodies or self.bodies
                    results.append(SpanResult(evaluator.applies, check, bodies))
        return tuple(results)


SpanResults = Mapping[CheckRule, Sequence[SpanResult]]  # Results of a motion's checks


@dataclass(frozen=True, eq=False)
class ReportRule(Quantity):
    """A quantity that a certificate reports, from a motion, its checks' results and ``gamma``.

    If the requirements state a limit, it is always checked, with remedies.
    """

    evaluate: Callable[[Motion, SpanResults, float], WorstCase | None]
    # The limit; None if it is not limited, infinity if its worst case states whether it is
    limit: Callable[[Requirements], float | None]
    remedy: str
    free_remedy: str
    assumes_gamma: bool = True
    has_default: bool = False  # Whether there is a limit that requirements need not state
    of_whole: bool = False  # Whether it depends on what flies before and after a part of a plan

    # Whether there is anything to evaluate in a motion
    applies: Callable[[Motion], bool] = lambda _motion: True

    def check(self, motion: Motion, results: SpanResults, gamma: float) -> Check | None:
        """Return the value of one team as a check, which holds without a limit.

        Without anything to evaluate, it is empty if there is a limit, and None otherwise. With a
        default limit, it is also None if the quantity does not apply.
        """
        if self.has_default and not self.applies(motion):
            return None
        with np.errstate(all="ignore"):
            worst_case = self.evaluate(motion, results, gamma)
        limit = self.limit(motion.requirements)
        limit = None if limit == math.inf else limit
        if worst_case is None:
            if limit is None:
                return None
            worst_case = WorstCase(empty_value(self.sense), 0.0)
        return worst_case.check(self, limit, gamma if self.assumes_gamma else None)


@dataclass(frozen=True, eq=False)
class FlightReport(Quantity):
    """A quantity of a whole flight that a certificate reports; it has no limit.

    A joined motion is evaluated as a whole, since processes may begin in one part and end in the
    next.
    """

    evaluate: Callable[[Flight], WorstCase]

    def check(self, flight: Flight) -> Check:
        """Return the value as a check, which holds."""
        with np.errstate(all="ignore"):
            return self.evaluate(flight).check(self, None)
