"""Custom rules: limits on quantities of drones, vertices or clasps, certified for all t.

A rule is a formula over spans, like every check. ``hitchopt verify`` has no formula for it and
does not prove it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from hitchopt.checks.certificate import CUSTOM, Check
from hitchopt.checks.clasps import clasp_names
from hitchopt.checks.drones import Drones, Points
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase, WorstOverSpans
from hitchopt.checks.spans import MotionSpans, leg_vectors
from hitchopt.errors import InputError, OneLine
from hitchopt.motion.motion import Motion
from hitchopt.motion.stated_rules import StatedRule
from hitchopt.trajectory.enclosed import Angle, Bound, Enclosed
from hitchopt.values import ByValue, Indices, check_instance, line, sequence
from hitchopt.values.fields import with_suggestions

OPERATIONS = (
    *("+", "-", "*", "dot", "cross", "norm", "direction", "inverse", "root", "xy"),
    *("components such as [2]", "angle_to"),
)
"""Arithmetic with enclosed values."""

REMEDY = "change the steps, or the limit of this rule"


class RuleSpans(OneLine, MotionSpans):
    """Spans of items that rules are evaluated for."""

    of_hitch: ClassVar[bool] = False  # Whether the items exist only while the hitch does

    def _parts(self) -> Iterator[str]:
        yield f"{len(self)} spans"


class DroneSpans(RuleSpans, Drones):
    """Spans of drones, at all times.

    ``thrust`` is their thrust [N], a vector, and ``load`` minus the force of the cable [N].
    """

    @property
    def position(self) -> Enclosed:
        """Position [m]."""
        return self.motion_rate(0)

    @property
    def velocity(self) -> Enclosed:
        """Velocity [m/s]."""
        return self.motion_rate(1)

    @property
    def acceleration(self) -> Enclosed:
        """Acceleration [m/s²]."""
        return self.motion_rate(2)


class VertexSpans(RuleSpans, Points):
    """Spans of the hitch's vertices, while it exists."""

    of_hitch = True

    @property
    def position(self) -> Enclosed:
        """Position [m]."""
        return self.derivative(self.source.vertices, 0)

    @property
    def velocity(self) -> Enclosed:
        """Velocity [m/s]."""
        return self.derivative(self.source.vertices, 1)

    @property
    def acceleration(self) -> Enclosed:
        """Acceleration [m/s²]."""
        return self.derivative(self.source.vertices, 2)


class ClaspSpans(RuleSpans):
    """Spans of clasps, the vertices at which two cables meet, while the hitch exists."""

    of_hitch = True
    names = staticmethod(clasp_names)

    @property
    def position(self) -> Enclosed:
        """Position [m]."""
        points = self.source.team.layout.clasps[self.item]
        return Enclosed(self.read(self.source.vertices.coefficients, points), self.noise)

    @property
    def q_leg(self) -> Enclosed:
        """Vector [m] to the drone q of the cable whose edge starts here."""
        return self._leg(2 * self.source.team.layout.ahead)

    @property
    def r_leg(self) -> Enclosed:
        """Vector [m] to the drone r of the cable whose edge ends here."""
        return self._leg(2 * self.source.team.layout.behind + 1)

    def _leg(self, drones: Indices) -> Enclosed:
        """Return the legs to one drone of each clasp, (clasps,)."""
        return Enclosed(self.read(leg_vectors(self.source), drones[self.item]), self.noise)


S = TypeVar("S", bound=RuleSpans)


