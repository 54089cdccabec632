"""Candidates: ways to meet one goal, tried in order until one is certified.

A planner yields its candidates. ``first_certified`` tries them, and is the only place that catches
InfeasibleError to try something else. What a planner asks on the way is a query that returns None,
or a violation, such as ``shape_violation``. The error itself is an answer where candidates are
ranked or shown (``outcome``, ``error_of``), and where forces have no balance (``if_balanced``; how
much a move must be slowed). ``violations_at`` only adds the time to an error.

The search within one candidate, such as that of the optimiser, has an effort of its own.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

from hitchopt.errors import (
    FaultWarning,
    HitchoptError,
    InfeasibleError,
    InputError,
    PlannerError,
    Progress,
    RequestError,
    TimeLimitError,
)

T = TypeVar("T")
U = TypeVar("U")
T_co = TypeVar("T_co", covariant=True)

CANDIDATE_COST = 100.0  # Effort of planning and certifying a candidate without a search
MIN_LIMIT = 1e-9  # Smallest limit by which a violation is divided


@dataclass(eq=False)
class Effort:
    """Effort of planning, which does not depend on the machine's speed, and its limit.

    It is the sum of the costs of candidates and of the optimiser's programs. Its unit takes about
    0.4 ms in programs; a candidate without a search takes longer than its cost, often 0.5 s.
    """

    limit: float = math.inf  # Effort within which candidates and programs start
    spent: float = 0.0  # Effort so far
    whole: Effort | None = None  # Effort of which it is a part; None if it is the whole

    def spend(self, cost: float) -> bool:
        """Add the cost of a candidate or a program, and return whether it is within all limits."""
        self.spent += cost
        within_whole = self.whole is None or self.whole.spend(cost)
        return self.spent <= self.limit and within_whole


@dataclass(frozen=True, eq=False)
class Candidate(Generic[T_co]):
    """One way to meet a goal."""

    name: str  # What it is, a noun in the singular: candidates of one name are counted
    plan: Callable[[], T_co]  # Return its certified plan, or raise InfeasibleError
    # Return the candidate that avoids a failure of this one; None if nothing can be changed
    amended: Callable[[InfeasibleError], Candidate[T_co] | None] | None = None
    explained: Callable[[InfeasibleError], InfeasibleError] | None = None
    """Return its error with what only a long analysis shows, for the best failure of all.

    It is called once, where ``explained_once`` surrounds the outermost search.
    """


class UnexplainedError(InfeasibleError):
    """A refusal whose violations a long analysis completes, unless something else is planned."""

    def __init__(
        self,
        error: InfeasibleError,
        note: str,
        explained: Callable[[InfeasibleError], InfeasibleError],
    ) -> None:
        super().__init__(error.violations, note)
        self._error = error
        self._explained = explained

    def with_note(self, line: str) -> UnexplainedError:
        """Return the refusal with a further line of its note."""
        return UnexplainedError(self._error, f"{self.note}\n{line}".strip(), self._explained)

    def explained(self) -> InfeasibleError:
        """Return the refusal with the violations that the analysis finds."""
        return InfeasibleError(self._explained(self._error).violations, self.note)


@contextmanager
def explained_once() -> Iterator[None]:
    """Explain the refusal that the context raises, if any: the best one of all nested searches."""
    try:
        yield
    except UnexplainedError as refusal:
        raise refusal.explained() from refusal


class Failure(NamedTuple):
    """A candidate that failed."""

    candidate: Candidate[Any]  # The candidate
    error: HitchoptError  # What it breaks, or where its planner failed


def first_certified(
    candidates: Iterable[Candidate[T]], effort: Effort, progress: Progress | None = None
) -> T:
    """Return the plan of the first candidate that is certified.

    A candidate is followed by what it is amended to, if anything. No further one is tried once the
    effort exceeds its limit. Raises the error of the candidate with the smallest violation, the
    first one of several; its note says how many were tried, and what the first one broke.
    """
    failures = list[Failure]()
    tried = Counter[str]()
    for first in candidates:
        candidate: Candidate[T] | None = first
        while candidate is not None:
            if not effort.spend(CANDIDATE_COST) and failures:
                raise _refusal(failures, complete=False) from _best(failures).error
            tried[candidate.name] += 1
            if progress is not None and failures:
                count = tried[candidate.name]
                progress(f"trying {candidate.name}{f' {count}' if count > 1 else ''}")
            try:
                plan = candidate.plan()
            except (TimeLimitError, RequestError):
                raise
            except InfeasibleError as error:
                failures.append(Failure(candidate, error))
                candidate = None if candidate.amended is None else candidate.amended(error)
            except HitchoptError as error:
                failures.append(Failure(candidate, error))
                candidate = None
            else:
                _report_faults(failures)
                return plan
    raise _refusal(failures) from _best(failures).error


def if_feasible(name: str, query: Callable[[], T], otherwise: U) -> T | U:
    """Return what a query answers, or what holds without it: a plan that is worse, or None.

    Nothing is said of failures but planners' faults, by the query's name.
    """
    asked: Candidate[T | U] = Candidate(name, query)
    fallback: Candidate[T | U] = Candidate("as it is", lambda: otherwise)
    return first_certified([asked, fallback], Effort())


def outcome(query: Callable[[], T]) -> T | InfeasibleError:
    """Return what a query answers, or what it finds infeasible, which is its answer then."""
    try:
        return query()
    except InfeasibleError as error:
        return error


def error_of(query: Callable[[], object]) -> InfeasibleError | None:
    """Return what a query finds infeasible, or None; it ranks or measures candidates."""
    answer = outcome(query)
    return answer if isinstance(answer, InfeasibleError) else None


def _report_faults(failures: Sequence[Failure]) -> None:
    """Warn of planners that failed with an InputError of their own: another plan hides no fault."""
    for failure in failures:
        error = failure.error
        while isinstance(error, PlannerError):
            error = error.error
        if isinstance(error, InputError):
            words = f"{failure.candidate.name}: {PlannerError(error)}"
            warnings.warn(FaultWarning(words), stacklevel=3)


def excess(error: HitchoptError) -> float:
    """Return the largest violation of an error, relative to its limit; infinite without any."""
    if not isinstance(error, InfeasibleError):
        return math.inf
    shortfalls = [
        abs(violation.value - violation.limit) / max(abs(violation.limit), MIN_LIMIT)
        for violation in error.violations
    ]
    return max(shortfalls, default=math.inf)


def _best(failures: Sequence[Failure]) -> Failure:
    """Return the failure with the smallest violation, the first one of several."""
    return min(failures, key=lambda failure: excess(failure.error))


def _refusal(failures: Sequence[Failure], *, complete: bool = True) -> HitchoptError:
    """Return the error of candidates that failed: that of the best one, with what was tried.

    It is ``complete`` unless the effort reached its limit before all candidates were tried.
    """
    best = _best(failures)
    error = best.error
    if isinstance(error, PlannerError):
        return error
    if not isinstance(error, InfeasibleError):
        return PlannerError(error)
    if best.candidate.explained is not None:
        error = UnexplainedError(error, "", best.candidate.explained)
    if len(failures) == 1 and complete:
        return error
    counts = Counter(failure.candidate.name for failure in failures)
    names = [name if count == 1 else f"{count} {name}s" for name, count in counts.items()]
    note = f"the best of {len(failures)} candidates: {', '.join(names)}"
    if not complete:
        note += "; others were not tried: these used up the effort"
    first = failures[0]
    if first is not best and isinstance(first.error, InfeasibleError):
        violation = replace(first.error.violations[0], remedy="")
        note += f"; {first.candidate.name}: {str(violation).rstrip('; ')}"
    return error.with_note(note)
