"""Trials: changes of a problem that were planned, and what they repair of its faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError, TimeIsUp, TimeLimitError, time_limit
from hitchopt.mission.solving import solve_problem
from hitchopt.planners.candidates import outcome
from hitchopt.repairs.changes import Change, broken_constraints, constraint_name

RELATIVE_TOLERANCE = 1e-3  # Largest relative change of a violation that counts as none


class Fault(NamedTuple):
    """What breaks a constraint in a step."""

    value: float  # The value, or its negative if the limit is an upper one: a smaller one is worse
    limit: float  # The limit


UNKNOWN_STEP = -1  # Index in place of an unknown step, before all others
Faults = Mapping[tuple[str, int], Fault]  # Faults by constraint and step


def faults_of(error: InfeasibleError) -> Faults:
    """Return the first fault of every constraint and step."""
    faults = dict[tuple[str, int], Fault]()
    for violation in error.violations:
        value = -violation.value if violation.sense == "max" else violation.value
        step = UNKNOWN_STEP if violation.step is None else violation.step
        place = constraint_name(violation), step
        faults.setdefault(place, Fault(value, violation.limit))
    return faults


def _first_step(faults: Faults) -> int:
    """Return the earliest step with a fault."""
    return min((step for _, step in faults), default=UNKNOWN_STEP)


@dataclass(frozen=True, eq=False)
class Trial:
    """A change that was planned: certified, infeasible, or failed for another reason."""

    change: Change  # The change
    before: Faults  # Faults of the problem without it
    duration: float | None = None  # Duration of the certified plan [s]; None without one
    # What the problem still breaks; None if it is certified, or if planning failed otherwise
    error: InfeasibleError | None = None
    given_up: bool = False  # Whether planning took longer than its time

    @classmethod
    def of(cls, change: Change, before: Faults, *, optimiser: bool, seconds: float) -> Trial:
        """Plan the problem with a change, within a time [s]."""
        try:
            with time_limit(seconds):
                plan = outcome(partial(solve_problem, change.problem, optimiser=optimiser))
        except (TimeLimitError, TimeIsUp):
            return cls(change, before, given_up=True)
        except HitchoptError:  # larger changes may still succeed
            return cls(change, before)
        if isinstance(plan, InfeasibleError):
            return cls(change, before, error=plan)
        return cls(change, before, plan.flight.duration)

    @property
    def certified(self) -> bool:
        """Return whether the change leads to a certified plan."""
        return self.duration is not None

    @cached_property
    def after(self) -> Faults:
        """Faults with the change."""
        return {} if self.error is None else faults_of(self.error)

    @property
    def repairs_all(self) -> bool:
        """Return whether all faults are repaired, if others appear."""
        return self.error is not None and self.before.keys().isdisjoint(self.after)

    @cached_property
    def is_without_effect(self) -> bool:
        """Return whether all faults that the change might repair are as they were."""
        covered = [place for place in self.before if place[0] in self.change.covers]
        return bool(covered) and all(
            place in self.after
            and np.allclose(self.after[place], self.before[place], rtol=RELATIVE_TOLERANCE)
            for place in covered
        )

    @cached_property
    def _remaining(self) -> Sequence[tuple[str, int]]:
        """Places of faults that the change might repair, and that remain."""
        return [x for x in self.before if x[0] in self.change.covers and x in self.after]

    @property
    def _worsens(self) -> bool:
        """Return whether a fault of another kind is worse, or there is one at an earlier step."""
        others = (self.before.keys() & self.after.keys()) - {*self._remaining}
        tolerated = {x: RELATIVE_TOLERANCE * abs(self.before[x].value) for x in others}
        return _first_step(self.after) < _first_step(self.before) or any(
            self.after[x].value < self.before[x].value - tolerated[x] for x in others
        )

    @property
    def repairs_part(self) -> bool:
        """Return whether all faults that it might repair are repaired, and none is worse."""
        is_moved = self.error is not None and not self.is_without_effect
        return is_moved and not self._worsens and not self._remaining

    @property
    def improves(self) -> bool:
        """Return whether some faults that it might repair remain, and none is worse."""
        return bool(self._remaining) and not self._worsens

    @property
    def covers_rest(self) -> bool:
        """Return whether a larger change may repair all that is still broken, or unknown."""
        return self.error is None or broken_constraints(self.error) <= self.change.covers