@with_suggestions
@dataclass(frozen=True, eq=False)
class Rule(ByValue, Generic[S]):
    """A custom limit, certified for all t like those of hitchopt.

    The formula is arithmetic with enclosed values: ``+``, ``-``, ``*``, ``dot``, ``cross``,
    ``norm``, ``direction``, ``inverse``, ``root``, ``xy``, components such as ``[2]``, and
    ``angle_to``. It must not extract plain numbers from them, which lose the enclosure.
    Vectors that may vanish have no direction: the bounds of their angles are 0 and 180 degrees.

    Every team is evaluated on its own, without tracking errors; external plans are not.

    Attributes
    ----------
    name: lower-case letters, digits and _, such as ``leg_angle``; not that of a check.
    unit: such as ``deg``; ``1`` for ratios.
    sense: ``min`` if the limit is a lower bound, ``max`` if it is an upper bound.
    limit: in that unit.
    over: the items that it limits: ``DroneSpans``, ``VertexSpans`` or ``ClaspSpans``.
    formula: returns the quantity of such spans, a scalar or an angle [deg].
    remedy: suggested change where it is violated.

    Raises
    ------
    InputError: an argument is invalid; raised in ``certify`` if the formula does not return an
    enclosed scalar.
    """

    name: str
    unit: str
    sense: str
    limit: float
    over: type[S]
    formula: Callable[[S], Enclosed | Angle]
    remedy: str = REMEDY

    def __post_init__(self) -> None:
        stated = StatedRule(self.name, self.unit, self.sense, self.limit)  # checks the arguments
        object.__setattr__(self, "limit", stated.limit)
        over: Any = self.over
        if not (isinstance(over, type) and issubclass(over, RuleSpans)):
            names = "hitchopt.DroneSpans, hitchopt.VertexSpans or hitchopt.ClaspSpans"
            raise InputError("over", over, names, "pass one of these classes")
        if not callable(self.formula):
            remedy = "pass a function of the spans"
            raise InputError("formula", self.formula, "a function", remedy)
        line("remedy", self.remedy)  # checks it

    @property
    def check_rule(self) -> CheckRule:
        """The check rule with which certificates evaluate it."""
        worst = WorstOverSpans(self.over, self._bound, self.sense)
        evaluators = (Evaluator(worst, lambda state: state.hitched or not self.over.of_hitch),)
        return CheckRule(
            self.name, self.unit, self.sense, self.limit, evaluators, self.remedy, group=CUSTOM
        )

    def check(self, motion: Motion) -> Check:
        """Return the check of one team's motion.

        If no item exists at any time, the worst value is the extremum of an empty set, and the
        check holds.
        """
        check = self.check_rule.check(motion)
        if check is None:
            empty = math.inf if self.sense == "min" else -math.inf
            check = WorstCase(empty, 0.0).check(self.check_rule, self.limit)
        return check

    def _bound(self, spans: S) -> Bound:
        """Return the bound of the formula's value; raise InputError if it is not one number."""
        try:
            quantity = self.formula(spans)
        except AttributeError as error:  # of a value that spans or enclosed numbers do not have
            names = [name for name, value in vars(self.over).items() if isinstance(value, property)]
            remedy = f"values of {self.over.__name__} are {', '.join(names)}"
            raise InputError(f"{self.name}.formula", error, "a formula", remedy) from error
        except (TypeError, ValueError, IndexError) as error:  # of an operation they do not have
            remedy = f"use {', '.join(OPERATIONS)}; numpy's functions do not take enclosed values"
            raise InputError(f"{self.name}.formula", error, "a formula", remedy) from error
        scalar: Any = quantity.cosine if isinstance(quantity, Angle) else quantity
        if not isinstance(scalar, Enclosed):
            remedy = "use arithmetic on the values of the spans; do not extract plain numbers"
            raise InputError(f"{self.name}.formula", quantity, "an enclosed scalar", remedy)
        if scalar.c.shape[:-1] != (len(spans), 1):
            bound = f"({len(spans)}, 1), one number for each span"
            remedy = "return a norm, a scalar product, a component such as value[2] or an angle"
            shape = f"of shape {scalar.c.shape[:-1]}"
            raise InputError(f"{self.name}.formula", shape, bound, remedy)
        return quantity.lower if self.sense == "min" else quantity.upper


def checked_rules(rules: Iterable[Rule[Any]], taken: Sequence[str]) -> tuple[Rule[Any], ...]:
    """Return rules as a tuple; raise InputError unless their names are unique and not taken."""
    entries: tuple[Rule[Any], ...] = sequence("rules", rules)
    names = list(taken)
    for index, rule in enumerate(entries):
        check_instance(f"rules[{index}]", rule, Rule)
        if rule.name in names:
            bound = "different from the names of other checks"
            raise InputError(f"rules[{index}].name", rule.name, bound, "rename the rule")
        names.append(rule.name)
    return entries
